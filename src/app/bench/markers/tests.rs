//! The generator's truth against what it draws.

use super::*;

const SIZE: Size = Size { width: 320, height: 240 };
const TILTED: [f64; 4] = [90.0, 0.4, 0.8, 1.1];

/// One print at (150.3, 121.7): side in px, then spin, tilt and its direction in radians.
fn one([side_px, spin, tilt, about]: [f64; 4], distorted: bool) -> Setup {
    let mut lens = Lens::guess(SIZE);
    if distorted {
        lens.distortion[..4].copy_from_slice(&[-0.2, 0.05, 1e-3, -1e-3]);
    }
    let pose = pose_at(&lens, DVec2::new(150.3, 121.7), side_px, spin, tilt, about).expect("in view");
    Setup {
        lens,
        family: Family::Tag36h11,
        prints: vec![(7, pose)],
        inks: [20.0, 220.0],
        background: Background::Plain,
        light: Light::EVEN,
        blur: Blur::Sharp,
        sigma: 0.0,
        seed: 3,
    }
}

/// Area and centroid of the black ink in the picture, from how much brighter an all-white print is.
fn ink_drawn(setup: &Setup) -> (f64, DVec2) {
    let [black, white] = setup.inks;
    let blank = Setup { inks: [white; 2], ..setup.clone() }.clean();
    let (mut area, mut moment) = (0.0, DVec2::ZERO);
    for (i, (print, blank)) in setup.clean().iter().zip(&blank).enumerate() {
        let ink = f64::from(blank - print) / (white - black);
        area += ink;
        moment += DVec2::new((i % SIZE.width) as f64, (i / SIZE.width) as f64) * ink;
    }
    (area, moment / area)
}

/// The same as the sum over the black cells' projected outlines (shoelace formula), sides in eight pieces.
fn ink_true(setup: &Setup) -> (f64, DVec2) {
    let (id, pose) = setup.prints[0];
    let picture = setup.family.picture(id).expect("known id");
    let (samples, cell_mm) = (picture.size().width, SIDE_MM / setup.family.cells() as f64);
    let seen = |column: f64, row: f64| {
        let half = 0.5 * samples as f64;
        let mm = DVec3::new((column - half) * cell_mm, (half - row) * cell_mm, 0.0);
        setup.lens.project(pose.apply(mm)).expect("in view")
    };
    let (mut area, mut moment) = (0.0, DVec2::ZERO);
    for i in (0..samples * samples).filter(|i| picture.at(i % samples, i / samples) == 0) {
        let (x, y) = ((i % samples) as f64, (i / samples) as f64);
        let outline: Vec<DVec2> = (0..32)
            .map(|k| {
                let along = f64::from(k % 8) / 8.0;
                match k / 8 {
                    0 => seen(x + along, y),
                    1 => seen(x + 1.0, y + along),
                    2 => seen(x + 1.0 - along, y + 1.0),
                    _ => seen(x, y + 1.0 - along),
                }
            })
            .collect();
        for (k, a) in outline.iter().enumerate() {
            let b = outline[(k + 1) % outline.len()];
            let cross = 0.5 * a.perp_dot(b);
            area += cross;
            moment += (*a + b) * cross / 3.0;
        }
    }
    (area, moment / area)
}

#[test]
fn the_ink_is_where_truth_says() {
    let blurs = [Blur::Sharp, Blur::Gaussian(1.3), Blur::Motion(DVec2::new(5.0, -3.0))];
    // what 64 points a pixel leave; with 1024 the last is 0.003 off
    let looks = [([90.0, 0.0, 0.0, 0.0], 0.005), (TILTED, 0.005), ([25.0, 2.0, 1.1, 3.0], 0.03)];
    for (look, bound) in looks {
        for (distorted, blur) in [false, true].into_iter().flat_map(|d| blurs.map(|blur| (d, blur))) {
            let setup = Setup { blur, ..one(look, distorted) };
            let ((area, center), (true_area, true_center)) = (ink_drawn(&setup), ink_true(&setup));
            let off = (center - true_center).length();
            assert!(off < bound, "{look:?} {distorted} {blur:?}: centroid off by {off} px");
            assert!(
                (area / true_area - 1.0).abs() < 3e-3,
                "{look:?} {distorted} {blur:?}: {area} {true_area}"
            );
        }
    }
}

