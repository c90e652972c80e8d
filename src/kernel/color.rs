//! Color spaces: planar RGB to analog BT.601 YUV and back, on f32 planes.
//!
//! Y = .299R + .587G + .114B, U = (.436/.886)(B-Y), V = (.615/.701)(R-Y) with R, G, B in 0..1, so that
//! Y is in 0..1, U in ±.436, V in ±.615. The row bodies are plain loops: they vectorize at every level.

use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, Rgb};
use fearless_simd::Simd;
use rayon::prelude::*;

/// Weights of R, G, B in Y.
pub const LUMA: [f32; 3] = [0.299, 0.587, 0.114];
/// U per unit of B - Y.
pub const U_OF_B: f32 = (0.436 / 0.886) as f32;
/// V per unit of R - Y.
pub const V_OF_R: f32 = (0.615 / 0.701) as f32;

/// Converts an 8-bit picture to Y, U, V planes (fitted to its size).
pub fn rgb_to_yuv(level: Level, picture: &Rgb, yuv: &mut [Plane<f32>; 3]) {
    let size = picture.size();
    yuv.iter_mut().for_each(|plane| plane.resize(size, 0.0));
    let rows = super::band_rows(size.height, 8);
    let [y, u, v] = yuv;
    let bands = y.view_mut().par_bands(rows).zip(u.view_mut().par_bands(rows));
    bands.zip(v.view_mut().par_bands(rows)).for_each(|(((first, mut y), (_, mut u)), (_, mut v))| {
        for row in 0..y.size().height {
            let rgb = [0, 1, 2].map(|c| picture.planes[c].row(first + row));
            let (y, u, v) = (y.row_mut(row), u.row_mut(row), v.row_mut(row));
            dispatch!(level, simd => bytes_row(simd, rgb, y, u, v));
        }
    });
}

#[inline(always)]
fn bytes_row<S: Simd>(_simd: S, [r, g, b]: [&[u8]; 3], y: &mut [f32], u: &mut [f32], v: &mut [f32]) {
    let n = y.len();
    let (r, g, b, u, v) = (&r[..n], &g[..n], &b[..n], &mut u[..n], &mut v[..n]);
    for i in 0..n {
        let [r, g, b] = [r[i], g[i], b[i]].map(|value| f32::from(value) * (1.0 / 255.0));
        [y[i], u[i], v[i]] = yuv_of([r, g, b]);
    }
}

/// One color, RGB in 0..1 to YUV.
#[inline(always)]
pub fn yuv_of([r, g, b]: [f32; 3]) -> [f32; 3] {
    let y = LUMA[0] * r + LUMA[1] * g + LUMA[2] * b;
    [y, U_OF_B * (b - y), V_OF_R * (r - y)]
}

/// One color, YUV to RGB in 0..1 (not clamped).
#[inline(always)]
pub fn rgb_of([y, u, v]: [f32; 3]) -> [f32; 3] {
    let r = y + v * (1.0 / V_OF_R);
    let b = y + u * (1.0 / U_OF_B);
    let g = y - u * (LUMA[2] / (LUMA[1] * U_OF_B)) - v * (LUMA[0] / (LUMA[1] * V_OF_R));
    [r, g, b]
}

/// The same conversion in f64, one color of bytes.
pub fn reference([r, g, b]: [u8; 3]) -> [f64; 3] {
    yuv_reference([r, g, b].map(|value| f64::from(value) / 255.0))
}

/// RGB 0..1 to analogue YUV in f64.
pub fn yuv_reference([r, g, b]: [f64; 3]) -> [f64; 3] {
    let y = 0.299 * r + 0.587 * g + 0.114 * b;
    [y, 0.436 / 0.886 * (b - y), 0.615 / 0.701 * (r - y)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::sweep;

    /// Rounding of three f32 products and sums of values up to 1.
    const BOUND: f64 = 4e-7;

    #[test]
    fn every_picture_matches_the_reference() {
        for case in sweep::cases() {
            let mut picture = Rgb { planes: [case.plane.clone(), case.plane.clone(), case.plane] };
            for value in picture.planes[1].samples_mut() {
                *value = value.wrapping_mul(7);
            }
            for value in picture.planes[2].samples_mut() {
                *value = 255 - *value;
            }
            let yuv = sweep::everywhere(&case.label, |level| {
                let mut yuv = Default::default();
                rgb_to_yuv(level, &picture, &mut yuv);
                yuv
            });
            let size = picture.size();
            for (x, y) in (0..size.height).flat_map(|y| (0..size.width).map(move |x| (x, y))) {
                let truth = reference(picture.at(x, y));
                for c in 0..3 {
                    let error = (f64::from(yuv[c].at(x, y)) - truth[c]).abs();
                    assert!(error <= BOUND, "{}: ({x}, {y}) channel {c}: {error:e}", case.label);
                }
            }
        }
    }

    #[test]
    fn the_way_back_returns_the_color() {
        for color in [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [1.0, 0.0, 0.0], [0.2, 0.7, 0.4], [0.0, 0.0, 1.0]] {
            let back = rgb_of(yuv_of(color));
            for c in 0..3 {
                assert!((back[c] - color[c]).abs() < 1e-6, "{color:?} came back as {back:?}");
            }
        }
    }
}
