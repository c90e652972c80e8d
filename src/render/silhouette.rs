//! Thick outlines by the method of two passes (Fischer 2006, section 3.2.2, Algorithm 3, after Lander 2000): front
//! faces fill the depth (LESS), then the edges of back faces are drawn as thick lines where they are not behind it
//! (LEQUAL). What remains visible are the outlines, inner ones too, by the half that lies outside the surface in
//! front.
//!
//! On closed parts of a mesh only edges between a front and a back are drawn: the backs' other edges are hidden
//! but for what their thickness lets stick out beside an outline. On open parts all edges of backs are drawn.
//!
//! Lines are OpenGL's: one step along the longer axis (x where equal), `line_width` pixels across the other, depth
//! linear in 1/z along the line. Everything in f64, in bands of tile rows that nothing is shared between.

use super::tile::ROW_WORDS;
use super::vertex::{NO_SPOT, Vertex};
use super::{Instance, View, clip};
use crate::frame::Layer;
use crate::pixels::{Plane, PlaneMut, Size, TILE, TileGrid, TileSet};
use crate::scene::Mesh;
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// How far, relative to depth, a line may lie behind a surface and still count as on it: the surface is sampled at
/// pixel centers, the line on the surface's edge.
const TOLERANCE: f64 = 1e-3;

/// Lines that room is kept for from the start, at most.
const KEPT_LINES: usize = 1 << 16;

/// A point of a line: picture position in px and 1/z.
#[derive(Clone, Copy)]
struct End {
    x: f64,
    y: f64,
    w: f64,
}

/// The lines of one frame and what finding them takes.
#[derive(Default)]
pub(super) struct Silhouette {
    /// Whether each triangle of the instance at hand faces the camera.
    fronts: Vec<bool>,
    lines: Vec<[End; 2]>,
    /// Camera z of the nearest phantom, which hides lines as it hides surfaces; empty when there is none.
    shield: Plane<f32>,
    /// Per row of tiles: the tiles with line pixels.
    reached: Vec<[u64; ROW_WORDS]>,
}

impl Silhouette {
    /// Lists the lines of the placed models.
    pub fn find(&mut self, view: &View<'_>) {
        self.lines.clear();
        // of all models, in view or not: their edges are found and room is made before they come
        let count = |mesh: &Mesh| mesh.edges().closed.len() + mesh.edges().open.len();
        let known: usize = view.shot.scene.models.iter().map(|model| count(&model.mesh)).sum();
        let placed = view.instances.iter().map(|i| count(&view.shot.scene.models[i.placed.model].mesh));
        let triangles = view.shot.scene.models.iter().map(|model| model.mesh.triangles.len()).max();
        self.fronts.resize(triangles.unwrap_or(0), false);
        self.lines.reserve(known.max(placed.sum()).min(KEPT_LINES));
        let seen = |instance: &&Instance| !view.shot.scene.models[instance.placed.model].phantom;
        for instance in view.instances.iter().filter(seen) {
            let mesh = &view.shot.scene.models[instance.placed.model].mesh;
            let edges = mesh.edges();
            self.fronts[..mesh.triangles.len()].par_chunks_mut(1024).enumerate().for_each(
                |(chunk, fronts)| {
                    for (front, triangle) in fronts.iter_mut().zip(&mesh.triangles[1024 * chunk..]) {
                        *front = faces_camera(view, instance, *triangle);
                    }
                },
            );
            // a mirrored model shows its inside: nothing is known to be hidden
            let closed_counts = instance.placed.to_camera.matrix3.determinant() > 0.0;
            for edge in &edges.closed {
                let [a, b] = edge.triangles.map(|t| self.fronts[t as usize]);
                if a != b || !(closed_counts || a) {
                    self.add(view, instance, edge.vertices);
                }
            }
            for edge in &edges.open {
                let [a, b] = edge.triangles.map(|t| self.fronts[t as usize]);
                if !(a && b) {
                    self.add(view, instance, edge.vertices);
                }
            }
        }
    }

    /// No lines, no phantoms.
    pub fn clear(&mut self) {
        self.lines.clear();
        self.shield.resize(Size::new(0, 0), 0.0);
    }

    /// Where what phantoms hide is written, far away everywhere.
    pub fn shield(&mut self, size: Size) -> &mut Plane<f32> {
        self.shield.resize(size, f32::INFINITY);
        self.shield.fill(f32::INFINITY);
        &mut self.shield
    }

    /// Draws the listed lines over the layer's depth, after wiping what the tiles of `previous` held; adds the tiles
    /// that lines reach to the touched ones.
    pub fn draw(&mut self, layer: &mut Layer, grid: TileGrid, previous: &TileSet, line_width: f64, far: f64) {
        self.reached.clear();
        self.reached.resize(grid.rows(), [0; ROW_WORDS]);
        if self.lines.is_empty() && previous.is_empty() {
            return;
        }
        let Layer { silhouette, depth, touched, .. } = layer;
        let (lines, depth, shield) = (&self.lines, &*depth, &self.shield);
        let bands = silhouette.view_mut().par_bands(TILE).zip(&mut self.reached).with_max_len(1);
        bands.for_each(|((first, mut out), reached)| {
            let row = first / TILE * grid.columns();
            for tile in (row..row + grid.columns()).filter(|&tile| previous.contains(tile)) {
                let area = grid.rect(tile);
                (0..out.size().height).for_each(|y| out.row_mut(y)[area.x0..area.x1].fill(0));
            }
            let last = (first + out.size().height) as f64;
            let reach = line_width;
            let mut band = Band { first, out: out.reborrow(), reached, depth, shield, least: 1.0 / far };
            for [a, b] in lines {
                if a.y.max(b.y) + reach >= first as f64 && a.y.min(b.y) - reach <= last {
                    band.line(*a, *b, line_width / 2.0);
                }
            }
        });
        for (row, words) in self.reached.iter().enumerate() {
            for column in (0..grid.columns()).filter(|c| words[c / 64] >> (c % 64) & 1 == 1) {
                touched.insert(row * grid.columns() + column);
            }
        }
    }

