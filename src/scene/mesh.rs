//! Triangles, vertices and materials of one model.

use crate::pixels::Rgb;
use glam::{DVec3, Vec2, Vec3};
use std::sync::Arc;

/// An indexed triangle mesh. All vertex arrays have the same length, or `texcoords` is empty.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions in mesh units.
    pub positions: Vec<Vec3>,
    /// Unit normals (zero where a vertex has none).
    pub normals: Vec<Vec3>,
    /// Texture coordinates, v up (OBJ convention); empty when no face has any.
    pub texcoords: Vec<Vec2>,
    /// Three vertex indices a triangle, counter-clockwise as seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Material index of each triangle; empty when `materials` is empty. An index past the end means no
    /// material: white.
    pub material_of: Vec<u16>,
    /// The materials.
    pub materials: Vec<Material>,
}

/// Surface color: a base color, perhaps times a texture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Material {
    /// Name in the material library.
    pub name: String,
    /// Base color (OBJ Kd), sRGB values 0..1.
    pub color: Vec3,
    /// Texture (map_Kd), multiplied with the color.
    pub texture: Option<Arc<Rgb>>,
}

impl Material {
    /// A plain color, sRGB values 0..1.
    pub fn plain(color: Vec3) -> Self {
        Self { name: String::new(), color, texture: None }
    }

    /// A texture as it is.
    pub fn textured(texture: Arc<Rgb>) -> Self {
        Self { name: String::new(), color: Vec3::ONE, texture: Some(texture) }
    }
}

impl Mesh {
    /// A rectangle of `width` x `height` around the origin in the plane z = 0, facing +z: x to the right of
    /// its picture, y up, the texture once across it.
    pub fn quad(width: f32, height: f32, material: Material) -> Self {
        let mut mesh = Mesh { materials: vec![material], ..Mesh::default() };
        let (x, y) = (width / 2.0, height / 2.0);
        mesh.push_face([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]].map(Vec3::from), Vec3::Z);
        mesh
    }

    /// A closed box of this extent around the origin, the texture once across every face.
    pub fn cuboid(extent: Vec3, material: Material) -> Self {
        let mut mesh = Mesh { materials: vec![material], ..Mesh::default() };
        for axis in 0..3 {
            for side in [1.0, -1.0] {
                let mut normal = [0.0; 3];
                normal[axis] = side;
                let normal = Vec3::from(normal);
                // a right-handed frame right × up = normal
                let right = Vec3::from([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]][axis]) * side;
                let up = normal.cross(right);
                let corner = |r: f32, u: f32| (normal + right * r + up * u) * extent / 2.0;
                let corners = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
                mesh.push_face(corners, normal);
            }
        }
        mesh
    }

    /// Adds a four-cornered face (bottom left first, counter-clockwise) with material 0.
    fn push_face(&mut self, corners: [Vec3; 4], normal: Vec3) {
        let first = self.positions.len() as u32;
        self.positions.extend(corners);
        self.normals.extend([normal; 4]);
        self.texcoords.extend([Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y]);
        self.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        self.material_of.extend([0, 0]);
    }

    /// Smallest box, lowest and highest corner, around all finite positions that triangles use; `None` when
    /// there are none.
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        let corners = self.triangles.iter().flatten().filter_map(|&i| self.positions.get(i as usize));
        let finite = corners.filter(|p| p.is_finite()).copied();
        finite.fold(None, |bounds, p| match bounds {
            None => Some((p, p)),
            Some((low, high)) => Some((low.min(p), high.max(p))),
        })
    }
}

/// Normals of `count` points as the sum of the area-weighted normals of the triangles around them; zero
/// where they cancel or there are none. `triangles` hold indices below `count`.
pub(super) fn area_weighted_normals(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    let mut sums = vec![DVec3::ZERO; positions.len()];
    for triangle in triangles {
        let [a, b, c] = triangle.map(|i| positions[i as usize].as_dvec3());
        let weighted = (b - a).cross(c - a);
        for &i in triangle {
            sums[i as usize] += weighted;
        }
    }
    sums.into_iter().map(unit).collect()
}

/// Of length 1, or zero where there is no direction.
pub(super) fn unit(v: DVec3) -> Vec3 {
    let length = v.length_squared().sqrt();
    if length > 0.0 && length.is_finite() { (v / length).as_vec3() } else { Vec3::ZERO }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_faces_outward_on_all_sides() {
        let mesh = Mesh::cuboid(Vec3::new(2.0, 4.0, 6.0), Material::default());
        assert_eq!(mesh.bounds(), Some((Vec3::new(-1.0, -2.0, -3.0), Vec3::new(1.0, 2.0, 3.0))));
        assert_eq!(mesh.triangles.len(), 12);
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|i| mesh.positions[i as usize]);
            let outward = (b - a).cross(c - a);
            assert!(outward.dot(mesh.normals[triangle[0] as usize]) > 0.0);
            assert!(outward.dot(a) > 0.0);
        }
        assert_eq!(Mesh::default().bounds(), None);
    }
}
