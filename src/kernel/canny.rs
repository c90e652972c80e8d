//! Canny's edges as OpenCV draws them (aperture 3, L1 norm) on an 8-bit gray picture, and their 3x3 dilation.
//!
//! Gray is (9798R + 19235G + 3735B + 2^14) >> 15. Everything is integer and exact:
//!
//! 1. Gradients are Sobel's on clamped borders, the magnitude |gx| + |gy|; outside the picture it is 0.
//! 2. A pixel above the low threshold that is a maximum across the edge is a candidate. OpenCV sorts directions by
//!    |gy|·2^15 < 13573·|gx| (tan 22.5°) and |gy|·2^15 > (13573 + 2^16)·|gx|. With q = ⌊13573·|gx| / 2^15⌋ these are
//!    |gy| <= q and |gy| - 2|gx| > q, and q = (53·|gx| + (5·|gx| >> 8)) >> 7 fits 16 bits: sixteen pixels at a time.
//! 3. Candidates above the high threshold are edges, and so is every candidate that touches an edge. The result is
//!    a set, whatever the order; each pixel enters the stack at most once.
#![allow(clippy::needless_range_loop)] // rows and lanes index several arrays in step

use super::sobel::Lines;
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, Rgb, Size};
use fearless_simd::{Bytes, Simd, SimdBase, i16x16, u16x16};
use rayon::prelude::*;

/// Samples before the first of a row of the map or of magnitudes: never an edge.
const MARGIN: usize = 16;
const WEAK: u8 = 1;
const STRONG: u8 = 2;

/// The detector with its buffers; keep it from frame to frame.
#[derive(Clone, Debug, Default)]
pub struct Canny {
    stride: usize,
    gray: Plane<u8>,
    /// 0, [`WEAK`] or [`STRONG`], with a margin of zeros all round.
    map: Vec<u8>,
    stack: Vec<u32>,
    scratch: Vec<Scratch>,
}

/// What one band works in: three rows of gray and of magnitudes, two of gradients.
#[derive(Clone, Debug, Default)]
struct Scratch {
    lines: Lines,
    magnitudes: Vec<i16>,
    gradients: Vec<i16>,
}

impl Canny {
    /// Finds the candidates of `picture`; thresholds as OpenCV's, 0 or more, `low <= high`. Allocates only when the
    /// size or the thread count changes.
    pub fn mark(&mut self, level: Level, picture: &Rgb, low: i16, high: i16) {
        let size = picture.size();
        self.fit(size);
        if size.area() == 0 {
            return;
        }
        let band = super::band_rows(size.height, 8);
        self.gray.view_mut().par_bands(band).for_each(|(first, mut gray)| {
            for y in 0..gray.size().height {
                let rgb = [0, 1, 2].map(|c| picture.planes[c].row(first + y));
                dispatch!(level, simd => gray_row(simd, rgb, gray.row_mut(y)));
            }
        });
        let bands = size.height.div_ceil(band);
        if self.scratch.len() < bands {
            self.scratch.resize_with(bands, Scratch::default);
        }
        let (stride, gray) = (self.stride, &self.gray);
        for scratch in &mut self.scratch[..bands] {
            scratch.lines.fit(size.width);
            scratch.magnitudes.resize(3 * stride, 0);
            scratch.gradients.resize(4 * stride, 0);
        }
        let map = &mut self.map[stride..stride * (size.height + 1)];
        map.par_chunks_mut(stride * band).zip(&mut self.scratch).enumerate().for_each(
            |(i, (map, scratch))| {
                dispatch!(level, simd => mark_band(simd, gray, i * band, [low, high], scratch, stride, map));
            },
        );
    }

    fn fit(&mut self, size: Size) {
        if self.gray.size() != size {
            self.stride = MARGIN + size.width.next_multiple_of(16) + MARGIN;
            self.gray.resize(size, 0);
            self.map.clear();
            self.map.resize(self.stride * (size.height + 2), 0);
            // the worst case: every pixel is a candidate
            self.stack.clear();
            self.stack.reserve_exact(size.area());
            // rows of another length would leave magnitudes in the margins
            self.scratch.iter_mut().for_each(|scratch| scratch.magnitudes.clear());
        }
    }

