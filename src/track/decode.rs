//! Quadrilateral → marker, read from gray through the homography.
//!
//! Black and white are planes over the marker, fitted to the border's ring and to the quiet zone's, so that a
//! lighting ramp moves the threshold along (AprilTag, Wang & Olson 2016). A quad without a dark ring in a
//! lighter one is dropped before a bit is read. If the plain reading matches no code, the bits are read
//! again sharpened against their neighbors, then restored from the blur (small markers), then with the quad shifted
//! a little.
//!
//! A short code alone is no marker: the print of the bits, blurred as the picture is, must explain the gray values all
//! over the code, not only at its cells' centers. How well it must, and how whole the rings, depends on how
//! often random bits are read as one of the family's codes ([`Family::chance`]).

use super::align::Aligned;
use super::bits::{MOST_BITS, SHARES, Soft, harden, restored};
use super::evidence::{Evidence, OFTEN};
use super::quad::Quad;
use super::rectify;
pub use super::ring::Level;
use super::ring::{Glance, Ring};
use crate::geometry::{Homography, Lens};
use crate::marker::{Family, Patch, Patterns, Polarity, Reading};
use crate::pixels::PlaneRef;
use glam::DVec2;

/// A picture seen through its lens.
#[derive(Clone, Copy)]
pub struct View<'a> {
    /// The gray picture; not empty.
    pub luma: PlaneRef<'a, u8>,
    /// Its lens.
    pub lens: &'a Lens,
    distorted: bool,
}

impl<'a> View<'a> {
    /// A picture, not empty, and its lens.
    pub fn new(luma: PlaneRef<'a, u8>, lens: &'a Lens) -> Self {
        Self { luma, lens, distorted: lens.is_distorted() }
    }

    /// Bilinear gray value at an ideal point, 0..255, clamped to the picture's border.
    #[inline]
    pub fn gray(&self, ideal: DVec2) -> f64 {
        let size = self.luma.size();
        let p = if self.distorted { rectify::seen(self.lens, ideal) } else { ideal };
        // `max` also turns NaN into 0
        let x = p.x.max(0.0).min((size.width - 1) as f64);
        let y = p.y.max(0.0).min((size.height - 1) as f64);
        // 32 bits hold every coordinate, and convert in one instruction either way
        let (column, row) = (x as i32, y as i32);
        let (s, t) = (x - f64::from(column), y - f64::from(row));
        let (column, row) = (column as usize, row as usize);
        let right = (column + 1).min(size.width - 1);
        let (top, bottom) = (self.luma.row(row), self.luma.row((row + 1).min(size.height - 1)));
        let mix = |line: &[u8]| f64::from(line[column]) * (1.0 - s) + f64::from(line[right]) * s;
        mix(top) * (1.0 - t) + mix(bottom) * t
    }
}

/// A quad read as a marker.
#[derive(Clone, Copy, Debug)]
pub struct Decoded {
    /// The family that was tried.
    pub family: Family,
    /// What its codes say.
    pub reading: Reading,
    /// Mean distance of the bits (or of a picture's samples) from their threshold, gray levels.
    pub margin: f64,
    /// The quad in the family's order, TL TR BR BL.
    pub quad: Quad,
    /// Whether the print must explain the picture all over: the bits or the outline were restored.
    pub doubtful: bool,
    /// Gray of what is black in the official picture (the lighter one of an inverted print).
    pub black: Level,
    /// Gray of what is white in the official picture.
    pub white: Level,
}

impl Decoded {
    /// Whether its alignment confirms a doubtful reading.
    pub fn stands(&self, aligned: Option<&Aligned>) -> bool {
        !self.doubtful || aligned.is_some_and(|aligned| aligned.share >= LEAST_SHARE)
    }
}

/// Least share of the pixels that the print of a doubtful reading explains.
const LEAST_SHARE: f64 = 0.75;