#[test]
fn true_corners_are_the_outer_corners_of_the_black_border() {
    let setup = one(TILTED, true);
    let truth = setup.truth()[0];
    let (clean, center) = (setup.clean(), truth.corners.iter().sum::<DVec2>() * 0.25);
    let gray = |p: DVec2| clean[p.y.round() as usize * SIZE.width + p.x.round() as usize];
    for (i, corner) in truth.corners.iter().enumerate() {
        let outward = (*corner - center).normalize_or_zero() * 3.0;
        assert_eq!(gray(*corner - outward), 20.0, "corner {i} inside");
        assert_eq!(gray(*corner + outward), 220.0, "corner {i} outside");
        let projected = setup.lens.project(truth.pose.apply(corners_mm(SIDE_MM)[i])).expect("in view");
        assert_eq!(*corner, projected);
    }
    // the print is upright at no spin: its first corner is the top-left one
    let [tl, tr, br, bl] = one([90.0, 0.0, 0.0, 0.0], false).truth()[0].corners;
    assert!(tl.x < tr.x && bl.x < br.x && tl.y < bl.y && tr.y < br.y);
}

#[test]
fn prints_stand_where_and_as_asked() {
    for look in [[90.0, 0.4, 0.0, 0.0], TILTED, [60.0, 2.0, 1.1, 3.0]] {
        let setup = one(look, true);
        let (truth, pose) = (setup.truth()[0], setup.prints[0].1);
        let place = setup.lens.project(pose.translation).expect("in view");
        assert!((place - DVec2::new(150.3, 121.7)).length() < 1e-6);
        assert!((truth.tilt_deg - look[2].to_degrees()).abs() < 1e-6, "{}", truth.tilt_deg);
        assert!((pose.rotation.determinant() - 1.0).abs() < 1e-12);
        if look[2] == 0.0 {
            assert!((truth.edge_px / look[0] - 1.0).abs() < 0.05, "{}", truth.edge_px);
        }
    }
}

#[test]
fn noise_is_as_strong_as_asked_and_normal() {
    let clean = vec![127.3f32; SIZE.area()];
    for sigma in [0.0, 2.0, 5.0, 20.0] {
        let picture = expose(&clean, SIZE, sigma, &mut SplitMix64::new(8));
        let mean_of = |power: &dyn Fn(f64) -> f64| {
            let sum: f64 = picture.samples().iter().map(|&v| power(f64::from(v) - 127.3)).sum();
            sum / SIZE.area() as f64
        };
        let (mean, square) = (mean_of(&|v| v), mean_of(&|v| v * v));
        if sigma == 0.0 {
            assert!(picture.samples().iter().all(|&v| v == 127));
            continue;
        }
        // rounding adds a twelfth to the variance
        let deviation = (square - mean * mean - 1.0 / 12.0).sqrt();
        assert!((deviation / sigma - 1.0).abs() < 0.01, "{deviation} for {sigma}");
        assert!(mean.abs() < 4.0 * sigma / (SIZE.area() as f64).sqrt(), "mean {mean}");
        let fourth = mean_of(&|v| v * v * v * v) / (square * square);
        assert!((fourth - 3.0).abs() < 0.1, "kurtosis {fourth}");
    }
}

