//! Ideal pixels: where the picture's points would lie without distortion.
//!
//! Straight edges are straight only there, so quadrilaterals and homographies live in ideal pixels, and gray
//! values are fetched through the lens model. Contours have thousands of points: for them the inverse is
//! tabled on a grid of 8 px and interpolated, good to about .02 px.

use crate::geometry::Lens;
use crate::pixels::Size;
use fearless_simd::{Simd, SimdFrom, f32x8, prelude::*};
use glam::DVec2;

const STEP: usize = 8;

/// The map between pixels and ideal pixels of one lens, with its table.
#[derive(Debug, Default)]
pub struct Rectify {
    lens: Option<Lens>,
    size: Option<Size>,
    /// Offsets ideal - seen at the grid's nodes; empty without distortion. NaN past a fold of the lens.
    table: Vec<[f32; 2]>,
    columns: usize,
}

impl Rectify {
    /// Prepares for pictures of `size` through `lens`; recomputes only when one of them changed.
    pub fn prepare(&mut self, lens: &Lens, size: Size) {
        if self.lens == Some(*lens) && self.size == Some(size) {
            return;
        }
        (self.lens, self.size) = (Some(*lens), Some(size));
        self.table.clear();
        if !lens.is_distorted() {
            return;
        }
        self.columns = size.width / STEP + 2;
        for row in 0..size.height / STEP + 2 {
            for column in 0..self.columns {
                let seen = DVec2::new((column * STEP) as f64, (row * STEP) as f64);
                let ideal = lens.undistort(seen).map_or(DVec2::NAN, |p| lens.to_pixel(p));
                let offset = (ideal - seen).as_vec2();
                self.table.push([offset.x, offset.y]);
            }
        }
    }

    /// Whether seen and ideal places differ.
    pub fn bends(&self) -> bool {
        !self.table.is_empty()
    }

    /// The ideal place of a seen point inside the picture; NaN where the lens shows nothing there.
    #[inline]
    pub fn ideal(&self, seen: DVec2) -> DVec2 {
        if self.table.is_empty() {
            return seen;
        }
        let grid = seen / STEP as f64;
        let (column, row) = (grid.x.max(0.0) as usize, grid.y.max(0.0) as usize);
        let at = row * self.columns + column;
        let corner =
            |i: usize| self.table.get(i).map_or(DVec2::NAN, |o| DVec2::new(o[0].into(), o[1].into()));
        let (s, t) = (grid.x - column as f64, grid.y - row as f64);
        let top = corner(at) * (1.0 - s) + corner(at + 1) * s;
        let bottom = corner(at + self.columns) * (1.0 - s) + corner(at + self.columns + 1) * s;
        seen + top * (1.0 - t) + bottom * t
    }
}

impl Rectify {
    /// Ideal places of the pixels `x..x + 8` of row `y`, by quadratics through the table's nodes (8 px apart).
    #[inline(always)]
    pub fn run<S: Simd>(&self, simd: S, x: usize, y: usize) -> (f32x8<S>, f32x8<S>) {
        let ramp = f32x8::simd_from(simd, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
        let across = ramp + x as f32;
        let down = f32x8::splat(simd, y as f32);
        if self.table.is_empty() {
            return (across, down);
        }
        // the node in the middle of the 3x3 used
        let (column, row) = ((x + 4 + STEP / 2) / STEP, (y + STEP / 2) / STEP);
        let column = column.clamp(1, self.columns.max(3) - 2);
        let row = row.clamp(1, (self.table.len() / self.columns.max(1)).max(3) - 2);
        let weights = |t: f32| [0.5 * t * (t - 1.0), 1.0 - t * t, 0.5 * t * (t + 1.0)];
        let down_weights = weights((y as f32 - (row * STEP) as f32) / STEP as f32);
        let mut nodes = [[0.0f32; 2]; 3];
        for (i, node) in nodes.iter_mut().enumerate() {
            for (j, weight) in down_weights.into_iter().enumerate() {
                let at = (row + j - 1) * self.columns + column + i - 1;
                let offset = self.table.get(at).copied().unwrap_or([f32::NAN; 2]);
                node[0] += weight * offset[0];
                node[1] += weight * offset[1];
            }
        }
        let t = (across - (column * STEP) as f32) * (1.0 / STEP as f32);
        let (first, middle, last) = ((t * t - t) * 0.5, t * t * -1.0 + 1.0, (t * t + t) * 0.5);
        let x = first * nodes[0][0] + middle * nodes[1][0] + last * nodes[2][0];
        let y = first * nodes[0][1] + middle * nodes[1][1] + last * nodes[2][1];
        (across + x, down + y)
    }
}

/// The picture place that shows an ideal point.
#[inline]
pub fn seen(lens: &Lens, ideal: DVec2) -> DVec2 {
    if !lens.is_distorted() {
        return ideal;
    }
    lens.to_pixel(lens.distort((ideal - lens.center) / lens.focal))
}
