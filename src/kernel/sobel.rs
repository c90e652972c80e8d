//! Sobel gradients [1 2 1]x[-1 0 1] / 4 with clamped borders: a unit step gives 1.
//!
//! Two forms. On 8-bit pictures gradients are exact in 16-bit integers (four times the gradient of 0..255), sixteen
//! pixels at a time; being linear, the gradients of Y, U, V follow from those of R, G, B. On f32 planes there is a
//! plain row form.
#![allow(clippy::needless_range_loop)] // lanes and channels index several arrays in step

use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, PlaneRef};
use fearless_simd::{Simd, SimdBase, i16x16};
use rayon::prelude::*;

/// Samples before the first pixel of a [`Lines`] row.
const MARGIN: usize = 16;

/// The last three rows of an 8-bit plane, widened to 16 bits, edges repeated.
#[derive(Clone, Debug, Default)]
pub struct Lines {
    samples: Vec<i16>,
    length: usize,
}

impl Lines {
    /// Fits the rows to `width` pixels; allocates only to grow.
    pub fn fit(&mut self, width: usize) {
        self.length = MARGIN + width.next_multiple_of(16) + MARGIN;
        self.samples.resize(3 * self.length, 0);
    }

    /// Takes a row of at least one pixel, as row number `y` (rows y, y-1, y-2 stay available).
    #[inline(always)]
    pub fn push(&mut self, y: usize, row: &[u8]) {
        let line = &mut self.samples[y % 3 * self.length..][..self.length];
        let pixels = &mut line[MARGIN..][..row.len()];
        for (to, &from) in pixels.iter_mut().zip(row) {
            *to = i16::from(from);
        }
        line[MARGIN - 1] = i16::from(row[0]);
        line[MARGIN + row.len()] = i16::from(row[row.len() - 1]);
    }

    /// Sixteen samples of row `y` from x - 1, x and x + 1.
    #[inline(always)]
    fn three<S: Simd>(&self, simd: S, y: usize, x: usize) -> [i16x16<S>; 3] {
        let line = &self.samples[y % 3 * self.length + MARGIN + x - 1..][..18];
        [
            i16x16::from_slice(simd, &line[..16]),
            i16x16::from_slice(simd, &line[1..17]),
            i16x16::from_slice(simd, &line[2..]),
        ]
    }

    /// Sums of the 3x3 samples around sixteen pixels from `x` (a multiple of 16), rows as in [`Lines::gradient`].
    #[inline(always)]
    pub fn nine<S: Simd>(&self, simd: S, top: usize, x: usize) -> i16x16<S> {
        let [a0, a1, a2] = self.three(simd, top, x);
        let [b0, b1, b2] = self.three(simd, top + 1, x);
        let [c0, c1, c2] = self.three(simd, top + 2, x);
        (a0 + a1 + a2) + (b0 + b1 + b2) + (c0 + c1 + c2)
    }

    /// Gradients (times 4, of 0..255) of sixteen pixels from `x` (a multiple of 16) on the row between rows
    /// `top` and `top + 2`; lanes past the width hold anything.
    #[inline(always)]
    pub fn gradient<S: Simd>(&self, simd: S, top: usize, x: usize) -> [i16x16<S>; 2] {
        let [a0, a1, a2] = self.three(simd, top, x);
        let [b0, _, b2] = self.three(simd, top + 1, x);
        let [c0, c1, c2] = self.three(simd, top + 2, x);
        let middle = b2 - b0;
        let gx = (a2 - a0) + (middle + middle) + (c2 - c0);
        let center = c1 - a1;
        let gy = (c0 - a0) + (center + center) + (c2 - a2);
        [gx, gy]
    }
}

/// Exact gradients of an 8-bit plane: four times those of contracts' convention, on 0..255.
pub fn gradients(level: Level, input: PlaneRef<'_, u8>, gx: &mut Plane<i16>, gy: &mut Plane<i16>) {
    let size = input.size();
    gx.resize(size, 0);
    gy.resize(size, 0);
    let rows = super::band_rows(size.height, 8);
    let bands = gx.view_mut().par_bands(rows).zip(gy.view_mut().par_bands(rows));
    bands.for_each(|((first, mut gx), (_, mut gy))| {
        let mut lines = Lines::default();
        lines.fit(size.width);
        lines.push(0, input.row(first.saturating_sub(1)));
        lines.push(1, input.row(first));
        for y in 0..gx.size().height {
            lines.push(y + 2, input.row((first + y + 1).min(size.height - 1)));
            let (gx, gy) = (gx.row_mut(y), gy.row_mut(y));
            dispatch!(level, simd => gradient_row(simd, &lines, y, gx, gy));
        }
    });
}

