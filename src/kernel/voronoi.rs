//! Exact nearest-site labels: for every pixel the site closest to its center, the lowest index among equals.
//!
//! Sites lie on a lattice of 1/16 px in the continuous frame `[0,W]x[0,H]` (pixel (i, j) is sampled at
//! (i + 1/2, j + 1/2)), so squared distances are whole numbers. Each site is splatted over a window of pixels around
//! it as `min(distance² << bits | index)`: one add and one minimum a pixel. A window that holds every pixel within
//! `reach` of its site proves the result: whatever distance up to `reach` a pixel ends with is its least. The few
//! pixels that end beyond it (sites that wandered off, any file of sites) are searched one by one through the
//! sites' buckets, ring by ring. The labels are therefore exact for every set of sites, only not equally fast.

use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, PlaneMut, Size};
use fearless_simd::{Simd, SimdBase, u32x8};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};

/// Lattice steps in a pixel.
pub const LATTICE: i32 = 16;
/// Farthest a site may lie from the frame's origin, lattice steps (65,536 px).
pub const FARTHEST: i32 = 1 << 20;
/// Most pixels across a window.
const WIDEST: usize = 256;
/// Side of the blocks that are labeled again or not, px.
const BLOCK: usize = 16;

/// The labels of one frame and the tables they are made with.
#[derive(Debug, Default)]
pub struct Voronoi {
    /// Keys, then labels; `margin` junk columns on either side.
    keys: Plane<u32>,
    margin: usize,
    buckets: Buckets,
    /// The frame size and the sites that the labels are of.
    size: Size,
    labeled: Vec<[i32; 2]>,
    /// Whether some pixel's nearest site was out of the window's reach.
    strayed: AtomicBool,
    stale: Stale,
}

/// The blocks of [`BLOCK`] x [`BLOCK`] px, row by row, whose labels may be wrong.
#[derive(Debug, Default)]
struct Stale {
    columns: usize,
    blocks: Vec<bool>,
    all: bool,
}

impl Stale {
    /// Fits the blocks to a frame; all of them are as `stale` says.
    fn reset(&mut self, size: Size, stale: bool) {
        self.all = stale;
        self.columns = size.width.div_ceil(BLOCK);
        self.blocks.clear();
        self.blocks.resize(self.columns * size.height.div_ceil(BLOCK), stale);
    }

    /// The blocks that hold pixels `low..=high` of a line of `count` blocks.
    fn span([low, high]: [i32; 2], count: usize) -> Range<usize> {
        let block = |pixel: i32| usize::try_from(pixel).map_or(0, |pixel| pixel / BLOCK);
        let end = if high < 0 { 0 } else { block(high) + 1 };
        block(low).min(count)..end.min(count)
    }

    /// Marks the blocks with pixels within `reach` of a site.
    fn mark(&mut self, [x, y]: [i32; 2], reach: i32) {
        let around = |v: i32| [(v >> 4) - reach - 1, (v >> 4) + reach + 1];
        for row in Self::span(around(y), self.blocks.len() / self.columns) {
            let columns = Self::span(around(x), self.columns);
            self.blocks[row * self.columns..][columns].fill(true);
        }
    }

    /// Whether some block with pixels in these columns and rows is stale.
    fn any(&self, columns: [i32; 2], rows: [i32; 2]) -> bool {
        if self.all {
            return true;
        }
        let columns = Self::span(columns, self.columns);
        let mut rows = Self::span(rows, self.blocks.len() / self.columns);
        rows.any(|row| self.blocks[row * self.columns..][columns.clone()].contains(&true))
    }
}

/// Sites sorted into square buckets of `1 << shift` px; sites outside the frame lie in its border buckets.
#[derive(Debug, Default)]
struct Buckets {
    columns: i32,
    rows: i32,
    shift: u32,
    /// Where each bucket begins in `order`; one more than there are buckets.
    starts: Vec<u32>,
    /// Site indices, bucket by bucket.
    order: Vec<u32>,
}

