//! The pointillism style against an independent f64 reference and its own, with grid and brush fed in, and models as
//! particles against plain f64.
//!
//! The 160x120 frames and their stages are in `tests/data/filters`. The full set of frames is checked when
//! `VERNISSAGE_REFERENCE` names the folder that holds `filters/inputs` and `filters/outputs`.

mod common;

use common::{FRAMES, data, frame, frame_of, stage, text};
use glam::{DAffine3, DMat3, DVec3, Vec2, Vec3};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use vernissage::frame::{Frame, Layer, Needs, Particle};
use vernissage::geometry::Lens;
use vernissage::marker::Family;
use vernissage::pixels::{Plane, Rgb, Size, SplitMix64, picture, simd};
use vernissage::render::{Camera, Placed, Renderer, Scatter};
use vernissage::scene::{Anchor, Light, Material, Mesh, Model, Scene, Shading, builtin};
use vernissage::style::pointillism::{Pointillism, reference_with_models};
use vernissage::style::{self, StyleInput, StyleName, Styler};

/// The style with the brush that the reference pictures were drawn with.
fn config() -> style::Config {
    let mut config = style::Config { name: StyleName::Pointillism, ..Default::default() };
    config.set("sprite", text(&data("brush_64.png"))).expect("the brush");
    config
}

fn drawn(config: &style::Config, frame: &Frame) -> Rgb {
    let mut out = Rgb::default();
    Styler::new(config, simd::best()).draw(StyleInput { frame, layer: None }, &mut out);
    out
}

/// The bound is two levels; the canvas' 1/64 levels keep it to one, and that seldom.
fn compare(label: &str, found: &Rgb, truth: &Rgb) {
    let size = truth.size();
    assert_eq!(found.size(), size, "{label}: size");
    let (mut worst, mut off) = (0, 0);
    for i in 0..size.area() {
        let (a, b) = (found.at(i % size.width, i / size.width), truth.at(i % size.width, i / size.width));
        for c in 0..3 {
            let miss = a[c].abs_diff(b[c]);
            worst = worst.max(miss);
            off += usize::from(miss > 0);
        }
    }
    println!("{label}: {off} of {} values differ, by at most {worst} levels (bound 2)", 3 * size.area());
    assert!(worst <= 1, "{label}: off by {worst} levels");
    assert!(off * 20 <= 3 * size.area() || size.area() < 64, "{label}: {off} values are off");
}

#[test]
fn the_grid_is_the_reference_grid() {
    for name in FRAMES {
        let path = data(&format!("{name}__brush.npz"));
        let (records, order) = (stage(&path, "rec"), stage(&path, "order"));
        let sites = config().pointillism.sites(Size::new(160, 120));
        assert_eq!(sites.len(), order.len());
        for (site, &k) in sites.iter().zip(&order) {
            let found = site.to_row().map(|v| f64::from(v as f32));
            assert_eq!(found, records[6 * k as usize..][..6], "{name}: site {k}");
        }
    }
}

#[test]
fn pictures_keep_their_bound() {
    for name in FRAMES {
        let frame = frame(name);
        let out = drawn(&config(), &frame);
        let truth = picture::read(&data(&format!("{name}__brush.png"))).expect("reference picture");
        compare(name, &out, &truth);
        let own = style::reference(&config(), &frame.color);
        assert_eq!(own, truth, "{name}: the plain f64 form gives the independent picture");
    }
}

#[test]
fn the_full_reference_set_keeps_its_bounds() {
    let Ok(folder) = std::env::var("VERNISSAGE_REFERENCE") else {
        eprintln!("NOT RUN: the full set of reference pictures; set VERNISSAGE_REFERENCE to its folder");
        return;
    };
    let filters = Path::new(&folder).join("filters");
    for name in ["coffee_640x480", "stress_640x480", FRAMES[0], FRAMES[1]] {
        let input = picture::read(&filters.join("inputs").join(format!("{name}.png"))).expect("input");
        let truth = filters.join("outputs").join(format!("{name}__brush.png"));
        compare(name, &drawn(&config(), &frame_of(input)), &picture::read(&truth).expect("picture"));
    }
    let path = filters.join("outputs/coffee_640x480__brush_grid.npz");
    let (records, order) = (stage(&path, "rec_i"), stage(&path, "order"));
    let offsets = stage(&path, "off");
    for (site, &k) in config().pointillism.sites(Size::new(640, 480)).iter().zip(&order) {
        let k = k as usize;
        let row = site.to_row();
        assert_eq!((&row[..3], &row[3..]), (&records[3 * k..][..3], &offsets[3 * k..][..3]), "site {k}");
    }
}

