//! The rasteriser against its plain f64 reference and against independently made reference views.
//!
//! Bounds: on pixels further than 1/256 px from every edge no coverage mismatch, colors within 1 level,
//! depths within 1e-4 relative; both layers. The same bytes for every thread count and SIMD level.

mod object;
mod shading;
mod silhouette;
mod skip;
mod stress;
mod views;

use glam::{DAffine3, DMat3, DVec2, DVec3, Vec3};
use std::sync::Arc;
use vernissage::frame::{Layer, Needs};
use vernissage::geometry::Lens;
use vernissage::marker::Family;
use vernissage::pixels::{Plane, Rgb, Size, SplitMix64, simd};
use vernissage::render::reference::{self, Difference, Picture};
use vernissage::render::{Camera, Placed, Renderer};
use vernissage::scene::{Anchor, Light, Material, Mesh, Model, Scene, Shading, builtin};

pub const EVERYTHING: Needs = Needs::COLOR.and(Needs::DEPTH).and(Needs::NORMAL).and(Needs::SECOND_LAYER);

pub fn scene(mesh: Mesh, shading: Shading, cull_back: bool) -> Scene {
    let anchor = Anchor { family: Family::Tag36h11, id: None, side_mm: 100.0 };
    let to_marker = DAffine3::IDENTITY;
    let mesh = mesh.into();
    let model = Model {
        name: "test".into(),
        mesh,
        anchor,
        to_marker,
        shading,
        cull_back,
        secondary: false,
        phantom: false,
    };
    Scene { models: vec![model], ..Scene::default() }
}

pub fn camera(width: usize, height: usize, near: f64, far: f64) -> Camera {
    Camera { lens: Lens::guess(Size::new(width, height)), near, far }
}

/// Away from the camera by `distance`, turned so that nothing is axis-parallel.
pub fn turned(distance: f64, scale: f64) -> Placed {
    let turn = DMat3::from_rotation_y(0.5) * DMat3::from_rotation_x(2.7);
    let to_camera = DAffine3 {
        matrix3: turn * scale,
        translation: DVec3::new(0.1 * distance, 0.05 * distance, distance),
    };
    Placed { model: 0, to_camera }
}

fn level(shading: Shading, fragment: &reference::Fragment) -> f64 {
    match shading {
        Shading::Smooth => 255.0 * fragment.smooth,
        Shading::Flat => 255.0 * fragment.flat,
        Shading::Toon { steps, base } => {
            let index = ((32.0 * fragment.smooth) as u32).min(31);
            let ramp = f64::from(base)
                + (1.0 - f64::from(base)) * f64::from(index * steps / 32) / f64::from(steps - 1);
            255.0 * if index == 31 { 1.0 } else { ramp }
        }
        Shading::ThreeSteps => {
            255.0
                * if steps_at(fragment, 0.7) {
                    1.0
                } else if steps_at(fragment, 0.2) {
                    0.4
                } else {
                    0.1
                }
        }
    }
}

/// Per-pixel intensity against the default light, above a step.
fn steps_at(fragment: &reference::Fragment, step: f64) -> bool {
    fragment.normal.dot(Light::default().direction.as_dvec3()) > step
}

