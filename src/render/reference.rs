//! The rules of drawing, written down plainly in f64: one triangle after the other, every pixel of its box,
//! all fragments of a pixel kept and sorted at the end. No tiles, no threads, no tricks. Undistorted lenses.

use super::{Camera, Placed};
use crate::frame::Layer;
use crate::scene::{Light, Mesh};
use glam::DVec3;

/// One surface seen through a pixel.
#[derive(Clone, Copy, Debug)]
pub struct Fragment {
    /// Camera z.
    pub depth: f64,
    /// Unit normal in camera space, or zero.
    pub normal: DVec3,
    /// Interpolated intensity of the vertices.
    pub smooth: f64,
    /// That of the face.
    pub flat: f64,
}

/// A drawn picture.
pub struct Picture {
    /// Pixels of a row.
    pub width: usize,
    /// Fragments of each pixel, nearest first, equal depths in submission order.
    pub fragments: Vec<Vec<Fragment>>,
    /// Pixels whose center is within 1/256 px of an edge.
    pub near_edge: Vec<bool>,
}

impl Picture {
    /// The nearest fragment, and the nearest strictly behind it.
    pub fn layers(&self, pixel: usize) -> [Option<Fragment>; 2] {
        let all = &self.fragments[pixel];
        let first = all.first().copied();
        [first, first.and_then(|first| all.iter().copied().find(|f| f.depth > first.depth))]
    }

    /// Whether rounding may decide which fragment is first or second: depths closer than 1e-6 among those
    /// in question.
    pub fn order_is_close(&self, pixel: usize) -> bool {
        let close = |pair: &[Fragment]| pair[1].depth - pair[0].depth <= 1e-6 * pair[0].depth;
        self.fragments[pixel].windows(2).take(3).any(close)
    }
}

#[derive(Clone, Copy)]
struct Corner {
    point: DVec3,
    normal: DVec3,
    intensity: f64,
}

/// Draws one placed mesh.
pub fn draw(mesh: &Mesh, placed: &Placed, camera: &Camera, light: &Light, cull_back: bool) -> Picture {
    let size = camera.lens.size;
    let mut picture = Picture {
        width: size.width,
        fragments: vec![Vec::new(); size.area()],
        near_edge: vec![false; size.area()],
    };
    let normals = placed.to_camera.matrix3.inverse().transpose();
    let towards = light.direction.as_dvec3();
    for triangle in &mesh.triangles {
        let at = |i: u32| mesh.positions.get(i as usize).map_or(DVec3::NAN, |p| p.as_dvec3());
        let corners = triangle.map(|i| {
            let normal = mesh.normals.get(i as usize).copied().unwrap_or_default().as_dvec3();
            let normal = (normals * normal).normalize_or_zero();
            let point = placed.to_camera.transform_point3(at(i));
            Corner { point, normal, intensity: normal.dot(towards).max(0.0) }
        });
        if corners.iter().any(|c| !c.point.is_finite()) {
            continue;
        }
        let [a, b, c] = triangle.map(at);
        let flat = (normals * (b - a).cross(c - a)).normalize_or_zero().dot(towards).max(0.0);
        let polygon = clip_near(&corners, camera.near);
        for k in 2..polygon.len() {
            fill([polygon[0], polygon[k - 1], polygon[k]], flat, camera, cull_back, &mut picture);
        }
    }
    for fragments in &mut picture.fragments {
        fragments.sort_by(|a, b| a.depth.total_cmp(&b.depth));
    }
    picture
}

fn clip_near(corners: &[Corner], near: f64) -> Vec<Corner> {
    let mut out = Vec::new();
    for (k, b) in corners.iter().enumerate() {
        let a = &corners[(k + corners.len() - 1) % corners.len()];
        if (a.point.z >= near) != (b.point.z >= near) {
            let t = (near - a.point.z) / (b.point.z - a.point.z);
            out.push(Corner {
                point: (a.point + (b.point - a.point) * t).with_z(near),
                normal: a.normal + (b.normal - a.normal) * t,
                intensity: a.intensity + (b.intensity - a.intensity) * t,
            });
        }
        if b.point.z >= near {
            out.push(*b);
        }
    }
    out
}

