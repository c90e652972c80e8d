//! Where the picture has changed since it was last searched.
//!
//! Nothing new can have appeared where nothing has changed. A `Watch` keeps a small picture of the scene as it was
//! when last searched and compares it, tile by tile, with the one of the present picture; the noise decides what
//! counts as a change. Tiles under followed markers never count: those are looked at anyway. What a marker
//! uncovers is known or too narrow to hold another one, so it is looked at only after a few frames. Every other row
//! of tiles is compared in a frame, the rest in the next.

use super::quad::Quad;
use super::search;
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, PlaneRef, Size};
use fearless_simd::{Simd, prelude::*, u8x32, u16x16, u32x8};
use glam::DVec2;
use std::ops::Range;

/// Pixels that a value of the small picture stands for, along either side.
const CELL: usize = 4;
/// Side of a tile, px, and in values of the small picture.
pub const TILE_PX: usize = TILE * CELL;
const TILE: usize = 4;
/// Frames after which what was uncovered is searched, and that in visits of its tiles.
const LATER_FRAMES: u8 = 8;
const LATER: u8 = LATER_FRAMES / 2;
/// Followed markers reach this far beyond their corners: quiet zone, blur, half a tile.
const REACH_PX: f64 = 16.0;

/// The scene as it was when last searched.
#[derive(Debug, Default)]
pub struct Watch {
    /// Mean of the middle 4x2 pixels of every 4x4, in the present picture and when last searched.
    now: Plane<u8>,
    seen: Plane<u8>,
    /// Tile by tile: 0 where nothing is to be searched, else its visits until then, and one.
    wait: Vec<u8>,
    /// Tile by tile: under a followed marker now (1), in the picture before that was compared (2).
    under: Vec<u8>,
    columns: usize,
    /// Sum of absolute differences of every tile in a row.
    apart: Vec<u32>,
    /// The tile from which the next region is looked for.
    next: usize,
    /// Which rows of tiles are compared in this frame: even or odd ones.
    turn: usize,
}

/// A box of tiles: first column and row, and the ones after the last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    pub low: [usize; 2],
    pub high: [usize; 2],
}

impl Region {
    /// Its box in the picture, px, with a tile more on every side.
    pub fn bounds(&self) -> [DVec2; 2] {
        let at = |v: usize, grow: f64| v as f64 * TILE_PX as f64 + grow;
        let grow = TILE_PX as f64;
        [
            DVec2::new(at(self.low[0], -grow), at(self.low[1], -grow)),
            DVec2::new(at(self.high[0], grow), at(self.high[1], grow)),
        ]
    }
}

impl Watch {
    /// All of this picture has been searched.
    pub fn settle(&mut self, luma: PlaneRef<'_, u8>, level: Level) {
        let Size { width, height } = luma.size();
        self.now.resize(Size::new(width / CELL, height / CELL), 0);
        let all = 0..self.now.size().height;
        shrink(luma, &mut self.now, all, level);
        self.columns = width.div_ceil(TILE_PX);
        let rows = height.div_ceil(TILE_PX);
        for tiles in [&mut self.wait, &mut self.under] {
            tiles.clear();
            tiles.resize(self.columns * rows, 0);
        }
        self.apart.resize(self.columns, 0);
        self.seen.resize(self.now.size(), 0);
        for y in 0..self.now.size().height {
            self.seen.row_mut(y).copy_from_slice(self.now.row(y));
        }
    }

