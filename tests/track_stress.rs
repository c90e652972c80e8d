//! The tracker where views end: grazing, tiny and whole-frame prints, the picture's edge, strong and odd lenses,
//! prints in prints and twice the same one. What is reported is right and finite, or nothing is.

use glam::{DMat3, DVec2, DVec3};
use std::f64::consts::TAU;
use vernissage::app::bench::markers::{SIDE_MM, Setup, pose_at};
use vernissage::frame::{Sighting, Solved};
use vernissage::geometry::{Lens, Pose};
use vernissage::marker::Family;
use vernissage::pixels::{Plane, Size, SplitMix64, simd};
use vernissage::track::{Config, Tracker, Wanted, solve};

const SIZE: Size = Size { width: 640, height: 480 };
const FAMILY: Family = Family::Tag36h11;

fn look(picture: &Plane<u8>, lens: &Lens) -> Vec<Sighting> {
    let wanted = [Wanted { family: FAMILY, id: None, side_mm: SIDE_MM }];
    Tracker::new(Config::default(), simd::best()).find(picture.view(), lens, &wanted).to_vec()
}

/// Numbers are finite, rotations orthonormal to 1e-12, what is seen stands before the camera.
fn assert_sound(sighting: &Sighting) {
    assert!(sighting.corners.iter().all(|p| p.is_finite()), "{sighting:?}");
    for Solved { pose, error_px } in [sighting.pose, sighting.pose_alt].into_iter().flatten() {
        let off = pose.rotation.transpose() * pose.rotation - DMat3::IDENTITY;
        assert!(off.to_cols_array().iter().all(|v| v.abs() < 1e-12), "{off}");
        assert!((pose.rotation.determinant() - 1.0).abs() < 1e-12);
        assert!(pose.translation.is_finite() && pose.translation.z > 0.0 && error_px.is_finite());
    }
}

/// Mean distance of the corners from the truth.
fn miss(sighting: &Sighting, lens: &Lens, pose: &Pose) -> f64 {
    let corners = solve::corners_mm(SIDE_MM).map(|p| lens.project(pose.apply(p)).expect("in view"));
    sighting.corners.iter().zip(corners).map(|(a, b)| (*a - b).length()).sum::<f64>() * 0.25
}

/// Draws one print a picture, and returns which were found (within 1.5 px); nothing else may be.
fn found(lens: Lens, poses: impl Iterator<Item = Pose>) -> Vec<bool> {
    let one = |(seed, pose): (usize, Pose)| {
        let setup = Setup::calm(&lens, FAMILY, vec![(5, pose)], seed as u64 + 1);
        let seen = look(&setup.shoot(), &lens);
        seen.iter().for_each(assert_sound);
        assert!(seen.len() <= 1 && seen.iter().all(|s| s.id == 5), "{seen:?}");
        seen.iter().all(|s| {
            let miss = miss(s, &lens, &pose);
            assert!(miss < 1.5, "{miss} px off at {pose:?}");
            true
        }) && !seen.is_empty()
    };
    poses.enumerate().map(one).collect()
}

fn share(found: &[bool]) -> f64 {
    found.iter().filter(|found| **found).count() as f64 / found.len() as f64
}

#[test]
fn grazing_views_are_right_or_not_reported() {
    let lens = Lens::guess(SIZE);
    let at = |tilt: f64| {
        let poses = (0..24).map(move |k| {
            let about = f64::from(k) * TAU / 24.0;
            pose_at(&lens, DVec2::new(318.0, 241.0), 190.0, 0.3, tilt.to_radians(), about).expect("in view")
        });
        let share = share(&found(lens, poses));
        println!("tilt {tilt}: {share:.2}");
        share
    };
    assert_eq!(at(60.0), 1.0);
    assert_eq!(at(70.0), 1.0);
    assert!(at(75.0) >= 0.9);
    // 190 px at 80° are 33, at 85° 17 px across, 2 px a cell
    assert!(at(80.0) >= 0.5);
    at(85.0);
    at(88.0);
}

