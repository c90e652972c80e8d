//! `vernissage bench --raster`: the rasteriser on models of rising size, against its f64 reference.
//!
//! Each model fills a 640x480 picture as the reference views do. Larger models than the built-in ones are these with
//! every triangle divided in four, once or more; model files can be added. Every frame is drawn anew.

use super::table::{Cell, Column, Table};
use super::{Args, Times};
use crate::app::report::machine;
use crate::app::{pool, progress, say};
use crate::frame::Needs;
use crate::geometry::Lens;
use crate::marker::Family;
use crate::pixels::{Size, simd};
use crate::render::reference::{self, Difference, Picture};
use crate::render::{Camera, Placed, Renderer};
use crate::scene::{Anchor, Mesh, Model, Scene, Shading, builtin};
use glam::{DAffine3, DMat3, DVec2, DVec3};
use rayon::ThreadPool;
use std::collections::HashMap;
use std::sync::Arc;
use std::time::Instant;

const VGA: Size = Size { width: 640, height: 480 };
/// Distance of the reference views in radii of the model.
const DISTANCE: f64 = 2.875;
/// Built-in models and how often their triangles are divided.
const MODELS: [(&str, u32); 5] = [("teapot", 0), ("spot", 0), ("spot", 1), ("spot", 2), ("spot", 3)];
/// Models of the crowd, and of those the ones in view.
const CROWD: [usize; 2] = [64, 4];

