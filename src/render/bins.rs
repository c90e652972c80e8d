//! A chunk of consecutive triangles: those that can cover a pixel center become records, listed per tile in
//! submission order. Each chunk is filled by one task and read by all tiles, so nothing is locked.

use super::clip::{self, Corner};
use super::vertex::{Vertex, normal_matrix, unit};
use super::{Instance, View};
use crate::frame::Needs;
use crate::pixels::{TILE, TileGrid};
use crate::scene::{Model, Shading};
use glam::{DVec2, DVec3};
use std::ops::Range;

/// Marks a corner as one of the chunk's own vertices (from cutting), not one of the frame's.
pub(super) const OWN: u32 = 1 << 31;
const NONE: u32 = u32::MAX;
/// Triangles over more tiles than this in a direction are not listed per tile but checked by every tile.
const MAX_LISTED: usize = 2;

/// A triangle that may cover pixel centers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Record {
    /// Indices of its corners: frame vertices, or the chunk's own where `OWN` is set. Wound so that the
    /// snapped area is positive with y down.
    pub corners: [u32; 3],
    /// Index into the frame's surfaces.
    pub surface: u32,
    /// Intensity of the face normal.
    pub face: f32,
    /// The instance it belongs to.
    pub instance: u32,
    /// The three mesh vertices, for texture coordinates; meaningless for own corners.
    pub first_vertex: u32,
    /// Pixels whose centers it may cover: x0, y0, x1, y1, all inclusive.
    pub bounds: [i16; 4],
}

/// A vertex made by cutting.
#[derive(Clone, Copy, Debug)]
pub(super) struct OwnVertex {
    pub vertex: Vertex,
    pub uv: [f32; 2],
}

#[derive(Clone, Copy)]
struct Link {
    record: u32,
    next: u32,
}

/// Consecutive triangles of one instance and what is left of them.
#[derive(Default)]
pub(super) struct Chunk {
    instance: usize,
    triangles: Range<usize>,
    columns: usize,
    pub records: Vec<Record>,
    pub own: Vec<OwnVertex>,
    heads: Vec<u32>,
    tails: Vec<u32>,
    links: Vec<Link>,
    wide: Vec<u32>,
    /// Tiles under all wide triangles together: column and row ranges, inclusive.
    wide_tiles: Option<[usize; 4]>,
}

impl Chunk {
    /// Empties the chunk for these triangles; `length` is the most it may be given this frame.
    pub fn begin(&mut self, instance: usize, triangles: Range<usize>, length: usize, grid: TileGrid) {
        (self.instance, self.triangles, self.columns) = (instance, triangles, grid.columns());
        self.records.clear();
        self.records.reserve(length + length / 4);
        self.own.clear();
        self.own.reserve(256);
        self.links.clear();
        self.links.reserve(2 * length);
        self.wide.clear();
        self.wide.reserve(64);
        self.wide_tiles = None;
        self.heads.clear();
        self.heads.resize(grid.count(), NONE);
        self.tails.clear();
        self.tails.resize(grid.count(), NONE);
    }

    /// Whether any record may touch the tile.
    pub fn reaches(&self, tile: usize, column: usize, row: usize) -> bool {
        let wide = |[x0, y0, x1, y1]: [usize; 4]| (x0..=x1).contains(&column) && (y0..=y1).contains(&row);
        self.heads[tile] != NONE || self.wide_tiles.is_some_and(wide)
    }

    /// The records that may touch the tile, in submission order.
    pub fn records_of(&self, tile: usize) -> impl Iterator<Item = &Record> {
        let mut link = self.heads[tile];
        let mut wide = self.wide.iter().copied().peekable();
        std::iter::from_fn(move || {
            let listed = if link == NONE { NONE } else { self.links[link as usize].record };
            match wide.peek() {
                Some(&record) if record < listed => {
                    wide.next();
                    Some(&self.records[record as usize])
                }
                _ if listed == NONE => None,
                _ => {
                    link = self.links[link as usize].next;
                    Some(&self.records[listed as usize])
                }
            }
        })
    }

