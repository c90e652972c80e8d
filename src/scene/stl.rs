//! STL: binary and ASCII, its corners welded by position. The facets' own normals are not read: they follow from the
//! corners.
//!
//! An own parser: `stl_io` takes a binary file whose first bytes say `solid` for ASCII, and an ASCII file whose solid
//! has no name for binary; both are common.

use super::Limits;
use super::load::{Refusal, finish};
use super::mesh::Mesh;
use glam::Vec3;
use std::collections::HashMap;

/// Bytes before the first triangle of a binary file: 80 of anything, and the count.
const HEADER: usize = 84;
/// Bytes of a triangle: normal, three corners, two of anything.
const FACET: usize = 50;

/// Reads a file; refuses what is beyond `limits`, cut short or no STL.
pub(super) fn parse(bytes: &[u8], limits: &Limits) -> Result<Mesh, Refusal> {
    let claimed = bytes.get(80..HEADER).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    let exact =
        claimed.is_some_and(|count| bytes.len() as u64 == HEADER as u64 + FACET as u64 * count as u64);
    let mut weld = Weld { mesh: Mesh::default(), known: HashMap::new(), limits };
    if !exact && bytes.trim_ascii_start().get(..5).is_some_and(|s| s.eq_ignore_ascii_case(b"solid")) {
        ascii(&String::from_utf8_lossy(bytes), &mut weld)?;
    } else {
        let body = bytes.get(HEADER..).unwrap_or_default();
        let whole = body.len() / FACET;
        let short = match claimed {
            None => Some("no whole header".into()),
            Some(count) if count > whole => Some(format!("{whole} of {count} triangles are there")),
            Some(_) => None,
        };
        if let Some(reason) = short {
            return Err(Refusal::Broken(format!("{reason}; copy the file again")));
        }
        for facet in body.chunks_exact(FACET).take(claimed.unwrap_or(0)) {
            let float =
                |at: usize| f32::from_le_bytes([facet[at], facet[at + 1], facet[at + 2], facet[at + 3]]);
            weld.triangle([12, 24, 36].map(|at| Vec3::new(float(at), float(at + 4), float(at + 8))))?;
        }
    }
    finish(&mut weld.mesh);
    Ok(weld.mesh)
}

/// Reads the loops of `vertex` lines; what is no number drops its triangle.
fn ascii(text: &str, weld: &mut Weld) -> Result<(), Refusal> {
    let (mut corners, mut open) = (Vec::new(), true);
    for line in text.lines() {
        let mut words = line.split_ascii_whitespace();
        let Some(word) = words.next() else { continue };
        match word.to_ascii_lowercase().as_str() {
            "solid" => open = true,
            "endsolid" => open = false,
            "outer" => corners.clear(),
            "vertex" => {
                let mut number = || words.next().and_then(|w| w.parse().ok()).unwrap_or(f32::NAN);
                corners.push(Vec3::new(number(), number(), number()));
            }
            "endloop" => {
                for k in 2..corners.len() {
                    weld.triangle([corners[0], corners[k - 1], corners[k]])?;
                }
                corners.clear();
            }
            _ => {}
        }
    }
    if open { Err(Refusal::Broken("no `endsolid` line; copy the file again".into())) } else { Ok(()) }
}

/// A mesh whose corners at one place are one vertex.
struct Weld<'a> {
    mesh: Mesh,
    known: HashMap<[u32; 3], u32>,
    limits: &'a Limits,
}

impl Weld<'_> {
    fn triangle(&mut self, corners: [Vec3; 3]) -> Result<(), Refusal> {
        let positions = &mut self.mesh.positions;
        let triangle = corners.map(|corner| {
            // + 0: both zeros are one place
            let place = corner.to_array().map(|v| (v + 0.0).to_bits());
            *self.known.entry(place).or_insert_with(|| {
                positions.push(corner);
                positions.len() as u32 - 1
            })
        });
        self.mesh.triangles.push(triangle);
        Refusal::above(self.mesh.positions.len(), self.limits.vertices, "vertices")?;
        Refusal::above(self.mesh.triangles.len(), self.limits.triangles, "triangles")
    }
}
