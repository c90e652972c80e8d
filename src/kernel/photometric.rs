//! The photometric filter: a 5x5 mean weighted by closeness of chroma (Fischer & Bartz 2005, eq. 1-3).
//!
//! h(x) = Σ f(ξ)·s(ξ, x) / Σ s(ξ, x), s = exp(-|f_UV(ξ) - f_UV(x)|² / 2σ²), Ω = 5x5 with the center, borders
//! clamped. The sum is linear in f, so filtering Y, U, V is filtering R, G, B; nothing is converted between steps.
//!
//! 1. Planes hold Y and *scaled* chroma: U·g, V·g with g = 1/(σ·√(2·ln 2)), so that s = 2^-(du² + dv²).
//! 2. s is symmetric: twelve weights a pixel (two in its row, five in each of the next two) serve all 24
//!    neighbors. Weight rows live in a ring of three rows; a band recomputes the two rows above it.
//! 3. 2^-t: a magic addition splits t into the nearest integer and g in ±½; a polynomial gives 2^-g and the
//!    integer goes into the exponent bits. t is cut at [`FARTHEST`], where the weight is nothing in f32.
//! 4. Work goes in strips of [`STRIP`] columns on copied rows of constant length, so that all offsets are known to
//!    the compiler and the working set (29 KB) stays in the first cache.
//!
//! Every pixel sums its taps in one fixed order; neither bands nor strips nor the SIMD level touch it.
#![allow(clippy::needless_range_loop)] // offsets and channels index several arrays in step

use crate::pixels::Plane;
use crate::pixels::simd::Level;
use fearless_simd::{Bytes, Simd, SimdBase, dispatch};
use rayon::prelude::*;

/// Columns a strip.
const STRIP: usize = 128;
/// First column of a strip within its rows.
const START: usize = 16;
/// Length of a strip's rows: the strip, two taps on either side, whole vectors of up to 16.
const LENGTH: usize = START + STRIP + 48;
/// Exponents beyond this weigh nothing: 2^-40 of a sum that is at least 1.
const FARTHEST: f32 = 40.0;
/// 1.5·2²³: adding it rounds to an integer, which then sits in the low bits.
const MAGIC: f32 = 12_582_912.0;
/// 2^-g on ±½ with relative error 2.9e-6; exactly 1 at 0.
const POWER: [f32; 4] = [-0.693_124_2, 0.240_240_99, -0.055_906_426, 0.009_582_853];

type Row = [f32; LENGTH];

/// The factor for chroma planes: 1/(σ·√(2·ln 2)).
pub fn chroma_gain(sigma: f32) -> f32 {
    (1.0 / (f64::from(sigma) * (2.0 * std::f64::consts::LN_2).sqrt())) as f32
}

/// One filter step on planes Y, U·g, V·g of one size (see [`chroma_gain`]), at least 1x1. `output` is fitted.
pub fn step(level: Level, input: &[Plane<f32>; 3], output: &mut [Plane<f32>; 3]) {
    let size = input[0].size();
    output.iter_mut().for_each(|plane| plane.resize(size, 0.0));
    if size.area() == 0 {
        return;
    }
    let rows = super::band_rows(size.height, 8);
    let [y, u, v] = output;
    let bands = y.view_mut().par_bands(rows).zip(u.view_mut().par_bands(rows));
    bands.zip(v.view_mut().par_bands(rows)).for_each(|(((first, mut y), (_, mut u)), (_, mut v))| {
        let strips = size.width.div_ceil(STRIP);
        let wide = size.width.div_ceil(strips).next_multiple_of(16);
        for from in (0..size.width).step_by(wide) {
            let columns = wide.min(size.width - from);
            let mut strip = Strip::new(input, from, columns);
            strip.open(level, first as isize);
            for row in 0..y.size().height {
                strip.advance(level, (first + row) as isize);
                let out = [&mut y, &mut u, &mut v].map(|plane| &mut plane.row_mut(row)[from..][..columns]);
                dispatch!(level, simd => strip.sum(simd, out));
            }
        }
    });
}

