//! The photometric filter: a 5x5 mean weighted by closeness of chroma (Fischer & Bartz 2005, eq. 1-3).
//!
//! h(x) = Σ f(ξ)·s(ξ, x) / Σ s(ξ, x), s = exp(-|f_UV(ξ) - f_UV(x)|² / 2σ²), Ω = 5x5 with the center, borders
//! clamped. The sum is linear in f, so filtering Y, U, V is filtering R, G, B; nothing is converted between steps.
//!
//! 1. Planes hold Y and *scaled* chroma: U·g, V·g with g = √(c/2)/σ, so that s = e^-((du² + dv²)/c).
//! 2. s is symmetric: twelve weights a pixel (two in its row, five in each of the next two) serve all 24
//!    neighbors. Weight rows live in a ring of three rows; a band recomputes the two rows above it.
//! 3. e^-(t/c) is a cubic's 32nd power (see `fall`); c makes the cubic's first coefficient -1.
//! 4. Work goes in strips of `STRIP` columns on copied rows of constant length, so that all offsets are known to
//!    the compiler and the working set (29 KB) stays in the first cache.
//!
//! Every pixel sums its taps in one fixed order; neither bands nor strips nor the SIMD level touch it.
#![allow(clippy::needless_range_loop)] // offsets and channels index several arrays in step

use crate::pixels::Plane;
use crate::pixels::simd::{Level, dispatch};
use fearless_simd::{Bytes, Simd, SimdBase, SimdFloat, f32x4, f32x8, f64x2};
use rayon::prelude::*;
use std::hint::black_box;

/// Columns a strip, a multiple of [`LANES`].
const STRIP: usize = 120;
/// First column of a strip within its rows: two neighbors come before it.
const START: usize = 2;
/// Length of a strip's rows. Three of them are within reach of one ARM load-pair instruction.
const LENGTH: usize = START + STRIP + 2;
/// Columns at once: two vectors of four or one of eight.
const LANES: usize = 8;
/// c of `fall`: the exponent's scale.
pub(crate) const SCALE: f64 = 0.016_877_87;
/// The other coefficients of `fall`'s cubic, fitted for the least greatest error.
const CUBIC: [f32; 2] = [1.712_289_3, -1.851_523_8];

/// Rows that belong to one picture row, one behind the other so that one address reaches them all: Y, U, V,
/// weights towards columns +1, +2 of the same row,
const SAME: usize = 3;
/// weights towards columns -2 ..= 2 of the next row,
const NEXT: usize = SAME + 2;
/// and of the row after the next.
const AFTER: usize = NEXT + 5;
const ROWS: usize = AFTER + 5;
/// All that belongs to one picture row. Aligned, so that no row starts off the vectors' grid.
#[derive(Clone, Copy)]
#[repr(align(64))]
struct Slot([f32; ROWS * LENGTH]);
/// A slot from some column on: what a block of [`LANES`] columns from the third on reaches.
type Block = [f32; BLOCK];
const BLOCK: usize = (ROWS - 1) * LENGTH + LANES + 4;
/// First column of the last block within the rows.
const LAST: usize = LENGTH - 4 - LANES;

impl Slot {
    #[inline(always)]
    fn block(&self, x: usize) -> &Block {
        &self.0[x..][..BLOCK].as_chunks().0[0]
    }

    #[inline(always)]
    fn block_mut(&mut self, x: usize) -> &mut Block {
        &mut self.0[x..][..BLOCK].as_chunks_mut().0[0]
    }
}

/// The factor for chroma planes: √(c/2)/σ.
pub fn chroma_gain(sigma: f32) -> f32 {
    ((SCALE / 2.0).sqrt() / f64::from(sigma)) as f32
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
        let wide = size.width.div_ceil(strips).next_multiple_of(LANES);
        let mut strip = Strip { input, from: 0, columns: 0, slots: [Slot([0.0; ROWS * LENGTH]); 5] };
        for from in (0..size.width).step_by(wide) {
            let columns = wide.min(size.width - from);
            (strip.from, strip.columns) = (from, columns);
            strip.open(level, first as isize);
            for row in 0..y.size().height {
                let at = (first + row) as isize;
                strip.take(at + 2);
                let out = [&mut y, &mut u, &mut v].map(|plane| &mut plane.row_mut(row)[from..][..columns]);
                dispatch!(level, simd => strip.sum(simd, at, out));
            }
        }
    });
}

