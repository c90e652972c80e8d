//! Strokes on the shade plane: every pixel's light is multiplied by what a stroke lets through.
//!
//! A stroke's coverage is clamp(half width + .5 - d, 0, 1), d being the distance to its nearest segment. Segment by
//! segment, the least squared distance of the pixels within reach is kept on a small sheet; then one pass over the
//! pixels that were touched takes the root and multiplies. Blends of black commute, so the order of strokes does not
//! matter to the picture.
//!
//! As a strip of textured quads a stroke may change its width on the way; the sheet then also keeps where along the
//! stroke the nearest place is and on which side of it the pixel lies, and the brush is looked up there.

use super::Config;
use super::brush::Brush;
use super::trace::{Point, Stroke};
use crate::pixels::Size;
use fearless_simd::{Simd, SimdBase, SimdFloat, f32x8};
use std::ops::Range;

/// Samples after the last of a sheet's or shade's row that may be written.
pub const SLACK: usize = 16;

/// The sheet one band of rows works on.
#[derive(Debug, Default)]
pub struct Sheet {
    /// Least squared distance, ∞ where no segment is within reach.
    squares: Vec<f32>,
    /// Quads only: points passed before the nearest place; above 0 on the right of the stroke.
    along: Vec<f32>,
    side: Vec<f32>,
    stride: usize,
    /// The columns touched in each row, a bit for every `1 << shift` of them.
    touched: Vec<u64>,
    shift: u32,
}

/// Rows of the shade plane, `first` being the topmost.
pub struct Rows<'a> {
    /// Light let through, 0..1, `stride` samples a row.
    pub shade: &'a mut [f32],
    /// At least `width` + [`SLACK`].
    pub stride: usize,
    /// Width of the picture, height of the band.
    pub size: Size,
    /// The picture's row that is row 0 here.
    pub first: usize,
}

impl Sheet {
    /// Makes room for the longest stroke in a band of this size; allocates only to grow.
    pub fn fit(&mut self, config: &Config, band: Size) {
        let length = f64::from(config.points - 1) * config.step + 2.0 * (2.0 * config.half_width + 0.5) + 2.0;
        let side = length.ceil() as usize;
        self.stride = side.min(band.width) + SLACK;
        let rows = side.min(band.height);
        self.shift = 2;
        while self.stride >> self.shift >= 64 {
            self.shift += 1;
        }
        if self.touched.len() < rows {
            self.touched.resize(rows, 0);
        }
        if self.squares.len() < rows * self.stride {
            self.squares.resize(rows * self.stride, f32::INFINITY);
            self.along.resize(rows * self.stride, 0.0);
            self.side.resize(rows * self.stride, 0.0);
        }
    }

    /// Draws one stroke as far as it lies in `rows`: of one width, that at its start, or with `QUADS` of textured
    /// quads.
    #[inline(always)]
    pub fn draw<S: Simd, const QUADS: bool>(
        &mut self,
        simd: S,
        config: &Config,
        stroke: Stroke<'_>,
        brush: Brush<'_>,
        rows: &mut Rows<'_>,
    ) {
        let mut half = config.half_width_at(stroke.points[0].nearness);
        if QUADS {
            for point in stroke.points {
                half = larger(half, config.half_width_at(point.nearness));
            }
        }
        let reach = half + 0.5;
        let last = (rows.first + rows.size.height) as f64 - 1.0;
        let top = (stroke.span[0] - reach).ceil().max(rows.first as f64);
        let bottom = (stroke.span[1] + reach).floor().min(last);
        if bottom < top {
            return;
        }
        let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
        for point in stroke.points {
            (least, most) = (-larger(-least, -point.at[0]), larger(most, point.at[0]));
        }
        let left = (least - reach).ceil().max(0.0);
        let right = (most + reach).floor().min(rows.size.width as f64 - 1.0);
        if right < left {
            return;
        }
        let (columns, lines) = ((right - left) as usize + 1, (bottom - top) as usize + 1);
        // from the stroke's own first row, wherever the band cuts it: places are rounded to f32, in every band alike
        let origin = (stroke.span[0] - reach).floor();
        let place = |at: [f64; 2]| [(at[0] - left) as f32, (at[1] - origin) as f32];
        let skipped = (top - origin) as usize;
        let mut from = place(stroke.points[0].at);
        for (k, point) in stroke.points[1..].iter().enumerate() {
            let to = place(point.at);
            let length = config.step as f32;
            self.segment::<_, QUADS>(
                simd,
                [from, to],
                length,
                k as f32,
                reach as f32,
                [columns, lines],
                skipped,
            );
            from = to;
        }
        for line in 0..lines {
            let shade = &mut rows.shade[(top as usize - rows.first + line) * rows.stride + left as usize..];
            if QUADS {
                self.print(config, stroke.points, brush, line, shade);
            } else {
                self.blend(simd, config, reach as f32, line, shade);
            }
            self.touched[line] = 0;
        }
    }