/// How far a splat reaches and how its keys are packed.
#[derive(Clone, Copy)]
struct Window {
    /// Every pixel within this distance of a site, px, is in the site's window.
    reach: i32,
    /// Pixels across: 2·reach + 1 and up to full vectors.
    across: usize,
    /// Low bits of a key that hold the index.
    bits: u32,
}

impl Window {
    /// The window for `count` sites over `area` pixels.
    fn new(area: usize, count: usize) -> Self {
        let bits = u32::BITS - (count as u32 - 1).leading_zeros();
        let spacing = (area as f64 / count as f64).sqrt();
        let mut reach = (spacing * 1.25) as i32;
        loop {
            let across = ((2 * reach + 1) as usize).next_multiple_of(8);
            let (dx, dy) = (LATTICE as u64 * (across as u64 + 1), LATTICE as u64 * (reach as u64 + 1));
            let fits = (dx * dx + dy * dy) >> (u32::BITS - bits.min(31)) == 0 && across <= WIDEST;
            if fits || reach == 0 {
                return Self { reach: if fits { reach } else { -1 }, across, bits };
            }
            reach -= 1;
        }
    }

    /// Columns of junk beside a frame's, for windows and blocks that overlap its sides.
    fn margin(self) -> usize {
        self.across.max(BLOCK)
    }

    /// The largest key that is proven by the window.
    fn proven(self) -> u32 {
        let reach = (LATTICE * self.reach) as u32;
        (reach * reach) << self.bits | ((1 << self.bits) - 1)
    }
}

impl Voronoi {
    /// Labels every pixel of a frame of `size` with the index of its nearest site (x, y in lattice steps, at most
    /// [`FARTHEST`] from 0). Without sites every label is 0. Allocates only when a size or a count grows.
    pub fn run(&mut self, level: Level, size: Size, sites: &[[i32; 2]]) {
        let count = sites.len().max(1);
        let window = Window::new(size.area().max(1), count);
        self.margin = window.margin();
        self.keys.resize(Size::new(size.width + 2 * self.margin, size.height), 0);
        if sites.is_empty() || size.area() == 0 {
            self.keys.fill(0);
            self.forget();
            return;
        }
        if !self.find_stale(size, sites, window) {
            return;
        }
        self.buckets.sort(size, sites);
        let Self { buckets, stale, strayed, .. } = self;
        let work = Work { window, sites, buckets, stale, strayed, width: size.width };
        let rows = super::band_rows(size.height, 16);
        self.keys.view_mut().par_bands(rows).for_each(|(first, band)| {
            dispatch!(level, simd => label_band(simd, work, first, band));
        });
    }

    /// Labels every pixel anew in the next call, whether or not sites move.
    pub fn forget(&mut self) {
        self.labeled.clear();
    }

    /// Takes new sites, and finds the blocks whose labels may change; false: none.
    fn find_stale(&mut self, size: Size, sites: &[[i32; 2]], window: Window) -> bool {
        let known = self.size == size && self.labeled.len() == sites.len();
        if known && self.labeled == sites {
            return false;
        }
        let strayed = self.strayed.swap(false, Ordering::Relaxed) || window.reach < 0;
        self.stale.reset(size, !known || strayed);
        if known && !strayed {
            // all is well within reach: a label changes only where a site came or went
            for (old, new) in self.labeled.iter().zip(sites).filter(|(old, new)| old != new) {
                self.stale.mark(*old, window.reach);
                self.stale.mark(*new, window.reach);
            }
        }
        self.size = size;
        self.labeled.clear();
        self.labeled.extend_from_slice(sites);
        true
    }

    /// The labels of row `y`.
    pub fn row(&self, y: usize) -> &[u32] {
        let row = self.keys.row(y);
        &row[self.margin..row.len() - self.margin]
    }
}

