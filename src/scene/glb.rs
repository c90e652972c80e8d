//! glTF 2.0 in one binary file: core geometry and base colors, KHR_materials_unlit, KHR_texture_transform.
//!
//! The nodes of the scene become one mesh in the file's own frame (metres, y up): their transforms applied, texture
//! transforms baked into the coordinates, linear colors coded as sRGB. Points, lines, cameras and alpha are left
//! out; skins and morph targets stay at rest. What other extensions a file *requires* is named in the refusal,
//! what it merely uses in the log.
//!
//! An own reading of the container and of the JSON (by `serde`) instead of the `gltf` crate: that one panics on a
//! header that claims fewer bytes than itself and on accessors that reach past their views.
//!
//! Source: Khronos Group, glTF 2.0 Specification, 2021.

mod accessor;
mod json;
mod material;

use super::Limits;
use super::load::{Refusal, finish};
use super::mesh::{Mesh, unit};
use super::texture::Textures;
use accessor::{Buffers, Reader};
use glam::{DAffine2, DAffine3, DMat3, DMat4, DQuat, DVec2, DVec3, Vec2, Vec3};
use json::{Attributes, Document, Node, Primitive};
use material::Materials;
use std::collections::HashMap;

/// Extensions that are understood.
const KNOWN: [&str; 2] = ["KHR_materials_unlit", "KHR_texture_transform"];

fn broken(reason: impl std::fmt::Display) -> Refusal {
    Refusal::Broken(reason.to_string())
}

/// Reads a file; refuses what is beyond `limits`, contradicts itself or cannot be drawn without an unknown extension.
pub(super) fn parse(bytes: &[u8], limits: &Limits, textures: &mut Textures) -> Result<Mesh, Refusal> {
    let (text, data) = chunks(bytes)?;
    let objects = text.iter().filter(|&&b| b == b'{').count();
    Refusal::above(objects, limits.entries, "objects in its JSON part")?;
    let document: Document =
        serde_json::from_slice(text).map_err(|e| broken(format_args!("its JSON: {e}")))?;
    extensions(&document)?;
    Refusal::above(document.materials.len(), limits.materials, "materials")?;

    let buffers = Buffers { document: &document, data };
    let materials = Materials::new(&buffers, textures)?;
    let mut builder = Builder {
        mesh: Mesh::default(),
        buffers,
        materials,
        limits,
        parts: 0,
        triangles: 0,
        shared: HashMap::new(),
    };
    walk(&document, limits, &mut |mesh, to_file| builder.instance(mesh, &to_file))?;
    let Builder { mut mesh, materials, .. } = builder;
    mesh.materials = materials.into_materials();
    if mesh.materials.is_empty() {
        mesh.material_of.clear();
    }
    let vertices = mesh.positions.len();
    if !mesh.texcoords.is_empty() {
        mesh.texcoords.resize(vertices, Vec2::ZERO);
    }
    if !mesh.colors.is_empty() {
        mesh.colors.resize(vertices, Vec3::ONE);
    }
    finish(&mut mesh);
    Ok(mesh)
}

/// The JSON and the binary chunk (§4.4): `glTF`, version, length; then chunks of length, type, data.
fn chunks(bytes: &[u8]) -> Result<(&[u8], &[u8]), Refusal> {
    let word = |at: usize| {
        let word = bytes.get(at..at.checked_add(4)?)?;
        Some(u32::from_le_bytes([word[0], word[1], word[2], word[3]]))
    };
    if !bytes.starts_with(b"glTF") {
        return Err(broken("it does not begin with `glTF`; save it in one binary file, as .glb"));
    }
    let short = || broken("it is shorter than it says; copy the file again");
    let (version, length) = (word(4).ok_or_else(short)?, word(8).ok_or_else(short)? as usize);
    if version != 2 {
        return Err(broken(format_args!("version {version}; save it as glTF 2.0")));
    }
    let whole = bytes.get(..length).ok_or_else(short)?;
    let (mut at, mut json, mut data) = (12, None, None);
    while at < whole.len() {
        let (Some(size), Some(kind)) = (word(at), word(at + 4)) else { return Err(short()) };
        let end = (at + 8).checked_add(size as usize).ok_or_else(short)?;
        let chunk = whole.get(at + 8..end).ok_or_else(short)?;
        match (&kind.to_le_bytes(), json) {
            (b"JSON", None) => json = Some(chunk),
            (b"BIN\0", Some(_)) => data = data.or(Some(chunk)),
            _ => {}
        }
        at = end;
    }
    Ok((json.ok_or_else(|| broken("it has no JSON part"))?, data.unwrap_or_default()))
}

