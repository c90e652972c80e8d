//! The solver on points with exact truth.

use super::super::Point;
use super::*;
use crate::pixels::SplitMix64;
use glam::DVec3;

const SIZE: Size = Size { width: 640, height: 480 };

fn truth() -> Lens {
    Lens {
        size: SIZE,
        focal: DVec2::new(571.3, 566.8),
        center: DVec2::new(327.4, 231.9),
        distortion: [-0.24, 0.09, 8e-4, -1.1e-3, -0.015, 0.0, 0.0, 0.0],
    }
}

fn noise(rng: &mut SplitMix64) -> f64 {
    (-2.0 * libm::log(1.0 - rng.f64())).sqrt() * libm::cos(std::f64::consts::TAU * rng.f64())
}

/// A view of a sheet of 9 x 7 points, tilted by up to `tilt` degrees, each point `sigma` px off.
fn view(rng: &mut SplitMix64, tilt: f64, sigma: f64) -> View {
    let between = |rng: &mut SplitMix64, low: f64, high: f64| low + (high - low) * rng.f64();
    let lens = truth();
    let turn = between(rng, 0.0, std::f64::consts::TAU);
    let axis = DVec3::new(libm::cos(turn), libm::sin(turn), 0.0);
    let facing = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let rotation = facing
        * DMat3::from_axis_angle(axis, between(rng, 0.6, 1.0) * tilt.to_radians())
        * DMat3::from_axis_angle(DVec3::Z, between(rng, -0.4, 0.4));
    let distance = between(rng, 260.0, 420.0);
    let translation =
        DVec3::new(between(rng, -0.25, 0.25) * distance, between(rng, -0.2, 0.2) * distance, distance);
    let pose = Pose { rotation, translation };
    let mut points = Vec::new();
    for k in 0..63 {
        let sheet_mm = DVec2::new(f64::from(k % 9) - 4.0, f64::from(k / 9) - 3.0) * 30.0;
        let Some(px) = lens.project(pose.apply(sheet_mm.extend(0.0))) else { continue };
        // as a lens shows it: not from beyond where it folds over
        let unfolded = lens.undistort(px).is_some_and(|ray| {
            let p = pose.apply(sheet_mm.extend(0.0));
            (ray - DVec2::new(p.x, p.y) / p.z).length() < 1e-6
        });
        if unfolded && px.min_element() > 0.0 && px.x < 639.0 && px.y < 479.0 {
            let off = DVec2::new(noise(rng), noise(rng)) * sigma;
            points.push(Point { sheet_mm, px: px + off });
        }
    }
    View { points }
}

fn views(seed: u64, count: usize, tilt: f64, sigma: f64) -> Vec<View> {
    let mut rng = SplitMix64::new(seed);
    (0..count).map(|_| view(&mut rng, tilt, sigma)).collect()
}

fn numbers(lens: &Lens) -> [f64; NUMBERS] {
    let [k1, k2, p1, p2, k3, ..] = lens.distortion;
    [lens.focal.x, lens.focal.y, lens.center.x, lens.center.y, k1, k2, p1, p2, k3]
}

#[test]
fn exact_points_give_the_exact_lens() {
    for seed in 0..20 {
        let solved = solve(&views(seed, 8, 40.0, 0.0), SIZE).expect("decided");
        for (found, true_value) in numbers(&solved.lens).into_iter().zip(numbers(&truth())) {
            assert!(
                (found - true_value).abs() < 1e-5 * true_value.abs().max(1.0),
                "{seed}: {found} {true_value}"
            );
        }
        assert!(solved.rms_px < 1e-6);
    }
}

#[test]
fn deviations_are_those_of_repeated_measurements() {
    let mut squares = [0.0; NUMBERS];
    let mut told = [0.0; NUMBERS];
    let tries = 60;
    let clean = views(7, 12, 40.0, 0.0);
    for seed in 0..tries {
        let mut rng = SplitMix64::new(100 + seed);
        let mut noisy = clean.clone();
        for point in noisy.iter_mut().flat_map(|view| &mut view.points) {
            point.px += DVec2::new(noise(&mut rng), noise(&mut rng)) * 0.1;
        }
        let solved = solve(&noisy, SIZE).expect("decided");
        assert!((0.08..0.12).contains(&(solved.rms_px / 1.414)), "{}", solved.rms_px);
        for (k, (found, true_value)) in numbers(&solved.lens).into_iter().zip(numbers(&truth())).enumerate() {
            squares[k] += (found - true_value) * (found - true_value);
            told[k] += solved.deviations[k] / tries as f64;
        }
    }
    for (k, told) in told.into_iter().enumerate() {
        let measured = (squares[k] / tries as f64).sqrt();
        assert!((0.7..1.4).contains(&(measured / told)), "number {k}: {measured} measured, {told} told");
    }
}

