//! Model files: which format a file is, what it may ask of the machine, and how it is refused.
//!
//! The formats are a file each: OBJ (`obj`, with `mtl`), glTF binary (`glb`), PLY (`ply`) and STL (`stl`). All of
//! them give vertices that no triangle needs without complaint, drop triangles that name missing or not finite
//! positions, and compute the normals that a file leaves out. OBJ is never refused for what its lines say
//! (contracts: `draw`); the others are when they are cut short or contradict themselves.

use super::mesh::{Mesh, area_weighted_normals, unit};
use super::texture::Textures;
use super::{glb, obj, ply, stl};
use glam::Vec3;
use std::path::{Path, PathBuf};

/// What a model file may ask of the machine.
///
/// Loading a file of `n` bytes (with its material libraries) never holds more than 128 n bytes, 512 bytes an entry,
/// 256 a vertex, 128 a triangle and 32 a texel, each up to its limit here, and a megabyte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Size of the model file and of each MTL file, bytes.
    pub bytes: u64,
    /// Positions, normals, texture coordinates, and unified vertices: each.
    pub vertices: usize,
    /// Triangles.
    pub triangles: usize,
    /// Materials.
    pub materials: usize,
    /// Width and height of a texture, px.
    pub texture_px: u32,
    /// Pixels of all textures together.
    pub texels: u64,
    /// glTF: how deep nodes lie within nodes.
    pub nesting: usize,
    /// glTF: objects in the JSON part, and parts of meshes that are drawn; PLY: elements and properties.
    pub entries: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            bytes: 512 << 20,
            vertices: 8 << 20,
            triangles: 8 << 20,
            materials: 4096,
            texture_px: 8192,
            texels: 128 << 20,
            nesting: 64,
            entries: 1 << 18,
        }
    }
}

/// Why a model could not be loaded.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// The file cannot be read.
    #[error("{}: cannot read model: {reason}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        reason: std::io::Error,
    },
    /// The file is larger than a limit.
    #[error("{}: more than {limit} {what}; simplify or split the model", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// What there is too much of.
        what: &'static str,
        /// How much is allowed.
        limit: u64,
    },
    /// The file is not what it says it is, or asks for what is not there.
    #[error("{}: not a usable {format} model: {reason}", path.display())]
    Broken {
        /// The file.
        path: PathBuf,
        /// Which format it should be.
        format: &'static str,
        /// What is wrong and what to do.
        reason: String,
    },
}

/// What a format's parser says no with; [`Mesh::parse`] adds the file's name.
#[derive(Debug, PartialEq)]
pub(super) enum Refusal {
    /// More of something than a limit allows.
    TooMuch(&'static str, u64),
    /// What is wrong and what to do.
    Broken(String),
}

impl Refusal {
    /// Refuses more than `limit` of `what`.
    pub fn above(count: usize, limit: usize, what: &'static str) -> Result<(), Refusal> {
        if count > limit { Err(Refusal::TooMuch(what, limit as u64)) } else { Ok(()) }
    }
}

/// A format of model files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Obj,
    Glb,
    Ply,
    Stl,
}

impl Format {
    /// The first bytes decide where they can, then the ending; everything else is OBJ.
    fn of(path: &Path, bytes: &[u8]) -> Format {
        if bytes.starts_with(b"glTF") {
            return Format::Glb;
        }
        if bytes.starts_with(b"ply\n") || bytes.starts_with(b"ply\r") {
            return Format::Ply;
        }
        let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        match ending.as_deref() {
            Some("glb" | "gltf") => Format::Glb,
            Some("ply") => Format::Ply,
            Some("stl") => Format::Stl,
            _ => Format::Obj,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Format::Obj => "OBJ",
            Format::Glb => "glTF",
            Format::Ply => "PLY",
            Format::Stl => "STL",
        }
    }
}

impl Mesh {
    /// Loads an OBJ, `.glb`, PLY or STL file with its materials and textures, within the default [`Limits`].
    ///
    /// Coordinates are the file's own. OBJ vertices are unified by position, texture coordinate and normal, STL's by
    /// position, in order of first use. Where a file gives no usable normal a vertex gets the area-weighted normal
    /// by position index (glTF: the face's, as it asks). A file without triangles gives an empty mesh.
    pub fn load(path: &Path) -> Result<Mesh, ModelError> {
        Self::load_within(path, &Limits::default())
    }

    /// [`Mesh::load`] within other limits.
    pub fn load_within(path: &Path, limits: &Limits) -> Result<Mesh, ModelError> {
        Self::parse(path, &read(path, limits)?, limits)
    }

    /// [`Mesh::load_within`] for a file that has been read: `path` says its name and where its materials and
    /// textures are.
    pub fn parse(path: &Path, bytes: &[u8], limits: &Limits) -> Result<Mesh, ModelError> {
        let format = Format::of(path, bytes);
        let mut textures = Textures::new(limits, path.parent());
        let mesh = match format {
            Format::Obj => obj::parse(bytes, limits, &mut textures),
            Format::Glb => glb::parse(bytes, limits, &mut textures),
            Format::Ply => ply::parse(bytes, limits, &mut textures),
            Format::Stl => stl::parse(bytes, limits),
        };
        mesh.map_err(|refusal| match refusal {
            Refusal::TooMuch(what, limit) => ModelError::TooLarge { path: path.into(), what, limit },
            Refusal::Broken(reason) => {
                ModelError::Broken { path: path.into(), format: format.name(), reason }
            }
        })
    }

    /// Reads OBJ text from memory, without materials; `None` beyond the default [`Limits`].
    pub fn from_obj(bytes: &[u8]) -> Option<Mesh> {
        let limits = Limits::default();
        obj::parse(bytes, &limits, &mut Textures::new(&limits, None)).ok()
    }
}

/// The bytes of a file, as long as there are not too many.
pub(super) fn read(path: &Path, limits: &Limits) -> Result<Vec<u8>, ModelError> {
    use std::io::Read;
    let fail = |reason| ModelError::Read { path: path.into(), reason };
    let file = std::fs::File::open(path).map_err(fail)?;
    let mut bytes = Vec::new();
    file.take(limits.bytes.saturating_add(1)).read_to_end(&mut bytes).map_err(fail)?;
    if bytes.len() as u64 > limits.bytes {
        return Err(ModelError::TooLarge { path: path.into(), what: "bytes", limit: limits.bytes });
    }
    Ok(bytes)
}

/// Makes a mesh whole: triangles without three finite positions go, normals become of length 1, and vertices
/// without one get the area-weighted normal by index.
pub(super) fn finish(mesh: &mut Mesh) {
    let usable = |i: u32| mesh.positions.get(i as usize).is_some_and(|p| p.is_finite());
    let keep: Vec<bool> = mesh.triangles.iter().map(|t| t.iter().all(|&i| usable(i))).collect();
    if keep.contains(&false) {
        let mut kept = keep.iter();
        mesh.triangles.retain(|_| *kept.next().unwrap_or(&false));
        let mut kept = keep.iter();
        mesh.material_of.retain(|_| *kept.next().unwrap_or(&false));
    }
    mesh.normals.resize(mesh.positions.len(), Vec3::ZERO);
    mesh.normals.iter_mut().for_each(|n| *n = unit(n.as_dvec3()));
    if mesh.normals.contains(&Vec3::ZERO) {
        let fallback = area_weighted_normals(&mesh.positions, &mesh.triangles);
        for (normal, fallback) in mesh.normals.iter_mut().zip(fallback) {
            if *normal == Vec3::ZERO {
                *normal = fallback;
            }
        }
    }
}
