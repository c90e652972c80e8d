//! Gray picture → one bit a pixel: darker than its surroundings.
//!
//! Comes in: the luma plane. Goes out: a `Mask` of the pixels below the middle of their neighborhood's range,
//! where that range stands clear of the noise; flat neighborhoods give no bits at all, so that a calm wall
//! costs nothing. Local contrast on 4x4 tiles dilated 3x3 as in AprilTag (Wang & Olson 2016, §III-A), but the
//! limit of flatness follows the frame's measured noise instead of a fixed number of gray levels.

use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{PlaneRef, Size};
use fearless_simd::{prelude::*, u8x16, u8x64, u32x16};
use rayon::prelude::*;

/// Side of a tile, px.
const TILE: usize = 4;
/// Pixels and tiles in one mask word.
const WORD: usize = 64;
const WORD_TILES: usize = WORD / TILE;
/// Tile rows a task takes.
const BAND: usize = 12;

/// One bit a pixel, rows of 64-bit words, bit 0 leftmost; bits past the width are 0.
#[derive(Debug, Default)]
pub struct Mask {
    words: Vec<u64>,
    per_row: usize,
    width: usize,
    height: usize,
}

impl Mask {
    /// Width and height in pixels.
    pub fn size(&self) -> Size {
        Size::new(self.width, self.height)
    }

    /// The words of row `y`. Panics when `y` is outside.
    pub fn row(&self, y: usize) -> &[u64] {
        &self.words[y * self.per_row..][..self.per_row]
    }

    /// Whether the pixel is set; everything outside the picture is not.
    #[inline]
    pub fn is_set(&self, x: i32, y: i32) -> bool {
        // a negative coordinate becomes a huge one
        let (x, y) = (x as u32 as usize, y as u32 as usize);
        x < self.width && y < self.height && (self.words[y * self.per_row + x / WORD] >> (x % WORD)) & 1 == 1
    }
}

/// The thresholding stage with its buffers.
#[derive(Debug, Default)]
pub struct Threshold {
    /// Least and greatest gray of each tile, with one neutral tile around (255 and 0), rows padded to whole
    /// mask words.
    low: Vec<u8>,
    high: Vec<u8>,
    stride: usize,
    mask: Mask,
    limit: u8,
}

impl Threshold {
    /// Thresholds a picture; the mask stays valid until the next call. Allocates only when the size grows.
    pub fn apply(&mut self, luma: PlaneRef<'_, u8>, least_contrast: u8, level: Level) -> &Mask {
        self.fit(luma.size());
        let Size { width, height } = luma.size();
        if width == 0 || height == 0 {
            return &self.mask;
        }
        let stride = self.stride;
        let inner = stride..stride * (height.div_ceil(TILE) + 1);
        let low = self.low[inner.clone()].par_chunks_mut(stride * BAND);
        let high = self.high[inner].par_chunks_mut(stride * BAND);
        low.zip(high).enumerate().for_each(|(band, (low, high))| {
            dispatch!(level, simd => tiles(simd, luma, band * BAND, stride, low, high));
        });

        self.limit = self.flatness(width.div_ceil(TILE), height.div_ceil(TILE), least_contrast);
        let (low, high, limit, per_row) = (&self.low[..], &self.high[..], self.limit, self.mask.per_row);
        self.mask.words.par_chunks_mut(per_row * TILE * BAND).enumerate().for_each(|(band, words)| {
            dispatch!(level, simd => bits(simd, luma, band * BAND, stride, low, high, limit, words));
        });
        &self.mask
    }

    /// The mask of the last picture.
    pub fn mask(&self) -> &Mask {
        &self.mask
    }

    #[cfg(test)]
    /// The gray range below which the last picture's neighborhoods counted as flat.
    pub fn limit(&self) -> u8 {
        self.limit
    }

    fn fit(&mut self, size: Size) {
        if self.mask.size() == size {
            return;
        }
        let per_row = size.width.div_ceil(WORD);
        let rows = size.height.div_ceil(TILE) + 2;
        self.stride = per_row * WORD_TILES + 2;
        for (plane, neutral) in [(&mut self.low, 255), (&mut self.high, 0)] {
            plane.clear();
            plane.resize(self.stride * rows, neutral);
        }
        self.mask.words.clear();
        self.mask.words.resize(per_row * size.height, 0);
        (self.mask.per_row, self.mask.width, self.mask.height) = (per_row, size.width, size.height);
    }

