//! Row by row of tiles: tiles are drawn and, while they are at hand, written to the layer's planes: 1/z to z,
//! attributes to color, normals to unit length. Those that were covered last time and are not now go back to the
//! background.

use super::View;
use super::bins::Chunk;
use super::raster;
use super::shade::{Palette, RUN, load, shade_row};
use super::tile::{STRIDE, Slot};
use crate::frame::Layer;
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, Rect, TILE, TileGrid, TileSet};
use fearless_simd::{Simd, SimdBase, f32x8, prelude::*};

/// What tiles are drawn from and written with.
pub(super) struct Painter<'a> {
    pub level: Level,
    pub view: Option<View<'a>>,
    pub chunks: &'a [Chunk],
    pub palette: Palette<'a>,
    pub previous: &'a TileSet,
}

impl Painter<'_> {
    /// Draws and writes all planes the layer has, and what phantoms hide where that is wanted; fills the set of touched
    /// tiles. There is a slot for each row of tiles.
    pub fn paint(&self, layer: &mut Layer, shield: Option<&mut Plane<f32>>, slots: &mut [Slot]) {
        let Some(grid) = layer.grid else { return };
        if self.chunks.is_empty() && self.previous.is_empty() {
            return;
        }
        let sheets = Sheets {
            color: layer.color.planes.each_mut().map(Sheet::of),
            depth: Sheet::of(&mut layer.depth),
            depth2: Sheet::of(&mut layer.depth2),
            normal: layer.normal.each_mut().map(Sheet::of),
            normal2: layer.normal2.each_mut().map(Sheet::of),
            object: Sheet::of(&mut layer.object),
            shield: shield.map(Sheet::of).unwrap_or_default(),
        };
        self.rows(grid, 0, sheets, slots);
        for (row, slot) in slots.iter().enumerate() {
            let columns =
                (0..grid.columns()).filter(|column| slot.covered[column / 64] >> (column % 64) & 1 == 1);
            columns.for_each(|column| layer.touched.insert(row * grid.columns() + column));
        }
    }

    fn rows(&self, grid: TileGrid, first: usize, sheets: Sheets<'_>, slots: &mut [Slot]) {
        match slots {
            [] => {}
            [slot] => self.row(grid, first, sheets, slot),
            more => {
                let half = more.len() / 2;
                let (slots, more) = more.split_at_mut(half);
                let (above, below) = sheets.split(half);
                rayon::join(
                    || self.rows(grid, first, above, slots),
                    || self.rows(grid, first + half, below, more),
                );
            }
        }
    }

    fn row(&self, grid: TileGrid, row: usize, mut sheets: Sheets<'_>, slot: &mut Slot) {
        slot.covered = Default::default();
        for column in 0..grid.columns() {
            let tile = row * grid.columns() + column;
            let reached = self.chunks.iter().any(|chunk| chunk.reaches(tile, column, row));
            let covered = match &self.view {
                Some(view) if reached => raster::draw_tile(self.level, view, self.chunks, tile, slot),
                _ => false,
            };
            let rect = grid.rect(tile);
            if covered {
                slot.covered[column / 64] |= 1 << (column % 64);
                dispatch!(self.level, simd => sheets.write(simd, &self.palette, slot, rect));
            } else if self.previous.contains(tile) {
                sheets.clear(rect);
            }
            if reached && self.palette.channels.phantoms {
                let shield = &slot.others[self.palette.channels.shield_at()];
                dispatch!(self.level, _simd => sheets.shield.write_depth(shield, self.palette.nothing, rect));
            }
        }
    }
}

/// Rows of a plane; none where the layer does not have it.
#[derive(Default)]
struct Sheet<'a, T> {
    samples: &'a mut [T],
    stride: usize,
}

impl<'a, T: Copy> Sheet<'a, T> {
    fn of(plane: &'a mut Plane<T>) -> Self {
        Self { stride: plane.stride(), samples: plane.samples_mut() }
    }

    /// The first rows of tiles, and the others.
    fn split(self, rows: usize) -> (Self, Self) {
        let Self { samples, stride } = self;
        let (above, below) = samples.split_at_mut((rows * TILE * stride).min(samples.len()));
        (Self { samples: above, stride }, Self { samples: below, stride })
    }

    /// What of the first row of tiles is in a tile, row by row.
    #[inline(always)]
    fn rows(&mut self, rect: Rect) -> impl Iterator<Item = &mut [T]> {
        let rows = self.samples.chunks_mut(self.stride.max(1)).take(rect.y1 - rect.y0);
        rows.map(move |row| row.get_mut(rect.x0..rect.x1).unwrap_or_default())
    }

