//! Every family of markers: read small, blurred, noisy and in uneven light, and never seen where it is not.

use glam::{DMat3, DVec2, DVec3};
use std::path::Path;
use vernissage::frame::Sighting;
use vernissage::geometry::{Homography, Lens};
use vernissage::marker::{Family, Patterns};
use vernissage::pixels::{Plane, Size, SplitMix64, simd};
use vernissage::track::{Config, Tracker, Wanted};

const SIZE: Size = Size { width: 320, height: 240 };

fn all_of(family: Family) -> Wanted {
    Wanted { family, id: None, side_mm: 80.0 }
}

/// A gray picture being drawn, 0..1.
struct Canvas {
    gray: Vec<f64>,
}

impl Canvas {
    fn new(gray: f64) -> Self {
        Self { gray: vec![gray; SIZE.width * SIZE.height] }
    }

    /// Prints a picture whose black border has these corners, TL TR BR BL; `paper` samples are around it.
    fn print(&mut self, picture: &Plane<u8>, paper: f64, corners: [DVec2; 4]) {
        let side = picture.size().width as f64;
        let cells = side - 2.0 * paper;
        let inverse: DMat3 = Homography::from_square(corners).expect("a proper quad").0.inverse();
        let center = (corners[0] + corners[2]) * 0.5;
        let reach = corners.iter().map(|c| (*c - center).length()).fold(0.0, f64::max) * 1.5 + 2.0;
        let range = |middle: f64, most: usize| {
            (middle - reach).max(0.0) as usize..((middle + reach).max(0.0) as usize).min(most)
        };
        for y in range(center.y, SIZE.height) {
            for x in range(center.x, SIZE.width) {
                let pixel = &mut self.gray[y * SIZE.width + x];
                let mut sum = 0.0;
                for k in 0..25 {
                    let offset = DVec2::new((k % 5) as f64, (k / 5) as f64) / 5.0 - 0.4;
                    let seen = DVec2::new(x as f64, y as f64) + offset;
                    let q = inverse * DVec3::new(seen.x, seen.y, 1.0);
                    let square = DVec2::new(q.x / q.z + 1.0, 1.0 - q.y / q.z) * (0.5 * cells) + paper;
                    let inside = square.min_element() >= 0.0 && square.max_element() < side;
                    sum += if inside {
                        f64::from(picture.at(square.x as usize, square.y as usize)) / 255.0
                    } else {
                        *pixel
                    };
                }
                *pixel = sum / 25.0;
            }
        }
    }

    /// The camera's picture: blurred, lit by `light`, black at `black` and white at `white`, noisy.
    fn take(
        &self,
        sigma_blur: f64,
        (black, white): (f64, f64),
        sigma_noise: f64,
        light: impl Fn(f64, f64) -> f64,
        seed: u64,
    ) -> Plane<u8> {
        let mut gray = self.gray.clone();
        let radius = (3.0 * sigma_blur).ceil() as isize;
        let weight = |k: isize| {
            let z = k as f64 / sigma_blur.max(1e-9);
            libm::exp(-0.5 * z * z)
        };
        let total: f64 = (-radius..=radius).map(weight).sum();
        for (across, down) in [(1, 0), (0, 1)] {
            let from = gray.clone();
            for (i, value) in gray.iter_mut().enumerate() {
                let (x, y) = ((i % SIZE.width) as isize, (i / SIZE.width) as isize);
                let at = |k: isize| {
                    let u = (x + k * across).clamp(0, SIZE.width as isize - 1) as usize;
                    let v = (y + k * down).clamp(0, SIZE.height as isize - 1) as usize;
                    weight(k) * from[v * SIZE.width + u]
                };
                *value = (-radius..=radius).map(at).sum::<f64>() / total;
            }
        }
        let mut rng = SplitMix64::new(seed);
        Plane::from_fn(SIZE, |x, y| {
            let bell: f64 = (0..12).map(|_| rng.f64()).sum::<f64>() - 6.0;
            let lit = (black + (white - black) * gray[y * SIZE.width + x]) * light(x as f64, y as f64);
            (lit + sigma_noise * bell + 0.5).clamp(0.0, 255.0) as u8
        })
    }
}