/// One strip of columns on its way down the picture.
struct Strip<'a> {
    input: &'a [Plane<f32>; 3],
    from: usize,
    columns: usize,
    /// Rows y-2 ..= y+2 of the picture; row k sits at k mod 5.
    slots: [Slot; 5],
}

impl Strip<'_> {
    /// Makes everything ready to go on to row `first`.
    fn open(&mut self, level: Level, first: isize) {
        for y in first - 2..first + 2 {
            self.take(y);
        }
        for y in first - 2..first {
            dispatch!(level, simd => self.weigh(simd, y));
        }
    }

    /// Copies input row `y` (clamped) with its clamped neighbors.
    fn take(&mut self, y: isize) {
        let size = self.input[0].size();
        let from_row = y.clamp(0, size.height as isize - 1) as usize;
        let slot = &mut self.slots[ring(y)];
        for (row, plane) in slot.0.chunks_exact_mut(LENGTH).zip(self.input) {
            let line = plane.row(from_row);
            row[START..][..self.columns].copy_from_slice(&line[self.from..][..self.columns]);
            for d in 1..=2 {
                row[START - d] = line[self.from.saturating_sub(d)];
                row[START + self.columns - 1 + d] =
                    line[(self.from + self.columns - 1 + d).min(size.width - 1)];
            }
        }
    }

    /// Weights from row `y` to the rows below, without summing.
    #[inline(always)]
    fn weigh<S: Simd>(&mut self, simd: S, y: isize) {
        let rows = self.slots.get_disjoint_mut([ring(y), ring(y + 1), ring(y + 2)]);
        let Ok([here, below, below2]) = rows else { return };
        weigh_sides(simd, here, below, below2, self.columns);
        for x in (0..self.columns).step_by(LANES).take_while(|&x| x <= LAST) {
            let (here, below, below2) = (here.block_mut(x), below.block(x), below2.block(x));
            let [_, u, v] = taps(simd, here, 2);
            for d in 0..5 {
                for (lower, row) in [(below, NEXT + d), (below2, AFTER + d)] {
                    let [_, to_u, to_v] = taps(simd, lower, d);
                    weight(simd, [u, v], [to_u, to_v]).store_slice(&mut here[row * LENGTH + 2..][..LANES]);
                }
            }
        }
    }

    /// Sums row `y`, and computes the weights from it to the rows below on the way: chroma is loaded once for both.
    #[inline(always)]
    fn sum<S: Simd>(&mut self, simd: S, y: isize, out: [&mut [f32]; 3]) {
        let rows = self.slots.get_disjoint_mut([ring(y - 2), ring(y - 1), ring(y), ring(y + 1), ring(y + 2)]);
        // What the compiler does not know keeps its addresses few. Five rows' addresses of their own, not offsets
        // from one; columns -2, -1, 1, 2 as numbers in registers, which fit no ARM load's offset; and a loop over a
        // window's columns that stays a loop, as unrolled its values are too many for any register file.
        let Ok([above2, above, here, below, below2]) = black_box(rows) else { return };
        let [o0, o1, o3, o4, across] = black_box([0usize, 1, 3, 4, 5]);
        let (o0, o1, o3, o4, across) = (o0.min(4), o1.min(4), o3.min(4), o4.min(4), across.min(5));
        let columns = self.columns;
        weigh_same(simd, here, columns, o1.min(1));
        weigh_sides(simd, here, below, below2, columns);
        let [out_y, out_u, out_v] = out;
        let (out_y, out_u, out_v) = (&mut out_y[..columns], &mut out_u[..columns], &mut out_v[..columns]);
        // the second bound is one check here instead of one an access
        for x in (0..columns).step_by(LANES).take_while(|&x| x <= LAST) {
            let (above2, above, here) = (above2.block(x), above.block(x), here.block_mut(x));
            let (below, below2) = (below.block(x), below2.block(x));
            let of = taps(simd, here, 2);
            let mut sum = Sums { k: f32x8::splat(simd, 1.0), of, center: [of[1], of[2]] };
            // a weight towards column d on the right is, read from there, the weight towards column -d on the left
            sum.add(load(simd, here, SAME, 2), taps(simd, here, o3));
            sum.add(load(simd, here, SAME, o1), taps(simd, here, o1));
            sum.add(load(simd, here, SAME + 1, 2), taps(simd, here, o4));
            sum.add(load(simd, here, SAME + 1, o0), taps(simd, here, o0));
            // the same goes for rows below, whose weights are new here, and rows above
            for d in 0..across {
                sum.add_new(simd, taps(simd, below, d), here, NEXT + d);
                sum.add(load(simd, above, NEXT + 4 - d, d), taps(simd, above, d));
            }
            for d in 0..across {
                sum.add_new(simd, taps(simd, below2, d), here, AFTER + d);
                sum.add(load(simd, above2, AFTER + 4 - d, d), taps(simd, above2, d));
            }
            let scale = f32x8::splat(simd, 1.0) / sum.k;
            let mean = [sum.of[0] * scale, sum.of[1] * scale, sum.of[2] * scale];
            if x + LANES <= columns {
                mean[0].store_slice(&mut out_y[x..x + LANES]);
                mean[1].store_slice(&mut out_u[x..x + LANES]);
                mean[2].store_slice(&mut out_v[x..x + LANES]);
            } else {
                for (mean, out) in mean.into_iter().zip([&mut *out_y, &mut *out_u, &mut *out_v]) {
                    let mut last = [0.0; LANES];
                    mean.store_slice(&mut last);
                    out[x..].copy_from_slice(&last[..columns - x]);
                }
            }
        }
    }
}

