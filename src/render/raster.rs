//! One tile: walk the records of all chunks in order, eight pixels at a time.
//!
//! Coverage is exact: integer edge functions of the snapped corners, the fill rule folded into the constant.
//! 1/z and the two barycentric weights of the unsnapped corners are evaluated in f64 at the start of every
//! run of eight pixels and stepped in f32 inside it, so that the error is that of eight pixels' steps however
//! large the triangle is. Nearest and second-nearest surface are kept in the same pass.

use super::bins::{Chunk, OWN, Record};
use super::shade::{Kind, Surface, sample};
use super::{Needs, TILE_AREA, View};
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Rgb, TILE};
use fearless_simd::{Simd, SimdBase, SimdFrom, f32x8, i32x8, mask32x8, prelude::*};

/// Pixels of a run.
const RUN: usize = 8;

/// The pixels of one tile while it is drawn; row by row, 64 a row.
#[derive(Default)]
pub(super) struct Slot {
    /// The tile of the picture.
    pub tile: usize,
    /// Whether any pixel inside the picture is covered.
    pub covered: bool,
    /// 1/z of the nearest surface, 0 where there is none.
    pub w: Vec<f32>,
    /// Its color, red in the lowest byte; unspecified where there is none.
    pub color: Vec<i32>,
    /// Its normal, not of unit length.
    pub normal: [Vec<f32>; 3],
    /// 1/z of the second-nearest surface.
    pub w2: Vec<f32>,
    /// Its normal, not of unit length.
    pub normal2: [Vec<f32>; 3],
}

impl Slot {
    /// Allocates what `needs` asks for.
    pub fn fit(&mut self, needs: Needs) {
        let second = needs.includes(Needs::SECOND_LAYER);
        let area = |wanted: bool| if wanted { TILE_AREA } else { 0 };
        self.w.resize(TILE_AREA, 0.0);
        self.color.resize(area(needs.includes(Needs::COLOR)), 0);
        self.w2.resize(area(second), 0.0);
        for plane in &mut self.normal {
            plane.resize(area(second || needs.includes(Needs::NORMAL)), 0.0);
        }
        for plane in &mut self.normal2 {
            plane.resize(area(second), 0.0);
        }
    }
}

/// Draws everything that touches the slot's tile.
pub(super) fn draw_tile(level: Level, view: &View<'_>, chunks: &[Chunk], slot: &mut Slot) {
    slot.w.fill(0.0);
    slot.w2.fill(0.0);
    dispatch!(level, simd => draw_records(simd, view, chunks, slot));
    let rect = view.grid.rect(slot.tile);
    let rows = slot.w.chunks_exact(TILE).take(rect.y1 - rect.y0);
    slot.covered = rows.into_iter().any(|row| row[..rect.x1 - rect.x0].iter().any(|&w| w > 0.0));
}

#[inline(always)]
fn draw_records<S: Simd>(simd: S, view: &View<'_>, chunks: &[Chunk], slot: &mut Slot) {
    let rect = view.grid.rect(slot.tile);
    let far = (1.0 / view.camera.far) as f32;
    for chunk in chunks {
        for record in chunk.records_of(slot.tile) {
            let [x0, y0, x1, y1] = record.bounds;
            let (x0, y0, x1, y1) = (x0 as usize, y0 as usize, x1 as usize, y1 as usize);
            if x0 >= rect.x1 || y0 >= rect.y1 || x1 < rect.x0 || y1 < rect.y0 {
                continue;
            }
            let area = Area {
                origin: [rect.x0 as i32, rect.y0 as i32],
                first: x0.max(rect.x0) - rect.x0,
                top: y0.max(rect.y0) - rect.y0,
                last: x1.min(rect.x1 - 1) - rect.x0,
                bottom: y1.min(rect.y1 - 1) - rect.y0,
            };
            let [a, b, c] = record.corners;
            let corners = [
                corner(view, chunk, record, a),
                corner(view, chunk, record, b),
                corner(view, chunk, record, c),
            ];
            let surface = &view.surfaces[record.surface as usize];
            let light = view.scene.light.direction.to_array();
            let paint = Paint { surface, texture: surface.texture(view.scene), face: record.face, light };
            draw_triangle(simd, &area, &corners, &paint, far, slot);
        }
    }
}

