//! The Gaussian pyramid: levels of half the size by the kernel [1 4 6 4 1] / 16, and back up by the doubled kernel.
//!
//! Down gives ⌈n/2⌉ pixels after mirroring at the border pixel (reflect-101). Up puts zeros between the pixels,
//! filters, and cuts to the wanted size: even samples are (a + 6b + c) / 8, odd ones (b + c) / 2; mirroring the
//! widened row makes the neighbor before the first the second, and the one after the last the last itself.
//! From bytes the sums are exact integers; every sample is summed in one fixed order.

use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, PlaneRef, Size};
use fearless_simd::{Simd, SimdBase, f32x8};
use rayon::prelude::*;

/// Samples before the first of a widened row.
pub const MARGIN: usize = 8;

/// Length of the scratch row that [`blend`] fills for `width` samples.
pub const fn narrow_length(width: usize) -> usize {
    MARGIN + width.next_multiple_of(8) + 16
}

/// The size of the level below.
pub const fn half(size: Size) -> Size {
    Size::new(size.width.div_ceil(2), size.height.div_ceil(2))
}

/// Index mirrored at the border samples, which are not repeated: -1 is 1, n is n - 2.
pub fn mirrored(i: isize, n: usize) -> usize {
    let last = n as isize - 1;
    let mut i = i;
    while last > 0 && (i < 0 || i > last) {
        i = if i < 0 { -i } else { 2 * last - i };
    }
    if last > 0 { i as usize } else { 0 }
}

/// Sample kinds that a level is made from.
pub trait Sample: Copy + Send + Sync {
    /// What 1.0 is in this kind.
    const ONE: f32;
    /// a + 4b + 6c + 4d + e.
    fn five(of: [Self; 5]) -> f32;
}

impl Sample for u8 {
    const ONE: f32 = 255.0;
    #[inline(always)]
    fn five([a, b, c, d, e]: [u8; 5]) -> f32 {
        let [a, b, c, d, e] = [u16::from(a), u16::from(b), u16::from(c), u16::from(d), u16::from(e)];
        f32::from((a + e) + 4 * (b + d) + 6 * c)
    }
}

impl Sample for f32 {
    const ONE: f32 = 1.0;
    #[inline(always)]
    fn five([a, b, c, d, e]: [f32; 5]) -> f32 {
        (a + e) + (b + d) * 4.0 + c * 6.0
    }
}

/// Scratch rows of [`Down::run`]; keep it from frame to frame.
#[derive(Clone, Debug, Default)]
pub struct Down {
    rows: Vec<f32>,
}

impl Down {
    /// One level down; `output` (fitted) holds 0..1 for bytes, the input's own scale for f32. Allocates only when
    /// the size or the thread count grows.
    pub fn run<T: Sample>(&mut self, level: Level, input: PlaneRef<'_, T>, output: &mut Plane<f32>) {
        let size = input.size();
        let small = half(size);
        output.resize(small, 0.0);
        if size.area() == 0 {
            return;
        }
        // the widened row, then its even and its odd samples
        let length = (size.width + 4).next_multiple_of(16) + 32;
        let band = super::band_rows(small.height, 8);
        let needed = 2 * length * small.height.div_ceil(band);
        if self.rows.len() < needed {
            self.rows.resize(needed, 0.0);
        }
        let bands = output.view_mut().par_bands(band).zip(self.rows.par_chunks_mut(2 * length));
        bands.for_each(|((first, mut out), rows)| {
            let (line, parts) = rows.split_at_mut(length);
            for y in 0..out.size().height {
                let center = 2 * (first + y) as isize;
                let taps = [-2, -1, 0, 1, 2].map(|d| input.row(mirrored(center + d, size.height)));
                dispatch!(level, simd => down_row(simd, taps, line, parts, out.row_mut(y)));
            }
        });
    }
}

