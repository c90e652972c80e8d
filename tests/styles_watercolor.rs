//! The watercolor style against an independent f64 reference and its own, and its sites from frame to frame.
//!
//! The 160x120 frames and their stages are in `tests/data/filters`. The full set of frames is checked when
//! `VERNISSAGE_REFERENCE` names the folder that holds `filters/inputs` and `filters/outputs`.

mod common;

use common::{FRAMES, data, frame, frame_of, stage, worst};
use std::path::Path;
use vernissage::frame::Frame;
use vernissage::pixels::{Rgb, Size, picture, simd};
use vernissage::style::watercolor::{Stages, Watercolor};
use vernissage::style::{self, Style, StyleInput, StyleName, Styler};

fn config() -> style::Config {
    style::Config { name: StyleName::Watercolor, ..Default::default() }
}

fn stages(style: &mut Watercolor, frame: &Frame) -> (Stages, Rgb) {
    let mut out = Rgb::default();
    let stages = style.stages(StyleInput { frame, layer: None }, &mut out);
    (stages, out)
}

#[test]
fn every_stage_keeps_its_bound() {
    for name in FRAMES {
        let path = data(&format!("{name}__watercolor.npz"));
        let frame = frame(name);
        let mut style = Watercolor::new(config().watercolor, simd::best());
        let (first, out) = stages(&mut style, &frame);
        assert_eq!(
            worst(first.labels.rows().flatten().copied(), &stage(&path, "lab")),
            0.0,
            "{name}: labels"
        );
        assert_eq!(worst(first.edge.rows().flatten().copied(), &stage(&path, "edge")), 0.0, "{name}: edges");
        assert_eq!(
            worst(first.sites.rows().flatten().copied(), &stage(&path, "s1")),
            0.0,
            "{name}: re-tiled sites"
        );
        let means = 255.0 * worst(first.means.rows().flatten().copied(), &stage(&path, "mean"));
        println!("{name}: labels, edges, sites: 0 mismatches; means: {means:.6} levels (bound 1)");
        assert!(means <= 1e-4, "{name}: means are off by {means} levels");
        let size = frame.color.size();
        let weights = ([0.35, 0.075, 0.075], 0.5 / 3.0);
        for (x, y) in (0..size.height).flat_map(|y| (0..size.width).map(move |x| (x, y))) {
            let truth = vernissage::kernel::contrast::reference(&frame.color, x, y, weights.0, weights.1);
            let error = 255.0 * (f64::from(first.response.at(x, y)) - truth).abs();
            assert!(error <= 0.25, "{name}: response at ({x}, {y}) is off by {error} levels");
        }
        compare(&format!("{name}, first frame"), &out, &bytes(size, &stage(&path, "out0")));
        let (second, out) = stages(&mut style, &frame);
        assert_eq!(
            worst(second.labels.rows().flatten().copied(), &stage(&path, "lab1")),
            0.0,
            "{name}: labels after re-tiling"
        );
        let truth = picture::read(&data(&format!("{name}__watercolor.png"))).expect("reference picture");
        compare(name, &out, &truth);
        style.restart();
        assert_eq!(stages(&mut style, &frame).0, first, "{name}: begun anew");
    }
}

fn bytes(size: Size, values: &[f64]) -> Rgb {
    let mut picture = Rgb::new(size, [0; 3]);
    for i in 0..size.area() {
        let color = [0, 1, 2].map(|c| (values[3 * i + c].clamp(0.0, 1.0) * 255.0 + 0.5).floor() as u8);
        picture.set(i % size.width, i / size.width, color);
    }
    picture
}