/// The top left `w` x `h` pixels, repeated where there are not so many.
fn part(picture: &Rgb, w: usize, h: usize) -> Rgb {
    let mut part = Rgb::new(Size::new(w, h), [0; 3]);
    for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
        part.set(x, y, picture.at(x % picture.size().width, y % picture.size().height));
    }
    part
}

#[test]
fn the_same_bytes_everywhere_at_every_size_and_setting() {
    let photo = frame(FRAMES[1]).color;
    type Case = (&'static [&'static str], &'static [(usize, usize)]);
    let cases: [Case; 5] = [
        (&[], &[(1, 1), (2, 9), (17, 5), (16, 16), (64, 32), (65, 33), (97, 53), (333, 211), (1920, 1080)]),
        (&["opacity=1", "color_offset=1", "seed=1"], &[(160, 120)]),
        (&["radius_min=0", "radius_max=9", "col_skip=7", "row_skip=3"], &[(1, 7), (131, 67)]),
        (&["radius_max=64", "radius_min=20", "range=200", "col_skip=31"], &[(3, 2), (150, 90)]),
        (&["col_skip=1", "row_skip=1", "range=0", "radius_min=1", "radius_max=1"], &[(66, 35)]),
    ];
    for (settings, sizes) in cases {
        let mut config = config();
        for setting in settings {
            let (key, value) = setting.split_once('=').expect("key=value");
            config.set(key, value).expect(setting);
        }
        for &(w, h) in sizes {
            let frame = frame_of(part(&photo, w, h));
            let mut first: Option<Rgb> = None;
            for threads in [1, 2, 4] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
                for level in simd::available() {
                    let mut out = Rgb::default();
                    let mut styler = Styler::new(&config, level);
                    pool.install(|| styler.draw(StyleInput { frame: &frame, layer: None }, &mut out));
                    let first = first.get_or_insert_with(|| {
                        let truth = style::reference(&config, &frame.color);
                        compare(&format!("{w}x{h} {settings:?}"), &out, &truth);
                        out.clone()
                    });
                    assert!(*first == out, "{w}x{h}: {} with {threads} threads", simd::name(level));
                }
            }
        }
    }
}

#[test]
fn sizes_may_change_from_frame_to_frame() {
    let (coffee, stress) = (frame(FRAMES[0]).color, frame(FRAMES[1]).color);
    let mut styler = Styler::new(&config(), simd::best());
    let mut out = Rgb::default();
    for picture in [coffee.clone(), part(&stress, 40, 100), Rgb::default(), part(&stress, 1, 1), coffee] {
        let frame = frame_of(picture);
        styler.draw(StyleInput { frame: &frame, layer: None }, &mut out);
        assert!(out == drawn(&config(), &frame), "{}: the frame before shows through", frame.size());
    }
}

fn write(folder: &Path, name: &str, shape: &[u64], values: &[f64]) -> String {
    use npyz::WriterBuilder;
    let path = folder.join(name);
    let file = std::fs::File::create(&path).expect("temporary file");
    let mut writer =
        npyz::WriteOptions::new().default_dtype().shape(shape).writer(file).begin_nd().expect("header");
    writer.extend(values.iter().copied()).expect("values");
    writer.finish().expect("written");
    text(&path).to_string()
}

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::create_dir_all(&folder).expect("temporary folder");
    folder
}

