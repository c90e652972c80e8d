//! The tracker against exact truth: a plain f64 renderer draws printed markers on a textured table, through
//! the lens, with blur and noise; recall, corners and poses are held to what was drawn.

use glam::{DMat3, DVec2, DVec3};
use std::f64::consts::TAU;
use vernissage::frame::Sighting;
use vernissage::geometry::{Homography, Lens, Pose};
use vernissage::marker::Family;
use vernissage::pixels::simd::{self, Level};
use vernissage::pixels::{Plane, PlaneRef, Size, SplitMix64};
use vernissage::track::{Config, Tracker, Wanted, solve};

const SIDE_MM: f64 = 80.0;

/// Families that prove themselves, of every number of bits but the largest.
const FAMILIES: [Family; 4] =
    [Family::Tag36h11, Family::Aruco4x4_50, Family::Aruco5x5_100, Family::Aruco6x6_250];

/// A marker as drawn.
#[derive(Clone, Copy)]
struct Print {
    family: Family,
    id: u32,
    pose: Pose,
}

/// How a frame looks.
#[derive(Clone, Copy)]
struct Look {
    sigma_blur: f64,
    sigma_noise: f64,
    black: f64,
    white: f64,
    /// Texture amplitude of the table, gray levels.
    clutter: f64,
}

const EASY: Look = Look { sigma_blur: 0.5, sigma_noise: 2.0, black: 30.0, white: 210.0, clutter: 60.0 };

fn rotation(axis: DVec3, angle: f64) -> DMat3 {
    DMat3::from_axis_angle(axis / axis.length(), angle)
}

/// A pose whose marker is about `side_px` large at `center`, turned by `spin` and tilted by `tilt` radians.
fn pose_at(lens: &Lens, center: DVec2, side_px: f64, spin: f64, tilt: f64, tilt_about: f64) -> Pose {
    let z = lens.focal.x * SIDE_MM / side_px;
    let ray = lens.undistort(center).expect("inside the picture");
    let facing = DMat3::from_cols(DVec3::X, -DVec3::Y, -DVec3::Z);
    let about = DVec3::new(libm::cos(tilt_about), libm::sin(tilt_about), 0.0);
    Pose {
        rotation: rotation(about, tilt) * facing * rotation(DVec3::Z, spin),
        translation: ray.extend(1.0) * z,
    }
}

/// The true corners in the picture.
fn corners(lens: &Lens, pose: &Pose) -> [DVec2; 4] {
    solve::corners_mm(SIDE_MM).map(|p| lens.project(pose.apply(p)).expect("before the camera"))
}

/// Smooth noise in 0..1 by bilinear interpolation of a hashed grid.
fn texture(p: DVec2, cell: f64, seed: u64) -> f64 {
    let (x, y) = (p.x / cell + 1000.0, p.y / cell + 1000.0);
    let (i, j) = (x.floor(), y.floor());
    let at = |i: f64, j: f64| {
        (vernissage::pixels::hash_noise(i as u32, j as u32, seed, 0) >> 40) as f64 / (1u64 << 24) as f64
    };
    let (s, t) = (x - i, y - j);
    (at(i, j) * (1.0 - s) + at(i + 1.0, j) * s) * (1.0 - t)
        + (at(i, j + 1.0) * (1.0 - s) + at(i + 1.0, j + 1.0) * s) * t
}

