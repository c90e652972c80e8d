//! What triangles are drawn by, set up four at a time, a lane each: 1/z and light over their areas, and how steep
//! they are. Other attributes are set up for one triangle, a value a lane.

use super::View;
use super::bins::Chunk;
use super::record::{Bounds, Extent, Record};
use super::slopes::{Slope, Slopes, SlopesApart, Weights};
use super::spans::{Corners, Row};
use super::tile::{MOST, STRIDE};
use super::vertex::{Spot, Vertex, Vertices, narrow, wide, widen};
use crate::pixels::TILE;
use fearless_simd::{Simd, SimdBase, SimdFrom, f64x2, f64x4, i32x4, prelude::*};
use glam::Vec3;

/// Width of the strips of steep triangles, px.
pub(super) const STRIP: i32 = 8;
/// Steep: over the triangle's width in the tile 1/z changes by more than this share of its least value...
const STEEP_DEPTH: f64 = 1.0;
/// ... or the corners' weights by more than this.
const STEEP_WEIGHTS: f64 = 16.0;
/// A sliver: the corners' weights change by more than this in a pixel.
const SLIVER: f64 = 32.0;

/// The body is built for each of three cases: light alone; both layers, light or not; and anything.
pub(super) const PLAIN: u8 = 0;
pub(super) const BOTH: u8 = 1;
pub(super) const ANY: u8 = 2;

/// The tile at hand.
pub(super) struct Tile<'a> {
    pub view: &'a View<'a>,
    /// Its pixels: left, top, right, bottom, inclusive.
    pub bounds: [i32; 4],
}

/// A triangle to draw.
#[derive(Clone, Copy)]
pub(super) struct Triangle<'a> {
    pub record: &'a Record,
    pub chunk: &'a Chunk,
    pub places: [&'a Vertex; 3],
}

impl<'a> Triangle<'a> {
    /// `places` are those that the record's corners count.
    #[inline(always)]
    pub fn new(chunk: &'a Chunk, record: &'a Record, places: &'a [Vertex]) -> Option<Self> {
        let [a, b, c] = record.corners.map(|c| c as usize);
        Some(Self { record, chunk, places: [places.get(a)?, places.get(b)?, places.get(c)?] })
    }