/// The pixels of a tile that a triangle may cover, in tile coordinates, inclusive.
struct Area {
    origin: [i32; 2],
    first: usize,
    top: usize,
    last: usize,
    bottom: usize,
}

struct Corner {
    x: f64,
    y: f64,
    w: f64,
    snapped: [i32; 2],
    intensity: f32,
    normal: [f32; 3],
    uv: [f32; 2],
}

struct Paint<'a> {
    surface: &'a Surface,
    texture: Option<&'a Rgb>,
    face: f32,
    light: [f32; 3],
}

#[inline(always)]
fn corner(view: &View<'_>, chunk: &Chunk, record: &Record, index: u32) -> Corner {
    let (vertex, uv) = if index & OWN != 0 {
        let own = &chunk.own[(index & !OWN) as usize];
        (&own.vertex, own.uv)
    } else {
        let model = view.instances[record.instance as usize].placed.model;
        let texcoords = &view.scene.models[model].mesh.texcoords;
        let uv = match texcoords.get((index - record.first_vertex) as usize) {
            Some(uv) => [uv.x, uv.y],
            None => [0.0; 2],
        };
        (&view.vertices[index as usize], uv)
    };
    let (x, y, w, snapped) = (vertex.x, vertex.y, vertex.w, vertex.snapped);
    Corner { x, y, w, snapped, intensity: vertex.intensity, normal: vertex.normal, uv }
}

/// The three edge functions over an area, divided by 256 with the sign kept exact: a pixel center is a whole
/// number of steps away, so only the constant has a fraction, and rounding it down changes no sign.
struct Edges {
    start: [i64; 3],
    right: [i64; 3],
    down: [i64; 3],
    /// Whether a value in the area may exceed 32 bits.
    wide: bool,
}

impl Edges {
    /// `None` when some edge leaves the whole area outside.
    #[inline(always)]
    fn new(area: &Area, corners: &[Corner; 3]) -> Option<Self> {
        let first = area.first / RUN * RUN;
        let columns = (area.last / RUN * RUN + RUN - 1 - first) as i64;
        let rows = (area.bottom - area.top) as i64;
        let x = i64::from(area.origin[0]) * 256 + first as i64 * 256;
        let y = i64::from(area.origin[1]) * 256 + area.top as i64 * 256;
        let mut edges = Edges { start: [0; 3], right: [0; 3], down: [0; 3], wide: false };
        for k in 0..3 {
            let (from, to) = (&corners[k].snapped, &corners[if k == 2 { 0 } else { k + 1 }].snapped);
            let (x0, y0) = (i64::from(from[0]), i64::from(from[1]));
            let (x1, y1) = (i64::from(to[0]), i64::from(to[1]));
            let (right, down) = (y0 - y1, x1 - x0);
            // top: to the right along the row; left: upwards (y down, inside on the right hand)
            let owned = right > 0 || (right == 0 && down > 0);
            let start = (right * (x - x0) + down * (y - y0) - i64::from(!owned)) >> 8;
            let (across, along) = (right * columns, down * rows);
            if start + across.max(0) + along.max(0) < 0 {
                return None;
            }
            if start + across.min(0) + along.min(0) >= 0 {
                continue; // inside everywhere: stays 0
            }
            edges.wide |= across.abs() + along.abs() >= i64::from(i32::MAX);
            (edges.start[k], edges.right[k], edges.down[k]) = (start, right, down);
        }
        Some(edges)
    }
}

impl Edges {
    /// The values some pixels to the right of and below the area's first run.
    #[inline(always)]
    fn at(&self, across: i64, along: i64) -> [i64; 3] {
        let [a, b, c] = self.start;
        [
            a + self.right[0] * across + self.down[0] * along,
            b + self.right[1] * across + self.down[1] * along,
            c + self.right[2] * across + self.down[2] * along,
        ]
    }
}