/// Within the bounds: coverage exact, depths 1e-4 relative, colors one level.
pub fn compare(label: &str, layer: &Layer, picture: &Picture, shading: Shading) -> Difference {
    let found = Difference::of(layer, picture);
    let mut color = 0.0f64;
    for (pixel, &near_edge) in picture.near_edge.iter().enumerate() {
        if near_edge || picture.order_is_close(pixel) {
            continue;
        }
        let (x, y) = (pixel % picture.width, pixel / picture.width);
        let Some(first) = picture.layers(pixel)[0] else { continue };
        let step = (first.smooth * 32.0).fract();
        if matches!(shading, Shading::Toon { .. }) && !(1e-3..=0.999).contains(&step) {
            continue; // a step of the ramp decided by rounding
        }
        if shading == Shading::ThreeSteps
            && [0.7, 0.2].iter().any(|s| steps_at(&first, s - 1e-5) != steps_at(&first, s + 1e-5))
        {
            continue; // likewise
        }
        let expected = level(shading, &first);
        for value in layer.color.at(x, y) {
            color = color.max((f64::from(value) - expected).abs());
        }
    }
    println!("{label}: {found:?}, color {color:.3}");
    assert_eq!(found.coverage, 0, "{label}: {found:?}");
    assert!(found.depth <= 1e-4, "{label}: {found:?}");
    // half a level is rounding
    assert!(color <= 1.0, "{label}: color {color}");
    found
}

pub fn check(
    label: &str,
    mesh: Mesh,
    placed: Placed,
    camera: Camera,
    shading: Shading,
    cull_back: bool,
) -> Difference {
    let scene = scene(mesh, shading, cull_back);
    let mut renderer = Renderer::new(simd::best());
    let layer = renderer.draw(&scene, &[placed], &camera, EVERYTHING);
    let picture = reference::draw(&scene.models[0].mesh, &placed, &camera, &scene.light, cull_back);
    compare(label, layer, &picture, shading)
}

#[test]
fn builtin_models_match_the_reference() {
    let toon = Shading::Toon { steps: 4, base: 0.25 };
    for (name, distance) in [("teapot", 9.0), ("spot", 3.0)] {
        let mesh = || builtin(name).expect("built in");
        let view = camera(160, 120, 0.2, 100.0);
        check(&format!("{name} smooth"), mesh(), turned(distance, 1.0), view, Shading::Smooth, false);
        check(&format!("{name} flat"), mesh(), turned(distance, 1.0), view, Shading::Flat, false);
        check(&format!("{name} toon, culled"), mesh(), turned(distance, 1.0), view, toon, true);
        check(
            &format!("{name} three steps"),
            mesh(),
            turned(distance, 1.0),
            view,
            Shading::ThreeSteps,
            false,
        );
        check(&format!("{name} inside"), mesh(), turned(0.5, 1.0), view, Shading::Smooth, false);
        let cut = Camera { near: distance, far: distance * 1.05, ..view };
        check(
            &format!("{name} cut near and far"),
            mesh(),
            turned(distance, 1.0),
            cut,
            Shading::Smooth,
            false,
        );
    }
}

/// `count` triangles whose corners spread `spread` around random points of the view.
pub fn soup(rng: &mut SplitMix64, count: usize, near_z: f64, far_z: f64, spread: f64) -> Mesh {
    let mut mesh = Mesh::default();
    let around = |rng: &mut SplitMix64| 2.0 * rng.f64() - 1.0;
    for t in 0..count as u32 {
        let z = near_z + (far_z - near_z) * rng.f64();
        let middle = DVec3::new(around(rng) * z.abs() * 0.6, around(rng) * z.abs() * 0.5, z);
        for _ in 0..3 {
            let offset = DVec3::new(around(rng), around(rng), around(rng)) * spread;
            mesh.positions.push((middle + offset).as_vec3());
            mesh.normals
                .push(DVec3::new(around(rng), around(rng), around(rng)).normalize_or_zero().as_vec3());
        }
        mesh.triangles.push([3 * t, 3 * t + 1, 3 * t + 2]);
    }
    mesh
}

