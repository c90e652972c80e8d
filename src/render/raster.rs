//! One tile: walk the records of all chunks in order, a run of pixels at a time.
//!
//! Coverage is exact: integer edge functions of the snapped corners, the fill rule folded into the constant.
//! 1/z and attributes over z of the unsnapped corners are evaluated in f64 at the start of every row and stepped in
//! f32 along it. Where they are so steep that the steps would round badly the triangle is drawn in strips of eight
//! pixels, so that the error is that of seven steps however large it is. Nearest and second-nearest surface are kept
//! in the same pass. Runs are as wide as the machine's vectors: no value depends on where they begin.

use super::bins::{Chunk, LARGE, OWN, Record};
use super::tile::{Channels, MOST, STRIDE, Slot};
use super::vertex::{Spot, Vertex};
use super::{Instance, View};
use crate::pixels::TILE;
use crate::pixels::simd::{Level, dispatch};
use fearless_simd::{Simd, SimdBase, SimdFrom, i32x4, prelude::*};
use glam::{Vec2, Vec3};

/// Width of the strips of steep triangles, px.
const STRIP: i32 = 8;
/// Steep: over the triangle's width in the tile 1/z changes by more than this share of its least value...
const STEEP_DEPTH: f64 = 1.0;
/// ... or the corners' weights by more than this.
const STEEP_WEIGHTS: f64 = 16.0;
/// Twice the area, px², below which a triangle counts as without any before snapping.
const LEAST_AREA: f64 = 1e-200;
/// A sliver: the corners' weights change by more than this in a pixel.
const SLIVER: f64 = 32.0;

/// Draws everything that touches the slot's tile.
pub(super) fn draw_tile(level: Level, view: &View<'_>, chunks: &[Chunk], slot: &mut Slot) {
    slot.fit(view.channels);
    slot.clear(view.nothing);
    let plain = Channels { light: true, ..Channels::default() };
    if view.channels == plain {
        dispatch!(level, simd => draw_records::<_, true>(simd, view, chunks, slot));
    } else {
        dispatch!(level, simd => draw_records::<_, false>(simd, view, chunks, slot));
    }
    let rect = view.grid.rect(slot.tile);
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
fn draw_records<S: Simd, const PLAIN: bool>(simd: S, view: &View<'_>, chunks: &[Chunk], slot: &mut Slot) {
    let rect = view.grid.rect(slot.tile);
    let [left, top, right, bottom] = [rect.x0, rect.y0, rect.x1 - 1, rect.y1 - 1].map(|v| v as i32);
    for chunk in chunks {
        if !chunk.holds(slot.tile) {
            continue;
        }
        let instance = &view.instances[chunk.instance];
        let phantom = view.scene.models[instance.placed.model].phantom;
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
                let Some(triangle) = Triangle::new(&whole, record) else { continue };
                let edges = Edges::small(simd, &area, triangle.spots);
                if draw_area::<S, PLAIN>(simd, &triangle, &area, &edges, None, slot) {
                    continue;
                }
            }
            let pen = if record.corners[0] & OWN == 0 { &whole } else { &own };
            draw_slowly::<S, PLAIN>(simd, pen, record, &area, slot);
        }
    }
}

