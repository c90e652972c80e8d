//! PLY: ASCII and binary of both byte orders.
//!
//! Read are `vertex` with x y z, nx ny nz, red green blue (integers by their full range, floats as they are) and
//! u v (also s t, texture_u texture_v); `face` with a list of corners; `tristrips`; and the texture that MeshLab
//! names in a `TextureFile` comment. Other elements and properties are skipped.
//!
//! An own parser: `ply-rs-bw` goes through as many items as the header claims even where an item takes no bytes,
//! and finds every property by its name for every vertex.

use super::Limits;
use super::load::{Refusal, finish};
use super::mesh::{Material, Mesh};
use super::texture::Textures;
use glam::{Vec2, Vec3};
use std::str::SplitAsciiWhitespace;

/// Reads a file; refuses what is beyond `limits`, cut short or no PLY.
pub(super) fn parse(bytes: &[u8], limits: &Limits, textures: &mut Textures) -> Result<Mesh, Refusal> {
    let (header, body) = Header::read(bytes, limits)?;
    let mut numbers = match header.encoding {
        Encoding::Ascii => {
            Numbers::Ascii(std::str::from_utf8(body).map_err(broken)?.split_ascii_whitespace())
        }
        Encoding::Little => Numbers::Binary { bytes: body, big: false },
        Encoding::Big => Numbers::Binary { bytes: body, big: true },
    };
    let mut mesh = Mesh::default();
    for element in &header.elements {
        element.read(&mut numbers, &mut mesh, limits)?;
    }
    finish(&mut mesh);
    if let Some(texture) = header.texture.filter(|_| !mesh.texcoords.is_empty()) {
        let texture = textures.file(&texture);
        mesh.materials = vec![Material { texture, ..Material::plain(Vec3::ONE) }];
        mesh.material_of = vec![0; mesh.triangles.len()];
    }
    Ok(mesh)
}

fn broken(reason: impl std::fmt::Display) -> Refusal {
    Refusal::Broken(reason.to_string())
}

#[derive(Clone, Copy, PartialEq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

/// Type of a number in the file.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Kind {
    fn named(name: &str) -> Result<Kind, Refusal> {
        Ok(match name {
            "char" | "int8" => Kind::I8,
            "uchar" | "uint8" => Kind::U8,
            "short" | "int16" => Kind::I16,
            "ushort" | "uint16" => Kind::U16,
            "int" | "int32" => Kind::I32,
            "uint" | "uint32" => Kind::U32,
            "float" | "float32" => Kind::F32,
            "double" | "float64" => Kind::F64,
            _ => return Err(broken(format_args!("unknown type `{name}` in the header"))),
        })
    }

    /// What stands for 1 in a color.
    fn full(self) -> f64 {
        match self {
            Kind::I8 => 127.0,
            Kind::U8 => 255.0,
            Kind::I16 => 32767.0,
            Kind::U16 => 65535.0,
            Kind::I32 => f64::from(i32::MAX),
            Kind::U32 => f64::from(u32::MAX),
            Kind::F32 | Kind::F64 => 1.0,
        }
    }
}

struct Property {
    name: String,
    /// Type of the length, for a list.
    list: Option<Kind>,
    kind: Kind,
}

struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

struct Header {
    encoding: Encoding,
    elements: Vec<Element>,
    texture: Option<String>,
}

