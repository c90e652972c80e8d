//! Edge functions and slopes of triangles over a part of a tile.
//!
//! Edges are exact integers of the snapped corners; slopes are f64 of the unsnapped ones.

use super::tile::STRIDE;
use super::vertex::{Spot, narrow};
use crate::pixels::TILE;
use fearless_simd::{Simd, SimdBase, SimdFrom, f32x4, f64x4, i32x4, prelude::*};

/// Twice the area, px², below which a triangle counts as without any before snapping.
const LEAST_AREA: f64 = 1e-200;

/// The pixels of a tile that a triangle may cover, picture coordinates, inclusive.
#[derive(Clone, Copy)]
pub(super) struct Area {
    pub first: i32,
    pub top: i32,
    pub last: i32,
    pub bottom: i32,
}

/// The three edge functions over an area, divided by 256 with the sign kept exact: a pixel center is a whole
/// number of steps away, so only the constant has a fraction, and rounding it down changes no sign. `T` holds every
/// value in the area.
#[derive(Clone, Copy, Default)]
pub(super) struct Edges<T> {
    pub start: [T; 3],
    pub right: [T; 3],
    pub down: [T; 3],
}

impl Edges<i32> {
    /// Of a triangle less than 64 px across: an edge a lane.
    #[inline(always)]
    pub fn small<S: Simd>(simd: S, area: &Area, [a, b, c]: [Spot; 3]) -> Self {
        let of = |v: [i32; 4]| i32x4::simd_from(simd, v);
        let (x, y) = (of([a[0], b[0], c[0], 0]), of([a[1], b[1], c[1], 0]));
        let (next_x, next_y) = (of([b[0], c[0], a[0], 0]), of([b[1], c[1], a[1], 0]));
        let (right, down) = (y - next_y, next_x - x);
        let (left, top) = (i32x4::splat(simd, area.first * 256), i32x4::splat(simd, area.top * 256));
        let (zero, one) = (i32x4::splat(simd, 0), i32x4::splat(simd, 1));
        // right above 0, or 0 and down above 0: by their sign, since small
        let owned = (right + right + down.simd_gt(zero).select(one, zero)).simd_gt(zero);
        let value = right * (left - x) + down * (top - y);
        let start = (value - owned.select(zero, one)) >> 8;
        let three = |v: i32x4<S>| [v[0], v[1], v[2]];
        Edges { start: three(start), right: three(right), down: three(down) }
    }
}

/// Whether pixel centers on an edge are inside, by its steps to the right and down. Top: to the right along the
/// row; left: upwards (y down, inside on the right hand).
#[inline(always)]
fn owned<T: PartialOrd + Default>(right: T, down: T) -> bool {
    right > T::default() || (right == T::default() && down > T::default())
}

impl Edges<i64> {
    /// Of any triangle; `None` when some edge leaves the whole area outside.
    pub fn new(area: &Area, spots: [Spot; 3]) -> Option<Self> {
        // the last run may reach further
        let columns = i64::from(area.last - area.first) + STRIDE as i64 - TILE as i64;
        let rows = i64::from(area.bottom - area.top);
        let (x, y) = (i64::from(area.first) * 256, i64::from(area.top) * 256);
        let mut edges = Edges::default();
        for k in 0..3 {
            let [[x0, y0], [x1, y1]] = [spots[k], spots[(k + 1) % 3]].map(|spot| spot.map(i64::from));
            let (right, down) = (y0 - y1, x1 - x0);
            let start = (right * (x - x0) + down * (y - y0) - i64::from(!owned(right, down))) >> 8;
            let (across, along) = (right * columns, down * rows);
            if start + across.max(0) + along.max(0) < 0 {
                return None;
            }
            // inside everywhere: stays 0
            if start + across.min(0) + along.min(0) < 0 {
                (edges.start[k], edges.right[k], edges.down[k]) = (start, right, down);
            }
        }
        Some(edges)
    }

    /// The same in 32 bits, where every value in the area fits.
    pub fn narrow(&self, area: &Area) -> Option<Edges<i32>> {
        let columns = i64::from(area.last - area.first) + STRIDE as i64 - TILE as i64;
        let rows = i64::from(area.bottom - area.top) + 1;
        // an edge that changes sign in the area starts within its own change
        let change = |k: usize| self.right[k].abs() * columns + self.down[k].abs() * rows;
        let fits = (0..3).all(|k| change(k) < i64::from(i32::MAX));
        let cut = |v: [i64; 3]| v.map(|v| v as i32);
        fits.then(|| Edges { start: cut(self.start), right: cut(self.right), down: cut(self.down) })
    }

    /// Coverage of a run, a bit a pixel.
    #[inline(never)]
    pub fn inside(&self, x: i32, y: i32, count: usize) -> u64 {
        let value = |k: usize, lane: usize| {
            self.start[k] + self.right[k] * (i64::from(x) + lane as i64) + self.down[k] * i64::from(y)
        };
        let inside = |lane: usize| value(0, lane) | value(1, lane) | value(2, lane);
        (0..count).fold(0, |bits, lane| bits | u64::from(inside(lane) >= 0) << lane)
    }
}

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
