//! Models in view, style by style: what each asks of the renderer, and its canvas against plain f64 references.
//!
//! The layer itself is held to its references in `tests/draw`.

use clap::ValueEnum;
use glam::{DAffine3, DMat3, DVec3, Vec3};
use std::path::Path;
use vernissage::frame::{Frame, Layer, Needs};
use vernissage::geometry::Lens;
use vernissage::marker::Family;
use vernissage::pixels::simd::{self, Level};
use vernissage::pixels::{Plane, Rgb, Size, picture};
use vernissage::render::{Camera, Placed, Renderer};
use vernissage::scene::{Anchor, Light, Mesh, Model, Scene, Shading, builtin};
use vernissage::style::{self, StyleInput, StyleName, Styler, illustrative};

/// A photograph, repeated to the size.
fn frame(size: Size) -> Frame {
    let path = "tests/data/filters/micro_coffee_160x120.png";
    let photo = picture::read(&Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).expect("test picture");
    let planes = [0, 1, 2].map(|c| Plane::from_fn(size, |x, y| photo.planes[c].at(x % 160, y % 120)));
    Frame { luma: Plane::new(size, 0), color: Rgb { planes }, ..Frame::default() }
}

fn model(mesh: Mesh, secondary: bool) -> Model {
    Model {
        name: "test".into(),
        mesh: mesh.into(),
        anchor: Anchor { family: Family::Tag36h11, id: None, side_mm: 80.0 },
        to_marker: DAffine3::IDENTITY,
        shading: Shading::Smooth,
        cull_back: false,
        secondary,
        phantom: false,
    }
}

/// A box around the origin with a normal to each face.
fn cuboid(half: Vec3) -> Mesh {
    let mut mesh = Mesh::default();
    for (normal, u) in [(Vec3::X, Vec3::Y), (Vec3::Y, Vec3::Z), (Vec3::Z, Vec3::X)] {
        for side in [1.0, -1.0] {
            let (normal, v) = (normal * side, normal.cross(u) * side);
            let first = mesh.positions.len() as u32;
            for (s, t) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                mesh.positions.push((normal + u * s + v * t) * half);
                mesh.normals.push(normal);
            }
            mesh.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        }
    }
    mesh
}

/// The teapot, and a long box through it that sticks out in front and behind.
fn scene() -> Scene {
    let teapot = builtin("teapot").expect("built in");
    let light = Light { ambient: 0.25, ..Light::default() };
    let inside = cuboid(Vec3::new(0.5, 0.4, 3.0));
    Scene { models: vec![model(teapot, false), model(inside, true)], light, ..Scene::default() }
}

fn placed(models: &[usize]) -> Vec<Placed> {
    let turn = DMat3::from_rotation_y(0.5) * DMat3::from_rotation_x(2.7);
    let middle = DAffine3 { matrix3: turn, translation: DVec3::new(0.4, 0.3, 10.0) };
    let up = DAffine3::from_translation(DVec3::new(0.0, 1.5, 0.0));
    let of = |&model| Placed { model, to_camera: if model == 0 { middle } else { middle * up } };
    models.iter().map(of).collect()
}

fn camera(size: Size) -> Camera {
    Camera { lens: Lens::guess(size), near: 0.2, far: 100.0 }
}

fn named(name: StyleName) -> style::Config {
    style::Config { name, ..Default::default() }
}

/// The layer that the style asks for, and the canvas it makes of it.
fn drawn(config: &style::Config, models: &[usize], size: Size, level: Level) -> (Layer, Rgb) {
    let (mut styler, mut renderer, mut out) =
        (Styler::new(config, level), Renderer::new(level), Rgb::default());
    let layer = renderer.draw(&scene(), &placed(models), &camera(size), styler.look());
    styler.draw(StyleInput { frame: &frame(size), layer: Some(layer) }, &mut out);
    (layer.clone(), out)
}

fn pixels(size: Size) -> impl Iterator<Item = (usize, usize)> {
    (0..size.area()).map(move |i| (i % size.width, i / size.width))
}

