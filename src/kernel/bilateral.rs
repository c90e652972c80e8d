//! The bilateral filter on colors (Tomasi & Manduchi; 003 eq. 3.1 to 3.4), 9x9 with the center, borders clamped.
//!
//! h(x) = Σ f(ξ)·c·s / Σ c·s, c = exp(-|ξ-x|² / 2σ_d²), s = exp(-|f(ξ)-f(x)|² / 2σ_r²), distance of colors Euclidean
//! over R, G, B.
//!
//! 1. Colors are scaled as chroma is for the photometric filter, so that c·s is one `fall` of |Δf|² plus a number
//!    that depends on |Δx| alone.
//! 2. c·s is symmetric: 40 weights a pixel (four in its row, nine in each of the next four) serve all 80 neighbors.
//!    Weight rows live in a ring of five rows; a band recomputes part of the four rows above it.
//! 3. Work goes in strips of columns on copied rows of constant length, so that all offsets are known to the
//!    compiler.
//!
//! Every pixel sums its taps in one fixed order; neither bands nor strips nor the SIMD level touch it.
#![allow(clippy::needless_range_loop)] // channels index several arrays in step

use super::photometric::{SCALE, chroma_gain, fall};
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, Size};
use fearless_simd::{Simd, SimdBase, SimdFloat, f32x4, f32x8};
use rayon::prelude::*;
use std::hint::black_box;

/// Pixels the window reaches from its center.
pub const REACH: usize = 4;
/// Side of the window.
const SIDE: usize = 2 * REACH + 1;
/// Columns at once: two vectors of four or one of eight.
const LANES: usize = 8;
/// Columns a strip, a multiple of [`LANES`].
const STRIP: usize = 160;
/// First column of a strip within its rows: its neighbors come before it, and theirs, which hold anything.
const START: usize = 2 * REACH;
/// Length of a strip's rows.
const LENGTH: usize = START + STRIP + 2 * REACH;
/// Weight rows of one picture row: towards columns 1 to 4 of the same row, then columns -4 to 4 of each of the next
/// four rows.
const WEIGHTS: usize = REACH + REACH * SIDE;

/// R, G, B of one picture row.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct Colors([f32; 3 * LENGTH]);
/// Weights from one picture row to those below.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct Weights([f32; WEIGHTS * LENGTH]);
/// Rows from four columns before a block of [`LANES`] columns to four behind it.
type ColorBlock = [f32; 2 * LENGTH + WINDOW];
type WeightBlock = [f32; (WEIGHTS - 1) * LENGTH + WINDOW];
const WINDOW: usize = LANES + 2 * REACH;
/// First column of the last block within the rows.
const LAST: usize = LENGTH - WINDOW;

impl Colors {
    /// The block whose own columns begin four behind `x` of the rows.
    #[inline(always)]
    fn block(&self, x: usize) -> &ColorBlock {
        &self.0[x..][..2 * LENGTH + WINDOW].as_chunks().0[0]
    }
}

impl Weights {
    #[inline(always)]
    fn block(&self, x: usize) -> &WeightBlock {
        &self.0[x..][..(WEIGHTS - 1) * LENGTH + WINDOW].as_chunks().0[0]
    }

    #[inline(always)]
    fn block_mut(&mut self, x: usize) -> &mut WeightBlock {
        &mut self.0[x..][..(WEIGHTS - 1) * LENGTH + WINDOW].as_chunks_mut().0[0]
    }
}

/// The filter with its copy of the picture; keep it from frame to frame.
#[derive(Clone, Debug, Default)]
pub struct Bilateral {
    copy: [Plane<f32>; 3],
}

impl Bilateral {
    /// One step, in place, on planes R, G, B in 0..1 of one size; both deviations are above 0. Allocates only when
    /// the size grows.
    pub fn step(&mut self, level: Level, sigma_d: f32, sigma_r: f32, planes: &mut [Plane<f32>; 3]) {
        let size = planes[0].size();
        if size.area() == 0 {
            return;
        }
        std::mem::swap(&mut self.copy, planes);
        planes.iter_mut().for_each(|plane| plane.resize(size, 0.0));
        let (input, gain, space) = (&self.copy, chroma_gain(sigma_r), distances(sigma_d));
        let band = super::band_rows(size.height, 24);
        let [r, g, b] = planes;
        let bands = r.view_mut().par_bands(band).zip(g.view_mut().par_bands(band));
        bands.zip(b.view_mut().par_bands(band)).for_each(|(((first, mut r), (_, mut g)), (_, mut b))| {
            let strips = size.width.div_ceil(STRIP);
            let wide = size.width.div_ceil(strips).next_multiple_of(LANES);
            let colors = [Colors([0.0; 3 * LENGTH]); SIDE];
            let weights = [Weights([0.0; WEIGHTS * LENGTH]); REACH + 1];
            let mut strip = Strip { input, gain, space: &space, from: 0, columns: 0, colors, weights };
            for from in (0..size.width).step_by(wide) {
                (strip.from, strip.columns) = (from, wide.min(size.width - from));
                strip.open(level, first as isize);
                for row in 0..r.size().height {
                    let y = (first + row) as isize;
                    strip.take(y + REACH as isize);
                    let out = [&mut r, &mut g, &mut b]
                        .map(|plane| &mut plane.row_mut(row)[from..][..strip.columns]);
                    dispatch!(level, simd => strip.sum(simd, y, out));
                }
            }
        });
    }
}

