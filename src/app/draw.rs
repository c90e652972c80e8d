//! `vernissage draw`: one model, one camera, raw depth and normals for measuring the rasteriser.

use super::{Failed, say};
use crate::frame::{Layer, Needs};
use crate::geometry::Lens;
use crate::marker::Family;
use crate::pixels::{Plane, Size, picture, simd};
use crate::render::{Camera, Placed, Renderer};
use crate::scene::{Anchor, BUILTIN, Mesh, Model, Scene, Shading, builtin};
use anyhow::{Context, bail, ensure};
use clap::ValueEnum;
use glam::{DAffine3, DMat3, DVec2, DVec3};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Draw one model as a camera file sees it: PREFIX_color.png, _depth.f32 (camera z, +inf outside) and
/// _normal.f32 (camera space), raw little-endian, row 0 on top
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  vernissage draw --model teapot --camera cam.json --out teapot\n  \
    vernissage draw --model bunny.obj --camera cam.json --out bunny --peel --repeat 100 --json")]
pub struct Args {
    /// OBJ, .glb, PLY or STL file, or the name of a built-in model (teapot, spot)
    #[arg(long, value_name = "M.obj")]
    model: PathBuf,
    /// JSON with width, height, fx, fy, cx, cy, near, far, world_to_camera (16 numbers, row by row)
    #[arg(long, value_name = "CAM.json")]
    camera: PathBuf,
    /// Where the output files' names begin
    #[arg(long, value_name = "PREFIX")]
    out: PathBuf,
    /// How intensity becomes color
    #[arg(long, value_enum, default_value_t = ShadingName::Smooth)]
    shading: ShadingName,
    /// Also write the second-nearest surface: PREFIX_depth2.f32, PREFIX_normal2.f32
    #[arg(long)]
    peel: bool,
    /// Also write where the model is nearest: PREFIX_object.u16, 1 there and 0 elsewhere
    #[arg(long)]
    objects: bool,
    /// Which faces are dropped; front = counter-clockwise as seen
    #[arg(long, value_enum, default_value_t = Cull::None)]
    cull: Cull,
    /// Threads used at most
    #[arg(long, default_value_t = 2, value_name = "N")]
    threads: usize,
    /// Time this many draws into memory, after three more: color and depth, with --peel normals and the
    /// second layer too
    #[arg(long, value_name = "K", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    repeat: Option<u32>,
    /// Print one JSON line: model, vertices, triangles, threads, ms
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum ShadingName {
    Smooth,
    Flat,
    Toon,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Cull {
    None,
    Back,
}

/// CAM.json.
#[derive(serde::Deserialize)]
struct CameraFile {
    width: usize,
    height: usize,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    near: f64,
    far: f64,
    world_to_camera: Vec<f64>,
}

/// The line `--json` prints.
#[derive(serde::Serialize)]
struct Report<'a> {
    model: &'a str,
    vertices: usize,
    triangles: usize,
    threads: usize,
    ms: Vec<f64>,
}

pub fn run(args: Args) -> anyhow::Result<()> {
    let (camera, to_camera) = read_camera(&args.camera)?;
    let mut mesh = load(&args.model)?;
    if args.model.extension().is_some_and(|end| end.eq_ignore_ascii_case("obj")) {
        // what this command draws is measured against others, that read no colors of OBJ vertices
        mesh.colors.clear();
    }
    let pool = super::pool(args.threads)?;
    let shading = match args.shading {
        ShadingName::Smooth => Shading::Smooth,
        ShadingName::Flat => Shading::Flat,
        ShadingName::Toon => Shading::Toon { steps: 4, base: 0.25 },
    };
    let name = args.model.to_string_lossy();
    let (vertices, triangles) = (mesh.positions.len(), mesh.triangles.len());
    let model = Model {
        name: name.clone().into_owned(),
        mesh: mesh.into(),
        anchor: Anchor { family: Family::Tag36h11, id: None, side_mm: 1.0 },
        to_marker: DAffine3::IDENTITY,
        shading,
        cull_back: args.cull == Cull::Back,
        secondary: false,
        phantom: false,
    };
    let scene = Scene { models: vec![model], ..Scene::default() };
    let placed = [Placed { model: 0, to_camera }];

    let mut renderer = Renderer::new(simd::best());
    let peel = if args.peel { Needs::SECOND_LAYER } else { Needs::NOTHING };
    let outputs = Needs::COLOR.and(Needs::DEPTH).and(Needs::NORMAL).and(peel);
    let objects = if args.objects { Needs::OBJECT } else { Needs::NOTHING };
    let ms = pool.install(|| {
        let timed = if args.peel { outputs } else { Needs::COLOR.and(Needs::DEPTH) };
        let mut once = || {
            renderer.restart();
            let start = Instant::now();
            renderer.draw(&scene, &placed, &camera, timed);
            start.elapsed().as_secs_f64() * 1e3
        };
        let repeats = args.repeat.unwrap_or(0);
        if repeats > 0 {
            (0..3).for_each(|_| _ = once());
        }
        (0..repeats).map(|_| once()).collect::<Vec<_>>()
    });
    let layer = pool.install(|| renderer.draw(&scene, &placed, &camera, outputs.and(objects)));
    write(layer, &args.out, args.peel, args.objects)?;

    let report = Report { model: &name, vertices, triangles, threads: args.threads, ms };
    if args.json {
        say(serde_json::to_string(&report)?)?;
    } else if let Some(least) = report.ms.iter().copied().reduce(f64::min) {
        let (threads, times) = (args.threads, report.ms.len());
        say(format_args!(
            "{name}: {vertices} vertices, {triangles} triangles, {threads} threads: {least:.3} ms (least of {times})"
        ))?;
    }
    Ok(())
}

/// The model file, or the built-in model where there is no such file.
fn load(path: &Path) -> anyhow::Result<Mesh> {
    if !path.exists()
        && let Some(mesh) = path.to_str().and_then(builtin)
    {
        return Ok(mesh);
    }
    Mesh::load(path).map_err(|e| {
        anyhow::anyhow!("{e}; give an OBJ, .glb, PLY or STL file or one of {}", BUILTIN.join(", "))
    })
}

fn read_camera(path: &Path) -> anyhow::Result<(Camera, DAffine3)> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("{}: cannot read camera", path.display()))?;
    let name = path.display();
    let file: CameraFile = serde_json::from_str(&text).with_context(|| {
        format!("{name}: not a camera: needs width, height, fx, fy, cx, cy, near, far, world_to_camera")
    })?;
    let Ok(m) = <[f64; 16]>::try_from(file.world_to_camera) else {
        bail!("{name}: world_to_camera: give 16 numbers, row by row")
    };
    ensure!(m.iter().all(|v| v.is_finite()), "{name}: world_to_camera: give finite numbers");
    let sides = 1..=16384;
    ensure!(
        sides.contains(&file.width) && sides.contains(&file.height),
        "{name}: width and height: give 1 to 16384 pixels"
    );
    let (focal, center) = (DVec2::new(file.fx, file.fy), DVec2::new(file.cx, file.cy));
    ensure!(
        focal.is_finite() && focal.min_element() > 0.0 && center.is_finite(),
        "{name}: fx and fy must be above 0, cx and cy finite"
    );
    ensure!(
        file.near > 0.0 && file.far > file.near && file.far.is_finite(),
        "{name}: near must be above 0 and below far"
    );
    let lens = Lens { size: Size::new(file.width, file.height), focal, center, distortion: [0.0; 8] };
    let linear = DMat3::from_cols(
        DVec3::new(m[0], m[4], m[8]),
        DVec3::new(m[1], m[5], m[9]),
        DVec3::new(m[2], m[6], m[10]),
    );
    let to_camera = DAffine3 { matrix3: linear, translation: DVec3::new(m[3], m[7], m[11]) };
    Ok((Camera { lens, near: file.near, far: file.far }, to_camera))
}