    /// Hysteresis: candidates that touch an edge, directly or by way of others, become edges.
    pub fn connect(&mut self) {
        let size = self.gray.size();
        if size.area() == 0 {
            return;
        }
        let (stride, map, stack) = (self.stride, &mut self.map, &mut self.stack);
        stack.clear();
        let reach = [1, stride - 1, stride, stride + 1];
        for y in 1..=size.height {
            let from = y * stride + MARGIN;
            for block in (from..from + size.width).step_by(16) {
                let seen = map[block..block + 16].iter().fold(0, |seen, &value| seen | value);
                if seen & WEAK == 0 {
                    continue;
                }
                for at in block..block + 16 {
                    if map[at] == WEAK && reach.iter().any(|d| map[at - d] | map[at + d] >= STRONG) {
                        map[at] = STRONG;
                        stack.push(at as u32);
                    }
                }
            }
        }
        while let Some(at) = stack.pop() {
            for d in reach {
                for next in [at as usize - d, at as usize + d] {
                    if map[next] == WEAK {
                        map[next] = STRONG;
                        stack.push(next as u32);
                    }
                }
            }
        }
    }

    /// Whether (`x`, `y`) is on an edge line, one pixel wide. Panics outside the picture.
    pub fn is_edge(&self, x: usize, y: usize) -> bool {
        let size = self.gray.size();
        assert!(x < size.width && y < size.height, "inside the picture");
        self.map[(y + 1) * self.stride + MARGIN + x] == STRONG
    }

    /// Row `y` of the picture's dilated edges, 0 on them and 255 elsewhere; `out` is as wide as the picture.
    #[inline(always)]
    pub fn inverted_row(&self, y: usize, out: &mut [u8]) {
        let n = out.len();
        let [a, b, c] = [0, 1, 2].map(|d| &self.map[(y + d) * self.stride + MARGIN - 1..][..n + 2]);
        for i in 0..n {
            let above = a[i] | a[i + 1] | a[i + 2];
            let here = b[i] | b[i + 1] | b[i + 2];
            let below = c[i] | c[i + 1] | c[i + 2];
            out[i] = if (above | here | below) & STRONG == 0 { 255 } else { 0 };
        }
    }
}

#[inline(always)]
fn gray_row<S: Simd>(_simd: S, [r, g, b]: [&[u8]; 3], out: &mut [u8]) {
    let n = out.len();
    let (r, g, b) = (&r[..n], &g[..n], &b[..n]);
    for i in 0..n {
        out[i] = gray([r[i], g[i], b[i]]);
    }
}

/// OpenCV's gray of a color.
#[inline(always)]
pub fn gray([r, g, b]: [u8; 3]) -> u8 {
    ((9798 * u32::from(r) + 19235 * u32::from(g) + 3735 * u32::from(b) + (1 << 14)) >> 15) as u8
}

/// Marks the candidates of the rows from `first` that `map` holds.
#[inline(always)]
fn mark_band<S: Simd>(
    simd: S,
    gray: &Plane<u8>,
    first: usize,
    thresholds: [i16; 2],
    scratch: &mut Scratch,
    stride: usize,
    map: &mut [u8],
) {
    let height = gray.size().height;
    let width = gray.size().width;
    let rows = map.len() / stride;
    let row = |y: usize| gray.row(y.saturating_sub(1).min(height - 1));
    // numbers in the rings: one above the row's own, so that the row above the picture is 0
    let Scratch { lines, magnitudes, gradients } = scratch;
    let from = first.saturating_sub(1);
    lines.push(from, row(from));
    lines.push(from + 1, row(from + 1));
    if first == 0 {
        magnitudes[..stride].fill(0);
    }
    for y in from..first + rows + 1 {
        let ring = (y + 1) % 3 * stride;
        let line = &mut magnitudes[ring..ring + stride];
        if y < height {
            lines.push(y + 2, row(y + 2));
            let (gx, gy) = gradients[y % 2 * 2 * stride..][..2 * stride].split_at_mut(stride);
            for x in (0..width).step_by(16) {
                let [dx, dy] = lines.gradient(simd, y, x);
                dx.store_slice(&mut gx[MARGIN + x..MARGIN + x + 16]);
                dy.store_slice(&mut gy[MARGIN + x..MARGIN + x + 16]);
                let sum = dx.max(-dx) + dy.max(-dy);
                sum.store_slice(&mut line[MARGIN + x..MARGIN + x + 16]);
            }
            line[MARGIN + width..].fill(0);
        } else {
            line.fill(0);
        }
        if y > first {
            let out = &mut map[(y - 1 - first) * stride..][..stride];
            let (gx, gy) = gradients[(y - 1) % 2 * 2 * stride..][..2 * stride].split_at(stride);
            let above = &magnitudes[(y - 1) % 3 * stride..][..stride];
            let here = &magnitudes[y % 3 * stride..][..stride];
            let below = &magnitudes[(y + 1) % 3 * stride..][..stride];
            mark_row(simd, [above, here, below], [gx, gy], thresholds, width, out);
        }
    }
}