#[test]
fn prints_of_every_size_are_right_or_not_reported() {
    let lens = Lens::guess(SIZE);
    let at = |side: f64| {
        let poses = (0..16).map(move |k| {
            // large prints stay upright: they fill the picture
            let spin = if side > 250.0 { 0.02 * f64::from(k) } else { 0.4 * f64::from(k) };
            let center = DVec2::new(319.0 + 0.13 * f64::from(k), 239.0 + 0.29 * f64::from(k));
            pose_at(&lens, center, side, spin, 0.05, 1.0).expect("in view")
        });
        let share = share(&found(lens, poses));
        println!("side {side}: {share:.2}");
        share
    };
    [5.0, 7.0, 9.0].iter().for_each(|&side| _ = at(side));
    assert!(at(14.0) >= 0.5);
    for side in [20.0, 30.0, 60.0, 120.0, 240.0, 340.0, 372.0] {
        assert_eq!(at(side), 1.0, "{side} px");
    }
    // its quiet zone leaves the picture at 384 px, its border at 480
    assert!(at(400.0) >= 0.5);
}

#[test]
fn prints_across_the_pictures_edge_are_not_invented() {
    let lens = Lens::guess(SIZE);
    let mut inside = Vec::new();
    for k in 0..120 {
        let x = 70.0 - f64::from(k);
        let pose = pose_at(&lens, DVec2::new(x, 200.0), 80.0, 0.1, 0.3, f64::from(k)).expect("in view");
        let corners = solve::corners_mm(SIDE_MM).map(|p| lens.project(pose.apply(p)).expect("in view"));
        let left = corners.iter().fold(f64::MAX, |least, p| least.min(p.x));
        let seen = found(lens, [pose].into_iter())[0];
        if left > 8.0 {
            inside.push(seen);
        } else if left < -4.0 {
            assert!(!seen, "a print that is cut off at x {left}");
        }
    }
    assert!(inside.len() > 10 && share(&inside) == 1.0, "{inside:?}");
}