#[test]
fn the_grid_comes_from_a_file() {
    let folder = folder("pointillism-grid");
    let frame = frame(FRAMES[0]);
    let path = data(&format!("{}__brush.npz", FRAMES[0]));
    let (records, order) = (stage(&path, "rec"), stage(&path, "order"));
    let rows: Vec<f64> = order.iter().flat_map(|&k| records[6 * k as usize..][..6].to_vec()).collect();
    let mut fed = config();
    fed.set("grid", &write(&folder, "grid.npy", &[order.len() as u64, 6], &rows)).expect("a grid file");
    fed.set("seed", "1").expect("a seed that does not matter");
    let truth = picture::read(&data(&format!("{}__brush.png", FRAMES[0]))).expect("reference picture");
    compare("grid from a file", &drawn(&fed, &frame), &truth);

    // the stage is what can be fed
    let stage = Pointillism::new(fed.pointillism.clone(), simd::best()).grid(frame.size());
    let again: Vec<f64> = stage.rows().flatten().map(|&v| f64::from(v)).collect();
    assert_eq!(again, rows);

    // any grid: sites far outside, every radius, crowds
    let mut rng = SplitMix64::new(9);
    let wild: Vec<f64> = (0..3000)
        .flat_map(|_| {
            let at =
                [rng.int(-90, 250) as f64, rng.int(-90, 210) as f64, (rng.int(0, 8) * rng.int(0, 8)) as f64];
            [at[0], at[1], at[2], 2.0 * rng.f64() - 1.0, rng.f64(), -rng.f64()]
        })
        .collect();
    fed.set("grid", &write(&folder, "wild.npy", &[3000, 6], &wild)).expect("a grid file");
    compare("wild grid", &drawn(&fed, &frame), &style::reference(&fed, &frame.color));

    let good = [1.0, 2.0, 3.0, 0.0, 0.0, 0.0];
    let with = |at: usize, value: f64| {
        let mut row = good;
        row[at] = value;
        row
    };
    for (path, wanted) in [
        (write(&folder, "flat.npy", &[6], &good), "N x 6"),
        (write(&folder, "five.npy", &[1, 5], &good[..5]), "N x 6"),
        (write(&folder, "none.npy", &[0, 6], &[]), "N x 6"),
        (write(&folder, "nan.npy", &[1, 6], &with(0, f64::NAN)), "site 0: x is NaN"),
        (write(&folder, "half.npy", &[1, 6], &with(1, 0.5)), "site 0: y is 0.5"),
        (write(&folder, "far.npy", &[1, 6], &with(0, 1e9)), "65535"),
        (write(&folder, "radius.npy", &[1, 6], &with(2, 65.0)), "0 to 64"),
        (write(&folder, "offset.npy", &[1, 6], &with(4, 1.5)), "dg is 1.5"),
        (text(&folder.join("missing.npy")).to_string(), "missing.npy"),
        (text(&data("brush_64.png")).to_string(), "brush_64.png"),
    ] {
        let error = config().set("grid", &path).expect_err(wanted).to_string();
        assert!(error.contains(wanted) && error.contains("grid") && error.lines().count() == 1, "{error}");
    }
}

#[test]
fn the_brush_comes_from_a_file() {
    let folder = folder("pointillism-sprite");
    let frame = frame(FRAMES[0]);
    let mut plain = style::Config { name: StyleName::Pointillism, ..Default::default() };
    let built_in = drawn(&plain, &frame);
    compare("built-in brush", &built_in, &style::reference(&plain, &frame.color));
    assert!(built_in != drawn(&config(), &frame));

    // a picture of one white pixel is an opaque square, one black pixel paints nothing
    let one = |name: &str, level: u8| {
        let path = folder.join(name);
        picture::write_png(&path, &Rgb::new(Size::new(1, 1), [level; 3])).expect("temporary file");
        text(&path).to_string()
    };
    plain.set("sprite", &one("white.png", 255)).expect("a brush");
    compare("white brush", &drawn(&plain, &frame), &style::reference(&plain, &frame.color));
    plain.set("sprite", &one("black.png", 0)).expect("a brush");
    assert_eq!(drawn(&plain, &frame), frame.color);

    let cut = folder.join("cut.png");
    let bytes = std::fs::read(data("brush_64.png")).expect("the brush");
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).expect("temporary file");
    let large = folder.join("large.png");
    picture::write_png(&large, &Rgb::new(Size::new(4097, 1), [9; 3])).expect("temporary file");
    for (path, wanted) in
        [(cut, "not a readable"), (folder.join("missing.png"), "missing.png"), (large, "4096x4096")]
    {
        let error = config().set("sprite", text(&path)).expect_err(wanted).to_string();
        assert!(error.contains(wanted) && error.contains("sprite") && error.lines().count() == 1, "{error}");
    }
}

