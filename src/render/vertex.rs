//! Vertices: mesh space → camera space → picture, snapped and lit, all in f64.

use super::field::Field;
use super::{Camera, Needs};
use crate::scene::{Light, Mesh};
use glam::{DAffine3, DMat3, DVec3};
use rayon::prelude::*;

/// Sub-pixel positions a pixel is divided into along each axis.
pub(super) const SUBPIXELS: f64 = 256.0;

/// A vertex before the lens.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Vertex {
    /// Picture position, px.
    pub x: f64,
    /// Picture position, px.
    pub y: f64,
    /// 1/z in 1/mm; 0 where the triangle must be cut first, NaN where the vertex is not finite.
    pub w: f64,
    /// Position snapped to 1/256 px, in 1/256 px.
    pub snapped: [i32; 2],
    /// max(0, n·L) in 0..1.
    pub intensity: f32,
    /// Unit normal in camera space.
    pub normal: [f32; 3],
}

impl Vertex {
    /// Puts a camera-space point on the picture; `false` leaves `w` at 0 (to be cut) or NaN.
    #[inline]
    pub fn project(&mut self, point: DVec3, near: f64, field: &Field) -> bool {
        if !point.is_finite() {
            self.w = f64::NAN;
            return false;
        }
        self.w = 0.0;
        if point.z < near {
            return false;
        }
        let w = 1.0 / point.z;
        let Some(px) = field.project(point.x * w, point.y * w) else { return false };
        (self.x, self.y, self.w) = (px.x, px.y, w);
        self.snapped = [px.x, px.y].map(|v| (v * SUBPIXELS + 0.5).floor() as i32);
        true
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

/// Places all vertices of a mesh; `out` has one element a position.
pub(super) fn place(
    mesh: &Mesh,
    to_camera: &DAffine3,
    camera: &Camera,
    field: &Field,
    light: &Light,
    needs: Needs,
    out: &mut [Vertex],
) {
    const RUN: usize = 1024;
    let normals = normal_matrix(to_camera);
    let towards = light.direction.as_dvec3();
    let lit =
        needs.includes(Needs::COLOR) || needs.includes(Needs::NORMAL) || needs.includes(Needs::SECOND_LAYER);
    out.par_chunks_mut(RUN).enumerate().for_each(|(run, out)| {
        let first = run * RUN;
        for (k, vertex) in out.iter_mut().enumerate() {
            let position = mesh.positions[first + k].as_dvec3();
            vertex.project(to_camera.transform_point3(position), camera.near, field);
            if lit {
                let normal = mesh.normals.get(first + k).copied().unwrap_or_default().as_dvec3();
                let normal = unit(normals * normal);
                vertex.normal = normal.as_vec3().to_array();
                vertex.intensity = normal.dot(towards).max(0.0) as f32;
            }
        }
    });
}
