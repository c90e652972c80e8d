//! Strokes on a canvas, in order, where they overlap.
//!
//! 1. Strokes are listed for every block of 64 x 32 pixels they touch, in drawing order (`Blocks`).
//! 2. A block is painted on a canvas of its own that stays in the first-level cache: it begins as the camera's
//!    pixels, takes its strokes, and is rounded to bytes once, at the end.
//!
//! The canvas holds 1/64 levels in 16 bits and opacities are 1/32768, so that a stroke is `d += floor((c - d)·a)`,
//! sixteen pixels at a time. A stroke adds at most 1.3 canvas steps of error (one from rounding down, the rest from the
//! opacity) and the strokes over it weaken what it added; with the default settings one byte in 150 is off, by one.

use super::grid::MAX_RADIUS;
use super::sprite::{LANES, Stamps};
use crate::kernel::band_rows;
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{PlaneMut, Rgb, Size};
use fearless_simd::Simd;
use rayon::prelude::*;

/// Columns of a block.
const ACROSS: usize = 64;
/// Rows of a block.
const DOWN: usize = 32;
/// Columns on either side of a block that strokes may spill onto: the widest stroke, in whole vectors.
const MARGIN: usize = (2 * MAX_RADIUS as usize + 1).next_multiple_of(LANES);
/// Columns of a canvas; known here, so that bounds are checked once a stroke. The cache sees only those in use.
const STRIDE: usize = ACROSS + 2 * MARGIN;
/// A row of a block: R, G, B.
type Line = [[i16; STRIDE]; 3];
/// Canvas steps in a level.
const LEVEL: i32 = 64;
/// Listed strokes that room is made for ahead; wilder settings make the lists grow as they come.
const ROOM: usize = 1 << 22;
/// Full brightness.
pub(super) const WHITE: i32 = 255 * LEVEL;

/// A brush stroke.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Stroke {
    /// Its middle, px.
    pub x: i32,
    /// Its middle, px.
    pub y: i32,
    /// Covers `2·radius + 1` pixels across and down.
    pub radius: u16,
    /// R, G, B in canvas steps: the color, or what is added to the camera's.
    pub color: [i16; 3],
}

/// A color channel in canvas steps.
pub(super) fn steps(value: f64) -> i32 {
    (value * f64::from(WHITE) + 0.5).floor() as i32
}

/// Strokes listed by block, in drawing order.
#[derive(Debug, Default)]
pub(super) struct Blocks {
    columns: usize,
    /// Where each block begins in `strokes`; one more than there are blocks.
    starts: Vec<u32>,
    strokes: Vec<Stroke>,
}

impl Blocks {
    /// Lists `strokes` over a frame of `size`; those outside it are dropped. Allocates only when `most`, the number of
    /// strokes that may come, grows (or their list beyond `ROOM`).
    pub fn sort(&mut self, size: Size, stamps: &Stamps, strokes: &[Stroke], most: usize) {
        self.columns = size.width.div_ceil(ACROSS);
        let count = self.columns * size.height.div_ceil(DOWN);
        self.starts.clear();
        self.starts.resize(count + 1, 0);
        for stroke in strokes {
            touched(size, stamps, stroke, |block| self.starts[block] += 1);
        }
        let mut end = 0;
        for start in &mut self.starts {
            end += *start;
            *start = end;
        }
        // a stroke touches one block more than it can cover, along either axis
        let blocks = |length: usize| stamps.widest() / length + 2;
        self.strokes.clear();
        self.strokes.reserve((most * blocks(ACROSS) * blocks(DOWN)).min(ROOM));
        self.strokes.resize(end as usize, Stroke::default());
        for stroke in strokes.iter().rev() {
            touched(size, stamps, stroke, |block| {
                self.starts[block] -= 1;
                self.strokes[self.starts[block] as usize] = *stroke;
            });
        }
    }