    /// What its corners count: the frame's vertices from a first one on, or the chunk's own.
    #[inline(always)]
    pub fn vertices<'b>(&self, view: &'b View<'_>) -> (&'b Vertices, usize)
    where
        'a: 'b,
    {
        match self.record.extent {
            Extent::Piece => (&self.chunk.own, 0),
            _ => (view.vertices, view.instances[self.chunk.instance].first_vertex),
        }
    }

    #[inline(always)]
    pub fn spots(&self, view: &View<'_>) -> [Spot; 3] {
        let (vertices, first) = self.vertices(view);
        let of = |i: usize| vertices.spots.get(first + i).copied().unwrap_or_default();
        let [a, b, c] = self.record.corners.map(|c| c as usize);
        [of(a), of(b), of(c)]
    }

    /// The slopes of normal and intensity.
    #[inline(always)]
    pub fn four<S: Simd>(&self, simd: S, view: &View<'_>, weights: &Weights<S>) -> Slopes<S> {
        let (vertices, first) = self.vertices(view);
        let of = |i: usize| vertices.normals.get(first + i).copied().unwrap_or_default();
        let ([i, j, k], [a, b, c]) = (self.record.corners.map(|c| c as usize), self.places);
        weights.slopes([
            widen(simd, of(i)) * f64x4::splat(simd, a.w()),
            widen(simd, of(j)) * f64x4::splat(simd, b.w()),
            widen(simd, of(k)) * f64x4::splat(simd, c.w()),
        ])
    }

    /// The slopes of all attributes but light, in the order of the channels.
    #[inline(always)]
    pub fn others<S: Simd>(&self, simd: S, view: &View<'_>, weights: &Weights<S>) -> [Slope; MOST - 1] {
        let mut slopes = [Slope::default(); MOST - 1];
        let ([i, j, k], [a, b, c]) = (self.record.corners.map(|c| c as usize), self.places);
        let mut next = 0;
        let mut put = |new: Slopes<S>, count: usize| {
            let apart = new.apart();
            for slope in slopes[next..].iter_mut().take(count).enumerate() {
                *slope.1 = apart.one(slope.0);
            }
            next += count;
        };
        if view.channels.normals {
            put(self.four(simd, view, weights), 3);
        }
        let mesh = &view.shot.scene.models[view.instances[self.chunk.instance].placed.model].mesh;
        let (uv, colors) = match self.record.extent {
            Extent::Piece => (&self.chunk.own_uv, &self.chunk.own_colors),
            _ => (&mesh.texcoords, &mesh.colors),
        };
        for (wanted, count) in [(view.channels.uv, 2), (view.channels.colors, 3)] {
            let of = |i: usize| match count {
                2 => uv.get(i).copied().unwrap_or_default().extend(0.0).extend(0.0).to_array(),
                _ => colors.get(i).copied().unwrap_or(Vec3::ONE).extend(0.0).to_array(),
            };
            if wanted {
                let (a, b, c) =
                    (f64x4::splat(simd, a.w()), f64x4::splat(simd, b.w()), f64x4::splat(simd, c.w()));
                put(
                    weights.slopes([widen(simd, of(i)) * a, widen(simd, of(j)) * b, widen(simd, of(k)) * c]),
                    count,
                );
            }
        }
        slopes
    }

    /// Snapping moves a covered center at most .003 px out of the triangle; slivers must not turn that into any depth
    /// at all.
    #[inline(always)]
    pub fn kept_near<S: Simd>(&self, simd: S, here: S::f32s) -> S::f32s {
        let [a, b, c] = self.places.map(|place| place.w());
        let (least, most) = (a.min(b).min(c), a.max(b).max(c));
        let reach = (most - least) * 0.5;
        let low = S::f32s::simd_from(simd, (least - reach).max(least * 0.5) as f32);
        let high = S::f32s::simd_from(simd, (most + reach) as f32);
        let here = here.simd_lt(low).select(low, here);
        high.simd_lt(here).select(high, here)
    }
}

/// Four triangles, each over its area.
pub(super) struct Setup {
    /// The first pixel in the slot, and how many rows there are.
    pub at: [i32; 4],
    pub heights: [i32; 4],
    /// Steps of 1/z and light to the right, rounded.
    pub w_right: [f32; 4],
    pub light_right: [f32; 4],
    /// A bit each: too steep for their width, slivers.
    pub steep: u64,
    pub slivers: u64,
    pub weights: [SlopesApart; 2],
    pub rows: [Row; TILE],
}

impl Default for Setup {
    fn default() -> Self {
        Self {
            at: [0; 4],
            heights: [0; 4],
            w_right: [0.0; 4],
            light_right: [0.0; 4],
            steep: 0,
            slivers: 0,
            weights: Default::default(),
            rows: [Row::default(); TILE],
        }
    }
}

