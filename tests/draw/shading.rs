//! What surfaces show beside intensity: textures past their edges, vertex colors, no light at all; and phantoms.

use super::{EVERYTHING, camera, same, scene, turned};
use glam::{DAffine3, DVec2, DVec3, Vec2, Vec3};
use std::sync::Arc;
use vernissage::frame::{Layer, Needs};
use vernissage::pixels::{Plane, Rgb, Size, SplitMix64, simd};
use vernissage::render::{Camera, Placed, Renderer};
use vernissage::scene::{Light, Material, Mesh, Scene, Shading, Wrap, builtin};

const HERE: Placed = Placed { model: 0, to_camera: DAffine3::IDENTITY };

fn draw(scene: &Scene, placed: &[Placed], view: &Camera) -> Layer {
    Renderer::new(simd::best()).draw(scene, placed, view, EVERYTHING).clone()
}

/// A tilted square before the camera, texture coordinates from -2 to 3 across it.
fn square(material: Material) -> Mesh {
    let corners = [(-4.0, -3.0), (4.0, -3.0), (4.0, 3.0), (-4.0, 3.0)];
    let at = |(x, y): (f32, f32)| Vec3::new(x, y, 9.0 + 0.4 * x - 0.3 * y);
    Mesh {
        positions: corners.map(at).into(),
        normals: vec![Vec3::NEG_Z; 4],
        texcoords: corners.map(|(x, y)| Vec2::new(x / 8.0 + 0.5, y / 6.0 + 0.5) * 5.0 - 2.0).into(),
        // seen counter-clockwise
        triangles: vec![[0, 2, 1], [0, 3, 2]],
        material_of: vec![0; 2],
        materials: vec![material],
        ..Mesh::default()
    }
}

/// The point of the square's plane that a pixel shows.
fn hit(view: &Camera, x: usize, y: usize) -> DVec3 {
    let ray = ((DVec2::new(x as f64, y as f64) - view.lens.center) / view.lens.focal).extend(1.0);
    // z = 9 + .4 x - .3 y
    ray * (9.0 / (1.0 - 0.4 * ray.x + 0.3 * ray.y))
}

/// Plainly: the texel at whole coordinates by the wrap rule, then bilinear.
fn plain_sample(texture: &Plane<u8>, wrap: [Wrap; 2], uv: DVec2) -> f64 {
    let size = texture.size();
    let index = |wrap: Wrap, i: i64, n: i64| match wrap {
        Wrap::Repeat => i.rem_euclid(n),
        Wrap::Mirror => {
            let k = i.rem_euclid(2 * n);
            if k < n { k } else { 2 * n - 1 - k }
        }
        Wrap::Clamp => i.clamp(0, n - 1),
    };
    let (x, y) = (uv.x * size.width as f64 - 0.5, (1.0 - uv.y) * size.height as f64 - 0.5);
    let (x0, y0) = (x.floor(), y.floor());
    let texel = |dx: i64, dy: i64| {
        let i = index(wrap[0], x0 as i64 + dx, size.width as i64);
        let j = index(wrap[1], y0 as i64 + dy, size.height as i64);
        f64::from(texture.at(i as usize, j as usize))
    };
    let (fx, fy) = (x - x0, y - y0);
    (texel(0, 0) * (1.0 - fx) + texel(1, 0) * fx) * (1.0 - fy)
        + (texel(0, 1) * (1.0 - fx) + texel(1, 1) * fx) * fy
}

#[test]
fn textures_go_on_past_their_edges_as_told() {
    let mut rng = SplitMix64::new(6);
    // smooth enough that float rounding of a coordinate is far below a level
    let values: Vec<u8> = (0..35).map(|_| 100 + rng.int(0, 40) as u8).collect();
    let plane = Plane::from_fn(Size::new(7, 5), |x, y| values[y * 7 + x]);
    let texture = Arc::new(Rgb { planes: [plane.clone(), plane.clone(), plane.clone()] });
    let view = camera(160, 120, 0.5, 99.0);
    let wraps = [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp];
    for wrap in wraps.iter().flat_map(|&a| wraps.map(|b| [a, b])) {
        let material = Material { wrap, unlit: true, ..Material::textured(texture.clone()) };
        let layer = draw(&scene(square(material), Shading::Smooth, false), &[HERE], &view);
        let (mut worst, mut checked) = (0.0f64, 0);
        for y in 0..120 {
            for x in 0..160 {
                if layer.depth.at(x, y).is_finite() {
                    let at = hit(&view, x, y);
                    let uv = (DVec2::new(at.x / 8.0, at.y / 6.0) + 0.5) * 5.0 - 2.0;
                    let expected = plain_sample(&plane, wrap, uv);
                    worst = worst.max((f64::from(layer.color.at(x, y)[0]) - expected).abs());
                    checked += 1;
                }
            }
        }
        println!("{wrap:?}: {checked} px, off by {worst:.3}");
        assert!(checked > 5000 && worst <= 1.0, "{wrap:?}: {checked} px, off by {worst}");
    }
}

