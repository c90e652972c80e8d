//! Real photographs. One crop is carried; the whole reference folder runs when VERNISSAGE_REFERENCE names it.

use glam::DVec2;
use std::path::Path;
use vernissage::frame::Sighting;
use vernissage::geometry::Lens;
use vernissage::marker::Family;
use vernissage::pixels::{picture, simd};
use vernissage::track::{Config, Tracker, Wanted, mean_side};

fn all_of(family: Family) -> Wanted {
    Wanted { family, id: None, side_mm: 65.0 }
}

fn near(sighting: &Sighting, corners: &[DVec2; 4], px: f64) -> bool {
    sighting.corners.iter().zip(corners).all(|(a, b)| (*a - *b).length() <= px)
}

/// Six small tags (16 to 29 px) on paper, corners as AprilTag 3 gave them at full resolution.
#[test]
fn the_carried_crop_is_read_whole() {
    let gray =
        picture::read_gray(Path::new("tests/data/markers/duckietown_240x216.png")).expect("carried picture");
    let truth = [
        (22, [(143.5, 58.5), (159.6, 50.0), (167.2, 65.8), (151.7, 73.8)]),
        (24, [(190.1, 20.6), (204.2, 13.6), (209.8, 27.7), (196.0, 34.6)]),
        (58, [(76.0, 114.4), (94.5, 104.8), (107.8, 122.0), (89.7, 130.7)]),
        (85, [(120.0, 80.1), (137.9, 69.8), (147.7, 86.5), (130.5, 96.4)]),
        (144, [(19.4, 182.2), (44.7, 166.8), (62.9, 184.4), (39.5, 199.1)]),
        (198, [(167.5, 36.8), (182.8, 29.4), (189.1, 44.9), (174.2, 51.7)]),
    ];
    let lens = Lens::guess(gray.size());
    let mut tracker = Tracker::new(Config::default(), simd::best());
    let seen = tracker.find(gray.view(), &lens, &[all_of(Family::Tag36h11)]);
    assert_eq!(seen.iter().map(|s| s.id).collect::<Vec<_>>(), truth.map(|(id, _)| id));
    for (sighting, (id, corners)) in seen.iter().zip(truth) {
        let corners = corners.map(|(x, y)| DVec2::new(x, y));
        assert!(near(sighting, &corners, 0.5), "{id}: {:?}", sighting.corners);
        assert!(sighting.pose.is_some());
    }
    for family in [Family::Aruco4x4_50, Family::Aruco5x5_100, Family::Aruco6x6_250] {
        assert!(tracker.find(gray.view(), &lens, &[all_of(family)]).is_empty(), "{}", family.name());
    }
}

#[test]
fn every_known_marker_is_found() {
    let Some(folder) = std::env::var_os("VERNISSAGE_REFERENCE") else {
        eprintln!("SKIPPED: set VERNISSAGE_REFERENCE to the reference folder to run the photographs");
        return;
    };
    let folder = Path::new(&folder).join("markers");
    let truth =
        std::fs::read_to_string(folder.join("truth.jsonl")).expect("truth.jsonl in the reference folder");
    let mut tracker = Tracker::new(Config::default(), simd::best());
    let mut missed = Vec::new();
    for line in truth.lines() {
        let line: serde_json::Value = serde_json::from_str(line).expect("a JSON object a line");
        let name = line["image"].as_str().expect("image");
        let gray = picture::read_gray(&folder.join(name)).expect("picture");
        let lens = Lens::guess(gray.size());
        let family = line["family"].as_str().and_then(|name| Family::from_name(name).ok());
        let wanted: Vec<Wanted> =
            Family::ALL.into_iter().filter(|f| family.is_none_or(|g| g == *f)).map(all_of).collect();
        let seen = tracker.find(gray.view(), &lens, &wanted);
        let markers = line["markers"].as_array().expect("markers");
        let mut found = 0;
        for marker in markers {
            let corner = |i: usize, axis: usize| marker["corners"][i][axis].as_f64().expect("corner");
            let corners = [0, 1, 2, 3].map(|i| DVec2::new(corner(i, 0), corner(i, 1)));
            let id = marker["id"].as_u64().expect("id");
            if seen.iter().any(|s| u64::from(s.id) == id && near(s, &corners, 1.5)) {
                found += 1;
            } else {
                missed.push(format!("{name}: id {id}, {:.0} px", mean_side(&corners)));
            }
        }
        eprintln!("{name}: {found} of {}, {} seen in all", markers.len(), seen.len());
        assert!(!markers.is_empty() || seen.is_empty(), "{name}: ghosts {seen:?}");
    }
    assert!(missed.is_empty(), "missed: {missed:#?}");
}