/// Non-maximum suppression of one row.
#[inline(always)]
fn mark_row<S: Simd>(
    simd: S,
    [above, here, below]: [&[i16]; 3],
    [gx, gy]: [&[i16]; 2],
    [low, high]: [i16; 2],
    width: usize,
    out: &mut [u8],
) {
    let zero = i16x16::splat(simd, 0);
    for x in (MARGIN..MARGIN + width).step_by(16) {
        let m = i16x16::from_slice(simd, &here[x..x + 16]);
        let enough = simd.simd_gt_i16x16(m, i16x16::splat(simd, low));
        let out = &mut out[x..x + 16];
        if !simd.any_true_mask16x16(enough) {
            out.fill(0);
            continue;
        }
        let dx = i16x16::from_slice(simd, &gx[x..x + 16]);
        let dy = i16x16::from_slice(simd, &gy[x..x + 16]);
        let (across, down) = (dx.max(-dx), dy.max(-dy));
        let wide: u16x16<S> = across.bitcast();
        let q = (wide * u16x16::splat(simd, 53) + ((wide * u16x16::splat(simd, 5)) >> 8)) >> 7;
        let q: i16x16<S> = q.bitcast();
        let flat = simd.simd_le_i16x16(down, q);
        let steep = simd.simd_gt_i16x16(down - (across + across), q);
        let falling = simd.simd_lt_i16x16(dx ^ dy, zero);

        let up = [-1, 0, 1].map(|d: isize| x.wrapping_add_signed(d));
        let before = i16x16::from_slice(simd, &here[up[0]..up[0] + 16]);
        let after = i16x16::from_slice(simd, &here[up[2]..up[2] + 16]);
        let a0 = i16x16::from_slice(simd, &above[up[0]..up[0] + 16]);
        let a1 = i16x16::from_slice(simd, &above[up[1]..up[1] + 16]);
        let a2 = i16x16::from_slice(simd, &above[up[2]..up[2] + 16]);
        let b0 = i16x16::from_slice(simd, &below[up[0]..up[0] + 16]);
        let b1 = i16x16::from_slice(simd, &below[up[1]..up[1] + 16]);
        let b2 = i16x16::from_slice(simd, &below[up[2]..up[2] + 16]);
        // the neighbor that must be smaller, and the one that may be equal on flat and steep gradients: m >= v is
        // m > v - 1
        let one = i16x16::splat(simd, 1);
        let first = simd.select_i16x16(falling, a2, a0);
        let second = simd.select_i16x16(falling, b0, b2);
        let first = simd.select_i16x16(steep, a1, first);
        let second = simd.select_i16x16(steep, b1 - one, second);
        let first = simd.select_i16x16(flat, before, first);
        let second = simd.select_i16x16(flat, after - one, second);
        let larger = first.max(second);
        let candidate = enough & simd.simd_gt_i16x16(m, larger);
        let strong = simd.simd_gt_i16x16(m, i16x16::splat(simd, high));
        let kind = simd.select_i16x16(
            strong,
            i16x16::splat(simd, i16::from(STRONG)),
            i16x16::splat(simd, i16::from(WEAK)),
        );
        let words: u16x16<S> = simd.select_i16x16(candidate, kind, zero).bitcast();
        let (first, second) = simd.split_u16x16(words);
        simd.saturating_narrow_u16x8(first, second).store_slice(out);
    }
}

