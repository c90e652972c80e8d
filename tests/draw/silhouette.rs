//! Silhouettes against the method of two passes, literally: front faces fill the depth, then every edge of every back
//! face is a thick line wherever it is not behind that depth.

use super::{Picture, Placed, barrel, camera, reference, scene, turned};
use glam::DVec3;
use vernissage::frame::{Layer, Needs};
use vernissage::pixels::{Plane, Size, simd};
use vernissage::render::{Camera, Look, Renderer};
use vernissage::scene::{Mesh, Scene, Shading, builtin};

/// As the renderer has it: how far behind a surface, relative to depth, still counts as on it.
const TOLERANCE: f64 = 1e-3;

fn look(line_width: f64) -> Look {
    Look { line_width, ..Needs::DEPTH.and(Needs::SILHOUETTE).into() }
}

/// Marks the pixels of one OpenGL line from `a` to `b` (x, y in px, 1/z), `width` px thick, that the depth lets through.
fn line(a: DVec3, b: DVec3, width: f64, far: f64, picture: &Picture, out: &mut Plane<u8>) {
    let size = out.size();
    let along_x = (b.x - a.x).abs() >= (b.y - a.y).abs();
    let turn = |p: DVec3| if along_x { p } else { DVec3::new(p.y, p.x, p.z) };
    let (a, b) = (turn(a), turn(b));
    let (a, b) = if a.x <= b.x { (a, b) } else { (b, a) };
    let (columns, rows) = if along_x { (size.width, size.height) } else { (size.height, size.width) };
    for column in (0..columns).filter(|&x| a.x <= x as f64 && (x as f64) < b.x) {
        let at = a + (b - a) * ((column as f64 - a.x) / (b.x - a.x));
        let across = |&y: &usize| at.y - width / 2.0 <= y as f64 && (y as f64) < at.y + width / 2.0;
        for row in (0..rows).filter(across) {
            let (x, y) = if along_x { (column, row) } else { (row, column) };
            let surface = picture.fragments[y * size.width + x].first().map_or(f64::INFINITY, |f| f.depth);
            if at.z >= 1.0 / far && 1.0 / at.z <= surface * (1.0 + TOLERANCE) {
                out.row_mut(y)[x] = 255;
            }
        }
    }
}

/// Both passes over one mesh that lies between the near and the far plane, undistorted.
fn two_passes(scene: &Scene, placed: &Placed, view: &Camera, width: f64) -> Plane<u8> {
    let mesh = &scene.models[0].mesh;
    let picture = reference::draw(mesh, placed, view, &scene.light, true);
    let mut out = Plane::new(view.lens.size, 0);
    for triangle in &mesh.triangles {
        let corners = triangle.map(|i| {
            let p = placed.to_camera.transform_point3(mesh.positions[i as usize].as_dvec3());
            (view.lens.focal * p.truncate() / p.z + view.lens.center).extend(1.0 / p.z)
        });
        let [a, b, c] = corners.map(|p| (p * 256.0 + 0.5).floor());
        let back = (b.x - a.x) * (c.y - a.y) - (c.x - a.x) * (b.y - a.y) >= 0.0;
        for k in (0..3).filter(|_| back) {
            line(corners[k], corners[(k + 1) % 3], width, view.far, &picture, &mut out);
        }
    }
    out
}

fn drawn(scene: &Scene, placed: &Placed, view: &Camera, width: f64) -> Layer {
    Renderer::new(simd::best()).draw(scene, &[*placed], view, look(width)).clone()
}

/// Pixels that differ, and lines' pixels in the second.
fn differing(found: &Plane<u8>, truth: &Plane<u8>) -> (usize, usize) {
    let pairs = || found.rows().flatten().zip(truth.rows().flatten());
    (pairs().filter(|(a, b)| a != b).count(), truth.rows().flatten().filter(|&&v| v == 255).count())
}

fn model(name: &str) -> Scene {
    scene(builtin(name).expect("built in"), Shading::Smooth, false)
}

#[test]
fn the_open_teapot_is_drawn_as_two_passes_would() {
    let teapot = model("teapot");
    for (distance, width) in [(9.0, 3.0), (14.0, 1.0), (7.0, 16.0)] {
        let view = camera(320, 240, 0.2, 100.0);
        let placed = turned(distance, 1.0);
        let truth = two_passes(&teapot, &placed, &view, width);
        let (off, lines) = differing(&drawn(&teapot, &placed, &view, width).silhouette, &truth);
        println!("teapot at {distance}, {width} px: {off} of {lines} line pixels differ");
        // depth rounded to f32, seen at the tolerance's very edge
        assert!(lines > 150 && off * 1000 <= lines, "{off} of {lines} differ");
    }
}

