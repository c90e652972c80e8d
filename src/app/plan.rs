//! `vernissage plan`: what would run for a scene, what is skipped, and why.

use super::config::Loaded;
use super::say;
use super::wishes::Wishes;
use crate::pipeline::{Pipeline, View};
use crate::pixels::{Size, simd};

/// Says what every frame of a scene computes, what it skips, and why.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  vernissage plan --config scene.toml\n  vernissage plan --model teapot --style watercolor"
)]
pub struct Args {
    #[command(flatten)]
    wishes: Wishes,
}

pub fn run(args: Args) -> anyhow::Result<()> {
    let Loaded { config, scene } = args.wishes.load()?;
    let size = Size::new(config.camera.width, config.camera.height);
    let (lens, warning) = config.lens(size);
    say(format_args!("style   {}", config.style.name))?;
    for model in &scene.models {
        let (anchor, triangles) = (model.anchor, model.mesh.triangles.len());
        let id = anchor.id.map_or("any".to_string(), |id| id.to_string());
        say(format_args!("model   {} ({triangles} triangles) on {} {id}", model.name, anchor.family.name()))?;
    }
    say(format_args!(
        "lens    {}",
        match (config.camera.source, warning) {
            (crate::camera::Kind::Synthetic, _) =>
                format!("exact, {size}: the synthetic camera knows its own"),
            (_, Some(warning)) => warning,
            (_, None) => format!("calibrated, {size}"),
        }
    ))?;
    let empty = scene.models.is_empty();
    let count = scene.models.len();
    let pipeline =
        Pipeline::new(scene, lens, config.track, &config.style, simd::best()).retouched(&config.retouch);
    say(format_args!("\nno marker in view\n{}", pipeline.plan(View::Models(0))))?;
    if !empty {
        say(format_args!("markers in view\n{}", pipeline.plan(View::Models(count))))?;
    }
    Ok(())
}
