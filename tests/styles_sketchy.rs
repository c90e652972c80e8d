//! The sketchy style against an independent f64 reference and its own, over models too, the same bytes everywhere.
//!
//! The 160x120 frames and their stages are in `tests/data/filters`. The full set of frames is checked when
//! `VERNISSAGE_REFERENCE` names the folder that holds `filters/inputs` and `filters/outputs`.

mod common;

use common::{FRAMES, data, frame, frame_of, stage, text, worst};
use std::path::Path;
use vernissage::frame::{Frame, Layer};
use vernissage::pixels::{Plane, Rgb, Size, TileGrid, TileSet, picture, simd};
use vernissage::style::sketchy::{Sketchy, Stages, reference_over};
use vernissage::style::{self, StyleInput, StyleName, Styler};

/// The style with these settings.
fn config(settings: &[(&str, &str)]) -> style::Config {
    let mut config = style::Config { name: StyleName::Sketchy, ..Default::default() };
    for (key, value) in settings {
        config.set(key, value).expect(key);
    }
    config
}

/// As the reference pictures were drawn.
fn as_reference() -> style::Config {
    config(&[("paper", text(&data("paper_256.png")))])
}

fn stages(config: &style::Config, frame: &Frame) -> (Stages, Rgb) {
    let mut out = Rgb::default();
    let mut style = Sketchy::new(config.sketchy.clone(), simd::best());
    let stages = style.stages(StyleInput { frame, layer: None }, &mut out);
    (stages, out)
}

#[test]
fn every_stage_keeps_its_bound() {
    for name in FRAMES {
        let path = data(&format!("{name}__sketchy.npz"));
        let (found, out) = stages(&as_reference(), &frame(name));
        let flat = |plane: &Plane<f32>| plane.rows().flatten().copied().collect::<Vec<_>>();
        let count = found.blur[0].size().area();
        let planes = found.blur.each_ref().map(flat);
        let blur = (0..3 * count).map(|i| planes[i % 3][i / 3]);
        let blur = 255.0 * worst(blur, &stage(&path, "blur"));
        let edges = worst(flat(&found.edge).into_iter(), &stage(&path, "edge"));
        // where nothing changes the reference's f64 rounding points anywhere
        let (fx, fy) = (stage(&path, "fx"), stage(&path, "fy"));
        let force = (flat(&found.fx).into_iter().zip(flat(&found.fy)).zip(fx.iter().zip(&fy)))
            .filter(|((x, y), _)| (*x, *y) != (0.0, 0.0))
            .map(|((x, y), (tx, ty))| (f64::from(x) - tx).abs().max((f64::from(y) - ty).abs()))
            .fold(0.0, f64::max);
        assert_eq!(
            worst(found.stroke_len.iter().copied(), &stage(&path, "stroke_len")),
            0.0,
            "{name}: lengths"
        );
        let points = worst(flat(&found.stroke_pts).into_iter(), &stage(&path, "stroke_pts"));
        println!(
            "{name}: blur {blur:.6} levels (bound 1), edges {edges}, force {force:.1e}, {} strokes off by \
             {points:.1e} px (bound 1e-3)",
            found.stroke_len.len()
        );
        assert!(blur <= 1.0, "{name}: blur is off by {blur} levels");
        assert_eq!(edges, 0.0, "{name}: edges");
        assert!(force <= 1e-6, "{name}: force is off by {force}");
        assert!(points <= 1e-3, "{name}: strokes are off by {points} px");
        let truth = picture::read(&data(&format!("{name}__sketchy.png"))).expect("reference picture");
        compare(name, &out, &truth);
        compare(
            &format!("{name}, own reference"),
            &style::reference(&as_reference(), &frame(name).color),
            &truth,
        );
    }
}

