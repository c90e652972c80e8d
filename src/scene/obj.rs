//! Wavefront OBJ with its MTL materials and textures (contracts: `draw`).
//!
//! A file is never refused for what its lines say: broken corners drop their face, broken positions drop
//! their triangles, everything unknown is skipped. It is refused for being unreadable or beyond `Limits`.
//! Missing material libraries and textures are logged and done without.

use super::mesh::{Material, Mesh, area_weighted_normals, unit};
use crate::pixels::{Rgb, picture};
use glam::{Vec2, Vec3};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What a model file may ask of the machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Size of the OBJ and of each MTL file, bytes.
    pub bytes: u64,
    /// Positions, normals, texture coordinates, and unified vertices: each.
    pub vertices: usize,
    /// Triangles.
    pub triangles: usize,
    /// Materials.
    pub materials: usize,
    /// Width and height of a texture, px.
    pub texture_px: u32,
}

impl Default for Limits {
    fn default() -> Self {
        Self { bytes: 512 << 20, vertices: 8 << 20, triangles: 8 << 20, materials: 4096, texture_px: 8192 }
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
}

impl Mesh {
    /// Loads an OBJ file with its materials and textures, within the default [`Limits`].
    ///
    /// Vertices are unified by position, texture coordinate and normal, in order of first use. Corners
    /// without a usable `vn` get the area-weighted normal by position index. A file without triangles gives
    /// an empty mesh.
    pub fn load(path: &Path) -> Result<Mesh, ModelError> {
        Self::load_within(path, &Limits::default())
    }

    /// [`Mesh::load`] within other limits.
    pub fn load_within(path: &Path, limits: &Limits) -> Result<Mesh, ModelError> {
        let bytes = read(path, limits)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut library = |name: &str, materials: &mut Vec<Material>| {
            let path = folder.join(name.replace('\\', "/"));
            match read(&path, limits) {
                Ok(bytes) => parse_mtl(&bytes, &path, limits, materials),
                Err(error) => log::warn!("{error}; drawing without these materials"),
            }
        };
        parse(&bytes, limits, &mut library).map_err(|(what, limit)| ModelError::TooLarge {
            path: path.into(),
            what,
            limit,
        })
    }