#[inline(always)]
fn gradient_row<S: Simd>(simd: S, lines: &Lines, top: usize, gx: &mut [i16], gy: &mut [i16]) {
    for (block, (gx, gy)) in gx.chunks_mut(16).zip(gy.chunks_mut(16)).enumerate() {
        let [x, y] = lines.gradient(simd, top, 16 * block);
        gx.copy_from_slice(&x.as_slice()[..gx.len()]);
        gy.copy_from_slice(&y.as_slice()[..gy.len()]);
    }
}

/// Gradients of one row of f32 samples, times `scale`. `rows` are the row above, the row and the row below, each
/// with one edge sample repeated on either side; `gx` and `gy` are two samples shorter.
#[inline(always)]
pub fn gradient_row_f32(rows: [&[f32]; 3], scale: f32, gx: &mut [f32], gy: &mut [f32]) {
    let n = gx.len();
    let [a, b, c] = rows.map(|row| &row[..n + 2]);
    let gy = &mut gy[..n];
    for i in 0..n {
        let middle = b[i + 2] - b[i];
        let center = c[i + 1] - a[i + 1];
        gx[i] = ((a[i + 2] - a[i]) + (middle + middle) + (c[i + 2] - c[i])) * scale;
        gy[i] = ((c[i] - a[i]) + (center + center) + (c[i + 2] - a[i + 2])) * scale;
    }
}

/// Sobel / 4 in f64 at (`x`, `y`) of a picture given by clamped lookups.
pub fn reference(
    width: usize,
    height: usize,
    x: usize,
    y: usize,
    at: impl Fn(usize, usize) -> f64,
) -> [f64; 2] {
    let clamped = |dx: isize, dy: isize| {
        let x = x.saturating_add_signed(dx).min(width - 1);
        at(x, y.saturating_add_signed(dy).min(height - 1))
    };
    let mut g = [0.0; 2];
    for (step, weight) in [(-1, 0.25), (0, 0.5), (1, 0.25)] {
        g[0] += weight * (clamped(1, step) - clamped(-1, step));
        g[1] += weight * (clamped(step, 1) - clamped(step, -1));
    }
    g
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::sweep;
    use crate::pixels::Size;

    #[test]
    fn integers_match_the_reference_exactly() {
        for case in sweep::cases() {
            let size = case.plane.size();
            let [gx, gy] = sweep::everywhere(&case.label, |level| {
                let mut g = [Plane::default(), Plane::default()];
                let [gx, gy] = &mut g;
                gradients(level, case.plane.view(), gx, gy);
                g
            });
            for i in 0..size.area() {
                let (x, y) = (i % size.width, i / size.width);
                let at = |x, y| f64::from(case.plane.at(x, y));
                let truth = reference(size.width, size.height, x, y, at).map(|g| 4.0 * g);
                let found = [f64::from(gx.at(x, y)), f64::from(gy.at(x, y))];
                assert_eq!(found, truth, "{}: ({x}, {y})", case.label);
            }
        }
    }

    #[test]
    fn floats_match_the_reference() {
        let case = sweep::case("noise", Size::new(33, 31));
        let (w, h) = (33usize, 31usize);
        let grown = |y: usize| -> Vec<f32> {
            (0..w + 2).map(|x: usize| f32::from(case.plane.at(x.saturating_sub(1).min(w - 1), y))).collect()
        };
        for y in 0..h {
            let rows = [y.saturating_sub(1), y, (y + 1).min(h - 1)].map(grown);
            let (mut gx, mut gy) = (vec![0.0; w], vec![0.0; w]);
            gradient_row_f32([&rows[0], &rows[1], &rows[2]], 0.25, &mut gx, &mut gy);
            for x in 0..w {
                let truth = reference(w, h, x, y, |x, y| f64::from(case.plane.at(x, y)));
                assert_eq!([f64::from(gx[x]), f64::from(gy[x])], truth, "integers are exact in f32");
            }
        }
    }

    #[test]
    fn a_unit_step_gives_one() {
        let step = |x: usize, _| f64::from(u8::from(x >= 2));
        assert_eq!(reference(4, 3, 1, 1, step), [1.0, 0.0]);
    }
}
