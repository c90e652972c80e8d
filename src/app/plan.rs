//! `vernissage plan`.

/// Not written yet.
#[derive(clap::Args, Default)]
pub struct Args {}

pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("plan is not built yet")
}
