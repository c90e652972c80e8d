//! One tile: walk the records of all chunks in order, a run of pixels at a time.
//!
//! Coverage is exact: integer edge functions of the snapped corners, the fill rule folded into the constant.
//! 1/z and attributes over z of the unsnapped corners are evaluated in f64 at the start of every row and stepped in
//! f32 along it. Where they are so steep that the steps would round badly the triangle is drawn in strips of eight
//! pixels, so that the error is that of seven steps however large it is. Nearest and second-nearest surface are kept
//! in the same pass. Runs are as wide as the machine's vectors: no value depends on where they begin.

use super::bins::{Chunk, LARGE, OWN, Record};
use super::edges::{Area, Edges, Slope, Weights};
use super::run::{Line, Run};
use super::tile::{Channels, MOST, STRIDE, Slot};
use super::vertex::{Spot, Vertex, narrow};
use super::{Instance, View};
use crate::pixels::TILE;
use crate::pixels::simd::{Level, dispatch};
use fearless_simd::{Simd, f64x4, prelude::*};
use glam::{Vec2, Vec3};

/// Width of the strips of steep triangles, px.
const STRIP: i32 = 8;
/// Steep: over the triangle's width in the tile 1/z changes by more than this share of its least value...
const STEEP_DEPTH: f64 = 1.0;
/// ... or the corners' weights by more than this.
const STEEP_WEIGHTS: f64 = 16.0;
/// A sliver: the corners' weights change by more than this in a pixel.
const SLIVER: f64 = 32.0;

/// The body is built for each of three cases: light alone; both layers, light or not; and anything.
const PLAIN: u8 = 0;
const BOTH: u8 = 1;
const ANY: u8 = 2;

/// Draws everything that touches the slot's tile.
pub(super) fn draw_tile(level: Level, view: &View<'_>, chunks: &[Chunk], slot: &mut Slot) {
    slot.clear(view.channels, view.nothing);
    let Channels { light, normals, uv, colors, surfaces, second, phantoms } = view.channels;
    match (second, normals || !light, uv || colors || surfaces || phantoms) {
        (false, false, false) => dispatch!(level, simd => draw_records::<_, PLAIN>(simd, view, chunks, slot)),
        (true, _, false) => dispatch!(level, simd => draw_records::<_, BOTH>(simd, view, chunks, slot)),
        _ => dispatch!(level, simd => draw_records::<_, ANY>(simd, view, chunks, slot)),
    }
    let rect = view.shot.grid.rect(slot.tile);
    let mut rows = slot.w.chunks_exact(STRIDE).take(rect.y1 - rect.y0);
    let most = |row: &[f32]| row.iter().fold(0, |most, w| w.to_bits().max(most));
    slot.covered = rows.any(|row| most(&row[..rect.x1 - rect.x0]) > view.nothing.to_bits());
}

/// What stays the same for all records of a chunk in a tile.
struct Pen<'a> {
    /// Top left pixel of the tile.
    origin: [i32; 2],
    channels: Channels,
    phantom: bool,
    source: Source<'a>,
}

#[inline(always)]
fn draw_records<S: Simd, const MODE: u8>(simd: S, view: &View<'_>, chunks: &[Chunk], slot: &mut Slot) {
    let rect = view.shot.grid.rect(slot.tile);
    let [left, top, right, bottom] = [rect.x0, rect.y0, rect.x1 - 1, rect.y1 - 1].map(|v| v as i32);
    for chunk in chunks {
        if !chunk.holds(slot.tile) {
            continue;
        }
        let instance = &view.instances[chunk.instance];
        let phantom = view.shot.scene.models[instance.placed.model].phantom;
        let whole = Source::of_instance(view, instance);
        let pen = |source| Pen { origin: [left, top], channels: view.channels, phantom, source };
        let (whole, own) = (pen(whole), pen(Source::of_chunk(chunk)));
        for record in chunk.records_of(slot.tile) {
            let [x0, y0, x1, y1] = record.bounds;
            let area = Area {
                first: i32::from(x0).max(left),
                top: i32::from(y0).max(top),
                last: i32::from(x1).min(right),
                bottom: i32::from(y1).min(bottom),
            };
            if area.first > area.last || area.top > area.bottom {
                continue;
            }
            if (record.corners[0] | record.corners[1]) & (OWN | LARGE) == 0 {
                let Some(triangle) = Triangle::new(&whole, record, record.corners) else { continue };
                let edges = Edges::small(simd, &area, triangle.spots());
                if draw_area::<S, MODE>(simd, &triangle, &area, &edges, None, slot) {
                    continue;
                }
            }
            let pen = if record.corners[0] & OWN == 0 { &whole } else { &own };
            draw_slowly::<S, MODE>(simd, pen, record, &area, slot);
        }
    }
}

