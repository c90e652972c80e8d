//! The cells as polygons, for plotters, cutters and vector programs: the dual of the sites' Delaunay triangulation.

use crate::pixels::{Plane, Size};
use spade::{DelaunayTriangulation, HasPosition, Point2, Triangulation};
use std::collections::HashMap;
use std::fmt::Write;

/// A site as the triangulation keeps it: px in the continuous frame `[0,W]x[0,H]`.
pub(super) struct Site {
    at: Point2<f64>,
    /// Its index; of several sites in one place the first.
    pub index: usize,
}

impl HasPosition for Site {
    type Scalar = f64;

    fn position(&self) -> Point2<f64> {
        self.at
    }
}

/// The Delaunay triangulation of sites in steps of 1/16 px; of sites in one place it holds the first.
pub(super) fn delaunay(sites: &[[i32; 2]]) -> DelaunayTriangulation<Site> {
    let mut first_at = HashMap::new();
    let mut mesh = DelaunayTriangulation::new();
    for (index, &site) in sites.iter().enumerate() {
        first_at.entry(site).or_insert_with(|| {
            let at = Point2::new(f64::from(site[0]) / 16.0, f64::from(site[1]) / 16.0);
            // refuses only coordinates that are not finite or beyond 1e60
            let _ = mesh.insert(Site { at, index });
        });
    }
    mesh
}

/// The corners of every cell in px of the continuous frame, in order around it, one list a site: what of the frame is
/// nearer to the site than to its Delaunay neighbors. Empty where a site has no part of the frame, or shares its
/// place with an earlier one.
pub fn polygons(sites: &[[i32; 2]], size: Size) -> Vec<Vec<[f64; 2]>> {
    let (w, h) = (size.width as f64, size.height as f64);
    let mut cells = vec![Vec::new(); sites.len()];
    for vertex in delaunay(sites).vertices() {
        let site = vertex.position();
        let mut cell = vec![[0.0, 0.0], [w, 0.0], [w, h], [0.0, h]];
        for neighbor in vertex.out_edges().map(|edge| edge.to().position()) {
            let (nx, ny) = (neighbor.x - site.x, neighbor.y - site.y);
            let middle = nx * (neighbor.x + site.x) / 2.0 + ny * (neighbor.y + site.y) / 2.0;
            cell = clipped(&cell, |[x, y]| nx * x + ny * y - middle);
        }
        cells[vertex.data().index] = cell;
    }
    cells
}

/// The part of a convex polygon where `beyond` ≤ 0 (Sutherland & Hodgman 1974).
fn clipped(polygon: &[[f64; 2]], beyond: impl Fn([f64; 2]) -> f64) -> Vec<[f64; 2]> {
    let mut kept = Vec::with_capacity(polygon.len() + 1);
    for (i, &to) in polygon.iter().enumerate() {
        let from = polygon[(i + polygon.len() - 1) % polygon.len()];
        let (a, b) = (beyond(from), beyond(to));
        if (a > 0.0) != (b > 0.0) {
            let t = a / (a - b);
            kept.push([from[0] + (to[0] - from[0]) * t, from[1] + (to[1] - from[1]) * t]);
        }
        if b <= 0.0 {
            kept.push(to);
        }
    }
    kept
}

/// The cells as an SVG drawing in px, each filled with its mean color (a row of `means`: R, G, B in 0..1).
pub fn svg(cells: &[Vec<[f64; 2]>], means: &Plane<f32>, size: Size) -> String {
    let Size { width, height } = size;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\">\n"
    );
    for (index, cell) in cells.iter().enumerate().filter(|(_, cell)| cell.len() > 2) {
        let [r, g, b] = [0, 1, 2].map(|c| (means.at(c, index) * 255.0 + 0.5) as u8);
        let _ = write!(out, "<polygon fill=\"#{r:02x}{g:02x}{b:02x}\" points=\""); // a String takes everything
        for [x, y] in cell {
            let _ = write!(out, "{x:.3},{y:.3} ");
        }
        out.push_str("\"/>\n");
    }
    out.push_str("</svg>\n");
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::style::watercolor::{initial, reference::labels};

    #[test]
    fn cells_tile_the_frame_and_hold_their_pixels() {
        let size = Size::new(61, 47);
        let mut sites = initial(size, 8, 3);
        sites.push(sites[5]);
        sites.push([-400, 9000]);
        let cells = polygons(&sites, size);
        let area = |cell: &[[f64; 2]]| -> f64 {
            let next = |i: usize| cell[(i + 1) % cell.len()];
            (0..cell.len()).map(|i| cell[i][0] * next(i)[1] - next(i)[0] * cell[i][1]).sum::<f64>() / 2.0
        };
        let total: f64 = cells.iter().map(|cell| area(cell)).sum();
        assert!((total - size.area() as f64).abs() < 1e-6, "{total}");
        assert!(cells[sites.len() - 2].is_empty(), "a second site in one place has no cell");
        for (i, label) in labels(&sites, size.width, size.height).into_iter().enumerate() {
            let at = [(i % size.width) as f64 + 0.5, (i / size.width) as f64 + 0.5];
            let cell = &cells[label];
            for (k, &a) in cell.iter().enumerate() {
                let b = cell[(k + 1) % cell.len()];
                let side = (b[0] - a[0]) * (at[1] - a[1]) - (b[1] - a[1]) * (at[0] - a[0]);
                assert!(side >= -1e-9, "pixel {i} lies in the cell of its site");
            }
        }
        let drawing = svg(&cells, &Plane::new(Size::new(3, sites.len()), 0.5), size);
        assert_eq!(drawing.matches("<polygon").count(), cells.iter().filter(|c| c.len() > 2).count());
    }
}
