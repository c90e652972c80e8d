//! RGB to luma and to full-range BT.601 YUV 4:4:4, in exact integers.

use super::to_level;
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, PlaneMut, Rgb};
use fearless_simd::prelude::*;
use rayon::prelude::*;

const BAND: usize = 32;

/// Parts interleaved R G B into `out` (luma, red, green, blue); stretches limited range unless `full`.
#[inline(always)]
pub(super) fn split_rgb(bytes: &[u8], full: bool, out: [&mut [u8]; 4]) {
    let [luma, red, green, blue] = out;
    let pixels =
        bytes.as_chunks::<3>().0.iter().zip(red.iter_mut()).zip(green.iter_mut()).zip(blue.iter_mut());
    if full {
        for (((from, r), g), b) in pixels {
            [*r, *g, *b] = *from;
        }
    } else {
        for (((from, r), g), b) in pixels {
            [*r, *g, *b] = from.map(stretch);
        }
    }
    luma_row(red, green, blue, luma);
}

/// 16..235 to 0..255, rounded to the nearest (a tie cannot happen: 73 is odd).
#[inline(always)]
fn stretch(v: u8) -> u8 {
    ((((i32::from(v) - 16).max(0) * 170 + 73) / 146).min(255)) as u8
}

#[inline(always)]
fn luma_row(red: &[u8], green: &[u8], blue: &[u8], luma: &mut [u8]) {
    for (((l, r), g), b) in luma.iter_mut().zip(red).zip(green).zip(blue) {
        *l = ((9798 * u32::from(*r) + 19235 * u32::from(*g) + 3735 * u32::from(*b) + 16384) >> 15) as u8;
    }
}

/// Gray of an RGB picture: (9798R + 19235G + 3735B + 16384) >> 15, OpenCV's 15-bit BT.601.
pub fn luma_of_rgb(level: Level, color: &Rgb, luma: &mut Plane<u8>) {
    luma.resize(color.size(), 0);
    luma.view_mut().par_bands(BAND).for_each(|(first, mut band)| {
        dispatch!(level, simd => gray_band(simd, color, first, &mut band));
    });
}

#[inline(always)]
fn gray_band<S: Simd>(_: S, color: &Rgb, first: usize, band: &mut PlaneMut<'_, u8>) {
    let [red, green, blue] = &color.planes;
    for y in 0..band.size().height {
        luma_row(red.row(first + y), green.row(first + y), blue.row(first + y), band.row_mut(y));
    }
}

/// RGB to full-range BT.601 planes Y, Cb, Cr of the same size, resizing them: what Y4M's C444 with
/// `XCOLORRANGE=FULL` carries. Each value is the exact one rounded by floor(v + .5), clamped to 0..255.
pub fn from_rgb(level: Level, color: &Rgb, yuv: &mut [Plane<u8>; 3]) {
    for plane in yuv.iter_mut() {
        plane.resize(color.size(), 0);
    }
    let [y, cb, cr] = yuv;
    let bands = y.view_mut().par_bands(BAND).zip(cb.view_mut().par_bands(BAND));
    bands.zip(cr.view_mut().par_bands(BAND)).for_each(|(((first, mut y), (_, mut cb)), (_, mut cr))| {
        dispatch!(level, simd => {
            for line in 0..y.size().height {
                let rgb = [0, 1, 2].map(|c: usize| color.planes[c].row(first + line));
                yuv_row(simd, rgb, [y.row_mut(line), cb.row_mut(line), cr.row_mut(line)]);
            }
        });
    });
}

/// 1/1000, 1/1772 and 1/1402, none below the true value. The numerators below are exact integers under 2¹⁹,
/// so product's error (< 5e-5) cannot reach the next integer (≥ 5e-4 away), and truncation gives the exact
/// floor of the exact quotient.
const PER_THOUSAND: f32 = above(1.0 / 1000.0);
const PER_1772: f32 = above(1.0 / 1772.0);
const PER_1402: f32 = above(1.0 / 1402.0);

const fn above(v: f64) -> f32 {
    let near = v as f32;
    if (near as f64) < v { f32::from_bits(near.to_bits() + 1) } else { near }
}

#[inline(always)]
fn yuv_row<S: Simd>(simd: S, rgb: [&[u8]; 3], yuv: [&mut [u8]; 3]) {
    let ([red, green, blue], [y, cb, cr]) = (rgb, yuv);
    let (n, step) = (red.len(), S::u8s::LEN);
    let mut x = 0;
    while x < n {
        let m = step.min(n - x);
        let rgb = [load(simd, &red[x..x + m]), load(simd, &green[x..x + m]), load(simd, &blue[x..x + m])];
        let out = yuv_vector(simd, rgb);
        for (to, from) in [&mut *y, &mut *cb, &mut *cr].into_iter().zip(out) {
            to[x..x + m].copy_from_slice(&from.as_slice()[..m]);
        }
        x += m;
    }
}

/// A vector of these bytes, zeros behind them.
#[inline(always)]
fn load<S: Simd>(simd: S, bytes: &[u8]) -> S::u8s {
    if bytes.len() == S::u8s::LEN {
        return S::u8s::from_slice(simd, bytes);
    }
    let mut vector = S::u8s::splat(simd, 0);
    vector.as_mut_slice()[..bytes.len()].copy_from_slice(bytes);
    vector
}

#[inline(always)]
fn yuv_vector<S: Simd>(simd: S, [r, g, b]: [S::u8s; 3]) -> [S::u8s; 3] {
    let ((r0, r1), (g0, g1), (b0, b1)) = (r.widen(), g.widen(), b.widen());
    let (low, high) = (half_vector(simd, [r0, g0, b0]), half_vector(simd, [r1, g1, b1]));
    [low[0].relaxed_narrow(high[0]), low[1].relaxed_narrow(high[1]), low[2].relaxed_narrow(high[2])]
}

#[inline(always)]
fn half_vector<S: Simd>(simd: S, [r, g, b]: [S::u16s; 3]) -> [S::u16s; 3] {
    let ((r0, r1), (g0, g1), (b0, b1)) = (r.widen(), g.widen(), b.widen());
    let (low, high) = (quarter_vector(simd, [r0, g0, b0]), quarter_vector(simd, [r1, g1, b1]));
    [low[0].relaxed_narrow(high[0]), low[1].relaxed_narrow(high[1]), low[2].relaxed_narrow(high[2])]
}

/// Y = (299R + 587G + 114B)/1000, Cb = (B - Y)/1.772 + 128, Cr = (R - Y)/1.402 + 128, each plus a half.
#[inline(always)]
fn quarter_vector<S: Simd>(simd: S, [r, g, b]: [S::u32s; 3]) -> [S::u32s; 3] {
    let r = S::f32s::float_from(r.bitcast::<S::i32s>());
    let g = S::f32s::float_from(g.bitcast::<S::i32s>()) * 587.0;
    let b = S::f32s::float_from(b.bitcast::<S::i32s>());
    [
        to_level(simd, (r * 299.0 + g + b * 114.0 + 500.0) * PER_THOUSAND),
        to_level(simd, (b * 886.0 - r * 299.0 - g + 227_702.0) * PER_1772),
        to_level(simd, (r * 701.0 - b * 114.0 - g + 180_157.0) * PER_1402),
    ]
}