/// Weights within a row, towards columns +1 and +2; `one` is 1 (see [`Strip::sum`]).
#[inline(always)]
fn weigh_same<S: Simd>(simd: S, here: &mut Slot, columns: usize, one: usize) {
    // two columns before the strip have weights, too: the last block may lie over the one before
    for x in (0..columns + 2).step_by(LANES) {
        let (here, over) = (here.block_mut(x.min(LAST)), x.saturating_sub(LAST).min(2));
        let [_, u, v] = taps(simd, here, over);
        let [_, u1, v1] = taps(simd, here, over + one);
        let [_, u2, v2] = taps(simd, here, over + one + 1);
        weight(simd, [u, v], [u1, v1]).store_slice(&mut here[SAME * LENGTH + over..][..LANES]);
        weight(simd, [u, v], [u2, v2]).store_slice(&mut here[(SAME + 1) * LENGTH + over..][..LANES]);
    }
}

/// Weights of the two columns on either side of a strip towards its own columns in the rows below. Leaves junk next
/// to them: the strip's own columns are weighed afterwards.
#[inline(always)]
fn weigh_sides<S: Simd>(simd: S, here: &mut Slot, below: &Slot, below2: &Slot, columns: usize) {
    let right = START + columns.min(STRIP);
    let center = sides(simd, here, START - 2, right);
    for (slot, to) in [(below, NEXT), (below2, AFTER)] {
        // columns -2 and -1 towards +2, `columns` and `columns` + 1 towards -2; then the same towards +1 and -1
        let far = weight(simd, center, sides(simd, slot, START, right - 2));
        far.store_slice(&mut here.0[(to + 4) * LENGTH + START - 2..][..4]);
        far.store_slice(&mut here.0[to * LENGTH + right - 2..][..4]);
        let near = weight(simd, center, sides(simd, slot, START - 1, right - 1));
        near.store_slice(&mut here.0[(to + 3) * LENGTH + START - 2..][..4]);
        near.store_slice(&mut here.0[(to + 1) * LENGTH + right - 2..][..4]);
    }
}

