//! Gaussian blur of 8-bit planes; the kernel ends at three sigma and sums to 1.
//!
//! A wide blur leaves nothing fine to see, so it is done on a quarter of the pixels, as in a pyramid: binomial filter
//! and halving, a kernel of half the width, and up again by the binomial filter. The half kernel is the one whose whole
//! way comes closest to the Gaussian (least squares). What differs is bounded for every picture whatever: by half of
//! the sum of the kernels' absolute differences. This way is taken only where that is at most half a level a
//! direction (.49 at sigma 3), so never more than one level.
//! Narrower blurs run the kernel itself down the columns and along the rows.
//!
//! Rows are asked for one at a time, so no blurred plane is ever stored.

use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, PlaneRef};
use fearless_simd::{Bytes, Simd, SimdBase, f32x8, i16x16, u8x16};
use rayon::prelude::*;

/// Largest sigma, px.
pub const MAX_SIGMA: f64 = 16.0;
/// Taps on either side of the center at most.
const MAX_RADIUS: usize = 48;
/// Samples before the first of a widened row, and after its last.
const MARGIN: usize = MAX_RADIUS + 16;
/// Pixels done at once down the columns.
const BLOCK: usize = 16;

/// The kernel: weights of the center and of the taps 1, 2, ... px away from it.
fn kernel(sigma: f64) -> Vec<f64> {
    let sigma = sigma.min(MAX_SIGMA);
    let radius = ((3.0 * sigma).ceil() as usize).min(MAX_RADIUS);
    let weight = |k: usize| libm::exp(-((k * k) as f64) / (2.0 * sigma * sigma));
    let sum = weight(0) + 2.0 * (1..=radius).map(weight).sum::<f64>();
    (0..=radius).map(|k| weight(k) / sum).collect()
}

/// A blur of one sigma.
#[derive(Clone, Debug)]
pub struct Gaussian {
    kernel: Vec<f32>,
    halved: Option<Halved>,
}

/// The blur by way of half the size.
#[derive(Clone, Debug)]
struct Halved {
    /// The half kernel.
    kernel: Vec<f32>,
    /// It and the way up joined, for even rows: weights of the half row itself and of those 1, 2, ... away.
    even: Vec<f32>,
    /// The same for odd rows: weights of the two half rows around, the two around these, ...
    odd: Vec<f32>,
}

/// The half-size rows of a plane, blurred along; see [`Gaussian::prepare`].
#[derive(Clone, Debug, Default)]
pub struct Halves {
    rows: Vec<f32>,
    scratch: Vec<f32>,
    /// Samples of a row.
    stride: usize,
}

impl Gaussian {
    /// The blur of `sigma` px, over 0 up to [`MAX_SIGMA`].
    pub fn new(sigma: f64) -> Self {
        let kernel = kernel(sigma);
        Self { halved: Halved::of(&kernel), kernel: floats_of(&kernel) }
    }

    /// Samples of a scratch row and of an output row for pictures `width` px wide.
    pub const fn length(width: usize) -> usize {
        2 * MARGIN + width.next_multiple_of(BLOCK)
    }

    /// To be called with a picture before its rows are asked for. Allocates only to grow.
    pub fn prepare(&self, level: Level, input: PlaneRef<'_, u8>, halves: &mut Halves) {
        let (size, Some(halved)) = (input.size(), &self.halved) else { return };
        if size.area() == 0 {
            return;
        }
        let halo = halved.halo();
        let height = size.height.div_ceil(2) + 2 * halo;
        halves.stride = (size.width.div_ceil(2) + 2).next_multiple_of(16);
        let length = (size.width + 4 * halo + 8).next_multiple_of(16) + 32;
        let band = super::band_rows(height, 8);
        if halves.rows.len() < halves.stride * height {
            halves.rows.resize(halves.stride * height, 0.0);
        }
        if halves.scratch.len() < 2 * length * height.div_ceil(band) {
            halves.scratch.resize(2 * length * height.div_ceil(band), 0.0);
        }
        let bands = halves.rows[..halves.stride * height].par_chunks_mut(halves.stride * band);
        bands.zip(halves.scratch.par_chunks_mut(2 * length)).enumerate().for_each(|(k, (rows, scratch))| {
            let (line, parts) = scratch.split_at_mut(length);
            for (y, row) in rows.chunks_exact_mut(halves.stride).enumerate() {
                // even rows of the picture, going on beyond its borders
                let center = 2 * (k * band + y) as isize - 2 * halo as isize;
                let last = size.height as isize - 1;
                let taps = [-2, -1, 0, 1, 2].map(|d| input.row((center + d).clamp(0, last) as usize));
                dispatch!(level, simd => halved.row(simd, taps, line, parts, row));
            }
        });
    }