/// The frame: area-sampled with 6x6 points a pixel on the prints, then blurred, lit unevenly, made noisy.
fn draw(lens: &Lens, prints: &[Print], look: Look, seed: u64) -> Plane<u8> {
    let Size { width, height } = lens.size;
    let mut frame = vec![0.0; width * height];
    for y in 0..height {
        for x in 0..width {
            let p = DVec2::new(x as f64, y as f64);
            let rough = texture(p, 9.0, seed) + texture(p, 31.0, seed + 1) - 1.0;
            frame[y * width + x] = 0.5 * (look.black + look.white) + look.clutter * rough;
        }
    }
    for print in prints {
        let picture = print.family.picture(print.id).expect("known id");
        let cells = print.family.cells() as f64;
        let r = print.pose.rotation;
        let plane = DMat3::from_cols(r.x_axis, r.y_axis, print.pose.translation).inverse();
        let reach = solve::corners_mm(SIDE_MM * (1.0 + 2.0 / cells));
        let outer = reach.map(|p| lens.project(print.pose.apply(p)).expect("before the camera"));
        let low = outer.iter().fold(DVec2::INFINITY, |a, b| a.min(*b)) - 4.0;
        let high = outer.iter().fold(DVec2::NEG_INFINITY, |a, b| a.max(*b)) + 4.0;
        for y in low.y.max(0.0) as usize..(high.y.max(0.0) as usize + 1).min(height) {
            for x in low.x.max(0.0) as usize..(high.x.max(0.0) as usize + 1).min(width) {
                let pixel = &mut frame[y * width + x];
                let mut sum = 0.0;
                for k in 0..36 {
                    let offset = DVec2::new((k % 6) as f64, (k / 6) as f64) / 6.0 - 5.0 / 12.0;
                    let seen = DVec2::new(x as f64, y as f64) + offset;
                    let ray = lens.undistort(seen).expect("inside the picture");
                    let q = plane * ray.extend(1.0);
                    let cell = DVec2::new(q.x / q.z, -q.y / q.z) * (cells / SIDE_MM) + cells / 2.0 + 1.0;
                    let (i, j) = (cell.x.floor(), cell.y.floor());
                    let inside = (0.0..cells + 2.0).contains(&i) && (0.0..cells + 2.0).contains(&j);
                    sum += match inside {
                        false => *pixel,
                        true if picture.at(i as usize, j as usize) > 0 => look.white,
                        true => look.black,
                    };
                }
                *pixel = sum / 36.0;
            }
        }
    }
    blur(&mut frame, width, look.sigma_blur);
    let mut rng = SplitMix64::new(seed);
    Plane::from_fn(lens.size, |x, y| {
        let bell: f64 = (0..12).map(|_| rng.f64()).sum::<f64>() - 6.0;
        let light = 1.0 - 0.2 * (x as f64 / width as f64);
        (frame[y * width + x] * light + look.sigma_noise * bell + 0.5).clamp(0.0, 255.0) as u8
    })
}

/// Separable Gaussian, clamped at the border.
fn blur(frame: &mut [f64], width: usize, sigma: f64) {
    if sigma <= 0.0 {
        return;
    }
    let radius = (4.0 * sigma).ceil() as isize;
    let weight = |k: isize| libm::exp(-0.5 * (k as f64 / sigma) * (k as f64 / sigma));
    let total: f64 = (-radius..=radius).map(weight).sum();
    let height = frame.len() / width;
    for (across, down) in [(1, 0), (0, 1)] {
        let from = frame.to_vec();
        for y in 0..height as isize {
            for x in 0..width as isize {
                let sum: f64 = (-radius..=radius)
                    .map(|k| {
                        let u = (x + k * across).clamp(0, width as isize - 1);
                        let v = (y + k * down).clamp(0, height as isize - 1);
                        weight(k) * from[(v * width as isize + u) as usize]
                    })
                    .sum();
                frame[y as usize * width + x as usize] = sum / total;
            }
        }
    }
}

fn lens(distorted: bool) -> Lens {
    let mut lens = Lens::guess(Size::new(640, 480));
    if distorted {
        lens.distortion[0] = -0.25;
    }
    lens
}

fn everything() -> Vec<Wanted> {
    FAMILIES.iter().map(|&family| Wanted { family, id: None, side_mm: SIDE_MM }).collect()
}

/// Sorted quantile.
fn quantile(values: &mut [f64], q: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * q) as usize]
}