#[test]
fn strong_lenses_are_looked_through() {
    let guess = Lens::guess(SIZE);
    let distortions = [
        [-0.35, 0.12, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [0.4, 0.1, 2e-3, -2e-3, 0.0, 0.0, 0.0, 0.0],
        [-0.3, 0.1, 1e-3, 1e-3, -0.01, 0.05, 0.01, 0.001],
    ];
    for distortion in distortions {
        let lens = Lens { distortion, ..guess };
        let poses = (0..20).map(|k| {
            let center = DVec2::new(90.0 + 120.0 * f64::from(k % 5), 70.0 + 110.0 * f64::from(k / 5));
            pose_at(&lens, center, 70.0, f64::from(k), 0.4, f64::from(k)).expect("in view")
        });
        let share = share(&found(lens, poses));
        println!("{distortion:?}: {share:.2}");
        assert!(share >= 0.95);
    }
}

#[test]
fn focal_lengths_and_centers_of_every_kind() {
    for focal in [50.0, 120.0, 400.0, 3000.0, 50_000.0] {
        for center in [DVec2::new(320.0, 240.0), DVec2::new(-500.0, 900.0), DVec2::new(3000.0, -200.0)] {
            let lens = Lens { focal: DVec2::splat(focal), center, ..Lens::guess(SIZE) };
            for k in 0..4 {
                let at = DVec2::new(200.0 + 70.0 * f64::from(k), 160.0 + 50.0 * f64::from(k));
                let Some(pose) = pose_at(&lens, at, 90.0, f64::from(k), 0.3, 2.0) else { continue };
                let setup = Setup::calm(&lens, FAMILY, vec![(9, pose)], 7);
                let truth = setup.truth();
                for sighting in look(&setup.shoot(), &lens) {
                    assert_sound(&sighting);
                    assert_eq!(sighting.id, 9, "{truth:?}");
                }
            }
        }
    }
}

/// Two prints of one number are two sightings; a print within a print's picture is no ghost.
#[test]
fn twins_and_nested_squares() {
    let lens = Lens::guess(SIZE);
    let place =
        |x: f64, side: f64| pose_at(&lens, DVec2::new(x, 240.0), side, 0.2, 0.2, 0.5).expect("in view");
    let twins = Setup::calm(&lens, FAMILY, vec![(3, place(160.0, 120.0)), (3, place(470.0, 90.0))], 4);
    let seen = look(&twins.shoot(), &lens);
    assert_eq!(seen.iter().map(|s| s.id).collect::<Vec<_>>(), [3, 3]);
    let mut rng = SplitMix64::new(31);
    let wanted = Family::ALL.map(|family| Wanted { family, id: None, side_mm: SIDE_MM });
    let mut tracker = Tracker::new(Config::default(), simd::best());
    for case in 0..40 {
        // black and white squares in each other, each a few pixels narrower
        let (turn, sides) = (rng.f64() * TAU, rng.int(2, 9) as usize);
        let (half, step) = (40.0 + 120.0 * rng.f64(), 4.0 + 12.0 * rng.f64());
        let (sin, cos) = (libm::sin(turn), libm::cos(turn));
        let picture = Plane::from_fn(SIZE, |x, y| {
            let d = DVec2::new(x as f64 - 320.0, y as f64 - 240.0);
            let out = DVec2::new(d.x * cos - d.y * sin, d.x * sin + d.y * cos).abs().max_element();
            let ring = ((half - out) / step).floor();
            let dark = ring >= 0.0 && ring < sides as f64 && (ring as usize).is_multiple_of(2);
            (if dark { 40.0 } else { 200.0 } + 4.0 * rng.f64()) as u8
        });
        let seen = tracker.find(picture.view(), &lens, &wanted);
        assert!(seen.is_empty(), "case {case}: {seen:?}");
    }
}

/// A million random quadrilaterals through every kind of lens: a sound pose, or none.
#[test]
fn a_million_random_quadrilaterals() {
    let mut rng = SplitMix64::new(4711);
    let mut poses = 0;
    for case in 0..1_000_000u32 {
        let mut between = |low: f64, high: f64| low + (high - low) * rng.f64();
        let focal = [50.0, 300.0, 700.0, 5000.0, 50_000.0][case as usize % 5];
        let mut lens = Lens { focal: DVec2::splat(focal), ..Lens::guess(SIZE) };
        if case % 3 == 0 {
            lens.center = DVec2::new(between(-2000.0, 2000.0), between(-2000.0, 2000.0));
        }
        let spread = [2.0, 20.0, 200.0, 2000.0][case as usize % 4];
        // half of them about a square, which most poses are of
        let square = if case % 2 == 0 { spread } else { 0.0 };
        let quad = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| {
            DVec2::new(320.0 + square * x, 240.0 + square * y)
                + DVec2::new(between(-spread, spread), between(-spread, spread))
        });
        let (best, other) = solve::solve(&quad, SIDE_MM, &lens);
        for Solved { pose, error_px } in [best, other].into_iter().flatten() {
            poses += 1;
            let off = pose.rotation.transpose() * pose.rotation - DMat3::IDENTITY;
            assert!(off.to_cols_array().iter().all(|v| v.abs() < 1e-12), "case {case}: {off}");
            assert!(pose.translation.is_finite() && error_px.is_finite(), "case {case}");
            let corners = solve::corners_mm(SIDE_MM).map(|p| pose.apply(p));
            assert!(corners.iter().all(|p: &DVec3| p.z > 0.0), "case {case}: behind the camera");
        }
    }
    assert!(poses > 100_000, "{poses} poses");
}