/// Larger quads are not tried again a little grown or shrunk.
const MOST_SMALL_PX: f64 = 40.0;

/// Reads the quad as a marker of `family`, a family with codes.
pub fn decode(view: &View<'_>, quad: &Quad, family: Family, polarity: Polarity) -> Option<Decoded> {
    let plain = attempt(view, quad, family, polarity)?;
    if plain.is_some() {
        return plain;
    }
    // an outline half a pixel off loses the smallest markers' bits
    let side = super::quad::area(quad).max(0.0).sqrt();
    if side > MOST_SMALL_PX {
        return None;
    }
    for grow in [0.5, -0.5] {
        let scaled = resized(quad, 1.0 + 2.0 * grow / side);
        if let Some(Some(found)) = attempt(view, &scaled, family, polarity) {
            return Some(found);
        }
    }
    None
}

/// Reads the quad as one of the picture markers. The picture is the middle half of the quad.
pub fn decode_picture(view: &View<'_>, quad: &Quad, known: &Patterns, polarity: Polarity) -> Option<Decoded> {
    let map = Homography::from_square(*quad)?;
    let cells = code_cells(Family::Pattern);
    Glance::at(view, &map, cells, polarity)?;
    let ring = Ring::read(view, &map, cells, polarity)?;
    if ring.dark < 1.0 || ring.light < OFTEN.light {
        return None;
    }
    // as many samples as there are pixels, at most 4 x 4
    let side = super::quad::area(quad).max(0.0).sqrt();
    let taps = ((side / 32.0) as usize).clamp(1, 4);
    let step = 1.0 / 16.0;
    let mut patch: Patch = [0.0; 256];
    let mut spread = 0.0;
    for (i, value) in patch.iter_mut().enumerate() {
        for tap in 0..taps * taps {
            let at =
                |sample: usize, tap: usize| -0.5 + (sample as f64 + (tap as f64 + 0.5) / taps as f64) * step;
            let p = DVec2::new(at(i % 16, tap % taps), -at(i / 16, tap / taps));
            *value += ring.place(p, polarity.gray(view.gray(map.apply(p))));
        }
        *value = 0.5 + 0.5 * *value / (taps * taps) as f64;
        spread += (2.0 * *value - 1.0).abs().min(1.0) / 256.0;
    }
    let (reading, _) = known.recognize(&patch)?;
    Some(found(Family::Pattern, reading, quad, &ring, spread, polarity))
}

fn found(
    family: Family,
    reading: Reading,
    quad: &Quad,
    ring: &Ring,
    clarity: f64,
    polarity: Polarity,
) -> Decoded {
    let level = |level: Level| level.turned(reading.rotation).raw(polarity);
    Decoded {
        family,
        reading,
        margin: clarity * 0.5 * ring.contrast(),
        quad: [0, 1, 2, 3].map(|i| quad[(i + reading.rotation) % 4]),
        doubtful: false,
        black: level(ring.black),
        white: level(ring.white),
    }
}

/// The quad about its center, `factor` times as large.
fn resized(quad: &Quad, factor: f64) -> Quad {
    let center = (quad[0] + quad[1] + quad[2] + quad[3]) * 0.25;
    quad.map(|p| center + (p - center) * factor)
}

/// Cells of the code along the border's outer edge.
fn code_cells(family: Family) -> usize {
    family.inner() + (2.0 * family.border()) as usize
}

/// A point given in cells of the code from its top-left, in the marker square.
#[inline]
fn in_square(family: Family, column: f64, row: f64) -> DVec2 {
    let cell = 2.0 / code_cells(family) as f64;
    let border = family.border();
    DVec2::new(-1.0 + (column + border) * cell, 1.0 - (row + border) * cell)
}

