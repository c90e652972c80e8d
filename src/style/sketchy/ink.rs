//! Strokes on the shade plane: every pixel's light is multiplied by what a stroke lets through.
//!
//! A stroke's coverage is clamp(half width + .5 - d, 0, 1), d being the distance to its nearest segment. Segment by
//! segment, the least squared distance of the pixels within reach is kept on a small sheet; then one pass over the
//! pixels that were touched takes the root and multiplies. Blends of black commute, so the order of strokes does not
//! matter to the picture.

use super::Config;
use super::trace::Stroke;
use crate::pixels::Size;
use fearless_simd::{Simd, SimdBase, SimdFloat, f32x8};

/// Samples after the last of a sheet's or shade's row that may be written.
pub const SLACK: usize = 16;

/// The sheet one band of rows works on.
#[derive(Debug, Default)]
pub struct Sheet {
    /// Least squared distance, ∞ where no segment is within reach.
    squares: Vec<f32>,
    stride: usize,
    /// Columns touched in each row, `from..to`.
    spans: Vec<[usize; 2]>,
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
        if self.spans.len() < rows {
            self.spans.resize(rows, NOWHERE);
        }
        if self.squares.len() < rows * self.stride {
            self.squares.resize(rows * self.stride, f32::INFINITY);
        }
    }

    /// Draws one stroke as far as it lies in `rows`.
    #[inline(always)]
    pub fn draw<S: Simd>(&mut self, simd: S, config: &Config, stroke: Stroke<'_>, rows: &mut Rows<'_>) {
        let half = config.half_width_at(stroke.points[0].nearness);
        let reach = half + 0.5;
        let top = ((stroke.span[0] - reach).ceil().max(rows.first as f64)) as usize;
        let end = rows.first + rows.size.height;
        if stroke.span[0] - reach > end as f64 - 1.0 || stroke.span[1] + reach < rows.first as f64 {
            return;
        }
        let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
        for point in stroke.points {
            least = if point.at[0] < least { point.at[0] } else { least };
            most = if point.at[0] > most { point.at[0] } else { most };
        }
        let left = (least - reach).ceil().max(0.0) as usize;
        let right = (most + reach).floor().min(rows.size.width as f64 - 1.0);
        let bottom = (stroke.span[1] + reach).floor().min(end as f64 - 1.0);
        if right < left as f64 || bottom < top as f64 {
            return;
        }
        let (columns, lines) = (right as usize - left + 1, bottom as usize - top + 1);
        let place = |at: [f64; 2]| [(at[0] - left as f64) as f32, (at[1] - top as f64) as f32];
        let reach = reach as f32;
        for ends in stroke.points.windows(2) {
            self.segment(simd, [place(ends[0].at), place(ends[1].at)], reach, [columns, lines]);
        }
        let (opacity, reach) = (f32x8::splat(simd, config.opacity as f32), f32x8::splat(simd, reach));
        let (zero, one) = (f32x8::splat(simd, 0.0), f32x8::splat(simd, 1.0));
        for (line, span) in self.spans[..lines].iter_mut().enumerate() {
            let squares = &mut self.squares[line * self.stride..][..self.stride];
            let shade = &mut rows.shade[(top - rows.first + line) * rows.stride + left..];
            for x in (span[0]..span[1]).step_by(8) {
                let distance = f32x8::from_slice(simd, &squares[x..x + 8]).sqrt();
                let coverage = (reach - distance).max(zero).min(one);
                let light = f32x8::from_slice(simd, &shade[x..x + 8]) * (one - opacity * coverage);
                light.store_slice(&mut shade[x..x + 8]);
                f32x8::splat(simd, f32::INFINITY).store_slice(&mut squares[x..x + 8]);
            }
            *span = NOWHERE;
        }
    }

    /// Takes the distances from one segment; places are relative to the sheet.
    #[inline(always)]
    fn segment<S: Simd>(&mut self, simd: S, [a, b]: [[f32; 2]; 2], reach: f32, [columns, lines]: [usize; 2]) {
        let [left, right] = covered(a[0], b[0], reach, columns);
        let [top, bottom] = covered(a[1], b[1], reach, lines);
        let along = [b[0] - a[0], b[1] - a[1]];
        let scale = 1.0 / (along[0] * along[0] + along[1] * along[1]);
        let (zero, one) = (f32x8::splat(simd, 0.0), f32x8::splat(simd, 1.0));
        let lanes = f32x8::from_slice(simd, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
        for line in top..bottom {
            let y = line as f32 - a[1];
            let squares = &mut self.squares[line * self.stride..][..self.stride];
            let mut to = left;
            for x in (left..right).step_by(8) {
                let dx = lanes + (x as f32 - a[0]);
                let t = ((dx * along[0] + y * along[1]) * scale).max(zero).min(one);
                let (dx, dy) = (dx - t * along[0], f32x8::splat(simd, y) - t * along[1]);
                let square = dx * dx + dy * dy;
                let kept = f32x8::from_slice(simd, &squares[x..x + 8]);
                square.min(kept).store_slice(&mut squares[x..x + 8]);
                to = x + 8;
            }
            let span = &mut self.spans[line];
            *span = [span[0].min(left), span[1].max(to)];
        }
    }
}

/// No columns: any span joined to it is that span.
const NOWHERE: [usize; 2] = [usize::MAX, 0];

/// The whole numbers within `reach` of the range from `a` to `b`, of `0..count`.
fn covered(a: f32, b: f32, reach: f32, count: usize) -> [usize; 2] {
    let (low, high) = if a < b { (a, b) } else { (b, a) };
    // conversions saturate at 0
    [((low - reach).ceil() as usize).min(count), ((high + reach).floor() + 1.0) as usize]
        .map(|edge| edge.min(count))
}