/// The exponent's spatial part by distance from the center, rows 0 to 4 below it, columns -4 to 4.
type Space = [[f32; SIDE]; REACH + 1];

fn distances(sigma_d: f32) -> Space {
    let unit = SCALE / (2.0 * f64::from(sigma_d) * f64::from(sigma_d));
    std::array::from_fn(|y| {
        std::array::from_fn(|x| {
            let dx = x.abs_diff(REACH);
            ((dx * dx + y * y) as f64 * unit) as f32
        })
    })
}

/// One strip of columns on its way down the picture.
struct Strip<'a> {
    input: &'a [Plane<f32>; 3],
    gain: f32,
    space: &'a Space,
    from: usize,
    columns: usize,
    /// Rows y-4 ..= y+4 of the picture; row k sits at k mod 9.
    colors: [Colors; SIDE],
    /// Rows y-4 ..= y; row k sits at k mod 5.
    weights: [Weights; REACH + 1],
}

impl Strip<'_> {
    /// Makes everything ready to go on to row `first`.
    fn open(&mut self, level: Level, first: isize) {
        let reach = REACH as isize;
        for y in first - reach..first + reach {
            self.take(y);
        }
        for above in 1..=REACH {
            let y = first - above as isize;
            dispatch!(level, simd => self.weigh(simd, y, above));
        }
    }

    /// Copies and scales input row `y` (clamped) with its clamped neighbors.
    fn take(&mut self, y: isize) {
        let size = self.input[0].size();
        let from_row = y.clamp(0, size.height as isize - 1) as usize;
        let (columns, from, gain) = (self.columns, self.from, self.gain);
        let slot = &mut self.colors[ring::<SIDE>(y)];
        for (row, plane) in slot.0.chunks_exact_mut(LENGTH).zip(self.input) {
            let line = plane.row(from_row);
            for (to, &value) in row[START..][..columns].iter_mut().zip(&line[from..][..columns]) {
                *to = value * gain;
            }
            for d in 1..=REACH {
                row[START - d] = line[from.saturating_sub(d)] * gain;
                row[START + columns - 1 + d] = line[(from + columns - 1 + d).min(size.width - 1)] * gain;
            }
        }
    }

    /// Weights from row `y` to the rows from `nearest` rows below on, without summing.
    #[inline(always)]
    fn weigh<S: Simd>(&mut self, simd: S, y: isize, nearest: usize) {
        let colors = &self.colors;
        let here = &colors[ring::<SIDE>(y)];
        let weights = &mut self.weights[ring::<{ REACH + 1 }>(y)];
        for dy in nearest..=REACH {
            let below = &colors[ring::<SIDE>(y + dy as isize)];
            for x in (REACH..REACH + self.columns).step_by(LANES).take_while(|&x| x <= LAST) {
                let (of, block, to) =
                    (taps(simd, here.block(x), REACH), below.block(x), weights.block_mut(x));
                for d in 0..SIDE {
                    let weight = weight(simd, of, taps(simd, block, d), self.space[dy][d]);
                    weight.store_slice(&mut to[row_of(dy, d) * LENGTH + REACH..][..LANES]);
                }
            }
            weigh_sides(simd, here, below, dy, &self.space[dy], self.columns, weights);
        }
    }

    /// Sums row `y`, and computes the weights from it to the rows below on the way: colors are loaded once for both.
    #[inline(always)]
    fn sum<S: Simd>(&mut self, simd: S, y: isize, out: [&mut [f32]; 3]) {
        let (columns, space) = (self.columns, self.space);
        let row = |dy: isize| ring::<SIDE>(y + dy);
        let colors = &self.colors;
        let (above, here, below) = (
            [&colors[row(-1)], &colors[row(-2)], &colors[row(-3)], &colors[row(-4)]],
            &colors[row(0)],
            [&colors[row(1)], &colors[row(2)], &colors[row(3)], &colors[row(4)]],
        );
        let rows = [0, -1, -2, -3, -4].map(|dy| ring::<{ REACH + 1 }>(y + dy));
        let Ok([weights, old @ ..]) = self.weights.get_disjoint_mut(rows) else { return };
        // a loop over a window's columns that stays a loop: unrolled, its values are too many for any register file
        let side = black_box(SIDE).min(SIDE);
        weigh_same(simd, here, &space[0], columns, weights);
        let [out_r, out_g, out_b] = out;
        let (out_r, out_g, out_b) = (&mut out_r[..columns], &mut out_g[..columns], &mut out_b[..columns]);
        let ungain = 1.0 / self.gain;
        // the second bound is one check here instead of one an access
        for x in (REACH..REACH + columns).step_by(LANES).take_while(|&x| x <= LAST) {
            let (block, weights) = (here.block(x), weights.block_mut(x));
            let of = taps(simd, block, REACH);
            let mut sum = Sums { k: f32x8::splat(simd, 1.0), of };
            // a weight towards column d on the right is, read from there, the weight towards column -d on the left
            for d in 1..=REACH {
                sum.add(load(simd, weights, (d - 1) * LENGTH + REACH), taps(simd, block, REACH + d));
                sum.add(load(simd, weights, (d - 1) * LENGTH + REACH - d), taps(simd, block, REACH - d));
            }
            // the same goes for rows below, whose weights are new here, and rows above
            for dy in 1..=REACH {
                let (above, below) = (above[dy - 1].block(x), below[dy - 1].block(x));
                let old = old[dy - 1].block(x);
                for d in 0..side {
                    let at = taps(simd, below, d);
                    let weight = weight(simd, of, at, space[dy][d]);
                    weight.store_slice(&mut weights[row_of(dy, d) * LENGTH + REACH..][..LANES]);
                    sum.add(weight, at);
                    sum.add(load(simd, old, row_of(dy, SIDE - 1 - d) * LENGTH + d), taps(simd, above, d));
                }
            }
            let scale = f32x8::splat(simd, ungain) / sum.k;
            let mean = [sum.of[0] * scale, sum.of[1] * scale, sum.of[2] * scale];
            let x = x - REACH;
            if x + LANES <= columns {
                mean[0].store_slice(&mut out_r[x..x + LANES]);
                mean[1].store_slice(&mut out_g[x..x + LANES]);
                mean[2].store_slice(&mut out_b[x..x + LANES]);
            } else {
                for (mean, out) in mean.into_iter().zip([&mut *out_r, &mut *out_g, &mut *out_b]) {
                    let mut last = [0.0; LANES];
                    mean.store_slice(&mut last);
                    out[x..].copy_from_slice(&last[..columns - x]);
                }
            }
        }
        for dy in 1..=REACH {
            weigh_sides(simd, here, below[dy - 1], dy, &space[dy], columns, weights);
        }
    }
}

