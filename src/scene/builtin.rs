//! The models inside the program: the Newell teapot and Keenan Crane's Spot (see `models/README.md`).

use super::mesh::{Mesh, area_weighted_normals};
use glam::{Vec2, Vec3};

/// Names of the built-in models.
pub const BUILTIN: [&str; 2] = ["teapot", "spot"];

/// A built-in model by name: as loading its OBJ would give it, without material.
pub fn builtin(name: &str) -> Option<Mesh> {
    let bytes: &[u8] = match name {
        "teapot" => include_bytes!("models/teapot.bin"),
        "spot" => include_bytes!("models/spot.bin"),
        _ => return None,
    };
    unpack(bytes)
}

/// The packed form: counts of positions, texture coordinates and triangles (u32), then positions (3 f32),
/// texture coordinates (2 f32), per triangle three position indices and, where there are texture
/// coordinates, three of their indices (u16). Little-endian throughout.
fn unpack(bytes: &[u8]) -> Option<Mesh> {
    let mut rest = bytes;
    let mut take = |n: usize| {
        let (head, tail) = rest.split_at_checked(n)?;
        rest = tail;
        Some(head)
    };
    let word = |b: &[u8]| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize;
    let float = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
    let index = |b: &[u8]| u32::from(u16::from_le_bytes([b[0], b[1]]));
    let header = take(12)?;
    let [positions, texcoords, triangles] = [0, 4, 8].map(|at| word(&header[at..at + 4]));
    let floats = |bytes: &[u8]| bytes.chunks_exact(4).map(float).collect::<Vec<f32>>();
    let points = floats(take(positions * 12)?);
    let points: Vec<Vec3> = points.chunks_exact(3).map(Vec3::from_slice).collect();
    let uvs = floats(take(texcoords * 8)?);
    let uvs: Vec<Vec2> = uvs.chunks_exact(2).map(Vec2::from_slice).collect();
    let each = if texcoords == 0 { 3 } else { 6 };
    let indices: Vec<u32> = take(triangles * each * 2)?.chunks_exact(2).map(index).collect();

    let by_position: Vec<[u32; 3]> = indices.chunks_exact(each).map(|t| [t[0], t[1], t[2]]).collect();
    let normals = area_weighted_normals(&points, &by_position);
    let mut mesh = Mesh::default();
    let mut seen = std::collections::HashMap::new();
    for corners in indices.chunks_exact(each) {
        mesh.triangles.push([0, 1, 2].map(|k| {
            let (position, uv) = (corners[k], corners.get(3 + k).copied());
            *seen.entry((position, uv)).or_insert_with(|| {
                mesh.positions.push(points[position as usize]);
                mesh.normals.push(normals[position as usize]);
                mesh.texcoords.extend(uv.and_then(|uv| uvs.get(uv as usize)));
                mesh.positions.len() as u32 - 1
            })
        }));
    }
    Some(mesh)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_builtin_model_unpacks() {
        for name in BUILTIN {
            let mesh = builtin(name).expect("built in");
            assert!(mesh.triangles.len() > 5000 && mesh.positions.len() > 2900, "{name}");
            assert!(mesh.triangles.iter().flatten().all(|&i| (i as usize) < mesh.positions.len()));
            assert!(mesh.texcoords.is_empty() || mesh.texcoords.len() == mesh.positions.len());
        }
        assert!(builtin("nothing").is_none());
    }

    #[test]
    fn a_short_file_is_refused() {
        assert!(unpack(&[1, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0]).is_none());
    }
}
