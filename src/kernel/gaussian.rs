//! Gaussian blur of 8-bit planes, down the columns and then along the rows; the kernel ends at three sigma and sums
//! to 1.
//!
//! Taps at the same distance share a weight, so they are added first: exactly, in integers, down the columns. The
//! caller asks for one row at a time, so no blurred plane lies between the passes.

use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, PlaneRef};
use fearless_simd::{Bytes, Simd, SimdBase, f32x8, i16x16, u8x16};
use rayon::prelude::*;

/// Largest sigma, px.
pub const MAX_SIGMA: f64 = 16.0;
/// Most taps: three sigma on either side of the center.
const TAPS: usize = 2 * 48 + 1;
/// Samples before the first of a widened row.
const MARGIN: usize = 48;
/// Pixels done at once down the columns.
const BLOCK: usize = 16;

/// The kernel: weights of the center and of the taps 1, 2, ... px away from it.
fn weights(sigma: f64) -> Vec<f64> {
    let sigma = sigma.min(MAX_SIGMA);
    let radius = (3.0 * sigma).ceil() as usize;
    let weight = |k: usize| libm::exp(-((k * k) as f64) / (2.0 * sigma * sigma));
    let sum = weight(0) + 2.0 * (1..=radius).map(weight).sum::<f64>();
    (0..=radius).map(|k| weight(k) / sum).collect()
}

/// A blur of one sigma.
#[derive(Clone, Debug)]
pub struct Gaussian {
    weights: Vec<f32>,
}

impl Gaussian {
    /// The blur of `sigma` px, over 0 up to [`MAX_SIGMA`].
    pub fn new(sigma: f64) -> Self {
        Self { weights: weights(sigma).into_iter().map(|w| w as f32).collect() }
    }

    /// Samples of a scratch row and of an output row for pictures `width` px wide.
    pub const fn length(width: usize) -> usize {
        2 * MARGIN + width.next_multiple_of(BLOCK)
    }

    /// Row `y` blurred, on the scale of bytes, to the first `width` samples of `out`; the ones after them hold
    /// anything. `line` is scratch; both have [`Gaussian::length`] samples.
    #[inline(always)]
    pub fn row<S: Simd>(
        &self,
        simd: S,
        input: PlaneRef<'_, u8>,
        y: usize,
        line: &mut [f32],
        out: &mut [f32],
    ) {
        let (width, last) = (input.size().width, input.size().height - 1);
        let radius = self.weights.len() - 1;
        let mut rows = [[&[][..]; 2]; TAPS / 2];
        for (k, pair) in rows[..radius].iter_mut().enumerate() {
            *pair = [input.row(y.saturating_sub(k + 1)), input.row((y + k + 1).min(last))];
        }
        let (center, rows) = (input.row(y), &rows[..radius]);
        for x in (0..width).step_by(BLOCK) {
            let [mut low, mut high] = floats(simd, words(simd, center, x));
            low *= self.weights[0];
            high *= self.weights[0];
            for (&[above, below], &weight) in rows.iter().zip(&self.weights[1..]) {
                let [a, b] = floats(simd, words(simd, above, x) + words(simd, below, x));
                low += a * weight;
                high += b * weight;
            }
            low.store_slice(&mut line[MARGIN + x..][..8]);
            high.store_slice(&mut line[MARGIN + x + 8..][..8]);
        }
        let (first, last) = (line[MARGIN], line[MARGIN + width - 1]);
        line[MARGIN - radius..MARGIN].fill(first);
        line[MARGIN + width..][..radius].fill(last);
        for x in (0..width).step_by(8) {
            let at = MARGIN + x;
            let mut sum = f32x8::from_slice(simd, &line[at..at + 8]) * self.weights[0];
            for (k, &weight) in (1..).zip(&self.weights[1..]) {
                let left = f32x8::from_slice(simd, &line[at - k..at - k + 8]);
                let right = f32x8::from_slice(simd, &line[at + k..at + k + 8]);
                sum += (left + right) * weight;
            }
            sum.store_slice(&mut out[x..x + 8]);
        }
    }

    /// The whole plane blurred, 0..1; `output` is fitted. Allocates.
    pub fn run(&self, level: Level, input: PlaneRef<'_, u8>, output: &mut Plane<f32>) {
        let size = input.size();
        output.resize(size, 0.0);
        output.view_mut().par_bands(super::band_rows(size.height, 8)).for_each(|(first, mut band)| {
            let mut scratch = [vec![0.0; Self::length(size.width)], vec![0.0; Self::length(size.width)]];
            for y in 0..band.size().height {
                let [line, blurred] = &mut scratch;
                dispatch!(level, simd => self.row(simd, input, first + y, line, blurred));
                for (to, &from) in band.row_mut(y).iter_mut().zip(&*blurred) {
                    *to = from / 255.0;
                }
            }
        });
    }
}

/// Sixteen bytes from `x` on, 0 past the end.
#[inline(always)]
fn words<S: Simd>(simd: S, row: &[u8], x: usize) -> i16x16<S> {
    let bytes = match row.get(x..x + BLOCK) {
        Some(bytes) => u8x16::from_slice(simd, bytes),
        None => {
            let mut bytes = [0; BLOCK];
            bytes[..row.len() - x].copy_from_slice(&row[x..]);
            u8x16::from_slice(simd, &bytes)
        }
    };
    let (low, high) = simd.widen_u8x16(bytes);
    simd.combine_u16x8(low, high).bitcast()
}

#[inline(always)]
fn floats<S: Simd>(simd: S, words: i16x16<S>) -> [f32x8<S>; 2] {
    let (low, high) = simd.widen_i16x16(words);
    [simd.cvt_f32_i32x8(low), simd.cvt_f32_i32x8(high)]
}

/// The plane blurred in f64, 0..1, rows first.
pub fn reference(input: PlaneRef<'_, u8>, sigma: f64) -> Vec<f64> {
    let (width, height) = (input.size().width, input.size().height);
    let weights = weights(sigma);
    let blur = |from: &[f64], toward: fn(usize, usize, isize) -> [usize; 2]| -> Vec<f64> {
        let pixel = |i: usize| {
            let mut sum = 0.0;
            for k in 1 - weights.len() as isize..weights.len() as isize {
                let [x, y] = toward(i % width, i / width, k);
                sum += weights[k.unsigned_abs()] * from[y.min(height - 1) * width + x.min(width - 1)];
            }
            sum
        };
        (0..from.len()).map(pixel).collect()
    };
    let pixels: Vec<f64> =
        (0..width * height).map(|i| f64::from(input.at(i % width, i / width)) / 255.0).collect();
    let once = blur(&pixels, |x, y, k| [x.saturating_add_signed(k), y]);
    blur(&once, |x, y, k| [x, y.saturating_add_signed(k)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::sweep;

    #[test]
    fn bytes_match_the_reference() {
        for case in sweep::cases() {
            for sigma in [0.3, 3.0, 16.0] {
                let size = case.plane.size();
                if sigma != 3.0 && size.area() > 3000 {
                    continue;
                }
                let found = sweep::everywhere(&case.label, |level| {
                    let mut out = Plane::default();
                    Gaussian::new(sigma).run(level, case.plane.view(), &mut out);
                    out
                });
                let truth = reference(case.plane.view(), sigma);
                for (i, truth) in truth.iter().enumerate() {
                    let miss = 255.0 * (f64::from(found.at(i % size.width, i / size.width)) - truth).abs();
                    assert!(miss < 1e-3, "{}, sigma {sigma}: pixel {i} is off by {miss} levels", case.label);
                }
            }
        }
    }
}