/// A square of this side turned by `angle`, its far side narrower by `tilt`.
fn quad(center: DVec2, side: f64, angle: f64, tilt: f64) -> [DVec2; 4] {
    let (sin, cos) = (libm::sin(angle), libm::cos(angle));
    [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(x, y)| {
        let depth = 1.0 - tilt * y;
        let p = DVec2::new(x, y) * (0.5 * side / depth);
        center + DVec2::new(p.x * cos - p.y * sin, p.x * sin + p.y * cos)
    })
}

/// Twelve markers of a family on a sheet: their numbers and corners.
fn sheet(family: Family, side: f64, seed: u64) -> (Canvas, Vec<(u32, [DVec2; 4])>) {
    let mut rng = SplitMix64::new(seed);
    let mut canvas = Canvas::new(0.8);
    let mut markers = Vec::new();
    for place in 0..12 {
        let id = (rng.next_u64() % family.codes().len() as u64) as u32;
        let center = DVec2::new(40.0 + 80.0 * (place % 4) as f64, 40.0 + 80.0 * (place / 4) as f64)
            + DVec2::new(rng.f64(), rng.f64());
        let corners = quad(center, side, rng.f64() * 6.3, 0.12 * rng.f64());
        canvas.print(&family.picture(id).expect("id"), 1.0, corners);
        markers.push((id, corners));
    }
    (canvas, markers)
}

/// How many of the markers were seen where they are, and how many sightings are none of them.
fn count(markers: &[(u32, [DVec2; 4])], seen: &[Sighting]) -> (usize, usize) {
    let right = |s: &Sighting| {
        let near =
            |corners: &[DVec2; 4]| s.corners.iter().zip(corners).all(|(a, b)| (*a - *b).length() < 2.0);
        markers.iter().any(|(id, corners)| s.id == *id && near(corners))
    };
    let found = seen.iter().filter(|s| right(s)).count();
    (found, seen.len() - found)
}

struct Look {
    name: &'static str,
    /// Least side, px, and for 7x7 and 6x6 so much larger as they have more cells than 4x4.
    side: f64,
    blur: f64,
    ink: (f64, f64),
    noise: f64,
    light: fn(f64, f64) -> f64,
    /// Least share found.
    least: f64,
}

const EVEN: fn(f64, f64) -> f64 = |_, _| 1.0;

const LOOKS: [Look; 6] = [
    Look { name: "small", side: 14.0, blur: 0.4, ink: (30.0, 220.0), noise: 2.0, light: EVEN, least: 0.85 },
    Look { name: "blurred", side: 20.0, blur: 1.0, ink: (30.0, 220.0), noise: 2.0, light: EVEN, least: 0.9 },
    Look { name: "noisy", side: 28.0, blur: 0.6, ink: (30.0, 220.0), noise: 20.0, light: EVEN, least: 0.8 },
    Look { name: "dim", side: 28.0, blur: 0.6, ink: (10.0, 40.0), noise: 2.0, light: EVEN, least: 0.9 },
    Look {
        name: "gradient",
        side: 30.0,
        blur: 0.6,
        ink: (20.0, 230.0),
        noise: 3.0,
        light: |x, y| 0.25 + 0.5 * libm::fabs(libm::sin((x + y) / 60.0)),
        least: 0.9,
    },
    Look {
        name: "shadow edges",
        side: 36.0,
        blur: 0.6,
        ink: (20.0, 230.0),
        noise: 3.0,
        light: |x, y| if ((x + 0.4 * y) as i64 / 40) % 2 == 0 { 1.0 } else { 0.55 },
        least: 0.6,
    },
];

#[test]
fn every_family_is_read_in_every_look() {
    let lens = Lens::guess(SIZE);
    let mut tracker = Tracker::new(Config::default(), simd::best());
    let mut short = Vec::new();
    for family in Family::ALL {
        let mut line = format!("{:22}", family.name());
        for (number, look) in LOOKS.iter().enumerate() {
            let (mut found, mut ghosts, mut drawn) = (0, 0, 0);
            for seed in 0..4 {
                let code_cells = family.inner() + 2;
                let side = look.side * (code_cells.max(6) as f64 / 6.0);
                let (canvas, markers) = sheet(family, side, seed * 10 + number as u64);
                let frame = canvas.take(look.blur, look.ink, look.noise, look.light, seed);
                let seen = tracker.find(frame.view(), &lens, &[all_of(family)]);
                let (right, wrong) = count(&markers, seen);
                (found, ghosts, drawn) = (found + right, ghosts + wrong, drawn + markers.len());
            }
            line += &format!(" {}: {found}/{drawn}, {ghosts};", look.name);
            if ghosts > 0 || (found as f64) < look.least * drawn as f64 {
                short.push(format!("{} {}: {found} of {drawn}, {ghosts} ghosts", family.name(), look.name));
            }
        }
        eprintln!("{line}");
    }
    assert!(short.is_empty(), "{short:#?}");
}

