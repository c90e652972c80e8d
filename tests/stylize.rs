//! The styles against an independent f64 reference, the same bytes everywhere, and the `stylize` command.
//!
//! The 160x120 frames and their stages are in `tests/data/filters`. The full set of frames is checked when
//! `VERNISSAGE_REFERENCE` names the folder that holds `filters/inputs` and `filters/outputs`.

mod common;

use common::{FRAMES, data, frame, frame_of, text};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use vernissage::frame::Frame;
use vernissage::pixels::{Plane, Rgb, Size, SplitMix64, picture, simd};
use vernissage::style::cartoon::{Cartoon, Config, Stages};
use vernissage::style::{self, Style, StyleInput, StyleName, Styler};

/// One array of a reference file: its shape and values.
fn stage(frame: &str, name: &str) -> (Vec<u64>, Vec<f32>) {
    let path = data(&format!("{frame}__cartoon.npz"));
    let mut archive = npyz::npz::NpzArchive::open(&path).expect("reference stages");
    let array = archive.by_name(name).expect("readable").expect("a stage of this name");
    (array.shape().to_vec(), array.into_vec().expect("f32 values"))
}

/// Planes as one row-major array with the channel running fastest.
fn joined(planes: &[&Plane<f32>]) -> (Vec<u64>, Vec<f32>) {
    let size = planes[0].size();
    let mut shape = vec![size.height as u64, size.width as u64];
    if planes.len() > 1 {
        shape.push(planes.len() as u64);
    }
    let values = (0..size.area())
        .flat_map(|i| planes.iter().map(move |plane| plane.at(i % size.width, i / size.width)))
        .collect();
    (shape, values)
}

fn worst(label: &str, found: &(Vec<u64>, Vec<f32>), truth: &(Vec<u64>, Vec<f32>)) -> f64 {
    assert_eq!(found.0, truth.0, "{label}: shape");
    let error = |(a, b): (&f32, &f32)| (f64::from(*a) - f64::from(*b)).abs();
    found.1.iter().zip(&truth.1).map(error).fold(0.0, f64::max)
}

fn psnr(found: &[f32], truth: &[f32], peak: f64) -> f64 {
    let sum: f64 = found.iter().zip(truth).map(|(a, b)| square(f64::from(*a) - f64::from(*b))).sum();
    10.0 * (peak * peak * found.len() as f64 / sum.max(1e-30)).log10()
}

fn stages(name: &str) -> (Stages, Rgb) {
    let frame = frame(name);
    let mut out = Rgb::default();
    let input = StyleInput { frame: &frame, layer: None };
    let stages = Cartoon::new(Config::default(), simd::best()).stages(input, &mut out);
    (stages, out)
}

#[test]
fn every_stage_keeps_its_bound() {
    for name in FRAMES {
        let (stages, _) = stages(name);
        let small = joined(&stages.small.each_ref());
        let error = 255.0 * worst(name, &small, &stage(name, "small"));
        println!("{name}: small: {error:.6} levels (bound 1)");
        assert!(error <= 1.0, "{name}: small is off by {error} levels");

        let (simplified, truth) = (joined(&stages.simplified.each_ref()), stage(name, "S"));
        let error = 255.0 * worst(name, &simplified, &truth);
        let quality = psnr(&simplified.1, &truth.1, 1.0);
        println!("{name}: S: {error:.6} levels (bound 4), {quality:.1} dB (bound 70)");
        assert!(error <= 4.0, "{name}: S is off by {error} levels");
        assert!(quality >= 70.0, "{name}: S has {quality} dB");

        for (stage_name, plane) in [("eS", &stages.edge_s), ("eA", &stages.edge_a)] {
            let error = 255.0 * worst(name, &joined(&[plane]), &stage(name, stage_name));
            println!("{name}: {stage_name}: {error:.6} levels (bound .25)");
            assert!(error <= 0.25, "{name}: {stage_name} is off by {error} levels");
        }
        // the line strength rises from 0 to 1 over .01 of response: an error of eS is a hundred and fifty times as
        // large here, so its mean is what can be bounded
        let (found, truth) = (joined(&[&stages.lines]), stage(name, "I"));
        let off = found.1.iter().zip(&truth.1).filter(|(a, b)| (*a - *b).abs() > 2.0 / 255.0).count();
        println!("{name}: I: {off} of {} pixels off by more than 2 levels (bound .1 %)", found.1.len());
        assert!(off * 1000 <= found.1.len(), "{name}: I is off at {off} pixels");
    }
}

