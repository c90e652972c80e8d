//! `vernissage run`.

/// Not written yet.
#[derive(clap::Args, Default)]
pub struct Args {}

pub fn run(_args: Args) -> anyhow::Result<()> {
    anyhow::bail!("run is not built yet")
}