#[test]
fn settings_out_of_range_are_refused() {
    for (setting, wanted) in [
        ("col_skip=0", "1 to 256"),
        ("row_skip=257", "1 to 256"),
        ("range=257", "0 to 256"),
        ("radius_min=65", "0 to 64"),
        ("radius_max=3", "radius_min to 64"),
        ("radius_max=65", "radius_min to 64"),
        ("color_offset=nan", "0 to 1"),
        ("opacity=1.1", "0 to 1"),
        ("num_particles=1000001", "0 to 1000000"),
        ("num_particles=-1", "num_particles"),
    ] {
        let (key, value) = setting.split_once('=').expect("key=value");
        let error = config().set(key, value).expect_err(setting).to_string();
        assert!(error.contains(key) && error.contains(wanted), "{error}");
    }
}

fn scene(meshes: Vec<Mesh>) -> Scene {
    let model = |mesh: Mesh| Model {
        name: "test".into(),
        mesh: mesh.into(),
        anchor: Anchor { family: Family::Tag36h11, id: None, side_mm: 100.0 },
        to_marker: DAffine3::IDENTITY,
        shading: Shading::Smooth,
        cull_back: false,
        secondary: false,
        phantom: false,
    };
    let light = Light { ambient: 0.2, ..Light::default() };
    Scene { models: meshes.into_iter().map(model).collect(), light, ..Scene::default() }
}

/// Both meshes side by side, 300 mm away, as large as a hand.
fn placed(scene: &Scene) -> Vec<Placed> {
    let turn = DMat3::from_rotation_y(0.5) * DMat3::from_rotation_x(2.7);
    let place = |(model, of): (usize, &Model)| {
        let (low, high) = of.mesh.bounds().expect("a mesh");
        let scale = 120.0 / f64::from((high - low).max_element());
        let middle = ((low + high) / 2.0).as_dvec3() * scale;
        let aside = DVec3::new(60.0 * model as f64 - 30.0, 0.0, 300.0 + 20.0 * model as f64);
        let to_camera = DAffine3 { matrix3: turn * scale, translation: aside - turn * middle };
        Placed { model, to_camera }
    };
    scene.models.iter().enumerate().map(place).collect()
}

