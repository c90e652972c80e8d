//! Bilateral cartoon and sketch-like against an independent f64 reference, the same bytes everywhere, sizes and
//! settings, stages.
//!
//! The 160x120 frames and their stages are in `tests/data/filters`. The full set of frames is checked when
//! `VERNISSAGE_REFERENCE` names the folder that holds `filters/inputs` and `filters/outputs`.

mod common;

use common::{FRAMES, data, frame, frame_of};
use std::path::Path;
use std::process::Command;
use vernissage::frame::Frame;
use vernissage::pixels::{Plane, Rgb, Size, picture, simd};
use vernissage::style::bilateral::{BilateralCartoon, Config, SketchLike};
use vernissage::style::{self, StyleInput, StyleName, Styler};

const STYLES: [StyleName; 2] = [StyleName::BilateralCartoon, StyleName::SketchLike];

/// Part of the photograph, mirrored where it ends.
fn part(size: Size) -> Frame {
    let photo = frame(FRAMES[0]).color;
    let fold = |i: usize, n: usize| if (i / n).is_multiple_of(2) { i % n } else { n - 1 - i % n };
    let mut picture = Rgb::new(size, [0; 3]);
    for (x, y) in (0..size.height).flat_map(|y| (0..size.width).map(move |x| (x, y))) {
        picture.set(x, y, photo.at(fold(x, 160), fold(y, 120)));
    }
    frame_of(picture)
}

fn drawn(config: &style::Config, frame: &Frame, level: simd::Level, threads: usize) -> Rgb {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
    pool.install(|| {
        let mut out = Rgb::default();
        Styler::new(config, level).draw(StyleInput { frame, layer: None }, &mut out);
        out
    })
}

fn named(name: StyleName) -> style::Config {
    style::Config { name, ..style::Config::default() }
}

fn array<T: npyz::Deserialize>(frame: &str, name: &str) -> Vec<T> {
    let path = data(&format!("{frame}__cartoon_original.npz"));
    let mut archive = npyz::npz::NpzArchive::open(&path).expect("reference stages");
    let array = archive.by_name(name).expect("readable").expect("a stage of this name");
    array.into_vec().expect("values of this kind")
}

/// Largest difference of planes from one array with the channel running fastest.
fn worst(planes: &[Plane<f32>; 3], truth: &[f32]) -> f64 {
    let size = planes[0].size();
    assert_eq!(truth.len(), 3 * size.area());
    let error =
        |i: usize| f64::from(planes[i % 3].at(i / 3 % size.width, i / 3 / size.width) - truth[i]).abs();
    (0..truth.len()).map(error).fold(0.0, f64::max)
}

#[test]
fn every_stage_keeps_its_bound() {
    for name in FRAMES {
        let frame = frame(name);
        let input = StyleInput { frame: &frame, layer: None };
        let mut out = Rgb::default();
        let stages = BilateralCartoon::new(Config::default(), simd::best()).stages(input, &mut out);
        let error = 255.0 * worst(&stages.filtered, &array(name, "small"));
        println!("{name}: filtered: {error:.6} levels (bound 1)");
        assert!(error <= 1.0, "{name}: filtered is off by {error} levels");
        let edges: Vec<bool> = array(name, "edge");
        let wrong = edges.iter().zip(stages.edges.samples()).filter(|(a, b)| **a != (**b == 1.0)).count();
        println!("{name}: edges: {wrong} mismatches (bound 0)");
        assert_eq!(wrong, 0, "{name}: edges");
        let truth: Vec<f32> = array(name, "out");
        let found = |i: usize| f64::from(out.at(i / 3 % 160, i / 3 / 160)[i % 3]);
        let error =
            (0..truth.len()).map(|i| (found(i) - 255.0 * f64::from(truth[i])).abs()).fold(0.0, f64::max);
        println!("{name}: picture before rounding: {error:.4} levels (half a level is the rounding)");
        assert!(error <= 0.51, "{name}: the picture is off by {error} levels");

        let mut sketch = Rgb::default();
        let lines = SketchLike::new(Default::default(), simd::best()).edges(input, &mut sketch);
        assert_eq!(lines, stages.edges, "{name}: both styles draw the same edges");
        for (i, &edge) in edges.iter().enumerate() {
            let white = if edge { 0 } else { 255 };
            assert_eq!(sketch.at(i % 160, i / 160), [white; 3], "{name}: pixel {i}");
        }
    }
}