/// Rings of input rows and weight rows for one strip. Row k of a ring of n sits at k mod n.
struct Strip<'a> {
    input: &'a [Plane<f32>; 3],
    from: usize,
    columns: usize,
    /// Y, U, V of rows y-2 ..= y+2.
    values: [[Row; 3]; 5],
    /// Weights towards columns +1, +2 of the same row.
    same: [Row; 2],
    /// Weights towards columns -2 ..= 2 of the next row, of rows y-1, y.
    next: [[Row; 5]; 2],
    /// Weights towards columns -2 ..= 2 of the row after the next, of rows y-2 ..= y.
    after: [[Row; 5]; 3],
    y: isize,
}

impl<'a> Strip<'a> {
    fn new(input: &'a [Plane<f32>; 3], from: usize, columns: usize) -> Self {
        const ZERO: Row = [0.0; LENGTH];
        Strip {
            input,
            from,
            columns,
            values: [[ZERO; 3]; 5],
            same: [ZERO; 2],
            next: [[ZERO; 5]; 2],
            after: [[ZERO; 5]; 3],
            y: 0,
        }
    }

    /// Makes everything ready for [`Self::advance`] to row `first`.
    fn open(&mut self, level: Level, first: isize) {
        for y in first - 2..first + 2 {
            self.take(y);
        }
        for y in first - 2..first {
            self.take(y + 2);
            self.y = y;
            dispatch!(level, simd => self.weigh(simd, y == first - 1));
        }
    }

    /// Goes on to row `y`: takes row y+2 and computes the weights that start in row y.
    fn advance(&mut self, level: Level, y: isize) {
        self.take(y + 2);
        self.y = y;
        dispatch!(level, simd => self.weigh(simd, true));
    }

    /// Copies input row `y` (clamped) with its clamped neighbors.
    fn take(&mut self, y: isize) {
        let size = self.input[0].size();
        let from_row = y.clamp(0, size.height as isize - 1) as usize;
        let slot = &mut self.values[ring::<5>(y)];
        for (row, plane) in slot.iter_mut().zip(self.input) {
            let line = plane.row(from_row);
            row[START..][..self.columns].copy_from_slice(&line[self.from..][..self.columns]);
            for d in 1..=4 {
                row[START - d] = line[self.from.saturating_sub(d)];
                row[START + self.columns - 1 + d] =
                    line[(self.from + self.columns - 1 + d).min(size.width - 1)];
            }
        }
    }

    /// Weights from row `self.y` to the rows below and, when `all`, within the row.
    #[inline(always)]
    fn weigh<S: Simd>(&mut self, simd: S, all: bool) {
        let y = self.y;
        let rows = [0, 1, 2].map(|d| &self.values[ring::<5>(y + d)]);
        let next = &mut self.next[ring::<2>(y)];
        let after = &mut self.after[ring::<3>(y)];
        let same = &mut self.same;
        let lanes = S::f32s::LEN;
        let blocks = (self.columns + 4).div_ceil(lanes);
        for block in 0..blocks {
            let x = START - 2 + block * lanes;
            // one check here instead of one an access
            if x + lanes + 2 > LENGTH {
                break;
            }
            let u = S::f32s::from_slice(simd, &rows[0][1][x..x + lanes]);
            let v = S::f32s::from_slice(simd, &rows[0][2][x..x + lanes]);
            if all {
                for d in 0..2 {
                    let at = x + d + 1;
                    weight(simd, u, v, rows[0], at).store_slice(&mut same[d][x..x + lanes]);
                }
                for d in 0..5 {
                    weight(simd, u, v, rows[1], x + d - 2).store_slice(&mut next[d][x..x + lanes]);
                }
            }
            for d in 0..5 {
                weight(simd, u, v, rows[2], x + d - 2).store_slice(&mut after[d][x..x + lanes]);
            }
        }
    }