    /// Reads OBJ text from memory, without materials; `None` beyond the default [`Limits`].
    pub fn from_obj(bytes: &[u8]) -> Option<Mesh> {
        parse(bytes, &Limits::default(), &mut |_, _| ()).ok()
    }
}

fn read(path: &Path, limits: &Limits) -> Result<Vec<u8>, ModelError> {
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

/// The file's text: UTF-16 with a byte order mark (or the zeros of ASCII in UTF-16) is decoded, a UTF-8 mark
/// dropped, bytes that are not UTF-8 replaced.
fn text(bytes: &[u8]) -> String {
    let wide = |swap: bool, bytes: &[u8]| {
        let units = bytes
            .chunks_exact(2)
            .map(|b| if swap { u16::from_be_bytes([b[0], b[1]]) } else { u16::from_le_bytes([b[0], b[1]]) });
        char::decode_utf16(units).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect()
    };
    match bytes {
        [0xff, 0xfe, rest @ ..] => wide(false, rest),
        [0xfe, 0xff, rest @ ..] => wide(true, rest),
        [0xef, 0xbb, 0xbf, rest @ ..] => String::from_utf8_lossy(rest).into_owned(),
        [a, 0, b, 0, ..] if *a != 0 && *b != 0 => wide(false, bytes),
        [0, a, 0, b, ..] if *a != 0 && *b != 0 => wide(true, bytes),
        _ => String::from_utf8_lossy(bytes).into_owned(),
    }
}

/// Calls `line` with the statements of a file: comments cut, continued lines joined, ends of all kinds.
fn statements(text: &str, mut statement: impl FnMut(&str)) {
    let mut joined = String::new();
    let lines = text.split('\n').flat_map(|line| line.strip_suffix('\r').unwrap_or(line).split('\r'));
    for line in lines {
        let code = line.split('#').next().unwrap_or("");
        let trimmed = code.trim_end();
        if code.len() == line.len() && trimmed.ends_with('\\') {
            joined.push_str(&trimmed[..trimmed.len() - 1]);
            joined.push(' ');
        } else if joined.is_empty() {
            statement(code);
        } else {
            joined.push_str(code);
            statement(&joined);
            joined.clear();
        }
    }
    if !joined.is_empty() {
        statement(&joined);
    }
}

/// One corner of a face; 0-based, `None` where nothing usable was named. Positions and normals may lie
/// ahead in the file, so their range is checked at the end.
#[derive(Clone, Copy)]
struct Corner {
    position: u64,
    texcoord: Option<u64>,
    normal: Option<u64>,
}

/// Everything the lines said.
#[derive(Default)]
struct Lines {
    positions: Vec<Vec3>,
    texcoords: Vec<Vec2>,
    normals: Vec<Vec3>,
    corners: Vec<Corner>,
    /// Corner count and material of each face.
    faces: Vec<(u32, u16)>,
    triangles: usize,
    materials: Vec<Material>,
}

type TooMuch = (&'static str, u64);

fn parse(
    bytes: &[u8],
    limits: &Limits,
    library: &mut dyn FnMut(&str, &mut Vec<Material>),
) -> Result<Mesh, TooMuch> {
    let mut lines = Lines::default();
    let mut libraries = 0;
    let mut wanted = HashMap::new(); // usemtl names and their numbers: libraries may come later
    let mut current = u16::MAX;
    let mut over = None;
    let check = |count: usize, limit: usize, what: &'static str, over: &mut Option<TooMuch>| {
        if count > limit {
            over.get_or_insert((what, limit as u64));
        }
    };
    statements(&text(bytes), |statement| {
        if over.is_some() {
            return;
        }
        let statement = statement.trim_matches(|c: char| c.is_whitespace() || c == '\0' || c == '\u{feff}');
        let (keyword, rest) =
            statement.split_once(char::is_whitespace).map_or((statement, ""), |(k, r)| (k, r.trim()));
        match keyword {
            "v" => {
                let [x, y, z] = numbers(rest);
                lines.positions.push(Vec3::new(x, y, z));
                check(lines.positions.len(), limits.vertices, "positions", &mut over);
            }
            "vt" => {
                let [u, v] = numbers(rest);
                // v may be left out
                let v = if rest.split_whitespace().nth(1).is_none() { 0.0 } else { v };
                lines.texcoords.push(Vec2::new(u, v));
                check(lines.texcoords.len(), limits.vertices, "texture coordinates", &mut over);
            }
            "vn" => {
                lines.normals.push(Vec3::from_array(numbers(rest)));
                check(lines.normals.len(), limits.vertices, "normals", &mut over);
            }
            "f" | "fo" => {
                lines.face(rest, current);
                check(lines.triangles, limits.triangles, "triangles", &mut over);
            }
            "usemtl" => {
                let next = wanted.len().min(usize::from(u16::MAX)) as u16;
                current = *wanted.entry(rest.to_owned()).or_insert(next);
                check(wanted.len(), limits.materials, "materials", &mut over);
            }
            "mtllib" if libraries < 64 => {
                libraries += 1;
                library(rest, &mut lines.materials);
            }
            _ => {}
        }
    });
    match over {
        Some(too_much) => Err(too_much),
        None => lines.into_mesh(limits, &wanted),
    }
}

/// The first `N` numbers; what is missing or no number becomes NaN, and so drops what uses it.
fn numbers<const N: usize>(rest: &str) -> [f32; N] {
    let mut out = [f32::NAN; N];
    for (out, word) in out.iter_mut().zip(rest.split_whitespace()) {
        *out = word.parse().unwrap_or(f32::NAN);
    }
    out
}

/// An OBJ index → 0-based: negative ones count back from `count`; `Err` when it is no whole number, or 0, or
/// reaches before the start.
fn index(word: &str, count: usize) -> Result<u64, ()> {
    let digits = word.strip_prefix(['+', '-']).unwrap_or(word);
    if digits.is_empty() || !digits.bytes().all(|b| b.is_ascii_digit()) {
        return Err(());
    }
    // more digits than fit are as far out of range as the largest
    let magnitude = digits.parse().unwrap_or(u64::MAX);
    match word.starts_with('-') {
        false => magnitude.checked_sub(1).ok_or(()),
        true if magnitude == 0 => Err(()),
        true => (count as u64).checked_sub(magnitude).ok_or(()),
    }
}

impl Lines {
    /// Reads a face's corners; a corner that cannot be read drops the face.
    fn face(&mut self, rest: &str, material: u16) {
        let first = self.corners.len();
        for word in rest.split_whitespace() {
            let mut parts = word.split('/');
            let Ok(position) = index(parts.next().unwrap_or(""), self.positions.len()) else {
                self.corners.truncate(first);
                return;
            };
            let mut optional = |count| index(parts.next().unwrap_or(""), count).ok();
            let (texcoord, normal) = (optional(self.texcoords.len()), optional(self.normals.len()));
            self.corners.push(Corner { position, texcoord, normal });
        }
        let count = self.corners.len() - first;
        if count < 3 {
            self.corners.truncate(first);
            return;
        }
        self.faces.push((count as u32, material));
        self.triangles += count - 2;
    }

    /// The usable position of a corner.
    fn position(&self, corner: &Corner) -> Option<Vec3> {
        let at = usize::try_from(corner.position).ok()?;
        self.positions.get(at).copied().filter(|p| p.is_finite())
    }

    fn into_mesh(mut self, limits: &Limits, wanted: &HashMap<String, u16>) -> Result<Mesh, TooMuch> {
        // fans of usable corners, by corner number
        let (mut fans, mut material_of) = (Vec::new(), Vec::new());
        let mut first = 0;
        for &(count, material) in &self.faces {
            let usable = |k: usize| self.position(&self.corners[first + k]).is_some();
            for k in 2..count as usize {
                if usable(0) && usable(k - 1) && usable(k) {
                    fans.push([first, first + k - 1, first + k]);
                    material_of.push(material);
                }
            }
            first += count as usize;
        }
        let by_position = fans.iter().map(|fan| fan.map(|c| self.corners[c].position as u32));
        let fallback = area_weighted_normals(&self.positions, &by_position.collect::<Vec<_>>());

        let mut unifier = Unifier::new(self.positions.len());
        let mut mesh = Mesh::default();
        let mut any_texcoord = false;
        for fan in &fans {
            let mut triangle = [0; 3];
            for (out, &c) in triangle.iter_mut().zip(fan) {
                let corner = self.corners[c];
                let position = corner.position as usize;
                let of = |at: Option<u64>| at.and_then(|at| usize::try_from(at).ok());
                let uv = of(corner.texcoord).and_then(|t| Some((t, *self.texcoords.get(t)?)));
                let uv = uv.filter(|(_, uv)| uv.is_finite());
                let normal = of(corner.normal).and_then(|n| Some((n, unit(self.normals.get(n)?.as_dvec3()))));
                let normal = normal.filter(|(_, n)| *n != Vec3::ZERO);
                any_texcoord |= uv.is_some();
                let key =
                    [uv.map_or(u32::MAX, |(t, _)| t as u32), normal.map_or(u32::MAX, |(n, _)| n as u32)];
                *out = unifier.vertex(position, key, mesh.positions.len() as u32);
                if *out as usize == mesh.positions.len() {
                    mesh.positions.push(self.positions[position]);
                    mesh.normals.push(normal.map_or(fallback[position], |(_, n)| n));
                    mesh.texcoords.push(uv.map_or(Vec2::ZERO, |(_, uv)| uv));
                }
            }
            mesh.triangles.push(triangle);
        }
        if mesh.positions.len() > limits.vertices {
            return Err(("vertices", limits.vertices as u64));
        }
        if !any_texcoord {
            mesh.texcoords.clear();
        }
        mesh.materials = std::mem::take(&mut self.materials);
        if !mesh.materials.is_empty() {
            // names → numbers in the library; unknown names are white
            let mut numbers = vec![u16::MAX; wanted.len()];
            for (k, material) in mesh.materials.iter().enumerate().rev() {
                if let Some(&name) = wanted.get(&material.name) {
                    numbers[usize::from(name)] = k as u16;
                }
            }
            let number = |m: &u16| numbers.get(usize::from(*m)).copied().unwrap_or(u16::MAX);
            mesh.material_of = material_of.iter().map(number).collect();
        }
        Ok(mesh)
    }
}

/// Finds the vertex of a (position, texcoord, normal) triple through a list a position.
struct Unifier {
    first: Vec<u32>,
    entries: Vec<([u32; 2], u32, u32)>,
}

impl Unifier {
    fn new(positions: usize) -> Self {
        Self { first: vec![u32::MAX; positions], entries: Vec::new() }
    }

    /// The vertex of the triple, or `next` when it is new.
    fn vertex(&mut self, position: usize, key: [u32; 2], next: u32) -> u32 {
        let mut at = self.first[position];
        while let Some(&(other, vertex, after)) = self.entries.get(at as usize) {
            if other == key {
                return vertex;
            }
            at = after;
        }
        self.entries.push((key, next, self.first[position]));
        self.first[position] = self.entries.len() as u32 - 1;
        next
    }
}

/// Reads a material library: `newmtl`, `Kd`, `map_Kd`; the first material of a name counts.
fn parse_mtl(bytes: &[u8], path: &Path, limits: &Limits, materials: &mut Vec<Material>) {
    let folder = path.parent().unwrap_or(Path::new(""));
    let first = materials.len();
    statements(&text(bytes), |statement| {
        let statement = statement.trim();
        let (keyword, rest) =
            statement.split_once(char::is_whitespace).map_or((statement, ""), |(k, r)| (k, r.trim()));
        let inside = materials.len() > first;
        match keyword {
            "newmtl" if materials.len() < limits.materials => {
                materials.push(Material { name: rest.to_owned(), color: Vec3::ONE, ..Material::default() });
            }
            "Kd" if inside => {
                let [r, g, b] = numbers(rest);
                // one number stands for all three
                let color = if g.is_nan() && b.is_nan() { Vec3::splat(r) } else { Vec3::new(r, g, b) };
                if let (Some(material), true) = (materials.last_mut(), color.is_finite()) {
                    material.color = color.clamp(Vec3::ZERO, Vec3::ONE);
                }
            }
            "map_Kd" if inside => {
                let texture = texture(&folder.join(texture_name(rest).replace('\\', "/")), limits);
                if let Some(material) = materials.last_mut() {
                    material.texture = texture;
                }
            }
            _ => {}
        }
    });
}

/// The file name after `map_Kd`'s options; names may hold spaces.
fn texture_name(rest: &str) -> &str {
    let mut rest = rest;
    while let Some((option, after)) = rest.split_once(char::is_whitespace) {
        let values = match option {
            "-blendu" | "-blendv" | "-cc" | "-clamp" | "-boost" | "-texres" | "-bm" | "-imfchan"
            | "-type" => 1,
            "-mm" => 2,
            "-o" | "-s" | "-t" => 3,
            _ => break,
        };
        rest = after.trim_start();
        // offsets and scales may give fewer than three numbers
        for k in 0..values {
            let Some((word, after)) = rest.split_once(char::is_whitespace) else { break };
            if k > 0 && word.parse::<f32>().is_err() {
                break;
            }
            rest = after.trim_start();
        }
    }
    rest
}

/// A texture within limits; logs and gives `None` otherwise.
fn texture(path: &Path, limits: &Limits) -> Option<Arc<Rgb>> {
    let fits = match image::image_dimensions(path) {
        Ok((w, h)) => w.max(h) <= limits.texture_px,
        Err(_) => true, // read below says what is wrong
    };
    if !fits {
        log::warn!("{}: texture above {} px; drawing without it", path.display(), limits.texture_px);
        return None;
    }
    match picture::read(path) {
        Ok(texture) => Some(Arc::new(texture)),
        Err(error) => {
            log::warn!("{error}; drawing without this texture");
            None
        }
    }
}

#[cfg(test)]
mod tests;