impl Buckets {
    fn sort(&mut self, size: Size, sites: &[[i32; 2]]) {
        let spacing = (size.area() as f64 / sites.len() as f64).sqrt();
        self.shift = 2;
        while f64::from(1 << (self.shift + 1)) <= spacing {
            self.shift += 1;
        }
        self.columns = size.width.div_ceil(1 << self.shift) as i32;
        self.rows = size.height.div_ceil(1 << self.shift) as i32;
        let count = (self.columns * self.rows) as usize;
        self.starts.clear();
        self.starts.resize(count + 1, 0);
        self.order.resize(sites.len(), 0);
        for &site in sites {
            let bucket = self.of(site);
            self.starts[bucket] += 1;
        }
        let mut end = 0;
        for start in &mut self.starts {
            end += *start;
            *start = end;
        }
        for (index, &site) in sites.iter().enumerate().rev() {
            let start = self.of(site);
            self.starts[start] -= 1;
            self.order[self.starts[start] as usize] = index as u32;
        }
    }

    /// The bucket of a site.
    #[inline(always)]
    fn of(&self, [x, y]: [i32; 2]) -> usize {
        (self.row_of(y) * self.columns + (x >> (self.shift + 4)).clamp(0, self.columns - 1)) as usize
    }

    #[inline(always)]
    fn row_of(&self, y: i32) -> i32 {
        (y >> (self.shift + 4)).clamp(0, self.rows - 1)
    }

    /// The sites in columns `from..=to` of bucket row `row`.
    #[inline(always)]
    fn span(&self, row: i32, from: i32, to: i32) -> &[u32] {
        let at = |column: i32| self.starts[(row * self.columns + column) as usize] as usize;
        &self.order[at(from)..at(to + 1)]
    }

    /// The site nearest to (`x`, `y`) in lattice steps, inside the frame.
    fn nearest(&self, sites: &[[i32; 2]], x: i32, y: i32) -> u32 {
        let side = self.shift + 4;
        let (column, row) = ((x >> side).min(self.columns - 1), (y >> side).min(self.rows - 1));
        let mut best = (i64::MAX, u32::MAX);
        for ring in 0..=self.columns.max(self.rows) {
            let (left, right) = (column - ring, column + ring);
            for r in (row - ring).max(0)..=(row + ring).min(self.rows - 1) {
                let rim = (r - row).abs() == ring;
                let mut look = |from: i32, to: i32| {
                    for &index in self.span(r, from, to) {
                        let [sx, sy] = sites[index as usize];
                        let (dx, dy) = (i64::from(sx - x), i64::from(sy - y));
                        best = best.min((dx * dx + dy * dy, index));
                    }
                };
                if rim {
                    look(left.max(0), right.min(self.columns - 1));
                } else {
                    for c in [left, right] {
                        if (0..self.columns).contains(&c) {
                            look(c, c);
                        }
                    }
                }
            }
            // every site left is outside the ring's square, unless that side has no more buckets
            let gap = |beyond: bool, gap: i32| if beyond { i64::from(gap) } else { i64::MAX >> 33 };
            let gap = gap(left > 0, x - (left << side))
                .min(gap(right + 1 < self.columns, ((right + 1) << side) - x))
                .min(gap(row - ring > 0, y - ((row - ring) << side)))
                .min(gap(row + ring + 1 < self.rows, ((row + ring + 1) << side) - y));
            if best.0 < gap * gap {
                break;
            }
        }
        best.1
    }
}

/// Borrowed inputs of a band.
#[derive(Clone, Copy)]
struct Work<'a> {
    window: Window,
    sites: &'a [[i32; 2]],
    buckets: &'a Buckets,
    stale: &'a Stale,
    strayed: &'a AtomicBool,
    width: usize,
}