impl Header {
    /// The header and what follows it.
    fn read<'a>(bytes: &'a [u8], limits: &Limits) -> Result<(Header, &'a [u8]), Refusal> {
        let mut header = Header { encoding: Encoding::Ascii, elements: Vec::new(), texture: None };
        // lines end as the first one does: a binary body may begin with any byte
        let end = if bytes.starts_with(b"ply\r") && !bytes.starts_with(b"ply\r\n") { b'\r' } else { b'\n' };
        let (mut rest, mut entries, mut first, mut format) = (bytes, 0, true, false);
        loop {
            let Some(at) = rest.iter().position(|&b| b == end) else {
                return Err(broken("no `end_header` line; copy the file again"));
            };
            let line = String::from_utf8_lossy(&rest[..at]);
            rest = &rest[at + 1..];
            let mut words = line.split_ascii_whitespace();
            let mut word = || words.next().unwrap_or("");
            match word() {
                "ply" if first => {}
                _ if first => return Err(broken("its first line is not `ply`")),
                "format" => {
                    format = true;
                    header.encoding = match word() {
                        "ascii" => Encoding::Ascii,
                        "binary_little_endian" => Encoding::Little,
                        "binary_big_endian" => Encoding::Big,
                        other => return Err(broken(format_args!("unknown format `{other}`"))),
                    };
                }
                "element" => {
                    let (name, count) = (word().to_owned(), word());
                    let count = count.parse();
                    let count = count.map_err(|_| broken(format_args!("element `{name}` has no count")))?;
                    header.elements.push(Element { name, count, properties: Vec::new() });
                    entries += 1;
                }
                "property" => {
                    let (mut kind, mut list) = (word(), None);
                    if kind == "list" {
                        list = Some(Kind::named(word())?);
                        kind = word();
                    }
                    let property = Property { kind: Kind::named(kind)?, list, name: word().to_owned() };
                    let Some(element) = header.elements.last_mut() else {
                        return Err(broken("a property before any element"));
                    };
                    element.properties.push(property);
                    entries += 1;
                }
                "comment" if word() == "TextureFile" => {
                    let name = line.split_once("TextureFile").map_or("", |(_, name)| name.trim());
                    header.texture = Some(name.to_owned());
                }
                "end_header" if format => return Ok((header, rest)),
                "end_header" => return Err(broken("the header names no format")),
                _ => {}
            }
            Refusal::above(entries, limits.entries, "elements and properties")?;
            first = false;
        }
    }
}

/// The body, number by number.
enum Numbers<'a> {
    Ascii(SplitAsciiWhitespace<'a>),
    Binary { bytes: &'a [u8], big: bool },
}

impl Numbers<'_> {
    /// The next number; `None` at the end. What is no number is NaN.
    fn next(&mut self, kind: Kind) -> Option<f64> {
        match self {
            Numbers::Ascii(words) => words.next().map(|word| word.parse().unwrap_or(f64::NAN)),
            Numbers::Binary { bytes, big } => {
                let mut take = |count: usize| {
                    let (head, rest) = bytes.split_at_checked(count)?;
                    *bytes = rest;
                    let mut word = [0; 8];
                    word[..count].copy_from_slice(head);
                    if *big {
                        word[..count].reverse();
                    }
                    Some(u64::from_le_bytes(word))
                };
                Some(match kind {
                    Kind::I8 => f64::from(take(1)? as i8),
                    Kind::U8 => f64::from(take(1)? as u8),
                    Kind::I16 => f64::from(take(2)? as i16),
                    Kind::U16 => f64::from(take(2)? as u16),
                    Kind::I32 => f64::from(take(4)? as i32),
                    Kind::U32 => f64::from(take(4)? as u32),
                    Kind::F32 => f64::from(f32::from_bits(take(4)? as u32)),
                    Kind::F64 => f64::from_bits(take(8)?),
                })
            }
        }
    }
}

/// Which value of a vertex a property is.
const VALUES: [&[&str]; 11] = [
    &["x"],
    &["y"],
    &["z"],
    &["nx"],
    &["ny"],
    &["nz"],
    &["red", "r", "diffuse_red"],
    &["green", "g", "diffuse_green"],
    &["blue", "b", "diffuse_blue"],
    &["u", "s", "texture_u"],
    &["v", "t", "texture_v"],
];