    /// What of row `y` of the first row of tiles is in a tile of whole width.
    #[inline(always)]
    fn whole(&mut self, rect: Rect, y: usize) -> Option<&mut [T; TILE]> {
        if rect.x1 - rect.x0 != TILE {
            return None;
        }
        self.samples.get_mut(y * self.stride + rect.x0..)?.first_chunk_mut()
    }

    /// In a tile of any width.
    fn part(&mut self, rect: Rect, y: usize) -> &mut [T] {
        let first = y * self.stride;
        self.samples.get_mut(first + rect.x0..first + rect.x1).unwrap_or_default()
    }

    fn fill(&mut self, rect: Rect, value: T) {
        self.rows(rect).for_each(|row| row.fill(value));
    }
}

impl Sheet<'_, f32> {
    #[inline(always)]
    fn write_depth(&mut self, w: &[f32], nothing: f32, rect: Rect) {
        for (row, w) in self.rows(rect).zip(w.chunks_exact(STRIDE)) {
            depth_row(w, nothing, row);
        }
    }
}

/// Rows of the layer's planes, from the same one on.
struct Sheets<'a> {
    color: [Sheet<'a, u8>; 3],
    depth: Sheet<'a, f32>,
    depth2: Sheet<'a, f32>,
    normal: [Sheet<'a, f32>; 3],
    normal2: [Sheet<'a, f32>; 3],
    object: Sheet<'a, u16>,
    shield: Sheet<'a, f32>,
}

impl Sheets<'_> {
    /// The first rows of tiles, and the others.
    fn split(self, rows: usize) -> (Self, Self) {
        fn three<'a, T: Copy>(sheets: [Sheet<'a, T>; 3], rows: usize) -> [[Sheet<'a, T>; 3]; 2] {
            let [(a, d), (b, e), (c, f)] = sheets.map(|sheet| sheet.split(rows));
            [[a, b, c], [d, e, f]]
        }
        let (depth, depth2, shield) =
            (self.depth.split(rows), self.depth2.split(rows), self.shield.split(rows));
        let (object, more_object) = self.object.split(rows);
        let [above, below] = three(self.color, rows);
        let [normal, more] = three(self.normal, rows);
        let [normal2, more2] = three(self.normal2, rows);
        (
            Self {
                color: above,
                depth: depth.0,
                depth2: depth2.0,
                normal,
                normal2,
                object,
                shield: shield.0,
            },
            Self {
                color: below,
                depth: depth.1,
                depth2: depth2.1,
                normal: more,
                normal2: more2,
                object: more_object,
                shield: shield.1,
            },
        )
    }

    fn clear(&mut self, rect: Rect) {
        self.color.iter_mut().for_each(|sheet| sheet.fill(rect, 0));
        self.depth.fill(rect, f32::INFINITY);
        self.depth2.fill(rect, f32::INFINITY);
        self.object.fill(rect, 0);
        self.normal.iter_mut().chain(&mut self.normal2).for_each(|sheet| sheet.fill(rect, 0.0));
    }

    #[inline(always)]
    fn write<S: Simd>(&mut self, simd: S, palette: &Palette<'_>, slot: &Slot, rect: Rect) {
        let (nothing, channels) = (palette.nothing, palette.channels);
        if self.color[0].samples.is_empty() {
            self.depth.write_depth(slot.w(), nothing, rect);
        } else {
            let [r, g, b] = &mut self.color;
            if let Some(gray) = palette.gray() {
                let from = slot.w().chunks_exact(STRIDE).zip(slot.light().chunks_exact(STRIDE));
                for (y, (w, light)) in from.enumerate().take(rect.y1 - rect.y0) {
                    let (Some(w), Some(light)) = (w.first_chunk(), light.first_chunk()) else { return };
                    let whole =
                        (self.depth.whole(rect, y), r.whole(rect, y), g.whole(rect, y), b.whole(rect, y));
                    if let (Some(depth), Some(r), Some(g), Some(b)) = whole {
                        gray.shade_row(simd, [w, light], depth, [r, g, b]);
                    } else {
                        let (depth, colors) =
                            (self.depth.part(rect, y), [r.part(rect, y), g.part(rect, y), b.part(rect, y)]);
                        gray.shade_part(simd, [w, light], depth, colors);
                    }
                }
            } else {
                let colors = r.rows(rect).zip(g.rows(rect)).zip(b.rows(rect));
                for (y, (depth, ((r, g), b))) in self.depth.rows(rect).zip(colors).enumerate() {
                    shade_row(simd, palette, slot, y, depth, [r, g, b]);
                }
            }
        }
        self.write_objects(palette, slot, rect);
        if let (false, [w, x, y, z]) = (self.normal[0].samples.is_empty(), &slot.near[..]) {
            write_normals(simd, w, nothing, [x, y, z], &mut self.normal, rect);
        }
        if let (false, [w, x, y, z, ..]) =
            (self.normal2[0].samples.is_empty(), &slot.others[channels.second_at()..])
        {
            self.depth2.write_depth(w, nothing, rect);
            write_normals(simd, w, nothing, [x, y, z], &mut self.normal2, rect);
        }
    }
}

