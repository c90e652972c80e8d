//! `vernissage render`.

/// Not written yet.
#[derive(clap::Args, Default)]
pub struct Args {}

pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("render is not built yet")
}