/// Refuses unknown required extensions, all by name; logs the others.
fn extensions(document: &Document) -> Result<(), Refusal> {
    let unknown = |names: &[String]| {
        let unknown = names.iter().filter(|name| !KNOWN.contains(&name.as_str()));
        unknown.map(|name| name.chars().take(64).collect()).take(16).collect::<Vec<String>>().join(", ")
    };
    let required = unknown(&document.extensions_required);
    if !required.is_empty() {
        let known = KNOWN.join(" and ");
        return Err(broken(format_args!("it requires {required}; export it without, only {known} are read")));
    }
    let used = unknown(&document.extensions_used);
    if !used.is_empty() {
        log::warn!("model uses {used}: drawn without");
    }
    Ok(())
}

/// Calls `visit` with every mesh of the scene and its frame → the file's.
fn walk(
    document: &Document,
    limits: &Limits,
    visit: &mut dyn FnMut(usize, DAffine3) -> Result<(), Refusal>,
) -> Result<(), Refusal> {
    let roots = match document.scenes.get(document.scene.unwrap_or(0) as usize) {
        Some(scene) => scene.nodes.clone(),
        None => {
            let mut inner = vec![false; document.nodes.len()];
            for &child in document.nodes.iter().flat_map(|node| &node.children) {
                if let Some(inner) = inner.get_mut(child as usize) {
                    *inner = true;
                }
            }
            (0..inner.len() as u32).filter(|&node| !inner[node as usize]).collect()
        }
    };
    let mut seen = vec![false; document.nodes.len()];
    let mut open: Vec<(&Node, DAffine3, usize)> = Vec::new();
    let mut enter = |children: &[u32], to_file: DAffine3, depth: usize, open: &mut Vec<_>| {
        for &index in children.iter().rev() {
            let node = document.nodes.get(index as usize);
            let node = node.ok_or_else(|| broken(format_args!("there is no node {index}")))?;
            if std::mem::replace(&mut seen[index as usize], true) {
                return Err(broken(format_args!("node {index} has two parents; export it again")));
            }
            open.push((node, to_file, depth));
        }
        Ok(())
    };
    enter(&roots, DAffine3::IDENTITY, 1, &mut open)?;
    while let Some((node, to_file, depth)) = open.pop() {
        Refusal::above(depth, limits.nesting, "levels of nodes")?;
        let to_file = to_file * transform(node);
        if let Some(mesh) = node.mesh {
            visit(mesh as usize, to_file)?;
        }
        enter(&node.children, to_file, depth + 1, &mut open)?;
    }
    Ok(())
}

/// A node's own frame → its parent's (§3.5.3).
fn transform(node: &Node) -> DAffine3 {
    if let Some(matrix) = &node.matrix {
        return DAffine3::from_mat4(DMat4::from_cols_array(matrix));
    }
    let scale = DVec3::from(node.scale.unwrap_or([1.0; 3]));
    let shift = DVec3::from(node.translation.unwrap_or_default());
    match node.rotation {
        // the unit quaternion of a file is one in f32 only
        Some(turn) => {
            let turn = DQuat::from_array(turn);
            let turn = if turn.length_squared() > 0.0 { turn.normalize() } else { DQuat::IDENTITY };
            DAffine3::from_scale_rotation_translation(scale, turn, shift)
        }
        None => DAffine3 { matrix3: DMat3::from_diagonal(scale), translation: shift },
    }
}

/// What decides the vertices of a primitive within one node: attributes, which texture coordinates, their change.
type Shared = (Attributes, u32, [u64; 6]);

/// The mesh as it grows.
struct Builder<'a> {
    mesh: Mesh,
    buffers: Buffers<'a>,
    materials: Materials<'a>,
    limits: &'a Limits,
    /// Primitives drawn so far.
    parts: usize,
    /// Triangles read so far, those that name missing vertices too.
    triangles: usize,
    /// First vertex of what primitives of the present node share.
    shared: HashMap<Shared, u32>,
}

