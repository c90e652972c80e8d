//! What breaks rasterisers: slivers, fans, extreme sizes, broken numbers, doubled faces, a million random triangles.

use super::{EVERYTHING, camera, check, compare, same, scene, soup, turned};
use glam::{DAffine3, DVec2, Vec3};
use vernissage::frame::{Layer, Needs};
use vernissage::pixels::{Plane, SplitMix64, simd};
use vernissage::render::{Camera, Placed, Renderer, reference};
use vernissage::scene::{Mesh, Shading, builtin};

const HERE: Placed = Placed { model: 0, to_camera: DAffine3::IDENTITY };

fn drawn(mesh: Mesh, placed: Placed, view: &Camera) -> Layer {
    let scene = scene(mesh, Shading::Smooth, false);
    Renderer::new(simd::best()).draw(&scene, &[placed], view, EVERYTHING).clone()
}

/// A million triangles of every size, some astride the near plane, in pictures of several sizes.
#[test]
fn a_million_random_triangles_match_the_reference() {
    let mut rng = SplitMix64::new(1_000_000);
    let (mut triangles, mut covered, mut excused) = (0, 0, 0);
    let kinds = [
        ("specks", 40_000, 5.0, 60.0, 0.05),
        ("small", 8000, 5.0, 60.0, 0.5),
        ("ordinary", 1500, 4.0, 60.0, 2.0),
        ("astride", 500, -4.0, 40.0, 3.0),
    ];
    for round in 0..20 {
        let (width, height) = [(97, 65), (160, 120), (64, 64)][round % 3];
        for (label, count, near, far, spread) in kinds {
            let mesh = soup(&mut rng, count, near, far, spread);
            let view = camera(width, height, 0.5, 100.0);
            let found = check(&format!("{label} {round}"), mesh, HERE, view, Shading::Smooth, false);
            (triangles, covered, excused) =
                (triangles + count, covered + found.covered, excused + found.excused);
        }
    }
    println!("{triangles} triangles, {covered} surfaces compared, {excused} pixels excused");
    assert!(
        triangles >= 1_000_000 && covered > excused && covered > 300_000,
        "{triangles} {covered} {excused}"
    );
}

/// Fans around a point that is a pixel center, on a grid line, or anywhere: inside, every pixel has one triangle.
#[test]
fn closed_fans_cover_every_pixel_once() {
    let mut rng = SplitMix64::new(77);
    let view = camera(97, 65, 0.1, 100.0);
    for (k, spokes) in [3usize, 4, 7, 16, 61, 200].into_iter().cycle().take(18).enumerate() {
        let hub = match k % 3 {
            0 => DVec2::new(40.0, 30.0),
            1 => DVec2::new(40.5, 31.0),
            _ => DVec2::new(20.0 + 60.0 * rng.f64(), 15.0 + 40.0 * rng.f64()),
        };
        let point = |pixel: DVec2| ((pixel - view.lens.center) / view.lens.focal).extend(1.0) * 4.0;
        let mut mesh = Mesh { positions: vec![point(hub).as_vec3()], ..Mesh::default() };
        for spoke in 0..spokes {
            let angle = (spoke as f64 + 0.8 * rng.f64()) / spokes as f64 * std::f64::consts::TAU;
            mesh.positions.push(point(hub + DVec2::from_angle(angle) * 200.0).as_vec3());
            mesh.triangles.push([0, spoke as u32 + 1, (spoke as u32 + 1) % spokes as u32 + 1]);
        }
        let mut hits = Plane::new(view.lens.size, 0u32);
        let mut renderer = Renderer::new(simd::best());
        for triangle in &mesh.triangles {
            let one = scene(Mesh { triangles: vec![*triangle], ..mesh.clone() }, Shading::Smooth, false);
            let layer = renderer.draw(&one, &[HERE], &view, Needs::DEPTH);
            for y in 0..65 {
                for x in 0..97 {
                    hits.row_mut(y)[x] += u32::from(layer.depth.at(x, y) < f32::INFINITY);
                }
            }
        }
        // three or four spokes need not go around within the picture: their outline is part of it
        let once = hits.samples().iter().filter(|&&n| n == 1).count();
        assert!(hits.samples().iter().all(|&n| n <= 1), "fan {k}: a pixel twice");
        let whole = drawn(mesh, HERE, &view);
        let seen = whole.depth.samples().iter().filter(|z| z.is_finite()).count();
        assert_eq!(once, seen, "fan {k}: all triangles at once cover what they cover singly");
        assert!(spokes < 16 || once == 97 * 65, "fan {k}: a hole");
    }
}

