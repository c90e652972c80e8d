//! The simplified picture on the shrunk grid, ready to be enlarged: colors and weighted gradients.
//!
//! Eq. 4 wants, at every output pixel, Sobel taps one *shrunk* pixel apart in the bilinearly enlarged S. Both being
//! linear, that is the enlarged Sobel of the grid, where the grid is grown by one pixel on every side (its samples
//! clamped). So nine planes are kept a grown row at a time: R, G, B in 0..255, and gx, gy of Y, U, V, each already
//! times its weight in eq. 4, so that the response is the plain sum of three magnitudes.
#![allow(clippy::needless_range_loop)] // lanes and channels index several arrays in step

use crate::kernel::{color, enlarge, sobel};
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, Size};
use fearless_simd::Simd;
use rayon::prelude::*;

/// Planes in a row of the grid.
pub const PLANES: usize = 9;

/// The grown grid: rows 0 and height+1 are the clamped ones.
#[derive(Debug, Default)]
pub struct Grid {
    size: Size0,
    gain: f32,
    column_stride: usize,
    /// Y, U·gain, V·gain with two edge samples repeated on either side.
    padded: [Plane<f32>; 3],
    /// Nine planes a row, `column_stride` samples each.
    rows: Plane<f32>,
    /// Edge response at the grid's own points: no response between them is larger than at their four corners.
    response: Plane<f32>,
}

type Size0 = Option<Size>;

impl Grid {
    /// Builds the grid from Y, U·gain, V·gain planes of at least 1x1. Allocates only when the size changes.
    pub fn build(&mut self, level: Level, simple: &[Plane<f32>; 3], gain: f32, alpha: f32) {
        let size = simple[0].size();
        let stride = (size.width + 2 + enlarge::SLACK).next_multiple_of(16);
        self.size = Some(size);
        self.gain = gain;
        self.column_stride = stride;
        self.rows.resize(Size::new(stride * PLANES, size.height + 2), 0.0);
        self.response.resize(Size::new(stride, size.height + 2), 0.0);
        for (padded, plane) in self.padded.iter_mut().zip(simple) {
            padded.resize(Size::new(size.width + 4, size.height), 0.0);
            for y in 0..size.height {
                let (to, from) = (padded.row_mut(y), plane.row(y));
                to[..2].fill(from[0]);
                to[2..size.width + 2].copy_from_slice(from);
                to[size.width + 2..].fill(from[size.width - 1]);
            }
        }
        let weights = [(1.0 - alpha) * 0.25, alpha * 0.125 / gain, alpha * 0.125 / gain];
        let padded = &self.padded;
        let bands = self.rows.view_mut().par_bands(24).zip(self.response.view_mut().par_bands(24));
        bands.for_each(|((first, mut rows), (_, mut response))| {
            for y in 0..rows.size().height {
                let at = |d: usize| (first + y + d).saturating_sub(2).min(size.height - 1);
                let (row, response) = (rows.row_mut(y), response.row_mut(y));
                let lines = [at(0), at(1), at(2)];
                dispatch!(level, simd => grow(simd, padded, lines, gain, weights, row, response));
            }
        });
    }

    /// Columns and rows of the grid before growing.
    pub fn size(&self) -> Size {
        self.size.unwrap_or(Size::new(0, 0))
    }

    /// Samples a plane takes in a row.
    pub fn column_stride(&self) -> usize {
        self.column_stride
    }

    /// The nine planes of grown row `y`.
    pub fn row(&self, y: usize) -> &[f32] {
        self.rows.row(y)
    }

    /// The responses of grown row `y`.
    pub fn response(&self, y: usize) -> &[f32] {
        self.response.row(y)
    }

    /// The simplified picture itself, R, G, B in 0..1.
    pub fn simplified(&self) -> [Plane<f32>; 3] {
        [0, 1, 2].map(|c| {
            Plane::from_fn(self.size(), |x, y| self.row(y + 1)[c * self.column_stride + x + 1] / 255.0)
        })
    }
}

/// Fills one grown row from the padded rows above, at and below it.
#[inline(always)]
fn grow<S: Simd>(
    _simd: S,
    padded: &[Plane<f32>; 3],
    lines: [usize; 3],
    gain: f32,
    weights: [f32; 3],
    row: &mut [f32],
    response: &mut [f32],
) {
    let stride = response.len();
    let grown = padded[0].size().width - 2;
    let (colors, gradients) = row.split_at_mut(3 * stride);
    let (red, rest) = colors.split_at_mut(stride);
    let (green, blue) = rest.split_at_mut(stride);
    let (red, green, blue) = (&mut red[..grown], &mut green[..grown], &mut blue[..grown]);
    let y = &padded[0].row(lines[1])[1..][..grown];
    let u = &padded[1].row(lines[1])[1..][..grown];
    let v = &padded[2].row(lines[1])[1..][..grown];
    let ungain = 1.0 / gain;
    for x in 0..grown {
        let rgb = color::rgb_of([y[x], u[x] * ungain, v[x] * ungain]);
        (red[x], green[x], blue[x]) = (rgb[0] * 255.0, rgb[1] * 255.0, rgb[2] * 255.0);
    }
    let response = &mut response[..grown];
    response.fill(0.0);
    for c in 0..3 {
        let rows = [padded[c].row(lines[0]), padded[c].row(lines[1]), padded[c].row(lines[2])];
        let (gx, gy) = gradients[2 * c * stride..][..2 * stride].split_at_mut(stride);
        let (gx, gy) = (&mut gx[..grown], &mut gy[..grown]);
        sobel::gradient_row_f32(rows, weights[c], gx, gy);
        for x in 0..grown {
            response[x] += (gx[x] * gx[x] + gy[x] * gy[x]).sqrt();
        }
    }
}
