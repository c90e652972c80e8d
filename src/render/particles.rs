//! Models as particles (Fischer 2006, section 3.4.3): points scattered evenly over a mesh, each with a normal and a
//! color of its own.
//!
//! A mesh is scattered once and kept as long as it is drawn. Every frame, points that face the viewer are lit,
//! projected through the lens and sorted from far to near; hidden ones stay: painting over them is the style's part.

use super::field::Field;
use super::shade::sample;
use super::vertex::{normal_matrix, unit};
use super::{Camera, Placed};
use crate::frame::Particle;
use crate::pixels::{Rgb, Size, SplitMix64};
use crate::scene::{Light, Mesh, Scene};
use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;
use std::sync::Arc;

/// How meshes are scattered into points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Scatter {
    /// Points a mesh (`numParticles`).
    pub count: u32,
    /// Seed of their places.
    pub seed: u64,
}

/// A point of a mesh, in its coordinates.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Point {
    position: Vec3,
    /// Unit length, or zero where the mesh has none.
    normal: Vec3,
    /// Unlit color, 0..1.
    color: Vec3,
}

/// A mesh and its points.
struct Cloud {
    mesh: Arc<Mesh>,
    scatter: Scatter,
    points: Vec<Point>,
}

/// The clouds of a scene's models, and room to sort what is seen of them.
#[derive(Default)]
pub(super) struct Particles {
    /// By model.
    clouds: Vec<Option<Cloud>>,
    seen: Vec<Particle>,
    keys: Vec<u64>,
}

/// Points that one task places.
const RUN: usize = 1024;

impl Particles {
    /// Fills `out` with the placed models' visible points, far to near; of equal depths the first placed comes first.
    /// Allocates only when the scene is new or a model is placed more often than ever before.
    pub fn draw(
        &mut self,
        scene: &Scene,
        placed: &[Placed],
        camera: &Camera,
        field: &Field,
        scatter: Scatter,
        out: &mut Vec<Particle>,
    ) {
        let Self { clouds, seen, keys } = self;
        out.clear();
        clouds.resize_with(scene.models.len(), || None);
        for (cloud, model) in clouds.iter_mut().zip(&scene.models) {
            let kept = |cloud: &Cloud| Arc::ptr_eq(&cloud.mesh, &model.mesh) && cloud.scatter == scatter;
            if !cloud.as_ref().is_some_and(kept) {
                let points = scattered(&model.mesh, scatter);
                *cloud = Some(Cloud { mesh: model.mesh.clone(), scatter, points });
            }
        }
        let placed =
            placed.iter().filter(|placed| scene.models.get(placed.model).is_some_and(|m| !m.phantom));
        let count = |cloud: &Option<Cloud>| cloud.as_ref().map_or(0, |cloud| cloud.points.len());
        let of_placed = |placed: &Placed| clouds.get(placed.model).map_or(0, count);
        let total: usize = placed.clone().map(of_placed).sum();
        let most = total.max(clouds.iter().map(count).sum());
        seen.clear();
        seen.reserve(most);
        seen.resize(total, Particle::default());
        let mut first = 0;
        for placed in placed {
            let Some(Some(cloud)) = clouds.get(placed.model) else { continue };
            let view = View::new(placed, camera, field, &scene.light);
            let part = &mut seen[first..first + cloud.points.len()];
            part.par_chunks_mut(RUN).zip(cloud.points.par_chunks(RUN)).for_each(|(out, points)| {
                for (out, point) in out.iter_mut().zip(points) {
                    *out = view.particle(point).unwrap_or_default();
                }
            });
            first += cloud.points.len();
        }
        keys.clear();
        keys.reserve(most);
        out.reserve(most);
        for (index, particle) in seen.iter().enumerate().filter(|(_, particle)| particle.z > 0.0) {
            // positive floats are ordered as their bits
            keys.push(u64::from(!particle.z.to_bits()) << 32 | index as u64);
        }
        keys.par_sort_unstable();
        out.extend(keys.iter().map(|&key| seen[key as u32 as usize]));
    }
}

/// What one placed model is seen with.
struct View<'a> {
    placed: &'a Placed,
    camera: &'a Camera,
    field: &'a Field,
    normals: glam::DMat3,
    towards_light: DVec3,
    ambient: f64,
    tint: DVec3,
}

impl<'a> View<'a> {
    fn new(placed: &'a Placed, camera: &'a Camera, field: &'a Field, light: &Light) -> Self {
        let ambient = if light.ambient >= 0.0 { f64::from(light.ambient.min(1.0)) } else { 0.0 };
        let normals = normal_matrix(&placed.to_camera);
        let (towards_light, tint) = (light.direction.as_dvec3(), light.tint.as_dvec3());
        Self { placed, camera, field, normals, towards_light, ambient, tint }
    }