#[test]
fn vertex_colors_multiply_and_unlit_ignores_light() {
    let view = camera(160, 120, 0.5, 99.0);
    let base = Vec3::new(0.9, 0.5, 0.25);
    for unlit in [false, true] {
        let mut mesh = square(Material { unlit, ..Material::plain(base) });
        let of = |p: &Vec3| Vec3::new(p.x / 8.0 + 0.5, p.y / 6.0 + 0.5, 1.0 - p.x / 8.0 - 0.5);
        mesh.colors = mesh.positions.iter().map(of).collect();
        let mut scene = scene(mesh, Shading::Smooth, false);
        scene.light = Light { ambient: 0.2, ..Light::default() };
        let intensity = f64::from(-scene.light.direction.z);
        let light = if unlit { 1.0 } else { 0.2 + 0.8 * intensity };
        let layer = draw(&scene, &[HERE], &view);
        let mut checked = 0;
        for y in 0..120 {
            for x in 0..160 {
                if layer.depth.at(x, y).is_finite() {
                    let expected = of(&hit(&view, x, y).as_vec3()) * base * light as f32 * 255.0;
                    for (value, expected) in layer.color.at(x, y).into_iter().zip(expected.to_array()) {
                        assert!((f32::from(value) - expected).abs() <= 1.0, "({x},{y}) {value} {expected}");
                    }
                    checked += 1;
                }
            }
        }
        assert!(checked > 5000);
    }
}

/// Two materials in one picture: each pixel has its own.
#[test]
fn every_pixel_is_of_its_surface() {
    let mut mesh = square(Material::plain(Vec3::X));
    mesh.materials.push(Material { unlit: true, ..Material::plain(Vec3::Y) });
    mesh.material_of = vec![0, 1];
    let view = camera(160, 120, 0.5, 99.0);
    let layer = draw(&scene(mesh, Shading::Flat, false), &[HERE], &view);
    let (mut red, mut green) = (0, 0);
    for (x, y) in (0..120).flat_map(|y| (0..160).map(move |x| (x, y))) {
        match layer.color.at(x, y) {
            [0, 0, 0] => assert!(layer.depth.at(x, y).is_infinite()),
            [r, 0, 0] if r < 255 => red += 1,
            [0, 255, 0] => green += 1,
            odd => panic!("({x},{y}) is {odd:?}"),
        }
    }
    assert!(red > 2000 && green > 2000, "{red} {green}");
}

#[test]
fn phantoms_hide_and_are_not_seen() {
    let spot = builtin("spot").expect("built in");
    let mut both = scene(spot, Shading::Smooth, false);
    let mut phantom = scene(square(Material::plain(Vec3::ONE)), Shading::Smooth, false).models.remove(0);
    phantom.phantom = true;
    both.models.push(phantom.clone());
    let view = camera(160, 120, 0.2, 99.0);
    let model = turned(9.6, 2.5);
    // the square cuts through the model; drawn alone it tells where
    let wall = Placed { model: 1, ..HERE };
    let alone = draw(&both, &[model], &view);
    let mut seen = both.clone();
    seen.models[1].phantom = false;
    let square = draw(&seen, &[wall], &view);
    for placed in [[model, wall], [wall, model]] {
        let layer = draw(&both, &placed, &view);
        let (mut hidden, mut shown, mut behind) = (0, 0, 0);
        for (x, y) in (0..120).flat_map(|y| (0..160).map(move |x| (x, y))) {
            let wall = square.depth.at(x, y);
            let kept = |z: f32| if z < wall { z } else { f32::INFINITY };
            let first = kept(alone.depth.at(x, y));
            assert_eq!(layer.depth.at(x, y), first, "({x},{y})");
            assert_eq!(layer.depth2.at(x, y), kept(alone.depth2.at(x, y)), "({x},{y})");
            let color = if first.is_finite() { alone.color.at(x, y) } else { [0; 3] };
            assert_eq!(layer.color.at(x, y), color, "({x},{y})");
            shown += usize::from(first.is_finite());
            hidden += usize::from(first.is_infinite() && alone.depth.at(x, y).is_finite());
            behind += usize::from(layer.depth2.at(x, y) != alone.depth2.at(x, y));
        }
        assert!(hidden > 300 && shown > 300 && behind > hidden, "{hidden} {shown} {behind}");
    }
    let nothing = draw(&both, &[wall], &view);
    assert!(nothing.touched.is_empty(), "a phantom alone touches nothing");
}

#[test]
fn phantoms_hide_outlines_too() {
    let mut both = scene(builtin("spot").expect("built in"), Shading::Smooth, false);
    let mut wall = both.models[0].clone();
    wall.mesh = square(Material::plain(Vec3::ONE)).into();
    wall.phantom = true;
    both.models.push(wall);
    let view = camera(160, 120, 0.2, 99.0);
    let look = vernissage::render::Look { line_width: 2.0, ..Needs::COLOR.and(Needs::SILHOUETTE).into() };
    let lines = |distance: f64, placed: &[Placed]| {
        let mut placed = placed.to_vec();
        placed.push(turned(distance, 1.0));
        let layer = Renderer::new(simd::best()).draw(&both, &placed, &view, look).clone();
        layer.silhouette.samples().iter().filter(|&&v| v > 0).count()
    };
    let wall = Placed { model: 1, ..HERE };
    assert!(lines(20.0, &[]) > 50, "far behind, but nothing before it");
    assert_eq!(lines(20.0, &[wall]), 0, "behind the phantom");
    assert_eq!(lines(4.0, &[]), lines(4.0, &[wall]), "before the phantom");
}

#[test]
fn drawing_twice_the_same_model_is_drawing_two() {
    let one = scene(builtin("spot").expect("built in"), Shading::Smooth, false);
    let mut two = one.clone();
    two.models.push(one.models[0].clone());
    let (a, mut b) = (turned(4.0, 1.0), turned(5.0, 1.0));
    b.to_camera.translation.x -= 0.8;
    let view = camera(160, 120, 0.2, 99.0);
    let instances = draw(&one, &[a, b], &view);
    assert!(same(&instances, &draw(&two, &[a, Placed { model: 1, ..b }], &view)));
}
