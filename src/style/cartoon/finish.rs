//! The last pass: enlarge S, find both edges, draw the lines, write bytes. One loop over output rows.
//!
//! Per output row the two grid rows around it blend into one narrow row; per block of sixteen pixels its planes
//! expand in registers. Most blocks hold no line, and two cheap bounds prove it without changing a bit:
//!
//! - the response between grid points is at most that of the four around it, so a block whose grid points all stay
//!   below `s0` has smoothstep 0;
//! - every channel's gradient is at most the largest |gx| + |gy| of R, G, B, in exact 16-bit integers, times
//!   [`Edges::reach`], so a block below `a0` by that measure has smoothstep 0.
#![allow(clippy::needless_range_loop)] // lanes and channels index several arrays in step

use super::grid::Grid;
use super::{Config, Stages};
use crate::kernel::enlarge::{BLOCK, Eight, Taps, blend_rows};
use crate::kernel::sobel::Lines;
use crate::kernel::{band_rows, color};
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{PlaneMut, Rgb};
use fearless_simd::{Bytes, Simd, SimdBase, SimdFloat, f32x8, i16x16, u8x16, u16x16};
use rayon::prelude::*;

/// Gradients of bytes are 4·255 times those of 0..1.
const UNIT: f32 = 1.0 / (4.0 * 255.0);
/// Keeps the bounds on the safe side of f32 rounding.
const SLACK: f32 = 1.0 - 1e-5;

/// Tables and scratch rows of the pass.
#[derive(Debug, Default)]
pub struct Finish {
    columns: Taps,
    rows: Taps,
    scratch: Vec<Scratch>,
}

/// What one band of rows works in.
#[derive(Debug, Default)]
struct Scratch {
    lines: [Lines; 3],
    narrow: Vec<f32>,
    busy: Vec<bool>,
}

/// The settings of eq. 4 and 5 as the loop wants them.
#[derive(Clone, Copy)]
struct Edges {
    /// Weights of |∇Y|, |∇(B-Y)|, |∇(R-Y)| of bytes.
    weights: [f32; 3],
    /// A block whose |gx| + |gy| of bytes stays at or below this has no full-resolution edge.
    quiet: i16,
    s0: f32,
    s_scale: f32,
    a0: f32,
    a_scale: f32,
    beta: f32,
}

impl Edges {
    fn new(config: &Config) -> Self {
        let chroma = config.alpha * 0.5;
        // |∇(B-Y)| <= (.886 + .299 + .587)·g and |∇(R-Y)| <= (.701 + .587 + .114)·g, g the largest of R, G, B
        let reach = (1.0 - config.alpha) + chroma * (color::U_OF_B * 1.772 + color::V_OF_R * 1.402);
        let quiet = (config.a0 * SLACK / (reach * UNIT)).min(f32::from(i16::MAX)) as i16;
        Self {
            weights: [1.0 - config.alpha, chroma * color::U_OF_B, chroma * color::V_OF_R].map(|w| w * UNIT),
            quiet,
            s0: config.s0,
            s_scale: 1.0 / (config.s1 - config.s0),
            a0: config.a0,
            a_scale: 1.0 / (config.a1 - config.a0),
            beta: config.beta,
        }
    }
}

/// Borrowed inputs of a band.
#[derive(Clone, Copy)]
struct Work<'a> {
    edges: Edges,
    picture: &'a Rgb,
    grid: &'a Grid,
    columns: &'a Taps,
    rows: &'a Taps,
}

impl Finish {
    /// Draws the picture into `out`, which has its size. Allocates only when a size or the thread count changes.
    pub fn draw(&mut self, level: Level, config: &Config, picture: &Rgb, grid: &Grid, out: &mut Rgb) {
        let band = band_rows(picture.size().height, 8);
        let (work, scratch) = self.prepare(config, picture, grid, band);
        let [r, g, b] = &mut out.planes;
        let bands = r.view_mut().par_bands(band).zip(g.view_mut().par_bands(band));
        let bands = bands.zip(b.view_mut().par_bands(band)).zip(scratch);
        bands.for_each(|((((first, r), (_, g)), (_, b)), scratch)| {
            dispatch!(level, simd => draw_band::<_, false>(simd, work, first, scratch, [r, g, b], None));
        });
    }

    /// The same, with responses and line strength kept at every pixel.
    pub fn tapped(
        &mut self,
        level: Level,
        config: &Config,
        picture: &Rgb,
        grid: &Grid,
        stages: &mut Stages,
        out: &mut Rgb,
    ) {
        let size = picture.size();
        let (work, scratch) = self.prepare(config, picture, grid, size.height);
        let kept = [&mut stages.edge_s, &mut stages.edge_a, &mut stages.lines].map(|plane| {
            plane.resize(size, 0.0);
            plane.view_mut()
        });
        let planes = out.planes.each_mut().map(|plane| plane.view_mut());
        let scratch = &mut scratch[0];
        dispatch!(level, simd => draw_band::<_, true>(simd, work, 0, scratch, planes, Some(kept)));
    }