/// PSNR over all channels, mean SSIM of luma over 8x8 windows, share of pixels off by more than two levels.
fn compare(label: &str, found: &Rgb, truth: &Rgb) {
    let size = truth.size();
    assert_eq!(found.size(), size, "{label}: size");
    let bytes = |p: &Rgb| -> Vec<f32> {
        p.planes
            .iter()
            .flat_map(|plane| plane.rows().flatten().map(|&v| f32::from(v)).collect::<Vec<_>>())
            .collect()
    };
    let quality = psnr(&bytes(found), &bytes(truth), 255.0);
    let off = (0..size.area())
        .filter(|i| {
            let (a, b) = (found.at(i % size.width, i / size.width), truth.at(i % size.width, i / size.width));
            (0..3).any(|c| a[c].abs_diff(b[c]) > 2)
        })
        .count();
    let share = off as f64 / size.area() as f64;
    let similarity = ssim(found, truth);
    println!(
        "{label}: {quality:.1} dB (bound 55), SSIM {similarity:.6} (.999), off by > 2: {:.4} % (.1)",
        100.0 * share
    );
    assert!(quality >= 55.0, "{label}: {quality} dB");
    assert!(similarity >= 0.999, "{label}: SSIM {similarity}");
    assert!(share <= 0.001, "{label}: {off} pixels are off by more than two levels");
}

fn ssim(a: &Rgb, b: &Rgb) -> f64 {
    let luma = |p: &Rgb, x, y| {
        let [r, g, b] = p.at(x, y).map(f64::from);
        0.299 * r + 0.587 * g + 0.114 * b
    };
    let size = a.size();
    let (w, h) = (8.min(size.width), 8.min(size.height));
    let (c1, c2) = (square(0.01 * 255.0), square(0.03 * 255.0));
    let (mut sum, mut count) = (0.0, 0.0);
    for (x0, y0) in
        (0..=size.height - h).step_by(4).flat_map(|y| (0..=size.width - w).step_by(4).map(move |x| (x, y)))
    {
        let n = (w * h) as f64;
        let mut m = [0.0; 5];
        for (x, y) in (y0..y0 + h).flat_map(|y| (x0..x0 + w).map(move |x| (x, y))) {
            let (p, q) = (luma(a, x, y), luma(b, x, y));
            for (m, v) in m.iter_mut().zip([p, q, p * p, q * q, p * q]) {
                *m += v / n;
            }
        }
        let (va, vb, cov) = (m[2] - m[0] * m[0], m[3] - m[1] * m[1], m[4] - m[0] * m[1]);
        sum +=
            (2.0 * m[0] * m[1] + c1) * (2.0 * cov + c2) / ((m[0] * m[0] + m[1] * m[1] + c1) * (va + vb + c2));
        count += 1.0;
    }
    sum / count
}

fn drawn(style: StyleName, frame: &Frame, level: simd::Level, threads: usize) -> Rgb {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
    let config = style::Config { name: style, ..Default::default() };
    pool.install(|| {
        let mut out = Rgb::default();
        Styler::new(&config, level).draw(StyleInput { frame, layer: None }, &mut out);
        out
    })
}

#[test]
fn whole_pictures_keep_their_bounds() {
    for name in FRAMES {
        let truth = picture::read(&data(&format!("{name}__cartoon.png"))).expect("reference picture");
        let (_, tapped) = stages(name);
        let out = drawn(StyleName::Cartoon, &frame(name), simd::best(), 2);
        assert_eq!(out, tapped, "{name}: keeping the stages must not change the picture");
        compare(name, &out, &truth);
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
        let Some(input) = name.strip_suffix("__cartoon.png") else { continue };
        let input = picture::read(&filters.join("inputs").join(format!("{input}.png"))).expect("input");
        let out = drawn(StyleName::Cartoon, &frame_of(input), simd::best(), 2);
        compare(&name, &out, &picture::read(&path).expect("reference picture"));
        checked += 1;
    }
    assert!(checked >= 5, "only {checked} cartoon pictures in {}", filters.display());
}