/// Large triangles, those made by cutting and steep ones.
#[inline(never)]
fn draw_slowly<S: Simd, const MODE: u8>(
    simd: S,
    pen: &Pen<'_>,
    record: &Record,
    area: &Area,
    slot: &mut Slot,
) {
    let [a, b, c] = record.corners;
    let Some(triangle) = Triangle::new(pen, record, [a & !OWN, b & !LARGE, c]) else { return };
    let mut draw = |area: &Area| {
        let Some(exact) = Edges::new(area, triangle.spots()) else { return true };
        let (edges, wide) = match exact.narrow(area) {
            Some(edges) => (edges, None),
            None => (Edges::default(), Some(&exact)),
        };
        simd.vectorize(
            #[inline(always)]
            || draw_area::<S, MODE>(simd, &triangle, area, &edges, wide, slot),
        )
    };
    if draw(area) {
        return;
    }
    for first in (area.first..=area.last).step_by(STRIP as usize) {
        draw(&Area { first, last: area.last.min(first + STRIP - 1), ..*area });
    }
}

/// Where the corners of records are: the vertices of an instance, or those a chunk made by cutting.
struct Source<'a> {
    places: &'a [Vertex],
    normals: &'a [[f32; 4]],
    uv: &'a [Vec2],
    colors: &'a [Vec3],
}

impl<'a> Source<'a> {
    fn of_instance(view: &View<'a>, instance: &Instance) -> Self {
        let mesh = &view.shot.scene.models[instance.placed.model].mesh;
        let (first, vertices) = (instance.first_vertex, view.vertices);
        Self {
            places: &vertices.places[first..],
            normals: vertices.normals.get(first..).unwrap_or_default(),
            uv: &mesh.texcoords,
            colors: &mesh.colors,
        }
    }

    fn of_chunk(chunk: &'a Chunk) -> Self {
        let own = &chunk.own;
        let (uv, colors) = (&chunk.own_uv, &chunk.own_colors);
        Self { places: &own.places, normals: &own.normals, uv, colors }
    }
}

/// A triangle to draw.
struct Triangle<'a> {
    pen: &'a Pen<'a>,
    record: &'a Record,
    index: [usize; 3],
    places: [&'a Vertex; 3],
}

impl<'a> Triangle<'a> {
    /// `corners` are the record's without their marks.
    #[inline(always)]
    fn new(pen: &'a Pen<'a>, record: &'a Record, corners: [u32; 3]) -> Option<Self> {
        let index = [corners[0] as usize, corners[1] as usize, corners[2] as usize];
        let places = pen.source.places;
        let places = [places.get(index[0])?, places.get(index[1])?, places.get(index[2])?];
        Some(Self { pen, record, index, places })
    }

    #[inline(always)]
    fn spots(&self) -> [Spot; 3] {
        [self.places[0].spot, self.places[1].spot, self.places[2].spot]
    }
}

/// Lane numbers; no vector has more.
const LANES: [i32; STRIDE - TILE] = [0, 1, 2, 3, 4, 5, 6, 7];