/// Linear in x and y over the tile: value at the tile's first pixel center and steps.
#[derive(Clone, Copy)]
struct Slope {
    origin: f64,
    right: f64,
    down: f64,
}

impl Slope {
    #[inline(always)]
    fn at(&self, x: usize, y: usize) -> f32 {
        (self.origin + self.right * x as f64 + self.down * y as f64) as f32
    }
}

/// A weight from its steps, 0 at the corner that lies (ox, oy) before the tile's origin.
#[inline(always)]
fn weight(ox: f64, oy: f64, right: f64, down: f64) -> Slope {
    let origin = ox * right + oy * down;
    if (origin + right + down).is_finite() {
        Slope { origin, right, down }
    } else {
        // no area before snapping: the middle of the triangle stands for all of it
        Slope { origin: 1.0 / 3.0, right: 0.0, down: 0.0 }
    }
}

/// The unsnapped triangle's barycentric weights of corners 1 and 2, and 1/z.
#[inline(always)]
fn slopes(area: &Area, [a, b, c]: &[Corner; 3]) -> [Slope; 3] {
    let (abx, aby, acx, acy) = (b.x - a.x, b.y - a.y, c.x - a.x, c.y - a.y);
    let inverse = 1.0 / (abx * acy - acx * aby);
    let (ox, oy) = (f64::from(area.origin[0]) - a.x, f64::from(area.origin[1]) - a.y);
    let l1 = weight(ox, oy, acy * inverse, -acx * inverse);
    let l2 = weight(ox, oy, -aby * inverse, abx * inverse);
    let (d1, d2) = (b.w - a.w, c.w - a.w);
    let w = Slope {
        origin: a.w + l1.origin * d1 + l2.origin * d2,
        right: l1.right * d1 + l2.right * d2,
        down: l1.down * d1 + l2.down * d2,
    };
    [l1, l2, w]
}

/// An attribute times 1/z at corner 0, and its differences to corners 1 and 2.
#[inline(always)]
fn plane([a, b, c]: &[Corner; 3], [p, q, r]: [f32; 3]) -> [f32; 3] {
    let (p, q, r) = (f64::from(p) * a.w, f64::from(q) * b.w, f64::from(r) * c.w);
    [p as f32, (q - p) as f32, (r - p) as f32]
}