#[inline(always)]
fn label_band<S: Simd>(simd: S, work: Work<'_>, first: usize, mut keys: PlaneMut<'_, u32>) {
    let Work { window, sites, buckets, stale, strayed, width } = work;
    let margin = window.margin();
    let height = keys.size().height;
    let blocks = |y: usize| stale.blocks[(first + y) / BLOCK * stale.columns..][..stale.columns].iter();
    for y in 0..height {
        let row = &mut keys.row_mut(y)[margin..][..width.next_multiple_of(BLOCK)];
        for (keys, _) in row.chunks_exact_mut(BLOCK).zip(blocks(y)).filter(|(_, stale)| **stale) {
            keys.fill(u32::MAX);
        }
    }
    if window.reach >= 0 {
        let (first, last) = (first as i32, (first + height) as i32 - 1);
        let top = buckets.row_of((first - window.reach - 1) * LATTICE);
        let bottom = buckets.row_of((last + window.reach + 1) * LATTICE);
        for row in top..=bottom {
            for &index in buckets.span(row, 0, buckets.columns - 1) {
                let [x, y] = sites[index as usize];
                let left = (x >> 4) - window.reach;
                let rows = [(y >> 4) - window.reach, (y >> 4) + window.reach];
                if stale.any([left, left + window.across as i32 - 1], rows) {
                    splat(simd, window, [x, y], index, [first, last], width, &mut keys);
                }
            }
        }
    }
    let (proven, mask) = (u32x8::splat(simd, window.proven()), (1u32 << window.bits) - 1);
    let lanes = u32x8::splat(simd, mask);
    for y in 0..height {
        let row = &mut keys.row_mut(y)[margin..][..width.next_multiple_of(BLOCK)];
        let blocks = row.chunks_exact_mut(BLOCK).zip(blocks(y)).enumerate().filter(|(_, (_, stale))| **stale);
        for (block, (keys, _)) in blocks {
            for (half, keys) in keys.chunks_exact_mut(8).enumerate() {
                let key = u32x8::from_slice(simd, keys);
                if window.reach >= 0 && !simd.any_true_mask32x8(simd.simd_gt_u32x8(key, proven)) {
                    (key & lanes).store_slice(keys);
                    continue;
                }
                for (lane, key) in keys.iter_mut().enumerate() {
                    let at = |pixel: usize| pixel as i32 * LATTICE + LATTICE / 2;
                    let x = BLOCK * block + 8 * half + lane;
                    if window.reach >= 0 && *key <= window.proven() {
                        *key &= mask;
                    } else if x < width {
                        strayed.store(true, Ordering::Relaxed);
                        *key = buckets.nearest(sites, at(x), at(first + y));
                    }
                }
            }
        }
    }
}

/// Offers one site to the pixels of its window. Labels of pixels that are not stale stay: as keys they are those of
/// distance 0, which only a nearer site could undercut.
#[inline(always)]
fn splat<S: Simd>(
    simd: S,
    window: Window,
    [x, y]: [i32; 2],
    index: u32,
    [first, last]: [i32; 2],
    width: usize,
    keys: &mut PlaneMut<'_, u32>,
) {
    let (left, middle) = ((x >> 4) - window.reach, y >> 4);
    let (top, bottom) = ((middle - window.reach).max(first), (middle + window.reach).min(last));
    if top > bottom || left >= width as i32 || left + window.across as i32 <= 0 {
        return;
    }
    let from = (left + window.margin() as i32) as usize;
    let lanes = u32x8::from_slice(simd, &[0, 16, 32, 48, 64, 80, 96, 112]);
    let start = (left * LATTICE + LATTICE / 2 - x) as u32;
    // three vectors at a time, which hold the window of the usual 8 px cells
    for block in (0..window.across).step_by(24) {
        // differences wrap, their squares do not
        let dx = lanes + start.wrapping_add(16 * block as u32);
        let (dx1, dx2) = (dx + 128, dx + 256);
        let shift = window.bits;
        let across = [(dx * dx) << shift, (dx1 * dx1) << shift, (dx2 * dx2) << shift];
        let vectors = (window.across - block).min(24) / 8;
        for row in top..=bottom {
            let dy = row * LATTICE + LATTICE / 2 - y;
            let down = u32x8::splat(simd, ((dy * dy) as u32) << window.bits | index);
            let row = &mut keys.row_mut((row - first) as usize)[from + block..][..8 * vectors];
            if let Some(row) = row.first_chunk_mut::<24>() {
                offer(simd, &mut row[..8], across[0] + down);
                offer(simd, &mut row[8..16], across[1] + down);
                offer(simd, &mut row[16..], across[2] + down);
            } else {
                for (keys, &across) in row.chunks_exact_mut(8).zip(&across) {
                    offer(simd, keys, across + down);
                }
            }
        }
    }
}