/// Draws a triangle's pixels in the area; `false`, and nothing is drawn, where it is too wide for how steep it is.
/// `wide` stands for `edges` where they do not fit.
#[inline(always)]
fn draw_area<S: Simd, const MODE: u8>(
    simd: S,
    triangle: &Triangle<'_>,
    area: &Area,
    edges: &Edges<i32>,
    wide: Option<&Edges<i64>>,
    slot: &mut Slot,
) -> bool {
    let splat = |v: f32| S::f32s::simd_from(simd, v);
    let whole = |v: i32| S::i32s::simd_from(simd, v);
    let length = S::f32s::LEN as i32;
    let (r0, r1, r2) = (whole(edges.right[0]), whole(edges.right[1]), whole(edges.right[2]));
    let (d0, d1, d2) = (whole(edges.down[0]), whole(edges.down[1]), whole(edges.down[2]));
    let lanes = S::i32s::from_slice(simd, &LANES[..S::i32s::LEN]);
    let mut e0 = whole(edges.start[0]) + lanes * r0;
    let mut e1 = whole(edges.start[1]) + lanes * r1;
    let mut e2 = whole(edges.start[2]) + lanes * r2;
    let width = area.last - area.first;
    let mut y = area.top;
    if width < length && wide.is_none() {
        // nothing is set up for what covers no pixel center
        while (e0 | e1 | e2).simd_ge(whole(0)).all_false() {
            if y == area.bottom {
                return true;
            }
            y += 1;
            (e0, e1, e2) = (e0 + d0, e1 + d1, e2 + d2);
        }
    }

    let [a, b, c] = triangle.places;
    let weights = Weights::new(area, triangle.places);
    let w = weights.slope(a.w, b.w, c.w);
    let steepness = weights.steepness();
    if width >= STRIP {
        let width = f64::from(width);
        let least = a.w.min(b.w).min(c.w);
        if w.right.abs() * width > STEEP_DEPTH * least || steepness.0 * width > STEEP_WEIGHTS {
            return false;
        }
    }
    let pen = triangle.pen;
    let lit = MODE == PLAIN || (MODE == ANY && pen.channels.light);
    let light = if lit { triangle.light(&weights) } else { Slope::default() };
    let four = if MODE == BOTH { triangle.four(simd, &weights) } else { [f64x4::splat(simd, 0.0); 3] };
    let right = narrow(simd, four[1]);
    let four_right = [splat(right[0]), splat(right[1]), splat(right[2]), splat(right[3])];
    let others;
    let others = if MODE == ANY && pen.channels.count() > 1 {
        others = triangle.others(&weights);
        &others[..pen.channels.count() - usize::from(pen.channels.light)]
    } else {
        &[]
    };
    let sliver = steepness.0 + steepness.1 > SLIVER;
    let first_xs: S::f32s = lanes.to_float();
    let (w_right, light_right) = (splat(w.right as f32), splat(light.right as f32));
    // where the left edges only move to the right, what is left of the last row's first pixel stays outside
    let leftmost = (0..3).all(|k| edges.right[k] <= 0 || edges.down[k] <= 0);
    let mut start = (0, first_xs);
    let mut at = (y - pen.origin[1]) as usize * STRIDE + (area.first - pen.origin[0]) as usize;
    loop {
        // from the top each time: where rows begin to be drawn differs with the length of vectors
        let dy = f64::from(y - area.top);
        let w_start = splat(w.at(dy));
        let (mut x, mut xs) = start;
        let (mut f0, mut f1, mut f2) = (e0, e1, e2);
        let mut entered = false;
        loop {
            let inside = match wide {
                None => (f0 | f1 | f2).simd_ge(whole(0)),
                Some(wide) => S::mask32s::from_bitmask(simd, wide.inside(x, y - area.top, S::f32s::LEN)),
            };
            if inside.any_true() {
                if leftmost && !entered {
                    start = (x, xs);
                    (e0, e1, e2) = (f0, f1, f2);
                }
                entered = true;
                let mut here = w_start + xs * w_right;
                if sliver {
                    here = triangle.kept_near(simd, here);
                }
                let light = Line { start: light.at(dy), right: light_right };
                let run = Run { at: at + x as usize, inside, here, xs, y: y - area.top };
                if MODE == PLAIN {
                    run.draw_plain(simd, light, slot);
                } else if MODE == BOTH {
                    run.draw_both(simd, &four, &four_right, triangle.record.face, pen.channels, slot);
                } else if pen.phantom {
                    run.hide(simd, slot);
                } else {
                    run.draw(simd, triangle.record.surface, pen.channels, light, others, slot);
                }
            } else if entered {
                break;
            }
            x += length;
            if x > width {
                break;
            }
            xs += splat(length as f32);
            (f0, f1, f2) = (f0 + r0 * length, f1 + r1 * length, f2 + r2 * length);
        }
        if y == area.bottom {
            return true;
        }
        y += 1;
        at += STRIDE;
        (e0, e1, e2) = (e0 + d0, e1 + d1, e2 + d2);
    }
}

