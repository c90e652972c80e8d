//! What is not in view or has not changed costs nothing, and nothing else is skipped.

use super::{EVERYTHING, barrel, camera, same, scene, turned};
use glam::{DAffine3, DMat3, DVec3, Vec3};
use vernissage::frame::Needs;
use vernissage::pixels::simd;
use vernissage::render::{Look, Placed, Renderer};
use vernissage::scene::{Mesh, Scene, Shading, builtin};

#[test]
fn sixty_four_models_cost_what_the_four_in_view_do() {
    let one = scene(builtin("spot").expect("built in"), Shading::Smooth, false);
    let many = Scene { models: vec![one.models[0].clone(); 64], ..Scene::default() };
    // eight by eight, the four in the middle in view
    let at = |k: usize| {
        let turn = DMat3::from_rotation_x(2.7);
        let shift = |i: usize| 2.6 * (i as f64 - 3.5);
        let translation = DVec3::new(shift(k % 8), shift(k / 8), 4.5);
        Placed { model: k, to_camera: DAffine3 { matrix3: turn, translation } }
    };
    let all: Vec<Placed> = (0..64).map(at).collect();
    let seen: Vec<Placed> = [27, 28, 35, 36].map(at).into();
    for view in [camera(320, 240, 0.2, 100.0), barrel(320, 240)] {
        let (mut of_all, mut of_four) = (Renderer::new(simd::best()), Renderer::new(simd::best()));
        let crowd = of_all.draw(&many, &all, &view, EVERYTHING).clone();
        let four = of_four.draw(&many, &seen, &view, EVERYTHING);
        assert!(same(&crowd, four) && crowd.extent == four.extent && !crowd.touched.is_empty());
        assert_eq!(of_all.work(), of_four.work());
        assert_eq!(of_all.work().models, 4);
    }
}

#[test]
fn parts_out_of_view_are_not_looked_at() {
    // a long strip of small squares, a hundredth of it in view
    let mut mesh = Mesh::default();
    for k in 0..20_000u32 {
        let x = k as f32 * 0.1 - 1000.0;
        for (dx, y) in [(0.0, -1.0), (0.1, -1.0), (0.1, 1.0), (0.0, 1.0)] {
            mesh.positions.push(Vec3::new(x + dx, y, 10.0));
        }
        mesh.triangles.extend([[4 * k, 4 * k + 1, 4 * k + 2], [4 * k, 4 * k + 2, 4 * k + 3]]);
    }
    let scene = scene(mesh, Shading::Smooth, false);
    let here = [Placed { model: 0, to_camera: DAffine3::IDENTITY }];
    let mut renderer = Renderer::new(simd::best());
    let layer = renderer.draw(&scene, &here, &camera(160, 120, 0.5, 99.0), Needs::DEPTH);
    let row = layer.depth.row(60);
    assert!(row.iter().all(|z| z.is_finite()), "the strip goes through the whole picture");
    assert!(renderer.work().triangles < 1000, "{:?}", renderer.work());
}

/// A cube of six faces, each of 512 triangles in a row, wound outwards.
fn cube() -> Mesh {
    const SIDE: u32 = 16;
    let mut mesh = Mesh::default();
    for (axis, sign) in [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0), (2, 1.0), (2, -1.0)] {
        let first = mesh.positions.len() as u32;
        for k in 0..=SIDE * (SIDE + 2) {
            let (u, v) = (k % (SIDE + 1), k / (SIDE + 1));
            let at = [u, v].map(|i| i as f32 / SIDE as f32 * 2.0 - 1.0);
            let turned = if sign > 0.0 { [1.0, at[0], at[1]] } else { [-1.0, at[1], at[0]] };
            let mut position = [0.0; 3];
            (0..3).for_each(|i| position[(axis + i) % 3] = turned[i]);
            mesh.positions.push(Vec3::from(position));
        }
        for k in 0..SIDE * SIDE {
            let a = first + k % SIDE + k / SIDE * (SIDE + 1);
            mesh.triangles.extend([[a, a + 1, a + SIDE + 2], [a, a + SIDE + 2, a + SIDE + 1]]);
        }
    }
    mesh
}

#[test]
fn backs_are_skipped_by_the_cluster() {
    let view = camera(160, 120, 0.2, 99.0);
    let (mut culling, mut whole) = (Renderer::new(simd::best()), Renderer::new(simd::best()));
    let culled = scene(cube(), Shading::Smooth, true);
    let first = culling.draw(&culled, &[turned(6.0, 1.0)], &view, Needs::DEPTH);
    let all = whole.draw(&scene(cube(), Shading::Smooth, false), &[turned(6.0, 1.0)], &view, Needs::DEPTH);
    assert!(first.depth == all.depth && !first.touched.is_empty(), "of a closed model backs are never seen");
    assert_eq!((culling.work().triangles, whole.work().triangles), (3 * 512, 6 * 512));
}

#[test]
fn a_frame_that_would_be_the_same_is_not_drawn() {
    let teapot = scene(builtin("teapot").expect("built in"), Shading::Smooth, false);
    let (view, place) = (camera(160, 120, 0.2, 99.0), turned(9.0, 1.0));
    let mut renderer = Renderer::new(simd::best());
    let first = renderer.draw(&teapot, &[place], &view, EVERYTHING).clone();
    for _ in 0..3 {
        assert!(same(&first, renderer.draw(&teapot, &[place], &view, EVERYTHING)));
    }
    assert_eq!(renderer.work().frames, 1);
    // each of these is another frame
    let mut moved = place;
    moved.to_camera.translation.x += 1e-9;
    let mut lit = teapot.clone();
    lit.light.ambient = 0.5;
    let mut tinted = teapot.clone();
    tinted.light.tint = Vec3::new(1.0, 0.5, 0.5);
    let mut culled = teapot.clone();
    culled.models[0].cull_back = true;
    let mut hidden = teapot.clone();
    hidden.models[0].phantom = true;
    let mut other = teapot.clone();
    other.models[0].mesh = builtin("spot").expect("built in").into();
    let (near, look) = (camera(160, 120, 0.3, 99.0), Look::from(EVERYTHING));
    let flat = Look { shading: Some(Shading::Flat), ..look };
    let cases = [
        (&teapot, vec![moved], view, look),
        (&teapot, vec![place, moved], view, look),
        (&teapot, vec![], view, look),
        (&teapot, vec![place], near, look),
        (&teapot, vec![place], view, flat),
        (&teapot, vec![place], view, Needs::COLOR.into()),
        (&lit, vec![place], view, look),
        (&tinted, vec![place], view, look),
        (&culled, vec![place], view, look),
        (&hidden, vec![place], view, look),
        (&other, vec![place], view, look),
    ];
    for (k, (scene, placed, view, look)) in cases.into_iter().enumerate() {
        let frames = renderer.work().frames;
        let drawn = renderer.draw(scene, &placed, &view, look).clone();
        assert!(same(&drawn, Renderer::new(simd::best()).draw(scene, &placed, &view, look)), "case {k}");
        assert_eq!(renderer.work().frames, frames + 1, "case {k}");
    }
    renderer.draw(&teapot, &[place], &view, EVERYTHING);
    let frames = renderer.work().frames;
    renderer.restart();
    renderer.draw(&teapot, &[place], &view, EVERYTHING);
    assert_eq!(renderer.work().frames, frames + 1, "restarted");
}
