//! What triangles are drawn by, set up four at a time, a lane each: 1/z and light over their areas, and how steep
//! they are. Other attributes are set up for one triangle, a value a lane.

use super::View;
use super::bins::Chunk;
use super::record::{Extent, Record};
use super::slopes::{Slope, Slopes, SlopesApart, Weights};
use super::spans::{Area, Corners, Row};
use super::tile::MOST;
use super::vertex::{Spot, Vertex, Vertices, narrow, widen};
use crate::pixels::TILE;
use fearless_simd::{Simd, SimdFrom, f64x4, i32x4, prelude::*};
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
            widen(simd, of(i)) * f64x4::splat(simd, a.w),
            widen(simd, of(j)) * f64x4::splat(simd, b.w),
            widen(simd, of(k)) * f64x4::splat(simd, c.w),
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
                let (a, b, c) = (f64x4::splat(simd, a.w), f64x4::splat(simd, b.w), f64x4::splat(simd, c.w));
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
        let [a, b, c] = self.places;
        let (least, most) = (a.w.min(b.w).min(c.w), a.w.max(b.w).max(c.w));
        let reach = (most - least) * 0.5;
        let low = S::f32s::simd_from(simd, (least - reach).max(least * 0.5) as f32);
        let high = S::f32s::simd_from(simd, (most + reach) as f32);
        let here = here.simd_lt(low).select(low, here);
        high.simd_lt(here).select(high, here)
    }
}

/// Four triangles, each over its area.
pub(super) struct Setup {
    pub weights: [SlopesApart; 2],
    /// Steps of 1/z and light to the right, rounded.
    pub w_right: [f32; 4],
    pub light_right: [f32; 4],
    /// A bit each: too steep for their width, slivers.
    pub steep: u64,
    pub slivers: u64,
}

impl Setup {
    /// Sets up four triangles, and fills their rows: 1/z and light, and what is covered where `spans` are wanted; of small
    /// triangles only.
    #[inline(always)]
    pub fn new<S: Simd, const MODE: u8>(
        simd: S,
        four: &[Triangle<'_>; 4],
        areas: &[Area; 4],
        spans: bool,
        rows: &mut [Row; TILE],
    ) -> Self {
        let of = |v: f64| f64x4::splat(simd, v);
        let (a, b, c) = (corners(simd, four, 0), corners(simd, four, 1), corners(simd, four, 2));
        let [p, q, r, s] = areas;
        let left = f64x4::simd_from(simd, [p.first, q.first, r.first, s.first].map(f64::from));
        let last = f64x4::simd_from(simd, [p.last, q.last, r.last, s.last].map(f64::from));
        let top = f64x4::simd_from(simd, [p.top, q.top, r.top, s.top].map(f64::from));
        let (x, y) = ([a[0], b[0], c[0]], [a[1], b[1], c[1]]);
        let weights = Weights::new(simd, [left, top], x, y);
        let w = weights.slopes([a[2], b[2], c[2]]);
        let mut light = Slopes::zero(simd);
        if MODE != BOTH {
            // over z; of flat faces intensity itself
            light = weights.slopes([a[3] * a[2], b[3] * b[2], c[3] * c[2]]);
            let faces = [four[0].record.face, four[1].record.face, four[2].record.face, four[3].record.face];
            let faces = widen(simd, faces);
            let flat = faces.simd_ge(of(0.0));
            light.origin = flat.select(faces, light.origin);
            light.right = flat.select(of(0.0), light.right);
            light.down = flat.select(of(0.0), light.down);
        }
        let heights = [p.bottom - p.top, q.bottom - q.top, r.bottom - r.top, s.bottom - s.top];
        let most = heights[0].max(heights[1]).max(heights[2]).max(heights[3]);
        let rows = &mut rows[..(most as usize).min(TILE - 1) + 1];
        let mut y = 0.0;
        for row in rows.iter_mut() {
            w.at(simd, y).store_slice(&mut row.w);
            if MODE != BOTH {
                light.at(simd, y).store_slice(&mut row.light);
            }
            y += 1.0;
        }
        if spans {
            let columns = [p.last - p.first, q.last - q.first, r.last - r.first, s.last - s.first];
            let columns = i32x4::simd_from(simd, columns) + i32x4::splat(simd, 1);
            Corners::new(simd, [left, top], x, [a[1], b[1], c[1]]).fill(simd, columns, rows);
        }
        let (mut w_right, mut light_right) = ([0.0; 4], [0.0; 4]);
        narrow(simd, w.right).store_slice(&mut w_right);
        narrow(simd, light.right).store_slice(&mut light_right);
        let (across, along) = weights.steepness();
        let (width, least) = (last - left, a[2].min(b[2]).min(c[2]));
        let steep = (w.right.abs() * width).simd_gt(of(STEEP_DEPTH) * least)
            | (across * width).simd_gt(of(STEEP_WEIGHTS));
        let steep = steep & width.simd_ge(of(f64::from(STRIP)));
        Self {
            weights: [weights.0[0].apart(), weights.0[1].apart()],
            w_right,
            light_right,
            steep: steep.to_bitmask(),
            slivers: (across + along).simd_gt(of(SLIVER)).to_bitmask(),
        }
    }
}

/// One corner of each of four triangles: x, y, 1/z and intensity.
#[inline(always)]
fn corners<S: Simd>(simd: S, four: &[Triangle<'_>; 4], k: usize) -> [f64x4<S>; 4] {
    let (a, b, c, d) = (four[0].places[k], four[1].places[k], four[2].places[k], four[3].places[k]);
    [
        f64x4::simd_from(simd, [a.x, b.x, c.x, d.x]),
        f64x4::simd_from(simd, [a.y, b.y, c.y, d.y]),
        f64x4::simd_from(simd, [a.w, b.w, c.w, d.w]),
        f64x4::simd_from(simd, [a.intensity, b.intensity, c.intensity, d.intensity]),
    ]
}