/// U and V of two columns from `left` and two from `right` on.
#[inline(always)]
fn sides<S: Simd>(simd: S, slot: &Slot, left: usize, right: usize) -> [f32x4<S>; 2] {
    let two = |from: usize| f32x4::from_slice(simd, &slot.0[from..][..4]).bitcast::<f64x2<S>>();
    [
        simd.zip_low_f64x2(two(LENGTH + left), two(LENGTH + right)).bitcast(),
        simd.zip_low_f64x2(two(2 * LENGTH + left), two(2 * LENGTH + right)).bitcast(),
    ]
}

/// Eight values of a row from the block's column `d` on.
#[inline(always)]
fn load<S: Simd>(simd: S, block: &Block, row: usize, d: usize) -> f32x8<S> {
    f32x8::from_slice(simd, &block[row * LENGTH + d..][..LANES])
}

/// Y, U, V from the block's column `d` on.
#[inline(always)]
fn taps<S: Simd>(simd: S, block: &Block, d: usize) -> [f32x8<S>; 3] {
    [load(simd, block, 0, d), load(simd, block, 1, d), load(simd, block, 2, d)]
}

/// Eight pixels' sums, and the chroma that their weights are measured from.
struct Sums<S: Simd> {
    k: f32x8<S>,
    of: [f32x8<S>; 3],
    center: [f32x8<S>; 2],
}

impl<S: Simd> Sums<S> {
    #[inline(always)]
    fn add(&mut self, weight: f32x8<S>, taps: [f32x8<S>; 3]) {
        self.k += weight;
        for c in 0..3 {
            self.of[c] += taps[c] * weight;
        }
    }

    /// Adds taps whose weight is not known yet, and keeps it in a row of `block`, at its own columns.
    #[inline(always)]
    fn add_new(&mut self, simd: S, taps: [f32x8<S>; 3], block: &mut Block, row: usize) {
        let weight = weight(simd, self.center, [taps[1], taps[2]]);
        weight.store_slice(&mut block[row * LENGTH + 2..][..LANES]);
        self.add(weight, taps);
    }
}

/// `fall` of du² + dv² between two places' (u, v).
#[inline(always)]
fn weight<S: Simd, F: SimdFloat<S, Element = f32>>(simd: S, center: [F; 2], at: [F; 2]) -> F {
    let du = at[0] - center[0];
    let dv = at[1] - center[1];
    fall(simd, du * du + dv * dv)
}

/// e^-(t/c) of t >= 0 with c = [`SCALE`]: exactly 1 at 0, off by at most 2.5e-6 (rounding included), 0 where that is
/// next to nothing. The cubic is near e^-(t/32c) and falls all the way; it is cut at 0.
#[inline(always)]
pub(crate) fn fall<S: Simd, F: SimdFloat<S, Element = f32>>(simd: S, t: F) -> F {
    let cubic = ((F::splat(simd, CUBIC[0]) - t) * t + CUBIC[1]) * t + 1.0;
    let root = cubic.max(F::splat(simd, 0.0));
    let second = root * root;
    let fourth = second * second;
    let eighth = fourth * fourth;
    let sixteenth = eighth * eighth;
    sixteenth * sixteenth
}

fn ring(y: isize) -> usize {
    (y + 30).unsigned_abs() % 5
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
    /// One step: the weights' 2.5e-6 and f32 chroma differences of up to 20σ squared, far below a level (4e-3).
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
    fn weights_fall_as_the_exponential_does() {
        let simd = crate::pixels::simd::scalar();
        let weight = |t: f64| f64::from(fall(simd, f32x4::splat(simd, t as f32)).as_slice()[0]);
        for i in 0..=200_000 {
            let t = SCALE * 40.0 * f64::from(i) / 200_000.0;
            let error = (weight(t) - libm::exp(-t / SCALE)).abs();
            assert!(error <= 2.5e-6, "{t}: {error:e}");
        }
        assert!(
            weight(0.0) == 1.0 && weight(1e3) == 0.0 && weight(1e30) == 0.0 && weight(f64::INFINITY) == 0.0
        );
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