/// Frames full of what looks like a marker: other families', checkerboards, nested squares, letters, blocks.
/// Each with its name (the family's, where they are markers) and the numbers of the markers in it.
fn decoys() -> Vec<(String, Plane<u8>, Vec<u32>)> {
    let mut frames = Vec::new();
    for other in Family::ALL {
        for seed in 0..6 {
            let (canvas, markers) = sheet(other, 24.0 + 5.0 * seed as f64, 100 + seed);
            let ids = markers.iter().map(|(id, _)| *id).collect();
            frames.push((other.name().into(), canvas.take(0.6, (30.0, 220.0), 3.0, EVEN, seed), ids));
        }
    }
    for (seed, side) in [(0, 14usize), (1, 23), (2, 36)] {
        let mut canvas = Canvas::new(0.9);
        for (i, gray) in canvas.gray.iter_mut().enumerate() {
            let (x, y) = (i % SIZE.width, i / SIZE.width);
            *gray = if (x / side + y / side) % 2 == 0 { 0.0 } else { 1.0 };
        }
        frames.push(("checkerboard".into(), canvas.take(0.6, (20.0, 230.0), 4.0, EVEN, seed), Vec::new()));
    }
    for seed in 0..40u64 {
        let mut rng = SplitMix64::new(seed + 7);
        let mut canvas = Canvas::new(0.85);
        for place in 0..12 {
            // a black square that holds random rectangles, rings and strokes: letters, icons, nested squares
            const SIDE: usize = 26;
            let mut ink = Plane::from_fn(Size::new(SIDE, SIDE), |x, y| {
                255 * u8::from(x.min(y).min(SIDE - 1 - x).min(SIDE - 1 - y) == 0)
            });
            let mut fill = |x: usize, y: usize, w: usize, h: usize, value: u8| {
                for row in y..(y + h).min(SIDE - 1) {
                    for column in x..(x + w).min(SIDE - 1) {
                        ink.row_mut(row)[column] = value;
                    }
                }
            };
            match seed % 4 {
                0 => {
                    for ring in 0..6 {
                        let at = 1 + 2 * ring + (rng.next_u64() % 3) as usize;
                        fill(at, at, 26 - 2 * at, 26 - 2 * at, 255 * (1 - (ring % 2) as u8));
                    }
                }
                1 => {
                    fill(5, 5, 16, 16, 255);
                    for _ in 0..4 {
                        let [x, y] = [0, 1].map(|_| 5 + (rng.next_u64() % 12) as usize);
                        let (w, h) = if rng.next_u64() & 1 == 0 { (3, 10) } else { (10, 3) };
                        fill(x, y, w, h, 0);
                    }
                }
                2 => {
                    for _ in 0..10 {
                        let [x, y, w, h] = [0, 1, 2, 3].map(|_| 3 + (rng.next_u64() % 15) as usize);
                        fill(x, y, w.min(20 - x.min(19)) / 2 + 1, h.min(20 - y.min(19)) / 2 + 1, 255);
                    }
                }
                _ => {
                    // random cells of eight by eight in a frame, as in two-dimensional bar codes
                    for cell in 0..64 {
                        let value = 255 * (rng.next_u64() & 1) as u8;
                        fill(5 + cell % 8 * 2, 5 + cell / 8 * 2, 2, 2, value);
                    }
                }
            }
            let center = DVec2::new(40.0 + 80.0 * (place % 4) as f64, 40.0 + 80.0 * (place / 4) as f64);
            canvas.print(&ink, 1.0, quad(center, 16.0 + 36.0 * rng.f64(), rng.f64() * 6.3, 0.1 * rng.f64()));
        }
        frames.push((
            format!("framed signs {}", seed % 4),
            canvas.take(0.6, (30.0, 220.0), 4.0, EVEN, seed),
            Vec::new(),
        ));
    }
    for seed in 0..12u64 {
        // text-like: dark strokes on paper, and blocks
        let mut rng = SplitMix64::new(seed + 70);
        let mut canvas = Canvas::new(0.9);
        let unit = 2 + seed as usize % 5;
        for (i, gray) in canvas.gray.iter_mut().enumerate() {
            let (x, y) = (i % SIZE.width / unit, i / SIZE.width / unit);
            let h = vernissage::pixels::hash_noise(x as u32, y as u32, seed, 0);
            let stroke = if seed % 2 == 0 {
                h.is_multiple_of(3)
            } else {
                y % 3 != 2 && x % 4 != 3 && !h.is_multiple_of(5)
            };
            *gray = if stroke { 0.05 } else { 0.9 };
        }
        let noise = 2.0 + 6.0 * rng.f64();
        frames.push(("strokes".into(), canvas.take(0.7, (20.0, 230.0), noise, EVEN, seed), Vec::new()));
    }
    frames
}

