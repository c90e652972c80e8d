//! Vertices: mesh space → camera space → picture, snapped and lit, four at a time, all in f64.
//!
//! What the triangles' sorting reads, the snapped `Spot`, stands once more apart from what only drawn triangles read. Every
//! operation is that of [`Vertex::project`], so that a vertex has the same bits wherever it comes from.

use super::field::Field;
use super::tile::Channels;
use crate::pixels::simd::{Level, dispatch};
use crate::scene::Mesh;
use fearless_simd::{Simd, SimdBase, SimdFrom, f32x4, f64x2, f64x4, prelude::*};
use glam::{DAffine3, DMat3, DVec3, Vec3};
use rayon::prelude::*;

/// Sub-pixel positions a pixel is divided into along each axis.
pub(super) const SUBPIXELS: f64 = 256.0;

/// A picture position snapped to 1/256 px, in 1/256 px.
pub(super) type Spot = [i32; 2];

/// The spot of a vertex that has none: its triangles must be cut first, or it is not finite.
pub(super) const NO_SPOT: Spot = [i32::MIN; 2];

/// A vertex before the lens.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Vertex {
    /// Picture position, px.
    pub at: [f64; 2],
    /// 1/z in 1/mm; 0 where the triangle must be cut first, NaN where the vertex is not finite. And intensity: max(0, n·L)
    /// in 0..1, rounded to f32.
    pub of: [f64; 2],
}

impl Vertex {
    /// No vertex.
    pub const NONE: Vertex = Vertex { at: [0.0; 2], of: [0.0; 2] };

    #[inline(always)]
    pub fn w(&self) -> f64 {
        self.of[0]
    }

    #[inline(always)]
    pub fn intensity(&self) -> f64 {
        self.of[1]
    }

    /// Puts a camera-space point on the picture; without a spot `w` stays 0 (to be cut) or is NaN.
    #[inline]
    pub fn project(point: DVec3, near: f64, field: &Field) -> Self {
        let nowhere = |w| Self { at: [0.0; 2], of: [w, 0.0] };
        if !point.is_finite() {
            return nowhere(f64::NAN);
        }
        if point.z < near {
            return nowhere(0.0);
        }
        let w = 1.0 / point.z;
        let Some(px) = field.project(point.x * w, point.y * w) else { return nowhere(0.0) };
        Self { at: px.to_array(), of: [w, 0.0] }
    }

    /// Its place snapped, or `NO_SPOT`.
    #[inline]
    pub fn spot(&self) -> Spot {
        let seen = self.w() > 0.0;
        if seen { self.at.map(|v| (v * SUBPIXELS + 0.5).floor() as i32) } else { NO_SPOT }
    }
}

/// The frame's vertices, those of all instances one after the other.
#[derive(Default)]
pub(super) struct Vertices {
    pub places: Vec<Vertex>,
    /// Theirs.
    pub spots: Vec<Spot>,
    /// Unit normals in camera space, and intensity once more; empty when no channel wants them.
    pub normals: Vec<[f32; 4]>,
}

/// Vertices that one task places.
pub(super) const RUN: usize = 1024;

impl Vertices {
    /// Makes room for at least `count` vertices.
    pub fn reserve(&mut self, count: usize, channels: Channels) {
        self.spots.reserve(count.saturating_sub(self.spots.len()));
        self.places.reserve(count.saturating_sub(self.places.len()));
        let normals = if channels.normals { count } else { 0 };
        self.normals.reserve(normals.saturating_sub(self.normals.len()));
    }

    /// Holds `count` vertices; allocates only to grow.
    pub fn resize(&mut self, count: usize, channels: Channels) {
        self.spots.resize(count, NO_SPOT);
        self.places.resize(count, Vertex::default());
        self.normals.resize(if channels.normals { count } else { 0 }, [0.0; 4]);
    }

    /// None, but with room for some.
    pub fn clear(&mut self) {
        self.spots.clear();
        self.spots.reserve(256);
        self.places.clear();
        self.places.reserve(256);
        self.normals.clear();
        self.normals.reserve(256);
    }
}

/// The matrix that turns normals with the model: the inverse transpose up to a positive factor.
pub(super) fn normal_matrix(to_camera: &DAffine3) -> DMat3 {
    let m = to_camera.matrix3;
    let cofactor =
        DMat3::from_cols(m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis));
    if m.determinant() < 0.0 { cofactor * -1.0 } else { cofactor }
}

