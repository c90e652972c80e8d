//! Eight triangles at a time, by their spots alone: which may cover a pixel center, which must be looked at singly.

use super::record::Bounds;
use super::vertex::{NO_SPOT, Spot};
use crate::pixels::{Size, TILE};
use fearless_simd::{Simd, SimdBase, i32x8, mask32x8, prelude::*};

/// Triangles of a batch.
pub(super) const BATCH: usize = 8;
/// What small means, in 1/256 px: products of differences fit in 32 bits.
pub(super) const SMALL: i32 = 1 << 14;
/// Boxes of at most so many pixel centers a side: each of them is tried.
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

/// A batch of triangles by their spots; a bit a triangle.
pub(super) struct Sorted {
    /// Small ones that may cover a pixel center, and are not culled; those in little boxes do.
    pub small: u32,
    /// Those that must be looked at singly.
    pub others: u32,
    /// Of the small ones, those wound counter-clockwise as seen.
    pub front: u32,
    /// Of the small ones bounds, low and high; the tile that holds them, or `SEVERAL`; and the centers that those in
    /// little boxes cover, row by row, a bit each, 0 for all others.
    each: [[i32; 4]; BATCH],
}

/// Not one tile.
pub(super) const SEVERAL: i32 = -1;

/// The corners of a batch, x and y apart.
type Side<S> = (i32x8<S>, i32x8<S>);

impl Sorted {
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
        let none = of(NO_SPOT[0]);
        let missing = a.0.simd_eq(none) | b.0.simd_eq(none) | c.0.simd_eq(none);
        let (x0, x1) = (a.0.min(b.0).min(c.0), a.0.max(b.0).max(c.0));
        let (y0, y1) = (a.1.min(b.1).min(c.1), a.1.max(b.1).max(c.1));
        let reach = of(rules.reach);
        let small = (x1 - x0).simd_lt(reach) & (y1 - y0).simd_lt(reach);
        let size = rules.size;
        let left = ((x0 + of(255)) >> 8).max(of(0));
        let top = ((y0 + of(255)) >> 8).max(of(0));
        let right = (x1 >> 8).min(of(size.width as i32 - 1));
        let bottom = (y1 >> 8).min(of(size.height as i32 - 1));
        let empty = left.simd_gt(right) | top.simd_gt(bottom);
        let far_off = if rules.bends { mask32x8::splat(simd, false) } else { empty };
        let others = missing | !(small | far_off);

        let area = (b.0 - a.0) * (c.1 - a.1) - (c.0 - a.0) * (b.1 - a.1);
        let front = area.simd_lt(of(0));
        let kept = if rules.cull_back { front } else { !area.simd_eq(of(0)) };
        let mut alive = kept & !empty & !others;
        let (wide, high) = (right - left, bottom - top);
        let little = alive & wide.simd_lt(of(LITTLE)) & high.simd_lt(of(LITTLE));
        let mut covers = of(0);
        if little.any_true() {
            // wound clockwise
            let (p, q) = (pick(front, c, b), pick(front, b, c));
            let corner = (left << 8, top << 8);
            let (e0, r0, d0) = edge(simd, corner, a, p);
            let (e1, r1, d1) = edge(simd, corner, p, q);
            let (e2, r2, d2) = edge(simd, corner, q, a);
            let edges = [[e0, r0 << 8, d0 << 8], [e1, r1 << 8, d1 << 8], [e2, r2 << 8, d2 << 8]];
            // most batches have no more than two a side
            let more = little & (wide | high).simd_gt(of(1));
            let outside = if more.any_true() {
                outside::<S, LITTLE>(simd, edges)
            } else {
                outside::<S, 2>(simd, edges)
            };
            let columns = pick_side(simd, wide, [0x1111, 0x3333, 0x7777, 0xffff]);
            let rows = pick_side(simd, high, [0xf, 0xff, 0xfff, 0xffff]);
            covers = little.select(columns & rows & !outside, of(0));
            alive &= !(little & covers.simd_eq(of(0)));
        }
        let one = ((left ^ right) | (top ^ bottom)).simd_lt(of(TILE as i32));
        let tile = (top >> TILE_SHIFT) * of(rules.columns as i32) + (left >> TILE_SHIFT);
        let (low, high) = (simd.split_i32x8(left | (top << 16)), simd.split_i32x8(right | (bottom << 16)));
        let (tile, covers) = (simd.split_i32x8(one.select(tile, of(SEVERAL))), simd.split_i32x8(covers));
        let mut each = [[0; 4]; BATCH];
        let (first, second) = each.split_at_mut(BATCH / 2);
        if let (Ok(first), Ok(second)) =
            (first.as_flattened_mut().try_into(), second.as_flattened_mut().try_into())
        {
            simd.store_four_interleaved_i32x4([low.0, high.0, tile.0, covers.0], first);
            simd.store_four_interleaved_i32x4([low.1, high.1, tile.1, covers.1], second);
        }
        Self {
            small: alive.to_bitmask() as u32,
            others: others.to_bitmask() as u32,
            front: front.to_bitmask() as u32,
            each,
        }
    }

    /// Of a small one its bounds, tile and cover.
    #[inline(always)]
    pub fn one(&self, k: usize) -> (Bounds, i32, u16) {
        let [low, high, tile, cover] = self.each[k % BATCH];
        (Bounds { low, high }, tile, cover as u16)
    }
}

