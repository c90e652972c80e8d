//! Eight triangles at a time, by their spots alone: which may cover a pixel center, which must be looked at singly.

use super::vertex::Spot;
use crate::pixels::{Size, TILE};
use fearless_simd::{Simd, SimdBase, i16x8, i32x8, prelude::*};

/// Triangles of a batch.
pub(super) const BATCH: usize = 8;
/// What small means, in 1/256 px: products of differences fit in 32 bits.
pub(super) const SMALL: i32 = 1 << 14;
/// Boxes of at most so many pixel centers a side, wholly in the picture: each of them is tried.
pub(super) const LITTLE: i32 = 4;
/// Of a pixel coordinate's bits, those within a tile.
const TILE_SHIFT: u32 = TILE.trailing_zeros();

/// What triangles are sorted by.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rules {
    /// The picture, and its tiles in a row.
    pub size: Size,
    pub columns: usize,
    pub cull_back: bool,
    /// Triangles whose box is smaller, 1/256 px, need no second look; at most `SMALL`.
    pub reach: i32,
    /// Whether the lens may bend larger ones into the picture.
    pub bends: bool,
}

/// A batch of triangles by their spots.
pub(super) struct Sorted {
    /// Those that may cover a pixel center and are not culled, and those that must be looked at singly, a bit each. Small
    /// ones in little boxes do cover one.
    pub alive: u32,
    /// Of those bounds, low and high; the tile that holds them, `SEVERAL` or `SINGLE`; and the centers that those in little
    /// boxes cover, row by row, a bit each, and above them `FRONT`.
    each: [[i32; 4]; BATCH],
}

/// In place of a tile: over several of them, ...
pub(super) const SEVERAL: i32 = -1;
/// ... to be looked at singly.
pub(super) const SINGLE: i32 = -2;

/// Set where a triangle is wound counter-clockwise as seen.
pub(super) const FRONT: i32 = 1 << 16;

/// The corners of a batch, x and y apart.
type Side<S> = (i32x8<S>, i32x8<S>);

/// The same from the first center of each one's box, where that is little.
type Near<S> = (i16x8<S>, i16x8<S>);

impl Sorted {
    /// What is said of a triangle is told by signs: of a number below 0 it is so.
    #[inline(always)]
    pub fn new<S: Simd>(
        simd: S,
        rules: &Rules,
        a: &[Spot; BATCH],
        b: &[Spot; BATCH],
        c: &[Spot; BATCH],
    ) -> Self {
        let (a, b, c) = (apart(simd, a), apart(simd, b), apart(simd, c));
        let of = |v: i32| i32x8::splat(simd, v);
        let when = |asked: bool| of(if asked { -1 } else { 0 });
        let (x0, x1) = (a.0.min(b.0).min(c.0), a.0.max(b.0).max(c.0));
        let (y0, y1) = (a.1.min(b.1).min(c.1), a.1.max(b.1).max(c.1));
        // no spot is far below all others
        let missing = x0 + of(1 << 30);
        let reach = (x1 - x0).max(y1 - y0);
        let large = of(rules.reach - 1) - reach;
        let (last_x, last_y) = (of(rules.size.width as i32 - 1), of(rules.size.height as i32 - 1));
        let (left, top) = ((x0 + of(255)) >> 8, (y0 + of(255)) >> 8);
        let (right, bottom) = (x1 >> 8, y1 >> 8);
        let off = left | top | (last_x - right) | (last_y - bottom);
        let (left, top) = (left.max(of(0)), top.max(of(0)));
        let (right, bottom) = (right.min(last_x), bottom.min(last_y));
        let (wide, high) = (right - left, bottom - top);
        let empty = wide | high;
        let others = missing | (large & !(empty & when(!rules.bends)));

        let area = (b.0 - a.0) * (c.1 - a.1) - (c.0 - a.0) * (b.1 - a.1);
        let kept = area | ((of(0) - area) & when(!rules.cull_back));
        let mut dead = !kept | empty;
        let (front, little) = (area >> 31, !(dead | others | off) & (wide.max(high) - of(LITTLE)));
        let mut covers = of(0);
        if little.simd_lt(of(0)).any_true() {
            let (x, y) = (left << 8, top << 8);
            let near = |p: Side<S>| (narrow(simd, p.0 - x), narrow(simd, p.1 - y));
            // wound clockwise
            let (a, (p, q)) = (near(a), swapped(narrow(simd, front), near(b), near(c)));
            let edges = [edge(simd, a, p), edge(simd, p, q), edge(simd, q, a)];
            // most batches have no more than two a side
            let more = little & (of(1) - wide.max(high));
            let inside = if more.simd_lt(of(0)).any_true() {
                inside::<S, LITTLE>(simd, edges)
            } else {
                inside::<S, 2>(simd, edges)
            };
            let (low, high) = simd.widen_u16x8(inside.bitcast());
            covers = simd.combine_i32x4(low.bitcast(), high.bitcast()) & (little >> 31);
            // little and nothing covered
            dead |= little & (covers - of(1));
        }
        let several = of(TILE as i32 - 1) - ((left ^ right) | (top ^ bottom));
        let tile = (top >> TILE_SHIFT) * of(rules.columns as i32) + (left >> TILE_SHIFT);
        let (alive, others) = ((!dead | others).simd_lt(of(0)), others >> 31);
        let tile = (tile | (several >> 31) | others) + others;
        let (low, high) = (simd.split_i32x8(left | (top << 16)), simd.split_i32x8(right | (bottom << 16)));
        let (tile, covers) = (simd.split_i32x8(tile), simd.split_i32x8(covers | (front & of(FRONT))));
        let mut each = [[0; 4]; BATCH];
        let (first, second) = each.split_at_mut(BATCH / 2);
        if let (Ok(first), Ok(second)) =
            (first.as_flattened_mut().try_into(), second.as_flattened_mut().try_into())
        {
            simd.store_four_interleaved_i32x4([low.0, high.0, tile.0, covers.0], first);
            simd.store_four_interleaved_i32x4([low.1, high.1, tile.1, covers.1], second);
        }
        Self { alive: alive.to_bitmask() as u32, each }
    }

