//! The pixels that triangles cover in each row of an area: a first one and how many. Exactly those whose centers are
//! inside the snapped corners by the fill rule.
//!
//! An edge function at a row's first center, divided by 256, is whole but for a fraction that changes no sign and is
//! rounded down; half a step is added, so that it is never 0 and the edge crosses the row between two centers, never on
//! one. Of small triangles all this fits in f32: the crossing is off by less than a quarter of its distance to the
//! nearest center.

use super::vertex::{SUBPIXELS, Spot, narrow};
use fearless_simd::{Simd, SimdBase, f32x4, f64x4, i32x4, mask32x4, prelude::*};

/// The pixels of a tile that a triangle may cover, picture coordinates, inclusive.
#[derive(Clone, Copy)]
pub(super) struct Area {
    pub first: i32,
    pub top: i32,
    pub last: i32,
    pub bottom: i32,
}

/// A row of each of four triangles.
#[derive(Clone, Copy, Default)]
pub(super) struct Row {
    /// Covered pixels: the first one, from the area's first column on, and how many; below 1 there are none.
    pub first: [i32; 4],
    pub count: [i32; 4],
    /// 1/z and light at the area's first column.
    pub w: [f32; 4],
    pub light: [f32; 4],
}

/// The corners of four triangles, in whole 1/256 px from the first center of each one's area.
pub(super) struct Corners<S: Simd>([[i32x4<S>; 2]; 3]);

/// One edge of four triangles.
struct Edge<S: Simd> {
    /// Its function at the first center of a row, plus 1/2, and the step to the next row.
    here: f32x4<S>,
    down: f32x4<S>,
    /// Turns that into where it crosses the row.
    across: f32x4<S>,
    /// Whether pixels are to the right of it.
    left: mask32x4<S>,
}

impl<S: Simd> Corners<S> {
    /// Snaps corners, px: x, then y.
    #[inline(always)]
    pub fn new(simd: S, [left, top]: [f64x4<S>; 2], x: [f64x4<S>; 3], y: [f64x4<S>; 3]) -> Self {
        Self([
            [snapped(simd, x[0], left), snapped(simd, y[0], top)],
            [snapped(simd, x[1], left), snapped(simd, y[1], top)],
            [snapped(simd, x[2], left), snapped(simd, y[2], top)],
        ])
    }

    #[inline(always)]
    fn edge(&self, simd: S, k: usize) -> Edge<S> {
        let (zero, one) = (i32x4::splat(simd, 0), i32x4::splat(simd, 1));
        let Self(corners) = self;
        let ([x, y], [next_x, next_y]) = (corners[k], corners[(k + 1) % 3]);
        let (right, down) = (y - next_y, next_x - x);
        let left = right.simd_gt(zero);
        // centers on it are inside: of top edges, to the right along the row, and of left ones, upwards
        let owned = left | (right.simd_eq(zero) & down.simd_gt(zero));
        let start = (zero - right * x - down * y - owned.select(zero, one)) >> 8;
        let (start, down, back): (f32x4<S>, f32x4<S>, f32x4<S>) =
            (start.to_float(), down.to_float(), (zero - right).to_float());
        // along the row: infinite, with the sign of its function, and never a left edge
        Edge { here: start + 0.5, down, across: f32x4::splat(simd, 1.0) / back, left }
    }

    /// Finds the covered pixels of the rows; of small triangles only.
    #[inline(always)]
    pub fn fill(&self, simd: S, columns: i32x4<S>, rows: &mut [Row]) {
        let (mut p, mut q, mut r) = (self.edge(simd, 0), self.edge(simd, 1), self.edge(simd, 2));
        let before = f32x4::splat(simd, -0.5);
        let after = columns.to_float::<f32x4<S>>() - 0.5;
        let one = i32x4::splat(simd, 1);
        for row in rows {
            let (s, t, u) = (p.here * p.across, q.here * q.across, r.here * r.across);
            let low = p.left.select(s, before).max(q.left.select(t, before)).max(r.left.select(u, before));
            let high = p.left.select(after, s).min(q.left.select(after, t)).min(r.left.select(after, u));
            let (outside, last) = (low.floor(), high.max(low).floor());
            (outside.to_int::<i32x4<S>>() + one).store_slice(&mut row.first);
            (last - outside).to_int::<i32x4<S>>().store_slice(&mut row.count);
            (p.here, q.here, r.here) = (p.here + p.down, q.here + q.down, r.here + r.down);
        }
    }
}