/// What a set of frames showed.
#[derive(Default)]
struct Outcome {
    drawn: usize,
    found: usize,
    ghosts: usize,
    corner_px: Vec<f64>,
    rotation_deg: Vec<f64>,
    translation_percent: Vec<f64>,
}

impl Outcome {
    fn count(&mut self, lens: &Lens, prints: &[Print], sightings: &[Sighting]) {
        let mut matched = 0;
        for print in prints {
            self.drawn += 1;
            let truth = corners(lens, &print.pose);
            let off = |s: &Sighting| {
                s.corners.iter().zip(truth).map(|(a, b)| (*a - b).length()).fold(0.0, f64::max)
            };
            let same = |s: &&Sighting| s.family == print.family && s.id == print.id;
            let Some(sighting) = sightings.iter().filter(same).find(|s| off(s) < 3.0) else { continue };
            matched += 1;
            self.corner_px.extend(sighting.corners.iter().zip(truth).map(|(a, b)| (*a - b).length()));
            let solved = sighting.pose.expect("a seen marker has a pose");
            let angle = solved.pose.angle_to(&print.pose);
            self.rotation_deg.push(angle.to_degrees());
            let miss = (solved.pose.translation - print.pose.translation).length();
            self.translation_percent.push(100.0 * miss / print.pose.translation.length());
        }
        self.found += matched;
        self.ghosts += sightings.len() - matched;
    }

    fn say(&mut self, label: &str) {
        eprintln!(
            "{label}: {}/{} found, {} ghosts; corners median {:.4} p95 {:.4} px; rotation median {:.3} p95 {:.2} deg; translation median {:.4} p95 {:.3} %",
            self.found,
            self.drawn,
            self.ghosts,
            quantile(&mut self.corner_px, 0.5),
            quantile(&mut self.corner_px, 0.95),
            quantile(&mut self.rotation_deg, 0.5),
            quantile(&mut self.rotation_deg, 0.95),
            quantile(&mut self.translation_percent, 0.5),
            quantile(&mut self.translation_percent, 0.95),
        );
    }
}

/// Frames with a marker in each third of the picture.
fn trial(frames: u64, look: Look, sides: (f64, f64), tilts_deg: (f64, f64)) -> Outcome {
    let mut outcome = Outcome::default();
    let mut tracker = Tracker::new(Config::default(), simd::best());
    for seed in 0..frames {
        let mut rng = SplitMix64::new(seed * 77 + 5);
        let lens = lens(seed % 2 == 1);
        let mut between = |low: f64, high: f64| low + (high - low) * rng.f64();
        let prints: Vec<Print> = (0..3)
            .map(|third| {
                let family = FAMILIES[((seed + third) % 4) as usize];
                let side = sides.0 * libm::pow(sides.1 / sides.0, between(0.0, 1.0));
                let center =
                    DVec2::new(107.0 + 213.0 * third as f64 + between(-5.0, 5.0), between(110.0, 370.0));
                let tilt = between(tilts_deg.0, tilts_deg.1).to_radians();
                let pose = pose_at(&lens, center, side, between(0.0, TAU), tilt, between(0.0, TAU));
                let id = (between(0.0, 1.0) * family.codes().len() as f64) as u32;
                Print { family, id, pose }
            })
            .collect();
        let frame = draw(&lens, &prints, look, seed);
        outcome.count(&lens, &prints, tracker.find(frame.view(), &lens, &everything()));
    }
    outcome
}

#[test]
fn easy_markers_are_all_found_and_sharp() {
    let mut outcome = trial(16, EASY, (40.0, 110.0), (0.0, 45.0));
    outcome.say("easy");
    assert_eq!((outcome.found, outcome.ghosts), (outcome.drawn, 0));
    assert!(quantile(&mut outcome.corner_px, 0.5) < 0.03);
    assert!(quantile(&mut outcome.corner_px, 0.95) < 0.1);
    assert!(quantile(&mut outcome.rotation_deg, 0.5) < 0.2);
    assert!(quantile(&mut outcome.translation_percent, 0.5) < 0.1);
}