/// One reading. Outer `None`: nothing like a marker of this family; inner `None`: a ring, but no code.
fn attempt(view: &View<'_>, quad: &Quad, family: Family, polarity: Polarity) -> Option<Option<Decoded>> {
    let map = Homography::from_square(*quad)?;
    let cells = code_cells(family);
    let glance = Glance::at(view, &map, cells, polarity)?;
    let centers = (0..family.inner() * family.inner()).map(|i| (i % family.inner(), i / family.inner()));
    let mut grays = centers.map(|(column, row)| {
        let p = in_square(family, column as f64 + 0.5, row as f64 + 0.5);
        polarity.gray(view.gray(map.apply(p)))
    });
    if !grays.any(|gray| glance.is_lit(gray)) {
        // most dark things are plain ones
        return None;
    }
    let ring = Ring::read(view, &map, cells, polarity)?;
    let cell_px = super::quad::area(quad).max(0.0).sqrt() / cells as f64;
    let least = Evidence::of(family, 0, None, cell_px);
    if !least.is_shown(&ring, f64::INFINITY, cell_px) {
        return None;
    }
    let code = Code { view, map: &map, family, ring: &ring, polarity, cell_px };
    let soft = code.soft();
    let mut before = None;
    for sharpen in [0.0, 0.25] {
        let (bits, clarity) = harden(&soft, family.inner(), sharpen);
        if clarity < least.clarity || before == Some(bits) {
            continue;
        }
        before = Some(bits);
        if bits == 0 || bits + 1 == 1 << (family.inner() * family.inner()) {
            // a plain square
            return None;
        }
        if let Some(reading) = family.read(bits) {
            let least = Evidence::of(family, reading.hamming, Some(bits), cell_px);
            let proven = |fit: Fit| fit.likeness >= least.likeness && fit.worst <= least.worst;
            if least.is_shown(&ring, clarity, cell_px) && (least.likeness == 0.0 || proven(code.fit(bits))) {
                return Some(Some(found(family, reading, quad, &ring, clarity, polarity)));
            }
        }
    }
    if cell_px > BLURRED_PX {
        return Some(None);
    }
    for share in SHARES {
        let bits = restored(&soft, family.inner(), share);
        if before.replace(bits) == Some(bits) {
            continue;
        }
        let reading = family.read(bits).filter(|reading| family.chance(reading.hamming) < SURE_CHANCE);
        if let Some(reading) = reading {
            let found = found(family, reading, quad, &ring, least.clarity, polarity);
            return Some(Some(Decoded { doubtful: true, ..found }));
        }
    }
    Some(None)
}

/// Below this chance, random bits are no code of a family.
const SURE_CHANCE: f64 = 1e-5;

/// In cells of less than this blur mixes neighbors, px.
const BLURRED_PX: f64 = 4.5;

/// Cells narrower than this are read at their centers alone.
const LEAST_CELL_PX: f64 = 3.0;

/// A quad whose rings are those of a marker, about to be read.
struct Code<'a> {
    view: &'a View<'a>,
    map: &'a Homography,
    family: Family,
    ring: &'a Ring,
    polarity: Polarity,
    cell_px: f64,
}