/// Keeps the lesser keys of eight.
#[inline(always)]
fn offer<S: Simd>(simd: S, keys: &mut [u32], offer: u32x8<S>) {
    u32x8::from_slice(simd, keys).min(offer).store_slice(keys);
}

/// The label of the pixel at column `x`, row `y` by looking at every site.
pub fn reference(sites: &[[i32; 2]], x: usize, y: usize) -> u32 {
    let at = |pixel: usize| pixel as i64 * i64::from(LATTICE) + i64::from(LATTICE / 2);
    let distance = |site: &[i32; 2]| {
        let (dx, dy) = (i64::from(site[0]) - at(x), i64::from(site[1]) - at(y));
        dx * dx + dy * dy
    };
    (0..sites.len()).min_by_key(|&i| distance(&sites[i])).unwrap_or(0) as u32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::sweep;
    use crate::pixels::SplitMix64;

    /// Sites of many temperaments: jittered, crowded in a corner, doubled, far outside, on one line, alone.
    fn sites(kind: &str, size: Size, rng: &mut SplitMix64) -> Vec<[i32; 2]> {
        let (w, h) = (16 * size.width as i64, 16 * size.height as i64);
        let count = (size.area() / 64).max(1);
        (0..count)
            .map(|i| match kind {
                "anywhere" => [rng.int(0, w) as i32, rng.int(0, h) as i32],
                "corner" => [rng.int(0, w / 8) as i32, rng.int(0, h / 8) as i32],
                "pixels" => [16 * rng.int(0, w / 16) as i32, 16 * rng.int(0, h / 16) as i32],
                "doubled" => [(i as i64 / 2 * 97 % (w + 1)) as i32, (i as i64 / 2 * 31 % (h + 1)) as i32],
                "outside" => [rng.int(-3 * w, 4 * w) as i32, rng.int(-3 * h, 4 * h) as i32],
                "far" => [FARTHEST, -FARTHEST],
                _ => [rng.int(0, w) as i32, (h / 2) as i32],
            })
            .collect()
    }

    #[test]
    fn labels_stay_exact_while_sites_move() {
        let mut rng = SplitMix64::new(5);
        for (w, h) in [(16, 16), (33, 31), (100, 75)] {
            let size = Size::new(w, h);
            for kind in ["anywhere", "corner", "doubled", "outside"] {
                let films = (0..6).scan(sites(kind, size, &mut rng), |sites, frame| {
                    let film = sites.clone();
                    for site in sites.iter_mut().step_by(1 + 7 * (frame % 3)) {
                        let far = if frame == 4 { 400 } else { 40 };
                        *site = site.map(|v| v + rng.int(-far, far) as i32);
                    }
                    Some(film)
                });
                let films: Vec<_> = films.collect();
                sweep::everywhere(kind, |level| {
                    let mut voronoi = Voronoi::default();
                    for (frame, sites) in films.iter().enumerate() {
                        voronoi.run(level, size, sites);
                        for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
                            let nearest = reference(sites, x, y);
                            assert_eq!(voronoi.row(y)[x], nearest, "{kind} {size} {frame}: ({x}, {y})");
                        }
                    }
                    0
                });
            }
        }
    }

    #[test]
    fn labels_are_exact_for_any_sites() {
        let mut rng = SplitMix64::new(3);
        for (w, h) in [(1, 1), (2, 5), (9, 4), (16, 16), (33, 31), (67, 45), (160, 120)] {
            let size = Size::new(w, h);
            for kind in ["anywhere", "corner", "pixels", "doubled", "outside", "far", "line", "one", "many"] {
                let mut sites = match kind {
                    "many" => (0..4).flat_map(|_| sites("anywhere", size, &mut rng)).collect(),
                    kind => sites(kind, size, &mut rng),
                };
                if kind == "one" {
                    sites.truncate(1);
                }
                let found = sweep::everywhere(kind, |level| {
                    let mut voronoi = Voronoi::default();
                    voronoi.run(level, size, &sites);
                    Plane::from_fn(size, |x, y| voronoi.row(y)[x])
                });
                for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
                    assert_eq!(found.at(x, y), reference(&sites, x, y), "{kind} {size}: ({x}, {y})");
                }
            }
        }
    }
}