/// No pixel is off by more than one level: a value may lie on a rounding tie.
fn compare(label: &str, found: &Rgb, truth: &Rgb) {
    let size = truth.size();
    assert_eq!(found.size(), size, "{label}: size");
    let (mut worst, mut off) = (0, 0);
    for i in 0..size.area() {
        let (a, b) = (found.at(i % size.width, i / size.width), truth.at(i % size.width, i / size.width));
        let miss = (0..3).map(|c| a[c].abs_diff(b[c])).max().unwrap_or(0);
        worst = worst.max(miss);
        off += usize::from(miss > 0);
    }
    println!("{label}: {off} of {} pixels differ, by at most {worst} levels (bound 1)", size.area());
    assert!(worst <= 1, "{label}: off by {worst} levels");
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
        let (_, out) = stages(&as_reference(), &frame_of(input));
        let truth = filters.join("outputs").join(format!("{name}__sketchy.png"));
        compare(name, &out, &picture::read(&truth).expect("reference picture"));
    }
}

/// The settings that take other ways through the style.
const VARIANTS: [&[(&str, &str)]; 8] = [
    &[],
    &[("color", "false")],
    &[("blur", "false"), ("paper", "false")],
    &[("strokes", "false"), ("sigma", "0.5")],
    &[("half_width", "5"), ("points", "64"), ("threshold", "0")],
    &[("half_width", "0"), ("density", "1"), ("step", "0.25"), ("points", "2")],
    &[("sigma", "16"), ("step", "16"), ("opacity", "1")],
    &[("density", "0")],
];

#[test]
fn sequences_repeat_everywhere_and_match_the_reference() {
    let (photo, stress) = (frame(FRAMES[0]).color, frame(FRAMES[1]).color);
    for (w, h) in [(1, 1), (2, 9), (16, 16), (17, 5), (97, 53), (160, 120)] {
        let frames = [&photo, &stress, &photo].map(|from| {
            let mut part = Rgb::new(Size::new(w, h), [0; 3]);
            for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
                part.set(x, y, from.at(x, y));
            }
            frame_of(part)
        });
        for settings in VARIANTS {
            let mut config = config(settings);
            config.set("lively", "true").expect("a switch");
            let mut first: Option<Vec<Rgb>> = None;
            for threads in [1, 2, 4] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
                for level in simd::available() {
                    let drawn: Vec<Rgb> = pool.install(|| {
                        let mut styler = Styler::new(&config, level);
                        let draw = |frame| {
                            let mut out = Rgb::default();
                            styler.draw(StyleInput { frame, layer: None }, &mut out);
                            out
                        };
                        frames.iter().map(draw).collect()
                    });
                    let first = first.get_or_insert_with(|| {
                        let truth = style::reference(&config, &frames[0].color);
                        compare(&format!("{w}x{h}, {settings:?}, own reference"), &drawn[0], &truth);
                        drawn.clone()
                    });
                    let same = *first == drawn;
                    assert!(same, "{w}x{h}, {settings:?}: {} x {threads} differs", simd::name(level));
                }
            }
        }
    }
}

#[test]
fn strokes_keep_still_unless_lively() {
    let frame = frame(FRAMES[0]);
    let play = |lively: &str| {
        let mut styler = Styler::new(&config(&[("lively", lively)]), simd::best());
        let mut draw = |anew: bool| {
            let mut out = Rgb::default();
            if anew {
                styler.restart();
            }
            styler.draw(StyleInput { frame: &frame, layer: None }, &mut out);
            out
        };
        [draw(false), draw(false), draw(true)]
    };
    let [still, again, anew] = play("false");
    assert!(still == again && still == anew, "the same picture gets the same strokes");
    let [first, second, anew] = play("true");
    assert!(first == still && anew == still, "a lively sequence begins as a still");
    assert!(second != first, "and goes on with other strokes");
}