const SIZES: [Size; 2] = [Size::new(320, 240), Size::new(171, 99)];

#[test]
fn toon_models_and_black_silhouettes_lie_over_the_cartoon_picture() {
    for size in SIZES {
        let config = named(StyleName::BilateralCartoon);
        let (layer, out) = drawn(&config, &[0], size, simd::best());
        let filtered = style::reference(&config, &frame(size).color);
        // contracts' levels under a quarter of ambient light
        let ramp = [0.25, 0.5, 0.75, 1.0].map(|step: f64| (255.0 * (0.25 + 0.75 * step) + 0.5) as u8);
        let mut counts = [0; 3];
        for (x, y) in pixels(size) {
            let (line, covered) = (layer.silhouette.at(x, y) > 0, layer.depth.at(x, y) < f32::INFINITY);
            let (color, beneath) = (out.at(x, y), filtered.at(x, y));
            if line {
                assert_eq!(color, [0; 3], "({x}, {y})");
                counts[0] += 1;
            } else if covered {
                assert!(ramp.contains(&color[0]) && color == layer.color.at(x, y), "({x}, {y}): {color:?}");
                counts[1] += 1;
            } else {
                assert!((0..3).all(|c| color[c].abs_diff(beneath[c]) <= 1), "({x}, {y}): {color:?}");
                counts[2] += 1;
            }
        }
        assert!(counts.iter().all(|&n| n > 300), "{size}: {counts:?}");
    }
}

#[test]
fn white_models_with_black_silhouettes_lie_over_the_sketch() {
    for size in SIZES {
        let config = named(StyleName::SketchLike);
        let (layer, out) = drawn(&config, &[0], size, simd::best());
        assert_eq!(layer.color.size(), Size::new(0, 0), "no color is drawn for nothing");
        let filtered = style::reference(&config, &frame(size).color);
        for (x, y) in pixels(size) {
            let covered = layer.depth.at(x, y) < f32::INFINITY;
            let beneath = if covered { [255; 3] } else { filtered.at(x, y) };
            let expected = if layer.silhouette.at(x, y) > 0 { [0; 3] } else { beneath };
            assert_eq!(out.at(x, y), expected, "({x}, {y})");
        }
    }
}

#[test]
fn line_width_and_toon_settings_reach_the_renderer() {
    let mut config = named(StyleName::BilateralCartoon);
    for (key, value) in [("toon_steps", "2"), ("toon_base", "0.5"), ("line_width", "8")] {
        config.set(key, value).expect(key);
    }
    let look = Styler::new(&config, simd::best()).look();
    assert_eq!(look.shading, Some(Shading::Toon { steps: 2, base: 0.5 }));
    assert_eq!((look.line_width, look.needs), (8.0, Needs::COLOR.and(Needs::SILHOUETTE)));
    for (style, key, value) in [
        (StyleName::BilateralCartoon, "toon_steps", "1"),
        (StyleName::BilateralCartoon, "toon_base", "1.5"),
        (StyleName::BilateralCartoon, "line_width", "17"),
        (StyleName::SketchLike, "line_width", "0.5"),
        (StyleName::Illustrative, "alpha_layer", "1.1"),
        (StyleName::Illustrative, "beta_layer", "0.8"),
        (StyleName::Illustrative, "normal_threshold", "5"),
        (StyleName::Illustrative, "depth_threshold", "nan"),
        (StyleName::Illustrative, "depth_fit", "0"),
        (StyleName::Illustrative, "secondary_red", "-1"),
    ] {
        let error = named(style).set(key, value).expect_err(key).to_string();
        assert!(error.contains(key) && error.contains(style.name()), "{error}");
    }
}

