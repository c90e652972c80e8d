//! The pixels that triangles cover in each row of an area: a first one and how many. Exactly those whose centers are
//! inside the snapped corners by the fill rule.
//!
//! An edge function at a row's first center, divided by 256, is whole but for a fraction that changes no sign and is
//! rounded down; half a step is added, so that it is never 0 and the edge crosses the row between two centers, never on
//! one. Of small triangles all this fits in f32: the crossing is off by less than a quarter of its distance to the
//! nearest center.

use super::record::Bounds;
use super::tile::STRIDE;
use super::vertex::{SUBPIXELS, Spot, narrow};
use fearless_simd::{Simd, SimdBase, f32x4, f64x4, i32x4, prelude::*};

/// A row of each of four triangles.
#[derive(Clone, Copy, Default)]
pub(super) struct Row {
    /// The first covered pixel, in the slot, and its column from the area's first one on.
    pub at: [i32; 4],
    pub first: [f32; 4],
    /// How many are covered; all else is any where none is.
    pub count: [i32; 4],
    /// 1/z and light at the area's first column.
    pub w: [f32; 4],
    pub light: [f32; 4],
}

/// The corners of four triangles, in whole 1/256 px from the first center of each one's area.
pub(super) struct Corners<S: Simd>([[i32x4<S>; 2]; 3]);

/// One edge of four triangles.
struct Edge<S: Simd> {
    /// Its function at the column before the first of a row, plus 1/2, and the step to the next row.
    here: f32x4<S>,
    down: f32x4<S>,
    /// Turns that into columns up to where it crosses the row; or to none where it does not bound them on the left.
    across: f32x4<S>,
    before: f32x4<S>,
    /// Where pixels are to the right of it they may end after the area, else anywhere.
    after: f32x4<S>,
}

impl<S: Simd> Corners<S> {
    /// Snaps corners, px: x, then y; areas begin at these pixels.
    #[inline(always)]
    pub fn new(simd: S, [left, top]: [i32x4<S>; 2], x: [f64x4<S>; 3], y: [f64x4<S>; 3]) -> Self {
        let (left, top) = (left << 8, top << 8);
        Self([
            [snapped(simd, x[0], left), snapped(simd, y[0], top)],
            [snapped(simd, x[1], left), snapped(simd, y[1], top)],
            [snapped(simd, x[2], left), snapped(simd, y[2], top)],
        ])
    }

    /// Of areas that end before the column `after`.
    #[inline(always)]
    fn edge(&self, simd: S, k: usize, after: f32x4<S>) -> Edge<S> {
        let (zero, one) = (i32x4::splat(simd, 0), i32x4::splat(simd, 1));
        let Self(corners) = self;
        let ([x, y], [next_x, next_y]) = (corners[k], corners[(k + 1) % 3]);
        let (right, down) = (y - next_y, next_x - x);
        let left = right.simd_gt(zero);
        // centers on it are inside: of top edges, to the right along the row, and of left ones, upwards
        let owned = left | (right.simd_eq(zero) & down.simd_gt(zero));
        let start = ((zero - right * x - down * y - owned.select(zero, one)) >> 8) - right;
        let (start, down, back): (f32x4<S>, f32x4<S>, f32x4<S>) =
            (start.to_float(), down.to_float(), (zero - right).to_float());
        // along the row: infinite, with the sign of its function, and never a left edge
        let across = f32x4::splat(simd, 1.0) / back;
        let before = left.select(across, f32x4::splat(simd, 0.0));
        let after = left.select(after, f32x4::splat(simd, f32::MIN));
        Edge { here: start + 0.5, down, across, before, after }
    }