    /// The strokes of the block in `column` and `row` of blocks.
    fn of(&self, column: usize, row: usize) -> &[Stroke] {
        let block = row * self.columns + column;
        match self.starts.get(block..block + 2) {
            Some(&[from, to]) => &self.strokes[from as usize..to as usize],
            _ => &[],
        }
    }
}

/// The blocks that a stroke paints on.
#[inline(always)]
fn touched(size: Size, stamps: &Stamps, stroke: &Stroke, mut each: impl FnMut(usize)) {
    let (stamp, radius) = (stamps.of(stroke.radius), i32::from(stroke.radius));
    let top = stroke.y - radius + stamp.skipped as i32;
    let (left, right) = ((stroke.x - radius).max(0), (stroke.x + radius).min(size.width as i32 - 1));
    let (top, bottom) = (top.max(0), (top + stamp.height as i32 - 1).min(size.height as i32 - 1));
    if left > right || top > bottom {
        return;
    }
    let columns = size.width.div_ceil(ACROSS);
    for row in top as usize / DOWN..=bottom as usize / DOWN {
        for column in left as usize / ACROSS..=right as usize / ACROSS {
            each(row * columns + column);
        }
    }
}

/// The canvases that blocks are painted on, one a band of rows.
#[derive(Debug, Default)]
pub(super) struct Easel {
    canvases: Vec<Vec<Line>>,
}

/// Borrowed inputs of a painting.
#[derive(Clone, Copy)]
pub(super) struct Painting<'a> {
    /// What the canvas begins as, and what the first strokes take their color from.
    pub picture: &'a Rgb,
    /// The brush.
    pub stamps: &'a Stamps,
    /// Strokes whose color is added to the picture's at their middle.
    pub sampled: &'a Blocks,
    /// Strokes of their own color, over those.
    pub colored: Option<&'a Blocks>,
}

impl Easel {
    /// Paints; `out` has the picture's size. Allocates only when a size, the brush or the number of threads grows.
    pub fn paint(&mut self, level: Level, painting: Painting<'_>, out: &mut Rgb) {
        let height = painting.picture.size().height;
        let rows = band_rows(height, DOWN).next_multiple_of(DOWN);
        let bands = height.div_ceil(rows.max(1));
        if self.canvases.len() < bands {
            self.canvases.resize_with(bands, Vec::new);
        }
        for canvas in &mut self.canvases[..bands] {
            canvas.resize(DOWN, [[0; STRIDE]; 3]);
        }
        let [r, g, b] = &mut out.planes;
        let work = r.view_mut().par_bands(rows).zip(g.view_mut().par_bands(rows));
        let work = work.zip(b.view_mut().par_bands(rows)).zip(&mut self.canvases);
        work.for_each(|((((first, r), (_, g)), (_, b)), canvas)| {
            dispatch!(level, simd => paint_band(simd, painting, first, canvas, [r, g, b]));
        });
    }
}