impl Element {
    /// Reads all items. Each takes at least a byte of the file, or there are none to go through.
    fn read(&self, numbers: &mut Numbers, mesh: &mut Mesh, limits: &Limits) -> Result<(), Refusal> {
        let is_vertex = self.name == "vertex" && mesh.positions.is_empty();
        let corners =
            |p: &Property| p.list.is_some() && matches!(&*p.name, "vertex_indices" | "vertex_index");
        let strips = self.name == "tristrips";
        let faces =
            if self.name == "face" || strips { self.properties.iter().position(corners) } else { None };
        if is_vertex {
            let count = usize::try_from(self.count).unwrap_or(usize::MAX);
            Refusal::above(count, limits.vertices, "vertices")?;
        }
        // for every property the value it is, if any, and the factor it has
        let value = |p: &Property| VALUES.iter().position(|names| names.contains(&p.name.as_str()));
        let scalar = |p: &Property| if p.list.is_none() { value(p) } else { None };
        let values: Vec<Option<usize>> = self.properties.iter().map(scalar).collect();
        let factor = |p: &Property| if matches!(value(p), Some(6..=8)) { 1.0 / p.kind.full() } else { 1.0 };
        let factors: Vec<f64> = self.properties.iter().map(factor).collect();
        let has = |wanted: std::ops::Range<usize>| wanted.clone().all(|v| values.contains(&Some(v)));
        let (normals, colors, texcoords) = (has(3..6), has(6..9), has(9..11));
        if is_vertex && !has(0..3) {
            return Err(broken("its vertices have no x, y and z"));
        }

        let mut list = Vec::new();
        for item in 0..if self.properties.is_empty() { 0 } else { self.count } {
            let short = || {
                let (name, count) = (&self.name, self.count);
                broken(format_args!("the data ends in `{name}` {item} of {count}; copy the file again"))
            };
            let mut vertex = [f64::NAN; 11];
            for (k, property) in self.properties.iter().enumerate() {
                let Some(length) = property.list else {
                    let number = numbers.next(property.kind).ok_or_else(short)?;
                    if let Some(value) = values[k] {
                        vertex[value] = number * factors[k];
                    }
                    continue;
                };
                let length = numbers.next(length).ok_or_else(short)?;
                if !(0.0..=f64::from(u32::MAX)).contains(&length) {
                    return Err(broken(format_args!(
                        "`{}` {item} has a list of {length} numbers",
                        self.name
                    )));
                }
                list.clear();
                for _ in 0..length as u64 {
                    let number = numbers.next(property.kind).ok_or_else(short)?;
                    if faces == Some(k) {
                        // what is no index names no vertex
                        let index = (0.0..f64::from(u32::MAX)).contains(&number);
                        list.push(if index { number as u32 } else { u32::MAX });
                    }
                }
                if faces == Some(k) {
                    fan(&list, strips, &mut mesh.triangles);
                    Refusal::above(mesh.triangles.len(), limits.triangles, "triangles")?;
                }
            }
            if is_vertex {
                let [x, y, z, nx, ny, nz, r, g, b, u, v] = vertex.map(|value| value as f32);
                mesh.positions.push(Vec3::new(x, y, z));
                if normals {
                    mesh.normals.push(Vec3::new(nx, ny, nz));
                }
                if colors {
                    let color = Vec3::new(r, g, b);
                    let color = if color.is_nan() { Vec3::ONE } else { color };
                    mesh.colors.push(color.clamp(Vec3::ZERO, Vec3::ONE));
                }
                if texcoords {
                    let uv = Vec2::new(u, v);
                    mesh.texcoords.push(if uv.is_finite() { uv } else { Vec2::ZERO });
                }
            }
        }
        Ok(())
    }
}

/// The triangles of a polygon, from its first corner, or of strips that indices without a vertex divide.
fn fan(corners: &[u32], strips: bool, triangles: &mut Vec<[u32; 3]>) {
    if strips {
        for strip in corners.split(|&i| i == u32::MAX) {
            let turn =
                |(k, w): (usize, &[u32])| if k % 2 == 0 { [w[0], w[1], w[2]] } else { [w[1], w[0], w[2]] };
            triangles.extend(strip.windows(3).enumerate().map(turn));
        }
    } else if let [first, rest @ ..] = corners {
        triangles.extend(rest.windows(2).map(|pair| [*first, pair[0], pair[1]]));
    }
}
