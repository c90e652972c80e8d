//! Bilinear enlarging with aligned centers and clamped borders.
//!
//! Output sample o reads the input at (o+.5)·in/out - .5. A row is *grown* by one copy of its edge sample on
//! either side, so that both taps of every output sample exist and no clamping is left: sample x of the input is
//! sample x+1 of the grown row. Rows blend first (few samples), then each row expands: four outputs in a row read
//! at most four neighboring samples where out >= 1.5·in, so one load and two in-register shuffles serve them;
//! other ratios gather one by one, with the same arithmetic.
#![allow(clippy::needless_range_loop)] // lanes and channels index several arrays in step

use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, PlaneRef, Size};
use fearless_simd::{Bytes, Simd, SimdBase, SimdCombine, f32x4, f32x8, u8x32};
use rayon::prelude::*;

/// Samples a grown row must have beyond its `input + 2`: loads of four may reach past the last one.
pub const SLACK: usize = 4;

/// Output samples handled together; tables are padded to whole blocks.
pub const BLOCK: usize = 16;

/// Where each output sample of one axis reads its grown input row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Taps {
    input: usize,
    output: usize,
    /// Left tap of each output sample.
    left: Vec<u32>,
    /// Weight of the right tap, 0..1.
    fraction: Vec<f32>,
    /// First sample each group of four outputs loads.
    base: Vec<u32>,
    /// Per group of four: byte indices of the left taps within the four loaded samples.
    lanes: Vec<u8>,
    /// Whether four samples always suffice.
    narrow: bool,
}

impl Taps {
    /// Fits the tables to enlarge `input` samples to `output` (both at least 1). Allocates only on a change.
    pub fn fit(&mut self, input: usize, output: usize) {
        if (self.input, self.output) == (input, output) {
            return;
        }
        let position = |o: usize| {
            let o = o.min(output.saturating_sub(1));
            let at = (o as f64 + 0.5) * input as f64 / output as f64 + 0.5;
            at.clamp(0.0, input as f64 + 0.5)
        };
        let padded = output.next_multiple_of(BLOCK);
        self.left = (0..padded).map(|o| position(o) as u32).collect();
        self.fraction =
            (0..padded).map(|o| position(o) - f64::from(self.left[o])).map(|f| f as f32).collect();
        self.base = self.left.chunks(4).map(|group| group[0]).collect();
        let span = |group: &[u32]| group[group.len() - 1] - group[0];
        self.narrow = self.left.chunks(4).all(|group| span(group) <= 2);
        self.lanes.clear();
        for group in self.left.chunks(4) {
            let bytes = group.iter().flat_map(|&left| {
                let byte = 4 * (left - group[0]).min(2) as u8;
                [byte, byte + 1, byte + 2, byte + 3]
            });
            self.lanes.extend(bytes);
        }
        (self.input, self.output) = (input, output);
    }

    /// Output samples.
    pub fn output(&self) -> usize {
        self.output
    }

    /// Left tap (in the grown row) and right weight of output sample `o`.
    pub fn at(&self, o: usize) -> (usize, f32) {
        (self.left[o] as usize, self.fraction[o])
    }

    /// First sample that output samples `first..=last` read, and the one after their last.
    pub fn window(&self, first: usize, last: usize) -> (usize, usize) {
        (self.left[first] as usize, self.left[last] as usize + 2)
    }
}

/// Eight output samples' taps, in registers.
#[derive(Clone, Copy)]
pub struct Eight<S: Simd> {
    low: usize,
    high: usize,
    left: u8x32<S>,
    right: u8x32<S>,
    fraction: f32x8<S>,
    first: usize,
}

impl<S: Simd> Eight<S> {
    /// The taps of output samples `8·index .. 8·index + 8`.
    #[inline(always)]
    pub fn load(simd: S, taps: &Taps, index: usize) -> Self {
        let left = u8x32::from_slice(simd, &taps.lanes[index * 32..][..32]);
        Self {
            low: taps.base[index * 2] as usize,
            high: taps.base[index * 2 + 1] as usize,
            left,
            right: left + 4,
            fraction: f32x8::from_slice(simd, &taps.fraction[index * 8..][..8]),
            first: index * 8,
        }
    }

