//! Edge response of an 8-bit picture: weighted gradient magnitudes of Y, U, V and of R, G, B, sixteen pixels at a
//! time.
//!
//! Gradients of R, G, B are exact integers ([`super::sobel`]); being linear, those of Y, U, V follow from them. Where
//! only a threshold counts, [`Weights::quiet`] gives an integer bound below which no response can reach it.
#![allow(clippy::needless_range_loop)] // lanes and channels index several arrays in step

use super::{color, sobel};
use crate::pixels::Rgb;
use fearless_simd::{Simd, SimdBase, SimdFloat, f32x8, i16x16};

/// Pixels a block.
pub const BLOCK: usize = 16;
/// Gradients of bytes are 4·255 times those of 0..1.
const UNIT: f32 = 1.0 / (4.0 * 255.0);

/// How much each channel's gradient magnitude counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weights {
    /// Of Y, U, V, colors in 0..1.
    pub yuv: [f32; 3],
    /// Of each of R, G, B, colors in 0..1.
    pub rgb: f32,
}

impl Weights {
    /// A block whose |gx| + |gy| of bytes (times 4) is at most this in every channel stays below `threshold`.
    pub fn quiet(self, threshold: f32) -> i16 {
        if threshold <= 0.0 {
            return -1;
        }
        // |∇(B-Y)| <= (.886 + .299 + .587)·g and |∇(R-Y)| <= (.701 + .587 + .114)·g, g the largest of R, G, B
        let [y, u, v] = self.yuv;
        let reach = y + u * color::U_OF_B * 1.772 + v * color::V_OF_R * 1.402 + 3.0 * self.rgb;
        (threshold * (1.0 - 1e-5) / (reach * UNIT).max(1e-9)).min(f32::from(i16::MAX)) as i16
    }
}

/// The largest |gx| + |gy| of the three channels.
#[inline(always)]
pub fn largest<S: Simd>(simd: S, gradients: &[[i16x16<S>; 2]; 3]) -> i16x16<S> {
    let mut largest = i16x16::splat(simd, 0);
    for [gx, gy] in gradients {
        largest = simd.max_i16x16(largest, simd.abs_i16x16(*gx) + simd.abs_i16x16(*gy));
    }
    largest
}

/// The responses of sixteen pixels from their gradients of R, G, B bytes.
#[inline(always)]
pub fn response<S: Simd>(simd: S, gradients: &[[i16x16<S>; 2]; 3], weights: Weights) -> [f32x8<S>; 2] {
    let zero = f32x8::splat(simd, 0.0);
    let of = [
        weights.yuv[0] * UNIT,
        weights.yuv[1] * (color::U_OF_B * UNIT),
        weights.yuv[2] * (color::V_OF_R * UNIT),
        weights.rgb * UNIT,
    ];
    // [direction][channel][half]
    let mut wide = [[[zero; 2]; 3]; 2];
    for c in 0..3 {
        for direction in 0..2 {
            let (low, high) = simd.widen_i16x16(gradients[c][direction]);
            wide[direction][c] = [simd.cvt_f32_i32x8(low), simd.cvt_f32_i32x8(high)];
        }
    }
    let mut response = [zero; 2];
    for half in 0..2 {
        let (mut yuv, mut rgb) = ([zero; 3], [zero; 3]);
        for direction in &wide {
            let [r, g, b] = [direction[0][half], direction[1][half], direction[2][half]];
            let luma = r * color::LUMA[0] + g * color::LUMA[1] + b * color::LUMA[2];
            let (u, v) = (b - luma, r - luma);
            yuv[0] += luma * luma;
            yuv[1] += u * u;
            yuv[2] += v * v;
            rgb[0] += r * r;
            rgb[1] += g * g;
            rgb[2] += b * b;
        }
        for c in 0..3 {
            response[half] += yuv[c].sqrt() * of[c];
        }
        if weights.rgb > 0.0 {
            response[half] += (rgb[0].sqrt() + rgb[1].sqrt() + rgb[2].sqrt()) * of[3];
        }
    }
    response
}

/// The response at (`x`, `y`) in f64.
pub fn reference(picture: &Rgb, x: usize, y: usize, yuv: [f64; 3], rgb: f64) -> f64 {
    let size = picture.size();
    let magnitude = |channel: &dyn Fn([f64; 3]) -> f64| {
        let at = |x, y| channel(picture.at(x, y).map(|v| f64::from(v) / 255.0));
        let [gx, gy] = sobel::reference(size.width, size.height, x, y, at);
        libm::hypot(gx, gy)
    };
    let mut sum = 0.0;
    for c in 0..3 {
        sum +=
            yuv[c] * magnitude(&|color| color::yuv_reference(color)[c]) + rgb * magnitude(&|color| color[c]);
    }
    sum
}