#[test]
fn noise_blur_and_tilt_cost_little() {
    let look = Look { sigma_blur: 1.0, sigma_noise: 8.0, black: 50.0, white: 180.0, clutter: 90.0 };
    let mut outcome = trial(12, look, (30.0, 110.0), (20.0, 65.0));
    outcome.say("medium");
    assert_eq!(outcome.ghosts, 0);
    assert!(outcome.found * 100 >= outcome.drawn * 85, "{}/{}", outcome.found, outcome.drawn);
    assert!(quantile(&mut outcome.corner_px, 0.5) < 0.1);
}

#[test]
fn small_markers_are_found() {
    let mut outcome = trial(12, EASY, (16.0, 30.0), (0.0, 50.0));
    outcome.say("small");
    assert_eq!(outcome.ghosts, 0);
    assert!(outcome.found * 100 >= outcome.drawn * 85, "{}/{}", outcome.found, outcome.drawn);
    assert!(quantile(&mut outcome.corner_px, 0.5) < 0.08);
}

#[test]
fn dim_light_is_no_darkness() {
    let look = Look { sigma_blur: 0.6, sigma_noise: 2.0, black: 8.0, white: 36.0, clutter: 12.0 };
    let mut outcome = trial(8, look, (40.0, 110.0), (0.0, 45.0));
    outcome.say("dim");
    assert_eq!(outcome.ghosts, 0);
    assert!(outcome.found * 100 >= outcome.drawn * 90, "{}/{}", outcome.found, outcome.drawn);
}

/// Textures, noise and stripes hold no marker of any family.
#[test]
fn nothing_is_seen_where_nothing_is() {
    let lens = lens(false);
    let mut tracker = Tracker::new(Config::default(), simd::best());
    for seed in 0..12 {
        let (clutter, noise) =
            ([0.0, 60.0, 200.0, 400.0][seed as usize % 4], [0.0, 5.0, 25.0][seed as usize % 3]);
        let look = Look { clutter, sigma_noise: noise, sigma_blur: 0.0, ..EASY };
        let frame = draw(&lens, &[], look, 1000 + seed);
        let seen = tracker.find(frame.view(), &lens, &everything());
        assert!(seen.is_empty(), "seed {seed}: {seen:?}");
    }
    let mut rng = SplitMix64::new(1);
    for cell in [1usize, 2, 3, 5, 8, 13] {
        let blocks = Plane::from_fn(Size::new(640, 480), |x, y| {
            let h = vernissage::pixels::hash_noise((x / cell) as u32, (y / cell) as u32, cell as u64, 0);
            if h & 1 == 0 { 20 } else { 220 }
        });
        let seen = tracker.find(blocks.view(), &lens, &everything());
        assert!(seen.is_empty(), "blocks of {cell}: {seen:?}");
    }
    let noise = Plane::from_fn(Size::new(640, 480), |_, _| rng.next_u64() as u8);
    assert!(tracker.find(noise.view(), &lens, &everything()).is_empty());
    // a mirrored print is no marker
    let print = Print {
        family: Family::Tag36h11,
        id: 3,
        pose: pose_at(&lens, DVec2::new(300.0, 200.0), 100.0, 0.3, 0.2, 1.0),
    };
    let frame = draw(&lens, &[print], EASY, 4);
    let mirrored = Plane::from_fn(frame.size(), |x, y| frame.at(639 - x, y));
    assert_eq!(tracker.find(frame.view(), &lens, &everything()).len(), 1);
    assert!(tracker.find(mirrored.view(), &lens, &everything()).is_empty());
}

