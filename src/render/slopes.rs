//! Slopes of triangles over a part of a tile: f64, of the unsnapped corners.

use super::vertex::narrow;
use fearless_simd::{Simd, SimdBase, f32x4, f64x4, prelude::*};

/// Twice the area, px², below which a triangle counts as without any before snapping.
const LEAST_AREA: f64 = 1e-200;

/// Linear in x and y over an area: value at its first pixel center and steps.
#[derive(Clone, Copy, Default)]
pub(super) struct Slope {
    pub origin: f64,
    pub right: f64,
    pub down: f64,
}

impl Slope {
    #[inline(always)]
    pub fn at(&self, y: f64) -> f32 {
        (self.origin + self.down * y) as f32
    }
}

/// Four slopes side by side: of four triangles, or of four values of one.
#[derive(Clone, Copy)]
pub(super) struct Slopes<S: Simd> {
    pub origin: f64x4<S>,
    pub right: f64x4<S>,
    pub down: f64x4<S>,
}

impl<S: Simd> Slopes<S> {
    #[inline(always)]
    pub fn zero(simd: S) -> Self {
        let zero = f64x4::splat(simd, 0.0);
        Self { origin: zero, right: zero, down: zero }
    }

    /// The values at the first pixel of row `y`.
    #[inline(always)]
    pub fn at(&self, simd: S, y: f64) -> f32x4<S> {
        narrow(simd, self.origin + self.down * f64x4::splat(simd, y))
    }

    /// To memory, to be had one by one.
    #[inline(always)]
    pub fn apart(&self) -> SlopesApart {
        let (mut origin, mut right, mut down) = ([0.0; 4], [0.0; 4], [0.0; 4]);
        self.origin.store_slice(&mut origin);
        self.right.store_slice(&mut right);
        self.down.store_slice(&mut down);
        SlopesApart { origin, right, down }
    }
}

/// Four slopes in memory.
#[derive(Clone, Copy, Default)]
pub(super) struct SlopesApart {
    origin: [f64; 4],
    right: [f64; 4],
    down: [f64; 4],
}

impl SlopesApart {
    #[inline(always)]
    pub fn one(&self, k: usize) -> Slope {
        Slope { origin: self.origin[k % 4], right: self.right[k % 4], down: self.down[k % 4] }
    }

    /// One of them, four times.
    #[inline(always)]
    pub fn all<S: Simd>(&self, simd: S, k: usize) -> Slopes<S> {
        let Slope { origin, right, down } = self.one(k);
        let (origin, right) = (f64x4::splat(simd, origin), f64x4::splat(simd, right));
        Slopes { origin, right, down: f64x4::splat(simd, down) }
    }
}

/// The unsnapped triangles' barycentric weights of corners 1 and 2.
#[derive(Clone, Copy)]
pub(super) struct Weights<S: Simd>(pub [Slopes<S>; 2]);

impl<S: Simd> Weights<S> {
    /// Over areas that begin at these pixels, of triangles with these corners: x, then y.
    #[inline(always)]
    pub fn new(simd: S, [left, top]: [f64x4<S>; 2], x: [f64x4<S>; 3], y: [f64x4<S>; 3]) -> Self {
        let of = |v: f64| f64x4::splat(simd, v);
        let (abx, aby, acx, acy) = (x[1] - x[0], y[1] - y[0], x[2] - x[0], y[2] - y[0]);
        let doubled = abx * acy - acx * aby;
        // no area before snapping: the middle of the triangle stands for all of it
        let none = doubled.abs().simd_lt(of(LEAST_AREA));
        let inverse = none.select(of(0.0), of(1.0) / doubled);
        let (ox, oy) = (left - x[0], top - y[0]);
        let (right1, down1) = (acy * inverse, -acx * inverse);
        let (right2, down2) = (-aby * inverse, abx * inverse);
        let origin1 = none.select(of(1.0 / 3.0), ox * right1 + oy * down1);
        let origin2 = none.select(of(1.0 / 3.0), ox * right2 + oy * down2);
        let l1 = Slopes { origin: origin1, right: right1, down: down1 };
        Weights([l1, Slopes { origin: origin2, right: right2, down: down2 }])
    }

    /// The slopes of values with these corners.
    #[inline(always)]
    pub fn slopes(&self, [p, q, r]: [f64x4<S>; 3]) -> Slopes<S> {
        let Weights([l1, l2]) = self;
        let (d1, d2) = (q - p, r - p);
        Slopes {
            origin: p + l1.origin * d1 + l2.origin * d2,
            right: l1.right * d1 + l2.right * d2,
            down: l1.down * d1 + l2.down * d2,
        }
    }

    /// How fast the weights change along a row, and along a column.
    #[inline(always)]
    pub fn steepness(&self) -> (f64x4<S>, f64x4<S>) {
        let Weights([l1, l2]) = self;
        (l1.right.abs() + l2.right.abs(), l1.down.abs() + l2.down.abs())
    }
}
