//! `vernissage demo`.

/// Not written yet.
#[derive(clap::Args, Default)]
pub struct Args {}

pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("demo is not built yet")
}
