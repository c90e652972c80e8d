//! Triangles, vertices and materials of one model.

use super::edges::{Edges, KeptEdges};
use crate::pixels::Rgb;
use glam::{DVec3, Vec2, Vec3};
use std::sync::Arc;

/// An indexed triangle mesh. All vertex arrays have the same length, or `texcoords` and `colors` are empty.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions in mesh units.
    pub positions: Vec<Vec3>,
    /// Unit normals (zero where a vertex has none).
    pub normals: Vec<Vec3>,
    /// Texture coordinates, v up (OBJ convention); empty when no face has any.
    pub texcoords: Vec<Vec2>,
    /// Vertex colors, sRGB values 0..1, multiplied with the material's; empty when there are none.
    pub colors: Vec<Vec3>,
    /// Three vertex indices a triangle, counter-clockwise as seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Material index of each triangle; empty when `materials` is empty. An index past the end means no
    /// material: white.
    pub material_of: Vec<u16>,
    /// The materials.
    pub materials: Vec<Material>,
    /// Room for the edges: read them by [`Mesh::edges`].
    pub kept_edges: KeptEdges,
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
    /// How the texture goes on past its edges, along u and v.
    pub wrap: [Wrap; 2],
    /// Whether light has no part in it: color and texture are shown as they are.
    pub unlit: bool,
}

/// How a texture goes on past its edges.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Wrap {
    /// Again from the other edge (the default of MTL and glTF).
    #[default]
    Repeat,
    /// Back and forth.
    Mirror,
    /// The edge's color (MTL `-clamp on`).
    Clamp,
}

impl Material {
    /// A plain color, sRGB values 0..1.
    pub fn plain(color: Vec3) -> Self {
        Self { color, ..Self::default() }
    }

    /// A texture as it is.
    pub fn textured(texture: Arc<Rgb>) -> Self {
        Self { color: Vec3::ONE, texture: Some(texture), ..Self::default() }
    }
}

impl Mesh {
    /// The parallelogram `center ± u ± v`, facing u × v, its texture once across it with v up.
    pub fn quad(center: Vec3, u: Vec3, v: Vec3, material: Material) -> Self {
        let corners = [(-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (1.0, 1.0)];
        Mesh {
            positions: corners.iter().map(|&(s, t)| center + u * s + v * t).collect(),
            normals: vec![u.cross(v).normalize_or_zero(); 4],
            texcoords: corners.iter().map(|&(s, t)| Vec2::new(s + 1.0, t + 1.0) / 2.0).collect(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            material_of: vec![0; 2],
            materials: vec![material],
            ..Mesh::default()
        }
    }

    /// Which triangles share which edges; found at the first call, so the mesh must not change after it.
    pub fn edges(&self) -> &Edges {
        self.kept_edges.of(self)
    }

    /// Gives every material this color.
    pub fn set_color(&mut self, color: Vec3) {
        self.materials_mut().iter_mut().for_each(|m| m.color = color);
    }

    /// Gives every material this texture.
    pub fn set_texture(&mut self, texture: Arc<Rgb>) {
        self.materials_mut().iter_mut().for_each(|m| m.texture = Some(texture.clone()));
    }

    /// The materials; a mesh without any gets one, white, for all triangles.
    fn materials_mut(&mut self) -> &mut [Material] {
        if self.materials.is_empty() {
            self.materials.push(Material { color: Vec3::ONE, ..Material::default() });
            self.material_of = vec![0; self.triangles.len()];
        }
        &mut self.materials
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
    fn bounds_hold_what_is_drawn() {
        let positions = vec![Vec3::NEG_X, Vec3::ONE, Vec3::new(0.0, 2.0, -3.0), Vec3::MAX];
        let mesh = Mesh { positions, triangles: vec![[0, 1, 2]], ..Mesh::default() };
        assert_eq!(mesh.bounds(), Some((Vec3::new(-1.0, 0.0, -3.0), Vec3::new(1.0, 2.0, 1.0))));
        assert_eq!(Mesh::default().bounds(), None);
    }

    #[test]
    fn painting_reaches_meshes_without_materials() {
        let mut mesh =
            Mesh { positions: vec![Vec3::ZERO; 3], triangles: vec![[0, 1, 2]; 2], ..Mesh::default() };
        mesh.set_color(Vec3::X);
        assert_eq!((mesh.materials.len(), mesh.materials[0].color, mesh.material_of.len()), (1, Vec3::X, 2));
    }
}