/// What is drawn: depth and color, or all of both layers.
fn products() -> [(&'static str, Needs); 2] {
    let plain = Needs::COLOR.and(Needs::DEPTH);
    [("1", plain), ("2", plain.and(Needs::NORMAL).and(Needs::SECOND_LAYER))]
}

/// Measures and prints.
pub(super) fn run(args: &Args) -> anyhow::Result<()> {
    if args.json {
        say(serde_json::json!({ "machine": machine(), "repeat": args.repeat }))?;
    } else {
        say(format_args!("{}, 640x480", machine()))?;
    }
    let mut models = Vec::new();
    for (name, times) in MODELS {
        let Some(mesh) = builtin(name) else { continue };
        let mesh = (0..times).fold(mesh, |mesh, _| divided(&mesh));
        models.push((if times > 0 { format!("{name} / {}", 4u32.pow(times)) } else { name.into() }, mesh));
    }
    for path in &args.model {
        let mesh = Mesh::load(path).map_err(|e| anyhow::anyhow!("{e}; --model takes model files"))?;
        models.push((path.display().to_string(), mesh));
    }
    let bar = progress::bar(Some(models.len() as u64 + 1), "models");
    let mut rows = Vec::new();
    for (name, mesh) in models {
        rows.extend(measure(args, &name, mesh)?);
        bar.inc(1);
    }
    let about = format!(
        "least and middle time of {} frames; overdraw is of all surfaces, hidden or not",
        args.repeat
    );
    let table = Table { part: "models", about, columns: COLUMNS, rows };
    bar.suspend(|| table.print(args.json))?;
    let crowd = crowd(args)?;
    bar.finish_and_clear();
    crowd.print(args.json)
}

const COLUMNS: &[Column] = &[
    Column("model", "model", 0),
    Column("vertices", "vertices", 0),
    Column("triangles", "triangles", 0),
    Column("layers", "layers", 0),
    Column("threads", "threads", 0),
    Column("ms: least", "min_ms", 3),
    Column("median", "median_ms", 3),
    Column("Mtriangles/s", "mtriangles_per_s", 2),
    Column("Mpixels/s", "mpixels_per_s", 1),
    Column("overdraw", "overdraw", 2),
    Column("coverage off", "coverage_mismatches", 0),
    Column("depth off", "depth_relative", 9),
    Column("normal off", "normal", 7),
];

/// One model's rows.
fn measure(args: &Args, name: &str, mesh: Mesh) -> anyhow::Result<Vec<Vec<Cell>>> {
    let (camera, placed) = view(&mesh);
    let (vertices, triangles) = (mesh.positions.len(), mesh.triangles.len());
    let scene = scene([mesh]);
    let picture = reference::draw(&scene.models[0].mesh, &placed, &camera, &scene.light, false);
    let (pixels, overdraw) = amount(&picture);
    let mut rows = Vec::new();
    for (layers, needs) in products() {
        for &threads in &args.threads {
            let mut renderer = Renderer::new(simd::best());
            let pool = pool(threads)?;
            let times = time(&pool, args.repeat, &mut renderer, &scene, &[placed], &camera, needs);
            let difference = Difference::of(renderer.layer(), &picture);
            let seconds = times.min.as_secs_f64();
            rows.push(vec![
                name.into(),
                vertices.into(),
                triangles.into(),
                layers.into(),
                threads.into(),
                (seconds * 1e3).into(),
                (times.median.as_secs_f64() * 1e3).into(),
                (triangles as f64 / seconds * 1e-6).into(),
                (pixels as f64 / seconds * 1e-6).into(),
                overdraw.into(),
                difference.coverage.into(),
                difference.depth.into(),
                difference.normal.into(),
            ]);
        }
    }
    Ok(rows)
}

/// Covered pixels, and surfaces over each of them.
fn amount(picture: &Picture) -> (usize, f64) {
    let covered = picture.fragments.iter().filter(|fragments| !fragments.is_empty()).count();
    let surfaces: usize = picture.fragments.iter().map(Vec::len).sum();
    (covered, surfaces as f64 / covered as f64)
}

/// Many models of which few are in view, against these few alone.
fn crowd(args: &Args) -> anyhow::Result<Table> {
    let mut rows = Vec::new();
    let spot = Arc::new(builtin("spot").unwrap_or_default());
    let (camera, placed) = view(&spot);
    // they stand twice as far as a model alone
    let camera = Camera { far: 2.0 * camera.far, ..camera };
    let scene = scene(vec![spot; CROWD[0]]);
    // the first ones side by side, all others to the right of the picture
    let at = |k: usize| {
        let mut to_camera = placed.to_camera;
        let column = if k < CROWD[1] { k as f64 - 1.5 } else { 20.0 + k as f64 };
        to_camera.translation.x += 0.25 * to_camera.translation.z * column;
        to_camera.translation.z *= 2.0;
        Placed { model: k, to_camera }
    };
    let places: Vec<Placed> = (0..CROWD[0]).map(at).collect();
    for &threads in &args.threads {
        let pool = pool(threads)?;
        let of = |count: usize| {
            let mut renderer = Renderer::new(simd::best());
            let needs = Needs::COLOR.and(Needs::DEPTH);
            let least = time(&pool, args.repeat, &mut renderer, &scene, &places[..count], &camera, needs).min;
            (least.as_secs_f64() * 1e3, renderer.work().models)
        };
        let [(all, drawn), (few, _)] = CROWD.map(of);
        rows.push(vec![threads.into(), drawn.into(), all.into(), few.into(), (all / few).into()]);
    }
    const COLUMNS: &[Column] = &[
        Column("threads", "threads", 0),
        Column("drawn", "drawn", 0),
        Column("ms: 64, 4 in view", "all_ms", 3),
        Column("4 alone", "few_ms", 3),
        Column("ratio", "ratio", 2),
    ];
    Ok(Table { part: "crowd", about: "64 models of which 4 are in view".into(), columns: COLUMNS, rows })
}

/// Times of frames drawn anew, after three more.
fn time(
    pool: &ThreadPool,
    repeat: u64,
    renderer: &mut Renderer,
    scene: &Scene,
    placed: &[Placed],
    camera: &Camera,
    needs: Needs,
) -> Times {
    pool.install(|| {
        let once = |_| {
            renderer.restart();
            let start = Instant::now();
            renderer.draw(scene, placed, camera, needs);
            start.elapsed()
        };
        Times::of((0..repeat + 3).map(once).skip(3).collect())
    })
}

fn scene(meshes: impl IntoIterator<Item = impl Into<Arc<Mesh>>>) -> Scene {
    let model = |mesh: Arc<Mesh>| Model {
        name: "bench".into(),
        mesh,
        anchor: Anchor { family: Family::Tag36h11, id: None, side_mm: 1.0 },
        to_marker: DAffine3::IDENTITY,
        shading: Shading::Smooth,
        cull_back: false,
        secondary: false,
        phantom: false,
    };
    Scene { models: meshes.into_iter().map(|mesh| model(mesh.into())).collect(), ..Scene::default() }
}

/// The camera of the reference views: 30° to the side, 20° from above, the whole model in the picture.
fn view(mesh: &Mesh) -> (Camera, Placed) {
    let (low, high) = mesh.bounds().unwrap_or_default();
    let center = (low.as_dvec3() + high.as_dvec3()) / 2.0;
    let used = mesh.triangles.iter().flatten().filter_map(|&i| mesh.positions.get(i as usize));
    let radius =
        used.map(|p| (p.as_dvec3() - center).length()).filter(|r| r.is_finite()).fold(1e-12, f64::max);
    // mesh y up becomes camera y up
    let turn = |degrees: f64| degrees.to_radians();
    let matrix3 = DMat3::from_rotation_x(turn(180.0) - turn(20.0)) * DMat3::from_rotation_y(turn(-30.0));
    let distance = DISTANCE * radius;
    let translation = DVec3::new(0.0, 0.0, distance) - matrix3 * center;
    let lens = Lens {
        size: VGA,
        focal: DVec2::splat(600.0),
        center: DVec2::new(319.5, 239.5),
        distortion: [0.0; 8],
    };
    let camera = Camera { lens, near: distance - 1.5 * radius, far: distance + 1.5 * radius };
    (camera, Placed { model: 0, to_camera: DAffine3 { matrix3, translation } })
}

/// Every triangle in four by the middles of its edges; without textures.
fn divided(mesh: &Mesh) -> Mesh {
    let mut out =
        Mesh { positions: mesh.positions.clone(), normals: mesh.normals.clone(), ..Mesh::default() };
    let mut middles = HashMap::new();
    for &[a, b, c] in &mesh.triangles {
        let mut middle = |a: u32, b: u32| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                let (i, j) = (a as usize, b as usize);
                out.positions.push((mesh.positions[i] + mesh.positions[j]) * 0.5);
                let normals = [i, j].map(|k| mesh.normals.get(k).copied().unwrap_or_default());
                out.normals.push((normals[0] + normals[1]).normalize_or_zero());
                out.positions.len() as u32 - 1
            })
        };
        let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
        out.triangles.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dividing_keeps_the_surface() {
        let spot = builtin("spot").expect("built in");
        let fine = divided(&spot);
        assert_eq!(fine.triangles.len(), 4 * spot.triangles.len());
        assert_eq!(fine.bounds(), spot.bounds());
        let area = |mesh: &Mesh| -> f64 {
            let at = |i: u32| mesh.positions[i as usize].as_dvec3();
            mesh.triangles.iter().map(|t| (at(t[1]) - at(t[0])).cross(at(t[2]) - at(t[0])).length()).sum()
        };
        assert!((area(&fine) / area(&spot) - 1.0).abs() < 1e-5);
    }

    #[test]
    fn the_view_holds_the_model() {
        let mesh = builtin("teapot").expect("built in");
        let (camera, placed) = view(&mesh);
        let picture = reference::draw(&mesh, &placed, &camera, &Default::default(), false);
        let (pixels, overdraw) = amount(&picture);
        assert!(pixels > 30_000 && overdraw > 1.5, "{pixels} px, {overdraw} surfaces each");
        let mut renderer = Renderer::new(simd::best());
        let layer = renderer.draw(&scene([mesh]), &[placed], &camera, products()[1].1);
        let difference = Difference::of(layer, &picture);
        assert!(difference.coverage == 0 && difference.depth <= 1e-4, "{difference:?}");
    }
}
