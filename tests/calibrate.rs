//! `vernissage calibrate`: the lens that drew the pictures is found again, and what decides none is refused.

use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use vernissage::app::bench::markers::{Background, Blur, Light, SIDE_MM, Setup};
use vernissage::calibration::LensConfig;
use vernissage::geometry::{Lens, Pose};
use vernissage::marker::{Family, Grid};
use vernissage::pixels::{Size, SplitMix64};

const SIZE: Size = Size { width: 640, height: 480 };

fn truth() -> Lens {
    Lens {
        size: SIZE,
        focal: DVec2::new(571.3, 566.8),
        center: DVec2::new(327.4, 231.9),
        distortion: [-0.24, 0.09, 8e-4, -1.1e-3, -0.015, 0.0, 0.0, 0.0],
    }
}

fn vernissage(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vernissage")).args(args).output().expect("the built binary runs")
}

/// A folder of this test's own, empty.
fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("calibrate").join(name);
    _ = std::fs::remove_dir_all(&path);
    std::fs::create_dir_all(&path).expect("a test folder");
    path
}

fn text(path: &Path) -> &str {
    path.to_str().expect("plain path")
}

/// Pictures of the 5x7 sheet as a hand would take them: tilted up to `tilt` degrees, near and far, towards the corners;
/// noise of two gray levels, a lens blurred by .6 px, a ramp of light.
fn film(folder: &Path, family: Family, count: usize, tilt: f64) {
    let grid = Grid { family, first: 0, columns: 5, rows: 7, side_mm: SIDE_MM };
    let board = grid.board().expect("a board");
    let shoot = |number: usize| {
        let mut rng = SplitMix64::new(77 + number as u64);
        let mut between = |low: f64, high: f64| low + (high - low) * rng.f64();
        let turn = between(0.0, std::f64::consts::TAU);
        let axis = DVec3::new(libm::cos(turn), libm::sin(turn), 0.0);
        let lying = if number.is_multiple_of(2) { 0.0 } else { std::f64::consts::FRAC_PI_2 };
        let rotation = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0))
            * DMat3::from_axis_angle(axis, between(0.5, 1.0) * tilt.to_radians())
            * DMat3::from_axis_angle(DVec3::Z, lying + between(-0.3, 0.3));
        let far = between(850.0, 1300.0);
        // four of five towards a corner
        let [x, y] = [[-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [0.0, 0.0]][number % 5];
        let middle = DVec3::new(x * between(0.1, 0.26), y * between(0.05, 0.2), 1.0) * far;
        let sheet = Pose { rotation, translation: middle };
        let prints = board.prints.iter().map(|print| (print.id, sheet.after(&print.to_board))).collect();
        let setup = Setup {
            inks: [28.0, 205.0],
            background: Background::Texture,
            light: Light::EVEN,
            blur: Blur::Gaussian(0.6),
            ..Setup::calm(&truth(), family, prints, 5 + number as u64)
        };
        let picture = setup.shoot();
        let mut bytes = format!("P5\n{} {}\n255\n", SIZE.width, SIZE.height).into_bytes();
        picture.rows().for_each(|row| bytes.extend_from_slice(row));
        std::fs::write(folder.join(format!("{number:03}.pgm")), bytes).expect("a picture");
    };
    (0..count).into_par_iter().for_each(shoot);
}