    /// Expands one grown row (at least `input + 2 + SLACK` samples long): a + f·(b - a).
    #[inline(always)]
    pub fn expand(&self, simd: S, taps: &Taps, row: &[f32]) -> f32x8<S> {
        let (a, b) = if taps.narrow {
            let low = f32x4::from_slice(simd, &row[self.low..][..4]);
            let high = f32x4::from_slice(simd, &row[self.high..][..4]);
            let bytes = low.combine(high).to_bytes();
            let a = simd.swizzle_dyn_within_blocks_u8x32(bytes, self.left);
            let b = simd.swizzle_dyn_within_blocks_u8x32(bytes, self.right);
            (f32x8::from_bytes(a), f32x8::from_bytes(b))
        } else {
            let left = &taps.left[self.first..][..8];
            let mut taken = [[0.0; 8]; 2];
            for i in 0..8 {
                taken[0][i] = row[left[i] as usize];
                taken[1][i] = row[left[i] as usize + 1];
            }
            (f32x8::from_slice(simd, &taken[0]), f32x8::from_slice(simd, &taken[1]))
        };
        a + (b - a) * self.fraction
    }
}

/// Blends two rows: a + f·(b - a).
#[inline(always)]
pub fn blend_rows(a: &[f32], b: &[f32], f: f32, out: &mut [f32]) {
    let n = out.len();
    let (a, b) = (&a[..n], &b[..n]);
    for i in 0..n {
        out[i] = a[i] + (b[i] - a[i]) * f;
    }
}

/// Enlarges a plane into `output`, which keeps its size (at least the input's in both directions).
pub fn enlarge(level: Level, input: PlaneRef<'_, f32>, output: &mut Plane<f32>) {
    let (from, to) = (input.size(), output.size());
    if from.area() == 0 || to.area() == 0 {
        return;
    }
    let (mut columns, mut rows) = (Taps::default(), Taps::default());
    columns.fit(from.width, to.width);
    rows.fit(from.height, to.height);
    let grown = Plane::from_fn(Size::new(from.width + 2 + SLACK, from.height + 2), |x, y| {
        input.at(x.saturating_sub(1).min(from.width - 1), y.saturating_sub(1).min(from.height - 1))
    });
    output.view_mut().par_bands(super::band_rows(to.height, 8)).for_each(|(first, mut band)| {
        let mut narrow = vec![0.0; grown.size().width];
        for y in 0..band.size().height {
            let (top, f) = rows.at(first + y);
            let out = band.row_mut(y);
            dispatch!(level, simd => enlarge_row(simd, &columns, grown.row(top), grown.row(top + 1), f, &mut narrow, out));
        }
    });
}

#[inline(always)]
fn enlarge_row<S: Simd>(
    simd: S,
    taps: &Taps,
    a: &[f32],
    b: &[f32],
    f: f32,
    narrow: &mut [f32],
    out: &mut [f32],
) {
    blend_rows(a, b, f, narrow);
    for (index, out) in out.chunks_mut(8).enumerate() {
        let eight = Eight::load(simd, taps, index).expand(simd, taps, narrow);
        out.copy_from_slice(&eight.as_slice()[..out.len()]);
    }
}

/// Bilinear enlarging in f64: output sample (`x`, `y`) of `input` enlarged to `output`.
pub fn reference(input: PlaneRef<'_, f32>, output: Size, x: usize, y: usize) -> f64 {
    let taps = |n: usize, out: usize, o: usize| {
        let at = ((o as f64 + 0.5) * n as f64 / out as f64 - 0.5).clamp(0.0, (n - 1) as f64);
        let low = at.floor();
        (low as usize, (low as usize + 1).min(n - 1), at - low)
    };
    let (x0, x1, fx) = taps(input.size().width, output.width, x);
    let (y0, y1, fy) = taps(input.size().height, output.height, y);
    let at = |x, y| f64::from(input.at(x, y));
    let top = at(x0, y0) * (1.0 - fx) + at(x1, y0) * fx;
    let bottom = at(x0, y1) * (1.0 - fx) + at(x1, y1) * fx;
    top * (1.0 - fy) + bottom * fy
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::sweep;

    /// Rounding of three f32 blends of values up to 255 (in levels).
    const BOUND: f64 = 1e-4;

    #[test]
    fn every_ratio_matches_the_reference() {
        for case in sweep::cases() {
            let size = case.plane.size();
            if size.width > 200 {
                continue;
            }
            let input = Plane::from_fn(size, |x, y| f32::from(case.plane.at(x, y)));
            for (num, den) in [(8, 3), (4, 1), (1, 1), (7, 6), (3, 2), (13, 4)] {
                let output = Size::new(size.width * num / den, size.height * num / den);
                let label = format!("{} to {output}", case.label);
                let result = sweep::everywhere(&label, |level| {
                    let mut plane = Plane::new(output, f32::NAN);
                    enlarge(level, input.view(), &mut plane);
                    plane
                });
                for i in (0..output.area()).step_by((output.area() / 3000).max(1)) {
                    let (x, y) = (i % output.width, i / output.width);
                    let error = (f64::from(result.at(x, y)) - reference(input.view(), output, x, y)).abs();
                    assert!(error <= BOUND, "{label}: ({x}, {y}): {error:e}");
                }
            }
        }
    }
}