    /// What is known of an alive one.
    #[inline(always)]
    pub fn one(&self, k: usize) -> [i32; 4] {
        self.each[k % BATCH]
    }
}

#[inline(always)]
fn apart<S: Simd>(simd: S, spots: &[Spot; BATCH]) -> Side<S> {
    let flat = spots.as_flattened();
    i32x8::from_slice(simd, &flat[..BATCH]).deinterleave(i32x8::from_slice(simd, &flat[BATCH..]))
}

/// The lower halves.
#[inline(always)]
fn narrow<S: Simd>(simd: S, v: i32x8<S>) -> i16x8<S> {
    let (low, high) = simd.split_i32x8(v);
    simd.narrow_i32x4(low, high)
}

/// The other way round where all bits are set.
#[inline(always)]
fn swapped<S: Simd>(set: i16x8<S>, b: Near<S>, c: Near<S>) -> (Near<S>, Near<S>) {
    let (x, y) = ((b.0 ^ c.0) & set, (b.1 ^ c.1) & set);
    ((b.0 ^ x, b.1 ^ y), (c.0 ^ x, c.1 ^ y))
}

/// The pixel centers of a box of so many a side that are inside of all edges, a bit each, four a row.
#[inline(always)]
fn inside<S: Simd, const SIDE: i32>(
    simd: S,
    [[e0, r0, d0], [e1, r1, d1], [e2, r2, d2]]: [[i16x8<S>; 3]; 3],
) -> i16x8<S> {
    // from the last center to the first, which takes the lowest bit
    let last = i16x8::splat(simd, SIDE as i16 - 1);
    let (mut e0, mut e1, mut e2) = (e0 + (r0 + d0) * last, e1 + (r1 + d1) * last, e2 + (r2 + d2) * last);
    let mut outside = i16x8::splat(simd, if SIDE < LITTLE { -1 } else { 0 });
    for row in 0..SIDE {
        if SIDE < LITTLE && row > 0 {
            // columns that no box has
            outside = (outside << (LITTLE - SIDE) as u32) | i16x8::splat(simd, (1 << (LITTLE - SIDE)) - 1);
        }
        let (mut f0, mut f1, mut f2) = (e0, e1, e2);
        for _ in 0..SIDE {
            // 0 or -1
            outside = outside + outside - ((f0 | f1 | f2) >> 15);
            (f0, f1, f2) = (f0 - r0, f1 - r1, f2 - r2);
        }
        (e0, e1, e2) = (e0 - d0, e1 - d1, e2 - d2);
    }
    !outside
}