    /// Takes the distances from segment number `k`, `length` px long; places count from the sheet's left and from
    /// `skipped` rows above it.
    #[inline(always)]
    #[allow(clippy::too_many_arguments)] // one place calls it
    fn segment<S: Simd, const QUADS: bool>(
        &mut self,
        simd: S,
        [a, b]: [[f32; 2]; 2],
        length: f32,
        k: f32,
        reach: f32,
        [columns, lines]: [usize; 2],
        skipped: usize,
    ) {
        let (left, right) = covered(a[0], b[0], reach, columns);
        let (top, bottom) = covered(a[1], b[1], reach, skipped + lines);
        let top = top.max(skipped);
        if right <= left || bottom <= top {
            return;
        }
        let part = 1.0 / length;
        let unit = [(b[0] - a[0]) * part, (b[1] - a[1]) * part];
        let (zero, end) = (f32x8::splat(simd, 0.0), f32x8::splat(simd, length));
        let lanes = f32x8::from_slice(simd, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
        let stride = self.stride;
        let blocks = (right - left).div_ceil(8);
        for x in (0..blocks).map(|block| left + 8 * block) {
            let dx = lanes + (x as i32 as f32 - a[0]);
            // how far along the segment's line a pixel lies, and how far beside it
            let (ahead, beside) = (dx * unit[0], dx * unit[1]);
            let mut at = (top - skipped) * stride + x;
            for line in top..bottom {
                let y = line as i32 as f32 - a[1];
                let (ahead, beside) = (ahead + y * unit[1], beside - y * unit[0]);
                let nearest = ahead.max(zero).min(end);
                let past = ahead - nearest;
                let square = past * past + beside * beside;
                let squares = &mut self.squares[at..at + 8];
                let kept = f32x8::from_slice(simd, squares);
                square.min(kept).store_slice(squares);
                if QUADS {
                    let nearer = simd.simd_lt_f32x8(square, kept);
                    for (sheet, value) in [(&mut self.along, nearest * part + k), (&mut self.side, -beside)] {
                        let sheet = &mut sheet[at..at + 8];
                        simd.select_f32x8(nearer, value, f32x8::from_slice(simd, sheet)).store_slice(sheet);
                    }
                }
                at += stride;
            }
        }
        let last = (left + 8 * blocks - 1) >> self.shift;
        let columns = u64::MAX << (left >> self.shift) & u64::MAX >> (63 - last);
        for touched in &mut self.touched[top - skipped..bottom - skipped] {
            *touched |= columns;
        }
    }

    /// The columns touched in a line of the sheet.
    #[inline(always)]
    fn span(&self, line: usize) -> Range<usize> {
        let touched = self.touched[line];
        if touched == 0 {
            return 0..0;
        }
        let (from, to) = (touched.trailing_zeros() as usize, (u64::BITS - touched.leading_zeros()) as usize);
        // the last bit may stand for columns that the sheet does not have
        from << self.shift..(to << self.shift).min(self.stride & !7)
    }

    /// Blends one line of the sheet, which is empty afterwards, into a row of the shade plane.
    #[inline(always)]
    fn blend<S: Simd>(&mut self, simd: S, config: &Config, reach: f32, line: usize, shade: &mut [f32]) {
        let span = self.span(line);
        let width = span.len().next_multiple_of(8);
        let squares = &mut self.squares[line * self.stride + span.start..][..width];
        let shade = &mut shade[span.start..][..width];
        let (zero, one) = (f32x8::splat(simd, 0.0), f32x8::splat(simd, 1.0));
        let (opacity, reach) = (f32x8::splat(simd, config.opacity as f32), f32x8::splat(simd, reach));
        let blocks = squares.as_chunks_mut::<8>().0.iter_mut().zip(shade.as_chunks_mut::<8>().0);
        for (squares, shade) in blocks {
            let distance = f32x8::from_slice(simd, squares).sqrt();
            let coverage = (reach - distance).max(zero).min(one);
            (f32x8::from_slice(simd, shade) * (one - opacity * coverage)).store_slice(shade);
            *squares = [f32::INFINITY; 8];
        }
    }

    /// The same with quads: the brush runs along the stroke and across it, and fades on the way.
    #[inline(always)]
    fn print(&mut self, config: &Config, points: &[Point], brush: Brush<'_>, line: usize, shade: &mut [f32]) {
        let row = line * self.stride;
        let (opacity, fade) = (config.opacity as f32, config.fade as f32);
        let last = points.len() - 2;
        let span = self.span(line);
        for (x, shade) in shade.iter_mut().enumerate().take(span.end).skip(span.start) {
            let square = std::mem::replace(&mut self.squares[row + x], f32::INFINITY);
            let along = self.along[row + x];
            let k = (along as usize).min(last);
            let reach = |k: usize| config.half_width_at(points[k].nearness) as f32 + 0.5;
            let (from, to) = (reach(k), reach(k + 1));
            let reach = from + (to - from) * (along - k as f32);
            let distance = square.sqrt();
            let coverage = (reach - distance).clamp(0.0, 1.0);
            if coverage > 0.0 {
                let u = along / (last + 1) as f32;
                let v = if self.side[row + x] < 0.0 { reach - distance } else { reach + distance }
                    / (2.0 * reach);
                *shade *= 1.0 - opacity * (1.0 - fade * u) * coverage * brush.at(u, v);
            }
        }
    }
}

fn larger(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// The whole numbers nearer than `reach` to the range from `a` to `b`, of `0..count`: from, to.
#[inline(always)]
fn covered(a: f32, b: f32, reach: f32, count: usize) -> (usize, usize) {
    let (low, high) = if a < b { (a, b) } else { (b, a) };
    // conversions cut off, towards 0
    let (from, to) = ((low - reach + 1.0) as i32, (high + reach + 1.0) as i32);
    ((from.max(0) as usize).min(count), (to.max(0) as usize).min(count))
}