    /// Compares the picture with what was searched. `sigma`: deviation of a pixel's noise, gray levels; `followed`:
    /// corners of the markers that need no search, px.
    pub fn look(
        &mut self,
        luma: PlaneRef<'_, u8>,
        sigma: f64,
        followed: impl Iterator<Item = Quad>,
        level: Level,
    ) {
        let size = Size::new(luma.size().width / CELL, luma.size().height / CELL);
        if self.seen.size() != size {
            self.settle(luma, level);
        }
        let rows = self.wait.len() / self.columns.max(1);
        self.turn ^= 1;
        for under in self.under.chunks_exact_mut(self.columns.max(1)).skip(self.turn).step_by(2) {
            under.iter_mut().for_each(|under| *under = (*under << 1) & 2);
        }
        followed.for_each(|quad| self.cover(&quad));
        let limit = limit(sigma);
        for row in (self.turn..rows).step_by(2) {
            let (from, to) = (row * TILE, size.height.min(row * TILE + TILE));
            shrink(luma, &mut self.now, from.min(to)..to, level);
            self.apart.fill(0);
            let rows = (from..to).map(|y| (self.now.row(y), self.seen.row(y)));
            dispatch!(level, simd => differ(simd, rows, &mut self.apart));
            for column in 0..self.columns {
                let at = row * self.columns + column;
                let wait = &mut self.wait[at];
                *wait -= u8::from(*wait > 1);
                if self.under[at] > 0 {
                    *wait = match self.under[at] {
                        // uncovered just now
                        2 => LATER,
                        _ => 0,
                    };
                    self.know([column, row]);
                    continue;
                }
                if self.apart[column] > limit {
                    *wait = 1;
                }
            }
        }
    }

    /// The next region in which something changed; all of the picture where most of it did.
    pub fn due(&mut self) -> Option<Region> {
        let (columns, count) = (self.columns, self.wait.len());
        let rows = count / columns.max(1);
        let due = |at: usize| self.wait[at] == 1;
        let changed = self.wait.iter().filter(|wait| **wait == 1).count();
        if changed == 0 {
            return None;
        }
        // of what changed, at least half is known in any frame
        if 4 * changed > count {
            return Some(Region { low: [0, 0], high: [columns, rows] });
        }
        let first = (self.next..count).chain(0..self.next.min(count)).find(|&at| due(at))?;
        self.next = first;
        let (column, row) = (first % columns, first / columns);
        let mut region = Region { low: [column, row], high: [column + 1, row + 1] };
        // grows while tiles around it have changed, or wait; the rows between may not have been compared yet
        loop {
            let before = region;
            let (left, right) = (before.low[0].max(1) - 1, (before.high[0] + 1).min(columns));
            let (top, bottom) = (before.low[1].max(2) - 2, (before.high[1] + 2).min(rows));
            for row in top..bottom {
                for column in left..right {
                    if self.wait[row * columns + column] > 0 {
                        region.low = [region.low[0].min(column), region.low[1].min(row)];
                        region.high = [region.high[0].max(column + 1), region.high[1].max(row + 1)];
                    }
                }
            }
            if region == before {
                return Some(region);
            }
        }
    }

    /// This region has been searched.
    pub fn searched(&mut self, region: &Region) {
        for row in region.low[1]..region.high[1] {
            for column in region.low[0]..region.high[0] {
                self.wait[row * self.columns + column] = 0;
                self.know([column, row]);
            }
        }
        self.next = region.high[0] + (region.high[1] - 1) * self.columns;
    }

    /// Takes the tile as it is now for what was searched.
    fn know(&mut self, [column, row]: [usize; 2]) {
        let Size { width, height } = self.now.size();
        let (from, to) = ((column * TILE).min(width), (column * TILE + TILE).min(width));
        for y in row * TILE..(row * TILE + TILE).min(height) {
            self.seen.row_mut(y)[from..to].copy_from_slice(&self.now.row(y)[from..to]);
        }
    }

    /// Marks the tiles under a marker.
    fn cover(&mut self, quad: &Quad) {
        let rows = self.wait.len() / self.columns.max(1);
        let [low, high] = super::bounds(quad).map(|p| p / TILE_PX as f64);
        let reach = REACH_PX / TILE_PX as f64;
        let range = |low: f64, high: f64, most: usize| {
            (low - reach).max(0.0) as usize..((high + reach).max(0.0) as usize + 1).min(most)
        };
        for row in range(low.y, high.y, rows).filter(|row| row % 2 == self.turn) {
            for column in range(low.x, high.x, self.columns) {
                let p = (DVec2::new(column as f64, row as f64) + 0.5) * TILE_PX as f64;
                let within = (0..4).all(|i| {
                    let side = quad[(i + 1) % 4] - quad[i];
                    side.perp_dot(p - quad[i]) >= -REACH_PX * side.length()
                });
                if within {
                    self.under[row * self.columns + column] |= 1;
                }
            }
        }
    }
}

