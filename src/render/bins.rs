//! A chunk of consecutive triangles: those that cover a pixel center become records, listed per tile in submission
//! order. Each chunk is filled by one task and read by all tiles, so nothing is locked.
//!
//! Eight triangles at a time are bounded and wound by their spots alone; of those in a box of at most four by four
//! pixel centers the centers themselves are tried. Only what is left is looked at singly: small triangles become
//! records at once, large ones and those to be cut go the long way.

use super::clip::{self, Corner};
use super::record::{Bounds, Extent, NONE, Record};
use super::shape::{CLUSTER, Frustum, Shape};
use super::sort::{BATCH, FRONT, Rules, SEVERAL, SINGLE, SMALL, Sorted};
use super::vertex::{NO_SPOT, Spot, Vertices, normal_matrix, unit};
use super::{Instance, View};
use crate::frame::Needs;
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{TILE, TileGrid};
use crate::scene::{Mesh, Shading};
use fearless_simd::Simd;
use glam::{DMat3, DVec2, DVec3, Vec2, Vec3};
use std::ops::Range;

/// Triangles over more tiles than this in a direction are not listed per tile but checked by every tile.
const MAX_LISTED: usize = 2;

/// Consecutive triangles of one instance and what is left of them.
#[derive(Default)]
pub(super) struct Chunk {
    pub instance: usize,
    triangles: Range<usize>,
    /// How many of them were looked at.
    pub sorted: usize,
    columns: usize,
    /// A triangle over several tiles is one record in each.
    records: Vec<Record>,
    /// Vertices made by cutting, their texture coordinates and colors.
    pub own: Vertices,
    pub own_uv: Vec<Vec2>,
    pub own_colors: Vec<Vec3>,
    heads: Vec<u32>,
    tails: Vec<u32>,
    wide: Vec<u32>,
    /// Tiles under all wide triangles together: column and row ranges, inclusive.
    wide_tiles: Option<[usize; 4]>,
}

/// The records of a tile.
pub(super) struct Records<'a> {
    all: &'a [Record],
    listed: u32,
    wide: &'a [u32],
}

impl<'a> Iterator for Records<'a> {
    type Item = &'a Record;

    #[inline(always)]
    fn next(&mut self) -> Option<&'a Record> {
        if let [first, rest @ ..] = self.wide
            && *first < self.listed
        {
            self.wide = rest;
            return self.all.get(*first as usize);
        }
        let record = self.all.get(self.listed as usize)?;
        self.listed = record.next;
        Some(record)
    }
}

/// What stays the same for all triangles of a chunk.
struct Sorting<'a> {
    view: &'a View<'a>,
    instance: Instance,
    mesh: &'a Mesh,
    spots: &'a [Spot],
    shape: Option<&'a Shape>,
    frustum: Frustum,
    /// The instance's first surface, and whether all triangles have it and no face is flat.
    surface: u32,
    plain: bool,
    /// Turns face normals, where faces are flat.
    flat: Option<DMat3>,
    rules: Rules,
}

impl<'a> Sorting<'a> {
    fn new(view: &'a View<'a>, instance: Instance) -> Self {
        let model = &view.shot.scene.models[instance.placed.model];
        let spots = &view.vertices.spots[instance.first_vertex..][..model.mesh.positions.len()];
        let flat = matches!(view.shot.look.shading.unwrap_or(model.shading), Shading::Flat);
        let straight = if view.shot.field.bends() { clip::straight_box(view.shot.field) } else { SMALL };
        Self {
            view,
            instance,
            mesh: &model.mesh,
            spots,
            shape: view.shapes.of(instance.placed.model),
            frustum: instance.frustum,
            surface: instance.first_surface as u32,
            plain: !flat && model.mesh.materials.is_empty(),
            flat: flat.then(|| normal_matrix(&instance.placed.to_camera)),
            rules: Rules {
                size: view.shot.camera.lens.size,
                columns: view.shot.grid.columns(),
                cull_back: model.cull_back || view.shot.look.needs.includes(Needs::SILHOUETTE),
                reach: straight.min(SMALL),
                bends: view.shot.field.bends(),
            },
        }
    }

    /// Whether any of the cluster with this triangle may be drawn.
    fn may_show(&self, triangle: usize) -> bool {
        self.shape.is_none_or(|shape| shape.cluster_may_show(triangle, &self.frustum, self.rules.cull_back))
    }

    /// The surface, and the intensity of a flat face.
    #[inline(never)]
    fn kind(&self, triangle: usize, corners: [u32; 3]) -> (u32, f32) {
        let none = self.mesh.materials.len();
        let own = self.mesh.material_of.get(triangle).map_or(0, |&m| usize::from(m).min(none));
        let surface = self.surface + own as u32;
        let Some(normals) = self.flat else { return (surface, -1.0) };
        let at = |c: u32| self.mesh.positions.get(c as usize).copied().unwrap_or_default().as_dvec3();
        let [a, b, c] = corners.map(at);
        let light = self.view.shot.scene.light.direction.as_dvec3();
        (surface, unit(normals * (b - a).cross(c - a)).dot(light).max(0.0) as f32)
    }