/// The contour of a closed mesh has the lines of two passes but for the hidden edges' thickness: an edge between two
/// backs that ends on or near the outline, steeper than it, sticks out beside it by up to half a line's width.
#[test]
fn the_contour_of_a_closed_mesh_has_the_lines_of_two_passes() {
    let spot = model("spot");
    for (distance, width, bound) in [(3.0, 3.0, 0.12), (3.0, 1.0, 0.12), (2.0, 3.0, 0.12), (2.0, 8.0, 0.12)] {
        let view = camera(320, 240, 0.2, 100.0);
        let placed = turned(distance, 1.0);
        let truth = two_passes(&spot, &placed, &view, width);
        let found = drawn(&spot, &placed, &view, width);
        let (off, lines) = differing(&found.silhouette, &truth);
        let all = (0..320 * 240).map(|i| (i % 320, i / 320));
        let only_found = all.filter(|&(x, y)| found.silhouette.at(x, y) > truth.at(x, y)).count();
        println!("spot at {distance}, {width} px: {off} of {lines} line pixels differ, {only_found} added");
        assert!(only_found * 1000 <= lines, "contour edges are among the backs' edges: {only_found} added");
        assert!(lines > 300 && off as f64 <= bound * lines as f64, "{off} of {lines} differ");
    }
}

#[test]
fn lines_reach_tiles_that_no_surface_touches_and_are_wiped() {
    let teapot = model("teapot");
    let view = camera(640, 480, 0.2, 100.0);
    let mut renderer = Renderer::new(simd::best());
    let mut beyond = 0;
    for step in 0..12 {
        let mut placed = turned(12.0, 1.0);
        placed.to_camera.translation.x += 0.11 * f64::from(step) - 0.5;
        let layer = renderer.draw(&teapot, &[placed], &view, look(16.0));
        let fresh = drawn(&teapot, &placed, &view, 16.0);
        assert!(layer.silhouette == fresh.silhouette && layer.touched == fresh.touched, "step {step}");
        let grid = layer.grid.expect("drawn");
        for tile in 0..grid.count() {
            let area = grid.rect(tile);
            let pixels = || (area.y0..area.y1).flat_map(|y| (area.x0..area.x1).map(move |x| (x, y)));
            let covered = pixels().any(|(x, y)| layer.depth.at(x, y) < f32::INFINITY);
            let lined = pixels().any(|(x, y)| layer.silhouette.at(x, y) > 0);
            assert_eq!(layer.touched.contains(tile), covered || lined, "step {step}, tile {tile}");
            beyond += usize::from(lined && !covered);
        }
    }
    assert!(beyond > 0, "no step put a line alone into a tile");
    let nothing = renderer.draw(&teapot, &[], &view, look(16.0));
    assert!(nothing.touched.is_empty() && nothing.silhouette.samples().iter().all(|&v| v == 0));
}

#[test]
fn the_same_lines_everywhere_whatever_cuts_or_bends_them() {
    let mut mirrored = turned(3.0, 1.0);
    mirrored.to_camera.matrix3.x_axis *= -1.0;
    let mut far_off = turned(520.0, 120.0);
    far_off.to_camera.translation = DVec3::new(-170.0, -115.0, 520.0);
    let close = Camera { near: 2.9, ..camera(200, 150, 0.2, 3.2) };
    for (name, placed, view) in [
        ("spot", turned(3.0, 1.0), camera(333, 250, 0.2, 99.0)),
        ("spot", mirrored, camera(97, 65, 0.2, 99.0)),
        ("spot", turned(3.0, 1.0), close),
        ("teapot", turned(1.0, 1.0), camera(160, 120, 0.2, 99.0)),
        ("spot", far_off, barrel(320, 240)),
        ("spot", turned(3.0, 1.0), camera(1, 1, 0.2, 99.0)),
    ] {
        let scene = model(name);
        let mut first: Option<Layer> = None;
        for threads in [1, 2, 4] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("test pool");
            for level in simd::available() {
                let layer =
                    pool.install(|| Renderer::new(level).draw(&scene, &[placed], &view, look(3.0)).clone());
                let lines = layer.silhouette.samples().iter().filter(|&&v| v > 0).count();
                assert!(lines > 40 || view.lens.size == Size::new(1, 1), "{name}: {lines}");
                let first = first.get_or_insert_with(|| layer.clone());
                assert!(super::same(first, &layer), "{name}: {} with {threads} differs", simd::name(level));
            }
        }
    }
}

/// Lines cut by the near plane and split by the lens lie where uncut, straight ones lie.
#[test]
fn cut_and_split_lines_stay_in_place() {
    let quad = |half: f32| Mesh {
        positions: [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(x, y)| glam::Vec3::new(half * x, half * y, 0.0))
            .into(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..Mesh::default()
    };
    let scene = scene(quad(100.0), Shading::Smooth, false);
    let placed = Placed { model: 0, to_camera: glam::DAffine3::from_translation(DVec3::Z * 500.0) };
    let view = barrel(320, 240);
    let layer = drawn(&scene, &placed, &view, 3.0);
    let mut checked = 0;
    for k in 0..200 {
        let along = f64::from(k) - 100.0;
        for point in [DVec3::new(along, 100.0, 500.0), DVec3::new(-100.0, along, 500.0)] {
            let px = view.lens.project(point).expect("in front");
            let (x, y) = ((px.x + 0.5) as usize, (px.y + 0.5) as usize);
            assert_eq!(layer.silhouette.at(x, y), 255, "({x}, {y})");
            checked += 1;
        }
    }
    assert_eq!(checked, 400);
}