#[test]
fn no_family_is_seen_where_it_is_not() {
    let lens = Lens::guess(SIZE);
    let mut tracker = Tracker::new(Config::default(), simd::best());
    let mut ghosts = Vec::new();
    let mut prints = 0;
    for (name, frame, ids) in decoys() {
        let from = Family::from_name(&name).ok();
        for family in Family::ALL {
            for s in tracker.find(frame.view(), &lens, &[all_of(family)]) {
                // a print that has, but for `max_hamming` bits, a code of this family is such a marker as well
                let alike = from.is_some_and(|from| {
                    let read = |id: &u32| family.read(from.codes()[*id as usize]);
                    from.inner() == family.inner()
                        && ids.iter().any(|id| read(id).is_some_and(|r| r.id == s.id))
                });
                if alike {
                    prints += 1;
                } else {
                    ghosts.push(format!(
                        "{name}: {} {} at {:?} margin {}",
                        family.name(),
                        s.id,
                        s.corners[0],
                        s.margin
                    ));
                }
            }
        }
    }
    eprintln!("{prints} sightings of prints that two families share");
    assert!(ghosts.is_empty(), "{} ghosts: {ghosts:#?}", ghosts.len());
}

/// A `.patt` file's marker: found, in each orientation, at its corners, and not where codes or other pictures are.
#[test]
fn picture_markers_are_seen() {
    let mut patterns = Patterns::default();
    let leaf =
        patterns.load(Path::new("tests/data/markers/leaf.patt"), Patterns::LEAST_MATCH).expect("a pattern");
    let print = patterns.print(leaf).expect("known");
    let lens = Lens::guess(SIZE);
    let mut tracker = Tracker::new(Config::default(), simd::best()).knowing(patterns);
    let wanted = [all_of(Family::Pattern)];
    let (mut found, mut off) = (0, Vec::new());
    for (seed, look) in (0..).zip(&LOOKS) {
        let mut rng = SplitMix64::new(seed);
        let mut canvas = Canvas::new(0.8);
        let mut markers = Vec::new();
        for place in 0..12 {
            let center = DVec2::new(40.0 + 80.0 * (place % 4) as f64, 40.0 + 80.0 * (place / 4) as f64)
                + DVec2::new(rng.f64(), rng.f64());
            let corners = quad(center, 2.0 * look.side.min(24.0), rng.f64() * 6.3, 0.12 * rng.f64());
            canvas.print(&print, 4.0, corners);
            markers.push((leaf, corners));
        }
        let frame = canvas.take(look.blur, look.ink, look.noise, look.light, seed);
        let seen = tracker.find(frame.view(), &lens, &wanted);
        let (right, wrong) = count(&markers, seen);
        eprintln!("{}: {right} of 12, {wrong} ghosts", look.name);
        assert_eq!(wrong, 0, "{}", look.name);
        found += right;
        if look.name == "small" {
            for s in seen {
                let miss = |corners: &[DVec2; 4]| {
                    s.corners.iter().zip(corners).map(|(a, b)| (*a - *b).length()).fold(0.0, f64::max)
                };
                off.push(markers.iter().map(|(_, corners)| miss(corners)).fold(f64::INFINITY, f64::min));
            }
        }
    }
    off.sort_by(f64::total_cmp);
    eprintln!("{found} of 72; corners off by {:.3} px (median of the worst of four)", off[off.len() / 2]);
    assert!(found >= 62, "{found} of 72");
    assert!(off[off.len() / 2] < 0.15, "{off:?}");
    for (name, frame, _) in decoys() {
        let seen = tracker.find(frame.view(), &lens, &wanted);
        assert!(seen.is_empty(), "{name}: {seen:?}");
    }
}