    /// Finds the covered pixels of the rows, `at` being the area's first one and `columns` how many it has in a row; of
    /// small triangles only.
    #[inline(always)]
    pub fn fill(&self, simd: S, mut at: i32x4<S>, columns: i32x4<S>, rows: &mut [Row]) {
        let after = columns.to_float::<f32x4<S>>() + 0.5;
        let (mut p, mut q) = (self.edge(simd, 0, after), self.edge(simd, 1, after));
        let mut r = self.edge(simd, 2, after);
        for row in rows {
            let (s, t, u) = (p.here * p.across, q.here * q.across, r.here * r.across);
            let low = (p.here * p.before).max(q.here * q.before).max(r.here * r.before);
            // left of a left edge that is after the area there is nothing anyhow
            let high = s.max(p.after).min(t.max(q.after)).min(u.max(r.after));
            // neither is below 0
            let (first, end) = (low.to_int::<i32x4<S>>(), high.max(low).to_int::<i32x4<S>>());
            (at + first).store_slice(&mut row.at);
            first.to_float::<f32x4<S>>().store_slice(&mut row.first);
            (end - first).store_slice(&mut row.count);
            (p.here, q.here, r.here) = (p.here + p.down, q.here + q.down, r.here + r.down);
            at += i32x4::splat(simd, STRIDE as i32);
        }
    }
}

/// Small triangles that have an area are so near the picture that f32 holds this.
#[inline(always)]
fn snapped<S: Simd>(simd: S, v: f64x4<S>, origin: i32x4<S>) -> i32x4<S> {
    let spot = (v * SUBPIXELS + f64x4::splat(simd, 0.5)).floor();
    narrow(simd, spot).to_int::<i32x4<S>>() - origin
}