/// Only what is wanted is reported, an id's own size before its family's, the same id twice when apart.
#[test]
fn wishes_are_heard() {
    let lens = lens(false);
    let at = |x: f64, id: u32| {
        let pose = pose_at(&lens, DVec2::new(x, 240.0), 80.0, 0.2, 0.4, 0.5);
        Print { family: Family::Aruco4x4_50, id, pose }
    };
    let frame = draw(&lens, &[at(110.0, 7), at(320.0, 7), at(530.0, 9)], EASY, 9);
    let mut tracker = Tracker::new(Config::default(), simd::best());
    let wish = |id, side_mm| Wanted { family: Family::Aruco4x4_50, id, side_mm };
    let ids = |seen: &[Sighting]| seen.iter().map(|s| s.id).collect::<Vec<_>>();
    assert_eq!(ids(tracker.find(frame.view(), &lens, &[wish(None, 80.0)])), [7, 7, 9]);
    assert_eq!(ids(tracker.find(frame.view(), &lens, &[wish(Some(9), 80.0)])), [9]);
    let other = Wanted { family: Family::Tag36h11, id: None, side_mm: 80.0 };
    assert!(tracker.find(frame.view(), &lens, &[other]).is_empty());
    assert!(tracker.find(frame.view(), &lens, &[]).is_empty());
    let seen = tracker.find(frame.view(), &lens, &[wish(None, 80.0), wish(Some(9), 160.0)]);
    let far = |s: &Sighting| s.pose.expect("solved").pose.translation.z;
    assert!((far(&seen[2]) / far(&seen[0]) - 2.0).abs() < 0.05);
}

/// Threads, SIMD levels, row padding and earlier pictures leave no trace in the result.
#[test]
fn results_are_the_same_everywhere() {
    let lens = lens(true);
    let prints = [(0u32, 120.0, 60.0), (5, 320.0, 110.0), (11, 520.0, 25.0)].map(|(id, x, side)| Print {
        family: FAMILIES[id as usize % 4],
        id,
        pose: pose_at(&lens, DVec2::new(x, 200.0), side, f64::from(id), 0.6, 0.3),
    });
    let frame = draw(&lens, &prints, EASY, 21);
    let mut padded = Plane::with_stride(frame.size(), 701, 77u8);
    for y in 0..480 {
        padded.row_mut(y).copy_from_slice(frame.row(y));
    }
    let mut first: Option<Vec<Sighting>> = None;
    for threads in [1, 2, 4] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
        for level in simd::available() {
            for view in [frame.view(), padded.view()] {
                let mut tracker = Tracker::new(Config::default(), level);
                let other = Plane::new(Size::new(64, 48), 9u8);
                let seen = pool.install(|| {
                    tracker.find(other.view(), &lens, &everything());
                    tracker.find(view, &lens, &everything()).to_vec()
                });
                assert_eq!(seen.len(), 3);
                assert!(first.as_ref().is_none_or(|first| *first == seen), "{} {threads}", simd::name(level));
                first.get_or_insert(seen);
            }
        }
    }
}

#[test]
fn odd_pictures_and_lenses_are_survived() {
    let wanted = everything();
    let mut tracker = Tracker::new(Config::default(), Level::fallback());
    for (w, h) in [(0, 0), (0, 9), (1, 1), (3, 700), (7, 7), (8, 8), (65, 63), (20_000, 8)] {
        let plane = Plane::from_fn(Size::new(w, h), |x, y| (x * 37 + y * 91) as u8);
        assert!(tracker.find(plane.view(), &Lens::guess(plane.size()), &wanted).is_empty());
    }
    let frame = Plane::from_fn(Size::new(200, 200), |x, y| if (x / 40 + y / 40) % 2 == 0 { 0 } else { 255 });
    for bad in [f64::NAN, f64::INFINITY, 0.0, -3.0, 1e-300, 1e300] {
        let mut lens = Lens::guess(frame.size());
        lens.focal.x = bad;
        tracker.find(frame.view(), &lens, &wanted);
        let mut lens = Lens::guess(frame.size());
        lens.distortion[0] = bad;
        tracker.find(frame.view(), &lens, &wanted);
        let side = Wanted { family: Family::Tag36h11, id: None, side_mm: bad };
        tracker.find(frame.view(), &Lens::guess(frame.size()), &[side]);
    }
    // a lens for another picture size is used as it is
    let print = Print {
        family: Family::Tag36h11,
        id: 1,
        pose: pose_at(&lens(false), DVec2::new(300.0, 200.0), 90.0, 0.0, 0.1, 0.0),
    };
    let frame = draw(&lens(false), &[print], EASY, 2);
    let half = PlaneRef::new(frame.samples(), Size::new(500, 400), 640).expect("a part of the frame");
    assert_eq!(tracker.find(half, &lens(false), &wanted).len(), 1);
}