#[inline(always)]
fn paint_band<S: Simd>(
    _simd: S,
    painting: Painting<'_>,
    first: usize,
    canvas: &mut [Line],
    mut out: [PlaneMut<'_, u8>; 3],
) {
    let size = painting.picture.size();
    let height = out[0].size().height;
    for top in (0..height).step_by(DOWN) {
        let rows = DOWN.min(height - top);
        for column in 0..size.width.div_ceil(ACROSS) {
            let left = column * ACROSS;
            let width = ACROSS.min(size.width - left);
            for (y, line) in canvas[..rows].iter_mut().enumerate() {
                for (to, plane) in line.iter_mut().zip(&painting.picture.planes) {
                    let from = &plane.row(first + top + y)[left..left + width];
                    let to = &mut to[MARGIN..MARGIN + width];
                    for x in 0..width {
                        to[x] = i16::from(from[x]) << 6;
                    }
                }
            }
            let row = (first + top) / DOWN;
            let mut block = Block { lines: &mut canvas[..rows], left, top: first + top };
            for stroke in painting.sampled.of(column, row) {
                block.stroke(painting.stamps, stroke, sampled(painting.picture, stroke));
            }
            for stroke in painting.colored.map_or(&[][..], |colored| colored.of(column, row)) {
                block.stroke(painting.stamps, stroke, stroke.color);
            }
            for (y, line) in canvas[..rows].iter().enumerate() {
                for (from, plane) in line.iter().zip(&mut out) {
                    let from = &from[MARGIN..MARGIN + width];
                    let to = &mut plane.row_mut(top + y)[left..left + width];
                    for x in 0..width {
                        to[x] = ((from[x] + 32) >> 6) as u8;
                    }
                }
            }
        }
    }
}

/// The picture's color at a stroke's middle, or at the pixel of the frame nearest to it, and the stroke's added.
#[inline(always)]
fn sampled(picture: &Rgb, stroke: &Stroke) -> [i16; 3] {
    let size = picture.size();
    let x = stroke.x.clamp(0, size.width as i32 - 1) as usize;
    let y = stroke.y.clamp(0, size.height as i32 - 1) as usize;
    let mut color = stroke.color;
    for (channel, plane) in color.iter_mut().zip(&picture.planes) {
        *channel = (i32::from(plane.at(x, y)) * LEVEL + i32::from(*channel)).clamp(0, WHITE) as i16;
    }
    color
}

/// One block's canvas and where its first pixel is.
struct Block<'a> {
    lines: &'a mut [Line],
    left: usize,
    top: usize,
}

impl Block<'_> {
    #[inline(always)]
    fn stroke(&mut self, stamps: &Stamps, stroke: &Stroke, color: [i16; 3]) {
        let (stamp, radius) = (stamps.of(stroke.radius), i32::from(stroke.radius));
        let top = stroke.y - radius + stamp.skipped as i32 - self.top as i32;
        let from = (-top).max(0);
        let to = (self.lines.len() as i32 - top).min(stamp.height as i32);
        if from >= to {
            return;
        }
        let rows = stamps.rows(stamp, from as usize, to as usize);
        let lines = &mut self.lines[(top + from) as usize..(top + to) as usize];
        let left = (stroke.x - radius - self.left as i32 + MARGIN as i32) as usize;
        // loops over indices: what an iterator's chain leaves as a call runs without the level's instructions
        if stamp.vectors == 1 && left + LANES <= STRIDE && rows.len() == lines.len() {
            for k in 0..lines.len() {
                lay(&mut lines[k], left, &rows[k], color);
            }
        } else {
            for k in 0..lines.len() {
                for vector in 0..stamp.vectors {
                    lay(&mut lines[k], left + vector * LANES, &rows[k * stamp.vectors + vector], color);
                }
            }
        }
    }
}

/// Lays `color` over sixteen pixels of a row.
#[inline(always)]
fn lay([r, g, b]: &mut Line, at: usize, opacity: &[i16; LANES], color: [i16; 3]) {
    blend(r, at, opacity, color[0]);
    blend(g, at, opacity, color[1]);
    blend(b, at, opacity, color[2]);
}

/// Lays one channel over sixteen pixels: `d += floor((color - d)·a)`.
#[inline(always)]
fn blend(canvas: &mut [i16; STRIDE], at: usize, opacity: &[i16; LANES], color: i16) {
    let Some(Ok(canvas)) = canvas.get_mut(at..at + LANES).map(<&mut [i16; LANES]>::try_from) else { return };
    let (was, opacity) = (*canvas, *opacity);
    for lane in 0..LANES {
        // the upper half of a product of sixteen bits: one instruction
        let way = color.wrapping_sub(was[lane]) << 1;
        canvas[lane] = was[lane].wrapping_add(((i32::from(way) * i32::from(opacity[lane])) >> 16) as i16);
    }
}