#[test]
fn any_unit_of_length_gives_the_same_picture() {
    for unit in [1e-6f64, 1e-3, 1e3, 1e6] {
        for (name, distance) in [("teapot", 9.0), ("spot", 3.0)] {
            let mut mesh = builtin(name).expect("built in");
            mesh.positions.iter_mut().for_each(|p| *p *= unit as f32);
            let mut placed = turned(distance * unit, 1.0);
            let view = camera(160, 120, 0.2 * unit, 100.0 * unit);
            check(&format!("{name}, unit {unit:e}"), mesh.clone(), placed, view, Shading::Smooth, false);
            // near enough to be cut
            placed.to_camera.translation *= 0.1;
            check(&format!("{name} cut, unit {unit:e}"), mesh, placed, view, Shading::Smooth, false);
        }
    }
}

#[test]
fn every_zoom_matches_the_reference() {
    for (name, distance) in [("teapot", 9.0), ("spot", 3.0)] {
        for zoom in 1..=8 {
            let distance = distance / f64::from(zoom);
            let view = camera(200, 150, 0.02 * distance, 100.0);
            let mesh = builtin(name).expect("built in");
            check(&format!("{name}, zoom {zoom}"), mesh, turned(distance, 1.0), view, Shading::Smooth, false);
        }
    }
}

#[test]
fn doubled_and_flat_faces_change_nothing() {
    let mesh = builtin("spot").expect("built in");
    let view = camera(160, 120, 0.2, 100.0);
    let plain = drawn(mesh.clone(), turned(3.0, 1.0), &view);
    let mut doubled = mesh.clone();
    doubled.triangles = mesh.triangles.iter().flat_map(|&t| [t, t]).collect();
    assert!(same(&plain, &drawn(doubled, turned(3.0, 1.0), &view)), "every face twice");
    let mut flat = mesh.clone();
    flat.triangles = mesh.triangles.iter().flat_map(|&[a, b, c]| [[a, a, b], [a, b, c], [c, c, c]]).collect();
    assert!(same(&plain, &drawn(flat, turned(3.0, 1.0), &view)), "faces without area");
}

#[test]
fn broken_corners_drop_their_triangles_alone() {
    let mesh = builtin("spot").expect("built in");
    let view = camera(160, 120, 0.2, 100.0);
    for odd in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let mut broken = mesh.clone();
        for k in (0..broken.positions.len()).step_by(97) {
            broken.positions[k][k % 3] = odd;
        }
        let is_whole = |t: &&[u32; 3]| t.iter().all(|i| i % 97 != 0);
        let rest =
            Mesh { triangles: mesh.triangles.iter().filter(is_whole).copied().collect(), ..mesh.clone() };
        assert!(rest.triangles.len() < mesh.triangles.len());
        let (broken, rest) = (drawn(broken, turned(3.0, 1.0), &view), drawn(rest, turned(3.0, 1.0), &view));
        assert!(broken.depth == rest.depth && broken.normal == rest.normal && broken.depth2 == rest.depth2);
        assert!(broken.color == rest.color);
    }
}