/// A vector of length 1, or zero where it has no direction.
#[inline]
pub(super) fn unit(v: DVec3) -> DVec3 {
    let length = v.length_squared().sqrt();
    if length > 0.0 && length.is_finite() { v / length } else { DVec3::ZERO }
}

/// What one mesh is placed with.
#[derive(Clone, Copy)]
pub(super) struct Stand<'a> {
    pub mesh: &'a Mesh,
    pub to_camera: &'a DAffine3,
    pub near: f64,
    pub field: &'a Field,
    /// Unit vector towards the light.
    pub light: Vec3,
    /// Whether anything is lit.
    pub lit: bool,
}

/// Nearest and farthest 1/z of vertices on the picture's side of the near plane, and whether some must be cut.
#[derive(Clone, Copy, Debug)]
pub(super) struct Depths {
    pub least: f64,
    pub most: f64,
    pub cut: bool,
}

impl Depths {
    pub const NONE: Depths = Depths { least: f64::INFINITY, most: 0.0, cut: false };

    pub fn join(self, other: Depths) -> Depths {
        let (least, most) = (self.least.min(other.least), self.most.max(other.most));
        Depths { least, most, cut: self.cut | other.cut }
    }
}

/// Places all vertices of a mesh from `first` on in the frame's; gives their depths.
pub(super) fn place(level: Level, stand: Stand<'_>, out: &mut Vertices, first: usize) -> Depths {
    let range = first..first + stand.mesh.positions.len();
    let spots = out.spots[range.clone()].par_chunks_mut(RUN);
    let places = out.places[range.clone()].par_chunks_mut(RUN);
    let run = |(k, (spots, places)): (usize, (&mut [Spot], &mut [Vertex])), normals: &mut [[f32; 4]]| dispatch!(level, simd => place_run(simd, &stand, k * RUN, spots, places, normals));
    let both = spots.zip(places).enumerate();
    if out.normals.is_empty() {
        return both.map(|part| run(part, &mut [])).reduce(|| Depths::NONE, Depths::join);
    }
    let normals = out.normals[range].par_chunks_mut(RUN);
    both.zip(normals).map(|(part, normals)| run(part, normals)).reduce(|| Depths::NONE, Depths::join)
}

/// Vertices of a batch.
const BATCH: usize = 4;

/// Three coordinates of four points.
type Points<S> = [f64x4<S>; 3];

