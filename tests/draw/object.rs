//! Which model each pixel shows, against the plain reference of every model alone.

use super::{EVERYTHING, camera, scene};
use glam::{DAffine3, DMat3, DVec3};
use rayon::ThreadPoolBuilder;
use vernissage::frame::Needs;
use vernissage::pixels::simd;
use vernissage::render::reference::{self, Picture};
use vernissage::render::{Camera, Placed, Renderer};
use vernissage::scene::{Mesh, Scene, Shading, builtin};

/// Three models through each other, the second flat and in view twice, the third seen or only hiding the others.
fn crowd(phantom: bool) -> (Scene, Vec<Placed>) {
    let mesh = |name| builtin(name).expect("built in");
    let mut all = scene(mesh("teapot"), Shading::Smooth, false);
    all.models.extend(scene(mesh("spot"), Shading::Flat, false).models);
    all.models.extend(scene(mesh("spot"), Shading::Smooth, false).models);
    all.models[2].phantom = phantom;
    let at = |model: usize, x: f64, z: f64, turn: f64| {
        let matrix3 = DMat3::from_rotation_x(2.7) * DMat3::from_rotation_y(turn);
        Placed { model, to_camera: DAffine3 { matrix3, translation: DVec3::new(x, 0.1, z) } }
    };
    let placed = [at(0, 0.0, 7.0, 0.4), at(1, 1.2, 5.5, 1.0), at(2, -0.9, 5.0, 2.0), at(1, -1.8, 7.5, 0.2)];
    (all, placed.to_vec())
}

/// Every placed model drawn alone.
fn alone(scene: &Scene, placed: &[Placed], view: &Camera) -> Vec<Picture> {
    let draw = |placed: &Placed| {
        let mesh: &Mesh = &scene.models[placed.model].mesh;
        reference::draw(mesh, placed, view, &scene.light, false)
    };
    placed.iter().map(draw).collect()
}

#[test]
fn objects_are_the_nearest_models() {
    // odd sides: tiles are cut off
    let view = camera(333, 251, 0.5, 50.0);
    for phantom in [false, true] {
        let (scene, placed) = crowd(phantom);
        let pictures = alone(&scene, &placed, &view);
        let mut renderer = Renderer::new(simd::best());
        let layer = renderer.draw(&scene, &placed, &view, EVERYTHING.and(Needs::OBJECT));
        let (mut seen, mut skipped) = ([0; 4], 0);
        for pixel in 0..333 * 251 {
            let mut found: Vec<(f64, usize)> = pictures
                .iter()
                .zip(&placed)
                .filter_map(|(picture, placed)| Some((picture.layers(pixel)[0]?.depth, placed.model)))
                .collect();
            found.sort_by(|a, b| a.0.total_cmp(&b.0));
            let near_edge = pictures.iter().any(|picture| picture.near_edge[pixel]);
            let close = matches!(found[..], [(a, m), (b, n), ..] if m != n && b - a <= 1e-4 * a);
            if near_edge || close {
                skipped += 1;
                continue;
            }
            let expected = match found.first() {
                Some(&(_, 2)) if phantom => 0,
                Some(&(_, model)) => model + 1,
                None => 0,
            };
            let (x, y) = (pixel % 333, pixel / 333);
            assert_eq!(usize::from(layer.object.at(x, y)), expected, "({x},{y}) phantom {phantom}");
            assert_eq!(layer.depth.at(x, y) < f32::INFINITY, expected != 0, "({x},{y})");
            seen[expected] += 1;
        }
        let models = seen[1] > 3000 && seen[2] > 3000 && (seen[3] > 3000) != phantom;
        assert!(models && seen[0] > 20_000 && skipped < 2500, "{seen:?} {skipped}");
    }
}

/// The plane is there only when it is asked for, changes nothing else, and no level or thread count changes it; what
/// moves away leaves nothing behind.
#[test]
fn objects_are_made_only_when_asked_for() {
    let view = camera(333, 251, 0.5, 50.0);
    let (scene, mut placed) = crowd(false);
    let mut plain = Renderer::new(simd::best());
    let color = Needs::COLOR.and(Needs::DEPTH);
    assert_eq!(plain.draw(&scene, &placed, &view, color).object.size().area(), 0);
    let mut first = None;
    for level in simd::available() {
        for threads in [1, 2, 4] {
            let pool = ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            let mut renderer = Renderer::new(level);
            let both =
                pool.install(|| renderer.draw(&scene, &placed, &view, color.and(Needs::OBJECT)).clone());
            assert!(both.color.planes == plain.layer().color.planes && both.depth == plain.layer().depth);
            let mask = pool.install(|| renderer.draw(&scene, &placed, &view, Needs::OBJECT).clone());
            assert_eq!(mask.color.size().area(), 0);
            assert!(mask.object == both.object);
            assert!(*first.get_or_insert_with(|| mask.object.clone()) == mask.object);
        }
    }
    // one model alone has no surfaces to tell apart
    let mut renderer = Renderer::new(simd::best());
    let one = renderer.draw(&scene, &placed[1..2], &view, Needs::OBJECT).clone();
    let covered = one.depth.samples().iter().map(|z| if *z < f32::INFINITY { 2 } else { 0 });
    assert!(covered.eq(one.object.samples().iter().copied()));
    placed.iter_mut().for_each(|placed| placed.to_camera.translation.x += 100.0);
    let gone = renderer.draw(&scene, &placed, &view, Needs::OBJECT);
    assert!(gone.object.samples().iter().all(|id| *id == 0));
}