#[test]
fn starts_come_from_a_file() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("sketchy-starts");
    std::fs::create_dir_all(&folder).expect("temporary folder");
    let write = |name: &str, shape: &[u64], values: &[f64]| {
        use npyz::WriterBuilder;
        let path = folder.join(name);
        let file = std::fs::File::create(&path).expect("temporary file");
        let mut writer =
            npyz::WriteOptions::new().default_dtype().shape(shape).writer(file).begin_nd().expect("header");
        writer.extend(values.iter().copied()).expect("values");
        writer.finish().expect("written");
        text(&path).to_string()
    };
    let (frame, path) = (frame(FRAMES[0]), data(&format!("{}__sketchy.npz", FRAMES[0])));
    // the places where the reference's strokes begin, among ones that start nothing
    let (lengths, points) = (stage(&path, "stroke_len"), stage(&path, "stroke_pts"));
    let mut starts = vec![-5.0, 3.0, 4000.0, 4000.0];
    let mut at = 0;
    for length in &lengths {
        starts.extend(&points[2 * at..2 * at + 2]);
        at += *length as usize;
    }
    let file = write("starts.npy", &[starts.len() as u64 / 2, 2], &starts);
    let mut fed = as_reference();
    fed.set("starts", &file).expect("a file of starts");
    let (stages, out) = stages(&fed, &frame);
    assert_eq!(worst(stages.stroke_len.into_iter(), &lengths), 0.0);
    assert!(worst(stages.stroke_pts.rows().flatten().copied(), &points) <= 1e-3);
    let truth = picture::read(&data(&format!("{}__sketchy.png", FRAMES[0]))).expect("reference picture");
    compare("starts from a file", &out, &truth);
    for (key, path, wanted) in [
        ("starts", write("flat.npy", &[4], &[1.0, 2.0, 3.0, 4.0]), "N x 2"),
        ("starts", write("nan.npy", &[2, 2], &[1.0, 2.0, 3.0, f64::NAN]), "start 1"),
        ("starts", text(&folder.join("missing.npy")).to_string(), "missing.npy"),
        ("paper", text(&folder.join("missing.png")).to_string(), "missing.png"),
        ("paper", text(&folder.join("flat.npy")).to_string(), "flat.npy"),
        ("paper", "3".to_string(), "gray picture"),
        ("brush", text(&folder.join("missing.png")).to_string(), "missing.png"),
        ("renderer", "crayons".to_string(), "lines"),
        ("density", "1.5".to_string(), "density"),
        ("sigma", "0".to_string(), "0.3 to 16"),
        ("points", "1".to_string(), "2 to 64"),
    ] {
        let error = config(&[]).set(key, &path).expect_err(wanted).to_string();
        assert!(error.contains(wanted) && error.contains(key) && error.lines().count() == 1, "{error}");
    }
}

/// A camera at f = 100 px in front of a floor plate that leads far away, 24 px to either side of the middle, over a
/// picture without edges of its own.
fn plate(size: Size) -> (Frame, Layer) {
    let grid = TileGrid::new(size);
    let mut touched = TileSet::new(grid);
    (0..grid.count()).for_each(|tile| touched.insert(tile));
    // 1/z is linear in y: 100 mm at the bottom row, 1000 mm at row 20
    let bottom = (size.height - 1) as f32;
    let inverse = |y: usize| 0.001 + (0.01 - 0.001) * (y as f32 - 20.0) / (bottom - 20.0);
    let inside = |x: usize, y: usize| y >= 20 && x.abs_diff(size.width / 2) < 24;
    let depth = Plane::from_fn(size, |x, y| if inside(x, y) { 1.0 / inverse(y) } else { f32::INFINITY });
    let color = Rgb::new(size, [200, 180, 90]);
    let layer =
        Layer { color, depth, extent: [100.0, 1000.0], touched, grid: Some(grid), ..Layer::default() };
    (frame_of(Rgb::new(size, [120; 3])), layer)
}