    /// The limit of flatness from the noise: a tenth of all tiles show a range below `r`; in white noise of
    /// deviation σ that is 2.6 σ, while 144 such samples (3x3 tiles) span less than 7.5 σ in 999 of 1000
    /// places. Where no tenth of the picture is flat, `r` is texture: hence the upper bound. Tiles that
    /// touch 0 or 255 are clipped and say nothing about noise.
    fn flatness(&self, columns: usize, rows: usize, least_contrast: u8) -> u8 {
        let mut histogram = [0u32; 256];
        for row in 0..rows {
            let from = (row + 1) * self.stride + 1;
            let (low, high) = (&self.low[from..][..columns], &self.high[from..][..columns]);
            // every other tile is plenty
            for (low, high) in low.iter().zip(high).skip(row & 1).step_by(2) {
                if *low > 0 && *high < 255 {
                    histogram[usize::from(high - low)] += 1;
                }
            }
        }
        let tenth = histogram.iter().sum::<u32>() / 10;
        let mut below = 0;
        let quiet = histogram.iter().position(|&count| {
            below += count;
            below > tenth
        });
        let noise = quiet.unwrap_or(0) * 29 / 10;
        noise.clamp(usize::from(least_contrast), MOST_NOISE) as u8
    }
}

/// No noise hides a contrast of this many gray levels.
const MOST_NOISE: usize = 80;

/// Least and greatest gray of the tiles in a band of tile rows.
#[inline(always)]
fn tiles<S: Simd>(
    simd: S,
    luma: PlaneRef<'_, u8>,
    first: usize,
    stride: usize,
    low: &mut [u8],
    high: &mut [u8],
) {
    let Size { width, height } = luma.size();
    for (i, (low, high)) in low.chunks_exact_mut(stride).zip(high.chunks_exact_mut(stride)).enumerate() {
        let top = (first + i) * TILE;
        let row = |k: usize| luma.row((top + k).min(height - 1));
        let rows = [row(0), row(1), row(2), row(3)];
        let mut from = 0;
        let (mut low, mut high) = (&mut low[1..], &mut high[1..]);
        while from < width {
            let count = WORD.min(width - from);
            let tiles = count.div_ceil(TILE);
            let (mut least, mut most) = (u8x64::splat(simd, 255), u8x64::splat(simd, 0));
            for row in rows {
                let row = &row[from..from + count];
                let (darkest, brightest) = if count == WORD {
                    let gray = u8x64::from_slice(simd, row);
                    (gray, gray)
                } else {
                    let (mut darkest, mut brightest) = ([255u8; WORD], [0u8; WORD]);
                    darkest[..count].copy_from_slice(row);
                    brightest[..count].copy_from_slice(row);
                    (u8x64::from_slice(simd, &darkest), u8x64::from_slice(simd, &brightest))
                };
                (least, most) = (least.min(darkest), most.max(brightest));
            }
            // the four bytes of each 32-bit lane fold into its lowest
            let fold = |v: u8x64<S>, bits: u32, pick: fn(u8x64<S>, u8x64<S>) -> u8x64<S>| {
                let lanes: u32x16<S> = v.bitcast();
                pick(v, (lanes >> bits).bitcast())
            };
            let least: u32x16<S> = fold(fold(least, 8, u8x64::min), 16, u8x64::min).bitcast();
            let most: u32x16<S> = fold(fold(most, 8, u8x64::max), 16, u8x64::max).bitcast();
            for (out, v) in low[..tiles].iter_mut().zip(least.as_slice()) {
                *out = *v as u8;
            }
            for (out, v) in high[..tiles].iter_mut().zip(most.as_slice()) {
                *out = *v as u8;
            }
            (low, high) = (&mut low[tiles..], &mut high[tiles..]);
            from += count;
        }
    }
}