impl Triangle<'_> {
    /// Intensity over z; of flat faces intensity itself.
    #[inline(always)]
    fn light(&self, weights: &Weights) -> Slope {
        if self.record.face >= 0.0 {
            return Slope { origin: f64::from(self.record.face), right: 0.0, down: 0.0 };
        }
        let [a, b, c] = self.places;
        weights.slope(
            f64::from(a.intensity) * a.w,
            f64::from(b.intensity) * b.w,
            f64::from(c.intensity) * c.w,
        )
    }

    /// The slopes of normal and intensity.
    #[inline(always)]
    fn four<S: Simd>(&self, simd: S, weights: &Weights) -> [f64x4<S>; 3] {
        let of = |i: usize| self.pen.source.normals.get(i).copied().unwrap_or_default();
        let ([i, j, k], [a, b, c]) = (self.index, self.places);
        weights.slopes_over_z(simd, [of(i), of(j), of(k)], [a.w, b.w, c.w])
    }

    /// The slopes of all other attributes, in the order of the channels.
    #[inline(never)]
    fn others(&self, weights: &Weights) -> [Slope; MOST - 1] {
        let mut slopes = [Slope::default(); MOST - 1];
        let Pen { channels, source, .. } = self.pen;
        let ([i, j, k], [a, b, c]) = (self.index, self.places);
        let mut next = 0;
        let mut push = |p: &[f32], q: &[f32], r: &[f32]| {
            for ((p, q), r) in p.iter().zip(q).zip(r) {
                slopes[next] = weights.slope(f64::from(*p) * a.w, f64::from(*q) * b.w, f64::from(*r) * c.w);
                next += 1;
            }
        };
        if channels.normals {
            let of = |i: usize| source.normals.get(i).copied().unwrap_or_default();
            push(&of(i)[..3], &of(j)[..3], &of(k)[..3]);
        }
        if channels.uv {
            let of = |i: usize| source.uv.get(i).copied().unwrap_or_default().to_array();
            push(&of(i), &of(j), &of(k));
        }
        if channels.colors {
            let of = |i: usize| source.colors.get(i).copied().unwrap_or(Vec3::ONE).to_array();
            push(&of(i), &of(j), &of(k));
        }
        slopes
    }

    /// Snapping moves a covered center at most .003 px out of the triangle; slivers must not turn that into any depth
    /// at all.
    #[inline(always)]
    fn kept_near<S: Simd>(&self, simd: S, here: S::f32s) -> S::f32s {
        let [a, b, c] = self.places;
        let (least, most) = (a.w.min(b.w).min(c.w), a.w.max(b.w).max(c.w));
        let reach = (most - least) * 0.5;
        let low = S::f32s::simd_from(simd, (least - reach).max(least * 0.5) as f32);
        let high = S::f32s::simd_from(simd, (most + reach) as f32);
        let here = here.simd_lt(low).select(low, here);
        high.simd_lt(here).select(high, here)
    }
}
