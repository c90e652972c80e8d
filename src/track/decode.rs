//! Quadrilateral → code, read from gray through the homography.
//!
//! Black and white are planes over the marker, fitted to the border's ring and to the quiet zone's, so that a
//! lighting ramp moves the threshold along (AprilTag, Wang & Olson 2016). A quad without a dark ring in a
//! lighter one is dropped before a bit is read. If the plain reading matches no code, the bits are read
//! again sharpened against their neighbors (small, blurred markers), then with the quad shifted a little.

use super::quad::Quad;
use super::rectify;
use crate::geometry::{Homography, Lens};
use crate::marker::{Family, Reading};
use crate::pixels::PlaneRef;
use glam::{DMat3, DVec2};

/// A picture seen through its lens.
#[derive(Clone, Copy)]
pub struct View<'a> {
    /// The gray picture; not empty.
    pub luma: PlaneRef<'a, u8>,
    /// Its lens.
    pub lens: &'a Lens,
}

impl View<'_> {
    /// Bilinear gray value at an ideal point, 0..255, clamped to the picture's border.
    #[inline]
    pub fn gray(&self, ideal: DVec2) -> f64 {
        let size = self.luma.size();
        let p = rectify::seen(self.lens, ideal);
        // `max` also turns NaN into 0
        let x = p.x.max(0.0).min((size.width - 1) as f64);
        let y = p.y.max(0.0).min((size.height - 1) as f64);
        let (column, row) = (x as usize, y as usize);
        let (s, t) = (x - column as f64, y - row as f64);
        let right = (column + 1).min(size.width - 1);
        let (top, bottom) = (self.luma.row(row), self.luma.row((row + 1).min(size.height - 1)));
        let mix = |line: &[u8]| f64::from(line[column]) * (1.0 - s) + f64::from(line[right]) * s;
        mix(top) * (1.0 - t) + mix(bottom) * t
    }
}

/// A gray level that varies linearly over the marker: `mean + slope · p`, p in ±1.
#[derive(Clone, Copy, Debug, Default)]
pub struct Level {
    /// At the center.
    pub mean: f64,
    /// Per half side to the right and up.
    pub slope: DVec2,
}

impl Level {
    /// The level at a point of the marker square.
    #[inline]
    pub fn at(&self, p: DVec2) -> f64 {
        self.mean + self.slope.dot(p)
    }
}

/// A quad read as a marker.
#[derive(Clone, Copy, Debug)]
pub struct Decoded {
    /// The family that was tried.
    pub family: Family,
    /// What its codes say.
    pub reading: Reading,
    /// Mean distance of the bits from their threshold, gray levels.
    pub margin: f64,
    /// The quad in the family's order, TL TR BR BL.
    pub quad: Quad,
    /// Gray of the black ink.
    pub black: Level,
    /// Gray of the paper.
    pub white: Level,
}

/// Least gray step from black to white.
const LEAST_CONTRAST: f64 = 8.0;
/// Least mean distance of a bit from its threshold, of half the contrast: true bits lie near 1, the bits of a
/// texture anywhere.
const LEAST_CLARITY: f64 = 0.35;

/// Reads the quad as a marker of `family`.
pub fn decode(view: &View<'_>, quad: &Quad, family: Family) -> Option<Decoded> {
    let plain = attempt(view, quad, family)?;
    if plain.is_some() {
        return plain;
    }
    // an outline half a pixel off loses the smallest markers' bits
    let center = (quad[0] + quad[1] + quad[2] + quad[3]) * 0.25;
    let side = (super::quad::area(quad)).max(0.0).sqrt();
    for grow in [0.5, -0.5] {
        let scaled = quad.map(|p| center + (p - center) * (1.0 + 2.0 * grow / side));
        if let Some(Some(found)) = attempt(view, &scaled, family) {
            return Some(found);
        }
    }
    None
}