/// Bytes may differ by one level where the exact value lies on a rounding tie; edges may not differ at all.
fn compare(label: &str, found: &Rgb, truth: &Rgb) {
    let size = truth.size();
    assert_eq!(found.size(), size, "{label}: size");
    let (mut largest, mut off, mut squares) = (0, 0, 0.0);
    for (x, y) in (0..size.height).flat_map(|y| (0..size.width).map(move |x| (x, y))) {
        let (a, b) = (found.at(x, y), truth.at(x, y));
        for c in 0..3 {
            let miss = a[c].abs_diff(b[c]);
            largest = largest.max(miss);
            off += usize::from(miss > 0);
            squares += f64::from(miss) * f64::from(miss);
        }
    }
    let mean: f64 = squares / (3 * size.area()) as f64;
    let psnr = 10.0 * (255.0 * 255.0 / mean.max(1e-30)).log10();
    println!("{label}: at most {largest} levels (bound 1), {off} samples differ, {psnr:.1} dB (55)");
    assert!(largest <= 1, "{label}: off by {largest} levels");
    assert!(psnr >= 55.0 || off < 10, "{label}: {psnr} dB");
}

#[test]
fn whole_pictures_keep_their_bounds() {
    for name in FRAMES {
        let truth =
            picture::read(&data(&format!("{name}__cartoon_original.png"))).expect("reference picture");
        compare(name, &drawn(&named(StyleName::BilateralCartoon), &frame(name), simd::best(), 2), &truth);
    }
}

#[test]
fn the_full_reference_set_keeps_its_bounds() {
    let Ok(folder) = std::env::var("VERNISSAGE_REFERENCE") else {
        eprintln!(
            "NOT RUN: the full set of reference pictures. Set VERNISSAGE_REFERENCE to the folder with filters/"
        );
        return;
    };
    let filters = Path::new(&folder).join("filters");
    let mut checked = 0;
    for entry in std::fs::read_dir(filters.join("outputs")).expect("filters/outputs") {
        let path = entry.expect("entry").path();
        let name = path.file_name().and_then(|n| n.to_str()).unwrap_or_default().to_string();
        let Some(input) = name.strip_suffix("__cartoon_original.png") else { continue };
        let input = picture::read(&filters.join("inputs").join(format!("{input}.png"))).expect("input");
        let out = drawn(&named(StyleName::BilateralCartoon), &frame_of(input), simd::best(), 2);
        compare(&name, &out, &picture::read(&path).expect("reference picture"));
        checked += 1;
    }
    assert!(checked >= 5, "only {checked} pictures in {}", filters.display());
}

#[test]
fn the_fast_forms_keep_to_the_plain_ones_at_odd_sizes_and_settings() {
    let settings: [(StyleName, &[&str]); 7] = [
        (StyleName::BilateralCartoon, &[]),
        (StyleName::BilateralCartoon, &["levels=1", "iterations=1", "sigma_d=.7"]),
        (StyleName::BilateralCartoon, &["levels=4", "iterations=0", "t2=0", "t1=20"]),
        (StyleName::BilateralCartoon, &["levels=8", "sigma_r=1", "sigma_d=100"]),
        (StyleName::BilateralCartoon, &["sigma_r=.001", "sigma_d=.1", "t1=2040"]),
        (StyleName::SketchLike, &[]),
        (StyleName::SketchLike, &["t1=0", "t2=0"]),
    ];
    // t2 is set first where the defaults would forbid the new t1
    for (name, settings) in settings {
        let mut config = named(name);
        let mut ordered = settings.to_vec();
        ordered.sort_by_key(|setting| !setting.starts_with("t2"));
        for setting in ordered {
            let (key, value) = setting.split_once('=').expect("key=value");
            config.set(key, value).expect(setting);
        }
        for (w, h) in [(1, 1), (2, 1), (1, 7), (3, 2), (17, 9), (31, 64), (97, 53)] {
            let frame = part(Size::new(w, h));
            let exact = style::reference(&config, &frame.color);
            let out = drawn(&config, &frame, simd::best(), 2);
            compare(&format!("{name} {settings:?} {w}x{h}"), &out, &exact);
        }
    }
}