#[test]
fn triangle_soups_match_the_reference() {
    let mut rng = SplitMix64::new(20);
    let here = Placed { model: 0, to_camera: DAffine3::IDENTITY };
    let kinds = [
        ("ordinary", 300, 5.0, 20.0, 2.0),
        ("sub-pixel", 4000, 5.0, 20.0, 0.05),
        ("huge", 60, 5.0, 20.0, 1e4),
        ("astride the near plane", 200, -3.0, 6.0, 5.0),
        ("behind", 100, -50.0, -1.0, 0.5),
        ("far", 300, 90.0, 110.0, 10.0),
    ];
    for (width, height) in [(160, 120), (97, 65), (1, 1)] {
        let view = camera(width, height, 0.5, 100.0);
        for (label, count, near, far, spread) in kinds {
            let mesh = soup(&mut rng, count, near, far, spread);
            let view = if label == "huge" { Camera { far: 1e6, ..view } } else { view };
            check(&format!("{label} {width}x{height}"), mesh, here, view, Shading::Smooth, false);
        }
        // slivers: the third corner a hair from the edge
        let mut mesh = soup(&mut rng, 500, 5.0, 20.0, 3.0);
        for t in 0..500 {
            let (a, b) = (mesh.positions[3 * t], mesh.positions[3 * t + 1]);
            let hair = (mesh.positions[3 * t + 2] - a) * (10.0f32).sqrt().recip() * [0.1, 0.01, 0.001][t % 3];
            mesh.positions[3 * t + 2] = a.lerp(b, 0.4) + hair;
        }
        check(&format!("slivers {width}x{height}"), mesh, here, view, Shading::Smooth, false);
    }
}

#[test]
fn a_floor_from_the_feet_to_the_horizon_keeps_its_depth() {
    let mut mesh = Mesh::quad(Vec3::ZERO, Vec3::X * 2e4, Vec3::Y * 2e4, Material::plain(Vec3::ONE));
    mesh.materials.clear();
    mesh.material_of.clear();
    let lying = DAffine3 { matrix3: DMat3::from_rotation_x(1.5), translation: DVec3::new(3.0, 15.0, 90.0) };
    let view = camera(160, 120, 1.0, 30000.0);
    check("floor", mesh, Placed { model: 0, to_camera: lying }, view, Shading::Smooth, false);
}

/// A picture-filling triangulated plane: every pixel is covered by exactly one triangle.
#[test]
fn shared_edges_cover_every_pixel_once() {
    let mut rng = SplitMix64::new(5);
    let (n, view) = (7, camera(97, 65, 0.1, 100.0));
    let mut mesh = Mesh::default();
    for j in 0..=n {
        for i in 0..=n {
            // inner points anywhere near their place, some exactly on pixel centers and in line
            let jitter = |rng: &mut SplitMix64, k: usize| {
                let inner = k > 0 && k < n;
                k as f64 + if inner { [0.0, 0.8 * (rng.f64() - 0.5)][rng.int(0, 1) as usize] } else { 0.0 }
            };
            let at = DVec2::new(jitter(&mut rng, i), jitter(&mut rng, j)) / n as f64 * 2.4 - 1.2;
            let pixel = (at * DVec2::new(48.0, 32.0)).round() + view.lens.center;
            let ray = (pixel - view.lens.center) / view.lens.focal;
            mesh.positions.push((ray.extend(1.0) * 4.0).as_vec3());
        }
    }
    let row = n as u32 + 1;
    for j in 0..n as u32 {
        for i in 0..n as u32 {
            let a = j * row + i;
            mesh.triangles.extend([[a, a + 1, a + row], [a + 1, a + row + 1, a + row]]);
        }
    }
    let here = [Placed { model: 0, to_camera: DAffine3::IDENTITY }];
    let mut hits = Plane::new(view.lens.size, 0u32);
    let mut renderer = Renderer::new(simd::best());
    for triangle in mesh.triangles.clone() {
        let one = scene(Mesh { triangles: vec![triangle], ..mesh.clone() }, Shading::Smooth, false);
        let layer = renderer.draw(&one, &here, &view, Needs::DEPTH);
        for y in 0..65 {
            for x in 0..97 {
                hits.row_mut(y)[x] += u32::from(layer.depth.at(x, y) < f32::INFINITY);
            }
        }
    }
    assert!(hits.samples().iter().all(|&n| n == 1), "holes or double hits");
}