    /// The point as it is seen; `None` where it faces away, or is not in the picture.
    #[inline]
    fn particle(&self, point: &Point) -> Option<Particle> {
        let at = self.placed.to_camera.transform_point3(point.position.as_dvec3());
        let normal = self.normals * point.normal.as_dvec3();
        let inside = at.z >= self.camera.near && at.z <= self.camera.far;
        if !inside || normal.dot(at) > 0.0 {
            return None;
        }
        let w = 1.0 / at.z;
        let px = self.field.project(at.x * w, at.y * w)?;
        let Size { width, height } = self.field.lens().size;
        let shown = |v: f64, length: usize| v >= -0.5 && v < length as f64 - 0.5;
        if !shown(px.x, width) || !shown(px.y, height) {
            return None;
        }
        let intensity = unit(normal).dot(self.towards_light).max(0.0);
        let light = self.ambient + (1.0 - self.ambient) * intensity;
        let color = (point.color.as_dvec3() * self.tint).min(DVec3::ONE) * light;
        let color = color.as_vec3().to_array();
        Some(Particle { x: px.x as f32, y: px.y as f32, z: at.z as f32, color })
    }
}

/// Points spread over `mesh` by area, triangle by triangle: of the first triangles' share of the area the same share
/// of the points, rounded. Triangles that are broken or not finite get none.
pub(super) fn scattered(mesh: &Mesh, scatter: Scatter) -> Vec<Point> {
    let mut rng = SplitMix64::new(scatter.seed);
    let count = f64::from(scatter.count);
    let total: f64 = mesh.triangles.iter().map(|&corners| area(mesh, corners)).sum();
    let mut points = Vec::with_capacity(scatter.count as usize);
    let mut covered = 0.0;
    for (triangle, &corners) in mesh.triangles.iter().enumerate() {
        covered += area(mesh, corners);
        let until =
            if total > 0.0 && total.is_finite() { (count * covered / total + 0.5).floor() } else { 0.0 };
        while (points.len() as f64) < until {
            points.push(point(mesh, triangle, corners, weights(&mut rng)));
        }
    }
    points
}

/// Area of a triangle; 0 where it has none.
fn area(mesh: &Mesh, corners: [u32; 3]) -> f64 {
    let corner = |i: u32| mesh.positions.get(i as usize).map(|p| p.as_dvec3());
    let [Some(a), Some(b), Some(c)] = corners.map(corner) else { return 0.0 };
    let doubled = (b - a).cross(c - a).length_squared().sqrt();
    if doubled.is_finite() { doubled / 2.0 } else { 0.0 }
}

/// Three random weights that sum up to one, evenly spread over the triangle.
fn weights(rng: &mut SplitMix64) -> [f64; 3] {
    let (mut s, mut t) = (rng.f64(), rng.f64());
    if s + t > 1.0 {
        (s, t) = (1.0 - s, 1.0 - t);
    }
    [1.0 - s - t, s, t]
}

/// The point of a triangle at these weights of its corners (eq. 3.12).
fn point(mesh: &Mesh, triangle: usize, corners: [u32; 3], weights: [f64; 3]) -> Point {
    let mut at = (DVec3::ZERO, DVec3::ZERO, Vec2::ZERO, Vec3::ZERO);
    for (&corner, weight) in corners.iter().zip(weights) {
        let corner = corner as usize;
        at.0 += mesh.positions[corner].as_dvec3() * weight;
        at.1 += mesh.normals.get(corner).copied().unwrap_or_default().as_dvec3() * weight;
        at.2 += mesh.texcoords.get(corner).copied().unwrap_or_default() * weight as f32;
        at.3 += mesh.colors.get(corner).copied().unwrap_or(Vec3::ONE) * weight as f32;
    }
    let (position, normal) = (at.0.as_vec3(), unit(at.1).as_vec3());
    let color = color(mesh, triangle, at.2) * at.3.min(Vec3::ONE).max(Vec3::ZERO);
    Point { position, normal, color }
}

/// Unlit color of a triangle where its texture coordinates are `uv`.
fn color(mesh: &Mesh, triangle: usize, uv: Vec2) -> Vec3 {
    let material =
        mesh.material_of.get(triangle).and_then(|&material| mesh.materials.get(usize::from(material)));
    let Some(material) = material else { return Vec3::ONE };
    let share = |v: f32| if v >= 0.0 { v.min(1.0) } else { 0.0 };
    let base = Vec3::from(material.color.to_array().map(share));
    let has_texels = |texture: &&Arc<Rgb>| texture.size().area() > 0;
    match material.texture.as_ref().filter(has_texels) {
        Some(texture) => base * Vec3::from(sample(texture, material.wrap, uv.x, uv.y)),
        None => base,
    }
}