    /// Row `y` blurred, on the scale of bytes, to the first `width` samples of `out`; the ones after them hold
    /// anything. `halves` are those of this picture; `line` is scratch; it and `out` have [`Gaussian::length`] samples.
    #[inline(always)]
    pub fn row<S: Simd>(
        &self,
        simd: S,
        input: PlaneRef<'_, u8>,
        halves: &Halves,
        y: usize,
        line: &mut [f32],
        out: &mut [f32],
    ) {
        match &self.halved {
            Some(halved) => halved.up(simd, halves, input.size().width, y, line, out),
            None => self.direct(simd, input, y, line, out),
        }
    }

    /// The kernel itself: down the columns, exactly summed in pairs, then along the row.
    #[inline(always)]
    fn direct<S: Simd>(&self, simd: S, input: PlaneRef<'_, u8>, y: usize, line: &mut [f32], out: &mut [f32]) {
        let (width, last) = (input.size().width, input.size().height - 1);
        let radius = self.kernel.len() - 1;
        let mut rows = [[&[][..]; 2]; MAX_RADIUS];
        for (k, pair) in rows[..radius].iter_mut().enumerate() {
            *pair = [input.row(y.saturating_sub(k + 1)), input.row((y + k + 1).min(last))];
        }
        let (center, rows) = (input.row(y), &rows[..radius]);
        for x in (0..width).step_by(BLOCK) {
            let [mut low, mut high] = floats(simd, words(simd, center, x));
            low *= self.kernel[0];
            high *= self.kernel[0];
            for (&[above, below], &weight) in rows.iter().zip(&self.kernel[1..]) {
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
        let line = &line[MARGIN - radius..];
        for x in (0..width).step_by(8) {
            symmetric(simd, &self.kernel, &line[x..]).store_slice(&mut out[x..x + 8]);
        }
    }

    /// The whole plane blurred, 0..1; `output` is fitted. Allocates.
    pub fn run(&self, level: Level, input: PlaneRef<'_, u8>, output: &mut Plane<f32>) {
        let size = input.size();
        output.resize(size, 0.0);
        let mut halves = Halves::default();
        self.prepare(level, input, &mut halves);
        output.view_mut().par_bands(super::band_rows(size.height, 8)).for_each(|(first, mut band)| {
            let mut scratch = [vec![0.0; Self::length(size.width)], vec![0.0; Self::length(size.width)]];
            for y in 0..band.size().height {
                let [line, blurred] = &mut scratch;
                dispatch!(level, simd => self.row(simd, input, &halves, first + y, line, blurred));
                for (to, &from) in band.row_mut(y).iter_mut().zip(&*blurred) {
                    *to = from / 255.0;
                }
            }
        });
    }
}

impl Halved {
    /// The half kernel that comes closest to `kernel`, where it comes close enough.
    fn of(kernel: &[f64]) -> Option<Self> {
        let radius = kernel.len() / 2;
        let wanted = |k: isize| kernel.get(k.unsigned_abs()).copied().unwrap_or(0.0);
        // what one tap of the half kernel, and its mirror image, does to a pixel on an even (0) or odd (1) column
        let reach = 2 * radius as isize + 5;
        let ways = (0..2).flat_map(|odd| (-reach..=reach).map(move |k| (odd, k)));
        let share = |tap: usize, (odd, k): (usize, isize)| {
            let up: &[(isize, f64)] =
                if odd == 0 { &[(-1, 0.125), (0, 0.75), (1, 0.125)] } else { &[(0, 0.5), (1, 0.5)] };
            let down = |d: isize| [6.0, 4.0, 1.0].get(d.unsigned_abs()).map_or(0.0, |w| w / 16.0);
            let one =
                |tap: isize| up.iter().map(|&(j, w)| w * down(k + odd as isize - 2 * (j + tap))).sum::<f64>();
            if tap == 0 { one(0) } else { one(tap as isize) + one(-(tap as isize)) }
        };
        // the normal equations
        let mut system = vec![vec![0.0; radius + 2]; radius + 1];
        for way in ways.clone() {
            for (i, row) in system.iter_mut().enumerate() {
                for (j, sum) in row[..=radius].iter_mut().enumerate() {
                    *sum += share(i, way) * share(j, way);
                }
                row[radius + 1] += share(i, way) * wanted(way.1);
            }
        }
        let mut half = solved(system);
        let sum = half[0] + 2.0 * half[1..].iter().sum::<f64>();
        half.iter_mut().for_each(|w| *w /= sum);
        let worst = [0, 1].map(|odd| {
            let miss = |way| (0..=radius).map(|tap| half[tap] * share(tap, way)).sum::<f64>() - wanted(way.1);
            255.0 / 2.0 * ways.clone().filter(|way| way.0 == odd).map(|way| miss(way).abs()).sum::<f64>()
        });
        let at = |k: usize| half.get(k).copied().unwrap_or(0.0);
        let even = (0..=radius + 1).map(|k: usize| 0.75 * at(k) + 0.125 * (at(k.abs_diff(1)) + at(k + 1)));
        let odd = (0..=radius).map(|k| 0.5 * (at(k) + at(k + 1)));
        let (even, odd): (Vec<f64>, Vec<f64>) = (even.collect(), odd.collect());
        let fine = worst.iter().all(|&worst| worst <= 0.5);
        fine.then(|| Self { kernel: floats_of(&half), even: floats_of(&even), odd: floats_of(&odd) })
    }

    /// Half rows, and half columns, that are looked at beyond the picture.
    const fn halo(&self) -> usize {
        self.kernel.len()
    }

    /// One half row: binomial filter down five rows and along, then the half kernel along; from the half column before
    /// the first to the one after the last.
    #[inline(always)]
    fn row<S: Simd>(&self, simd: S, taps: [&[u8]; 5], line: &mut [f32], parts: &mut [f32], out: &mut [f32]) {
        let (n, halo) = (taps[0].len(), self.halo());
        let before = 2 * halo + 2;
        let [a, b, c, d, e] = [&taps[0][..n], &taps[1][..n], &taps[2][..n], &taps[3][..n], &taps[4][..n]];
        let pixels = &mut line[before..before + n];
        for i in 0..n {
            let (outer, inner) = (u16::from(a[i]) + u16::from(e[i]), u16::from(b[i]) + u16::from(d[i]));
            pixels[i] = f32::from(outer + 4 * inner + 6 * u16::from(c[i]));
        }
        let (first, last) = (pixels[0], pixels[n - 1]);
        line[..before].fill(first);
        line[before + n..].fill(last);
        let (even, odd) = parts.split_at_mut(parts.len() / 2);
        for ((line, even), odd) in
            line.chunks_exact(16).zip(even.chunks_exact_mut(8)).zip(odd.chunks_exact_mut(8))
        {
            let (low, high) = (f32x8::from_slice(simd, &line[..8]), f32x8::from_slice(simd, &line[8..]));
            let (e, o) = simd.deinterleave_f32x8(low, high);
            e.store_slice(even);
            o.store_slice(odd);
        }
        // in place of the line: from half column -halo on
        let count = n.div_ceil(2) + 2 * halo;
        let (e0, e1, e2) = (&even[..count], &even[1..count + 1], &even[2..count + 2]);
        let (o0, o1) = (&odd[..count], &odd[1..count + 1]);
        let halves = &mut line[..count];
        for i in 0..count {
            halves[i] = ((e0[i] + e2[i]) + (o0[i] + o1[i]) * 4.0 + e1[i] * 6.0) * (1.0 / 256.0);
        }
        for x in (0..n.div_ceil(2) + 2).step_by(8) {
            symmetric(simd, &self.kernel, &line[x..]).store_slice(&mut out[x..x + 8]);
        }
    }

    /// Row `y` of the full size: the half kernel down the half rows joined with the way up, then up along.
    #[inline(always)]
    fn up<S: Simd>(
        &self,
        simd: S,
        halves: &Halves,
        width: usize,
        y: usize,
        line: &mut [f32],
        out: &mut [f32],
    ) {
        let center = y / 2 + self.halo();
        let count = width.div_ceil(2);
        let row = |i: usize| &halves.rows[i * halves.stride..][..halves.stride];
        // pairs at the same distance; on even rows the first is the row itself, twice
        let odd = y % 2;
        let weights = if odd == 1 { &self.odd } else { &self.even };
        let mut rows = [[&[][..]; 2]; MAX_RADIUS];
        for (k, pair) in rows[..weights.len()].iter_mut().enumerate() {
            *pair = [row(center - k), row(center + odd + k)];
        }
        let first = if odd == 1 { weights[0] } else { 0.5 * weights[0] };
        let rows = rows[1..weights.len()].iter().zip(&weights[1..]);
        for x in (0..count + 2).step_by(16) {
            let [above, below] = [&row(center)[x..x + 16], &row(center + odd)[x..x + 16]];
            let mut low =
                (f32x8::from_slice(simd, &above[..8]) + f32x8::from_slice(simd, &below[..8])) * first;
            let mut high =
                (f32x8::from_slice(simd, &above[8..]) + f32x8::from_slice(simd, &below[8..])) * first;
            for (&[above, below], &weight) in rows.clone() {
                let (above, below) = (&above[x..x + 16], &below[x..x + 16]);
                low += (f32x8::from_slice(simd, &above[..8]) + f32x8::from_slice(simd, &below[..8])) * weight;
                high +=
                    (f32x8::from_slice(simd, &above[8..]) + f32x8::from_slice(simd, &below[8..])) * weight;
            }
            low.store_slice(&mut line[x..x + 8]);
            high.store_slice(&mut line[x + 8..x + 16]);
        }
        for x in (0..count).step_by(8) {
            let left = f32x8::from_slice(simd, &line[x..x + 8]);
            let middle = f32x8::from_slice(simd, &line[x + 1..x + 9]);
            let right = f32x8::from_slice(simd, &line[x + 2..x + 10]);
            let even = (left + right) * 0.125 + middle * 0.75;
            let odd = (middle + right) * 0.5;
            let (low, high) = simd.interleave_f32x8(even, odd);
            low.store_slice(&mut out[2 * x..2 * x + 8]);
            high.store_slice(&mut out[2 * x + 8..2 * x + 16]);
        }
    }
}

/// The kernel over eight samples; `line` begins with the first one's farthest tap.
#[inline(always)]
fn symmetric<S: Simd>(simd: S, kernel: &[f32], line: &[f32]) -> f32x8<S> {
    let radius = kernel.len() - 1;
    let line = &line[..2 * radius + 8];
    let mut sum = f32x8::from_slice(simd, &line[radius..radius + 8]) * kernel[0];
    for (k, &weight) in (1..).zip(&kernel[1..]) {
        let left = f32x8::from_slice(simd, &line[radius - k..radius - k + 8]);
        sum += (left + f32x8::from_slice(simd, &line[radius + k..radius + k + 8])) * weight;
    }
    sum
}

/// Solves a small symmetric positive definite system, the right side being its last column.
fn solved(mut rows: Vec<Vec<f64>>) -> Vec<f64> {
    let n = rows.len();
    for i in 0..n {
        let pivot = rows[i].clone();
        for (_, row) in rows.iter_mut().enumerate().filter(|(j, _)| *j != i) {
            let factor = row[i] / pivot[i];
            row.iter_mut().zip(&pivot).for_each(|(to, from)| *to -= factor * from);
        }
    }
    rows.iter().enumerate().map(|(i, row)| row[n] / row[i]).collect()
}

fn floats_of(values: &[f64]) -> Vec<f32> {
    values.iter().map(|&v| v as f32).collect()
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
    let weights = kernel(sigma);
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
            for (sigma, bound) in [(0.3, 1e-3), (2.0, 1e-3), (3.0, 1.0), (16.0, 1.0)] {
                let size = case.plane.size();
                if sigma != 3.0 && size.area() > 5000 {
                    continue;
                }
                let found = sweep::everywhere(&case.label, |level| {
                    let mut out = Plane::default();
                    Gaussian::new(sigma).run(level, case.plane.view(), &mut out);
                    out
                });
                let mut worst = 0.0f64;
                let truth = reference(case.plane.view(), sigma);
                for (i, truth) in truth.iter().enumerate() {
                    let miss = 255.0 * (f64::from(found.at(i % size.width, i / size.width)) - truth).abs();
                    assert!(
                        miss <= bound,
                        "{}, sigma {sigma}: pixel {i} is off by {miss} levels",
                        case.label
                    );
                    worst = worst.max(miss);
                }
                println!("{}, sigma {sigma}: {worst:.4} levels (bound {bound})", case.label);
            }
        }
    }

    #[test]
    fn wide_blurs_go_by_way_of_half_the_size() {
        for (sigma, halved) in
            [(0.3, false), (1.0, false), (3.0, true), (4.0, true), (8.0, true), (16.0, true)]
        {
            assert_eq!(Gaussian::new(sigma).halved.is_some(), halved, "sigma {sigma}");
        }
    }
}