    /// Sums row `self.y`.
    #[inline(always)]
    fn sum<S: Simd>(&self, simd: S, out: [&mut [f32]; 3]) {
        let y = self.y;
        let [above2, above, here, below, below2] = [-2, -1, 0, 1, 2].map(|d| &self.values[ring::<5>(y + d)]);
        let same = &self.same;
        let (next, next_up) = (&self.next[ring::<2>(y)], &self.next[ring::<2>(y - 1)]);
        let (after, after_up) = (&self.after[ring::<3>(y)], &self.after[ring::<3>(y - 2)]);
        let lanes = S::f32s::LEN;
        let [out_y, out_u, out_v] = out;
        for block in 0..self.columns.div_ceil(lanes) {
            let x = START + block * lanes;
            if x + lanes + 2 > LENGTH {
                break;
            }
            let mut sum = Sums {
                k: S::f32s::splat(simd, 1.0),
                of: [
                    S::f32s::from_slice(simd, &here[0][x..x + lanes]),
                    S::f32s::from_slice(simd, &here[1][x..x + lanes]),
                    S::f32s::from_slice(simd, &here[2][x..x + lanes]),
                ],
            };
            for d in 1..3 {
                sum.add(simd, &same[d - 1], x, here, x + d);
                sum.add(simd, &same[d - 1], x - d, here, x - d);
            }
            // a weight towards column d of a row below is, read from there, the weight towards column -d above
            for d in 0..5 {
                let at = x + d - 2;
                sum.add(simd, &next[d], x, below, at);
                sum.add(simd, &next_up[4 - d], at, above, at);
            }
            for d in 0..5 {
                let at = x + d - 2;
                sum.add(simd, &after[d], x, below2, at);
                sum.add(simd, &after_up[4 - d], at, above2, at);
            }
            let scale = S::f32s::splat(simd, 1.0) / sum.k;
            let mean = [sum.of[0] * scale, sum.of[1] * scale, sum.of[2] * scale];
            let done = block * lanes;
            if done + lanes <= out_y.len() {
                mean[0].store_slice(&mut out_y[done..done + lanes]);
                mean[1].store_slice(&mut out_u[done..done + lanes]);
                mean[2].store_slice(&mut out_v[done..done + lanes]);
            } else {
                let rest = out_y.len() - done;
                out_y[done..].copy_from_slice(&mean[0].as_slice()[..rest]);
                out_u[done..].copy_from_slice(&mean[1].as_slice()[..rest]);
                out_v[done..].copy_from_slice(&mean[2].as_slice()[..rest]);
            }
        }
    }
}

struct Sums<S: Simd> {
    k: S::f32s,
    of: [S::f32s; 3],
}

impl<S: Simd> Sums<S> {
    /// Adds the samples at `at`, weighted by the weights at `x`.
    #[inline(always)]
    fn add(&mut self, simd: S, weights: &Row, x: usize, values: &[Row; 3], at: usize) {
        let lanes = S::f32s::LEN;
        let weight = S::f32s::from_slice(simd, &weights[x..x + lanes]);
        self.k += weight;
        for c in 0..3 {
            self.of[c] += S::f32s::from_slice(simd, &values[c][at..at + lanes]) * weight;
        }
    }
}

/// 2^-(du² + dv²) between (u, v) and the samples at `at`.
#[inline(always)]
fn weight<S: Simd>(simd: S, u: S::f32s, v: S::f32s, values: &[Row; 3], at: usize) -> S::f32s {
    let lanes = S::f32s::LEN;
    let du = S::f32s::from_slice(simd, &values[1][at..at + lanes]) - u;
    let dv = S::f32s::from_slice(simd, &values[2][at..at + lanes]) - v;
    half_to(simd, du * du + dv * dv)
}

/// 2^-t of t >= 0, as the file's head says; relative error 2.9e-6, 2^-40 from t = 40 on, exactly 1 at 0.
#[inline(always)]
pub(crate) fn half_to<S: Simd>(simd: S, t: S::f32s) -> S::f32s {
    let t = t.min(S::f32s::splat(simd, FARTHEST));
    let whole = S::f32s::splat(simd, MAGIC) - t;
    let g = t + (whole - MAGIC);
    let p = ((g * POWER[3] + POWER[2]) * g + POWER[1]) * g + POWER[0];
    let p = p * g + 1.0;
    let bits = p.bitcast::<S::u32s>() + (whole.bitcast::<S::u32s>() << 23);
    bits.bitcast()
}