#[test]
fn difficulty_follows_its_definition() {
    let class = |setup: Setup| setup.truth()[0].difficulty;
    let easy = || Setup { sigma: 5.0, ..one([60.0, 0.3, 0.3, 1.0], false) };
    assert_eq!(class(easy()), Difficulty::Easy);
    let tilted = |degrees: f64| one([120.0, 0.0, degrees.to_radians(), 1.0], false);
    let motion = |px: f64| Blur::Motion(DVec2::new(0.6, 0.8) * px);
    let dim = Light { level: 0.2, ..Light::EVEN };
    // step 200: SNR 10 at σ 20, 4 at σ 50
    let cases = [
        (Setup { sigma: 19.9, ..easy() }, Difficulty::Easy),
        (Setup { sigma: 20.1, ..easy() }, Difficulty::Medium),
        (Setup { sigma: 49.0, ..easy() }, Difficulty::Medium),
        (Setup { sigma: 51.0, ..easy() }, Difficulty::Hard),
        (Setup { light: dim, ..easy() }, Difficulty::Medium),
        (Setup { light: dim, sigma: 11.0, ..easy() }, Difficulty::Hard),
        (Setup { blur: Blur::Gaussian(0.79), ..easy() }, Difficulty::Easy),
        (Setup { blur: Blur::Gaussian(0.81), ..easy() }, Difficulty::Medium),
        (Setup { blur: motion(0.9), ..easy() }, Difficulty::Easy),
        (Setup { blur: motion(5.9), ..easy() }, Difficulty::Medium),
        (Setup { blur: motion(6.1), ..easy() }, Difficulty::Hard),
        (one([26.0, 0.0, 0.0, 0.0], false), Difficulty::Easy),
        (one([23.0, 0.0, 0.0, 0.0], false), Difficulty::Medium),
        (one([13.0, 0.0, 0.0, 0.0], false), Difficulty::Hard),
        (tilted(44.0), Difficulty::Easy),
        (tilted(46.0), Difficulty::Medium),
        (tilted(66.0), Difficulty::Hard),
    ];
    for (i, (setup, difficulty)) in cases.into_iter().enumerate() {
        assert_eq!(class(setup), difficulty, "case {i}");
    }
}

#[test]
fn sets_are_spread_as_described() {
    let (mut classes, mut kinds, mut markers) = ([0; 3], [0; 3], 0);
    for number in 0..400 {
        let mut rng = SplitMix64::new(number);
        let setup = Setup::accuracy(&mut rng, Size::new(640, 480), Family::Aruco5x5_100);
        let truths = setup.truth();
        assert!((1..=6).contains(&truths.len()));
        assert!((0.0..20.0).contains(&setup.sigma));
        kinds[setup.background as usize] += 1;
        for (i, truth) in truths.iter().enumerate() {
            classes[truth.difficulty as usize] += 1;
            markers += 1;
            assert!(truth.tilt_deg < 75.01 && (truth.id as usize) < 100);
            assert!(truths[..i].iter().all(|other| other.id != truth.id));
            let inside = |p: &DVec2| p.min_element() > 1.0 && p.x < 638.0 && p.y < 478.0;
            assert!(truth.corners.iter().all(inside));
        }
    }
    let shares = kinds.map(|count| f64::from(count) / 400.0);
    for (share, asked) in shares.iter().zip([0.25, 0.3, 0.45]) {
        assert!((share - asked).abs() < 0.08, "backgrounds {shares:?}");
    }
    assert!(classes.iter().all(|&count| count * 10 > markers), "classes {classes:?}");
    for kind in 0..3 {
        let rng = &mut SplitMix64::new(kind as u64);
        let speed = Setup::speed(rng, SIZE, Family::Tag36h11, kind);
        assert_eq!(speed.sigma, [2.0, 3.0, 10.0][kind]);
        assert!(speed.truth().iter().all(|truth| truth.tilt_deg < 60.01));
        let still = Setup::still(rng, Size::new(640, 480), Family::Tag36h11, kind);
        assert_eq!((still.sigma, still.prints.len()), ([2.0, 5.0, 10.0][kind], 1));
        assert!(Setup::negative(rng, SIZE, Family::Tag16h5, false).prints.is_empty());
    }
}

/// The same numbers give the same pictures, on any number of threads; draws differ in their noise alone.
#[test]
fn shots_are_repeatable() {
    let take = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
        pool.install(|| shots(3..6, 2, |rng, kind| Setup::still(rng, SIZE, Family::Tag36h11, kind)))
    };
    let (one, two) = (take(1), take(2));
    for (one, two) in one.iter().zip(&two) {
        assert_eq!(one.pictures, two.pictures);
        let apart = |i: usize| f64::from(one.pictures[0].samples()[i].abs_diff(one.pictures[1].samples()[i]));
        let square = (0..SIZE.area()).map(|i| apart(i) * apart(i)).sum::<f64>() / SIZE.area() as f64;
        let expected = one.setup.sigma * 2f64.sqrt();
        assert!((square.sqrt() / expected - 1.0).abs() < 0.05, "{} for {expected}", square.sqrt());
    }
    assert_ne!(one[0].pictures, one[1].pictures);
}