/// Exact corners give back the exact pose, and the other minimum is reported with its larger error.
#[test]
fn exact_corners_give_the_pose() {
    let mut rng = SplitMix64::new(12);
    let mut between = |low: f64, high: f64| low + (high - low) * rng.f64();
    let (mut ambiguous, mut solved) = (0, 0);
    for case in 0..4000 {
        let lens = lens(case % 2 == 0);
        let center = DVec2::new(between(100.0, 540.0), between(100.0, 380.0));
        let tilt = between(0.0, 85f64.to_radians());
        let truth = pose_at(&lens, center, between(20.0, 150.0), between(0.0, TAU), tilt, between(0.0, TAU));
        let px = corners(&lens, &truth);
        let area = 0.5 * (px[2] - px[0]).perp_dot(px[3] - px[1]);
        if area < 30.0 {
            continue;
        }
        solved += 1;
        let (best, other) = solve::solve(&px, SIDE_MM, &lens);
        let best = best.expect("solved");
        assert!(best.error_px < 1e-6, "case {case}: {} px", best.error_px);
        assert!(best.pose.angle_to(&truth) < 1e-5, "case {case}: {} rad", best.pose.angle_to(&truth));
        let miss = (best.pose.translation - truth.translation).length() / truth.translation.length();
        assert!(miss < 1e-6, "case {case}: {miss}");
        if let Some(other) = other {
            assert!(other.error_px >= best.error_px);
            ambiguous += 1;
        }
    }
    assert!(solved > 3000 && ambiguous > solved / 2, "{ambiguous} of {solved} with two minima");
}

/// Whatever four points are given: a rotation to 1e-12 and finite numbers, or nothing.
#[test]
fn random_corners_give_a_pose_or_none() {
    let mut rng = SplitMix64::new(99);
    let lenses = [lens(false), lens(true)];
    let mut some = 0;
    for case in 0..100_000u32 {
        let spread = [1e-6, 1.0, 30.0, 640.0, 1e6][case as usize % 5];
        let mut px = [DVec2::ZERO; 4]
            .map(|_| DVec2::new(320.0, 240.0) + DVec2::new(rng.f64() - 0.5, rng.f64() - 0.5) * spread);
        match case % 97 {
            0 => px[1] = px[0],
            1 => px[2] = (px[0] + px[1]) * 0.5,
            2 => px[3].x = f64::NAN,
            3 => px[0].y = f64::INFINITY,
            _ => {}
        }
        let (best, other) = solve::solve(&px, SIDE_MM, &lenses[case as usize % 2]);
        assert!(best.is_some() || other.is_none());
        for solved in [best, other].into_iter().flatten() {
            some += 1;
            let r = solved.pose.rotation;
            let off = r.transpose() * r - DMat3::IDENTITY;
            assert!(
                off.to_cols_array().iter().all(|v| v.abs() < 1e-12) && (r.determinant() - 1.0).abs() < 1e-12
            );
            assert!(solved.pose.translation.is_finite() && solved.pose.translation.z > 0.0);
            assert!(solved.error_px.is_finite());
        }
        assert!(Homography::from_square(px).is_none_or(|map| map.0.is_finite()));
    }
    assert!(some > 2000, "only {some} poses");
}