fn camera(size: Size, k1: f64) -> Camera {
    let distortion = [k1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
    Camera { lens: Lens { distortion, ..Lens::guess(size) }, near: 10.0, far: 1e5 }
}

fn models() -> Vec<Mesh> {
    let mut spot = builtin("spot").expect("built in");
    let texture = Plane::from_fn(Size::new(32, 32), |x, y| (8 * x) as u8 ^ (5 * y) as u8);
    spot.set_texture(Arc::new(Rgb {
        planes: [texture.clone(), Plane::new(Size::new(32, 32), 200), texture],
    }));
    let mut teapot = builtin("teapot").expect("built in");
    teapot.set_color(Vec3::new(0.9, 0.5, 0.2));
    vec![teapot, spot]
}

/// Section 3.4.3 in plain f64: what is seen of a mesh's particles, in no order.
fn particles(scene: &Scene, placed: &Placed, camera: &Camera, scatter: Scatter) -> Vec<([f64; 3], [f64; 3])> {
    let mesh = &scene.models[placed.model].mesh;
    let corner = |i: u32| mesh.positions[i as usize].as_dvec3();
    let area = |t: &[u32; 3]| (corner(t[1]) - corner(t[0])).cross(corner(t[2]) - corner(t[0])).length() / 2.0;
    let total: f64 = mesh.triangles.iter().map(area).sum();
    let mut rng = SplitMix64::new(scatter.seed);
    let (mut seen, mut made, mut covered) = (Vec::new(), 0, 0.0);
    for (index, triangle) in mesh.triangles.iter().enumerate() {
        covered += area(triangle);
        let until = (f64::from(scatter.count) * covered / total + 0.5).floor() as usize;
        for _ in made..until {
            let (mut s, mut t) = (rng.f64(), rng.f64());
            if s + t > 1.0 {
                (s, t) = (1.0 - s, 1.0 - t);
            }
            let w = [1.0 - s - t, s, t];
            let sum = |of: &dyn Fn(usize) -> DVec3| {
                (0..3).map(|k| of(triangle[k] as usize) * w[k]).fold(DVec3::ZERO, |a, b| a + b)
            };
            let at = placed.to_camera.transform_point3(sum(&|i| mesh.positions[i].as_dvec3()));
            let turned = placed.to_camera.matrix3.inverse().transpose();
            let normal = (turned * sum(&|i| mesh.normals[i].as_dvec3())).normalize();
            let Some(px) = camera.lens.project(at) else { continue };
            let Size { width, height } = camera.lens.size;
            let shown = |v: f64, n: usize| v >= -0.5 && v < n as f64 - 0.5;
            if normal.dot(at) > 0.0 || at.z < camera.near || !shown(px.x, width) || !shown(px.y, height) {
                continue;
            }
            let light = scene.light;
            let ambient = f64::from(light.ambient);
            let brightness = ambient + (1.0 - ambient) * normal.dot(light.direction.as_dvec3()).max(0.0);
            let material: &Material = &mesh.materials[usize::from(mesh.material_of[index])];
            let texel = material.texture.as_ref().map_or(DVec3::ONE, |texture| {
                let uv = (0..3).map(|k| mesh.texcoords[triangle[k] as usize] * w[k] as f32).sum::<Vec2>();
                texel(texture, f64::from(uv.x), f64::from(uv.y))
            });
            let color = texel * material.color.as_dvec3() * brightness;
            seen.push(([px.x, px.y, at.z], color.to_array()));
        }
        made = until;
    }
    assert_eq!(made, scatter.count as usize, "all particles are made");
    seen
}

/// Bilinear, repeated, v up.
fn texel(texture: &Rgb, u: f64, v: f64) -> DVec3 {
    let size = texture.size();
    let (x, y) = (u * size.width as f64 - 0.5, (1.0 - v) * size.height as f64 - 0.5);
    let at = |x: f64, y: f64| {
        let wrap = |v: f64, n: usize| (v as i64).rem_euclid(n as i64) as usize;
        DVec3::from(texture.at(wrap(x, size.width), wrap(y, size.height)).map(|v| f64::from(v) / 255.0))
    };
    let (x0, y0) = (x.floor(), y.floor());
    let row = |y: f64| at(x0, y) * (1.0 - (x - x0)) + at(x0 + 1.0, y) * (x - x0);
    row(y0) * (1.0 - (y - y0)) + row(y0 + 1.0) * (y - y0)
}

#[test]
fn particles_are_the_references_particles() {
    let scene = scene(models());
    let scatter = Scatter { count: 5000, seed: 7 };
    for (size, k1) in [(Size::new(160, 120), 0.0), (Size::new(97, 131), -0.2)] {
        let (camera, placed) = (camera(size, k1), placed(&scene));
        let look = vernissage::render::Look { scatter, ..Needs::PARTICLES.into() };
        let mut renderer = Renderer::new(simd::best());
        let found = renderer.draw(&scene, &placed, &camera, look).particles.clone();
        let mut truth: Vec<_> = placed.iter().flat_map(|p| particles(&scene, p, &camera, scatter)).collect();
        truth.sort_by(|a, b| b.0[2].total_cmp(&a.0[2]));
        assert!(found.len().abs_diff(truth.len()) <= 3, "{} of {} particles", found.len(), truth.len());
        assert!(found.len() > 2000 && found.is_sorted_by(|a, b| a.z >= b.z), "{size}: far to near");
        for particle in &found {
            let z = f64::from(particle.z);
            let from = truth.partition_point(|t| t.0[2] > z + 1e-3);
            let near = truth[from..].iter().take_while(|t| t.0[2] >= z - 1e-3);
            let close = |t: &&([f64; 3], [f64; 3])| {
                let at = (f64::from(particle.x) - t.0[0]).abs().max((f64::from(particle.y) - t.0[1]).abs());
                let color = (0..3).map(|c| (f64::from(particle.color[c]) - t.1[c]).abs()).fold(0.0, f64::max);
                at < 1e-3 && color < 1e-3
            };
            assert!(near.clone().any(|t| close(&t)), "{size}: {particle:?} is none of the reference's");
        }
        let layer = renderer.draw(&scene, &placed, &camera, look);
        assert_eq!(layer.particles, found, "the next frame is the same");
        assert!(layer.depth.size() == Size::new(0, 0) && !layer.touched.is_empty());
        assert!(layer.extent[0] < layer.extent[1]);
        let both = vernissage::render::Look { scatter, ..Needs::PARTICLES.and(Needs::COLOR).into() };
        let layer = renderer.draw(&scene, &placed, &camera, both);
        assert!(layer.particles == found && layer.color.size() == size, "surfaces do not change particles");
        assert!(renderer.draw(&scene, &[], &camera, look).particles.is_empty(), "nothing in view");
    }
}

#[test]
fn models_are_painted_as_in_the_reference() {
    let scene = scene(models());
    let photo = frame(FRAMES[0]).color;
    for (size, k1, settings) in [
        (Size::new(160, 120), 0.0, &["num_particles=20000"][..]),
        (Size::new(97, 131), -0.2, &["num_particles=3000", "seed=3"]),
        (Size::new(33, 20), 0.0, &["num_particles=500", "opacity=1", "radius_min=0", "radius_max=12"]),
        (Size::new(1, 1), 0.0, &["num_particles=2000"]),
    ] {
        let mut config = config();
        for setting in settings {
            let (key, value) = setting.split_once('=').expect("key=value");
            config.set(key, value).expect(setting);
        }
        let (camera, placed, frame) =
            (camera(size, k1), placed(&scene), frame_of(part(&photo, size.width, size.height)));
        let mut first: Option<Rgb> = None;
        for threads in [1, 2, 4] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
            for level in simd::available() {
                let (mut styler, mut renderer) = (Styler::new(&config, level), Renderer::new(level));
                let mut out = Rgb::default();
                let layer: Layer = pool.install(|| {
                    let layer = renderer.draw(&scene, &placed, &camera, styler.look());
                    styler.draw(StyleInput { frame: &frame, layer: Some(layer) }, &mut out);
                    layer.clone()
                });
                let first = first.get_or_insert_with(|| {
                    let truth = reference_with_models(&config.pointillism, &frame.color, &layer.particles);
                    compare(&format!("{size}, {} particles", layer.particles.len()), &out, &truth);
                    out.clone()
                });
                assert!(*first == out, "{size}: {} with {threads} threads", simd::name(level));
            }
        }
        let without = drawn(&config, &frame);
        assert!(size.area() == 1 || first.is_some_and(|with| with != without), "{size}: no model to be seen");
    }
}

#[test]
fn nearer_particles_paint_over_those_behind() {
    let size = Size::new(40, 40);
    let mut config = config();
    config.set("color_offset", "0").expect("a number");
    let frame = frame_of(Rgb::new(size, [0; 3]));
    let stroke = |color: [f32; 3], z: f32| vec![Particle { x: 20.0, y: 20.0, z, color }; 12];
    let draw = |particles: Vec<Particle>| {
        let layer = Layer { particles, ..Layer::default() };
        let mut out = Rgb::default();
        Styler::new(&config, simd::best()).draw(StyleInput { frame: &frame, layer: Some(&layer) }, &mut out);
        out
    };
    let (red, blue) = ([1.0, 0.0, 0.0], [0.0, 0.0, 1.0]);
    let out = draw([stroke(red, 500.0), stroke(blue, 400.0)].concat());
    assert!(out.at(20, 20)[2] > 200 && out.at(20, 20)[0] < 20, "{:?}", out.at(20, 20));
    assert_eq!(draw(Vec::new()), drawn(&config, &frame), "a layer without particles changes nothing");
}
