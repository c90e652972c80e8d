//! The tracker's promises one by one: what is found under which condition, what is reported, that results are the
//! same everywhere, that poses are exact where corners are. Its figures over all conditions are held by `tracking.rs`.

use glam::{DMat3, DVec2};
use std::f64::consts::TAU;
use vernissage::app::bench::markers::{Background, Blur, Light, SIDE_MM, Setup, pose_at};
use vernissage::app::bench::tally::{Class, Tally, quantile};
use vernissage::frame::Sighting;
use vernissage::geometry::{Homography, Lens};
use vernissage::marker::Family;
use vernissage::pixels::simd::{self, Level};
use vernissage::pixels::{Plane, PlaneRef, Size, SplitMix64};
use vernissage::track::{Config, Tracker, Wanted, solve};

/// Families that prove themselves, of every number of bits but the largest.
const FAMILIES: [Family; 4] =
    [Family::Tag36h11, Family::Aruco4x4_50, Family::Aruco5x5_100, Family::Aruco6x6_250];

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

/// Frames with a marker in each third of the picture, looking as `look` makes them; every family is wanted.
fn trial(frames: u64, look: impl Fn(&mut Setup), sides: (f64, f64), tilts_deg: (f64, f64)) -> Class {
    let mut tally = Tally::default();
    let mut tracker = Tracker::new(Config::default(), simd::best());
    for seed in 0..frames {
        let mut rng = SplitMix64::new(seed * 77 + 5);
        let lens = lens(seed % 2 == 1);
        let family = FAMILIES[(seed % 4) as usize];
        let mut between = |low: f64, high: f64| low + (high - low) * rng.f64();
        let prints = (0..3).map(|third| {
            let side = sides.0 * libm::pow(sides.1 / sides.0, between(0.0, 1.0));
            let center = DVec2::new(107.0 + 213.0 * third as f64 + between(-5.0, 5.0), between(110.0, 370.0));
            let tilt = between(tilts_deg.0, tilts_deg.1).to_radians();
            let pose = pose_at(&lens, center, side, between(0.0, TAU), tilt, between(0.0, TAU));
            // each third its own numbers: none twice
            let numbers = family.codes().len() / 3;
            let id = numbers * third + (between(0.0, 1.0) * numbers as f64) as usize;
            (id as u32, pose.expect("in view"))
        });
        let mut setup = Setup::calm(&lens, family, prints.collect(), seed);
        look(&mut setup);
        let seen = tracker.find(setup.shoot().view(), &lens, &everything());
        assert!(seen.iter().all(|s| s.family == family), "{seen:?}");
        tally.count(&setup.truth(), seen);
    }
    assert_eq!(tally.ghosts, 0);
    tally.all()
}

#[test]
fn easy_markers_are_all_found_and_sharp() {
    let seen = trial(16, |_| {}, (40.0, 110.0), (0.0, 45.0));
    assert_eq!((seen.found, seen.posed), (seen.drawn, seen.drawn));
    assert!(quantile(&seen.corner_px, 0.5) < 0.03);
    assert!(quantile(&seen.corner_px, 0.95) < 0.1);
    assert!(quantile(&seen.rotation_deg, 0.5) < 0.2);
    assert!(quantile(&seen.distance_percent, 0.5) < 0.1);
}

#[test]
fn noise_blur_and_tilt_cost_little() {
    let look = |setup: &mut Setup| {
        (setup.inks, setup.blur, setup.sigma) = ([50.0, 180.0], Blur::Gaussian(1.0), 8.0);
    };
    let seen = trial(12, look, (30.0, 110.0), (20.0, 65.0));
    assert!(seen.recall() >= 0.85, "{}/{}", seen.found, seen.drawn);
    assert!(quantile(&seen.corner_px, 0.5) < 0.1);
}

#[test]
fn small_markers_are_found() {
    let seen = trial(12, |_| {}, (16.0, 30.0), (0.0, 50.0));
    assert!(seen.recall() >= 0.85, "{}/{}", seen.found, seen.drawn);
    assert!(quantile(&seen.corner_px, 0.5) < 0.08);
}

#[test]
fn dim_light_is_no_darkness() {
    // inks of 6 and 38 gray levels
    let dim = |setup: &mut Setup| setup.light = Light::even(0.18);
    let seen = trial(8, dim, (40.0, 110.0), (0.0, 45.0));
    assert!(seen.recall() >= 0.9, "{}/{}", seen.found, seen.drawn);
}

/// Textures, noise and stripes hold no marker of any family.
#[test]
fn nothing_is_seen_where_nothing_is() {
    let lens = lens(false);
    let mut tracker = Tracker::new(Config::default(), simd::best());
    for seed in 0..12 {
        let empty = Setup {
            background: [Background::Plain, Background::Texture, Background::Clutter][seed as usize % 3],
            sigma: [0.0, 5.0, 25.0, 1.0][seed as usize % 4],
            blur: Blur::Sharp,
            ..Setup::calm(&lens, Family::Tag36h11, Vec::new(), 1000 + seed)
        };
        let seen = tracker.find(empty.shoot().view(), &lens, &everything());
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
    let pose = pose_at(&lens, DVec2::new(300.0, 200.0), 100.0, 0.3, 0.2, 1.0).expect("in view");
    let frame = Setup::calm(&lens, Family::Tag36h11, vec![(3, pose)], 4).shoot();
    let mirrored = Plane::from_fn(frame.size(), |x, y| frame.at(639 - x, y));
    assert_eq!(tracker.find(frame.view(), &lens, &everything()).len(), 1);
    assert!(tracker.find(mirrored.view(), &lens, &everything()).is_empty());
}

/// Only what is wanted is reported, an id's own size before its family's, the same id twice when apart.
#[test]
fn wishes_are_heard() {
    let lens = lens(false);
    let at =
        |x: f64, id: u32| (id, pose_at(&lens, DVec2::new(x, 240.0), 80.0, 0.2, 0.4, 0.5).expect("in view"));
    let prints = vec![at(110.0, 7), at(320.0, 7), at(530.0, 9)];
    let frame = Setup::calm(&lens, Family::Aruco4x4_50, prints, 9).shoot();
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
    let prints = [(0, 120.0, 60.0), (5, 320.0, 110.0), (11, 520.0, 25.0)].map(|(id, x, side)| {
        (id, pose_at(&lens, DVec2::new(x, 200.0), side, f64::from(id), 0.6, 0.3).expect("in view"))
    });
    let frame = Setup::calm(&lens, Family::Aruco5x5_100, prints.to_vec(), 21).shoot();
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
    let whole = lens(false);
    let pose = pose_at(&whole, DVec2::new(300.0, 200.0), 90.0, 0.0, 0.1, 0.0).expect("in view");
    let frame = Setup::calm(&whole, Family::Tag36h11, vec![(1, pose)], 2).shoot();
    let half = PlaneRef::new(frame.samples(), Size::new(500, 400), 640).expect("a part of the frame");
    assert_eq!(tracker.find(half, &whole, &wanted).len(), 1);
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
        let truth = truth.expect("in view");
        let px = solve::corners_mm(SIDE_MM).map(|p| lens.project(truth.apply(p)).expect("before the camera"));
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