/// An edge function at a box's first center, below 0 outside by the fill rule, and its steps for a pixel: all of it
/// in 1/256 of its own unit, of which the steps are whole; the value rounded down, which changes no sign. Corners are
/// less than a pixel before and less than four after the center, so that 16 bits hold it at each of the box's centers.
#[inline(always)]
fn edge<S: Simd>(simd: S, from: Near<S>, to: Near<S>) -> [i16x8<S>; 3] {
    let zero = i16x8::splat(simd, 0);
    let (right, down) = (from.1 - to.1, to.0 - from.0);
    let owned = right.simd_gt(zero) | (right.simd_eq(zero) & down.simd_gt(zero));
    let less = simd.widen_i16x8(owned.select(zero, i16x8::splat(simd, -1)));
    let (p, q) = (simd.widening_mul_i16x8(from.0, to.1), simd.widening_mul_i16x8(to.0, from.1));
    [simd.narrow_i32x4((p.0 - q.0 + less.0) >> 8, (p.1 - q.1 + less.1) >> 8), right, down]
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::pixels::SplitMix64;
    use crate::pixels::simd::{self, dispatch};
    use crate::render::record::Bounds;
    use crate::render::vertex::NO_SPOT;

    /// Whether a pixel center is inside, by the contract's words.
    pub fn covers(p: [Spot; 3], x: i64, y: i64) -> bool {
        (0..3).all(|k| {
            let [[x0, y0], [x1, y1]] = [p[k], p[(k + 1) % 3]].map(|spot| spot.map(i64::from));
            let side = (x1 - x0) * (256 * y - y0) - (y1 - y0) * (256 * x - x0);
            let top_left = y1 < y0 || (y1 == y0 && x1 > x0);
            side > 0 || (side == 0 && top_left)
        })
    }

    #[test]
    fn batches_are_single_triangles() {
        let mut rng = SplitMix64::new(15);
        let size = Size::new(200, 150);
        let (mut dead, mut kept, mut odd) = (0, 0, 0);
        for round in 0..6000 {
            let rules = Rules {
                size,
                columns: size.width.div_ceil(TILE),
                cull_back: round % 2 == 1,
                reach: [SMALL, 5000][round % 3 / 2],
                bends: round % 5 == 0,
            };
            let spread = [100, 400, 3000, 60_000][round % 4];
            let mut corners = [[NO_SPOT; BATCH]; 3];
            for k in 0..BATCH {
                let middle = [rng.int(-2000, 53_000), rng.int(-2000, 40_000)];
                for corner in &mut corners {
                    corner[k] = middle.map(|v| (v + rng.int(-spread, spread)) as i32);
                    if rng.int(0, 9) == 0 {
                        corner[k] = corner[k].map(|v| v / 128 * 128); // on centers and between them
                    }
                }
            }
            if round % 7 == 0 {
                corners[round % 3][round % BATCH] = NO_SPOT;
            }
            let [a, b, c] = corners;
            for level in simd::available() {
                let sorted = dispatch!(level, simd => Sorted::new(simd, &rules, &a, &b, &c));
                for (k, ((&a, &b), &c)) in a.iter().zip(&b).zip(&c).enumerate() {
                    let p = [a, b, c];
                    let [_, _, of_tile, word] = sorted.one(k);
                    let alive = sorted.alive >> k & 1 == 1;
                    let (small, single) = (alive && of_tile != SINGLE, alive && of_tile == SINGLE);
                    let (low, high) = (
                        [0, 1].map(|i| p.map(|v| v[i]).into_iter().min()),
                        [0, 1].map(|i| p.map(|v| v[i]).into_iter().max()),
                    );
                    let (low, high) = (low.map(|v| v.unwrap_or(0)), high.map(|v| v.unwrap_or(0)));
                    let missing = p.contains(&NO_SPOT);
                    let large = !missing && (0..2).any(|i| high[i] - low[i] >= rules.reach);
                    let first = low.map(|v| ((i64::from(v) + 255) >> 8).max(0));
                    let last = [(high[0] >> 8).min(199), (high[1] >> 8).min(149)].map(i64::from);
                    let empty = (0..2).any(|i| first[i] > last[i]);
                    assert_eq!(single, missing || (large && (rules.bends || !empty)), "{p:?}");
                    if missing || large {
                        assert!(!small);
                        odd += 1;
                        continue;
                    }
                    let [[x0, y0], [x1, y1], [x2, y2]] = p.map(|spot| spot.map(i64::from));
                    let area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0);
                    let wound = if area < 0 { [p[0], p[2], p[1]] } else { p };
                    let mut inside = 0;
                    for (y, row) in (first[1]..=last[1]).zip(0..) {
                        for (x, column) in (first[0]..=last[0]).zip(0..) {
                            inside |= u128::from(covers(wound, x, y)) << (LITTLE * row + column).min(127);
                        }
                    }
                    let hit = inside != 0;
                    let drawn = area != 0 && !empty && !(rules.cull_back && area > 0);
                    // what covers a center is kept; what does not is dropped in small boxes
                    let clear = low[0] > -256 && low[1] > -256 && high[0] < 200 * 256 && high[1] < 150 * 256;
                    let tiny = clear && (0..2).all(|i| last[i] - first[i] < i64::from(LITTLE));
                    assert_eq!(small, drawn && (hit || !tiny), "{p:?} {}", simd::name(level));
                    dead += usize::from(drawn && !hit && tiny);
                    if !small {
                        continue;
                    }
                    kept += 1;
                    assert_eq!(u128::from(word as u16), if tiny { inside } else { 0 });
                    assert_eq!(word & FRONT != 0, area < 0);
                    let bounds = Bounds { low: sorted.one(k)[0], high: sorted.one(k)[1] };
                    assert_eq!(bounds.sides().map(i64::from), [first[0], first[1], last[0], last[1]]);
                    let tile = |x: i64, y: i64| (y / 64 * 4 + x / 64) as i32;
                    let (from, to) = (tile(first[0], first[1]), tile(last[0], last[1]));
                    assert_eq!(of_tile, if from == to { from } else { SEVERAL });
                }
            }
        }
        assert!(dead > 3000 && kept > 30_000 && odd > 10_000, "{dead} {kept} {odd}");
    }
}