/// Finds the covered pixels of a triangle of any size, as the first of the four; `false` when some edge leaves the
/// whole area, whose first pixel is `at`, outside.
pub(super) fn fill_one(at: i32, area: Bounds, spots: [Spot; 3], rows: &mut [Row]) -> bool {
    let [left, top, right, bottom] = area.sides().map(i64::from);
    let (columns, height) = (right - left, bottom - top);
    let mut edges = [[0; 3]; 3];
    for (k, edge) in edges.iter_mut().enumerate() {
        let [[x0, y0], [x1, y1]] = [spots[k], spots[(k + 1) % 3]].map(|spot| spot.map(i64::from));
        let (right, down) = (y0 - y1, x1 - x0);
        let owned = right > 0 || (right == 0 && down > 0);
        let start = (right * (256 * left - x0) + down * (256 * top - y0) - i64::from(!owned)) >> 8;
        let (across, along) = (right * columns, down * height);
        if start + across.max(0) + along.max(0) < 0 {
            return false;
        }
        // inside everywhere: stays 0
        if start + across.min(0) + along.min(0) < 0 {
            *edge = [start, right, down];
        }
    }
    for (y, row) in (0..=height as i32).zip(rows) {
        let (mut first, mut last) = (0, columns);
        for [here, right, down] in &mut edges {
            match *right {
                0 if *here < 0 => last = -1,
                0 => {}
                1.. => first = first.max(-here.div_euclid(*right)),
                _ => last = last.min(here.div_euclid(-*right)),
            }
            *here += *down;
        }
        row.count[0] = (last + 1 - first).max(0) as i32;
        let first = first.min(columns) as i32;
        (row.at[0], row.first[0]) = (at + y * STRIDE as i32 + first, first as f32);
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pixels::simd::{self, Level, dispatch};
    use crate::pixels::{SplitMix64, TILE};
    use crate::render::sort::SMALL;
    use crate::render::sort::tests::covers;
    use fearless_simd::SimdFrom;

    /// Where areas begin in the slot.
    const AT: i32 = 7;

    /// What of the area is covered is one run in each row, and it is that of the rows.
    fn check(area: Bounds, p: [Spot; 3], rows: &[Row], k: usize, name: &str) -> usize {
        let [left, top, right, bottom] = area.sides();
        let mut hits = 0;
        for (y, row) in (top..=bottom).zip(rows) {
            let covered: Vec<i32> = (left..=right).filter(|&x| covers(p, x.into(), y.into())).collect();
            assert_eq!(row.count[k], covered.len() as i32, "{p:?} row {y} {name}");
            if let [first, ..] = covered[..] {
                assert_eq!(row.first[k], (first - left) as f32, "{p:?} row {y} {name}");
                assert_eq!(row.at[k], AT + (y - top) * STRIDE as i32 + first - left);
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
    fn area(p: [Spot; 3], tile: [i32; 2]) -> Option<Bounds> {
        let side = |i: usize| {
            let (low, high) = (p.iter().map(|v| v[i]).min()?, p.iter().map(|v| v[i]).max()?);
            let end = tile[i] + TILE as i32 - 1;
            Some([((low + 255) >> 8).max(tile[i]), (high >> 8).min(end)])
        };
        let ([left, right], [top, bottom]) = (side(0)?, side(1)?);
        (left <= right && top <= bottom).then(|| Bounds::new([left, top, right, bottom]))
    }

    /// The rows of four triangles whose unsnapped corners are `within`, -.5 to .5, of their spots.
    fn rows(level: Level, four: &[([Spot; 3], Bounds); 4], within: f64) -> [Row; TILE] {
        let mut rows = [Row::default(); TILE];
        let place = |k: usize, i: usize| four.map(|(p, _)| (f64::from(p[k][i]) + within) / 256.0);
        let side = |i: usize| four.map(|(_, area)| area.sides()[i]);
        dispatch!(level, simd => {
            let of = |v: [f64; 4]| f64x4::simd_from(simd, v);
            let whole = |v: [i32; 4]| i32x4::simd_from(simd, v);
            let x = [of(place(0, 0)), of(place(1, 0)), of(place(2, 0))];
            let y = [of(place(0, 1)), of(place(1, 1)), of(place(2, 1))];
            let columns = four.map(|(_, area)| area.sides()[2] - area.sides()[0] + 1);
            Corners::new(simd, [whole(side(0)), whole(side(1))], x, y).fill(
                simd, i32x4::splat(simd, AT), i32x4::simd_from(simd, columns), &mut rows,
            );
        });
        rows
    }

    /// Small ones at every level, and each of them as one of any size.
    #[test]
    fn rows_are_what_is_covered() {
        let mut rng = SplitMix64::new(21);
        let (mut hits, mut drawn) = (0, 0);
        for round in 0..20_000 {
            let spread = [40, 300, 1500, i64::from(SMALL) / 2 - 1][round % 4];
            let tile = [rng.int(0, 9), rng.int(0, 9)].map(|v| (v * 64) as i32);
            let mut four = [([[0; 2]; 3], Bounds::default()); 4];
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
            let within = (rng.f64() - 0.5) * 0.999;
            for level in simd::available() {
                let rows = rows(level, &four, within);
                for (k, &(p, area)) in four.iter().enumerate().filter(|(_, (p, _))| clockwise(*p).is_some()) {
                    hits += check(area, p, &rows, k, simd::name(level));
                    drawn += 1;
                }
            }
            for &(p, area) in four.iter().filter(|(p, _)| clockwise(*p).is_some()) {
                let mut rows = [Row::default(); TILE];
                // where it says that nothing is covered the rows stay empty
                fill_one(AT, area, p, &mut rows);
                check(area, p, &rows, 0, "one");
            }
        }
        assert!(drawn > 60_000 && hits > 1_000_000, "{drawn} {hits}");
    }

    /// Edges of the greatest length, steep, flat and aslant: their crossings come nearest to centers.
    #[test]
    fn crossings_next_to_centers_fall_on_their_side() {
        let mut rng = SplitMix64::new(22);
        let mut hits = 0;
        for _ in 0..20_000 {
            let (wide, high) = (SMALL - 1 - rng.int(0, 40) as i32, SMALL - 1 - rng.int(0, 40) as i32);
            let (x, y) = (rng.int(-255, 255) as i32, rng.int(-255, 255) as i32);
            let far = [
                [x + wide, y + rng.int(0, 300) as i32],
                [x + rng.int(0, 300) as i32, y + high],
                [x + wide, y + high],
            ];
            let third = [x + rng.int(0, wide.into()) as i32, y + rng.int(0, high.into()) as i32];
            for far in far {
                let Some(p) = clockwise([[x, y], far, third]) else { continue };
                let Some(area) = area(p, [0, 0]) else { continue };
                hits += check(area, p, &rows(simd::best(), &[(p, area); 4], 0.0), 3, "four");
                let mut rows = [Row::default(); TILE];
                // where it says that nothing is covered the rows stay empty
                fill_one(AT, area, p, &mut rows);
                check(area, p, &rows, 0, "one");
            }
        }
        assert!(hits > 10_000_000, "{hits}");
    }
}