/// One reading. Outer `None`: nothing like a marker of this family; inner `None`: a ring, but no code.
fn attempt(view: &View<'_>, quad: &Quad, family: Family) -> Option<Option<Decoded>> {
    let map = Homography::from_square(*quad)?;
    let cells = family.cells();
    let (black, dark) = ring(view, &map, cells, 1.0 - 1.0 / cells as f64);
    let (white, light) = ring(view, &map, cells, 1.0 + 1.0 / cells as f64);
    let contrast = white.mean - black.mean;
    if contrast < LEAST_CONTRAST {
        return None;
    }
    let count = 4 * cells;
    let middle = |p: DVec2| 0.5 * (black.at(p) + white.at(p));
    let below = dark[..count].iter().filter(|(p, gray)| *gray < middle(*p)).count();
    let above = light[..count].iter().filter(|(p, gray)| *gray > middle(*p)).count();
    if below * 8 < count * 7 || above * 4 < count * 3 {
        return None;
    }

    let inner = family.inner();
    let mut soft = [[0.0; MOST_BITS]; MOST_BITS];
    let cell = 2.0 / cells as f64;
    // four taps about the center calm the noise of cells that have the pixels for it
    let taps = [(-0.17, -0.17), (0.17, -0.17), (-0.17, 0.17), (0.17, 0.17)];
    for (row, line) in soft[..inner].iter_mut().enumerate() {
        for (column, value) in line[..inner].iter_mut().enumerate() {
            let at = |i: usize| -1.0 + (i + family.border()) as f64 * cell + 0.5 * cell;
            let p = DVec2::new(at(column), -at(row));
            let gray: f64 =
                taps.iter().map(|&(x, y)| view.gray(map.apply(p + DVec2::new(x, y) * cell))).sum();
            *value = (gray * 0.25 - middle(p)) / (0.5 * (white.at(p) - black.at(p))).max(1.0);
        }
    }
    for sharpen in [0.0, 0.25] {
        let (bits, clarity) = harden(&soft, inner, sharpen);
        if clarity < LEAST_CLARITY {
            continue;
        }
        if let Some(reading) = family.read(bits) {
            let quad = [0, 1, 2, 3].map(|i| quad[(i + reading.rotation) % 4]);
            let turn =
                |level: Level| Level { mean: level.mean, slope: turned(level.slope, reading.rotation) };
            let (black, white) = (turn(black), turn(white));
            let margin = clarity * 0.5 * contrast;
            return Some(Some(Decoded { family, reading, margin, quad, black, white }));
        }
    }
    Some(None)
}

/// A slope in the frame whose top-left corner is `turns` corners further clockwise.
fn turned(slope: DVec2, turns: usize) -> DVec2 {
    match turns {
        0 => slope,
        // the new x axis runs down the old right side, the new y axis to the old right
        1 => DVec2::new(-slope.y, slope.x),
        2 => -slope,
        _ => DVec2::new(slope.y, -slope.x),
    }
}

const MOST_BITS: usize = 6;
const MOST_RING: usize = 4 * (MOST_BITS + 2);

type Ring = [(DVec2, f64); MOST_RING];

/// Gray at the middles of the cells along the four sides of the square ±radius, and the plane through them.
fn ring(view: &View<'_>, map: &Homography, cells: usize, radius: f64) -> (Level, Ring) {
    let mut samples = [(DVec2::ZERO, 0.0); MOST_RING];
    let mut level = Level::default();
    let mut squares = 0.0;
    for (i, sample) in samples[..4 * cells].iter_mut().enumerate() {
        let along = (-1.0 + (2 * (i / 4) + 1) as f64 / cells as f64).clamp(-radius, radius);
        let p = match i % 4 {
            0 => DVec2::new(along, radius),
            1 => DVec2::new(radius, along),
            2 => DVec2::new(along, -radius),
            _ => DVec2::new(-radius, along),
        };
        *sample = (p, view.gray(map.apply(p)));
        level.mean += sample.1;
        level.slope += p * sample.1;
        squares += p.x * p.x;
    }
    // the ring is symmetric: the normal equations are diagonal
    level.mean /= (4 * cells) as f64;
    level.slope /= squares;
    (level, samples)
}

/// Bits row by row, and the mean distance of the values from their threshold (each at most 1).
fn harden(soft: &[[f64; MOST_BITS]; MOST_BITS], inner: usize, sharpen: f64) -> (u64, f64) {
    let (mut bits, mut clarity) = (0u64, 0.0);
    let value = |row: usize, column: usize| soft[row][column];
    for row in 0..inner {
        for column in 0..inner {
            // outside the bits lies the black border
            let mut beside = 0.0;
            beside += if row > 0 { value(row - 1, column) } else { -1.0 };
            beside += if column > 0 { value(row, column - 1) } else { -1.0 };
            beside += if row + 1 < inner { value(row + 1, column) } else { -1.0 };
            beside += if column + 1 < inner { value(row, column + 1) } else { -1.0 };
            let v = value(row, column) + sharpen * (4.0 * value(row, column) - beside);
            bits = (bits << 1) | u64::from(v > 0.0);
            clarity += v.abs().min(1.0);
        }
    }
    (bits, clarity / (inner * inner) as f64)
}

/// The matrix of a homography and of its inverse, for those who need both ways.
pub fn both_ways(quad: &Quad) -> Option<(Homography, DMat3)> {
    let map = Homography::from_square(*quad)?;
    let inverse = map.0.inverse();
    inverse.is_finite().then_some((map, inverse))
}