/// The plain form, pixel by pixel as OpenCV's source reads: thin edges of a gray picture.
pub fn reference(gray: &Plane<u8>, low: i32, high: i32) -> Plane<bool> {
    let size = gray.size();
    let (w, h) = (size.width as isize, size.height as isize);
    let at = |x: isize, y: isize| i32::from(gray.at(x.clamp(0, w - 1) as usize, y.clamp(0, h - 1) as usize));
    let gradient = |x: isize, y: isize| {
        let column = |x: isize| at(x, y - 1) + 2 * at(x, y) + at(x, y + 1);
        let row = |y: isize| at(x - 1, y) + 2 * at(x, y) + at(x + 1, y);
        [column(x + 1) - column(x - 1), row(y + 1) - row(y - 1)]
    };
    let magnitude = |x: isize, y: isize| {
        let inside = (0..w).contains(&x) && (0..h).contains(&y);
        if inside { gradient(x, y).iter().map(|g| g.abs()).sum() } else { 0 }
    };
    const TG22: i64 = 13573;
    let mut candidates = Plane::new(size, false);
    let mut edges = Plane::new(size, false);
    let mut stack = Vec::new();
    for (x, y) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))) {
        let m = magnitude(x, y);
        if m <= low {
            continue;
        }
        let [xs, ys] = gradient(x, y);
        let (ax, ay) = (i64::from(xs.abs()), i64::from(ys.abs()) << 15);
        let maximum = if ay < ax * TG22 {
            m > magnitude(x - 1, y) && m >= magnitude(x + 1, y)
        } else if ay > ax * TG22 + (ax << 16) {
            m > magnitude(x, y - 1) && m >= magnitude(x, y + 1)
        } else {
            let s = if (xs ^ ys) < 0 { -1 } else { 1 };
            m > magnitude(x - s, y - 1) && m > magnitude(x + s, y + 1)
        };
        if maximum {
            candidates.row_mut(y as usize)[x as usize] = true;
            if m > high {
                edges.row_mut(y as usize)[x as usize] = true;
                stack.push((x, y));
            }
        }
    }
    while let Some((x, y)) = stack.pop() {
        for (nx, ny) in (y - 1..=y + 1).flat_map(|ny| (x - 1..=x + 1).map(move |nx| (nx, ny))) {
            let inside = (0..w).contains(&nx) && (0..h).contains(&ny);
            if inside && candidates.at(nx as usize, ny as usize) && !edges.at(nx as usize, ny as usize) {
                edges.row_mut(ny as usize)[nx as usize] = true;
                stack.push((nx, ny));
            }
        }
    }
    edges
}

/// 3x3 dilation, nothing outside the picture.
pub fn dilate_reference(edges: &Plane<bool>) -> Plane<bool> {
    let size = edges.size();
    Plane::from_fn(size, |x, y| {
        let rows = y.saturating_sub(1)..(y + 2).min(size.height);
        rows.into_iter().any(|y| (x.saturating_sub(1)..(x + 2).min(size.width)).any(|x| edges.at(x, y)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::sweep;

    #[test]
    fn thin_and_dilated_edges_match_the_reference_exactly() {
        for case in sweep::cases() {
            let size = case.plane.size();
            let turned = Plane::from_fn(size, |x, y| case.plane.at(x, size.height - 1 - y) / 2 + 90);
            let picture = Rgb { planes: [case.plane.clone(), case.plane.clone(), turned] };
            let gray = Plane::from_fn(size, |x, y| gray(picture.at(x, y)));
            for (low, high) in [(105, 150), (0, 0), (0, 2040), (20, 400)] {
                let thin = reference(&gray, low.into(), high.into());
                let thick = dilate_reference(&thin);
                let truth = (thin, Plane::from_fn(size, |x, y| if thick.at(x, y) { 0 } else { 255 }));
                let found = sweep::everywhere(&case.label, |level| {
                    let mut canny = Canny::default();
                    // another size first: nothing of it may show
                    canny.mark(level, &Rgb::new(Size::new(40, 3), [9, 200, 30]), 0, 0);
                    canny.mark(level, &picture, low, high);
                    canny.connect();
                    let mut inverted = Plane::new(size, 0);
                    (0..size.height).for_each(|y| canny.inverted_row(y, inverted.row_mut(y)));
                    (Plane::from_fn(size, |x, y| canny.is_edge(x, y)), inverted)
                });
                assert!(found == truth, "{}: thresholds {low}, {high}", case.label);
            }
        }
    }

    #[test]
    fn sixteen_bits_sort_directions_as_opencv_does() {
        for x in 0..=1020u32 {
            let q = ((53 * x) + ((5 * x) >> 8)) >> 7;
            assert!(53 * x + ((5 * x) >> 8) <= u32::from(u16::MAX));
            for y in (0..=1020u32).filter(|&y| x + y > 0) {
                let (tall, tangent) = (u64::from(y) << 15, 13573 * u64::from(x));
                assert_eq!(y <= q && x > 0, tall < tangent, "({x}, {y})");
                assert_eq!(
                    y as i32 - 2 * x as i32 > q as i32,
                    tall > tangent + (u64::from(x) << 16),
                    "({x}, {y})"
                );
                assert!(x > 0 || y > q, "x = 0 never counts as flat");
            }
        }
    }
}