/// Large triangles, those made by cutting and steep ones.
#[inline(never)]
fn draw_slowly<S: Simd, const PLAIN: bool>(
    simd: S,
    pen: &Pen<'_>,
    record: &Record,
    area: &Area,
    slot: &mut Slot,
) {
    let Some(triangle) = Triangle::new(pen, record) else { return };
    let mut draw = |area: &Area| {
        let Some(exact) = Edges::new(area, triangle.spots) else { return true };
        let (edges, wide) = match exact.narrow(area) {
            Some(edges) => (edges, None),
            None => (Edges::default(), Some(&exact)),
        };
        simd.vectorize(
            #[inline(always)]
            || draw_area::<S, PLAIN>(simd, &triangle, area, &edges, wide, slot),
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
    spots: &'a [Spot],
    places: &'a [Vertex],
    normals: &'a [[f32; 3]],
    uv: &'a [Vec2],
    colors: &'a [Vec3],
}

impl<'a> Source<'a> {
    fn of_instance(view: &View<'a>, instance: &Instance) -> Self {
        let mesh = &view.scene.models[instance.placed.model].mesh;
        let (first, vertices) = (instance.first_vertex, view.vertices);
        Self {
            spots: &vertices.spots[first..],
            places: &vertices.places[first..],
            normals: vertices.normals.get(first..).unwrap_or_default(),
            uv: &mesh.texcoords,
            colors: &mesh.colors,
        }
    }

    fn of_chunk(chunk: &'a Chunk) -> Self {
        let own = &chunk.own;
        let (uv, colors) = (&chunk.own_uv, &chunk.own_colors);
        Self { spots: &own.spots, places: &own.places, normals: &own.normals, uv, colors }
    }
}

/// The pixels of a tile that a triangle may cover, picture coordinates, inclusive.
#[derive(Clone, Copy)]
struct Area {
    first: i32,
    top: i32,
    last: i32,
    bottom: i32,
}

/// The three edge functions over an area, divided by 256 with the sign kept exact: a pixel center is a whole
/// number of steps away, so only the constant has a fraction, and rounding it down changes no sign. `T` holds every
/// value in the area.
#[derive(Clone, Copy, Default)]
struct Edges<T> {
    start: [T; 3],
    right: [T; 3],
    down: [T; 3],
}

impl Edges<i32> {
    /// Of a triangle less than 64 px across: an edge a lane.
    #[inline(always)]
    fn small<S: Simd>(simd: S, area: &Area, [a, b, c]: [Spot; 3]) -> Self {
        let of = |v: [i32; 4]| i32x4::simd_from(simd, v);
        let (x, y) = (of([a[0], b[0], c[0], 0]), of([a[1], b[1], c[1], 0]));
        let (next_x, next_y) = (of([b[0], c[0], a[0], 0]), of([b[1], c[1], a[1], 0]));
        let (right, down) = (y - next_y, next_x - x);
        let (left, top) = (i32x4::splat(simd, area.first * 256), i32x4::splat(simd, area.top * 256));
        let (zero, one) = (i32x4::splat(simd, 0), i32x4::splat(simd, 1));
        // right above 0, or 0 and down above 0: by their sign, since small
        let owned = (right + right + down.simd_gt(zero).select(one, zero)).simd_gt(zero);
        let value = right * (left - x) + down * (top - y);
        let start = (value - owned.select(zero, one)) >> 8;
        let three = |v: i32x4<S>| [v[0], v[1], v[2]];
        Edges { start: three(start), right: three(right), down: three(down) }
    }
}

/// Whether pixel centers on an edge are inside, by its steps to the right and down. Top: to the right along the
/// row; left: upwards (y down, inside on the right hand).
#[inline(always)]
fn owned<T: PartialOrd + Default>(right: T, down: T) -> bool {
    right > T::default() || (right == T::default() && down > T::default())
}

impl Edges<i64> {
    /// Of any triangle; `None` when some edge leaves the whole area outside.
    fn new(area: &Area, spots: [Spot; 3]) -> Option<Self> {
        // the last run may reach further
        let columns = i64::from(area.last - area.first) + STRIDE as i64 - TILE as i64;
        let rows = i64::from(area.bottom - area.top);
        let (x, y) = (i64::from(area.first) * 256, i64::from(area.top) * 256);
        let mut edges = Edges::default();
        for k in 0..3 {
            let [[x0, y0], [x1, y1]] = [spots[k], spots[(k + 1) % 3]].map(|spot| spot.map(i64::from));
            let (right, down) = (y0 - y1, x1 - x0);
            let start = (right * (x - x0) + down * (y - y0) - i64::from(!owned(right, down))) >> 8;
            let (across, along) = (right * columns, down * rows);
            if start + across.max(0) + along.max(0) < 0 {
                return None;
            }
            // inside everywhere: stays 0
            if start + across.min(0) + along.min(0) < 0 {
                (edges.start[k], edges.right[k], edges.down[k]) = (start, right, down);
            }
        }
        Some(edges)
    }

    /// The same in 32 bits, where every value in the area fits.
    fn narrow(&self, area: &Area) -> Option<Edges<i32>> {
        let columns = i64::from(area.last - area.first) + STRIDE as i64 - TILE as i64;
        let rows = i64::from(area.bottom - area.top) + 1;
        // an edge that changes sign in the area starts within its own change
        let change = |k: usize| self.right[k].abs() * columns + self.down[k].abs() * rows;
        let fits = (0..3).all(|k| change(k) < i64::from(i32::MAX));
        let cut = |v: [i64; 3]| v.map(|v| v as i32);
        fits.then(|| Edges { start: cut(self.start), right: cut(self.right), down: cut(self.down) })
    }

    /// Coverage of a run, a bit a pixel.
    #[inline(never)]
    fn inside(&self, x: i32, y: i32, count: usize) -> u64 {
        let value = |k: usize, lane: usize| {
            self.start[k] + self.right[k] * (i64::from(x) + lane as i64) + self.down[k] * i64::from(y)
        };
        let inside = |lane: usize| value(0, lane) | value(1, lane) | value(2, lane);
        (0..count).fold(0, |bits, lane| bits | u64::from(inside(lane) >= 0) << lane)
    }
}

/// Linear in x and y over the area: value at its first pixel center and steps.
#[derive(Clone, Copy, Default)]
struct Slope {
    origin: f64,
    right: f64,
    down: f64,
}

impl Slope {
    #[inline(always)]
    fn at(&self, y: f64) -> f32 {
        (self.origin + self.down * y) as f32
    }
}

/// The unsnapped triangle's barycentric weights of corners 1 and 2.
#[derive(Clone, Copy)]
struct Weights([Slope; 2]);

impl Weights {
    #[inline(always)]
    fn new(area: &Area, [a, b, c]: [&Vertex; 3]) -> Self {
        let (abx, aby, acx, acy) = (b.x - a.x, b.y - a.y, c.x - a.x, c.y - a.y);
        let doubled = abx * acy - acx * aby;
        if doubled.abs() < LEAST_AREA {
            // no area before snapping: the middle of the triangle stands for all of it
            return Weights([Slope { origin: 1.0 / 3.0, right: 0.0, down: 0.0 }; 2]);
        }
        let inverse = 1.0 / doubled;
        let (ox, oy) = (f64::from(area.first) - a.x, f64::from(area.top) - a.y);
        let (right1, down1, right2, down2) = (acy * inverse, -acx * inverse, -aby * inverse, abx * inverse);
        let l1 = Slope { origin: ox * right1 + oy * down1, right: right1, down: down1 };
        let l2 = Slope { origin: ox * right2 + oy * down2, right: right2, down: down2 };
        Weights([l1, l2])
    }

    /// The slope of a value with these corners.
    #[inline(always)]
    fn slope(&self, p: f64, q: f64, r: f64) -> Slope {
        let Weights([l1, l2]) = self;
        let (d1, d2) = (q - p, r - p);
        Slope {
            origin: p + l1.origin * d1 + l2.origin * d2,
            right: l1.right * d1 + l2.right * d2,
            down: l1.down * d1 + l2.down * d2,
        }
    }

    /// How fast the weights change along a row, and along a column.
    #[inline(always)]
    fn steepness(&self) -> (f64, f64) {
        let Weights([l1, l2]) = self;
        (l1.right.abs() + l2.right.abs(), l1.down.abs() + l2.down.abs())
    }
}

/// A triangle to draw.
struct Triangle<'a> {
    pen: &'a Pen<'a>,
    record: &'a Record,
    index: [usize; 3],
    spots: [Spot; 3],
    places: [&'a Vertex; 3],
}

impl<'a> Triangle<'a> {
    #[inline(always)]
    fn new(pen: &'a Pen<'a>, record: &'a Record) -> Option<Self> {
        let [a, b, c] = record.corners;
        let [a, b, c] = [(a & !OWN) as usize, (b & !LARGE) as usize, c as usize];
        let Source { spots, places, .. } = &pen.source;
        let spots = [*spots.get(a)?, *spots.get(b)?, *spots.get(c)?];
        let places = [places.get(a)?, places.get(b)?, places.get(c)?];
        Some(Self { pen, record, index: [a, b, c], spots, places })
    }
}

/// Lane numbers; no vector has more.
const LANES: [i32; STRIDE - TILE] = [0, 1, 2, 3, 4, 5, 6, 7];

/// Draws a triangle's pixels in the area; `false`, and nothing is drawn, where it is too wide for how steep it is.
/// `wide` stands for `edges` where they do not fit. `PLAIN`: there is light and nothing else.
#[inline(always)]
fn draw_area<S: Simd, const PLAIN: bool>(
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
    let [r0, r1, r2] = edges.right.map(whole);
    let [d0, d1, d2] = edges.down.map(whole);
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
    let light = if PLAIN || pen.channels.light { triangle.light(&weights) } else { Slope::default() };
    let others;
    let others = if !PLAIN && pen.channels.count() > 1 {
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
    let dy = f64::from(y - area.top);
    let (mut w_row, mut light_row) = (w.origin + w.down * dy, light.origin + light.down * dy);
    loop {
        let w_start = splat(w_row as f32);
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
                let light = Line { start: light_row as f32, right: light_right };
                let run = Run { at: at + x as usize, inside, here, xs, y: y - area.top };
                if PLAIN {
                    run.draw_plain(simd, light, slot);
                } else if pen.phantom {
                    run.hide(simd, slot);
                } else {
                    run.draw(simd, triangle, light, others, slot);
                }
            } else if entered {
                break;
            }
            x += length;
            if x > width {
                break;
            }
            xs = xs + splat(length as f32);
            (f0, f1, f2) = (f0 + r0 * length, f1 + r1 * length, f2 + r2 * length);
        }
        if y == area.bottom {
            return true;
        }
        y += 1;
        at += STRIDE;
        (w_row, light_row) = (w_row + w.down, light_row + light.down);
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
            push(&of(i), &of(j), &of(k));
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

/// A value along a row.
#[derive(Clone, Copy)]
struct Line<F> {
    start: f32,
    right: F,
}

/// Neighboring pixels of a row.
struct Run<S: Simd> {
    /// The first one in the slot.
    at: usize,
    inside: S::mask32s,
    /// The triangle's 1/z.
    here: S::f32s,
    /// Pixels right of the area's first, and below it.
    xs: S::f32s,
    y: i32,
}

impl<S: Simd> Run<S> {
    #[inline(always)]
    fn load(&self, simd: S, plane: &[f32]) -> S::f32s {
        S::f32s::from_slice(simd, &plane[self.at..self.at + S::f32s::LEN])
    }

    #[inline(always)]
    fn store(&self, value: S::f32s, plane: &mut [f32]) {
        value.store_slice(&mut plane[self.at..self.at + S::f32s::LEN]);
    }

    /// Where there is light and nothing else.
    #[inline(always)]
    fn draw_plain(&self, simd: S, light: Line<S::f32s>, slot: &mut Slot) {
        let before = self.load(simd, &slot.w);
        let wins = self.inside & self.here.simd_gt(before);
        if wins.any_true()
            && let Some(plane) = slot.attributes.first_mut()
        {
            self.store(wins.select(self.here, before), &mut slot.w);
            let new = S::f32s::simd_from(simd, light.start) + self.xs * light.right;
            self.store(wins.select(new, self.load(simd, plane)), plane);
        }
    }

    #[inline(always)]
    fn value(&self, simd: S, slope: &Slope) -> S::f32s {
        let right = S::f32s::simd_from(simd, slope.right as f32);
        S::f32s::simd_from(simd, slope.at(f64::from(self.y))) + self.xs * right
    }

    /// Keeps what a phantom hides.
    #[inline(always)]
    fn hide(&self, simd: S, slot: &mut Slot) {
        let before = self.load(simd, &slot.shield);
        let nearer = self.inside & self.here.simd_gt(before);
        self.store(nearer.select(self.here, before), &mut slot.shield);
    }

    #[inline(always)]
    fn draw(
        &self,
        simd: S,
        triangle: &Triangle<'_>,
        light: Line<S::f32s>,
        others: &[Slope],
        slot: &mut Slot,
    ) {
        let channels = triangle.pen.channels;
        let (here, mut inside) = (self.here, self.inside);
        if channels.phantoms {
            inside = inside & here.simd_gt(self.load(simd, &slot.shield));
        }
        let before = self.load(simd, &slot.w);
        let wins = inside & here.simd_gt(before);
        let any = wins.any_true();
        if channels.second {
            // a fragment behind the first may be the second; a new first makes the old one second
            let before2 = self.load(simd, &slot.w2);
            let behind = inside & here.simd_lt(before) & here.simd_gt(before2);
            if !any && behind.all_false() {
                return;
            }
            self.store(wins.select(before, behind.select(here, before2)), &mut slot.w2);
            let firsts = slot.attributes.iter_mut().skip(channels.normal_at());
            for ((slope, first), second) in others.iter().zip(firsts).zip(&mut slot.normal2) {
                let (old, old2) = (self.load(simd, first), self.load(simd, second));
                let new = self.value(simd, slope);
                self.store(wins.select(old, behind.select(new, old2)), second);
                self.store(wins.select(new, old), first);
            }
        }
        if !any {
            return;
        }
        self.store(wins.select(here, before), &mut slot.w);
        let mut planes = slot.attributes.iter_mut();
        if channels.light
            && let Some(plane) = planes.next()
        {
            let new = S::f32s::simd_from(simd, light.start) + self.xs * light.right;
            self.store(wins.select(new, self.load(simd, plane)), plane);
        }
        // the second layer has seen to the normals
        let done = if channels.second { 3 } else { 0 };
        for (slope, plane) in others.iter().zip(planes).skip(done) {
            self.store(wins.select(self.value(simd, slope), self.load(simd, plane)), plane);
        }
        if channels.surfaces {
            let ids = &mut slot.surface[self.at..self.at + S::i32s::LEN];
            let own = S::i32s::simd_from(simd, triangle.record.surface as i32);
            wins.select(own, S::i32s::from_slice(simd, ids)).store_slice(ids);
        }
    }
}