#[inline(always)]
fn down_row<S: Simd, T: Sample>(
    simd: S,
    taps: [&[T]; 5],
    line: &mut [f32],
    parts: &mut [f32],
    out: &mut [f32],
) {
    let n = taps[0].len();
    let [a, b, c, d, e] = [&taps[0][..n], &taps[1][..n], &taps[2][..n], &taps[3][..n], &taps[4][..n]];
    let pixels = &mut line[2..2 + n];
    for i in 0..n {
        pixels[i] = T::five([a[i], b[i], c[i], d[i], e[i]]);
    }
    for (at, i) in [(0, -2), (1, -1), (n + 2, n as isize), (n + 3, n as isize + 1)] {
        line[at] = line[2 + mirrored(i, n)];
    }
    let (even, odd) = parts.split_at_mut(parts.len() / 2);
    for ((line, even), odd) in
        line.chunks_exact(16).zip(even.chunks_exact_mut(8)).zip(odd.chunks_exact_mut(8))
    {
        let (low, high) = (f32x8::from_slice(simd, &line[..8]), f32x8::from_slice(simd, &line[8..16]));
        let (e, o) = simd.deinterleave_f32x8(low, high);
        e.store_slice(even);
        o.store_slice(odd);
    }
    let m = out.len();
    let (e0, e1, e2) = (&even[..m], &even[1..m + 1], &even[2..m + 2]);
    let (o0, o1) = (&odd[..m], &odd[1..m + 1]);
    for i in 0..m {
        out[i] = f32::five([e0[i], o0[i], e1[i], o1[i], e2[i]]) * (1.0 / (256.0 * T::ONE));
    }
}

/// The rows of a level that row `y` of the level above blends: above, at and below it.
pub fn taps(y: usize, height: usize) -> [usize; 3] {
    let i = y / 2;
    [if i == 0 { 1.min(height - 1) } else { i - 1 }, i, (i + 1).min(height - 1)]
}

/// Blends three rows of a level into row `y` above, still narrow, with its neighbors on both sides; `narrow` has
/// [`narrow_length`] samples.
#[inline(always)]
pub fn blend(rows: [&[f32]; 3], y: usize, narrow: &mut [f32]) {
    let n = rows[0].len();
    let [a, b, c] = [&rows[0][..n], &rows[1][..n], &rows[2][..n]];
    let out = &mut narrow[MARGIN..MARGIN + n];
    if y.is_multiple_of(2) {
        for i in 0..n {
            out[i] = ((a[i] + c[i]) + b[i] * 6.0) * 0.125;
        }
    } else {
        for i in 0..n {
            out[i] = (b[i] + c[i]) * 0.5;
        }
    }
    narrow[MARGIN - 1] = narrow[MARGIN + 1.min(n - 1)];
    narrow[MARGIN + n] = narrow[MARGIN + n - 1];
}

/// Sixteen samples above from sample `i` (a multiple of 8) of a blended row.
#[inline(always)]
pub fn sixteen<S: Simd>(simd: S, narrow: &[f32], i: usize) -> [f32x8<S>; 2] {
    let window = &narrow[MARGIN + i - 1..][..10];
    let a = f32x8::from_slice(simd, &window[..8]);
    let b = f32x8::from_slice(simd, &window[1..9]);
    let c = f32x8::from_slice(simd, &window[2..]);
    let even = ((a + c) + b * 6.0) * 0.125;
    let odd = (b + c) * 0.5;
    let (low, high) = simd.interleave_f32x8(even, odd);
    [low, high]
}

/// Scratch rows of [`Up::run`]; keep it from frame to frame.
#[derive(Clone, Debug, Default)]
pub struct Up {
    rows: Vec<f32>,
}

impl Up {
    /// One level up to `size`, whose [`half`] the input is. Allocates only when the size or the thread count grows.
    pub fn run(&mut self, level: Level, input: &Plane<f32>, size: Size, output: &mut Plane<f32>) {
        output.resize(size, 0.0);
        if size.area() == 0 {
            return;
        }
        let small = input.size();
        let length = narrow_length(small.width);
        let band = super::band_rows(size.height, 8);
        let needed = length * size.height.div_ceil(band);
        if self.rows.len() < needed {
            self.rows.resize(needed, 0.0);
        }
        let bands = output.view_mut().par_bands(band).zip(self.rows.par_chunks_mut(length));
        bands.for_each(|((first, mut out), narrow)| {
            for y in 0..out.size().height {
                let rows = taps(first + y, small.height).map(|i| input.row(i));
                dispatch!(level, simd => up_row(simd, rows, first + y, narrow, out.row_mut(y)));
            }
        });
    }
}

