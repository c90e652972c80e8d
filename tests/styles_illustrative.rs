//! The illustrative style against an independent f64 reference and its own, the same bytes everywhere.
//!
//! The 160x120 frames and their stages are in `tests/data/filters`. The full set of frames is checked when
//! `VERNISSAGE_REFERENCE` names the folder that holds `filters/inputs` and `filters/outputs`.

mod common;

use common::{FRAMES, data, frame, frame_of, stage, worst};
use std::path::Path;
use vernissage::pixels::{Rgb, Size, picture, simd};
use vernissage::style::illustrative::{Config, Illustrative, halftone};
use vernissage::style::{self, Style, StyleInput, StyleName, Styler};

/// Pixels whose color is another than the reference's, `ambiguous` ones left out.
fn flips(found: &Rgb, truth: &Rgb, ambiguous: impl Fn(usize, usize) -> bool) -> usize {
    let size = truth.size();
    assert_eq!(found.size(), size);
    let all = (0..size.area()).map(|i| (i % size.width, i / size.width));
    all.filter(|&(x, y)| found.at(x, y) != truth.at(x, y) && !ambiguous(x, y)).count()
}

fn config() -> style::Config {
    style::Config { name: StyleName::Illustrative, ..Default::default() }
}

#[test]
fn every_stage_keeps_its_bound() {
    for name in FRAMES {
        let path = data(&format!("{name}__illustrative.npz"));
        let frame = frame(name);
        let width = frame.color.size().width;
        let input = StyleInput { frame: &frame, layer: None };
        let (mut tapped, mut out) = (Rgb::default(), Rgb::default());
        let mut style = Illustrative::new(Config::default(), simd::best());
        let stages = style.stages(input, &mut tapped);
        for (label, plane, truth) in [
            ("response", &stages.response, "edge"),
            ("intensity", &stages.intensity, "I"),
            ("halftone", &stages.halftone, "tau"),
        ] {
            let error = 255.0 * worst(plane.rows().flatten().copied(), &stage(&path, truth));
            println!("{name}: {label}: {error:.6} levels (bound .25)");
            assert!(error <= 0.25, "{name}: {label} is off by {error} levels");
        }
        style.draw(input, &mut out);
        assert!(out == tapped, "{name}: keeping the stages must not change the picture");
        let truth = picture::read(&data(&format!("{name}__illustrative.png"))).expect("reference picture");
        let ambiguous = stage(&path, "amb");
        let clear = flips(&out, &truth, |x, y| ambiguous[y * width + x] != 0.0);
        let all = flips(&out, &truth, |_, _| false);
        println!("{name}: {clear} clear flips (bound 0), {all} with the ambiguous ones");
        assert_eq!(clear, 0, "{name}: flips");
        assert_eq!(
            flips(&out, &style::reference(&config(), &frame.color), |x, y| ambiguous[y * width + x] != 0.0),
            0
        );
    }
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
        let truth = filters.join("outputs").join(format!("{name}__illustrative.png"));
        let truth = picture::read(&truth).expect("reference picture");
        let frame = frame_of(input);
        let mut out = Rgb::default();
        let mut style = Illustrative::new(Config::default(), simd::best());
        let stages = style.stages(StyleInput { frame: &frame, layer: None }, &mut out);
        // too close to call: within 5e-5 of a threshold, or where the halftone itself jumps
        let close = |x: usize, y: usize| {
            let tau = f64::from(stages.halftone.at(x, y));
            let brightness = 1.6 * f64::from(stages.intensity.at(x, y));
            let near = |a: f64, b: f64| (a - b).abs() <= 5e-5;
            near(f64::from(stages.response.at(x, y)), 0.1125)
                || near(brightness, tau)
                || [19.9999, 20.0001].iter().any(|&turn| (halftone(turn, 4.0, 0.9, x, y) - tau).abs() > 0.02)
        };
        let (clear, all) = (flips(&out, &truth, close), flips(&out, &truth, |_, _| false));
        println!("{name}: {clear} clear flips (bound 0), {all} with the ambiguous ones");
        assert_eq!(clear, 0, "{name}");
    }
}

#[test]
fn the_same_bytes_for_every_level_and_thread_count() {
    let photo = frame(FRAMES[0]).color;
    for (w, h) in [(1, 1), (2, 9), (17, 5), (97, 53), (160, 120)] {
        for settings in ["gamma=1.6", "edge_threshold=0", "alpha=1", "n=256", "theta=-360", "c_cross=1"] {
            let mut part = Rgb::new(Size::new(w, h), [0; 3]);
            for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
                part.set(x, y, photo.at(x, y));
            }
            let frame = frame_of(part);
            let mut config = config();
            let (key, value) = settings.split_once('=').expect("key=value");
            config.set(key, value).expect(settings);
            let mut first: Option<Rgb> = None;
            for threads in [1, 2, 4] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
                for level in simd::available() {
                    let drawn = pool.install(|| {
                        let mut out = Rgb::default();
                        Styler::new(&config, level).draw(StyleInput { frame: &frame, layer: None }, &mut out);
                        out
                    });
                    let first = first.get_or_insert_with(|| drawn.clone());
                    assert!(
                        *first == drawn,
                        "{w}x{h}, {settings}: {} x {threads} differs",
                        simd::name(level)
                    );
                }
            }
        }
    }
}