impl Setup {
    /// Sets up four triangles over areas within the tile; what of their rows is covered only where `spans` are wanted,
    /// and of small ones.
    #[inline(never)]
    pub fn fill<S: Simd, const MODE: u8>(
        &mut self,
        simd: S,
        tile: &Tile<'_>,
        four: &[Triangle<'_>; 4],
        areas: &[Bounds; 4],
        spans: bool,
    ) {
        simd.vectorize(
            #[inline(always)]
            || self.fill_here::<S, MODE>(simd, tile, four, areas, spans),
        );
    }

    #[inline(always)]
    fn fill_here<S: Simd, const MODE: u8>(
        &mut self,
        simd: S,
        tile: &Tile<'_>,
        four: &[Triangle<'_>; 4],
        areas: &[Bounds; 4],
        spans: bool,
    ) {
        let flat = tile.view.channels.flat;
        let [corner_x, corner_y, ..] = tile.bounds;
        let of = |v: f64| f64x4::splat(simd, v);
        let whole = |v: i32| i32x4::splat(simd, v);
        let (a, b, c) = (corners(simd, four, 0), corners(simd, four, 1), corners(simd, four, 2));
        let [p, q, r, s] = areas;
        let low = i32x4::simd_from(simd, [p.low, q.low, r.low, s.low]);
        let high = i32x4::simd_from(simd, [p.high, q.high, r.high, s.high]);
        let (left, top) = (low & whole(0xffff), low >> 16);
        let columns = (high & whole(0xffff)) - left;
        let heights = (high >> 16) - top + whole(1);
        let at = top * whole(STRIDE as i32) + left - whole(corner_y * STRIDE as i32 + corner_x);
        at.store_slice(&mut self.at);
        heights.store_slice(&mut self.heights);
        let corner = [wide(simd, left.to_float()), wide(simd, top.to_float())];
        let (x, y) = ([a[0], b[0], c[0]], [a[1], b[1], c[1]]);
        let weights = Weights::new(simd, corner, x, y);
        let w = weights.slopes([a[2], b[2], c[2]]);
        let mut light = Slopes::zero(simd);
        if MODE != BOTH {
            // over z; of flat faces intensity itself
            light = weights.slopes([a[3] * a[2], b[3] * b[2], c[3] * c[2]]);
        }
        if MODE != BOTH && flat {
            let faces = [four[0].record.face, four[1].record.face, four[2].record.face, four[3].record.face];
            let faces = widen(simd, faces);
            let flat = faces.simd_ge(of(0.0));
            light.origin = flat.select(faces, light.origin);
            light.right = flat.select(of(0.0), light.right);
            light.down = flat.select(of(0.0), light.down);
        }
        let [i, j, k, l] = self.heights;
        let rows = &mut self.rows[..(i.max(j).max(k).max(l) as usize).min(TILE)];
        let mut below = 0.0;
        for row in rows.iter_mut() {
            w.at(simd, below).store_slice(&mut row.w);
            if MODE != BOTH {
                light.at(simd, below).store_slice(&mut row.light);
            }
            below += 1.0;
        }
        if spans {
            Corners::new(simd, [left, top], x, y).fill(simd, at, columns + whole(1), rows);
        }
        narrow(simd, w.right).store_slice(&mut self.w_right);
        narrow(simd, light.right).store_slice(&mut self.light_right);
        let (across, along) = weights.steepness();
        let sliver = (across + along).simd_gt(of(SLIVER));
        (self.slivers, self.steep) = (0, 0);
        if sliver.any_true() {
            self.slivers = sliver.to_bitmask();
        }
        let broad = columns.simd_ge(whole(STRIP));
        if broad.any_true() {
            let (width, least) = (wide(simd, columns.to_float()), a[2].min(b[2]).min(c[2]));
            let steep = (w.right.abs() * width).simd_gt(of(STEEP_DEPTH) * least)
                | (across * width).simd_gt(of(STEEP_WEIGHTS));
            self.steep = steep.to_bitmask() & broad.to_bitmask();
        }
        if MODE != PLAIN {
            self.weights = [weights.0[0].apart(), weights.0[1].apart()];
        }
    }
}

/// One corner of each of four triangles: x, y, 1/z and intensity.
#[inline(always)]
fn corners<S: Simd>(simd: S, four: &[Triangle<'_>; 4], k: usize) -> [f64x4<S>; 4] {
    let (p, q, r, s) = (four[0].places[k], four[1].places[k], four[2].places[k], four[3].places[k]);
    let ([x, y], [w, intensity]) =
        (columns(simd, [&p.at, &q.at, &r.at, &s.at]), columns(simd, [&p.of, &q.of, &r.of, &s.of]));
    [x, y, w, intensity]
}

/// The first of each pair, and the second.
#[inline(always)]
fn columns<S: Simd>(simd: S, [p, q, r, s]: [&[f64; 2]; 4]) -> [f64x4<S>; 2] {
    let (p, q) = (f64x2::from_slice(simd, p), f64x2::from_slice(simd, q));
    let (r, s) = (f64x2::from_slice(simd, r), f64x2::from_slice(simd, s));
    [
        simd.combine_f64x2(simd.zip_low_f64x2(p, q), simd.zip_low_f64x2(r, s)),
        simd.combine_f64x2(simd.zip_high_f64x2(p, q), simd.zip_high_f64x2(r, s)),
    ]
}