#[test]
fn the_same_bytes_for_every_level_and_thread_count() {
    let photo = frame(FRAMES[0]).color;
    let mut rng = SplitMix64::new(5);
    let sizes =
        [(1, 1), (2, 1), (1, 7), (3, 2), (17, 9), (31, 64), (97, 53), (160, 120), (333, 211), (640, 480)];
    for (w, h) in sizes {
        let mut picture = Rgb::new(Size::new(w, h), [0; 3]);
        for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
            let [r, g, b] = photo.at(x % 160, y % 120);
            let noise = if x > w / 2 { (rng.next_u64() % 24) as u8 } else { 0 };
            picture.set(x, y, [r.saturating_add(noise), g, b.saturating_sub(noise)]);
        }
        let frame = frame_of(picture);
        let first = drawn(StyleName::Cartoon, &frame, simd::available()[0], 1);
        assert_eq!(first.size(), frame.size());
        for threads in [1, 2, 4] {
            for level in simd::available() {
                let other = drawn(StyleName::Cartoon, &frame, level, threads);
                assert!(other == first, "{w}x{h}: {} with {threads} threads differs", simd::name(level));
            }
        }
    }
}

#[test]
fn sizes_may_change_from_frame_to_frame() {
    let (coffee, stress) = (frame(FRAMES[0]), frame(FRAMES[1]));
    let part = |w: usize, h: usize| {
        let mut picture = Rgb::new(Size::new(w, h), [0; 3]);
        for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
            picture.set(x, y, coffee.color.at(x, y));
        }
        frame_of(picture)
    };
    let frames = [
        coffee.clone(),
        part(40, 100),
        stress,
        part(1, 1),
        frame_of(Rgb::default()),
        part(157, 3),
        coffee.clone(),
    ];
    let mut style = Cartoon::new(Config::default(), simd::best());
    let mut out = Rgb::default();
    for frame in &frames {
        style.draw(StyleInput { frame, layer: None }, &mut out);
        let mut fresh = Rgb::default();
        Cartoon::new(Config::default(), simd::best()).draw(StyleInput { frame, layer: None }, &mut fresh);
        assert!(out == fresh, "{}: the frame before shows through", frame.size());
    }
}

#[test]
fn extreme_settings_draw_something() {
    let frame = frame(FRAMES[1]);
    for settings in [
        "steps=0",
        "beta=0",
        "beta=1",
        "alpha=0",
        "alpha=1",
        "s0=0",
        "a0=0",
        "sigma_p=10",
        "sigma_p=.001",
        "shrunk_width=1",
        "shrunk_height=1",
        "shrunk_width=160",
        "shrunk_height=65535",
        "a1=100",
    ] {
        let (key, value) = settings.split_once('=').expect("key=value");
        let mut config = style::Config::default();
        config.set(key, value).expect(settings);
        let mut pictures = simd::available().into_iter().map(|level| {
            let mut out = Rgb::default();
            Styler::new(&config, level).draw(StyleInput { frame: &frame, layer: None }, &mut out);
            out
        });
        let first = pictures.next().expect("a level");
        assert!(pictures.all(|other| other == first), "{settings}: levels differ");
        let mut out = Rgb::default();
        let input = StyleInput { frame: &frame, layer: None };
        let stages = Cartoon::new(config.cartoon, simd::best()).stages(input, &mut out);
        assert!(out == first, "{settings}: skipping changed the picture");
        assert!(
            stages.lines.samples().iter().all(|v| (0.0..=1.0001).contains(v)),
            "{settings}: line strength"
        );
    }
}

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vernissage"))
        .arg("stylize")
        .args(arguments)
        .output()
        .expect("the program runs")
}

fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("temporary folder");
    folder
}