impl Builder<'_> {
    /// Adds the mesh number `index`.
    fn instance(&mut self, index: usize, to_file: &DAffine3) -> Result<(), Refusal> {
        let document = self.buffers.document;
        let mesh = document.meshes.get(index);
        let mesh = mesh.ok_or_else(|| broken(format_args!("there is no mesh {index}")))?;
        self.shared.clear();
        for primitive in &mesh.primitives {
            self.parts += 1;
            Refusal::above(self.parts, self.limits.entries, "parts of meshes")?;
            self.primitive(primitive, to_file)?;
        }
        Ok(())
    }

    fn primitive(&mut self, primitive: &Primitive, to_file: &DAffine3) -> Result<(), Refusal> {
        let (attributes, mode) = (primitive.attributes, primitive.mode.unwrap_or(4));
        let (Some(position), 4..=6) = (attributes.position, mode) else { return Ok(()) };
        let reader = Vertices::new(&self.buffers, &self.materials, primitive, position, to_file)?;
        let count = reader.positions.count();

        // few enough before they are read
        let indices = primitive.indices.map(|indices| self.buffers.read(indices, 1)).transpose()?;
        let corners = indices.as_ref().map_or(count, Reader::count);
        let whole = if mode == 4 { corners / 3 } else { corners.saturating_sub(2) };
        self.triangles = self.triangles.saturating_add(whole);
        Refusal::above(self.triangles, self.limits.triangles, "triangles")?;
        let index = |k: usize| match &indices {
            Some(indices) => indices.index(k),
            None => k as u32,
        };
        let mut triangles = Vec::with_capacity(whole);
        for k in 0..whole {
            // §3.7.2.1
            let [a, b, c] = match mode {
                4 => [3 * k, 3 * k + 1, 3 * k + 2],
                5 => [k, k + 1 + k % 2, k + 2 - k % 2],
                _ => [k + 1, k + 2, 0],
            };
            // a mirrored frame turns the winding round
            let triangle = if reader.mirrored { [a, c, b] } else { [a, b, c] }.map(index);
            if triangle.iter().all(|&i| (i as usize) < count) {
                triangles.push(triangle);
            }
        }

        let first = self.mesh.positions.len();
        let room = self.limits.vertices.saturating_sub(first);
        let too_many = || Refusal::TooMuch("vertices", self.limits.vertices as u64);
        if reader.normals.is_none() {
            // without normals every face is flat: no two share a vertex
            if 3 * triangles.len() > room {
                return Err(too_many());
            }
            triangles.iter().flatten().for_each(|&i| reader.push(i as usize, &mut self.mesh));
            let own = |t: u32| [0, 1, 2].map(|k| first as u32 + 3 * t + k);
            self.mesh.triangles.extend((0..triangles.len() as u32).map(own));
        } else {
            let (set, change) = self.materials.texcoords(primitive.material);
            let key = (attributes, set, change.to_cols_array().map(f64::to_bits));
            let known = self.shared.get(&key).copied();
            if known.is_none() {
                if count > room {
                    return Err(too_many());
                }
                (0..count).for_each(|i| reader.push(i, &mut self.mesh));
                self.shared.insert(key, first as u32);
            }
            let first = known.unwrap_or(first as u32);
            self.mesh.triangles.extend(triangles.iter().map(|t| t.map(|i| first + i)));
        }
        let material = primitive.material.and_then(|m| u16::try_from(m).ok()).unwrap_or(u16::MAX);
        self.mesh.material_of.resize(self.mesh.triangles.len(), material);
        Ok(())
    }
}

/// The vertices of one primitive, in the file's frame.
struct Vertices<'a> {
    positions: Reader<'a>,
    normals: Option<Reader<'a>>,
    colors: Option<Reader<'a>>,
    texcoords: Option<(Reader<'a>, DAffine2)>,
    to_file: &'a DAffine3,
    turn: DMat3,
    mirrored: bool,
}

impl<'a> Vertices<'a> {
    fn new(
        buffers: &Buffers<'a>,
        materials: &Materials,
        primitive: &Primitive,
        position: u32,
        to_file: &'a DAffine3,
    ) -> Result<Self, Refusal> {
        let attributes = primitive.attributes;
        let (set, change) = materials.texcoords(primitive.material);
        let read = |accessor: Option<u32>, width| accessor.map(|a| buffers.read(a, width)).transpose();
        // normals turn by the inverse transpose; the cofactors are that up to the determinant
        let [x, y, z] = [to_file.matrix3.x_axis, to_file.matrix3.y_axis, to_file.matrix3.z_axis];
        let mirrored = to_file.matrix3.determinant() < 0.0;
        let cofactors = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y));
        Ok(Self {
            positions: buffers.read(position, 3)?,
            normals: read(attributes.normal, 3)?,
            colors: read(attributes.color_0, 3)?,
            texcoords: read(attributes.texcoord(set), 2)?.map(|reader| (reader, change)),
            to_file,
            turn: if mirrored { -cofactors } else { cofactors },
            mirrored,
        })
    }

    /// Adds vertex `i` to the mesh; a normal that it lacks is 0.
    fn push(&self, i: usize, mesh: &mut Mesh) {
        let vector = |reader: &Reader| DVec3::from(reader.value(i).map(f64::from));
        mesh.positions.push(self.to_file.transform_point3(vector(&self.positions)).as_vec3());
        let normal = self.normals.as_ref().map_or(DVec3::ZERO, |reader| self.turn * vector(reader));
        mesh.normals.push(unit(normal));
        // the first part that has texture coordinates or colors fills up those before it
        if let Some((reader, change)) = &self.texcoords {
            let [u, v, _] = reader.value(i).map(f64::from);
            let changed = change.transform_point2(DVec2::new(u, v));
            let texcoord = Vec2::new(changed.x as f32, (1.0 - changed.y) as f32);
            mesh.texcoords.resize(mesh.positions.len() - 1, Vec2::ZERO);
            mesh.texcoords.push(if texcoord.is_finite() { texcoord } else { Vec2::ZERO });
        }
        if let Some(reader) = &self.colors {
            mesh.colors.resize(mesh.positions.len() - 1, Vec3::ONE);
            mesh.colors.push(material::coded(Vec3::from(reader.value(i))));
        }
    }
}