/// Weights within a row, from the four columns before the strip on.
#[inline(always)]
fn weigh_same<S: Simd>(simd: S, here: &Colors, space: &[f32; SIDE], columns: usize, weights: &mut Weights) {
    for x in (0..columns + REACH).step_by(LANES).map(|x| x.min(LAST)) {
        let (block, to) = (here.block(x), weights.block_mut(x));
        let of = taps(simd, block, REACH);
        for d in 1..=REACH {
            let weight = weight(simd, of, taps(simd, block, REACH + d), space[REACH + d]);
            weight.store_slice(&mut to[(d - 1) * LENGTH + REACH..][..LANES]);
        }
    }
}

/// Weights of the four columns on either side of a strip towards its own columns in the row `dy` below.
#[inline(always)]
fn weigh_sides<S: Simd>(
    simd: S,
    here: &Colors,
    below: &Colors,
    dy: usize,
    space: &[f32; SIDE],
    columns: usize,
    weights: &mut Weights,
) {
    let (left, right) = (START - REACH, START + columns.min(STRIP));
    let four = |slot: &Colors, x: usize| {
        let row = |c: usize| f32x4::from_slice(simd, &slot.0[c * LENGTH + x..][..REACH]);
        [row(0), row(1), row(2)]
    };
    let centers = [four(here, left), four(here, right)];
    for d in 1..=REACH {
        for (x, to, column, center) in
            [(left, left + d, REACH + d, centers[0]), (right, right - d, REACH - d, centers[1])]
        {
            weight(simd, center, four(below, to), space[column])
                .store_slice(&mut weights.0[row_of(dy, column) * LENGTH + x..][..REACH]);
        }
    }
}