#[test]
fn a_slanted_plate_has_a_contour_and_with_the_guard_nothing_inside() {
    let size = Size::new(97, 90);
    let (frame, layer) = plate(size);
    let edges = |guard: &str| {
        let mut style = Sketchy::new(config(&[("slope_guard", guard)]).sketchy, simd::best());
        style.stages(StyleInput { frame: &frame, layer: Some(&layer) }, &mut Rgb::default()).edge
    };
    let (plain, guarded) = (edges("false"), edges("true"));
    let well_inside = |x: usize, y: usize| y >= 23 && x.abs_diff(size.width / 2) < 22;
    let count = |edges: &Plane<f32>, wanted: bool| {
        let all = (0..size.area()).map(|i| (i % size.width, i / size.width));
        all.filter(|&(x, y)| well_inside(x, y) == wanted && edges.at(x, y) > 0.0).count()
    };
    println!(
        "edges inside: {} plain, {} guarded; contour: {}",
        count(&plain, true),
        count(&guarded, true),
        count(&plain, false)
    );
    assert!(count(&plain, true) > 100, "without the guard the far end is full of silhouettes");
    assert_eq!(count(&guarded, true), 0, "a plane has no silhouettes inside");
    for y in 24..size.height {
        for x in [size.width / 2 - 24, size.width / 2 - 23, size.width / 2 + 23, size.width / 2 + 24] {
            assert!(guarded.at(x, y) > 0.0, "the contour goes on at ({x}, {y})");
        }
    }
}

#[test]
fn models_and_every_renderer_match_the_reference() {
    let size = Size::new(97, 90);
    let (_, layer) = plate(size);
    let photo = frame(FRAMES[0]).color;
    let camera = Rgb { planes: photo.planes.each_ref().map(|p| Plane::from_fn(size, |x, y| p.at(x, y))) };
    let frame = frame_of(camera);
    for settings in [
        &[("slope_guard", "false")][..],
        &[("depth_width", "1"), ("half_width", "2")],
        &[("renderer", "polygons")],
        &[("renderer", "polygons"), ("depth_width", "1"), ("half_width", "3"), ("border", "true")],
        &[("renderer", "sprites"), ("border", "true")],
        &[("renderer", "sprites"), ("depth_width", "1"), ("half_width", "3")],
    ] {
        let config = config(settings);
        let truth = reference_over(&config.sketchy, &frame.color, Some(&layer));
        let mut first: Option<Vec<Rgb>> = None;
        for threads in [1, 2, 4] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
            for level in simd::available() {
                let drawn: Vec<Rgb> = pool.install(|| {
                    let mut styler = Styler::new(&config, level);
                    let draw = |_| {
                        let mut out = Rgb::default();
                        styler.draw(StyleInput { frame: &frame, layer: Some(&layer) }, &mut out);
                        out
                    };
                    (0..4).map(draw).collect()
                });
                let first = first.get_or_insert_with(|| drawn.clone());
                assert!(*first == drawn, "{settings:?}: {} x {threads} differs", simd::name(level));
            }
        }
        let drawn = first.expect("drawn");
        compare(&format!("models, {settings:?}"), &drawn[0], &truth);
        let moves = settings.contains(&("renderer", "sprites"));
        assert_eq!(drawn[0] != drawn[1], moves, "{settings:?}: only sprites move on a still picture");
    }
}

#[test]
fn strokes_as_long_as_a_wide_picture_match_the_reference() {
    let photo = frame(FRAMES[0]).color;
    let size = Size::new(700, 30);
    // stripes that strokes follow from side to side, and a little of the photograph
    let red = |x: usize, y: usize| (y as u8 % 10) * 20 + photo.planes[0].at(x % 160, y) / 32;
    let frame = frame_of(Rgb { planes: [(); 3].map(|()| Plane::from_fn(size, red)) });
    for renderer in ["lines", "polygons"] {
        let config =
            config(&[("renderer", renderer), ("points", "64"), ("step", "13"), ("threshold", "0.01")]);
        let mut out = Rgb::default();
        let level = simd::best();
        Styler::new(&config, level).draw(StyleInput { frame: &frame, layer: None }, &mut out);
        compare(renderer, &out, &reference_over(&config.sketchy, &frame.color, None));
    }
}