#[inline(always)]
fn snapped<S: Simd>(simd: S, v: f64x4<S>, origin: f64x4<S>) -> i32x4<S> {
    let spot = (v * SUBPIXELS + f64x4::splat(simd, 0.5)).floor();
    narrow(simd, spot - origin * SUBPIXELS).to_int()
}

/// Finds the covered pixels of a triangle of any size, as the first of the four; `false` when some edge leaves the
/// whole area outside.
pub(super) fn fill_one(area: &Area, spots: [Spot; 3], rows: &mut [Row]) -> bool {
    let columns = i64::from(area.last - area.first);
    let height = i64::from(area.bottom - area.top);
    let (x, y) = (i64::from(area.first) * 256, i64::from(area.top) * 256);
    let mut edges = [[0; 3]; 3];
    for k in 0..3 {
        let [[x0, y0], [x1, y1]] = [spots[k], spots[(k + 1) % 3]].map(|spot| spot.map(i64::from));
        let (right, down) = (y0 - y1, x1 - x0);
        let owned = right > 0 || (right == 0 && down > 0);
        let start = (right * (x - x0) + down * (y - y0) - i64::from(!owned)) >> 8;
        if start + (right * columns).max(0) + (down * height).max(0) < 0 {
            return false;
        }
        edges[k] = [start, right, down];
    }
    for (y, row) in (0..=height).zip(rows) {
        let (mut first, mut last) = (0, columns);
        for [start, right, down] in edges {
            let here = start + down * y;
            match right {
                0 if here < 0 => last = -1,
                0 => {}
                1.. => first = first.max(-here.div_euclid(right)),
                _ => last = last.min(here.div_euclid(-right)),
            }
        }
        (row.first[0], row.count[0]) = (first.min(columns) as i32, (last - first + 1).max(0) as i32);
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pixels::simd::{self, dispatch};
    use crate::pixels::{SplitMix64, TILE};
    use crate::render::sort::SMALL;
    use fearless_simd::SimdFrom;

    /// Whether a pixel center is inside, by the contract's words.
    fn covers(p: [Spot; 3], x: i64, y: i64) -> bool {
        (0..3).all(|k| {
            let [[x0, y0], [x1, y1]] = [p[k], p[(k + 1) % 3]].map(|spot| spot.map(i64::from));
            let side = (x1 - x0) * (256 * y - y0) - (y1 - y0) * (256 * x - x0);
            let top_left = y1 < y0 || (y1 == y0 && x1 > x0);
            side > 0 || (side == 0 && top_left)
        })
    }

    /// What of the area is covered is one run in each row, and it is that of the rows.
    fn check(area: &Area, p: [Spot; 3], rows: &[Row], k: usize, name: &str) -> usize {
        let mut hits = 0;
        for (y, row) in (area.top..=area.bottom).zip(rows) {
            let inside = |x: i32| covers(p, x.into(), y.into());
            let covered: Vec<i32> = (area.first..=area.last).filter(|&x| inside(x)).collect();
            assert_eq!(row.count[k].max(0), covered.len() as i32, "{p:?} row {y} {name}");
            if let [first, ..] = covered[..] {
                assert_eq!(row.first[k], first - area.first, "{p:?} row {y} {name}");
                assert_eq!(covered[covered.len() - 1] - first + 1, covered.len() as i32);
            }
            hits += covered.len();
        }
        hits
    }

    fn clockwise([a, b, c]: [Spot; 3]) -> Option<[Spot; 3]> {
        let [[x0, y0], [x1, y1], [x2, y2]] = [a, b, c].map(|spot| spot.map(i64::from));
        let area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0);
        (area != 0).then_some(if area < 0 { [a, c, b] } else { [a, b, c] })
    }

    /// What of the box around the corners is in a tile.
    fn area(p: [Spot; 3], tile: [i32; 2]) -> Option<Area> {
        let side = |i: usize| {
            let (low, high) = (p.map(|v| v[i]), p.map(|v| v[i]));
            let (low, high) = (low.into_iter().min()?, high.into_iter().max()?);
            let end = tile[i] + TILE as i32 - 1;
            Some([((low + 255) >> 8).clamp(tile[i], end + 1), (high >> 8).clamp(tile[i] - 1, end)])
        };
        let ([first, last], [top, bottom]) = (side(0)?, side(1)?);
        (first <= last && top <= bottom).then_some(Area { first, top, last, bottom })
    }

    /// Small ones at every level, unsnapped places anywhere around their spots; all by the way for any size too.
    #[test]
    fn rows_are_what_is_covered() {
        let mut rng = SplitMix64::new(21);
        let (mut hits, mut drawn) = (0, 0);
        for round in 0..20_000 {
            let spread = [40, 300, 1500, i64::from(SMALL) / 2 - 1][round % 4];
            let tile = [rng.int(0, 9), rng.int(0, 9)].map(|v| (v * 64) as i32);
            let mut four = [([[0; 2]; 3], Area { first: 0, top: 0, last: 0, bottom: 0 }); 4];
            for one in &mut four {
                let middle = tile.map(|v| i64::from(v) * 256 + rng.int(-2000, 18_000));
                let mut corners = [[0; 2]; 3];
                for corner in &mut corners {
                    *corner = middle.map(|v| (v + rng.int(-spread, spread)) as i32);
                    match rng.int(0, 9) {
                        0 => *corner = corner.map(|v| v / 128 * 128), // on centers and between them
                        1 => corner[1] = (middle[1] / 256 * 256) as i32,
                        _ => {}
                    }
                }
                if let Some(p) = clockwise(corners)
                    && let Some(area) = area(p, tile)
                {
                    *one = (p, area);
                }
            }
            let of = |f: &dyn Fn(&([Spot; 3], Area)) -> f64| four.each_ref().map(f);
            let within = rng.f64() - 0.5;
            let place = |k: usize, i: usize| of(&|(p, _)| (f64::from(p[k][i]) + within * 0.999) / 256.0);
            let most = four.iter().map(|(_, area)| area.bottom - area.top + 1).max().unwrap_or(0);
            for level in simd::available() {
                let mut rows = [Row::default(); TILE];
                dispatch!(level, simd => {
                    let at = |v: [f64; 4]| f64x4::simd_from(simd, v);
                    let first = [at(of(&|(_, a)| a.first.into())), at(of(&|(_, a)| a.top.into()))];
                    let x = [at(place(0, 0)), at(place(1, 0)), at(place(2, 0))];
                    let y = [at(place(0, 1)), at(place(1, 1)), at(place(2, 1))];
                    let columns = i32x4::simd_from(simd, four.map(|(_, a)| a.last - a.first + 1));
                    Corners::new(simd, first, x, y).fill(simd, columns, &mut rows[..most as usize]);
                });
                for (k, (p, area)) in four.iter().enumerate() {
                    if clockwise(*p).is_some() {
                        hits += check(area, *p, &rows, k, simd::name(level));
                        drawn += 1;
                    }
                }
            }
            for (p, area) in four.iter().filter(|(p, _)| clockwise(*p).is_some()) {
                let mut rows = [Row::default(); TILE];
                fill_one(area, *p, &mut rows);
                check(area, *p, &rows, 0, "one");
            }
        }
        assert!(drawn > 60_000 && hits > 1_000_000, "{drawn} {hits}");
    }

    /// Steep and flat edges of the greatest length whose crossings are nearest to centers.
    #[test]
    fn crossings_next_to_centers_fall_on_their_side() {
        let mut rng = SplitMix64::new(22);
        for _ in 0..40_000 {
            let wide = SMALL - 1 - rng.int(0, 40) as i32;
            let high = SMALL - 1 - rng.int(0, 40) as i32;
            let (x, y) = (rng.int(-255, 255) as i32, rng.int(-255, 255) as i32);
            let far = [[x + wide, y + rng.int(0, 300) as i32], [x + rng.int(0, 300) as i32, y + high]];
            let third = [x + rng.int(0, wide.into()) as i32, y + rng.int(0, high.into()) as i32];
            let corners = [[[x, y], far[0], third], [[x, y], far[1], third], [[x, y], [x + wide, y + high], third]];
            for corners in corners {
                let Some(p) = clockwise(corners) else { continue };
                let Some(area) = area(p, [0, 0]) else { continue };
                let mut rows = [Row::default(); TILE];
                dispatch!(simd::best(), simd => {
                    let at = |v: f64| f64x4::splat(simd, v);
                    let x = [at(f64::from(p[0][0]) / 256.0), at(f64::from(p[1][0]) / 256.0), at(f64::from(p[2][0]) / 256.0)];
                    let y = [at(f64::from(p[0][1]) / 256.0), at(f64::from(p[1][1]) / 256.0), at(f64::from(p[2][1]) / 256.0)];
                    let columns = i32x4::splat(simd, area.last - area.first + 1);
                    let first = [at(area.first.into()), at(area.top.into())];
                    Corners::new(simd, first, x, y).fill(simd, columns, &mut rows);
                });
                check(&area, p, &rows, 3, "four");
                fill_one(&area, p, &mut rows);
                check(&area, p, &rows, 0, "one");
            }
        }
    }
}