impl Code<'_> {
    /// Gray at a point given in cells of the code from its top-left: -1 = black, 1 = white.
    #[inline]
    fn at(&self, column: f64, row: f64) -> f64 {
        let p = in_square(self.family, column, row);
        self.ring.place(p, self.polarity.gray(self.view.gray(self.map.apply(p))))
    }

    /// The bits' gray values.
    fn soft(&self) -> Soft {
        let inner = self.family.inner();
        let mut soft = [[0.0; MOST_BITS]; MOST_BITS];
        // four taps about the center calm the noise of cells that have the pixels for it
        let four = [(0.33, 0.67), (0.67, 0.67), (0.33, 0.33), (0.67, 0.33)];
        let taps = if self.cell_px < LEAST_CELL_PX { &[(0.5, 0.5)][..] } else { &four };
        for (row, line) in soft[..inner].iter_mut().enumerate() {
            for (column, value) in line[..inner].iter_mut().enumerate() {
                *value = taps.iter().map(|&(x, y)| self.at(column as f64 + x, row as f64 + y)).sum::<f64>()
                    / taps.len() as f64;
            }
        }
        soft
    }

    /// How well the print of these bits explains the gray values all over the code (and the inner part of a
    /// wide border): blurred by a box of no, half or one cell's width, whichever fits best.
    fn fit(&self, bits: u64) -> Fit {
        // whole cells of the border between the code and the ring
        let margin = (self.family.border() - 0.5) as usize;
        let inner = self.family.inner();
        let side = (inner + 2 * margin) * TAPS;
        let count = (side * side) as f64;
        let mut taps = [[0.0; MOST_TAPS]; MOST_TAPS];
        let (mut seen, mut squares) = (0.0, 0.0);
        for (row, line) in taps[..side].iter_mut().enumerate() {
            for (column, gray) in line[..side].iter_mut().enumerate() {
                let at = |tap: usize| (tap as f64 + 0.5) / TAPS as f64 - margin as f64;
                *gray = self.at(at(column), at(row)).clamp(-1.5, 1.5);
                seen += *gray;
                squares += *gray * *gray;
            }
        }
        let spread = squares - seen * seen / count;
        let ink = |column: usize, row: usize| {
            // beyond the code there is border
            let (column, row) = (column.wrapping_sub(margin), row.wrapping_sub(margin));
            let inside = column < inner && row < inner;
            let bit = if inside { bits >> (inner * inner - 1 - (row * inner + column)) & 1 } else { 0 };
            2.0 * bit as f64 - 1.0
        };
        let mut best = Fit { likeness: 0.0, worst: f64::INFINITY };
        for width in [0.0, 0.5, 1.0] {
            // a cell and its neighbor on the tap's side, and the neighbor's share in the box
            let cover = |tap: usize| {
                let (cell, s) = (tap / TAPS, ((tap % TAPS) as f64 + 0.5) / TAPS as f64);
                let share = if width > 0.0 { ((0.5 * width - s.min(1.0 - s)) / width).max(0.0) } else { 0.0 };
                (cell, if s < 0.5 { cell.wrapping_sub(1) } else { cell + 1 }, share)
            };
            let print = |column: usize, row: usize| {
                let ((i, k, a), (j, l, b)) = (cover(column), cover(row));
                (1.0 - b) * ((1.0 - a) * ink(i, j) + a * ink(k, j))
                    + b * ((1.0 - a) * ink(i, l) + a * ink(k, l))
            };
            let (mut sum, mut square, mut product) = (0.0, 0.0, 0.0);
            for (row, line) in taps[..side].iter().enumerate() {
                for (column, gray) in line[..side].iter().enumerate() {
                    let print = print(column, row);
                    sum += print;
                    square += print * print;
                    product += print * gray;
                }
            }
            let (power, common) = (square - sum * sum / count, product - sum * seen / count);
            if !(power > 0.0 && spread > 0.0) || common / (power * spread).sqrt() <= best.likeness {
                continue;
            }
            best = Fit { likeness: common / (power * spread).sqrt(), worst: 0.0 };
            let gain = common / power;
            for cell in 0..(side / TAPS) * (side / TAPS) {
                let (i, j) = (cell % (side / TAPS) * TAPS, cell / (side / TAPS) * TAPS);
                let mut miss = 0.0;
                for tap in 0..TAPS * TAPS {
                    let (column, row) = (i + tap % TAPS, j + tap / TAPS);
                    let off = taps[row][column] - (seen + gain * (count * print(column, row) - sum)) / count;
                    miss += off * off;
                }
                best.worst = best.worst.max(miss / (TAPS * TAPS) as f64 * count / spread);
            }
        }
        best
    }
}

/// Samples along a cell for the fit.
const TAPS: usize = 4;
const MOST_TAPS: usize = MOST_BITS * TAPS;