/// Both layers at once against each triangle drawn alone, sorted by hand: the same bits.
#[test]
fn both_layers_are_what_single_triangles_give() {
    let mut rng = SplitMix64::new(12);
    for (label, count, near, far, spread) in
        [("small", 500, 4.0, 12.0, 1.0), ("large", 60, 4.0, 20.0, 8.0), ("astride", 120, -2.0, 8.0, 3.0)]
    {
        let mesh = soup(&mut rng, count, near, far, spread);
        let view = camera(97, 65, 0.5, 100.0);
        let size = view.lens.size;
        let mut layers: Vec<[(f32, [f32; 3]); 2]> = vec![[(f32::INFINITY, [0.0; 3]); 2]; size.area()];
        let mut renderer = Renderer::new(simd::best());
        let alone = |renderer: &mut Renderer, triangle: [u32; 3]| {
            let one = scene(Mesh { triangles: vec![triangle], ..mesh.clone() }, Shading::Smooth, false);
            renderer.draw(&one, &[HERE], &view, Needs::DEPTH.and(Needs::NORMAL)).clone()
        };
        let fragments: Vec<Layer> =
            mesh.triangles.iter().map(|&triangle| alone(&mut renderer, triangle)).collect();
        for (pixel, kept) in layers.iter_mut().enumerate() {
            let (x, y) = (pixel % size.width, pixel / size.width);
            let of = |layer: &Layer| (layer.depth.at(x, y), [0, 1, 2].map(|k| layer.normal[k].at(x, y)));
            let mut all: Vec<_> = fragments.iter().map(of).filter(|(z, _)| z.is_finite()).collect();
            all.sort_by(|a, b| a.0.total_cmp(&b.0));
            let Some(&first) = all.first() else { continue };
            kept[0] = first;
            kept[1] = all.iter().copied().find(|f| f.0 > first.0).unwrap_or(kept[1]);
        }
        let both = drawn(mesh.clone(), HERE, &view);
        let mut covered = 0;
        for (pixel, [first, second]) in layers.into_iter().enumerate() {
            let (x, y) = (pixel % size.width, pixel / size.width);
            let normal = |planes: &[Plane<f32>; 3]| [0, 1, 2].map(|k| planes[k].at(x, y));
            assert_eq!((both.depth.at(x, y), normal(&both.normal)), first, "{label} ({x},{y})");
            assert_eq!((both.depth2.at(x, y), normal(&both.normal2)), second, "{label} ({x},{y})");
            covered += usize::from(second.0.is_finite());
        }
        assert!(covered > 500, "{label}: {covered} pixels have two layers");
    }
}

/// Hair-thin triangles as long as the picture, and triangles far larger than it, seen from within.
#[test]
fn needles_and_giants_match_the_reference() {
    let mut rng = SplitMix64::new(31);
    let view = Camera { far: 1e7, ..camera(160, 120, 0.5, 100.0) };
    for (label, thin, long) in [("needles", 1e-3, 1.0), ("hairs", 1e-5, 1.0), ("giants", 1.0, 1e5)] {
        let mut mesh = soup(&mut rng, 300, 3.0, 30.0, 10.0 * long);
        for t in 0..300 {
            let (a, b) = (mesh.positions[3 * t], mesh.positions[3 * t + 1]);
            let third = mesh.positions[3 * t + 2];
            mesh.positions[3 * t + 2] = a.lerp(b, 0.3) + (third - a) * thin;
        }
        let picture = reference::draw(&mesh, &HERE, &view, &vernissage::scene::Light::default(), false);
        compare(label, &drawn(mesh, HERE, &view), &picture, Shading::Smooth);
    }
    let mut far_away = soup(&mut rng, 200, 3.0, 30.0, 2.0);
    far_away.positions.iter_mut().for_each(|p| *p += Vec3::new(1e6, 0.0, 0.0));
    let layer = drawn(far_away, HERE, &view);
    assert!(layer.touched.is_empty(), "a million to the right is not in view");
}

/// Where rows and runs begin differs between the levels; what they hold must not.
#[test]
fn soups_are_the_same_bytes_at_every_level() {
    let mut rng = SplitMix64::new(404);
    let plain = Needs::COLOR.and(Needs::DEPTH);
    for round in 0..40 {
        let spread = [0.1, 0.4, 1.0, 4.0][round % 4];
        let mut mesh = soup(&mut rng, 600, 3.0, 20.0, spread);
        if round % 3 == 0 {
            mesh.colors = mesh.normals.iter().map(|n| *n * 0.5 + 0.5).collect();
        }
        let shading = if round % 5 == 0 { Shading::Flat } else { Shading::Smooth };
        let scene = scene(mesh, shading, false);
        for needs in [plain, EVERYTHING, plain.and(Needs::NORMAL)] {
            let draw = |level| {
                Renderer::new(level).draw(&scene, &[HERE], &camera(97, 65, 0.5, 100.0), needs).clone()
            };
            let layers: Vec<Layer> = simd::available().into_iter().map(draw).collect();
            assert!(layers.iter().all(|layer| same(layer, &layers[0])), "round {round}");
            assert!(!layers[0].touched.is_empty());
        }
    }
}