fn write(layer: &Layer, prefix: &Path, peel: bool, objects: bool) -> anyhow::Result<()> {
    let path = |ending: &str| {
        let mut path = prefix.as_os_str().to_owned();
        path.push(ending);
        PathBuf::from(path)
    };
    picture::write_png(&path("_color.png"), &layer.color)?;
    write_raw(&path("_depth.f32"), &[&layer.depth], f32::to_le_bytes)?;
    write_raw(&path("_normal.f32"), &layer.normal.each_ref(), f32::to_le_bytes)?;
    if peel {
        write_raw(&path("_depth2.f32"), &[&layer.depth2], f32::to_le_bytes)?;
        write_raw(&path("_normal2.f32"), &layer.normal2.each_ref(), f32::to_le_bytes)?;
    }
    if objects {
        write_raw(&path("_object.u16"), &[&layer.object], u16::to_le_bytes)?;
    }
    Ok(())
}

/// Writes planes of one size pixel by pixel, their samples side by side.
fn write_raw<T: Copy, const N: usize>(
    path: &Path,
    planes: &[&Plane<T>],
    bytes_of: fn(T) -> [u8; N],
) -> anyhow::Result<()> {
    let size = planes[0].size();
    let mut bytes = Vec::with_capacity(size.area() * planes.len() * N);
    for y in 0..size.height {
        for x in 0..size.width {
            for plane in planes {
                bytes.extend(bytes_of(plane.at(x, y)));
            }
        }
    }
    std::fs::write(path, &bytes)
        .with_context(|| format!("{}: cannot write; choose another --out", path.display()))
        .context(Failed("cannot write the output files"))
}