fn barrel(width: usize, height: usize) -> Camera {
    let mut camera = camera(width, height, 1.0, 1e5);
    camera.lens.distortion = [-0.25, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    camera
}

/// A large rectangle through a barrel lens: its outline within .5 px of the true curve, its depth and
/// texture where each pixel's ray meets it.
#[test]
fn a_rectangle_bends_with_the_lens() {
    let size = Size::new(256, 1);
    let gradient = Arc::new(Rgb { planes: [0, 1, 2].map(|_| Plane::from_fn(size, |x, _| x as u8)) });
    let view = barrel(640, 480);
    for (label, width, height, tilt, z) in [
        ("inside the picture", 640.0, 440.0, 0.3, 600.0),
        ("past its edges", 2000.0, 1400.0, 0.9, 700.0),
        ("through the near plane", 3000.0, 3000.0, 1.3, 400.0),
    ] {
        let mut scene = scene(
            Mesh::quad(
                Vec3::ZERO,
                Vec3::X * width / 2.0,
                Vec3::Y * height / 2.0,
                Material::textured(gradient.clone()),
            ),
            Shading::Flat,
            false,
        );
        scene.light.ambient = 1.0;
        let matrix3 = DMat3::from_rotation_x(std::f64::consts::PI - tilt) * DMat3::from_rotation_z(0.1);
        let to_camera = DAffine3 { matrix3, translation: DVec3::new(5.0, 8.0, z) };
        let back = to_camera.inverse();
        let mut renderer = Renderer::new(simd::best());
        let layer = renderer.draw(&scene, &[Placed { model: 0, to_camera }], &view, EVERYTHING);
        // where the pixel's ray meets the rectangle
        let hit = |x: f64, y: f64| {
            let ray = view.lens.undistort(DVec2::new(x, y))?.extend(1.0);
            let (from, along) = (back.transform_point3(DVec3::ZERO), back.transform_vector3(ray));
            let z = -from.z / along.z;
            let at = from + along * z;
            let inside = at.x.abs() <= f64::from(width) / 2.0 && at.y.abs() <= f64::from(height) / 2.0;
            (inside && z >= view.near).then_some((z, at))
        };
        let (mut checked, mut worst_depth, mut worst_texel) = (0, 0.0f64, 0.0f64);
        for y in 0..480 {
            for x in 0..640 {
                let around: Vec<_> = [(0.0, 0.0), (0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5)]
                    .iter()
                    .map(|(dx, dy)| hit(x as f64 + dx, y as f64 + dy))
                    .collect();
                let covered = layer.depth.at(x, y) < f32::INFINITY;
                if around.iter().all(Option::is_none) {
                    assert!(!covered, "{label}: ({x},{y}) is more than .5 px outside");
                } else if around.iter().all(Option::is_some) {
                    assert!(covered, "{label}: ({x},{y}) is more than .5 px inside");
                    let Some((z, at)) = around[0] else { continue };
                    let off = |other: &Option<(f64, DVec3)>| other.map_or(0.0, |(o, _)| (o - z).abs());
                    // what half a pixel is worth here, at least float rounding
                    let half = around.iter().map(off).fold(1e-4 * z, f64::max);
                    worst_depth = worst_depth.max((f64::from(layer.depth.at(x, y)) - z).abs() / half);
                    let texel = (at.x / f64::from(width) + 0.5) * 256.0 - 0.5;
                    let step = around.iter().flatten().map(|(_, o)| (o.x - at.x).abs()).fold(0.0, f64::max);
                    if (1.0..254.0).contains(&texel) {
                        let half = step / f64::from(width) * 256.0 + 1.0;
                        let miss = (f64::from(layer.color.at(x, y)[0]) - texel).abs() / half;
                        worst_texel = worst_texel.max(miss);
                    }
                    checked += 1;
                }
            }
        }
        println!(
            "{label}: {checked} px, depth off {worst_depth:.3}, texture off {worst_texel:.3} of half a pixel"
        );
        assert!(checked > 50_000, "{label}: {checked}");
        assert!(worst_depth <= 1.0 && worst_texel <= 1.0, "{label}: {worst_depth} {worst_texel}");
    }
}

/// Every drawn teapot vertex is where the lens puts it: the nearest covered depth near the projection of
/// the model's outermost points.
#[test]
fn the_teapot_outline_follows_the_lens() {
    let view = barrel(640, 480);
    let mesh = builtin("teapot").expect("built in");
    for (dx, dy) in [(0.0, 0.0), (-170.0, -115.0), (175.0, 120.0), (-170.0, 120.0)] {
        let mut placed = turned(520.0, 20.0);
        placed.to_camera.translation = DVec3::new(dx, dy, 520.0);
        let scene = scene(mesh.clone(), Shading::Smooth, false);
        let mut renderer = Renderer::new(simd::best());
        let layer = renderer.draw(&scene, &[placed], &view, Needs::DEPTH);
        let project = |p: &Vec3| view.lens.project(placed.to_camera.transform_point3(p.as_dvec3()));
        let points: Vec<DVec2> = mesh.positions.iter().filter_map(project).collect();
        let covered = (0..480).flat_map(|y| (0..640).map(move |x| (x, y)));
        let covered: Vec<DVec2> = covered
            .filter(|&(x, y)| layer.depth.at(x, y) < f32::INFINITY)
            .map(|(x, y)| DVec2::new(x as f64, y as f64))
            .collect();
        let whole = points.iter().all(|p| p.x > 1.0 && p.y > 1.0 && p.x < 638.0 && p.y < 478.0);
        assert!(whole && covered.len() > 3000, "the view is meant to hold the whole teapot");
        for axis in [DVec2::X, DVec2::Y, DVec2::NEG_X, DVec2::NEG_Y] {
            let reach = |of: &[DVec2]| of.iter().map(|p| p.dot(axis)).fold(f64::MIN, f64::max);
            let (drawn, true_) = (reach(&covered), reach(&points));
            // the outermost covered center is up to a pixel inside the true outline
            assert!(drawn <= true_ + 0.5 && drawn >= true_ - 1.5, "{axis}: {drawn} for {true_}");
        }
    }
}

pub fn same(a: &Layer, b: &Layer) -> bool {
    a.color == b.color
        && a.depth == b.depth
        && a.normal == b.normal
        && a.depth2 == b.depth2
        && a.normal2 == b.normal2
        && a.silhouette == b.silhouette
        && a.touched == b.touched
}

#[test]
fn every_level_and_thread_count_gives_the_same_bytes() {
    let mut rng = SplitMix64::new(9);
    let toon = Shading::Toon { steps: 4, base: 0.25 };
    let texture = Arc::new(Rgb {
        planes: [0, 1, 2].map(|_| Plane::from_fn(Size::new(13, 7), |_, _| rng.next_u64() as u8)),
    });
    let mut quad = scene(
        Mesh::quad(Vec3::ZERO, Vec3::X * 450.0, Vec3::Y * 450.0, Material::textured(texture)),
        Shading::Smooth,
        false,
    );
    quad.light.ambient = 0.3;
    let mut tilted = turned(500.0, 1.0);
    tilted.model = 0;
    let views = [
        (
            "teapot",
            scene(builtin("teapot").expect("built in"), toon, false),
            turned(9.0, 1.0),
            camera(333, 250, 0.2, 99.0),
        ),
        (
            "soup",
            scene(soup(&mut rng, 800, -2.0, 20.0, 4.0), Shading::Flat, false),
            turned(3.0, 1.0),
            camera(200, 150, 0.5, 99.0),
        ),
        ("bent quad", quad, tilted, barrel(320, 240)),
    ];
    for (label, scene, placed, camera) in &views {
        let mut first: Option<Layer> = None;
        for threads in [1, 2, 4] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("test pool");
            for level in simd::available() {
                let mut renderer = Renderer::new(level);
                let layer = pool.install(|| renderer.draw(scene, &[*placed], camera, EVERYTHING).clone());
                assert!(!layer.touched.is_empty(), "{label} draws nothing");
                let equal = first.as_ref().is_none_or(|first| same(first, &layer));
                assert!(equal, "{label}: {} with {threads} threads differs", simd::name(level));
                first.get_or_insert(layer);
            }
        }
    }
}

