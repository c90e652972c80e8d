//! Exact area average: an 8-bit plane shrinks to f32 values in 0..1.
//!
//! Output sample o covers the input interval [o·in/out, (o+1)·in/out). With in/out = p/q in lowest terms every
//! overlap is a whole number of 1/q pixels and sums to p, so weights are integers: rows add up exactly in u16
//! (u32 where 255·p needs it), columns in f32, and one multiplication by 1/(255·p·p') ends it.

use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, PlaneRef, Size};
use fearless_simd::Simd;
use rayon::prelude::*;

/// Row accumulators, one a band.
const BANDS: usize = 16;

/// Overlaps of one axis, in units of 1/q input pixels.
#[derive(Clone, Debug, Default, PartialEq)]
struct Axis {
    /// First input sample of each output sample.
    first: Vec<u32>,
    /// `taps` overlaps an output sample, zero where it covers fewer.
    weights: Vec<u32>,
    /// A multiple of four.
    taps: usize,
    /// Sum of the overlaps of one output sample.
    total: u32,
}

impl Axis {
    fn new(input: usize, output: usize) -> Self {
        let divisor = gcd(input.max(1), output.max(1));
        let (p, q) = (input / divisor, output / divisor);
        let taps = (p.div_ceil(q.max(1)) + 1).next_multiple_of(4);
        let mut axis = Axis { taps, total: p as u32, ..Axis::default() };
        for o in 0..output {
            let (from, to) = (o * p, (o + 1) * p);
            let first = from / q;
            axis.first.push(first as u32);
            for i in first..first + taps {
                let overlap = to.min((i + 1) * q).saturating_sub(from.max(i * q));
                axis.weights.push(overlap as u32);
            }
        }
        axis
    }

    fn weights(&self, o: usize) -> &[u32] {
        &self.weights[o * self.taps..][..self.taps]
    }
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// Shrinks planes of one size to another; owns the overlap tables and row sums.
#[derive(Debug, Default)]
pub struct Shrink {
    input: Size0,
    output: Size0,
    columns: Axis,
    column_weights: Vec<f32>,
    rows: Axis,
    short: Vec<u16>,
    long: Vec<u32>,
}

/// A size that may not be known yet.
type Size0 = Option<Size>;

impl Shrink {
    /// Averages `input` into `output`, which keeps its size (each side at least 1 and at most the input's).
    /// Allocates only when a size changes.
    pub fn run(&mut self, level: Level, input: PlaneRef<'_, u8>, output: &mut Plane<f32>) {
        self.fit(input.size(), output.size());
        if input.size().area() == 0 || output.size().area() == 0 {
            return;
        }
        let band = output.size().height.div_ceil(BANDS.min(4 * rayon::current_num_threads()));
        let padded = input.size().width + self.columns.taps;
        let scale = (1.0 / (255.0 * f64::from(self.columns.total) * f64::from(self.rows.total))) as f32;
        let (columns, weights, rows) = (&self.columns, &self.column_weights, &self.rows);
        let bands = output.view_mut().par_bands(band);
        if 255 * u64::from(self.rows.total) <= u64::from(u16::MAX) {
            bands.zip(self.short.par_chunks_mut(padded)).for_each(|((first, mut out), sums)| {
                for y in 0..out.size().height {
                    let to = out.row_mut(y);
                    dispatch!(level, simd => row(simd, input, rows, first + y, columns, weights, scale, sums, to));
                }
            });
        } else {
            bands.zip(self.long.par_chunks_mut(padded)).for_each(|((first, mut out), sums)| {
                for y in 0..out.size().height {
                    let to = out.row_mut(y);
                    dispatch!(level, simd => row(simd, input, rows, first + y, columns, weights, scale, sums, to));
                }
            });
        }
    }