#[test]
fn wrong_points_are_weighed_down() {
    let mut views = views(3, 15, 40.0, 0.05);
    let mut rng = SplitMix64::new(4);
    for view in &mut views {
        for point in view.points.iter_mut().step_by(19) {
            point.px += DVec2::new(rng.f64() - 0.5, rng.f64() - 0.5) * 40.0;
        }
    }
    let solved = solve(&views, SIZE).expect("decided");
    assert!((solved.lens.focal - truth().focal).length() < 0.005 * truth().focal.x, "{}", solved.lens.focal);
    assert!(solved.outliers > 20 && solved.outliers < 70, "{}", solved.outliers);
}

#[test]
fn what_does_not_decide_a_lens_is_refused_with_what_is_missing() {
    let says = |views: &[View]| solve(views, SIZE).expect_err("undecided").to_string();
    assert!(says(&[]).contains("0 pictures show the sheet"));
    assert!(says(&views(1, 2, 40.0, 0.05)).contains("2 pictures show the sheet"));
    let flat = says(&views(1, 12, 0.5, 0.05));
    assert!(flat.contains("faces the camera"), "{flat}");
    // only the middle of the picture
    let mut middle = views(1, 12, 40.0, 0.05);
    for view in &mut middle {
        view.points.retain(|p| (p.px - DVec2::new(319.5, 239.5)).abs().cmplt(DVec2::new(150.0, 110.0)).all());
    }
    let middle = says(&middle);
    assert!(middle.contains("parts of the picture") || middle.contains("alike"), "{middle}");
    let mut strange = views(1, 12, 40.0, 0.05);
    let mut rng = SplitMix64::new(9);
    for point in strange.iter_mut().flat_map(|view| &mut view.points) {
        point.sheet_mm += DVec2::new(rng.f64(), rng.f64()) * 60.0;
    }
    let strange = says(&strange);
    assert!(strange.contains("no lens explains"), "{strange}");
}

#[test]
fn nonsense_is_refused_and_never_panics() {
    let mut rng = SplitMix64::new(11);
    for seed in 0..300 {
        let mut views = views(seed, 4, 40.0, 0.1);
        for view in &mut views {
            match rng.int(0, 4) {
                0 => view.points.iter_mut().for_each(|p| p.px = DVec2::NAN),
                1 => view.points.iter_mut().for_each(|p| p.px = DVec2::ONE),
                2 => view.points.iter_mut().for_each(|p| p.sheet_mm.y = 0.0),
                3 => view.points.iter_mut().for_each(|p| p.px *= 1e300),
                _ => view.points.iter_mut().for_each(|p| p.px = DVec2::new(rng.f64(), rng.f64()) * 640.0),
            }
        }
        if let Ok(solved) = solve(&views, SIZE) {
            assert!(numbers(&solved.lens).iter().all(|v| v.is_finite()));
        }
    }
}

#[test]
fn derivatives_are_differences() {
    let (lens, h) = (truth(), 1e-6);
    let facing = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
    let rotation = facing * DMat3::from_axis_angle(DVec3::new(0.6, 0.8, 0.0), 0.5);
    let pose = Pose { rotation, translation: DVec3::new(20.0, -30.0, 300.0) };
    let (sheet, px) = (DVec2::new(40.0, -55.0), DVec2::new(300.0, 200.0));
    let miss = |lens: &Lens, pose: &Pose| derivatives(lens, pose, 300.0, sheet, px).expect("before it").0;
    let (_, by_lens, by_pose) = derivatives(&lens, &pose, 300.0, sheet, px).expect("before it");
    for (k, told) in by_lens[0].iter().zip(by_lens[1]).map(|(&x, y)| DVec2::new(x, y)).enumerate() {
        let at = |h: f64| {
            let mut lens = lens;
            match k {
                0 | 1 => lens.focal[k] += h,
                2 | 3 => lens.center[k - 2] += h,
                _ => lens.distortion[k - 4] += h,
            }
            miss(&lens, &pose)
        };
        let slope = (at(-h) - at(h)) / (2.0 * h);
        assert!((slope - told).length() < 1e-5 * (1.0 + told.length()), "{k}: {slope} {told}");
    }
    for k in 0..6 {
        let at = |h: f64| {
            let mut step = [0.0; 6];
            step[k] = h;
            miss(&lens, &moved(&pose, 300.0, step))
        };
        let slope = (at(-h) - at(h)) / (2.0 * h);
        let told = DVec2::new(by_pose[0][k], by_pose[1][k]);
        assert!((slope - told).length() < 1e-5 * (1.0 + told.length()), "{k}: {slope} {told}");
    }
}