    fn record(&self, triangle: usize, corners: [u32; 3], bounds: Bounds) -> Record {
        let (surface, face) = self.kind(triangle, corners);
        Record { corners, surface, face, bounds, ..Record::NONE }
    }
}

impl Chunk {
    /// Empties the chunk for these triangles; `length` is the most it may be given this frame.
    pub fn begin(&mut self, instance: usize, triangles: Range<usize>, length: usize, grid: TileGrid) {
        (self.instance, self.triangles, self.columns) = (instance, triangles, grid.columns());
        self.sorted = 0;
        self.records.clear();
        self.records.reserve(2 * length);
        self.own.clear();
        self.own_uv.clear();
        self.own_uv.reserve(256);
        self.own_colors.clear();
        self.own_colors.reserve(256);
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

    /// Whether there are records to walk for the tile.
    pub fn holds(&self, tile: usize) -> bool {
        self.heads[tile] != NONE || !self.wide.is_empty()
    }

    /// The records that may touch the tile, in submission order.
    #[inline(always)]
    pub fn records_of(&self, tile: usize) -> Records<'_> {
        Records { all: &self.records, listed: self.heads[tile], wide: &self.wide }
    }

    /// Sorts the chunk's triangles into records and tiles.
    pub fn fill(&mut self, level: Level, view: &View<'_>) {
        let sorting = Sorting::new(view, view.instances[self.instance]);
        let Range { start, end } = self.triangles;
        let mut first = start;
        while first < end {
            // as many clusters at once as there are side by side
            let mut last = first;
            while last < end && sorting.may_show(last) {
                last = end.min(last / CLUSTER * CLUSTER + CLUSTER);
            }
            dispatch!(level, simd => self.sort(simd, &sorting, first..last));
            self.sorted += last - first;
            first = end.min(last / CLUSTER * CLUSTER + CLUSTER);
        }
    }

    #[inline(always)]
    fn sort<S: Simd>(&mut self, simd: S, sorting: &Sorting<'_>, triangles: Range<usize>) {
        let spot = |corner: u32| sorting.spots.get(corner as usize).copied().unwrap_or(NO_SPOT);
        let mut first = triangles.start;
        let (whole, rest) = sorting.mesh.triangles[triangles].as_chunks::<BATCH>();
        // triangles that have no corners draw nothing
        let mut last = [[u32::MAX; 3]; BATCH];
        last[..rest.len()].copy_from_slice(rest);
        for batch in whole.iter().chain((!rest.is_empty()).then_some(&last)) {
            let (mut a, mut b, mut c) = ([NO_SPOT; BATCH], [NO_SPOT; BATCH], [NO_SPOT; BATCH]);
            for (k, triangle) in batch.iter().enumerate() {
                (a[k], b[k], c[k]) = (spot(triangle[0]), spot(triangle[1]), spot(triangle[2]));
            }
            let sorted = Sorted::new(simd, &sorting.rules, &a, &b, &c);
            let mut left = sorted.alive;
            while left != 0 {
                let k = left.trailing_zeros() as usize % BATCH;
                left &= left - 1;
                let [low, high, tile, word] = sorted.one(k);
                if tile == SINGLE {
                    self.single(sorting, first + k, batch[k]);
                    continue;
                }
                let (mut surface, mut face) = (sorting.surface, -1.0);
                if !sorting.plain {
                    (surface, face) = sorting.kind(first + k, batch[k]);
                }
                let [a, b, c] = batch[k];
                let corners = if word & FRONT != 0 { [a, c, b] } else { [a, b, c] };
                let (bounds, cover, extent) = (Bounds { low, high }, word as u16, Extent::Small);
                // built twice: one in memory for both would be read before it is there
                if tile == SEVERAL {
                    self.list(&Record { corners, surface, face, bounds, cover, extent, next: NONE });
                } else {
                    let record = Record { corners, surface, face, bounds, cover, extent, next: NONE };
                    self.append(record, tile as usize);
                }
            }
            first += BATCH;
        }
    }

    /// One triangle, whatever it is.
    #[inline(never)]
    fn single(&mut self, sorting: &Sorting<'_>, triangle: usize, corners: [u32; 3]) {
        let Sorting { view, instance, .. } = sorting;
        let places = &view.vertices.places[instance.first_vertex..][..sorting.spots.len()];
        let at = corners.map(|c| places.get(c as usize));
        let [Some(a), Some(b), Some(c)] = at else { return };
        let [u, v, w] = [a.w(), b.w(), c.w()];
        let (least, most) = (u.min(v).min(w), u.max(v).max(w));
        if (u + v + w).is_nan() {
            return;
        }
        let whole = least > 0.0;
        if whole && most < 1.0 / view.shot.camera.far {
            return;
        }
        let field = view.shot.field;
        let bent = whole
            && field.bends()
            && (clip::may_bend(a, b, field) || clip::may_bend(b, c, field) || clip::may_bend(c, a, field));
        if whole && !bent {
            let spots = corners.map(|c| sorting.spots[c as usize]);
            if let Some((wound, bounds)) = shape(spots, sorting) {
                let mut record = sorting.record(triangle, corners, bounds);
                (record.corners, record.extent) = (wound.map(|k| corners[k]), Extent::Large);
                self.list(&record);
            }
        } else {
            self.cut(sorting, triangle, corners);
        }
    }