#[test]
fn the_lens_that_drew_the_pictures_is_found_again() {
    let here = folder("found");
    let pictures = here.join("pictures");
    std::fs::create_dir(&pictures).expect("a folder");
    film(&pictures, Family::Tag36h11, 20, 45.0);
    let out = here.join("lens");
    let output = vernissage(&["calibrate", text(&pictures), "--out", text(&out), "--json"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let told: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    println!("{told:#}");
    let value = |name: &str| told["lens"][name].as_f64().expect(name);
    let part = |name: &str, truth: f64| (value(name) / truth - 1.0).abs();
    let lens = truth();
    for (name, truth) in
        [("fx", lens.focal.x), ("fy", lens.focal.y), ("cx", lens.center.x), ("cy", lens.center.y)]
    {
        assert!(part(name, truth) < 0.001, "{name} = {}, not {truth}", value(name));
    }
    assert!(part("k1", lens.distortion[0]) < 0.02, "k1 = {}", value("k1"));
    // distortion is what it does to the picture: over all of it, within 2 % of the most it does
    let k = ["k1", "k2", "p1", "p2", "k3"].map(value);
    let found = Lens { distortion: [k[0], k[1], k[2], k[3], k[4], 0.0, 0.0, 0.0], ..lens };
    let (mut most, mut worst) = (0.0f64, 0.0f64);
    for y in (0..480).step_by(8) {
        for x in (0..640).step_by(8) {
            let Some(ray) = lens.undistort(DVec2::new(x as f64, y as f64)) else { continue };
            most = most.max(((lens.distort(ray) - ray) * lens.focal).length());
            worst = worst.max(((found.distort(ray) - lens.distort(ray)) * lens.focal).length());
        }
    }
    println!("distortion moves by up to {most:.2} px, found to {worst:.4} px");
    assert!(most > 20.0 && worst < 0.02 * most, "{worst} of {most} px");
    assert!(told["rms_px"].as_f64().expect("rms") < 0.12, "{told}");

    // what was written says the same, and is taken where a lens is asked for
    for ending in ["toml", "yaml", "ros.yaml"] {
        let path = here.join(format!("lens.{ending}"));
        let read = LensConfig::read(&path).expect("a calibration");
        for (read, name) in [(read.fx, "fx"), (read.cy, "cy"), (read.dist[0], "k1")] {
            // the test's reader of JSON rounds the last bit as it likes
            assert!((read - value(name)).abs() <= f64::EPSILON * read.abs(), "{ending}: {name} {read}");
        }
        let plan = vernissage(&["plan", "--model", "teapot", "--lens", text(&path)]);
        assert!(String::from_utf8_lossy(&plan.stdout).contains("lens    calibrated, 640x480"), "{ending}");
    }
    let visor = here.join("visor.toml");
    std::fs::write(&visor, "[lens]\nfile = \"lens.yaml\"\n").expect("a visor file");
    let plan = vernissage(&["plan", "--config", text(&visor)]);
    assert!(String::from_utf8_lossy(&plan.stdout).contains("lens    calibrated"));
    let plot = std::fs::read_to_string(here.join("lens.svg")).expect("a plot");
    assert!(plot.starts_with("<svg") && plot.matches("<circle").count() > 1000);
}

fn refused(pictures: &Path, says: &str) {
    let out = pictures.join("lens");
    let output = vernissage(&["calibrate", text(pictures), "--out", text(&out)]);
    let told = String::from_utf8_lossy(&output.stderr);
    assert_eq!((output.status.code(), told.lines().count()), (Some(2), 1), "{told}");
    assert!(told.contains(says), "{told}");
    assert!(!out.with_extension("toml").exists());
}

#[test]
fn pictures_that_decide_no_lens_are_refused_with_what_is_missing() {
    let here = folder("flat");
    film(&here, Family::Tag36h11, 8, 1.0);
    refused(&here, "tilt it by 30°");
    let here = folder("few");
    film(&here, Family::Tag36h11, 2, 40.0);
    refused(&here, "2 pictures show the sheet well enough");
    let here = folder("other");
    film(&here, Family::Aruco5x5_50, 3, 40.0);
    refused(&here, "the pictures show aruco_5x5_50 markers: give --family aruco_5x5_50");
    let here = folder("sizes");
    film(&here, Family::Tag36h11, 1, 40.0);
    std::fs::write(here.join("zz.pgm"), b"P5\n2 2\n255\n1234").expect("a picture");
    refused(&here, "one calibration is of one size");
}

#[test]
fn damaged_calibrations_are_answered_at_once_and_never_panic() {
    let lens = LensConfig::of(&truth());
    let texts = [lens.to_opencv(0.1), lens.to_ros("visor"), lens.to_toml("x")];
    let mut rng = SplitMix64::new(8);
    let mut slowest = std::time::Duration::ZERO;
    for round in 0..30_000usize {
        let mut bytes = texts[round % 3].clone().into_bytes();
        for _ in 0..rng.int(1, 6) {
            if bytes.is_empty() {
                break;
            }
            let at = rng.int(0, bytes.len() as i64 - 1) as usize;
            match rng.int(0, 4) {
                0 => bytes[at] = rng.int(0, 255) as u8,
                1 => bytes.truncate(at + 1),
                2 => drop(bytes.remove(at)),
                3 => bytes.insert(at, b"[]{}:-?&*!|>'\"%@,#\n\t "[rng.int(0, 20) as usize]),
                _ => bytes.extend_from_within(at..),
            }
        }
        let start = std::time::Instant::now();
        if let Err(error) = LensConfig::parse(&bytes, round % 3 == 2) {
            assert!(!error.reason.contains('\n') && error.line >= 1, "{error:?}");
        }
        slowest = slowest.max(start.elapsed());
    }
    for (open, close) in [("[", "]"), ("{a: ", "}"), ("- ", ""), ("? ", ""), ("&a ", ""), ("\"", "\n")] {
        let deep = open.repeat(60_000 / open.len()) + &close.repeat(2000);
        let start = std::time::Instant::now();
        LensConfig::parse(deep.as_bytes(), false).expect_err("no calibration");
        slowest = slowest.max(start.elapsed());
        println!("{open:?}: {:?}", start.elapsed());
    }
    println!("slowest {slowest:?}");
    let output = vernissage(&["plan", "--model", "teapot", "--lens", "nowhere.yaml"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("nowhere.yaml: cannot read the calibration"));
}