fn ring<const N: usize>(y: isize) -> usize {
    (y + 30).unsigned_abs() % N
}

/// One step in f64 on planes Y, U, V (not scaled) at (`x`, `y`): eq. 1-3.
pub fn reference(input: &[Plane<f32>; 3], sigma: f64, x: usize, y: usize) -> [f64; 3] {
    let size = input[0].size();
    let at = |dx: isize, dy: isize| {
        let x = x.saturating_add_signed(dx).min(size.width - 1);
        let y = y.saturating_add_signed(dy).min(size.height - 1);
        [0, 1, 2].map(|c| f64::from(input[c].at(x, y)))
    };
    let center = at(0, 0);
    let mut k = 0.0;
    let mut sum = [0.0; 3];
    for (dx, dy) in (-2..=2).flat_map(|dy| (-2..=2).map(move |dx| (dx, dy))) {
        let f = at(dx, dy);
        let distance = (f[1] - center[1]) * (f[1] - center[1]) + (f[2] - center[2]) * (f[2] - center[2]);
        let s = libm::exp(-0.5 * distance / (sigma * sigma));
        k += s;
        (0..3).for_each(|c| sum[c] += s * f[c]);
    }
    sum.map(|sum| sum / k)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::{color, sweep};
    use crate::pixels::{Rgb, Size};

    const SIGMA: f32 = 0.025;
    /// One step: the polynomial's 3e-6 and f32 chroma differences of up to 20σ squared, far below a level (4e-3).
    const BOUND: f64 = 2e-5;

    fn planes(case: &sweep::Case) -> [Plane<f32>; 3] {
        let size = case.plane.size();
        let (w, h) = (size.width, size.height);
        let turned = Plane::from_fn(size, |x, y| case.plane.at(w - 1 - x, y));
        let flipped = Plane::from_fn(size, |x, y| case.plane.at(x, h - 1 - y) / 2 + 60);
        let mut yuv = Default::default();
        color::rgb_to_yuv(
            Level::fallback(),
            &Rgb { planes: [case.plane.clone(), turned, flipped] },
            &mut yuv,
        );
        yuv
    }

    fn check(case: &sweep::Case) {
        let yuv = planes(case);
        let size = yuv[0].size();
        let gain = chroma_gain(SIGMA);
        // padded rows with junk between them
        let scaled = [1.0, gain, gain].map(|_| Plane::with_stride(size, size.width + 3, f32::NAN));
        let mut scaled = scaled;
        for c in 0..3 {
            let factor = if c == 0 { 1.0 } else { gain };
            for y in 0..size.height {
                for x in 0..size.width {
                    scaled[c].row_mut(y)[x] = yuv[c].at(x, y) * factor;
                }
            }
        }
        let result = sweep::everywhere(&case.label, |level| {
            let mut out = Default::default();
            step(level, &scaled, &mut out);
            out
        });
        for i in (0..size.area()).step_by((size.area() / 2000).max(1)) {
            let (x, y) = (i % size.width, i / size.width);
            let truth = reference(&yuv, f64::from(SIGMA), x, y);
            for c in 0..3 {
                let factor = if c == 0 { 1.0 } else { f64::from(gain) };
                let error = (f64::from(result[c].at(x, y)) / factor - truth[c]).abs();
                assert!(error <= BOUND, "{}: ({x}, {y}) channel {c}: {error:e}", case.label);
            }
        }
    }

    #[test]
    fn every_picture_matches_the_reference() {
        sweep::cases().iter().for_each(check);
    }

    #[test]
    fn strip_seams_do_not_show() {
        for width in [127, 128, 129, 255, 257, 300] {
            check(&sweep::case("noise", Size::new(width, 12)));
        }
    }

    #[test]
    fn equal_colors_are_left_exactly_alone() {
        let flat = [0.25f32, 2.0, -1.0].map(|v| Plane::new(Size::new(40, 30), v));
        let mut out = Default::default();
        step(Level::new(), &flat, &mut out);
        for (plane, value) in out.iter().zip([0.25, 2.0, -1.0]) {
            assert!(plane.samples().iter().all(|&v: &f32| (v - value).abs() < 1e-6));
        }
    }
}