#[inline(always)]
fn place_run<S: Simd>(
    simd: S,
    stand: &Stand<'_>,
    first: usize,
    spots: &mut [Spot],
    places: &mut [Vertex],
    normals: &mut [[f32; 4]],
) -> Depths {
    let m = &stand.to_camera.matrix3;
    let turn = normal_matrix(stand.to_camera);
    let light = stand.light.as_dvec3();
    let positions = &stand.mesh.positions[first..first + spots.len()];
    let given = stand.mesh.normals.get(first..).unwrap_or_default();
    let mut least = f64x4::splat(simd, f64::INFINITY);
    let mut most = f64x4::splat(simd, 0.0);
    let mut cut = false;
    let (zero, infinite) = (f64x4::splat(simd, 0.0), f64x4::splat(simd, f64::INFINITY));
    for (batch, points) in positions.chunks(BATCH).enumerate() {
        let at = batch * BATCH;
        let p = turned(simd, m, gather(simd, points));
        let t = stand.to_camera.translation;
        let (x, y, z) = (p[0] + t.x, p[1] + t.y, p[2] + t.z);
        let mut w = f64x4::splat(simd, 1.0) / z;
        let (mut px, mut py, inside) = stand.field.project_four(simd, x * w, y * w);
        // inside is not what is infinite or not a number, but for z
        let whole = inside & z.simd_ge(f64x4::splat(simd, stand.near)) & z.simd_lt(infinite);
        let seen = whole.to_bitmask();
        if seen != 15 {
            // what is not finite times 0 is not a number
            let finite = (x * zero + y * zero + z * zero).simd_eq(zero);
            w = whole.select(w, finite.select(zero, f64x4::splat(simd, f64::NAN)));
            (px, py) = (whole.select(px, zero), whole.select(py, zero));
        }
        // the sum's last 32 bits are the whole number
        let magic = f64x4::splat(simd, 6_755_399_441_055_744.0);
        let half = f64x4::splat(simd, 0.5);
        let mut sx = (px * SUBPIXELS + half).floor() + magic;
        let mut sy = (py * SUBPIXELS + half).floor() + magic;
        if seen != 15 {
            let none = f64x4::splat(simd, f64::from(NO_SPOT[0])) + magic;
            (sx, sy) = (whole.select(sx, none), whole.select(sy, none));
        }
        let counted = points.len();
        if counted == BATCH && seen == 15 {
            least = w.simd_lt(least).select(w, least);
            most = most.simd_lt(w).select(w, most);
        }

        let mut intensity = zero;
        if stand.lit {
            let n = turned(simd, &turn, gather(simd, given.get(at..).unwrap_or_default()));
            let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
            let known = length.simd_gt(zero) & length.simd_lt(infinite);
            let nx = known.select(n[0] / length, zero);
            let ny = known.select(n[1] / length, zero);
            let nz = known.select(n[2] / length, zero);
            let lit = nx * light.x + ny * light.y + nz * light.z;
            let lit = lit.simd_gt(zero).select(lit, zero);
            let rounded = narrow(simd, lit);
            intensity = wide(simd, rounded);
            if let Some(normals) = normals.get_mut(at..at + counted) {
                let rows = [narrow(simd, nx), narrow(simd, ny), narrow(simd, nz), rounded];
                let mut side = [0.0f32; 4 * BATCH];
                simd.store_four_interleaved_f32x4(rows, &mut side);
                for (normal, four) in normals.iter_mut().zip(side.chunks_exact(BATCH)) {
                    normal.copy_from_slice(four);
                }
            }
        }
        let (ats, ofs) = (pairs(simd, px, py), pairs(simd, w, intensity));
        let (sx, sy) = (sx.to_array(), sy.to_array());
        match (spots[at..].first_chunk_mut::<BATCH>(), places[at..].first_chunk_mut::<BATCH>()) {
            (Some(spots), Some(places)) => {
                for k in 0..BATCH {
                    spots[k] = [sx[k].to_bits() as i32, sy[k].to_bits() as i32];
                    ats[k].store_slice(&mut places[k].at);
                    ofs[k].store_slice(&mut places[k].of);
                }
            }
            _ => {
                for (k, (spot, place)) in spots[at..].iter_mut().zip(&mut places[at..]).enumerate() {
                    *spot = [sx[k].to_bits() as i32, sy[k].to_bits() as i32];
                    ats[k].store_slice(&mut place.at);
                    ofs[k].store_slice(&mut place.of);
                }
            }
        }
        if counted < BATCH || seen != 15 {
            for &w in &w.to_array()[..counted] {
                cut |= w == 0.0;
                if w > 0.0 {
                    (least[0], most[0]) = (least[0].min(w), most[0].max(w));
                }
            }
        }
    }
    let (least, most) = (least.to_array(), most.to_array());
    Depths {
        least: least.into_iter().fold(f64::INFINITY, f64::min),
        most: most.into_iter().fold(0.0, f64::max),
        cut,
    }
}

/// One of each, four times.
#[inline(always)]
fn pairs<S: Simd>(simd: S, first: f64x4<S>, second: f64x4<S>) -> [f64x2<S>; BATCH] {
    let ((a, b), (c, d)) = (simd.split_f64x4(first), simd.split_f64x4(second));
    [simd.zip_low_f64x2(a, c), simd.zip_high_f64x2(a, c), simd.zip_low_f64x2(b, d), simd.zip_high_f64x2(b, d)]
}

/// Up to four points side by side; the rest is zero.
#[inline(always)]
fn gather<S: Simd>(simd: S, points: &[Vec3]) -> Points<S> {
    let (mut x, mut y, mut z) = ([0.0f32; BATCH], [0.0f32; BATCH], [0.0f32; BATCH]);
    match points.first_chunk::<BATCH>() {
        Some(points) => {
            for (k, point) in points.iter().enumerate() {
                (x[k], y[k], z[k]) = (point.x, point.y, point.z);
            }
        }
        None => {
            for (k, point) in points.iter().enumerate().take(BATCH) {
                (x[k], y[k], z[k]) = (point.x, point.y, point.z);
            }
        }
    }
    [widen(simd, x), widen(simd, y), widen(simd, z)]
}