    fn fit(&mut self, input: Size, output: Size) {
        if self.input == Some(input) && self.output == Some(output) {
            return;
        }
        (self.input, self.output) = (Some(input), Some(output));
        self.columns = Axis::new(input.width, output.width);
        self.column_weights = self.columns.weights.iter().map(|&w| w as f32).collect();
        self.rows = Axis::new(input.height, output.height);
        // samples past the width stay 0: the last output's spare taps read them
        let length = (input.width + self.columns.taps) * BANDS;
        (self.short, self.long) = (Vec::new(), Vec::new());
        if 255 * u64::from(self.rows.total) <= u64::from(u16::MAX) {
            self.short.resize(length, 0);
        } else {
            self.long.resize(length, 0);
        }
    }
}

/// An exact row sum.
trait Sum: Copy {
    fn start(value: u8, weight: u32) -> Self;
    fn add(self, value: u8, weight: u32) -> Self;
    fn f32(self) -> f32;
}

impl Sum for u16 {
    #[inline(always)]
    fn start(value: u8, weight: u32) -> Self {
        u16::from(value).wrapping_mul(weight as u16)
    }
    #[inline(always)]
    fn add(self, value: u8, weight: u32) -> Self {
        self.wrapping_add(u16::from(value).wrapping_mul(weight as u16))
    }
    #[inline(always)]
    fn f32(self) -> f32 {
        f32::from(self)
    }
}

impl Sum for u32 {
    #[inline(always)]
    fn start(value: u8, weight: u32) -> Self {
        u32::from(value).wrapping_mul(weight)
    }
    #[inline(always)]
    fn add(self, value: u8, weight: u32) -> Self {
        self.wrapping_add(u32::from(value).wrapping_mul(weight))
    }
    #[inline(always)]
    fn f32(self) -> f32 {
        self as f32
    }
}

#[allow(clippy::too_many_arguments)] // one row of a fused loop: everything it reads is a borrowed table
#[inline(always)]
fn row<S: Simd, A: Sum>(
    _simd: S,
    input: PlaneRef<'_, u8>,
    rows: &Axis,
    o: usize,
    columns: &Axis,
    weights: &[f32],
    scale: f32,
    sums: &mut [A],
    out: &mut [f32],
) {
    let width = input.size().width;
    let mut first = true;
    for (j, &weight) in rows.weights(o).iter().enumerate().filter(|(_, weight)| **weight > 0) {
        let samples = input.row(rows.first[o] as usize + j);
        let sums = &mut sums[..width];
        if first {
            sums.iter_mut().zip(samples).for_each(|(sum, &value)| *sum = A::start(value, weight));
        } else {
            sums.iter_mut().zip(samples).for_each(|(sum, &value)| *sum = sum.add(value, weight));
        }
        first = false;
    }
    if columns.taps == 4 {
        for ((out, &first), weights) in out.iter_mut().zip(&columns.first).zip(weights.as_chunks::<4>().0) {
            let s = &sums[first as usize..][..4];
            let sum = s[0].f32() * weights[0] + s[1].f32() * weights[1];
            *out = (sum + s[2].f32() * weights[2] + s[3].f32() * weights[3]) * scale;
        }
    } else {
        for ((out, &first), weights) in
            out.iter_mut().zip(&columns.first).zip(weights.chunks_exact(columns.taps))
        {
            let samples = &sums[first as usize..][..columns.taps];
            let sum = samples.iter().zip(weights).fold(0.0, |sum, (&s, &w)| sum + s.f32() * w);
            *out = sum * scale;
        }
    }
}

/// The area average in f64: output sample (`x`, `y`) of `input` shrunk to `output`, 0..1.
pub fn reference(input: PlaneRef<'_, u8>, output: Size, x: usize, y: usize) -> f64 {
    let spans = |n: usize, out: usize, o: usize| {
        let (from, to) = (o as f64 * n as f64 / out as f64, (o + 1) as f64 * n as f64 / out as f64);
        (from as usize..(to.ceil() as usize).min(n))
            .map(move |i| (i, to.min(i as f64 + 1.0) - from.max(i as f64)))
    };
    let mut sum = 0.0;
    let mut area = 0.0;
    for (j, h) in spans(input.size().height, output.height, y) {
        for (i, w) in spans(input.size().width, output.width, x) {
            sum += w * h * f64::from(input.at(i, j)) / 255.0;
            area += w * h;
        }
    }
    sum / area
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::sweep;

    /// Rounding of the column sums, far below the contract's one level.
    const BOUND: f64 = 1e-6;

    #[test]
    fn every_ratio_matches_the_reference() {
        for case in sweep::cases() {
            let size = case.plane.size();
            let part = |n: usize, num: usize, den: usize| (n * num / den).max(1);
            let ratios = [(3, 8, 3, 8), (1, 4, 1, 4), (1, 1, 1, 1), (5, 7, 2, 3), (1, 999_999, 1, 999_999)];
            for (xn, xd, yn, yd) in ratios {
                let output = Size::new(part(size.width, xn, xd), part(size.height, yn, yd));
                let label = format!("{} to {output}", case.label);
                let result = sweep::everywhere(&label, |level| {
                    let mut plane = Plane::new(output, f32::NAN);
                    let mut shrink = Shrink::default();
                    shrink.run(level, case.plane.view(), &mut plane);
                    plane
                });
                let step = (output.area() / 500).max(1);
                for i in (0..output.area()).step_by(step) {
                    let (x, y) = (i % output.width, i / output.width);
                    let truth = reference(case.plane.view(), output, x, y);
                    let error = (f64::from(result.at(x, y)) - truth).abs();
                    assert!(error <= BOUND, "{label}: ({x}, {y}): {error:e}");
                }
            }
        }
    }

    #[test]
    fn eight_thirds_by_hand() {
        let plane = Plane::from_fn(Size::new(8, 1), |x, _| x as u8);
        let mut out = Plane::new(Size::new(3, 1), 0.0);
        Shrink::default().run(Level::baseline(), plane.view(), &mut out);
        let by_hand =
            [(0.0 + 1.0 + 2.0 * 2.0 / 3.0) / (8.0 / 3.0), (2.0 / 3.0 + 3.0 + 4.0 + 5.0 / 3.0) / (8.0 / 3.0)];
        assert!((out.at(0, 0) * 255.0 - by_hand[0]).abs() < 1e-5);
        assert!((out.at(1, 0) * 255.0 - by_hand[1]).abs() < 1e-5);
    }
}