#[test]
fn watercolor_paints_three_tones() {
    let size = SIZES[0];
    let config = named(StyleName::Watercolor);
    let (layer, out) = drawn(&config, &[0], size, simd::best());
    let mut augmented = frame(size).color;
    let mut seen = std::collections::BTreeSet::new();
    for (x, y) in pixels(size).filter(|&(x, y)| layer.depth.at(x, y) < f32::INFINITY) {
        augmented.set(x, y, layer.color.at(x, y));
        seen.insert(layer.color.at(x, y));
    }
    assert_eq!(seen.into_iter().collect::<Vec<_>>(), [[26; 3], [102; 3], [255; 3]], "no ambient light");
    let expected = style::reference(&config, &augmented);
    let off = pixels(size).filter(|&(x, y)| {
        let (a, b) = (out.at(x, y), expected.at(x, y));
        (0..3).any(|c| a[c].abs_diff(b[c]) > 1)
    });
    assert_eq!(off.count(), 0);
}

/// The references around a setting: pixels on which they disagree are too close to a threshold to call.
fn references(config: &illustrative::Config, size: Size, layer: &Layer) -> Vec<Rgb> {
    let camera = frame(size).color;
    let draw = |change: &dyn Fn(&mut illustrative::Config, &mut Layer)| {
        let (mut config, mut layer) = (*config, layer.clone());
        change(&mut config, &mut layer);
        illustrative::reference_with(&config, &camera, &layer)
    };
    let mut all = vec![draw(&|_, _| ())];
    for sign in [-1.0, 1.0] {
        let hair = 5e-5 * sign;
        all.push(draw(&|c, _| c.depth_threshold += hair));
        all.push(draw(&|c, _| c.normal_threshold += hair));
        all.push(draw(&|c, _| c.edge_threshold += hair));
        all.push(draw(&|c, _| c.gamma += 2.0 * hair));
        all.push(draw(&|c, _| c.theta += f64::from(2.0 * hair)));
        all.push(draw(&|_, layer| layer.light *= 1.0 + 2.0 * hair));
    }
    all
}

#[test]
fn the_illustrative_object_side_matches_the_reference() {
    for size in SIZES {
        for (models, settings) in [
            (&[0, 1][..], &[][..]),
            (&[0, 1], &[("depth_fit", "1"), ("depth_threshold", "0.05"), ("normal_threshold", "3.5")]),
            (&[0], &[("depth_fit", "1")]),
            (&[1], &[("depth_fit", "0.5"), ("normal_threshold", "-4")]),
        ] {
            let mut config = named(StyleName::Illustrative);
            for (key, value) in settings {
                config.set(key, value).expect(key);
            }
            let (layer, out) = drawn(&config, models, size, simd::best());
            let all = references(&config.illustrative, size, &layer);
            let (mut flips, mut unclear, mut object, mut inside) = (0, 0, 0, 0);
            for (x, y) in pixels(size) {
                let secondary = layer.secondary.as_ref().expect("the style asks for it");
                let [z1, zs] = [&layer.depth, &secondary.depth].map(|plane| plane.at(x, y));
                object += usize::from(z1 < f32::INFINITY);
                inside += usize::from(zs < f32::INFINITY);
                let far = |a: [u8; 3], b: [u8; 3]| (0..3).any(|c| a[c].abs_diff(b[c]) > 1);
                if all.iter().any(|other| far(other.at(x, y), all[0].at(x, y))) {
                    unclear += 1;
                } else if far(out.at(x, y), all[0].at(x, y)) {
                    flips += 1;
                }
            }
            println!(
                "{size} {models:?} {settings:?}: {flips} flips, {unclear} unclear, {object} + {inside} px"
            );
            assert_eq!(flips, 0, "{size} {models:?} {settings:?}");
            assert_eq!((object > 1000, inside > 300), (models.contains(&0), models.contains(&1)));
            assert!(unclear * 50 < size.area(), "{unclear} of {size}");
        }
    }
}