    fn prepare<'a>(
        &'a mut self,
        config: &Config,
        picture: &'a Rgb,
        grid: &'a Grid,
        band: usize,
    ) -> (Work<'a>, &'a mut [Scratch]) {
        let (size, small) = (picture.size(), grid.size());
        self.columns.fit(small.width, size.width);
        self.rows.fit(small.height, size.height);
        let bands = size.height.div_ceil(band.max(1));
        if self.scratch.len() < bands {
            self.scratch.resize_with(bands, Scratch::default);
        }
        for scratch in &mut self.scratch[..bands] {
            scratch.lines.iter_mut().for_each(|lines| lines.fit(size.width));
            scratch.narrow.resize(grid.row(0).len(), 0.0);
            scratch.busy.resize(size.width.div_ceil(BLOCK), false);
        }
        let edges = Edges::new(config);
        let work = Work { edges, picture, grid, columns: &self.columns, rows: &self.rows };
        (work, &mut self.scratch[..bands])
    }
}

/// Draws the rows of one band. `TAP` keeps the intermediate planes and computes them everywhere.
#[inline(always)]
fn draw_band<S: Simd, const TAP: bool>(
    simd: S,
    work: Work<'_>,
    first: usize,
    scratch: &mut Scratch,
    mut out: [PlaneMut<'_, u8>; 3],
    mut kept: Option<[PlaneMut<'_, f32>; 3]>,
) {
    let Work { edges, picture, grid, columns, rows } = work;
    let (size, stride) = (picture.size(), grid.column_stride());
    let (use_s, use_a) = (TAP || edges.beta < 1.0, TAP || edges.beta > 0.0);
    if use_a {
        for (lines, plane) in scratch.lines.iter_mut().zip(&picture.planes) {
            lines.push(0, plane.row(first.saturating_sub(1)));
            lines.push(1, plane.row(first));
        }
    }
    let mut last_top = usize::MAX;
    let mut any_busy = false;
    for y in 0..out[0].size().height {
        if use_a {
            for (lines, plane) in scratch.lines.iter_mut().zip(&picture.planes) {
                lines.push(y + 2, plane.row((first + y + 1).min(size.height - 1)));
            }
        }
        let (top, f) = rows.at(first + y);
        if use_s && top != last_top {
            let (a, b) = (grid.response(top), grid.response(top + 1));
            any_busy = find_busy(columns, a, b, edges.s0 * SLACK, TAP, &mut scratch.busy);
            last_top = top;
        }
        let planes = if any_busy { super::grid::PLANES } else { 3 };
        blend_rows(grid.row(top), grid.row(top + 1), f, &mut scratch.narrow[..planes * stride]);
        let [red, green, blue] = &mut out;
        let (red, green, blue) = (red.row_mut(y), green.row_mut(y), blue.row_mut(y));
        for block in 0..size.width.div_ceil(BLOCK) {
            let eights = [Eight::load(simd, columns, 2 * block), Eight::load(simd, columns, 2 * block + 1)];
            let zero = f32x8::splat(simd, 0.0);
            let mut ink = [zero; 2];
            let mut inked = false;
            let mut seen = [[zero; 2]; 2];
            if use_s && scratch.busy[block] {
                for half in 0..2 {
                    let response = response_s(simd, &eights[half], columns, &scratch.narrow, stride);
                    let strength = smoothstep(simd, response, edges.s0, edges.s_scale);
                    ink[half] = strength * (1.0 - edges.beta);
                    seen[0][half] = response;
                }
                inked = true;
            }
            if use_a {
                let mut gradients = [[i16x16::splat(simd, 0); 2]; 3];
                let mut largest = i16x16::splat(simd, 0);
                for c in 0..3 {
                    let [gx, gy] = scratch.lines[c].gradient(simd, y, BLOCK * block);
                    largest = largest.max(simd.abs_i16x16(gx) + simd.abs_i16x16(gy));
                    gradients[c] = [gx, gy];
                }
                if TAP
                    || simd.any_true_mask16x16(simd.simd_gt_i16x16(largest, i16x16::splat(simd, edges.quiet)))
                {
                    let response = response_a(simd, gradients, edges.weights);
                    for half in 0..2 {
                        let strength = smoothstep(simd, response[half], edges.a0, edges.a_scale);
                        ink[half] += strength * edges.beta;
                    }
                    seen[1] = response;
                    inked = true;
                }
            }
            let x = BLOCK * block;
            let count = BLOCK.min(size.width - x);
            for (c, row) in [&mut *red, &mut *green, &mut *blue].into_iter().enumerate() {
                let narrow = &scratch.narrow[c * stride..][..stride];
                let mut color =
                    [eights[0].expand(simd, columns, narrow), eights[1].expand(simd, columns, narrow)];
                if inked {
                    for half in 0..2 {
                        color[half] *= f32x8::splat(simd, 1.0) - ink[half];
                    }
                }
                let bytes = bytes_of(simd, color);
                if count == BLOCK {
                    bytes.store_slice(&mut row[x..x + BLOCK]);
                } else {
                    row[x..].copy_from_slice(&bytes.as_slice()[..count]);
                }
            }
            if TAP && let Some(kept) = &mut kept {
                for (plane, values) in kept.iter_mut().zip([seen[0], seen[1], ink]) {
                    let row = &mut plane.row_mut(first + y)[x..x + count];
                    for (i, to) in row.iter_mut().enumerate() {
                        *to = values[i / 8].as_slice()[i % 8];
                    }
                }
            }
        }
    }
}

/// Marks the blocks whose grid points reach `threshold` on either row; whether there is any.
#[inline(always)]
fn find_busy(columns: &Taps, a: &[f32], b: &[f32], threshold: f32, all: bool, busy: &mut [bool]) -> bool {
    let mut any = false;
    for (block, busy) in busy.iter_mut().enumerate() {
        let (from, to) = columns.window(block * BLOCK, block * BLOCK + BLOCK - 1);
        let mut largest = 0.0f32;
        for (&a, &b) in a[from..to].iter().zip(&b[from..to]) {
            let larger = if a > b { a } else { b };
            largest = if larger > largest { larger } else { largest };
        }
        *busy = all || largest >= threshold;
        any |= *busy;
    }
    any
}

/// Eq. 4 for the simplified picture: eight pixels' response from the blended grid row.
#[inline(always)]
fn response_s<S: Simd>(simd: S, eight: &Eight<S>, columns: &Taps, narrow: &[f32], stride: usize) -> f32x8<S> {
    let mut response = f32x8::splat(simd, 0.0);
    for c in 0..3 {
        let gx = eight.expand(simd, columns, &narrow[(3 + 2 * c) * stride..][..stride]);
        let gy = eight.expand(simd, columns, &narrow[(4 + 2 * c) * stride..][..stride]);
        response += (gx * gx + gy * gy).sqrt();
    }
    response
}

/// Eq. 4 for the augmented picture: sixteen pixels' response from the gradients of R, G, B bytes.
#[inline(always)]
fn response_a<S: Simd>(simd: S, gradients: [[i16x16<S>; 2]; 3], weights: [f32; 3]) -> [f32x8<S>; 2] {
    let zero = f32x8::splat(simd, 0.0);
    // [direction][channel][half]
    let mut wide = [[[zero; 2]; 3]; 2];
    for c in 0..3 {
        for direction in 0..2 {
            let (low, high) = simd.widen_i16x16(gradients[c][direction]);
            wide[direction][c] = [simd.cvt_f32_i32x8(low), simd.cvt_f32_i32x8(high)];
        }
    }
    let mut response = [zero; 2];
    for half in 0..2 {
        let mut squares = [zero; 3];
        for direction in &wide {
            let [r, g, b] = [direction[0][half], direction[1][half], direction[2][half]];
            let luma = r * color::LUMA[0] + g * color::LUMA[1] + b * color::LUMA[2];
            let (u, v) = (b - luma, r - luma);
            squares[0] += luma * luma;
            squares[1] += u * u;
            squares[2] += v * v;
        }
        for c in 0..3 {
            response[half] += squares[c].sqrt() * weights[c];
        }
    }
    response
}

/// GLSL's smoothstep from `edge` on, `scale` = 1 / width.
#[inline(always)]
fn smoothstep<S: Simd>(simd: S, x: f32x8<S>, edge: f32, scale: f32) -> f32x8<S> {
    let t = (x - edge) * scale;
    let t = t.max(f32x8::splat(simd, 0.0)).min(f32x8::splat(simd, 1.0));
    t * t * (f32x8::splat(simd, 3.0) - (t + t))
}

/// floor(v + .5) of values in 0..255, as bytes.
#[inline(always)]
fn bytes_of<S: Simd>(simd: S, color: [f32x8<S>; 2]) -> u8x16<S> {
    let low = simd.cvt_i32_f32x8(color[0] + 0.5);
    let high = simd.cvt_i32_f32x8(color[1] + 0.5);
    let words: u16x16<S> = simd.saturating_narrow_i32x8(low, high).bitcast();
    let (low, high) = simd.split_u16x16(words);
    simd.saturating_narrow_u16x8(low, high)
}