/// The sum of absolute differences over a tile that noise alone exceeds about once in 10⁶: the difference d of two
/// means of 8 has the deviation σ/2, and rounding adds a little; 16 |d| have the mean 12.8 and the deviation 2.4 of
/// these.
fn limit(sigma: f64) -> u32 {
    let deviation = (0.25 * sigma * sigma + 0.2).sqrt();
    (25.0 * deviation).min(4096.0) as u32 + 8
}

/// Adds the absolute differences of pairs of rows to the tiles' sums.
#[inline(always)]
fn differ<'a, S: Simd>(simd: S, rows: impl Iterator<Item = (&'a [u8], &'a [u8])>, sums: &mut [u32]) {
    for (a, b) in rows {
        let mut from = 0;
        for (eight, (a, b)) in
            sums.chunks_exact_mut(RUN / TILE).zip(a.chunks_exact(RUN).zip(b.chunks_exact(RUN)))
        {
            let (a, b) = (u8x32::from_slice(simd, a), u8x32::from_slice(simd, b));
            let apart: u16x16<S> = (a.max(b) - a.min(b)).bitcast();
            let pairs: u32x8<S> = ((apart & 0xff) + (apart >> 8)).bitcast();
            let fours = (pairs & 0xffff) + (pairs >> 16);
            (u32x8::from_slice(simd, eight) + fours).store_slice(eight);
            from += RUN;
        }
        let rest = a[from..].chunks(TILE).zip(b[from..].chunks(TILE));
        for (sum, (a, b)) in sums[from / TILE..].iter_mut().zip(rest) {
            *sum += a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(*b))).sum::<u32>();
        }
    }
}

/// Rows of the small picture: the mean of the middle two rows of every 4x4 pixels, rounded.
fn shrink(luma: PlaneRef<'_, u8>, small: &mut Plane<u8>, rows: Range<usize>, level: Level) {
    for y in rows {
        let (above, below) = (luma.row(CELL * y + 1), luma.row(CELL * y + 2));
        let out = small.row_mut(y);
        dispatch!(level, simd => means(simd, above, below, out));
    }
}

/// Values made at once.
const RUN: usize = 32;

#[inline(always)]
fn means<S: Simd>(simd: S, above: &[u8], below: &[u8], out: &mut [u8]) {
    let mut runs = out.chunks_exact_mut(RUN);
    for (i, out) in (&mut runs).enumerate() {
        let at = i * RUN * CELL;
        let low = eight(simd, above, below, at).relaxed_narrow(eight(simd, above, below, at + 32));
        let high = eight(simd, above, below, at + 64).relaxed_narrow(eight(simd, above, below, at + 96));
        low.relaxed_narrow(high).store_slice(out);
    }
    let rest = runs.into_remainder();
    let from = (above.len() / CELL - rest.len()) * CELL;
    let fours = above[from..].chunks_exact(CELL).zip(below[from..].chunks_exact(CELL));
    for (out, (a, b)) in rest.iter_mut().zip(fours) {
        let sum = a.iter().chain(b).map(|v| u16::from(*v)).sum::<u16>();
        *out = ((sum + 4) >> 3) as u8;
    }
}