#[inline(always)]
fn draw_triangle<S: Simd>(
    simd: S,
    area: &Area,
    corners: &[Corner; 3],
    paint: &Paint<'_>,
    far: f32,
    slot: &mut Slot,
) {
    let Some(edges) = Edges::new(area, corners) else { return };
    let [l1, l2, w] = slopes(area, corners);
    let (color, normals, second) = (!slot.color.is_empty(), !slot.normal[0].is_empty(), !slot.w2.is_empty());

    let lanes = f32x8::simd_from(simd, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
    // no closures and no array `map` in here: what is not inlined runs without the level's instructions
    let l1_step = lanes * f32x8::splat(simd, l1.right as f32);
    let l2_step = lanes * f32x8::splat(simd, l2.right as f32);
    let w_step = lanes * f32x8::splat(simd, w.right as f32);
    let far = f32x8::splat(simd, far);
    // snapping moves a covered center at most .003 px out of the triangle; slivers must not turn that into
    // any depth at all
    let [wa, wb, wc] = [corners[0].w, corners[1].w, corners[2].w];
    let (least, most) = (wa.min(wb).min(wc), wa.max(wb).max(wc));
    let reach = (most - least) * 0.5;
    let low = f32x8::splat(simd, (least - reach).max(least * 0.5) as f32);
    let high = f32x8::splat(simd, (most + reach) as f32);

    let [a, b, c] = corners;
    let intensity = plane(corners, [a.intensity, b.intensity, c.intensity]);
    let three_steps = color && paint.surface.kind == Kind::ThreeSteps;
    let mut normal = [[0.0; 3]; 3];
    if normals || three_steps {
        for (k, out) in normal.iter_mut().enumerate() {
            *out = plane(corners, [a.normal[k], b.normal[k], c.normal[k]]);
        }
    }
    let mut uv = [[0.0; 3]; 2];
    if paint.texture.is_some() {
        for (k, out) in uv.iter_mut().enumerate() {
            *out = plane(corners, [a.uv[k], b.uv[k], c.uv[k]]);
        }
    }

    let ramp = i32x8::simd_from(simd, [0, 1, 2, 3, 4, 5, 6, 7]);
    let e_step = [
        ramp * i32x8::splat(simd, edges.right[0] as i32),
        ramp * i32x8::splat(simd, edges.right[1] as i32),
        ramp * i32x8::splat(simd, edges.right[2] as i32),
    ];
    let first = area.first / RUN * RUN;
    for y in area.top..=area.bottom {
        for x in (first..=area.last).step_by(RUN) {
            let (across, along) = ((x - first) as i64, (y - area.top) as i64);
            let start = edges.at(across, along);
            let inside = if edges.wide {
                wide_inside(simd, start, &edges.right)
            } else {
                let e0 = i32x8::splat(simd, start[0] as i32) + e_step[0];
                let e1 = i32x8::splat(simd, start[1] as i32) + e_step[1];
                let e2 = i32x8::splat(simd, start[2] as i32) + e_step[2];
                (e0 | e1 | e2).simd_ge(i32x8::splat(simd, 0))
            };
            if inside.all_false() {
                continue;
            }
            let at = y * TILE + x;
            let here = f32x8::splat(simd, w.at(x, y)) + w_step;
            let here = here.simd_lt(low).select(low, here);
            let here = high.simd_lt(here).select(high, here);
            let inside = inside & here.simd_ge(far);
            let before = load(simd, &slot.w, at);
            let wins = inside & here.simd_gt(before);
            let any = wins.any_true();
            if !any && !second {
                continue;
            }
            let b1 = f32x8::splat(simd, l1.at(x, y)) + l1_step;
            let b2 = f32x8::splat(simd, l2.at(x, y)) + l2_step;
            if second {
                // a fragment behind the first may be the second; a new first makes the old one second
                let before2 = load(simd, &slot.w2, at);
                let behind = inside & here.simd_lt(before) & here.simd_gt(before2);
                if !any && behind.all_false() {
                    continue;
                }
                let now2 = wins.select(before, behind.select(here, before2));
                store(now2, &mut slot.w2, at);
                for (k, &plane) in normal.iter().enumerate() {
                    let old = load(simd, &slot.normal[k], at);
                    let old2 = load(simd, &slot.normal2[k], at);
                    let new = blend(simd, b1, b2, plane);
                    store(wins.select(old, behind.select(new, old2)), &mut slot.normal2[k], at);
                }
                if !any {
                    continue;
                }
            }
            store(wins.select(here, before), &mut slot.w, at);
            if normals {
                for (k, &plane) in normal.iter().enumerate() {
                    let old = load(simd, &slot.normal[k], at);
                    store(wins.select(blend(simd, b1, b2, plane), old), &mut slot.normal[k], at);
                }
            }
            if color {
                let z = f32x8::splat(simd, 1.0) / here;
                let light = match paint.surface.kind {
                    Kind::Flat => f32x8::splat(simd, paint.face),
                    Kind::ThreeSteps => {
                        let nx = blend(simd, b1, b2, normal[0]);
                        let ny = blend(simd, b1, b2, normal[1]);
                        let nz = blend(simd, b1, b2, normal[2]);
                        let [lx, ly, lz] = paint.light;
                        let length = (nx * nx + ny * ny + nz * nz).sqrt();
                        let towards = nx * lx + ny * ly + nz * lz;
                        let (dark, middle) = (f32x8::splat(simd, 0.1), f32x8::splat(simd, 0.4));
                        let light = towards.simd_gt(length * 0.2).select(middle, dark);
                        towards.simd_gt(length * 0.7).select(f32x8::splat(simd, 1.0), light)
                    }
                    _ => unit_range(simd, blend(simd, b1, b2, intensity) * z),
                };
                let light = match paint.surface.kind {
                    Kind::Toon => {
                        let mut out = [0.0f32; RUN];
                        light.store_slice(&mut out);
                        for value in &mut out {
                            *value = paint.surface.toon(*value);
                        }
                        f32x8::simd_from(simd, out)
                    }
                    _ => light,
                };
                let ambient = paint.surface.ambient;
                let light = f32x8::splat(simd, ambient) + f32x8::splat(simd, 1.0 - ambient) * light;
                let texels = match paint.texture {
                    Some(texture) => {
                        let (mut u, mut v) = ([0.0f32; RUN], [0.0f32; RUN]);
                        (blend(simd, b1, b2, uv[0]) * z).store_slice(&mut u);
                        (blend(simd, b1, b2, uv[1]) * z).store_slice(&mut v);
                        let mut texels = [[1.0f32; RUN]; 3];
                        let bits = wins.to_bitmask();
                        for k in 0..RUN {
                            if bits >> k & 1 == 1 {
                                let [r, g, b] = sample(texture, u[k], v[k]);
                                (texels[0][k], texels[1][k], texels[2][k]) = (r, g, b);
                            }
                        }
                        [
                            light * f32x8::simd_from(simd, texels[0]),
                            light * f32x8::simd_from(simd, texels[1]),
                            light * f32x8::simd_from(simd, texels[2]),
                        ]
                    }
                    None => [light; 3],
                };
                let base = paint.surface.color;
                let r = to_level(simd, texels[0], base[0]);
                let g = to_level(simd, texels[1], base[1]);
                let b = to_level(simd, texels[2], base[2]);
                let packed = r | (g << 8) | (b << 16);
                let old = i32x8::from_slice(simd, &slot.color[at..at + RUN]);
                wins.select(packed, old).store_slice(&mut slot.color[at..at + RUN]);
            }
        }
    }
}

/// An attribute times 1/z where the corners' weights are `b1` and `b2`.
#[inline(always)]
fn blend<S: Simd>(simd: S, b1: f32x8<S>, b2: f32x8<S>, [p, q, r]: [f32; 3]) -> f32x8<S> {
    f32x8::splat(simd, p) + b1 * f32x8::splat(simd, q) + b2 * f32x8::splat(simd, r)
}

/// Light times base color, rounded to a whole level.
#[inline(always)]
fn to_level<S: Simd>(simd: S, light: f32x8<S>, base: f32) -> i32x8<S> {
    (light * f32x8::splat(simd, base) + f32x8::splat(simd, 0.5)).to_int()
}

#[inline(always)]
fn load<S: Simd>(simd: S, plane: &[f32], at: usize) -> f32x8<S> {
    f32x8::from_slice(simd, &plane[at..at + RUN])
}

#[inline(always)]
fn store<S: Simd>(value: f32x8<S>, plane: &mut [f32], at: usize) {
    value.store_slice(&mut plane[at..at + RUN]);
}

/// Clamped to 0..1; not-a-number becomes 0.
#[inline(always)]
fn unit_range<S: Simd>(simd: S, v: f32x8<S>) -> f32x8<S> {
    let (zero, one) = (f32x8::splat(simd, 0.0), f32x8::splat(simd, 1.0));
    let v = v.simd_gt(zero).select(v, zero);
    v.simd_lt(one).select(v, one)
}

/// Coverage of a run whose edge functions need 64 bits.
#[inline(always)]
fn wide_inside<S: Simd>(simd: S, start: [i64; 3], right: &[i64; 3]) -> mask32x8<S> {
    let mut bits = 0;
    for lane in 0..RUN {
        let step = lane as i64;
        let values =
            (start[0] + right[0] * step) | (start[1] + right[1] * step) | (start[2] + right[2] * step);
        let inside = values >= 0;
        bits |= u64::from(inside) << lane;
    }
    mask32x8::from_bitmask(simd, bits)
}
