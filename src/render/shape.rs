//! What is known of a mesh before it is drawn: the box around it, and boxes and normal cones of its clusters, by which
//! what lies outside the view or turns its back is skipped unseen.
//!
//! A cluster is a run of triangles as the mesh has them: nothing is reordered, since the first submitted wins. All
//! tests are on the safe side.

use super::Camera;
use super::field::Field;
use super::vertex::unit;
use crate::scene::{Mesh, Scene};
use glam::{DAffine3, DVec2, DVec3};
use rayon::prelude::*;
use std::sync::Arc;

/// Triangles of a cluster.
pub(super) const CLUSTER: usize = 128;

/// Rounding in the tests, relative to the distances they compare: far above that of f64, far below a pixel.
const HAIR: f64 = 1e-7;

/// A box around points, mesh coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bounds {
    center: DVec3,
    half: DVec3,
}

/// Triangles that follow each other.
#[derive(Clone, Copy, Debug)]
struct Cluster {
    /// `None` when no triangle is finite.
    bounds: Option<Bounds>,
    /// Mean direction of its face normals and the sine of the widest angle to it; none where it is 90° or more.
    cone: Option<(DVec3, f64)>,
}

/// The shape of one mesh.
pub(super) struct Shape {
    mesh: Arc<Mesh>,
    bounds: Option<Bounds>,
    clusters: Vec<Cluster>,
}

/// The shapes of a scene's models, by their index.
#[derive(Default)]
pub(super) struct Shapes(Vec<Shape>);

impl Shapes {
    /// Looks at meshes that are new. Allocates only for these.
    pub fn learn(&mut self, scene: &Scene) {
        let Shapes(shapes) = self;
        shapes.truncate(scene.models.len());
        for (k, model) in scene.models.iter().enumerate() {
            match shapes.get_mut(k) {
                Some(shape) if Arc::ptr_eq(&shape.mesh, &model.mesh) => {}
                Some(shape) => *shape = Shape::new(&model.mesh),
                None => shapes.push(Shape::new(&model.mesh)),
            }
        }
    }

    /// The shape of a model.
    pub fn of(&self, model: usize) -> Option<&Shape> {
        self.0.get(model)
    }
}

impl Shape {
    fn new(mesh: &Arc<Mesh>) -> Self {
        let clusters: Vec<_> =
            mesh.triangles.par_chunks(CLUSTER).map(|triangles| Cluster::new(mesh, triangles)).collect();
        let bounds = clusters.iter().filter_map(|cluster| cluster.bounds).reduce(Bounds::join);
        Self { mesh: mesh.clone(), bounds, clusters }
    }

    /// Whether any of it may be in view.
    pub fn may_show(&self, view: &Frustum) -> bool {
        self.bounds.is_some_and(|bounds| view.may_hold(&bounds))
    }

    /// Whether any of the cluster with this triangle may be drawn.
    pub fn cluster_may_show(&self, triangle: usize, view: &Frustum, cull_back: bool) -> bool {
        let Some(cluster) = self.clusters.get(triangle / CLUSTER) else { return true };
        let Some(bounds) = &cluster.bounds else { return false };
        view.may_hold(bounds) && !(cull_back && view.sees_backs(bounds, cluster.cone))
    }
}

impl Bounds {
    fn of(low: DVec3, high: DVec3) -> Self {
        Self { center: (low + high) * 0.5, half: (high - low) * 0.5 }
    }

    fn join(self, other: Self) -> Self {
        let low = (self.center - self.half).min(other.center - other.half);
        Self::of(low, (self.center + self.half).max(other.center + other.half))
    }
}

impl Cluster {
    fn new(mesh: &Mesh, triangles: &[[u32; 3]]) -> Self {
        let (mut low, mut high) = (DVec3::MAX, DVec3::MIN);
        let mut sum = DVec3::ZERO;
        let corners = |triangle: &[u32; 3]| -> Option<[DVec3; 3]> {
            let at = |i: u32| mesh.positions.get(i as usize).filter(|p| p.is_finite()).map(|p| p.as_dvec3());
            Some([at(triangle[0])?, at(triangle[1])?, at(triangle[2])?])
        };
        let normal = |[a, b, c]: [DVec3; 3]| unit((b - a).cross(c - a));
        for corners in triangles.iter().filter_map(corners) {
            for corner in corners {
                (low, high) = (low.min(corner), high.max(corner));
            }
            sum += normal(corners);
        }
        let axis = unit(sum);
        let least = triangles.iter().filter_map(corners).map(|t| normal(t).dot(axis)).fold(1.0, f64::min);
        Self {
            bounds: (low.x <= high.x).then(|| Bounds::of(low, high)),
            cone: (least > 0.0).then(|| (axis, (1.0 - least * least).max(0.0).sqrt())),
        }
    }
}

/// What of an instance the camera can show.
#[derive(Clone, Copy)]
pub(super) struct Frustum {
    to_camera: DAffine3,
    near: f64,
    far: f64,
    /// Rays x/z and y/z of the picture's edges.
    low: DVec2,
    high: DVec2,
    /// Where the camera is in mesh coordinates; none where the model is mirrored or flat.
    eye: Option<DVec3>,
}