fn fill(corners: [Corner; 3], flat: f64, camera: &Camera, cull_back: bool, picture: &mut Picture) {
    let lens = &camera.lens;
    let mut corners = corners;
    let pixel = |c: &Corner| {
        (
            c.point.x / c.point.z * lens.focal.x + lens.center.x,
            c.point.y / c.point.z * lens.focal.y + lens.center.y,
        )
    };
    let snap = |c: &Corner| {
        let (x, y) = pixel(c);
        ((x * 256.0 + 0.5).floor() as i128, (y * 256.0 + 0.5).floor() as i128)
    };
    let area = |[a, b, c]: [(i128, i128); 3]| (b.0 - a.0) * (c.1 - a.1) - (c.0 - a.0) * (b.1 - a.1);
    let turn = area(corners.each_ref().map(snap));
    // y down: positive is clockwise as seen, the back
    if turn == 0 || (cull_back && turn > 0) {
        return;
    }
    if turn < 0 {
        corners.swap(1, 2);
    }
    let snapped = corners.each_ref().map(snap);
    let [a, b, c] = corners.each_ref().map(pixel);
    let det = (b.0 - a.0) * (c.1 - a.1) - (c.0 - a.0) * (b.1 - a.1);
    let w = corners.map(|c| 1.0 / c.point.z);
    let range = |values: [i128; 3], count: usize| {
        let low = values.into_iter().min().unwrap_or(0).div_euclid(256) - 1;
        let high = values.into_iter().max().unwrap_or(0).div_euclid(256) + 2;
        low.clamp(0, count as i128)..high.clamp(0, count as i128)
    };
    let columns = range(snapped.map(|p| p.0), lens.size.width);
    for y in range(snapped.map(|p| p.1), lens.size.height) {
        for x in columns.clone() {
            let at = y as usize * picture.width + x as usize;
            let (mut inside, mut distance) = (true, f64::MAX);
            for k in 0..3 {
                let (p, q) = (snapped[k], snapped[(k + 1) % 3]);
                let (dx, dy) = (q.0 - p.0, q.1 - p.1);
                let (px, py) = (x * 256 - p.0, y * 256 - p.1);
                let side = dx * py - dy * px;
                let top_left = dy < 0 || (dy == 0 && dx > 0);
                inside &= side > 0 || (side == 0 && top_left);
                // distance to the edge as a segment, in 1/256 px
                let length2 = (dx * dx + dy * dy) as f64;
                let along = ((px * dx + py * dy) as f64 / length2.max(1.0)).clamp(0.0, 1.0);
                let (ex, ey) = (px as f64 - along * dx as f64, py as f64 - along * dy as f64);
                distance = distance.min((ex * ex + ey * ey).sqrt());
            }
            picture.near_edge[at] |= distance <= 1.0;
            if !inside || det == 0.0 {
                continue;
            }
            let (px, py) = (x as f64 - a.0, y as f64 - a.1);
            let l1 = (px * (c.1 - a.1) - py * (c.0 - a.0)) / det;
            let l2 = (py * (b.0 - a.0) - px * (b.1 - a.1)) / det;
            let weights = [(1.0 - l1 - l2) * w[0], l1 * w[1], l2 * w[2]];
            let depth = 1.0 / (weights[0] + weights[1] + weights[2]);
            if !(depth > 0.0 && depth <= camera.far) {
                continue;
            }
            let sum = |of: fn(&Corner) -> DVec3| {
                (0..3).fold(DVec3::ZERO, |sum, k| sum + of(&corners[k]) * weights[k]) * depth
            };
            picture.fragments[at].push(Fragment {
                depth,
                normal: sum(|c| c.normal).normalize_or_zero(),
                smooth: sum(|c| DVec3::splat(c.intensity)).x.clamp(0.0, 1.0),
                flat,
            });
        }
    }
}

/// How far a drawn layer is from the reference, on pixels where rounding cannot decide.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Difference {
    /// Surfaces compared, of both layers where both are drawn.
    pub covered: usize,
    /// Pixels left out: near an edge, or with two surfaces too close to tell.
    pub excused: usize,
    /// Surfaces where there should be none, or the other way round.
    pub coverage: usize,
    /// Largest difference of depth, relative.
    pub depth: f64,
    /// Largest difference of a normal's component; 0 where no normals are drawn.
    pub normal: f64,
}

impl Difference {
    /// Compares all that the layer has beside colors.
    pub fn of(layer: &Layer, picture: &Picture) -> Self {
        let mut found = Self::default();
        let planes = [(&layer.depth, &layer.normal), (&layer.depth2, &layer.normal2)];
        for (pixel, &near_edge) in picture.near_edge.iter().enumerate() {
            if near_edge || picture.order_is_close(pixel) {
                found.excused += 1;
                continue;
            }
            let (x, y) = (pixel % picture.width, pixel / picture.width);
            for (expected, (depth, normal)) in picture.layers(pixel).into_iter().zip(planes) {
                if depth.size().area() == 0 {
                    continue;
                }
                let drawn = f64::from(depth.at(x, y));
                let Some(expected) = expected.filter(|_| drawn.is_finite()) else {
                    found.coverage += usize::from(expected.is_some() != drawn.is_finite());
                    continue;
                };
                found.covered += 1;
                found.depth = found.depth.max((drawn / expected.depth - 1.0).abs());
                if normal[0].size().area() > 0 {
                    let normal = DVec3::from_array([0, 1, 2].map(|k| f64::from(normal[k].at(x, y))));
                    found.normal = found.normal.max((normal - expected.normal).abs().max_element());
                }
            }
        }
        found
    }
}