/// The mask words of a band of tile rows.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "one kernel's planes, called once")]
fn bits<S: Simd>(
    simd: S,
    luma: PlaneRef<'_, u8>,
    first: usize,
    stride: usize,
    low: &[u8],
    high: &[u8],
    limit: u8,
    words: &mut [u64],
) {
    let Size { width, height } = luma.size();
    let per_row = width.div_ceil(WORD);
    for (i, words) in words.chunks_mut(per_row * TILE).enumerate() {
        let tile_row = first + i;
        for word in 0..per_row {
            let mut least = u8x16::splat(simd, 255);
            let mut most = u8x16::splat(simd, 0);
            for row in tile_row..tile_row + 3 {
                let at = row * stride + word * WORD_TILES;
                for from in at..at + 3 {
                    least = least.min(u8x16::from_slice(simd, &low[from..from + WORD_TILES]));
                    most = most.max(u8x16::from_slice(simd, &high[from..from + WORD_TILES]));
                }
            }
            // the mean rounded up, without a ninth bit
            let half = (least | most) - ((least ^ most) >> 1);
            // nothing is darker than 0: a flat tile sets no bit
            let middle = (most - least).simd_ge(limit).select(half, u8x16::splat(simd, 0));
            let (left, count) = (word * WORD, WORD.min(width - word * WORD));
            let rows = TILE.min(height - tile_row * TILE);
            if !middle.simd_gt(0).any_true() {
                for y in 0..rows {
                    words[y * per_row + word] = 0;
                }
                continue;
            }
            let mut limits = [0u32; WORD_TILES];
            for (four, &middle) in limits.iter_mut().zip(middle.as_slice()) {
                *four = u32::from(middle) * 0x0101_0101;
            }
            let limits: u8x64<S> = u32x16::from_slice(simd, &limits).bitcast();
            for y in 0..rows {
                let gray = &luma.row(tile_row * TILE + y)[left..left + count];
                let gray = if count == WORD {
                    u8x64::from_slice(simd, gray)
                } else {
                    let mut padded = [255u8; WORD];
                    padded[..count].copy_from_slice(gray);
                    u8x64::from_slice(simd, &padded)
                };
                words[y * per_row + word] = gray.simd_lt(limits).to_bitmask();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::sweep::{cases, everywhere};
    use crate::pixels::Plane;

    /// The same rule, pixel by pixel.
    fn reference(plane: &Plane<u8>, limit: u8) -> Vec<bool> {
        let Size { width, height } = plane.size();
        let mut out = Vec::new();
        for y in 0..height {
            for x in 0..width {
                let (tx, ty) = (x / 4, y / 4);
                let columns = (tx.max(1) - 1) * 4..((tx + 2) * 4).min(width);
                let (mut least, mut most) = (255, 0);
                for row in (ty.max(1) - 1) * 4..((ty + 2) * 4).min(height) {
                    for &v in &plane.row(row)[columns.clone()] {
                        (least, most) = (v.min(least), v.max(most));
                    }
                }
                let middle = (f64::from(least) + f64::from(most)) / 2.0;
                out.push(most - least >= limit && f64::from(plane.at(x, y)) < (middle + 0.5).floor());
            }
        }
        out
    }

    #[test]
    fn mask_equals_the_plain_rule_everywhere() {
        for case in cases() {
            let (bits, limit) = everywhere(&case.label, |level| {
                let mut stage = Threshold::default();
                let size = case.plane.size();
                stage.apply(case.plane.view(), 6, level);
                let bits: Vec<bool> = (0..size.height as i32)
                    .flat_map(|y| (0..size.width as i32).map(move |x| (x, y)))
                    .map(|(x, y)| stage.mask().is_set(x, y))
                    .collect();
                (bits, stage.limit())
            });
            assert!(bits == reference(&case.plane, limit), "{}", case.label);
        }
    }

    #[test]
    fn noise_alone_sets_next_to_nothing() {
        let mut rng = crate::pixels::SplitMix64::new(3);
        let size = Size::new(320, 240);
        for sigma in [2.0, 5.0, 10.0] {
            let noise = Plane::from_fn(size, |_, _| {
                let sum: f64 = (0..12).map(|_| rng.f64()).sum();
                (120.5 + sigma * (sum - 6.0)) as u8
            });
            let mut stage = Threshold::default();
            let mask = stage.apply(noise.view(), 6, Level::fallback());
            let set: u32 = (0..size.height).flat_map(|y| mask.row(y)).map(|w| w.count_ones()).sum();
            assert!(
                f64::from(set) < 0.02 * size.area() as f64,
                "σ {sigma}: {set} pixels, limit {}",
                stage.limit()
            );
        }
    }
}
