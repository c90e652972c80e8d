//! The models' side (Fischer 2006, section 4.2.3): silhouettes of the first and the second surface, hatching of the
//! first, secondary geometry between them.
//!
//! Comes in: depth and normal of both surfaces and of the secondary models; goes out: every pixel that any of them
//! covers, over the finished camera side. Silhouettes of a surface are found where that surface is; pixels just
//! outside it belong to the camera picture. Only touched tiles are looked at.

use super::super::composite;
use super::Config;
use crate::frame::Layer;
use crate::kernel::sobel;
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, PlaneMut, Rect, Rgb, TILE};
use rayon::prelude::*;

/// A row of a tile with one neighbor on either side.
const WIDE: usize = TILE + 2;

/// One surface of the models.
#[derive(Clone, Copy)]
struct Surface<'a> {
    depth: &'a Plane<f32>,
    normal: &'a [Plane<f32>; 3],
}

impl<'a> Surface<'a> {
    /// `None` unless both are there for every pixel of the first surface.
    fn new(depth: &'a Plane<f32>, normal: &'a [Plane<f32>; 3], layer: &Layer) -> Option<Self> {
        let whole = [depth.size(), normal[0].size()].iter().all(|&size| size == layer.depth.size());
        whole.then_some(Self { depth, normal })
    }
}

/// What all pixels share.
struct Work<'a> {
    config: &'a Config,
    halftone: &'a Plane<f32>,
    surfaces: [Surface<'a>; 2],
    secondary: Option<Surface<'a>>,
    light: [f32; 3],
    /// Window depth is `scale · (z - near) / z`, 1 where nothing is: f/(f-n) · (1 - n/z) with n and f around the models
    /// ([`Config::planes`]).
    near: f32,
    scale: f32,
}

/// Draws the models of `layer` into `out`; a layer without both surfaces' normals draws nothing.
pub(super) fn draw(level: Level, config: &Config, halftone: &Plane<f32>, layer: &Layer, out: &mut Rgb) {
    let surfaces = [
        Surface::new(&layer.depth, &layer.normal, layer),
        Surface::new(&layer.depth2, &layer.normal2, layer),
    ];
    let [Some(first), Some(second)] = surfaces else { return };
    let secondary = layer.secondary.as_deref();
    let [near, far] = config.planes(layer.extent);
    let work = &Work {
        config,
        halftone,
        surfaces: [first, second],
        secondary: secondary.and_then(|s| Surface::new(&s.depth, &s.normal, layer)),
        light: layer.light.to_array(),
        near,
        scale: if far > near { far / (far - near) } else { 0.0 },
    };
    let size = out.size();
    let [r, g, b] = &mut out.planes;
    let bands =
        r.view_mut().par_bands(TILE).zip(g.view_mut().par_bands(TILE)).zip(b.view_mut().par_bands(TILE));
    bands.with_max_len(1).for_each(|(((first, r), (_, g)), (_, b))| {
        let mut out = [r, g, b];
        for area in composite::touched(layer, size).filter(|area| area.y0 == first) {
            dispatch!(level, _simd => draw_tile(work, area, &mut out));
        }
    });
}

/// Three rows of a surface around a tile.
struct Rows {
    depth: [[f32; WIDE]; 3],
    normal: [[[f32; WIDE]; 3]; 3],
}

impl Rows {
    #[inline(always)]
    fn take(&mut self, work: &Work<'_>, surface: Surface<'_>, slot: usize, y: usize, area: Rect) {
        let depth = &mut self.depth[slot];
        padded(surface.depth.row(y), area, depth);
        for z in depth.iter_mut() {
            let inside = work.scale * ((*z - work.near) / *z);
            *z = if *z < f32::INFINITY { inside } else { 1.0 };
        }
        for (plane, to) in surface.normal.iter().zip(&mut self.normal[slot]) {
            padded(plane.row(y), area, to);
        }
    }

    /// Where the middle row (in slot `y`, the one above before it) has a silhouette (eq. 4.3 to 4.5).
    #[inline(always)]
    fn silhouette(&self, config: &Config, y: usize, lines: &mut [bool; TILE]) {
        let [above, here, below] = [(y + 2) % 3, y % 3, (y + 1) % 3];
        let (mut gx, mut gy) = ([0.0; TILE], [0.0; TILE]);
        let depth = [above, here, below].map(|slot| &self.depth[slot][..]);
        sobel::gradient_row_f32(depth, 0.25, &mut gx, &mut gy);
        let mut similarity = [0.0; TILE];
        for k in 0..3 {
            let [a, b, c] = [above, here, below].map(|slot| &self.normal[slot][k]);
            for x in 0..TILE {
                similarity[x] += b[x + 1] * ((b[x + 2] + b[x]) + (c[x + 1] + a[x + 1]));
            }
        }
        let least = config.depth_threshold * config.depth_threshold;
        for x in 0..TILE {
            let steep = gx[x] * gx[x] + gy[x] * gy[x] >= least;
            lines[x] = steep | (similarity[x] < config.normal_threshold);
        }
    }
}

