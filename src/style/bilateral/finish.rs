//! The last pass: the largest level up to full size, black on the edges, bytes. One loop over output rows.

use crate::kernel::canny::Canny;
use crate::kernel::{band_rows, pyramid};
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, Rgb};
use fearless_simd::{Bytes, Simd, SimdBase, f32x8, u8x16, u16x16};
use rayon::prelude::*;

/// Scratch rows of the pass.
#[derive(Debug, Default)]
pub struct Finish {
    scratch: Vec<Scratch>,
}

/// What one band works in: a blended row of the level below, a row of inverted edges.
#[derive(Debug, Default)]
struct Scratch {
    narrow: Vec<f32>,
    paper: Vec<u8>,
}

impl Finish {
    /// Draws into `out`, whose half `half` is and whose edges `canny` holds. Allocates only when a size or the
    /// thread count changes.
    pub fn draw(&mut self, level: Level, half: &[Plane<f32>; 3], canny: &Canny, out: &mut Rgb) {
        let size = out.size();
        let band = band_rows(size.height, 8);
        let bands = size.height.div_ceil(band);
        if self.scratch.len() < bands {
            self.scratch.resize_with(bands, Scratch::default);
        }
        for scratch in &mut self.scratch[..bands] {
            scratch.narrow.resize(pyramid::narrow_length(half[0].size().width), 0.0);
            scratch.paper.resize(size.width, 0);
        }
        let [r, g, b] = &mut out.planes;
        let bands = r.view_mut().par_bands(band).zip(g.view_mut().par_bands(band));
        let bands = bands.zip(b.view_mut().par_bands(band)).zip(&mut self.scratch);
        bands.for_each(|((((first, mut r), (_, mut g)), (_, mut b)), scratch)| {
            for y in 0..r.size().height {
                let out = [r.row_mut(y), g.row_mut(y), b.row_mut(y)];
                dispatch!(level, simd => row(simd, half, canny, first + y, scratch, out));
            }
        });
    }
}

#[inline(always)]
fn row<S: Simd>(
    simd: S,
    half: &[Plane<f32>; 3],
    canny: &Canny,
    y: usize,
    scratch: &mut Scratch,
    out: [&mut [u8]; 3],
) {
    let Scratch { narrow, paper } = scratch;
    canny.inverted_row(y, paper);
    let [above, here, below] = pyramid::taps(y, half[0].size().height);
    for (plane, out) in half.iter().zip(out) {
        pyramid::blend([plane.row(above), plane.row(here), plane.row(below)], y, narrow);
        for (block, (out, paper)) in out.chunks_mut(16).zip(paper.chunks(16)).enumerate() {
            let bytes = bytes_of(simd, pyramid::sixteen(simd, narrow, 8 * block));
            if out.len() == 16 {
                (bytes & u8x16::from_slice(simd, paper)).store_slice(out);
            } else {
                for (i, (out, &paper)) in out.iter_mut().zip(paper).enumerate() {
                    *out = bytes.as_slice()[i] & paper;
                }
            }
        }
    }
}

/// floor(255·v + .5) of values in 0..1, as bytes.
#[inline(always)]
fn bytes_of<S: Simd>(simd: S, color: [f32x8<S>; 2]) -> u8x16<S> {
    let low = simd.cvt_i32_f32x8(color[0] * 255.0 + 0.5);
    let high = simd.cvt_i32_f32x8(color[1] * 255.0 + 0.5);
    let words: u16x16<S> = simd.saturating_narrow_i32x8(low, high).bitcast();
    let (low, high) = simd.split_u16x16(words);
    simd.saturating_narrow_u16x8(low, high)
}
