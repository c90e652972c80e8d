//! From tiles to the layer's planes: 1/z to z, attributes to color, normals to unit length; tiles that were covered
//! last time and are not now go back to the background.

use super::shade::{Palette, shade_row};
use super::tile::{STRIDE, Slot};
use crate::frame::Layer;
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, PlaneMut, TILE, TileGrid, TileSet};
use rayon::prelude::*;

/// Which tiles a band of rows must write.
struct Tiles<'a> {
    grid: TileGrid,
    slots: &'a [Slot],
    slot_of: &'a [u32],
    previous: &'a TileSet,
    /// 1/z that stands for no surface.
    nothing: f32,
}

/// What happens to a tile.
enum Fate<'a> {
    Draw(&'a Slot),
    Clear,
}

impl<'a> Tiles<'a> {
    /// The tiles of one row of tiles that change, with their columns in the picture.
    fn of_row(&self, row: usize) -> impl Iterator<Item = (std::ops::Range<usize>, Fate<'a>)> {
        let columns = self.grid.columns();
        (row * columns..(row + 1) * columns).filter_map(move |tile| {
            let rect = self.grid.rect(tile);
            let fate = match self.slots.get(self.slot_of[tile] as usize) {
                Some(slot) => Fate::Draw(slot),
                None if self.previous.contains(tile) => Fate::Clear,
                None => return None,
            };
            Some((rect.x0..rect.x1, fate))
        })
    }
}

/// Writes all planes the layer has.
pub(super) fn resolve(
    level: Level,
    layer: &mut Layer,
    palette: &Palette<'_>,
    grid: TileGrid,
    slots: &[Slot],
    slot_of: &[u32],
    previous: &TileSet,
) {
    if layer.touched.is_empty() && previous.is_empty() {
        return;
    }
    let tiles = &Tiles { grid, slots, slot_of, previous, nothing: palette.nothing };
    if layer.color.size().area() > 0 {
        let [r, g, b] = layer.color.planes.each_mut().map(|p| p.view_mut().par_bands(TILE));
        let depth = layer.depth.view_mut().par_bands(TILE);
        r.zip(g).zip(b).zip(depth).with_max_len(1).for_each(|(((r, g), b), depth)| {
            let (row, mut bands, mut depth) = (r.0 / TILE, [r.1, g.1, b.1], depth.1);
            for (columns, fate) in tiles.of_row(row) {
                write_color(level, palette, &mut bands, &mut depth, columns, &fate);
            }
        });
    } else {
        depth_alone(level, &mut layer.depth, tiles, |slot| &slot.w);
    }
    depth_alone(level, &mut layer.depth2, tiles, |slot| &slot.w2);
    let first = palette.channels.normal_at();
    normals(level, &mut layer.normal, tiles, |slot| (&slot.w, &slot.attributes[first..]));
    normals(level, &mut layer.normal2, tiles, |slot| (&slot.w2, &slot.normal2));
}

fn depth_alone(level: Level, plane: &mut Plane<f32>, tiles: &Tiles<'_>, of: impl Fn(&Slot) -> &[f32] + Sync) {
    plane.view_mut().par_bands(TILE).with_max_len(1).for_each(|(first, mut band)| {
        for (columns, fate) in tiles.of_row(first / TILE) {
            write_depth(level, tiles.nothing, &mut band, columns, &fate, &of);
        }
    });
}

fn normals(
    level: Level,
    planes: &mut [Plane<f32>; 3],
    tiles: &Tiles<'_>,
    of: impl Fn(&Slot) -> (&[f32], &[Vec<f32>]) + Sync,
) {
    if planes[0].size().area() == 0 {
        return;
    }
    let [x, y, z] = planes.each_mut().map(|p| p.view_mut().par_bands(TILE));
    x.zip(y).zip(z).with_max_len(1).for_each(|((x, y), z)| {
        let (row, mut bands) = (x.0 / TILE, [x.1, y.1, z.1]);
        for (columns, fate) in tiles.of_row(row) {
            for y in 0..bands[0].size().height {
                let [bx, by, bz] = bands.each_mut().map(|band| &mut band.row_mut(y)[columns.clone()]);
                match &fate {
                    Fate::Clear => [bx, by, bz].into_iter().for_each(|row| row.fill(0.0)),
                    Fate::Draw(slot) => {
                        let (w, n) = of(slot);
                        let part = y * STRIDE..y * STRIDE + bx.len();
                        let [nx, ny, nz, ..] = n else { continue };
                        let from = [nx, ny, nz].map(|plane| &plane[part.clone()]);
                        dispatch!(level, _simd => unit_row(&w[part.clone()], tiles.nothing, from, [bx, by, bz]));
                    }
                }
            }
        }
    });
}

fn write_depth(
    level: Level,
    nothing: f32,
    band: &mut PlaneMut<'_, f32>,
    columns: std::ops::Range<usize>,
    fate: &Fate<'_>,
    of: impl Fn(&Slot) -> &[f32],
) {
    for y in 0..band.size().height {
        let out = &mut band.row_mut(y)[columns.clone()];
        match fate {
            Fate::Clear => out.fill(f32::INFINITY),
            Fate::Draw(slot) => {
                let w = &of(slot)[y * STRIDE..y * STRIDE + out.len()];
                dispatch!(level, _simd => depth_row(w, nothing, out));
            }
        }
    }
}

/// Depth and color.
fn write_color(
    level: Level,
    palette: &Palette<'_>,
    bands: &mut [PlaneMut<'_, u8>; 3],
    depth: &mut PlaneMut<'_, f32>,
    columns: std::ops::Range<usize>,
    fate: &Fate<'_>,
) {
    let write = |y: usize, depth: &mut [f32], [r, g, b]: [&mut [u8]; 3]| match fate {
        Fate::Clear => {
            depth.fill(f32::INFINITY);
            [r, g, b].into_iter().for_each(|row| row.fill(0));
        }
        Fate::Draw(slot) => {
            dispatch!(level, simd => shade_row(simd, palette, slot, y, depth, [r, g, b]));
        }
    };
    for y in 0..depth.size().height {
        let color = bands.each_mut().map(|band| &mut band.row_mut(y)[columns.clone()]);
        write(y, &mut depth.row_mut(y)[columns.clone()], color);
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
fn unit_row(w: &[f32], nothing: f32, from: [&[f32]; 3], out: [&mut [f32]; 3]) {
    let [ox, oy, oz] = out;
    for (i, &w) in w.iter().enumerate() {
        let (x, y, z) = (from[0][i], from[1][i], from[2][i]);
        let length = (x * x + y * y + z * z).sqrt();
        let known = w > nothing && length > 0.0 && length < f32::INFINITY;
        (ox[i], oy[i], oz[i]) = if known { (x / length, y / length, z / length) } else { (0.0, 0.0, 0.0) };
    }
}