/// A tile's part of a row with its neighbors, the picture's edges repeated.
#[inline(always)]
fn padded(row: &[f32], area: Rect, to: &mut [f32; WIDE]) {
    let count = area.x1 - area.x0;
    to[1..=count].copy_from_slice(&row[area.x0..area.x1]);
    to[0] = row[area.x0.saturating_sub(1)];
    to[count + 1] = row[area.x1.min(row.len() - 1)];
}

#[inline(always)]
fn draw_tile(work: &Work<'_>, area: Rect, out: &mut [PlaneMut<'_, u8>; 3]) {
    let height = work.halftone.size().height;
    let mut rows = [0, 1].map(|_| Rows { depth: [[0.0; WIDE]; 3], normal: [[[0.0; WIDE]; 3]; 3] });
    for (rows, &surface) in rows.iter_mut().zip(&work.surfaces) {
        rows.take(work, surface, 2, area.y0.saturating_sub(1), area);
        rows.take(work, surface, 0, area.y0, area);
    }
    let mut lines = [[false; TILE]; 2];
    for y in 0..area.y1 - area.y0 {
        let below = (area.y0 + y + 1).min(height - 1);
        for (rows, &surface) in rows.iter_mut().zip(&work.surfaces) {
            rows.take(work, surface, (y + 1) % 3, below, area);
        }
        let part = |plane: &Plane<f32>| -> bool {
            plane.row(area.y0 + y)[area.x0..area.x1].iter().any(|&z| z < f32::INFINITY)
        };
        if part(work.surfaces[0].depth) {
            for (rows, lines) in rows.iter().zip(&mut lines) {
                rows.silhouette(work.config, y, lines);
            }
        } else if !work.secondary.is_some_and(|s| part(s.depth)) {
            continue;
        }
        compose(work, area, y, &lines, out);
    }
}

/// The colors of one row of a tile (eq. 4.2, 4.6, 4.9 and 4.10, Algorithm 6).
#[inline(always)]
fn compose(
    work: &Work<'_>,
    area: Rect,
    y: usize,
    lines: &[[bool; TILE]; 2],
    out: &mut [PlaneMut<'_, u8>; 3],
) {
    let Config { alpha_layer, beta_layer, .. } = *work.config;
    let (row, count) = (area.y0 + y, area.x1 - area.x0);
    let part = |plane| cut(plane, row, area);
    let [z1, z2] = [0, 1].map(|k| part(work.surfaces[k].depth));
    let tau = part(work.halftone);
    let mut bright = [0.0; TILE];
    lit(work.light, work.surfaces[0].normal, row, area, &mut bright);
    let (mut inner, mut strength) = ([false; TILE], [0.0; TILE]);
    if let Some(secondary) = work.secondary {
        let z = part(secondary.depth);
        lit(work.light, secondary.normal, row, area, &mut strength);
        for x in 0..count {
            let seen = if z[x] < z1[x] {
                1.0
            } else if z[x] < z2[x] {
                alpha_layer
            } else {
                beta_layer
            };
            inner[x] = z[x] < f32::INFINITY;
            let hidden = !inner[x] | (lines[1][x] & (z2[x] <= z[x]));
            strength[x] = if hidden { 0.0 } else { strength[x] * seen };
        }
    }
    let (mut object, mut black) = ([false; TILE], [false; TILE]);
    for x in 0..count {
        let covered = z1[x] < f32::INFINITY;
        object[x] = covered | inner[x];
        black[x] = covered & (lines[0][x] | (bright[x] < tau[x]));
    }
    let colors = [work.config.paper_color(), work.config.back_layer_color(), work.config.secondary_color()];
    for (k, plane) in out.iter_mut().enumerate() {
        let [paper, back, secondary] = colors.map(|color| color[k]);
        for (x, to) in plane.row_mut(y)[area.x0..area.x1].iter_mut().enumerate() {
            let ground = if lines[1][x] & (z2[x] < f32::INFINITY) { back } else { paper };
            let color = (1.0 - strength[x]) * ground + strength[x] * secondary;
            let byte = if black[x] { 0 } else { (color * 255.0 + 0.5) as u8 };
            *to = if object[x] { byte } else { *to };
        }
    }
}

/// A tile's part of a row.
#[inline(always)]
fn cut(plane: &Plane<f32>, row: usize, area: Rect) -> &[f32] {
    &plane.row(row)[area.x0..area.x1]
}

/// max(n·L, 0) along one row of a tile.
#[inline(always)]
fn lit(light: [f32; 3], normal: &[Plane<f32>; 3], row: usize, area: Rect, out: &mut [f32; TILE]) {
    let [nx, ny, nz] = normal.each_ref().map(|plane| cut(plane, row, area));
    for (x, out) in out.iter_mut().enumerate().take(nx.len()) {
        let towards = nx[x] * light[0] + ny[x] * light[1] + nz[x] * light[2];
        *out = if towards > 0.0 { towards } else { 0.0 };
    }
}