/// Where the weights towards column `d` - 4 of the row `dy` below are.
#[inline(always)]
const fn row_of(dy: usize, d: usize) -> usize {
    REACH + (dy - 1) * SIDE + d
}

/// Eight values of a block from `at` on.
#[inline(always)]
fn load<S: Simd>(simd: S, block: &[f32], at: usize) -> f32x8<S> {
    f32x8::from_slice(simd, &block[at..][..LANES])
}

/// R, G, B from the block's column `d` on.
#[inline(always)]
fn taps<S: Simd>(simd: S, block: &ColorBlock, d: usize) -> [f32x8<S>; 3] {
    [load(simd, block, d), load(simd, block, LENGTH + d), load(simd, block, 2 * LENGTH + d)]
}

/// Eight pixels' sums.
struct Sums<S: Simd> {
    k: f32x8<S>,
    of: [f32x8<S>; 3],
}

impl<S: Simd> Sums<S> {
    #[inline(always)]
    fn add(&mut self, weight: f32x8<S>, taps: [f32x8<S>; 3]) {
        self.k += weight;
        for c in 0..3 {
            self.of[c] += taps[c] * weight;
        }
    }
}

/// c·s between two places' colors, `space` being the exponent's spatial part.
#[inline(always)]
fn weight<S: Simd, F: SimdFloat<S, Element = f32>>(simd: S, center: [F; 3], at: [F; 3], space: f32) -> F {
    let (r, g, b) = (at[0] - center[0], at[1] - center[1], at[2] - center[2]);
    fall(simd, (r * r + g * g) + (b * b + space))
}

fn ring<const N: usize>(y: isize) -> usize {
    (y + 4 * N as isize).unsigned_abs() % N
}

/// One pixel of one step in f64, straight from eq. 3.1 to 3.4; `at` takes coordinates inside the picture.
pub fn reference(
    size: Size,
    sigma_d: f64,
    sigma_r: f64,
    x: usize,
    y: usize,
    at: impl Fn(usize, usize) -> [f64; 3],
) -> [f64; 3] {
    let center = at(x, y);
    let (mut k, mut sum) = (0.0, [0.0; 3]);
    let reach = REACH as isize;
    for (dx, dy) in (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy))) {
        let sx = x.saturating_add_signed(dx).min(size.width - 1);
        let sy = y.saturating_add_signed(dy).min(size.height - 1);
        let f = at(sx, sy);
        let apart: f64 = (0..3).map(|c| (f[c] - center[c]) * (f[c] - center[c])).sum();
        let far = (dx * dx + dy * dy) as f64;
        let weight = libm::exp(-0.5 * (far / (sigma_d * sigma_d) + apart / (sigma_r * sigma_r)));
        k += weight;
        (0..3).for_each(|c| sum[c] += weight * f[c]);
    }
    sum.map(|sum| sum / k)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::sweep;

    /// The weights' 2.5e-6 and f32 roundings, far below a level (4e-3).
    const BOUND: f64 = 2e-5;

    #[test]
    fn every_picture_matches_the_reference() {
        for case in sweep::cases().iter().filter(|case| case.plane.size().area() < 500_000) {
            let size = case.plane.size();
            let (w, h) = (size.width, size.height);
            let unit = |v: u8| f32::from(v) / 255.0;
            let planes = [
                Plane::from_fn(size, |x, y| unit(case.plane.at(x, y))),
                Plane::from_fn(size, |x, y| unit(case.plane.at(w - 1 - x, y)) * 0.3),
                Plane::from_fn(size, |x, y| unit(case.plane.at(x, h - 1 - y)) * 0.5 + 0.2),
            ];
            for (sigma_d, sigma_r) in [(2.0, 0.1), (0.5, 1.0)] {
                let found = sweep::everywhere(&case.label, |level| {
                    let mut planes = planes.clone();
                    Bilateral::default().step(level, sigma_d, sigma_r, &mut planes);
                    planes
                });
                for i in (0..size.area()).step_by((size.area() / 1000).max(1)) {
                    let (x, y) = (i % w, i / w);
                    let at = |x, y| planes.each_ref().map(|plane| f64::from(plane.at(x, y)));
                    let truth = reference(size, sigma_d.into(), sigma_r.into(), x, y, at);
                    for c in 0..3 {
                        let error = (f64::from(found[c].at(x, y)) - truth[c]).abs();
                        assert!(error <= BOUND, "{}: ({x}, {y}) channel {c}: {error:e}", case.label);
                    }
                }
            }
        }
    }
}