    /// The rare way: cut and split first.
    fn cut(&mut self, sorting: &Sorting<'_>, triangle: usize, corners: [u32; 3]) {
        let Sorting { view, instance, mesh, .. } = sorting;
        let whole = sorting.record(triangle, corners, Bounds::default());
        let cut = corners.map(|c| {
            let (c, index) = (c as usize, instance.first_vertex + c as usize);
            let normal = view.vertices.normals.get(index).copied().unwrap_or_default();
            Corner {
                point: instance.placed.to_camera.transform_point3(mesh.positions[c].as_dvec3()),
                normal: DVec3::new(normal[0].into(), normal[1].into(), normal[2].into()),
                intensity: view.vertices.places[index].intensity(),
                uv: mesh.texcoords.get(c).map_or(DVec2::ZERO, |uv| uv.as_dvec2()),
                color: mesh.colors.get(c).map_or(DVec3::ONE, |color| color.as_dvec3()),
            }
        });
        clip::cut(cut, view.shot.camera.near, view.shot.field, &mut |piece| {
            let Some((wound, bounds)) = shape(piece.each_ref().map(|seen| seen.vertex.spot()), sorting)
            else {
                return;
            };
            let first = self.own.places.len() as u32;
            for seen in piece {
                self.own.places.push(seen.vertex);
                self.own.spots.push(seen.vertex.spot());
                self.own
                    .normals
                    .push(seen.corner.normal.as_vec3().extend(seen.vertex.intensity() as f32).to_array());
                self.own_uv.push(seen.corner.uv.as_vec2());
                self.own_colors.push(seen.corner.color.as_vec3());
            }
            let corners = wound.map(|k| first + k as u32);
            self.list(&Record { bounds, corners, extent: Extent::Piece, ..whole });
        });
    }

    /// Adds what of a record is in them to its tiles.
    #[inline(never)]
    fn list(&mut self, record: &Record) {
        let [x0, y0, x1, y1] = record.bounds.sides().map(|v| v as usize / TILE);
        if x1 - x0 >= MAX_LISTED || y1 - y0 >= MAX_LISTED {
            self.wide.push(self.records.len() as u32);
            self.records.push(*record);
            let [a, b, c, d] = self.wide_tiles.unwrap_or([x0, y0, x1, y1]);
            self.wide_tiles = Some([a.min(x0), b.min(y0), c.max(x1), d.max(y1)]);
            return;
        }
        let (across, down) = (x1 > x0, y1 > y0);
        self.list_part(record, x0, y0);
        if across {
            self.list_part(record, x1, y0);
        }
        if down {
            self.list_part(record, x0, y1);
        }
        if across && down {
            self.list_part(record, x1, y1);
        }
    }

    #[inline(always)]
    fn list_part(&mut self, record: &Record, column: usize, row: usize) {
        let (x, y) = ((column * TILE) as i32, (row * TILE) as i32);
        let part = record.cut([x, y, x + (TILE as i32 - 1), y + (TILE as i32 - 1)]);
        if record.cover == 0 || part.cover != 0 {
            self.append(part, row * self.columns + column);
        }
    }

    #[inline(always)]
    fn append(&mut self, record: Record, tile: usize) {
        let index = self.records.len() as u32;
        self.records.push(record);
        let Some(tail) = self.tails.get_mut(tile) else { return };
        let last = std::mem::replace(tail, index);
        match self.records.get_mut(last as usize) {
            Some(last) => last.next = index,
            None => self.heads[tile] = index,
        }
    }
}

/// Which of the corners comes first, second and third, and the pixels they bound; `None` when no pixel center is
/// covered or the triangle faces away.
fn shape(p: [Spot; 3], sorting: &Sorting<'_>) -> Option<([usize; 3], Bounds)> {
    let [[x0, y0], [x1, y1], [x2, y2]] = p.map(|spot| spot.map(i64::from));
    let area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0);
    // positive = clockwise as seen, the back
    if area == 0 || (sorting.rules.cull_back && area > 0) {
        return None;
    }
    let size = sorting.rules.size;
    let first = |v: i64| ((v + 255) >> 8).max(0);
    let left = first(x0.min(x1).min(x2));
    let top = first(y0.min(y1).min(y2));
    let right = (x0.max(x1).max(x2) >> 8).min(size.width as i64 - 1);
    let bottom = (y0.max(y1).max(y2) >> 8).min(size.height as i64 - 1);
    let wound = if area < 0 { [0, 2, 1] } else { [0, 1, 2] };
    (left <= right && top <= bottom)
        .then(|| (wound, Bounds::new([left, top, right, bottom].map(|v| v as i32))))
}