#[inline(always)]
fn apart<S: Simd>(simd: S, spots: &[Spot; BATCH]) -> Side<S> {
    let flat = spots.as_flattened();
    i32x8::from_slice(simd, &flat[..BATCH]).deinterleave(i32x8::from_slice(simd, &flat[BATCH..]))
}

#[inline(always)]
fn pick<S: Simd>(mask: mask32x8<S>, yes: Side<S>, no: Side<S>) -> Side<S> {
    (mask.select(yes.0, no.0), mask.select(yes.1, no.1))
}

/// The pixel centers of a box of so many a side that are outside of any of the edges, a bit each, four a row.
#[inline(always)]
fn outside<S: Simd, const SIDE: i32>(
    simd: S,
    [[e0, r0, d0], [e1, r1, d1], [e2, r2, d2]]: [[i32x8<S>; 3]; 3],
) -> i32x8<S> {
    // from the last center to the first, which takes the lowest bit
    let last = i32x8::splat(simd, SIDE - 1);
    let (mut e0, mut e1, mut e2) = (e0 + (r0 + d0) * last, e1 + (r1 + d1) * last, e2 + (r2 + d2) * last);
    let mut outside = i32x8::splat(simd, 0);
    for _ in 0..SIDE {
        outside <<= (LITTLE - SIDE) as u32;
        let (mut f0, mut f1, mut f2) = (e0, e1, e2);
        for _ in 0..SIDE {
            // 0 or -1
            outside = outside + outside - ((f0 | f1 | f2) >> 31);
            (f0, f1, f2) = (f0 - r0, f1 - r1, f2 - r2);
        }
        (e0, e1, e2) = (e0 - d0, e1 - d1, e2 - d2);
    }
    outside
}

/// The entry that `last`, 0 to 3, names.
#[inline(always)]
fn pick_side<S: Simd>(simd: S, last: i32x8<S>, of: [i32; LITTLE as usize]) -> i32x8<S> {
    let is = [i32x8::splat(simd, of[0]), i32x8::splat(simd, of[1]), i32x8::splat(simd, of[2])];
    let (one, two) = (i32x8::splat(simd, 1), i32x8::splat(simd, 2));
    let more = last.simd_eq(two).select(is[2], i32x8::splat(simd, of[3]));
    let less = last.simd_eq(one).select(is[1], is[0]);
    last.simd_gt(one).select(more, less)
}

/// An edge function at a pixel center, below 0 outside by the fill rule, and its steps for 1/256 px.
#[inline(always)]
fn edge<S: Simd>(simd: S, at: Side<S>, from: Side<S>, to: Side<S>) -> (i32x8<S>, i32x8<S>, i32x8<S>) {
    let zero = i32x8::splat(simd, 0);
    let (right, down) = (from.1 - to.1, to.0 - from.0);
    let owned = right.simd_gt(zero) | (right.simd_eq(zero) & down.simd_gt(zero));
    let value = right * (at.0 - from.0) + down * (at.1 - from.1);
    (value - owned.select(zero, i32x8::splat(simd, 1)), right, down)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::pixels::SplitMix64;
    use crate::pixels::simd::{self, dispatch};

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
                    let is = |bits: u32| bits >> k & 1 == 1;
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
                    assert_eq!(is(sorted.others), missing || (large && (rules.bends || !empty)), "{p:?}");
                    if missing || large {
                        assert!(!is(sorted.small));
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
                    let tiny = (0..2).all(|i| last[i] - first[i] < i64::from(LITTLE));
                    assert_eq!(is(sorted.small), drawn && (hit || !tiny), "{p:?} {}", simd::name(level));
                    dead += usize::from(drawn && !hit && tiny);
                    if !is(sorted.small) {
                        continue;
                    }
                    kept += 1;
                    let (bounds, of_tile, cover) = sorted.one(k);
                    assert_eq!(u128::from(cover), if tiny { inside } else { 0 });
                    assert_eq!(is(sorted.front), area < 0);
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
