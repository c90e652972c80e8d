//! Triangles, vertices and materials of one model.

use crate::pixels::Rgb;
use glam::{Vec2, Vec3};
use std::sync::Arc;

/// An indexed triangle mesh. All vertex arrays have the same length, or `texcoords` is empty.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Vertex positions in mesh units.
    pub positions: Vec<Vec3>,
    /// Unit normals (zero where a vertex has none).
    pub normals: Vec<Vec3>,
    /// Texture coordinates, v up (OBJ convention); empty when no face has any.
    pub texcoords: Vec<Vec2>,
    /// Three vertex indices a triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Material index of each triangle; empty when `materials` is empty.
    pub material_of: Vec<u16>,
    /// The materials.
    pub materials: Vec<Material>,
}

/// Surface color: a base color, perhaps times a texture.
#[derive(Clone, Debug, Default)]
pub struct Material {
    /// Name in the material library.
    pub name: String,
    /// Base color (OBJ Kd), sRGB values 0..1.
    pub color: Vec3,
    /// Texture (map_Kd), multiplied with the color.
    pub texture: Option<Arc<Rgb>>,
}
