//! `vernissage plan`: what would run for a scene, what is skipped, and why.

use super::config::Loaded;
use crate::pipeline::{Pipeline, View};
use crate::pixels::{Size, simd};
use std::path::PathBuf;

/// Says what every frame of a scene computes, what it skips, and why.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  vernissage plan --config scene.toml")]
pub struct Args {
    /// Scene or visor file
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
}

pub fn run(args: Args) -> anyhow::Result<()> {
    let Loaded { config, scene } = Loaded::read(&args.config)?;
    let size = Size::new(config.camera.width, config.camera.height);
    let (lens, warning) = config.lens(size);
    println!("style   {}", config.style.name);
    for model in &scene.models {
        let (anchor, triangles) = (model.anchor, model.mesh.triangles.len());
        let id = anchor.id.map_or("any".to_string(), |id| id.to_string());
        println!("model   {} ({triangles} triangles) on {} {id}", model.name, anchor.family.name());
    }
    println!("lens    {}", warning.unwrap_or_else(|| format!("calibrated, {size}")));
    let empty = scene.models.is_empty();
    let count = scene.models.len();
    let pipeline = Pipeline::new(scene, lens, config.track, &config.style, simd::best());
    println!("\nno marker in view\n{}", pipeline.plan(View::Models(0)));
    if !empty {
        println!("markers in view\n{}", pipeline.plan(View::Models(count)));
    }
    Ok(())
}