impl Sheets<'_> {
    /// The models that the pixels show.
    #[inline(always)]
    fn write_objects(&mut self, palette: &Palette<'_>, slot: &Slot, rect: Rect) {
        let model = |surface: i32| palette.surfaces.get(surface as usize).map_or(0, |s| s.model as u16 + 1);
        let of_all = model(0);
        for (y, row) in self.object.rows(rect).enumerate() {
            let part = y * STRIDE..y * STRIDE + row.len();
            for (out, &w) in row.iter_mut().zip(&slot.w()[part.clone()]) {
                *out = if w > palette.nothing { of_all } else { 0 };
            }
            if palette.channels.surfaces {
                for (out, &surface) in row.iter_mut().zip(&slot.surface[part]).filter(|(out, _)| **out != 0) {
                    *out = model(surface);
                }
            }
        }
    }
}

/// Normals to unit length, row by row.
#[inline(always)]
fn write_normals<S: Simd>(
    simd: S,
    w: &[f32],
    nothing: f32,
    [x, y, z]: [&[f32]; 3],
    to: &mut [Sheet<'_, f32>; 3],
    rect: Rect,
) {
    let rows = w
        .chunks_exact(STRIDE)
        .zip(x.chunks_exact(STRIDE))
        .zip(y.chunks_exact(STRIDE).zip(z.chunks_exact(STRIDE)));
    for (row, ((w, x), (y, z))) in rows.enumerate().take(rect.y1 - rect.y0) {
        let (Some(w), Some(x)) = (w.first_chunk(), x.first_chunk()) else { return };
        let (Some(y), Some(z)) = (y.first_chunk(), z.first_chunk()) else { return };
        let [ox, oy, oz] = &mut *to;
        if let (Some(ox), Some(oy), Some(oz)) =
            (ox.whole(rect, row), oy.whole(rect, row), oz.whole(rect, row))
        {
            unit_row(simd, w, nothing, [x, y, z], [ox, oy, oz]);
        } else {
            let [mut nx, mut ny, mut nz] = [[0.0; TILE]; 3];
            unit_row(simd, w, nothing, [x, y, z], [&mut nx, &mut ny, &mut nz]);
            for (out, n) in [ox, oy, oz].into_iter().zip([nx, ny, nz]) {
                let out = out.part(rect, row);
                out.copy_from_slice(&n[..out.len()]);
            }
        }
    }
}

#[inline(always)]
fn depth_row(w: &[f32], nothing: f32, out: &mut [f32]) {
    for (out, &w) in out.iter_mut().zip(w) {
        *out = if w > nothing { 1.0 / w } else { f32::INFINITY };
    }
}

/// Divides by the length; no direction and no surface give 0.
#[inline(always)]
fn unit_row<S: Simd>(
    simd: S,
    w: &[f32; TILE],
    nothing: f32,
    [x, y, z]: [&[f32; TILE]; 3],
    [ox, oy, oz]: [&mut [f32; TILE]; 3],
) {
    let of = |v: f32| f32x8::splat(simd, v);
    for at in (0..TILE).step_by(RUN) {
        let covered = load(simd, w, at).simd_gt(of(nothing));
        let (mut nx, mut ny, mut nz) = (of(0.0), of(0.0), of(0.0));
        if covered.any_true() {
            let (x, y, z) = (load(simd, x, at), load(simd, y, at), load(simd, z, at));
            let squared = x * x + y * y + z * z;
            let known = covered & squared.simd_gt(of(0.0)) & squared.simd_lt(of(f32::INFINITY));
            let inverse = known.select(of(1.0) / squared.sqrt(), of(0.0));
            (nx, ny, nz) =
                (known.select(x * inverse, nx), known.select(y * inverse, ny), known.select(z * inverse, nz));
        }
        nx.store_slice(&mut ox[at..at + RUN]);
        ny.store_slice(&mut oy[at..at + RUN]);
        nz.store_slice(&mut oz[at..at + RUN]);
    }
}