/// Eq. 4.2 and 4.10 on single pixels: full, behind one surface, behind two, behind a line of the second.
#[test]
fn secondary_geometry_fades_behind_surfaces() {
    let size = Size::new(70, 3);
    let plane = |value: f32| Plane::new(size, value);
    let facing = || [plane(0.0), plane(0.0), plane(-1.0)];
    let grid = vernissage::pixels::TileGrid::new(size);
    let mut touched = vernissage::pixels::TileSet::new(grid);
    touched.insert(1);
    let config = illustrative::Config::default();
    let mut styler = Styler::new(&named(StyleName::Illustrative), simd::best());
    // depth of the secondary model, cosines of its light, of the second surface's normals → share of its color
    for (z, second_is_rough, share) in
        [(1.0, false, 1.0), (3.0, false, 0.7), (5.0, false, 0.21), (5.0, true, 0.0)]
    {
        let secondary = Layer { depth: plane(z), normal: facing(), ..Layer::default() };
        let layer = Layer {
            depth: plane(2.0),
            normal: facing(),
            depth2: plane(4.0),
            normal2: if second_is_rough { [plane(0.0), plane(0.0), plane(0.0)] } else { facing() },
            light: Vec3::NEG_Z,
            extent: [2.0, 4.0],
            secondary: Some(Box::new(secondary)),
            touched: touched.clone(),
            grid: Some(grid),
            ..Layer::default()
        };
        let mut out = Rgb::default();
        styler.draw(StyleInput { frame: &frame(size), layer: Some(&layer) }, &mut out);
        let paper = [config.paper_red, config.paper_green, config.paper_blue];
        let back = [config.back_layer_red, config.back_layer_green, config.back_layer_blue];
        let own = [config.secondary_red, config.secondary_green, config.secondary_blue];
        let ground = if second_is_rough { back } else { paper };
        for c in 0..3 {
            let expected = (255.0 * (ground[c] * (1.0 - share) + own[c] * share) + 0.5) as u8;
            assert_eq!(out.planes[c].at(66, 1), expected, "secondary geometry at {z}, channel {c}");
        }
    }
}

#[test]
fn nothing_in_view_is_the_picture_alone() {
    let size = SIZES[1];
    for &name in StyleName::value_variants() {
        let mut alone = Rgb::default();
        let frame = frame(size);
        Styler::new(&named(name), simd::best()).draw(StyleInput { frame: &frame, layer: None }, &mut alone);
        assert!(drawn(&named(name), &[], size, simd::best()).1 == alone, "{name}");
    }
}

#[test]
fn the_same_bytes_for_every_level_and_thread_count() {
    for &name in StyleName::value_variants() {
        for size in [SIZES[0], SIZES[1], Size::new(1, 1), Size::new(16, 16), Size::new(65, 129)] {
            let mut first: Option<Rgb> = None;
            for threads in [1, 2, 4] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
                for level in simd::available() {
                    let out = pool.install(|| drawn(&named(name), &[0, 1], size, level).1);
                    let first = first.get_or_insert_with(|| out.clone());
                    assert!(*first == out, "{name} {size}: {} with {threads} differs", simd::name(level));
                }
            }
        }
    }
}

#[test]
fn secondary_models_are_apart_only_where_that_is_asked_for() {
    let size = SIZES[0];
    let mut renderer = Renderer::new(simd::best());
    let view = camera(size);
    let apart = Needs::NORMAL.and(Needs::SECONDARY);
    for (needs, models) in [
        (Needs::COLOR, &[0, 1][..]),
        (apart, &[0, 1]),
        (apart, &[1]),
        (apart, &[0, 1]),
        (Needs::NORMAL, &[1]),
    ] {
        let layer = renderer.draw(&scene(), &placed(models), &view, needs).clone();
        let alone = |models: &[usize]| {
            Renderer::new(simd::best()).draw(&scene(), &placed(models), &view, Needs::NORMAL).clone()
        };
        match &layer.secondary {
            Some(secondary) => {
                let (outer, inner) = (alone(&models[..models.len() - 1]), alone(&[1]));
                assert!(needs.includes(Needs::SECONDARY) && layer.depth == outer.depth);
                assert!(secondary.depth == inner.depth && secondary.normal == inner.normal);
                let mut both = outer.touched.clone();
                both.union(&inner.touched);
                assert_eq!(layer.touched, both);
            }
            None => assert!(!needs.includes(Needs::SECONDARY) && layer.depth == alone(models).depth),
        }
    }
}