#[test]
fn the_same_bytes_for_every_level_and_thread_count() {
    for style in STYLES {
        for (w, h) in [(1, 1), (2, 1), (1, 7), (17, 9), (31, 64), (97, 53), (333, 211), (640, 480)] {
            let frame = part(Size::new(w, h));
            let first = drawn(&named(style), &frame, simd::available()[0], 1);
            for threads in [1, 2, 4] {
                for level in simd::available() {
                    let other = drawn(&named(style), &frame, level, threads);
                    assert!(other == first, "{style} {w}x{h}: {} with {threads} differs", simd::name(level));
                }
            }
        }
    }
}

#[test]
fn sizes_may_change_from_frame_to_frame() {
    let frames = [(160, 120), (40, 100), (1, 1), (0, 0), (157, 3), (160, 120), (161, 121)]
        .map(|(w, h)| part(Size::new(w, h)));
    for style in STYLES {
        let mut styler = Styler::new(&named(style), simd::best());
        let mut out = Rgb::default();
        for frame in &frames {
            styler.draw(StyleInput { frame, layer: None }, &mut out);
            let mut fresh = Rgb::default();
            let input = StyleInput { frame, layer: None };
            Styler::new(&named(style), simd::best()).draw(input, &mut fresh);
            assert!(out == fresh, "{style} {}: the frame before shows through", frame.size());
        }
    }
}

#[test]
fn settings_out_of_range_are_refused_by_name() {
    for (style, key, value) in [
        (StyleName::BilateralCartoon, "levels", "0"),
        (StyleName::BilateralCartoon, "levels", "9"),
        (StyleName::BilateralCartoon, "sigma_d", "0"),
        (StyleName::BilateralCartoon, "sigma_r", "nan"),
        (StyleName::BilateralCartoon, "t2", "151"),
        (StyleName::SketchLike, "t1", "2041"),
        (StyleName::SketchLike, "t1", "100"),
        (StyleName::SketchLike, "levels", "2"),
    ] {
        let error = named(style).set(key, value).expect_err(value).to_string();
        assert!(error.contains(key) && error.contains(style.name()), "{error}");
    }
    let text = "name = 'sketch-like'\n[bilateral-cartoon]\nlevels = 3\n[sketch-like]\nt1 = 200\n";
    let config: style::Config = toml::from_str(text).expect("tables named as the styles");
    assert_eq!((config.bilateral_cartoon.levels, config.sketch_like.t1), (3, 200.0));
}

#[test]
fn the_command_writes_the_stages() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("stylize-bilateral");
    let _ = std::fs::remove_dir_all(&folder);
    for (style, wanted) in [
        (
            "bilateral-cartoon",
            &[("pyramid", [30, 40, 3].as_slice()), ("filtered", &[30, 40, 3]), ("edges", &[120, 160])][..],
        ),
        ("sketch-like", &[("edges", &[120, 160])]),
    ] {
        let stages = folder.join(style);
        let done = Command::new(env!("CARGO_BIN_EXE_vernissage"))
            .args(["stylize", "--style", style, "--stages"])
            .arg(&stages)
            .arg(data("micro_coffee_160x120.png"))
            .output()
            .expect("the program runs");
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        for (name, shape) in wanted {
            let bytes = std::fs::read(stages.join(format!("{name}.npy"))).expect("stage file");
            let array = npyz::NpyFile::new(&bytes[..]).expect("npy");
            assert_eq!(array.shape(), *shape, "{style} {name}");
            let values: Vec<f32> = array.into_vec().expect("f32");
            if *name == "filtered" {
                let truth: Vec<f32> = self::array(FRAMES[0], "small");
                assert!(values.iter().zip(&truth).all(|(a, b)| (a - b).abs() < 1e-5));
            }
        }
    }
}