#[test]
fn the_command_draws_times_and_writes_stages() {
    let folder = folder("stylize-command");
    let (input, out) = (data("micro_coffee_160x120.png"), folder.join("out.png"));
    let stages = folder.join("stages");
    let done = run(&[
        "--style",
        "cartoon",
        "--threads",
        "1",
        text(&input),
        "--out",
        text(&out),
        "--stages",
        text(&stages),
        "--repeat",
        "4",
        "--json",
    ]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let line: serde_json::Value = serde_json::from_slice(&done.stdout).expect("one JSON object");
    assert_eq!((line["style"].as_str(), line["threads"].as_u64()), (Some("cartoon"), Some(1)));
    assert!(line["image"].as_str().is_some_and(|image| image.ends_with("micro_coffee_160x120.png")));
    assert_eq!(line["ms"].as_array().map(Vec::len), Some(4));
    let picture = picture::read(&out).expect("the result");
    assert_eq!(picture, drawn(StyleName::Cartoon, &frame(FRAMES[0]), simd::best(), 1));
    for (name, shape) in [
        ("small", vec![45, 60, 3]),
        ("S", vec![45, 60, 3]),
        ("eS", vec![120, 160]),
        ("eA", vec![120, 160]),
        ("I", vec![120, 160]),
    ] {
        let bytes = std::fs::read(stages.join(format!("{name}.npy"))).expect("stage file");
        let array = npyz::NpyFile::new(&bytes[..]).expect("npy");
        assert_eq!(array.shape(), shape, "{name}");
        let found = (shape, array.into_vec::<f32>().expect("f32"));
        assert!(worst(name, &found, &stage(FRAMES[0], name)) < 0.1, "{name}");
    }

    let several = folder.join("several");
    let done = run(&[
        "--style",
        "plain",
        text(&input),
        text(&data("micro_stress_160x120.png")),
        "--out",
        text(&several),
    ]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    for name in FRAMES {
        let copy = picture::read(&several.join(format!("{name}.png"))).expect("the result");
        assert_eq!(copy, frame(name).color, "plain without models is the picture itself");
    }
    let again = folder.join("again");
    let done = run(&["--style", "cartoon", text(&several), "--out", text(&again)]);
    assert!(done.status.success());
    assert_eq!(std::fs::read_dir(&again).expect("a folder").count(), 2, "a folder's pictures, one by one");
}

#[test]
fn bad_input_is_refused_in_one_clear_line() {
    let folder = folder("stylize-refusals");
    let input = data("micro_coffee_160x120.png");
    let bytes = std::fs::read(&input).expect("picture");
    let cut = folder.join("cut.png");
    std::fs::write(&cut, &bytes[..bytes.len() / 3]).expect("temporary file");
    let out = folder.join("out.png");
    let out = text(&out);
    let (missing, cut, input) = (folder.join("missing.png"), text(&cut), text(&input));
    let missing = text(&missing);
    for (arguments, wanted) in [
        (vec!["--style", "cartoon", missing, "--out", out], "missing.png"),
        (vec!["--style", "cartoon", cut, "--out", out], "cut.png"),
        (vec!["--style", "cartoon", "--set", "sigma=1", input, "--out", out], "sigma_p"),
        (vec!["--style", "cartoon", "--set", "steps", input, "--out", out], "key=value"),
        (vec!["--style", "cartoon", "--set", "beta=2", input, "--out", out], "beta"),
        (vec!["--style", "cartoon", "--threads", "0", input, "--out", out], "--threads"),
        (vec!["--style", "cartoon", input, input, "--out", out], "same name"),
        (vec!["--style", "cartoon", "-", "--out", out], "many frames"),
    ] {
        let done = run(&arguments);
        let message = String::from_utf8_lossy(&done.stderr).into_owned();
        assert_eq!(done.status.code(), Some(2), "{arguments:?}: {message}");
        assert!(message.contains(wanted), "{arguments:?}: {message}");
        assert_eq!(message.trim_end().lines().count(), 1, "{arguments:?}: {message}");
        assert!(done.stdout.is_empty());
    }
    let done = run(&["--style", "cartoony", input, "--out", out]);
    assert_eq!(done.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&done.stderr).contains("cartoon"));
}

fn square(v: f64) -> f64 {
    v * v
}