/// No pixel is off by more than one level: a mean may lie on a rounding tie, an edge may not flip.
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
    for name in ["coffee_640x480", "stress_640x480", "coffee_1280x720", FRAMES[0], FRAMES[1]] {
        let input = picture::read(&filters.join("inputs").join(format!("{name}.png"))).expect("input");
        let frame = frame_of(input);
        let mut style = Watercolor::new(config().watercolor, simd::best());
        let (first, _) = stages(&mut style, &frame);
        let sites = filters.join("outputs").join(format!("{name}__watercolor_sites.npz"));
        if sites.exists() {
            assert_eq!(
                worst(first.sites.rows().flatten().copied(), &stage(&sites, "s1")),
                0.0,
                "{name}: re-tiled sites"
            );
        }
        let (_, out) = stages(&mut style, &frame);
        let truth = filters.join("outputs").join(format!("{name}__watercolor.png"));
        compare(name, &out, &picture::read(&truth).expect("reference picture"));
    }
}

#[test]
fn sequences_repeat_everywhere_and_match_the_reference() {
    let (photo, stress) = (frame(FRAMES[0]).color, frame(FRAMES[1]).color);
    for (w, h) in [(1, 1), (2, 9), (17, 5), (97, 53), (160, 120)] {
        let frames = [&photo, &stress, &photo].map(|from| {
            let mut part = Rgb::new(Size::new(w, h), [0; 3]);
            for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
                part.set(x, y, from.at(x, y));
            }
            frame_of(part)
        });
        let mut first: Option<Vec<Rgb>> = None;
        for threads in [1, 2, 4] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
            for level in simd::available() {
                let drawn: Vec<Rgb> = pool.install(|| {
                    let mut styler = Styler::new(&config(), level);
                    let draw = |frame| {
                        let mut out = Rgb::default();
                        styler.draw(StyleInput { frame, layer: None }, &mut out);
                        out
                    };
                    frames.iter().map(draw).collect()
                });
                let first = first.get_or_insert_with(|| {
                    compare(
                        &format!("{w}x{h}, own reference"),
                        &drawn[0],
                        &style::reference(&config(), &frames[0].color),
                    );
                    drawn.clone()
                });
                assert!(*first == drawn, "{w}x{h}: {} with {threads} threads differs", simd::name(level));
            }
        }
    }
}

#[test]
fn sites_come_from_a_file() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("watercolor-sites");
    std::fs::create_dir_all(&folder).expect("temporary folder");
    let write = |name: &str, shape: &[u64], values: &[f64]| {
        use npyz::WriterBuilder;
        let path = folder.join(name);
        let file = std::fs::File::create(&path).expect("temporary file");
        let mut writer =
            npyz::WriteOptions::new().default_dtype().shape(shape).writer(file).begin_nd().expect("header");
        writer.extend(values.iter().copied()).expect("values");
        writer.finish().expect("written");
        path.to_str().expect("plain path").to_string()
    };
    let frame = frame(FRAMES[0]);
    let retiled = stage(&data(&format!("{}__watercolor.npz", FRAMES[0])), "s1");
    let path = write("retiled.npy", &[retiled.len() as u64 / 2, 2], &retiled);
    let mut fed = config();
    fed.set("sites", &path).expect("a file of sites");
    let mut out = Rgb::default();
    Watercolor::new(fed.watercolor, simd::best()).draw(StyleInput { frame: &frame, layer: None }, &mut out);
    let truth = picture::read(&data(&format!("{}__watercolor.png", FRAMES[0]))).expect("reference picture");
    compare("sites from a file", &out, &truth);
    for (path, wanted) in [
        (write("flat.npy", &[4], &[1.0, 2.0, 3.0, 4.0]), "N x 2"),
        (write("none.npy", &[0, 2], &[]), "N x 2"),
        (write("nan.npy", &[2, 2], &[1.0, 2.0, 3.0, f64::NAN]), "site 1"),
        (folder.join("missing.npy").to_str().expect("plain path").to_string(), "missing.npy"),
    ] {
        let error = config().set("sites", &path).expect_err(wanted).to_string();
        assert!(error.contains(wanted) && error.lines().count() == 1, "{error}");
    }
}