/// How well a print explains what is seen.
#[derive(Clone, Copy, Debug)]
struct Fit {
    /// Correlation of the gray values with the print.
    likeness: f64,
    /// Mean squared miss in the cell that fits worst, of the variance of all gray values.
    worst: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pixels::{Plane, Size, SplitMix64};

    /// Whatever the four corners: no panic, and what is read in random gray is next to nothing.
    #[test]
    fn random_quads_are_survived() {
        let mut rng = SplitMix64::new(8);
        let noise = Plane::from_fn(Size::new(160, 120), |_, _| rng.next_u64() as u8);
        let lens = Lens::guess(noise.size());
        let view = View::new(noise.view(), &lens);
        let mut read = 0;
        for case in 0..100_000usize {
            let spread = [3.0, 40.0, 200.0, 1e7][case % 4];
            let mut quad = [DVec2::ZERO; 4]
                .map(|_| DVec2::new(80.0, 60.0) + DVec2::new(rng.f64() - 0.5, rng.f64() - 0.5) * spread);
            match case % 89 {
                0 => quad[2] = quad[0],
                1 => quad[1].y = f64::NAN,
                2 => quad[3].x = f64::NEG_INFINITY,
                _ => {}
            }
            read += usize::from(
                decode(&view, &quad, Family::ALL[case % Family::ALL.len()], Polarity::BlackOnWhite).is_some(),
            );
        }
        assert!(read < 10, "{read} ghosts in 100000");
    }

    /// The upright print is read upright, a turned one turned, at every number of pixels a cell.
    #[test]
    fn prints_read_as_themselves() {
        for (family, zoom) in [(Family::Tag36h11, 3), (Family::Aruco4x4_50, 5), (Family::Aruco6x6_250, 8)] {
            let picture = family.picture(17).expect("id");
            let side = picture.size().width * zoom;
            let plane = Plane::from_fn(Size::new(side, side), |x, y| 40 + picture.at(x / zoom, y / zoom) / 2);
            let (low, high) = (zoom as f64 - 0.5, (side - zoom) as f64 - 0.5);
            let quad = [(low, low), (high, low), (high, high), (low, high)].map(|(x, y)| DVec2::new(x, y));
            let lens = Lens::guess(plane.size());
            for turn in 0..4 {
                let turned = [0, 1, 2, 3].map(|i| quad[(i + turn) % 4]);
                let found = decode(&View::new(plane.view(), &lens), &turned, family, Polarity::BlackOnWhite)
                    .expect("read");
                assert_eq!((found.reading.id, found.reading.hamming), (17, 0));
                assert_eq!(found.quad, quad);
                assert!((found.black.mean - 40.0).abs() < 1.0 && (found.white.mean - 167.0).abs() < 1.0);
            }
        }
    }

    /// White-on-black prints read with their polarity and not with the other.
    #[test]
    fn inverted_prints_are_read_inverted() {
        for family in Family::ALL {
            let id = family.codes().len() as u32 / 2;
            let picture = family.inverted_picture(id).expect("id");
            let (zoom, side) = (4, picture.size().width * 4);
            let plane = Plane::from_fn(Size::new(side, side), |x, y| 30 + picture.at(x / zoom, y / zoom) / 2);
            let (low, high) = (zoom as f64 - 0.5, (side - zoom) as f64 - 0.5);
            let quad = [(low, low), (high, low), (high, high), (low, high)].map(|(x, y)| DVec2::new(x, y));
            let lens = Lens::guess(plane.size());
            let view = View::new(plane.view(), &lens);
            let found = decode(&view, &quad, family, Polarity::WhiteOnBlack).expect("read");
            assert_eq!((found.reading.id, found.quad), (id, quad));
            assert!((found.black.mean - 157.0).abs() < 1.0 && (found.white.mean - 30.0).abs() < 1.0);
            assert!(decode(&view, &quad, family, Polarity::BlackOnWhite).is_none());
        }
    }
}