#[inline(always)]
fn up_row<S: Simd>(simd: S, rows: [&[f32]; 3], y: usize, narrow: &mut [f32], out: &mut [f32]) {
    blend(rows, y, narrow);
    for (block, out) in out.chunks_mut(16).enumerate() {
        let [low, high] = sixteen(simd, narrow, 8 * block);
        if out.len() == 16 {
            low.store_slice(&mut out[..8]);
            high.store_slice(&mut out[8..]);
        } else {
            let first = out.len().min(8);
            out[..first].copy_from_slice(&low.as_slice()[..first]);
            let rest = out.len() - first;
            out[first..].copy_from_slice(&high.as_slice()[..rest]);
        }
    }
}

/// One sample of the level below in f64: the equation, tap by tap.
pub fn down_reference(size: Size, x: usize, y: usize, at: impl Fn(usize, usize) -> f64) -> f64 {
    let mut sum = 0.0;
    for (dx, dy) in (-2..=2).flat_map(|dy| (-2..=2).map(move |dx| (dx, dy))) {
        let (sx, sy) = (2 * x as isize + dx, 2 * y as isize + dy);
        sum += KERNEL[(dx + 2) as usize]
            * KERNEL[(dy + 2) as usize]
            * at(mirrored(sx, size.width), mirrored(sy, size.height));
    }
    sum
}

/// One sample of the level above in f64: zeros between the samples of a picture of `small`, the doubled kernel.
pub fn up_reference(small: Size, x: usize, y: usize, at: impl Fn(usize, usize) -> f64) -> f64 {
    let mut sum = 0.0;
    for (dx, dy) in (-2..=2).flat_map(|dy| (-2..=2).map(move |dx| (dx, dy))) {
        let sx = mirrored(x as isize + dx, 2 * small.width);
        let sy = mirrored(y as isize + dy, 2 * small.height);
        if sx.is_multiple_of(2) && sy.is_multiple_of(2) {
            sum += 4.0 * KERNEL[(dx + 2) as usize] * KERNEL[(dy + 2) as usize] * at(sx / 2, sy / 2);
        }
    }
    sum
}

const KERNEL: [f64; 5] = [1.0 / 16.0, 4.0 / 16.0, 6.0 / 16.0, 4.0 / 16.0, 1.0 / 16.0];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::sweep;

    /// A few f32 roundings of values up to 1.
    const BOUND: f64 = 5e-7;

    #[test]
    fn down_and_up_match_the_reference_everywhere() {
        for case in sweep::cases() {
            let size = case.plane.size();
            let levels = sweep::everywhere(&case.label, |level| {
                let (mut one, mut two, mut back) = (Plane::default(), Plane::default(), Plane::default());
                Down::default().run(level, case.plane.view(), &mut one);
                Down::default().run(level, one.view(), &mut two);
                Up::default().run(level, &one, size, &mut back);
                [one, two, back]
            });
            let [one, two, back] = &levels;
            let check = |found: &Plane<f32>, truth: &dyn Fn(usize, usize) -> f64, what: &str| {
                let size = found.size();
                for i in (0..size.area()).step_by((size.area() / 3000).max(1)) {
                    let (x, y) = (i % size.width, i / size.width);
                    let error = (f64::from(found.at(x, y)) - truth(x, y)).abs();
                    assert!(error <= BOUND, "{} {what} ({x}, {y}): {error:e}", case.label);
                }
            };
            let byte = |x, y| f64::from(case.plane.at(x, y)) / 255.0;
            check(one, &|x, y| down_reference(size, x, y, byte), "down");
            let float = |x, y| f64::from(one.at(x, y));
            check(two, &|x, y| down_reference(one.size(), x, y, float), "down again");
            check(back, &|x, y| up_reference(one.size(), x, y, float), "up");
        }
    }
}