impl Frustum {
    /// Of an instance; what is up to `margin_px` outside the picture counts as in it.
    pub fn new(to_camera: DAffine3, camera: &Camera, field: &Field, margin_px: f64) -> Self {
        let (low, high) = field.view(margin_px);
        let eye = (to_camera.matrix3.determinant() > 0.0).then(|| to_camera.inverse().translation);
        let eye = eye.filter(|eye| eye.is_finite());
        Self { to_camera, near: camera.near, far: camera.far, low, high, eye }
    }

    fn may_hold(&self, bounds: &Bounds) -> bool {
        let DAffine3 { matrix3: m, translation } = self.to_camera;
        let center = m * bounds.center + translation;
        let sides = [m.x_axis * bounds.half.x, m.y_axis * bounds.half.y, m.z_axis * bounds.half.z];
        // how far the box reaches to the plane's positive side
        let reach = |normal: DVec3, offset: f64| {
            let (at, wide) = (normal.dot(center), sides.iter().map(|s| normal.dot(*s).abs()).sum::<f64>());
            let size = normal.abs().dot(center.abs()) + wide + offset.abs();
            at + wide + size * HAIR - offset
        };
        let planes = [
            (DVec3::Z, self.near),
            (DVec3::NEG_Z, -self.far),
            (DVec3::new(1.0, 0.0, -self.low.x), 0.0),
            (DVec3::new(-1.0, 0.0, self.high.x), 0.0),
            (DVec3::new(0.0, 1.0, -self.low.y), 0.0),
            (DVec3::new(0.0, -1.0, self.high.y), 0.0),
        ];
        // what is not a number may be anywhere
        !planes.iter().any(|&(normal, offset)| reach(normal, offset) < 0.0)
    }

    /// Whether all triangles with these bounds and normals turn their back on the camera.
    fn sees_backs(&self, bounds: &Bounds, cone: Option<(DVec3, f64)>) -> bool {
        let (Some(eye), Some((axis, sine))) = (self.eye, cone) else { return false };
        let (towards, radius) = (bounds.center - eye, length(bounds.half));
        towards.dot(axis) > (sine + 1e-3) * length(towards) + radius
    }
}

fn length(v: DVec3) -> f64 {
    v.length_squared().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Lens;
    use crate::pixels::{Size, SplitMix64};
    use glam::{DMat3, Vec3};

    /// What is skipped must have no corner in view, and only backs.
    #[test]
    fn nothing_that_shows_is_skipped() {
        let mut rng = SplitMix64::new(8);
        let lens = Lens::guess(Size::new(160, 120));
        let (field, camera) = (Field::new(lens), Camera { lens, near: 1.0, far: 50.0 });
        let (mut outside, mut backs) = (0, 0);
        for _ in 0..3000 {
            let mut any = |scale: f64| (rng.f64() - 0.5) * scale;
            let matrix3 = DMat3::from_rotation_y(any(7.0)) * DMat3::from_rotation_x(any(7.0));
            let to_camera = DAffine3 { matrix3, translation: DVec3::new(any(40.0), any(30.0), any(60.0)) };
            let mut mesh = Mesh::default();
            let curve = any(2.0) as f32;
            for t in 0..20 {
                let (x, y) = (any(4.0) as f32, any(4.0) as f32);
                // a little bowl, all of it wound the same way
                for (dx, dy) in [(0.0, 0.0), (0.5, 0.0), (0.0, 0.5)] {
                    let (x, y) = (x + dx, y + dy);
                    mesh.positions.push(Vec3::new(x, y, curve * 0.1 * (x * x + y * y)));
                }
                mesh.triangles.push([3 * t, 3 * t + 1, 3 * t + 2]);
            }
            let at = |i: u32| to_camera.transform_point3(mesh.positions[i as usize].as_dvec3());
            let mesh = Arc::new(mesh.clone());
            let shape = Shape::new(&mesh);
            let view = Frustum::new(to_camera, &camera, &field, 1.5);
            let in_view = mesh.triangles.iter().flatten().any(|&i| {
                let (p, px) = (at(i), lens.project(at(i)));
                p.z >= 1.0
                    && p.z <= 50.0
                    && px.is_some_and(|px| px.x > -1.0 && px.y > -1.0 && px.x < 160.0 && px.y < 120.0)
            });
            let front = mesh.triangles.iter().any(|t| {
                let [a, b, c] = t.map(at);
                a.dot((b - a).cross(c - a)) < 0.0
            });
            if !shape.may_show(&view) {
                outside += 1;
                assert!(!in_view);
            } else if !shape.cluster_may_show(0, &view, true) {
                backs += 1;
                assert!(!front);
            }
            assert_eq!(shape.cluster_may_show(5, &view, false), shape.may_show(&view));
        }
        assert!(outside > 1000 && backs > 100, "{outside} {backs}");
    }
}