    /// Sorts the chunk's triangles into records and tiles.
    pub fn fill(&mut self, view: &View<'_>) {
        let instance = view.instances[self.instance];
        let model = &view.scene.models[instance.placed.model];
        let mesh = &model.mesh;
        let vertices = &view.vertices[instance.first_vertex..][..mesh.positions.len()];
        let normals = normal_matrix(&instance.placed.to_camera);
        let towards = view.scene.light.direction.as_dvec3();
        let flat = matches!(view.look.shading.unwrap_or(model.shading), Shading::Flat);
        let (nearest_far, bends) = (1.0 / view.camera.far, view.field.bends());
        for t in self.triangles.clone() {
            let corners = mesh.triangles[t];
            let at = corners.map(|c| vertices.get(c as usize));
            let [Some(a), Some(b), Some(c)] = at else { continue };
            let (least, most) = (a.w.min(b.w).min(c.w), a.w.max(b.w).max(c.w));
            if (a.w + b.w + c.w).is_nan() {
                continue;
            }
            let whole = least > 0.0;
            if whole && most < nearest_far {
                continue;
            }
            let bent = whole
                && bends
                && (clip::may_bend(a, b, view.field)
                    || clip::may_bend(b, c, view.field)
                    || clip::may_bend(c, a, view.field));
            let face = || match flat {
                true => {
                    let [a, b, c] = corners.map(|c| mesh.positions[c as usize].as_dvec3());
                    unit(normals * (b - a).cross(c - a)).dot(towards).max(0.0) as f32
                }
                false => 0.0,
            };
            let surface = instance.first_surface as u32
                + mesh.material_of.get(t).map_or(0, |&m| (usize::from(m)).min(mesh.materials.len()) as u32);
            let mut record = Record {
                corners: corners.map(|c| c + instance.first_vertex as u32),
                surface,
                face: 0.0,
                instance: self.instance as u32,
                first_vertex: instance.first_vertex as u32,
                bounds: [0; 4],
            };
            if whole && !bent {
                let snapped = [a.snapped, b.snapped, c.snapped];
                if self.shape(&mut record, snapped, view, model) {
                    record.face = face();
                    self.list(record);
                }
            } else {
                self.cut(record, face(), corners, view, &instance, model);
            }
        }
    }

    /// The rare way: cut and split first.
    fn cut(
        &mut self,
        record: Record,
        face: f32,
        corners: [u32; 3],
        view: &View<'_>,
        instance: &Instance,
        model: &Model,
    ) {
        let mesh = &model.mesh;
        let corners = corners.map(|c| {
            let c = c as usize;
            let vertex = &view.vertices[instance.first_vertex + c];
            Corner {
                point: instance.placed.to_camera.transform_point3(mesh.positions[c].as_dvec3()),
                normal: DVec3::from_array(vertex.normal.map(f64::from)),
                intensity: f64::from(vertex.intensity),
                uv: mesh.texcoords.get(c).map_or(DVec2::ZERO, |uv| uv.as_dvec2()),
            }
        });
        let near = view.camera.near;
        clip::cut(corners, near, view.field, &mut |piece, uvs| {
            let mut record = Record { face, ..record };
            record.corners = [0, 1, 2].map(|k| OWN | (self.own.len() + k) as u32);
            if self.shape(&mut record, piece.map(|v| v.snapped), view, model) {
                for (vertex, uv) in piece.into_iter().zip(uvs) {
                    self.own.push(OwnVertex { vertex, uv: uv.as_vec2().to_array() });
                }
                self.list(record);
            }
        });
    }

    /// Winds the record and bounds its pixels; `false` when it covers no pixel center or faces away.
    #[inline]
    fn shape(&self, record: &mut Record, p: [[i32; 2]; 3], view: &View<'_>, model: &Model) -> bool {
        let [a, b, c] = p;
        let (x0, y0, x1, y1) = (i64::from(a[0]), i64::from(a[1]), i64::from(b[0]), i64::from(b[1]));
        let (x2, y2) = (i64::from(c[0]), i64::from(c[1]));
        let area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0);
        // positive = clockwise as seen, the back
        let cull_back = model.cull_back || view.look.needs.includes(Needs::SILHOUETTE);
        if area == 0 || (cull_back && area > 0) {
            return false;
        }
        if area < 0 {
            record.corners.swap(1, 2);
        }
        let size = view.camera.lens.size;
        let first = |v: i64| ((v + 255) >> 8).max(0);
        let left = first(x0.min(x1).min(x2));
        let top = first(y0.min(y1).min(y2));
        let right = (x0.max(x1).max(x2) >> 8).min(size.width as i64 - 1);
        let bottom = (y0.max(y1).max(y2) >> 8).min(size.height as i64 - 1);
        if left > right || top > bottom {
            return false;
        }
        record.bounds = [left, top, right, bottom].map(|v| v as i16);
        true
    }

    /// Adds a record and lists it under its tiles.
    #[inline]
    fn list(&mut self, record: Record) {
        let index = self.records.len() as u32;
        let [x0, y0, x1, y1] = record.bounds.map(|v| v as usize / TILE);
        self.records.push(record);
        if x1 - x0 >= MAX_LISTED || y1 - y0 >= MAX_LISTED {
            self.wide.push(index);
            let [a, b, c, d] = self.wide_tiles.unwrap_or([x0, y0, x1, y1]);
            self.wide_tiles = Some([a.min(x0), b.min(y0), c.max(x1), d.max(y1)]);
            return;
        }
        for row in y0..=y1 {
            for column in x0..=x1 {
                let tile = row * self.columns + column;
                let link = self.links.len() as u32;
                self.links.push(Link { record: index, next: NONE });
                match self.tails[tile] {
                    NONE => self.heads[tile] = link,
                    last => self.links[last as usize].next = link,
                }
                self.tails[tile] = link;
            }
        }
    }
}