/// The points times the matrix, summed as glam does.
#[inline(always)]
fn turned<S: Simd>(simd: S, m: &DMat3, [x, y, z]: Points<S>) -> Points<S> {
    let (a, b, c) = (m.x_axis, m.y_axis, m.z_axis);
    let of = |v: f64| f64x4::splat(simd, v);
    [
        x * of(a.x) + y * of(b.x) + z * of(c.x),
        x * of(a.y) + y * of(b.y) + z * of(c.y),
        x * of(a.z) + y * of(b.z) + z * of(c.z),
    ]
}

#[inline(always)]
pub(super) fn widen<S: Simd>(simd: S, v: [f32; BATCH]) -> f64x4<S> {
    wide(simd, f32x4::simd_from(simd, v))
}

#[inline(always)]
pub(super) fn wide<S: Simd>(simd: S, v: f32x4<S>) -> f64x4<S> {
    let (low, high) = simd.widen_f32x4(v);
    simd.combine_f64x2(low, high)
}

#[inline(always)]
pub(super) fn narrow<S: Simd>(simd: S, v: f64x4<S>) -> f32x4<S> {
    let (low, high) = simd.split_f64x4(v);
    simd.narrow_f64x2(low, high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Lens;
    use crate::pixels::{Size, SplitMix64, simd};

    /// Every batch against the single vertex: the same bits, at every level, whatever the lens and the numbers.
    #[test]
    fn batches_are_single_vertices() {
        let mut rng = SplitMix64::new(4);
        let mut mesh = Mesh::default();
        for k in 0..4099 {
            let mut any = || (rng.f64() - 0.5) as f32;
            let odd = [f32::NAN, f32::INFINITY, 1e30, 0.0, -1e-30];
            let point = Vec3::new(any() * 8.0, any() * 6.0, any() * 12.0);
            mesh.positions.push(if k % 37 == 5 { point.with_x(odd[k / 37 % 5]) } else { point });
            mesh.normals.push(if k % 41 == 0 { Vec3::ZERO } else { Vec3::new(any(), any(), any()) });
        }
        mesh.normals.truncate(4090);
        let mut lens = Lens::guess(Size::new(640, 480));
        for distortion in [[0.0; 8], [-0.25, 0.05, 1e-3, -5e-4, 0.01, 0.02, 0.01, 0.0]] {
            lens.distortion = distortion;
            let field = Field::new(lens);
            let matrix3 = DMat3::from_rotation_y(0.4) * DMat3::from_rotation_x(2.0) * 1.7;
            let to_camera = DAffine3 { matrix3, translation: DVec3::new(0.3, 0.1, 4.0) };
            let light = Vec3::new(-0.4, -0.6, -0.69);
            let stand =
                Stand { mesh: &mesh, to_camera: &to_camera, near: 0.5, field: &field, light, lit: true };
            for level in simd::available() {
                let mut out = Vertices::default();
                out.resize(mesh.positions.len(), Channels { normals: true, ..Channels::default() });
                let depths = place(level, stand, &mut out, 0);
                let mut expected = Depths::NONE;
                for (k, position) in mesh.positions.iter().enumerate() {
                    let point = to_camera.transform_point3(position.as_dvec3());
                    let mut vertex = Vertex::project(point, 0.5, &field);
                    let normal = mesh.normals.get(k).copied().unwrap_or_default().as_dvec3();
                    let normal = unit(normal_matrix(&to_camera) * normal);
                    vertex.of[1] = f64::from(normal.dot(light.as_dvec3()).max(0.0) as f32);
                    let w = vertex.w();
                    let depth = if w > 0.0 { Depths { least: w, most: w, cut: false } } else { Depths::NONE };
                    expected = expected.join(Depths { cut: w == 0.0, ..depth });
                    let bits = |v: Vertex| [v.at, v.of].map(|pair| pair.map(f64::to_bits));
                    assert_eq!(out.spots[k], vertex.spot(), "vertex {k} {}", simd::name(level));
                    assert_eq!(bits(out.places[k]), bits(vertex), "vertex {k} {}", simd::name(level));
                    assert_eq!(Vec3::from_slice(&out.normals[k]), normal.as_vec3(), "vertex {k}");
                    assert_eq!(f64::from(out.normals[k][3]), vertex.intensity(), "vertex {k}");
                }
                assert_eq!(
                    (depths.least, depths.most, depths.cut),
                    (expected.least, expected.most, expected.cut)
                );
                assert!(expected.cut && expected.most > 0.5);
            }
        }
    }
}
