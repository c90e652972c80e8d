//! Wavefront OBJ with its MTL materials and textures (contracts: `draw`).
//!
//! A file is never refused for what its lines say: broken corners drop their face, broken positions drop
//! their triangles, everything unknown is skipped. It is refused only for being beyond `Limits`.
//! Missing material libraries and textures are logged and done without. Smoothing groups are not read: contracts
//! give a corner without a usable `vn` the area-weighted normal of its position, whatever group it is in.

use super::load::Refusal;
use super::mesh::{Material, Mesh, area_weighted_normals, unit};
use super::texture::Textures;
use super::{Limits, mtl};
use glam::{Vec2, Vec3};
use std::collections::HashMap;

/// The file's text: UTF-16 with a byte order mark (or the zeros of ASCII in UTF-16) is decoded, a UTF-8 mark
/// dropped, bytes that are not UTF-8 replaced.
pub(super) fn text(bytes: &[u8]) -> String {
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
pub(super) fn statements(text: &str, mut statement: impl FnMut(&str)) {
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
    /// As many as positions once there is any; white where a position has none.
    colors: Vec<Vec3>,
    texcoords: Vec<Vec2>,
    normals: Vec<Vec3>,
    corners: Vec<Corner>,
    /// Corner count and material of each face.
    faces: Vec<(u32, u16)>,
    triangles: usize,
    materials: Vec<Material>,
}

/// Reads a file; refuses only what is beyond `limits`.
pub(super) fn parse(bytes: &[u8], limits: &Limits, textures: &mut Textures) -> Result<Mesh, Refusal> {
    let mut lines = Lines::default();
    let mut libraries = 0;
    let mut wanted = HashMap::new(); // usemtl names and their numbers: libraries may come later
    let mut current = u16::MAX;
    let mut over = None;
    let check = |count: usize, limit: usize, what: &'static str, over: &mut Option<Refusal>| {
        if let Err(refusal) = Refusal::above(count, limit, what) {
            *over = Some(refusal);
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
                lines.vertex(rest);
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
                mtl::load(rest, limits, textures, &mut lines.materials);
            }
            _ => {}
        }
    });
    match over {
        Some(refusal) => Err(refusal),
        None => lines.into_mesh(limits, &wanted),
    }
}

/// The first `N` numbers; what is missing or no number becomes NaN, and so drops what uses it.
pub(super) fn numbers<const N: usize>(rest: &str) -> [f32; N] {
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
    /// Reads `x y z`, `x y z w`, `x y z r g b` or `x y z w r g b`.
    fn vertex(&mut self, rest: &str) {
        let [x, y, z, a, b, c, d] = numbers(rest);
        self.positions.push(Vec3::new(x, y, z));
        let color = if d.is_nan() { Vec3::new(a, b, c) } else { Vec3::new(b, c, d) };
        if color.is_finite() {
            self.colors.resize(self.positions.len() - 1, Vec3::ONE);
            self.colors.push(color.clamp(Vec3::ZERO, Vec3::ONE));
        }
    }

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

    fn into_mesh(mut self, limits: &Limits, wanted: &HashMap<String, u16>) -> Result<Mesh, Refusal> {
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
                    if !self.colors.is_empty() {
                        mesh.colors.push(self.colors.get(position).copied().unwrap_or(Vec3::ONE));
                    }
                }
            }
            mesh.triangles.push(triangle);
        }
        if mesh.positions.len() > limits.vertices {
            return Err(Refusal::TooMuch("vertices", limits.vertices as u64));
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

#[cfg(test)]
mod tests;
