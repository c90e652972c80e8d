//! Boards of several prints: one pose, better than any print's own; covered prints are where they are.

use glam::{DMat3, DVec2, DVec3};
use vernissage::app::bench::markers::{Blur, SIDE_MM, Setup, pose_at};
use vernissage::frame::{Sighting, State};
use vernissage::geometry::{Lens, Pose};
use vernissage::marker::{Board, Family, Print};
use vernissage::pixels::{Size, SplitMix64, simd};
use vernissage::track::{Config, Tracker, Wanted};

const SIZE: Size = Size { width: 640, height: 480 };
const FAMILY: Family = Family::Tag36h11;

/// Four prints on a sheet.
fn sheet() -> Board {
    let print = |(id, x, y)| Print {
        family: FAMILY,
        id,
        side_mm: SIDE_MM,
        to_board: Pose { rotation: DMat3::IDENTITY, translation: DVec3::new(x, y, 0.0) },
    };
    Board {
        prints: [(0, -80.0, 80.0), (1, 80.0, 80.0), (2, 80.0, -80.0), (3, -80.0, -80.0)].map(print).into(),
    }
}

/// Three sides of a box, a quarter turn from each other.
fn corner() -> Board {
    let faces = [
        DMat3::IDENTITY,
        DMat3::from_rotation_y(90f64.to_radians()),
        DMat3::from_rotation_x(-90f64.to_radians()),
    ];
    let print = |(id, turn): (u32, DMat3)| Print {
        family: FAMILY,
        id,
        side_mm: SIDE_MM,
        to_board: Pose { rotation: turn, translation: turn * DVec3::new(0.0, 0.0, 70.0) },
    };
    Board { prints: (10..).zip(faces).map(print).collect() }
}

/// What is reported of the prints in `drawn`, without a board and with `known`; they stand as `board` says.
fn look(board: &Board, known: &Board, pose: &Pose, drawn: &[u32], seed: u64) -> [Vec<Sighting>; 2] {
    let prints = board.prints.iter().filter(|print| drawn.contains(&print.id));
    let prints = prints.map(|print| (print.id, pose.after(&print.to_board))).collect();
    let calm = Setup::calm(&Lens::guess(SIZE), FAMILY, prints, seed);
    let setup = Setup { blur: Blur::Gaussian(0.7), sigma: 6.0, ..calm };
    let picture = setup.shoot();
    let wanted = [Wanted { family: FAMILY, id: None, side_mm: SIDE_MM }];
    [Vec::new(), vec![known.clone()]].map(|boards| {
        let mut tracker = Tracker::new(Config::default(), simd::best()).with_boards(boards);
        tracker.find(picture.view(), &setup.lens, &wanted).to_vec()
    })
}

/// Rotation errors in degrees of the prints' poses.
fn errors(board: &Board, pose: &Pose, seen: &[Sighting]) -> Vec<f64> {
    let error = |sighting: &Sighting| {
        let print = board.prints.iter().find(|print| print.id == sighting.id).expect("on the board");
        let truth = pose.after(&print.to_board);
        sighting.pose.expect("a pose").pose.angle_to(&truth).to_degrees()
    };
    seen.iter().map(error).collect()
}

#[test]
fn a_boards_pose_is_better_than_its_prints() {
    let mut rng = SplitMix64::new(5);
    for (board, side, tilt) in [(sheet(), 42.0, 0.3), (corner(), 60.0, 0.95)] {
        let (mut alone, mut together) = (Vec::new(), Vec::new());
        for case in 0..30 {
            let (spin, about) = if tilt < 0.5 { (rng.f64() * 6.3, rng.f64() * 6.3) } else { (0.0, -0.785) };
            let center = DVec2::new(280.0 + 80.0 * rng.f64(), 200.0 + 80.0 * rng.f64());
            let pose = pose_at(&Lens::guess(SIZE), center, side, spin, tilt, about).expect("in view");
            let ids: Vec<u32> = board.prints.iter().map(|print| print.id).collect();
            let [apart, one] = look(&board, &board, &pose, &ids, 100 + case);
            assert!(one.len() >= 3, "case {case}: {one:?}");
            alone.extend(errors(&board, &pose, &apart));
            together.extend(errors(&board, &pose, &one));
        }
        alone.sort_by(f64::total_cmp);
        together.sort_by(f64::total_cmp);
        let at = |errors: &[f64], q: f64| errors[(q * (errors.len() - 1) as f64) as usize];
        println!(
            "alone: median {:.3}° worst {:.2}°; together {:.3}° {:.2}°",
            at(&alone, 0.5),
            at(&alone, 1.0),
            at(&together, 0.5),
            at(&together, 1.0)
        );
        assert!(at(&together, 0.5) < 0.4 * at(&alone, 0.5));
        assert!(at(&together, 1.0) < 0.6, "{}", at(&together, 1.0));
    }
}

#[test]
fn covered_prints_are_held_where_they_are() {
    let board = sheet();
    let pose = pose_at(&Lens::guess(SIZE), DVec2::new(322.0, 238.0), 70.0, 0.4, 0.5, 1.0).expect("in view");
    for drawn in [vec![0, 2, 3], vec![1, 3], vec![2]] {
        let [_, seen] = look(&board, &board, &pose, &drawn, 8);
        assert_eq!(seen.iter().map(|s| s.id).collect::<Vec<_>>(), [0, 1, 2, 3]);
        for sighting in &seen {
            let held = sighting.state == State::Held;
            assert_eq!(held, !drawn.contains(&sighting.id));
            let lens = Lens::guess(SIZE);
            let truth = pose.after(&board.prints[sighting.id as usize].to_board);
            let corner = vernissage::track::solve::corners_mm(SIDE_MM)[2];
            let off = (lens.project(truth.apply(corner)).expect("in view") - sighting.corners[2]).length();
            // a lone print's pose reaches less far
            assert!(off < if drawn.len() > 1 { 0.5 } else { 3.0 }, "{off} px, {drawn:?}");
        }
    }
    let [_, nothing] = look(&board, &board, &pose, &[], 9);
    assert!(nothing.is_empty());
}

/// A print that lies elsewhere than the board says keeps its own pose and does not pull.
#[test]
fn a_loose_print_does_not_pull() {
    let board = sheet();
    let mut bent = board.clone();
    bent.prints[3].to_board.translation += DVec3::new(-45.0, 20.0, 0.0);
    let pose = pose_at(&Lens::guess(SIZE), DVec2::new(322.0, 238.0), 70.0, 0.4, 0.5, 1.0).expect("in view");
    let [apart, seen] = look(&bent, &board, &pose, &[0, 1, 2, 3], 8);
    assert_eq!(seen.len(), 4);
    let own = |sightings: &[Sighting]| sightings[3].pose.expect("a pose").pose;
    assert!(own(&seen).angle_to(&own(&apart)) < 1e-9, "it keeps its own");
    for sighting in &seen[..3] {
        let truth = pose.after(&board.prints[sighting.id as usize].to_board);
        let off = sighting.pose.expect("a pose").pose.angle_to(&truth).to_degrees();
        assert!(off < 0.3, "print {} is {off}° off", sighting.id);
    }
}
