//! Which triangles share which edges, by position: what silhouettes are found from.
//!
//! Vertices at the same place are one here, however many normals and texture coordinates they carry. A part of a
//! mesh is *closed* when every edge has exactly two triangles, wound as one surface that faces outwards: there
//! only edges between a front and a back can be seen as outline, since all other backs are hidden.

use super::Mesh;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::sync::OnceLock;

/// An edge and the triangles on its two sides; the same triangle twice where there is only one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// Indices of its two vertices.
    pub vertices: [u32; 2],
    /// Indices of its two triangles.
    pub triangles: [u32; 2],
}

/// The edges of a mesh. Triangles without three different, existing places have none.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Edges {
    /// Edges of closed parts, two triangles each.
    pub closed: Vec<Edge>,
    /// Edges of all other parts; one that more than two triangles share comes once for each.
    pub open: Vec<Edge>,
}

/// The edges of one mesh, kept once found. Equal to every other: they follow from the mesh.
#[derive(Clone, Debug, Default)]
pub struct KeptEdges(OnceLock<Edges>);

impl PartialEq for KeptEdges {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl KeptEdges {
    /// The edges of `mesh`, which must be the same at every call.
    pub(super) fn of(&self, mesh: &Mesh) -> &Edges {
        self.0.get_or_init(|| Edges::new(&mesh.positions, &mesh.triangles))
    }
}

/// One side of an edge: lower and higher vertex, the triangle, whether it runs from low to high.
type Side = (u32, u32, u32, bool);

impl Edges {
    /// Finds the edges; n log n in the number of triangles.
    pub fn new(positions: &[Vec3], triangles: &[[u32; 3]]) -> Self {
        let place = places(positions);
        let whole = |t: &[u32; 3]| -> Option<[u32; 3]> {
            let [a, b, c] = t.map(|i| place.get(i as usize).copied());
            let (a, b, c) = (a?, b?, c?);
            (a != b && b != c && c != a).then_some([a, b, c])
        };
        let mut parts = Parts::new(positions.len());
        let mut sides: Vec<Side> = Vec::with_capacity(3 * triangles.len());
        for (t, triangle) in triangles.iter().enumerate() {
            let Some([a, b, c]) = whole(triangle) else { continue };
            parts.join(a, b);
            parts.join(b, c);
            for (from, to) in [(a, b), (b, c), (c, a)] {
                sides.push((from.min(to), from.max(to), t as u32, from < to));
            }
        }
        sides.par_sort_unstable();

        let shared = |a: &Side, b: &Side| (a.0, a.1) == (b.0, b.1);
        let mut open = vec![false; positions.len()];
        for edge in sides.chunk_by(shared) {
            let two = edge.len() == 2 && edge[0].3 != edge[1].3;
            open[parts.of(edge[0].0) as usize] |= !two;
        }
        let mut volume = vec![0.0; positions.len()];
        for [a, b, c] in triangles.iter().filter_map(whole) {
            let at = |i: u32| positions[i as usize].as_dvec3();
            volume[parts.of(a) as usize] += DVec3::dot(at(a), at(b).cross(at(c)));
        }
        let mut edges = Edges::default();
        for edge in sides.chunk_by(shared) {
            let part = parts.of(edge[0].0) as usize;
            let of = |triangles| Edge { vertices: [edge[0].0, edge[0].1], triangles };
            match edge {
                [a, b] if !open[part] && volume[part] > 0.0 => edges.closed.push(of([a.2, b.2])),
                [a, b] => edges.open.push(of([a.2, b.2])),
                more => edges.open.extend(more.iter().map(|side| of([side.2, side.2]))),
            }
        }
        edges
    }
}

/// For every vertex the lowest one at the same place.
fn places(positions: &[Vec3]) -> Vec<u32> {
    // + 0: both zeros are one place
    let bits = |i: u32| positions[i as usize].to_array().map(|v| (v + 0.0).to_bits());
    let mut order: Vec<u32> = (0..positions.len() as u32).collect();
    order.par_sort_unstable_by_key(|&i| (bits(i), i));
    let mut place = vec![0; positions.len()];
    for same in order.chunk_by(|&a, &b| bits(a) == bits(b)) {
        same.iter().for_each(|&i| place[i as usize] = same[0]);
    }
    place
}

/// Which vertices hang together.
struct Parts(Vec<u32>);

impl Parts {
    fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    fn of(&mut self, mut vertex: u32) -> u32 {
        while self.0[vertex as usize] != vertex {
            let above = self.0[vertex as usize];
            self.0[vertex as usize] = self.0[above as usize];
            vertex = above;
        }
        vertex
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.of(a), self.of(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::builtin;

    /// A tetrahedron whose corners are not shared between its faces, wound outwards.
    fn tetrahedron() -> (Vec<Vec3>, Vec<[u32; 3]>) {
        let [o, x, y, z] = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z];
        let positions = vec![o, y, x, o, x, z, o, z, y, x, y, z];
        (positions, (0..4).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect())
    }

    #[test]
    fn corners_at_one_place_are_one() {
        let (positions, triangles) = tetrahedron();
        let edges = Edges::new(&positions, &triangles);
        assert_eq!((edges.closed.len(), edges.open.len()), (6, 0));
        assert!(edges.closed.iter().all(|e| e.triangles[0] != e.triangles[1]));
    }

    #[test]
    fn holes_and_inner_sides_are_open() {
        let (positions, mut triangles) = tetrahedron();
        let edges = Edges::new(&positions, &triangles[1..]);
        assert_eq!((edges.closed.len(), edges.open.len()), (0, 6), "one face is missing");
        assert_eq!(edges.open.iter().filter(|e| e.triangles[0] == e.triangles[1]).count(), 3);
        triangles.iter_mut().for_each(|t| t.swap(0, 1));
        assert_eq!(Edges::new(&positions, &triangles).open.len(), 6, "wound inwards");
        triangles.push([0, 0, 1]);
        triangles.push([0, 1, 99]);
        triangles.push(triangles[0]);
        assert_eq!(
            Edges::new(&positions, &triangles).open.len(),
            3 + 3 * 3,
            "three sides are shared by three"
        );
        assert_eq!(Edges::new(&[], &[[0, 1, 2]]), Edges::default());
    }

    #[test]
    fn spot_is_closed_and_the_teapot_is_not() {
        let spot = builtin("spot").expect("built in");
        assert_eq!((spot.edges().closed.len(), spot.edges().open.len()), (spot.triangles.len() * 3 / 2, 0));
        let teapot = builtin("teapot").expect("built in");
        assert!(teapot.edges().closed.is_empty() && teapot.edges().open.len() > 9000);
    }
}