/// The means of the 4x2 pixels from `at` on.
#[inline(always)]
fn eight<S: Simd>(simd: S, above: &[u8], below: &[u8], at: usize) -> u32x8<S> {
    let sum: u32x8<S> = (search::pairs(simd, above, at) + search::pairs(simd, below, at)).bitcast();
    ((sum & 0xffff) + (sum >> 16) + 4) >> 3
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::sweep::{cases, everywhere};
    use crate::pixels::{SplitMix64, simd};

    fn noisy(size: Size, sigma: f64, seed: u64, thing: impl Fn(usize, usize) -> f64) -> Plane<u8> {
        let mut rng = SplitMix64::new(seed);
        Plane::from_fn(size, |x, y| {
            let bell = (0..12).map(|_| rng.f64()).sum::<f64>() - 6.0;
            (thing(x, y) + sigma * bell + 0.5).clamp(0.0, 255.0) as u8
        })
    }

    #[test]
    fn small_picture_is_the_plain_mean_everywhere() {
        for case in cases() {
            let Size { width, height } = case.plane.size();
            let small = everywhere(&case.label, |level| {
                let mut small = Plane::default();
                small.resize(Size::new(width / CELL, height / CELL), 0);
                shrink(case.plane.view(), &mut small, 0..height / CELL, level);
                (0..height / CELL).map(|y| small.row(y).to_vec()).collect::<Vec<_>>()
            });
            for (y, row) in small.iter().enumerate() {
                assert_eq!(row.len(), width / CELL);
                for (x, &mean) in row.iter().enumerate() {
                    let pixels = (0..8).map(|i| u32::from(case.plane.at(4 * x + i % 4, 4 * y + 1 + i / 4)));
                    assert_eq!(u32::from(mean), (pixels.sum::<u32>() + 4) / 8, "{}", case.label);
                }
            }
        }
    }

    /// Noise changes nothing, a small faint square does, and what was searched rests.
    #[test]
    fn changes_are_due_until_searched_and_noise_never_is() {
        let size = Size::new(330, 250);
        for sigma in [0.0, 2.0, 8.0] {
            for level in simd::available() {
                let wall = |x: usize, y: usize| 90.0 + (x * y % 31) as f64;
                let mut watch = Watch::default();
                watch.settle(noisy(size, sigma, 1, wall).view(), level);
                for seed in 2..20 {
                    watch.look(noisy(size, sigma, seed, wall).view(), sigma, [].into_iter(), level);
                    assert_eq!(watch.due(), None, "σ {sigma}");
                }
                let square = |x: usize, y: usize| {
                    let inside = (200..216).contains(&x) && (100..116).contains(&y);
                    if inside { 40.0 } else { wall(x, y) }
                };
                for seed in [30, 31] {
                    watch.look(noisy(size, sigma, seed, square).view(), sigma, [].into_iter(), level);
                }
                let region = watch.due().expect("a square");
                assert_eq!(watch.due(), Some(region), "until it is searched");
                let [low, high] = region.bounds();
                assert!(low.x <= 192.0 && low.y <= 92.0 && high.x >= 224.0 && high.y >= 124.0, "{region:?}");
                assert!(high.x - low.x <= 80.0 && high.y - low.y <= 80.0, "{region:?}");
                watch.searched(&region);
                for seed in [32, 33] {
                    watch.look(noisy(size, sigma, seed, square).view(), sigma, [].into_iter(), level);
                    assert_eq!(watch.due(), None);
                }
            }
        }
    }

    #[test]
    fn what_a_marker_uncovers_is_searched_later_and_all_of_another_scene_at_once() {
        let size = Size::new(320, 240);
        let level = simd::best();
        let square = |left: f64| {
            [(0.0, 0.0), (48.0, 0.0), (48.0, 48.0), (0.0, 48.0)].map(|(x, y)| DVec2::new(left + x, 80.0 + y))
        };
        let picture = |left: usize| {
            Plane::from_fn(size, |x, y| {
                if (left..left + 48).contains(&x) && (80..128).contains(&y) { 20 } else { 200 }
            })
        };
        let mut watch = Watch::default();
        watch.settle(picture(40).view(), level);
        for _ in 0..2 {
            watch.look(picture(40).view(), 1.0, [square(40.0)].into_iter(), level);
        }
        // it jumps aside: both places are known
        let mut waited = 0;
        loop {
            watch.look(picture(160).view(), 1.0, [square(160.0)].into_iter(), level);
            if let Some(region) = watch.due() {
                assert!(region.low[0] <= 2 && region.high[0] <= 7, "where it was: {region:?}");
                break;
            }
            waited += 1;
            assert!(waited < 10, "what was behind it is looked at");
        }
        assert!(waited + 2 >= usize::from(LATER_FRAMES), "{waited}");
        let other = Plane::from_fn(size, |x, y| (x * 3 + y * 5) as u8);
        watch.look(other.view(), 1.0, [].into_iter(), level);
        assert_eq!(watch.due(), Some(Region { low: [0, 0], high: [20, 15] }));
    }
}
