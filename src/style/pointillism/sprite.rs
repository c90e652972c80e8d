//! The brush at the sizes of strokes, and the built-in one.

use super::grid::MAX_RADIUS;
use crate::pixels::{Plane, Size, SplitMix64};
use std::sync::LazyLock;

/// Side of the built-in brush, px.
const SIDE: usize = 64;

/// The built-in brush.
pub(super) static BUILT_IN: LazyLock<Plane<u8>> = LazyLock::new(built_in);

/// A round touch of paint, thinner towards its rim and streaked by bristles along x.
fn built_in() -> Plane<u8> {
    const REACH: usize = 6;
    let mut rng = SplitMix64::new(64);
    let noise = Plane::from_fn(Size::new(SIDE, SIDE), |_, _| rng.f64());
    Plane::from_fn(Size::new(SIDE, SIDE), |x, y| {
        let from_middle = |i: usize| (i as f64 + 0.5) / (SIDE as f64 / 2.0) - 1.0;
        let (u, v) = (from_middle(x), from_middle(y));
        let near = (x.saturating_sub(REACH)..=(x + REACH).min(SIDE - 1)).map(|x| noise.at(x, y));
        // the mean of 13 numbers lies within about .3 of .5
        let streak = near.sum::<f64>() / (2 * REACH + 1) as f64;
        let paint = 0.88 + 0.6 * (streak - 0.5);
        let t = (((u * u + v * v).sqrt() - 0.55) / 0.4).clamp(0.0, 1.0);
        let rim = 1.0 - t * t * (3.0 - 2.0 * t);
        ((paint * rim).clamp(0.0, 1.0) * 255.0 + 0.5).floor() as u8
    })
}

/// The mask at `2·radius + 1` pixels, 0..1: bilinear between the four nearest samples, also when that skips some.
pub(super) fn scaled(mask: &Plane<u8>, radius: u32) -> Plane<f64> {
    let across = 2 * radius as usize + 1;
    let taps = |o: usize, count: usize| {
        let at = (o as f64 + 0.5) * count as f64 / across as f64 - 0.5;
        let (first, last) = (at.floor(), count as f64 - 1.0);
        (first.clamp(0.0, last) as usize, (first + 1.0).clamp(0.0, last) as usize, at - first)
    };
    let value = |x: usize, y: usize| f64::from(mask.at(x, y)) / 255.0;
    Plane::from_fn(Size::new(across, across), |x, y| {
        let (x0, x1, right) = taps(x, mask.size().width);
        let (y0, y1, down) = taps(y, mask.size().height);
        let above = value(x0, y0) * (1.0 - right) + value(x1, y0) * right;
        let below = value(x0, y1) * (1.0 - right) + value(x1, y1) * right;
        above * (1.0 - down) + below * down
    })
}

/// Pixels that are blended at once.
pub(super) const LANES: usize = 16;

/// The opacities of strokes of every radius in use, in 1/32768, rows padded with 0 to whole [`LANES`].
#[derive(Debug, Default)]
pub(super) struct Stamps {
    stamps: Vec<Stamp>,
    rows: Vec<[i16; LANES]>,
    widest: usize,
}

/// Where one radius' opacities are.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Stamp {
    first: usize,
    /// Vectors in a row.
    pub vectors: usize,
    /// Rows above the first that paints anything.
    pub skipped: usize,
    /// Rows from there to the last that paints anything.
    pub height: usize,
}

impl Stamps {
    /// The stamps of all radii up to the largest among `radii`.
    pub fn new(mask: &Plane<u8>, opacity: f64, radii: impl Iterator<Item = u32>) -> Self {
        let largest = radii.max().unwrap_or(0).min(MAX_RADIUS);
        let mut all = Self::default();
        for radius in 0..=largest {
            let scaled = scaled(mask, radius);
            let vectors = scaled.size().width.div_ceil(LANES);
            let covers = |row: &&[f64]| row.iter().any(|&v| fixed(v * opacity) > 0);
            let first = scaled.rows().take_while(|row| !covers(row)).count();
            let end =
                scaled.rows().enumerate().filter(|(_, row)| covers(row)).last().map_or(first, |(y, _)| y + 1);
            let stamp = Stamp { first: all.rows.len(), vectors, skipped: first, height: end - first };
            for row in scaled.rows().take(end).skip(first) {
                for part in row.chunks(LANES) {
                    let mut lanes = [0; LANES];
                    for (lane, &v) in lanes.iter_mut().zip(part) {
                        *lane = fixed(v * opacity);
                    }
                    all.rows.push(lanes);
                }
            }
            all.widest = all.widest.max(vectors * LANES);
            all.stamps.push(stamp);
        }
        all
    }

    /// The stamp of `radius`, one that there is.
    #[inline(always)]
    pub fn of(&self, radius: u16) -> Stamp {
        self.stamps[usize::from(radius)]
    }

    /// The vectors of a stamp's rows `from..to`.
    #[inline(always)]
    pub fn rows(&self, stamp: Stamp, from: usize, to: usize) -> &[[i16; LANES]] {
        &self.rows[stamp.first + from * stamp.vectors..stamp.first + to * stamp.vectors]
    }

    /// Pixels across the widest row, padding included.
    pub fn widest(&self) -> usize {
        self.widest
    }
}

/// An opacity in 1/32768; the largest is 32767.
fn fixed(opacity: f64) -> i16 {
    (opacity * 32768.0 + 0.5).floor().clamp(0.0, 32767.0) as i16
}