#[test]
fn a_used_renderer_draws_like_a_new_one() {
    let teapot = scene(builtin("teapot").expect("built in"), Shading::Smooth, false);
    let mut used = Renderer::new(simd::best());
    let views =
        [(9.0, EVERYTHING), (30.0, EVERYTHING), (9.0, Needs::COLOR), (30.0, Needs::DEPTH), (4.0, EVERYTHING)];
    for (k, (distance, needs)) in views.into_iter().enumerate() {
        for view in [camera(300, 200, 0.2, 99.0), camera(301, 199, 0.2, 99.0)] {
            let mut new = Renderer::new(simd::best());
            let layer = used.draw(&teapot, &[turned(distance, 1.0)], &view, needs);
            assert!(same(layer, new.draw(&teapot, &[turned(distance, 1.0)], &view, needs)), "view {k}");
        }
    }
    let nothing = used.draw(&teapot, &[], &camera(301, 199, 0.2, 99.0), EVERYTHING);
    assert!(nothing.touched.is_empty() && nothing.depth.samples().iter().all(|&z| z == f32::INFINITY));
    assert!(nothing.color.planes[1].samples().iter().all(|&v| v == 0));
}

#[test]
fn nonsense_draws_nothing_and_never_panics() {
    let mut rng = SplitMix64::new(3);
    let mut mesh = soup(&mut rng, 50, 2.0, 9.0, 1.0);
    for (k, bad) in
        [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, 1e30, 1e-40].into_iter().enumerate()
    {
        mesh.positions[7 * k].x = bad;
        mesh.positions[9 * k + 1].z = bad;
    }
    mesh.triangles.extend([[0, 1, 999_999], [3, 3, 3], [4, 5, 4], [u32::MAX, 0, 1]]);
    mesh.normals.truncate(20);
    mesh.texcoords = vec![glam::Vec2::NAN; 3];
    mesh.material_of = vec![9; 4];
    let scene = scene(mesh, Shading::Toon { steps: 0, base: f32::NAN }, false);
    let mut renderer = Renderer::new(simd::best());
    let sizes = [(0, 0), (1, 1), (0, 5), (5, 0), (65, 3), (129, 64)];
    let placings = [DMat3::IDENTITY, DMat3::IDENTITY * f64::NAN, DMat3::ZERO, DMat3::IDENTITY * 1e200];
    for (width, height) in sizes {
        for matrix3 in placings {
            for (near, far) in
                [(0.1, 50.0), (f64::NAN, 1.0), (-1.0, 1.0), (1.0, f64::INFINITY), (1e-300, 1e300)]
            {
                let placed = [0, 7]
                    .map(|model| Placed { model, to_camera: DAffine3 { matrix3, translation: DVec3::Z } });
                let mut view = camera(width, height, near, far);
                renderer.draw(&scene, &placed, &view, EVERYTHING);
                view.lens.distortion = [-5.0, 3.0, 0.1, 0.1, 9.0, 1.0, -4.0, 2.0];
                renderer.draw(&scene, &placed, &view, EVERYTHING);
                view.lens.focal = DVec2::new(f64::NAN, 0.0);
                let layer = renderer.draw(&scene, &placed, &view, EVERYTHING);
                assert!(layer.touched.is_empty());
            }
        }
    }
}