    /// Lists an edge, cut and split where it must be.
    fn add(&mut self, view: &View<'_>, instance: &Instance, edge: [u32; 2]) {
        let [a, b] = edge.map(|i| &view.vertices.places[instance.first_vertex + i as usize]);
        let whole = a.w() > 0.0 && b.w() > 0.0;
        if whole && !(view.shot.field.bends() && clip::may_bend(a, b, view.shot.field)) {
            self.lines.push([a, b].map(End::of));
        } else if a.w() >= 0.0 && b.w() >= 0.0 {
            let mesh = &view.shot.scene.models[instance.placed.model].mesh;
            let [a, b] = edge
                .map(|i| instance.placed.to_camera.transform_point3(mesh.positions[i as usize].as_dvec3()));
            clip::cut_line([a, b], view.shot.camera.near, view.shot.field, &mut |a, b| {
                self.lines.push([a, b].map(End::of));
            });
        }
    }
}

impl End {
    fn of(vertex: &Vertex) -> Self {
        End { x: vertex.at[0], y: vertex.at[1], w: vertex.w() }
    }
}

/// Whether a triangle is seen counter-clockwise: decided as coverage is, and before the lens where the triangle must
/// be cut. One without area shows its back.
fn faces_camera(view: &View<'_>, instance: &Instance, triangle: [u32; 3]) -> bool {
    let spots = triangle.map(|i| view.vertices.spots[instance.first_vertex..].get(i as usize));
    let [Some(&a), Some(&b), Some(&c)] = spots else { return false };
    if a != NO_SPOT && b != NO_SPOT && c != NO_SPOT {
        let [[x0, y0], [x1, y1], [x2, y2]] = [a, b, c].map(|spot| spot.map(i64::from));
        return (x1 - x0) * (y2 - y0) < (x2 - x0) * (y1 - y0);
    }
    let mesh = &view.shot.scene.models[instance.placed.model].mesh;
    let [a, b, c] = triangle.map(|i| {
        let position = mesh.positions.get(i as usize).copied().unwrap_or_default();
        instance.placed.to_camera.transform_point3(position.as_dvec3())
    });
    DVec3::dot(a, b.cross(c)) < 0.0
}

/// A row of tiles while lines are drawn over it.
struct Band<'a> {
    first: usize,
    out: PlaneMut<'a, u8>,
    reached: &'a mut [u64; ROW_WORDS],
    depth: &'a Plane<f32>,
    shield: &'a Plane<f32>,
    /// 1/z at the far plane.
    least: f64,
}

impl Band<'_> {
    fn line(&mut self, a: End, b: End, half: f64) {
        let size = self.out.size();
        let step = DVec2::new(b.x - a.x, b.y - a.y);
        let along_x = step.x.abs() >= step.y.abs();
        let backwards = if along_x { step.x < 0.0 } else { step.y < 0.0 };
        let (a, b) = if backwards { (b, a) } else { (a, b) };
        let (top, rows) = (self.first as f64, size.height as f64);
        if along_x {
            let length = b.x - a.x;
            let (slope, dw) = ((b.y - a.y) / length, (b.w - a.w) / length);
            for x in span(a.x, b.x, size.width as f64) {
                let along = x as f64 - a.x;
                let (y, w) = (a.y + slope * along - top, a.w + dw * along);
                for y in span(y - half, y + half, rows) {
                    self.mark(x, y, w);
                }
            }
        } else {
            let length = b.y - a.y;
            let (slope, dw) = ((b.x - a.x) / length, (b.w - a.w) / length);
            for y in span(a.y - top, b.y - top, rows) {
                let along = y as f64 + top - a.y;
                let (x, w) = (a.x + slope * along, a.w + dw * along);
                for x in span(x - half, x + half, size.width as f64) {
                    self.mark(x, y, w);
                }
            }
        }
    }

    /// Blackens a pixel of the band where the line is in view.
    #[inline(always)]
    fn mark(&mut self, x: usize, y: usize, w: f64) {
        let mut z = self.depth.at(x, self.first + y);
        if self.shield.size().area() > 0 {
            z = z.min(self.shield.at(x, self.first + y));
        }
        let z = f64::from(z);
        if w >= self.least && w * (1.0 + TOLERANCE) * z >= 1.0 {
            self.out.row_mut(y)[x] = 255;
            self.reached[x / TILE / 64] |= 1 << (x / TILE % 64);
        }
    }
}

/// The whole numbers from `low` up to but not including `high`, of those in 0..count.
#[inline(always)]
fn span(low: f64, high: f64, count: f64) -> std::ops::Range<usize> {
    low.ceil().clamp(0.0, count) as usize..high.ceil().clamp(0.0, count) as usize
}
