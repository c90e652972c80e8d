//! `vernissage sheet`: what is printed is found again, in its true size.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use vernissage::geometry::Lens;
use vernissage::marker::Family;
use vernissage::pixels::{Plane, Size, simd};
use vernissage::track::{Config, Tracker, Wanted};

/// The page is laid out at 600 dpi and looked at with every 2x2 pixels averaged: prints of more than 700 px whose edges
/// are sharper than any lens draws them are beyond the tracker's alignment.
const DPI: f64 = 600.0;
const DPI_SEEN: f64 = 0.5 * DPI;
/// Of the page as it is looked at.
const PX_A_MM: f64 = DPI_SEEN / 25.4;

fn vernissage(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vernissage")).args(args).output().expect("the built binary runs")
}

fn file(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("sheet");
    std::fs::create_dir_all(&folder).expect("a test folder");
    folder.join(name)
}

/// Runs `sheet` and gives what it says and wrote.
fn sheet(name: &str, args: &[&str]) -> (String, Vec<u8>) {
    let path = file(name);
    let output = vernissage(&[&["sheet", "--out", path.to_str().expect("plain path")], args].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    (String::from_utf8(output.stdout).expect("text"), std::fs::read(path).expect("a sheet"))
}

/// Size of an SVG sheet in mm and its black rectangles.
fn rectangles(svg: &[u8]) -> ([f64; 2], Vec<[f64; 4]>) {
    let text = std::str::from_utf8(svg).expect("text");
    let side = |key: &str| -> f64 {
        let rest = text.split_once(&format!("{key}=\"")).expect(key).1;
        rest.split_once("mm\"").expect("mm").0.parse().expect("a number")
    };
    let mut rects = Vec::new();
    for shape in text.split("<path d=\"").skip(1) {
        for part in shape.split('"').next().expect("a path").split('M').skip(1) {
            let numbers: Vec<f64> = part
                .split(|c: char| !(c.is_ascii_digit() || c == '.'))
                .filter_map(|n| n.parse().ok())
                .collect();
            rects.push([numbers[0], numbers[1], numbers[2], numbers[3]]);
        }
    }
    ([side("width"), side("height")], rects)
}

/// The page as it is looked at.
fn rasterize(size: [f64; 2], rects: &[[f64; 4]]) -> Plane<u8> {
    let a_mm = DPI / 25.4;
    // whole pixels of what is looked at
    let [width, height] = size.map(|mm| (mm * PX_A_MM).round() as usize * 2);
    let mut ink = vec![0f32; width * height];
    for [x, y, w, h] in rects.iter().map(|rect| rect.map(|mm| mm * a_mm)) {
        let part = |i: usize, low: f64, high: f64| (high.min(i as f64 + 1.0) - low.max(i as f64)).max(0.0);
        for row in y.max(0.0) as usize..((y + h).ceil() as usize).min(height) {
            for column in x.max(0.0) as usize..((x + w).ceil() as usize).min(width) {
                ink[row * width + column] += (part(column, x, x + w) * part(row, y, y + h)) as f32;
            }
        }
    }
    let paper = |x: usize, y: usize| 1.0 - ink[y * width + x].clamp(0.0, 1.0);
    Plane::from_fn(Size::new(width / 2, height / 2), |x, y| {
        let sum: f32 = (0..4).map(|k| paper(2 * x + k % 2, 2 * y + k / 2)).sum();
        (255.0 * 0.25 * sum + 0.5) as u8
    })
}

/// Every marker found on the page, by number, with the lengths of its edges in mm.
fn found(page: &Plane<u8>, family: Family) -> Vec<(u32, [f64; 4])> {
    let mut tracker = Tracker::new(Config::default(), simd::best());
    let wanted = [Wanted { family, id: None, side_mm: 1.0 }];
    let sightings = tracker.find(page.view(), &Lens::guess(page.size()), &wanted);
    let edges = |corners: [glam::DVec2; 4]| {
        std::array::from_fn(|i| (corners[(i + 1) % 4] - corners[i]).length() / PX_A_MM)
    };
    sightings.iter().map(|s| (s.id, edges(s.corners))).collect()
}

/// Finds exactly these ids, every edge within .05 mm.
fn holds(svg: &[u8], family: Family, ids: impl Iterator<Item = u32>, side: f64) {
    let (size, rects) = rectangles(svg);
    let found = found(&rasterize(size, &rects), family);
    assert_eq!(found.iter().map(|(id, _)| *id).collect::<Vec<_>>(), ids.collect::<Vec<_>>());
    for (id, edges) in found {
        let worst = edges.iter().map(|edge| (edge - side).abs()).fold(0.0, f64::max);
        assert!(worst < 0.05, "{} {id}: edges {edges:?}, not {side}", family.name());
    }
}

#[test]
fn a_sheet_without_options_is_a_page_of_markers_of_80_mm() {
    let (told, svg) = sheet("plain.svg", &[]);
    assert!(told.contains("tag36h11 0 1 2 3, 80 mm wide"), "{told}");
    assert!(rectangles(&svg).0 == [210.0, 297.0]);
    holds(&svg, Family::Tag36h11, 0..4, 80.0);
}

#[test]
fn other_families_papers_and_sizes_are_found_again() {
    let (_, svg) = sheet(
        "aruco.svg",
        &["--family", "aruco_5x5_100", "--ids", "3-5,9", "--side-mm", "42.5", "--paper", "letter"],
    );
    assert!(rectangles(&svg).0 == [215.9, 279.4]);
    holds(&svg, Family::Aruco5x5_100, [3, 4, 5, 9].into_iter(), 42.5);
    let (_, svg) =
        sheet("tag25.svg", &["--family", "tag25h9", "--ids", "1", "--side-mm", "130", "--landscape"]);
    assert!(rectangles(&svg).0 == [297.0, 210.0]);
    holds(&svg, Family::Tag25h9, 1..2, 130.0);
}

#[test]
fn a_board_is_found_again_and_its_table_is_read() {
    let (table, svg) = sheet("board.svg", &["--board"]);
    holds(&svg, Family::Tag36h11, 0..35, 30.5);
    let config = vernissage::app::config::Config::parse(&table, Path::new("board.toml")).expect("a table");
    let scene = vernissage::scene::Scene::default().on_boards(&config.board).expect("a board");
    assert_eq!(scene.boards[0].prints.len(), 35);
    // the table's places are those on the page: markers of the first row, and the one below the first
    let (size, rects) = rectangles(&svg);
    let mut tracker = Tracker::new(Config::default(), simd::best());
    let page = rasterize(size, &rects);
    let wanted = [Wanted { family: Family::Tag36h11, id: None, side_mm: 30.5 }];
    let sightings = tracker.find(page.view(), &Lens::guess(page.size()), &wanted);
    for (sighting, print) in sightings.iter().zip(&scene.boards[0].prints) {
        let middle = sighting.corners.iter().sum::<glam::DVec2>() * 0.25;
        let first = sightings[0].corners.iter().sum::<glam::DVec2>() * 0.25;
        let seen = (middle - first) / PX_A_MM;
        let told = print.to_board.translation - scene.boards[0].prints[0].to_board.translation;
        assert!((seen - glam::DVec2::new(told.x, -told.y)).length() < 0.02, "{}: {seen} {told}", print.id);
    }
}

#[test]
fn the_pdf_holds_the_same_rectangles_as_the_svg() {
    for args in [&["--ids", "0-8"][..], &["--board", "3x4", "--paper", "a3"]] {
        let (_, svg) = sheet("same.svg", args);
        let (_, pdf) = sheet("same.pdf", args);
        let text = String::from_utf8_lossy(&pdf).into_owned();
        assert!(text.starts_with("%PDF-1.") && text.contains("/PrintScaling /None"));
        let ([width, height], mut drawn) = rectangles(&svg);
        // further pages of markers are files of their own
        for page in ["same-2.svg", "same-3.svg"].iter().filter(|_| args[0] == "--ids") {
            drawn.extend(rectangles(&std::fs::read(file(page)).expect("a further page")).1);
        }
        let numbers = |line: &str| line.split(' ').filter_map(|n| n.parse::<f64>().ok()).collect::<Vec<_>>();
        let boxed = text.split("/MediaBox [").nth(1).and_then(|t| t.split(']').next()).expect("a page");
        let points = numbers(boxed);
        assert!(
            (points[2] - width * 72.0 / 25.4).abs() < 1e-3 && (points[3] - height * 72.0 / 25.4).abs() < 1e-3
        );
        let rects: Vec<Vec<f64>> = text.lines().filter(|line| line.ends_with(" re")).map(numbers).collect();
        assert_eq!(rects.len(), drawn.len());
        for (pdf, svg) in rects.iter().zip(&drawn) {
            let expected = [svg[0], height - svg[1] - svg[3], svg[2], svg[3]];
            for (a, b) in pdf.iter().zip(expected) {
                assert!((a - b).abs() < 1e-4, "{pdf:?} {expected:?}");
            }
        }
    }
}

#[test]
fn what_cannot_be_printed_is_refused_in_one_line() {
    let out = file("refused.pdf");
    let out = out.to_str().expect("plain path");
    for (args, says) in [
        (&["--side-mm", "250"][..], "give 160 mm at most"),
        (&["--side-mm", "-3"], "1 to 1000 mm"),
        (&["--ids", "600"], "ids 0 to 586"),
        (&["--ids", "5-2"], "other way round"),
        (&["--ids", "x"], "write it as"),
        (&["--family", "tag36h12"], "did you mean `tag36h11`"),
        (&["--family", "tag16h5", "--board"], "30 codes"),
        (&["--board", "5x7", "--side-mm", "50"], "up to 30.7 mm"),
        (&["--board", "1x1"], "2 prints or more"),
        (&["--out", "sheet.png"], ".pdf or an .svg"),
    ] {
        let own = args.contains(&"--out");
        let rest = if own { &[][..] } else { &["--out", out] };
        let output = vernissage(&[&["sheet"][..], args, rest].concat());
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {text}");
        assert!(text.contains(says) && !text.contains("panicked"), "{args:?}: {text}");
    }
}
