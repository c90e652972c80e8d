//! The stages of one frame, from placed models to drawn tiles, and the buffers between them.
//!
//! Room is made for every model of the scene once, in view or not: nothing is allocated when one comes into view.

use super::bins::Chunk;
use super::field::Field;
use super::resolve::Painter;
use super::shade::{Kind, Palette, Surface};
use super::shape::{CLUSTER, Frustum, Shapes};
use super::silhouette::Silhouette;
use super::tile::{self, Channels, Slot};
use super::vertex::{self, Depths, Stand, Vertices};
use super::{Camera, Look, Part, Placed, Work};
use crate::frame::{Layer, Needs};
use crate::pixels::simd::Level;
use crate::pixels::{TileGrid, TileSet};
use crate::scene::{Model, Scene, Shading};
use rayon::prelude::*;

/// Triangles in a chunk of small scenes; larger ones have about `MAX_CHUNKS` larger chunks, and the largest more of
/// `MAX_CHUNK`.
const CHUNK: usize = 512;
const MAX_CHUNKS: usize = 64;
const MAX_CHUNK: usize = 4096;

/// Pixels around the picture in which a triangle counts as in view: more than snapping moves it.
const MARGIN_PX: f64 = 1.5;

/// What a frame is drawn from, beside the places.
#[derive(Clone, Copy)]
pub(super) struct Shot<'a> {
    pub scene: &'a Scene,
    pub camera: &'a Camera,
    pub field: &'a Field,
    pub grid: TileGrid,
    pub look: Look,
}

/// One placed model that may be in view: where its vertices and surfaces are.
#[derive(Clone, Copy)]
pub(super) struct Instance {
    pub placed: Placed,
    pub frustum: Frustum,
    pub first_vertex: usize,
    pub first_surface: usize,
}

/// What all stages of one frame share.
#[derive(Clone, Copy)]
pub(super) struct View<'a> {
    pub shot: Shot<'a>,
    pub instances: &'a [Instance],
    pub shapes: &'a Shapes,
    pub vertices: &'a Vertices,
    pub channels: Channels,
    /// 1/z that stands for no surface.
    pub nothing: f32,
}

/// The buffers of the stages.
#[derive(Default)]
pub(super) struct Stages {
    shapes: Shapes,
    instances: Vec<Instance>,
    surfaces: Vec<Surface>,
    vertices: Vertices,
    chunks: Vec<Chunk>,
    /// How many chunks the frame has.
    used: usize,
    /// One for each row of tiles of the picture.
    slots: Vec<Slot>,
    /// What of pixels is kept.
    channels: Channels,
    /// What all slots have room for; `None` when they have none.
    fitted: Option<Channels>,
}

impl Stages {
    /// Takes pictures of this many rows of tiles.
    pub fn resize(&mut self, rows: usize) {
        if self.slots.len() == rows {
            return; // other products, the same tiles
        }
        self.slots.clear();
        self.slots.resize_with(rows, Slot::default);
        self.fitted = None;
    }

    /// Nothing is drawn.
    pub fn clear(&mut self) {
        (self.used, self.channels) = (0, Channels::default());
        self.instances.clear();
        self.surfaces.clear();
    }

    /// Draws what was sorted into the layer, all tiles that it or the last frame touches; `shot` is that of `sort`,
    /// if there was any.
    pub fn paint(
        &mut self,
        level: Level,
        (scene, camera): (&Scene, &Camera),
        shot: Option<Shot<'_>>,
        layer: &mut Layer,
        previous: &TileSet,
        lines: Option<&mut Silhouette>,
    ) {
        let Self { shapes, instances, surfaces, vertices, chunks, used, slots, channels, .. } = self;
        let (channels, nothing) = (*channels, tile::nothing(camera.far));
        let view = shot.map(|shot| View { shot, instances, shapes, vertices, channels, nothing });
        let palette = Palette { scene, surfaces, channels, nothing };
        let painter = Painter { level, view, chunks: &chunks[..*used], palette, previous };
        let shield = lines.filter(|_| channels.phantoms).map(|lines| lines.shield(camera.lens.size));
        painter.paint(layer, shield, slots);
    }

    /// Sorts the placed models of a part into tiles, and finds their outlines where `lines` are wanted. Gives nearest
    /// and farthest camera z, and what it took.
    pub fn sort(
        &mut self,
        level: Level,
        shot: &Shot<'_>,
        placed: &[Placed],
        part: Part,
        lines: Option<&mut Silhouette>,
    ) -> ([f32; 2], Work) {
        let Shot { scene, camera, field, grid, .. } = *shot;
        self.shapes.learn(scene);
        let vertex_count = self.list(shot, placed, part);
        let length = self.make_room(shot);
        let Self { shapes, instances, vertices, chunks, channels, .. } = self;
        vertices.resize(vertex_count, *channels);
        let mut depths = Depths::NONE;
        for instance in instances.iter() {
            let model = &scene.models[instance.placed.model];
            let (mesh, to_camera, near) = (&*model.mesh, &instance.placed.to_camera, camera.near);
            let lit = channels.light || channels.normals;
            let stand = Stand { mesh, to_camera, near, field, light: scene.light.direction, lit };
            let reached = vertex::place(level, stand, vertices, instance.first_vertex);
            if !model.phantom {
                depths = depths.join(reached);
            }
        }
        let (channels, nothing) = (*channels, tile::nothing(camera.far));
        let view = View { shot: *shot, instances, shapes, vertices, channels, nothing };
        if let Some(lines) = lines {
            lines.find(&view);
        }

        let mut used = 0;
        for (k, instance) in view.instances.iter().enumerate() {
            let triangles = scene.models[instance.placed.model].mesh.triangles.len();
            for first in (0..triangles).step_by(length) {
                if used == chunks.len() {
                    chunks.push(Chunk::default());
                }
                chunks[used].begin(k, first..triangles.min(first + length), length, grid);
                used += 1;
            }
        }
        let chunks = &mut chunks[..used];
        chunks.par_iter_mut().with_max_len(1).for_each(|chunk| chunk.fill(level, &view));
        let triangles = chunks.iter().map(|chunk| chunk.sorted).sum();
        let work = Work { frames: 0, models: view.instances.len(), vertices: vertex_count, triangles };

        self.used = used;
        (extent(depths, camera), work)
    }

    /// Lists the instances that may be in view and their surfaces; gives the number of their vertices.
    fn list(&mut self, shot: &Shot<'_>, placed: &[Placed], part: Part) -> usize {
        let Shot { scene, camera, field, look, .. } = *shot;
        let Self { shapes, instances, surfaces, .. } = self;
        let lines = if look.needs.includes(Needs::SILHOUETTE) { look.line_width.max(0.0) } else { 0.0 };
        let mut vertex_count = 0;
        // phantoms first: what they hide must be known
        for phantom in [true, false] {
            for &placed in placed {
                let Some(model) = scene.models.get(placed.model) else { continue };
                let frustum = Frustum::new(placed.to_camera, camera, field, MARGIN_PX + lines);
                let may_show = shapes.of(placed.model).is_some_and(|shape| shape.may_show(&frustum));
                if model.phantom != phantom || !part.holds(model) || !may_show {
                    continue;
                }
                let known = instances.iter().find(|other| other.placed.model == placed.model);
                let first_surface = known.map_or(surfaces.len(), |other| other.first_surface);
                if known.is_none() {
                    let shading = look.shading.unwrap_or(model.shading);
                    Surface::push_all(placed.model, model, shading, &scene.light, surfaces);
                }
                instances.push(Instance { placed, frustum, first_vertex: vertex_count, first_surface });
                vertex_count += model.mesh.positions.len();
            }
        }
        self.channels = channels(look.needs, surfaces);
        vertex_count
    }

    /// Makes room for every model of the scene once; gives the length of chunks.
    fn make_room(&mut self, shot: &Shot<'_>) -> usize {
        let Shot { scene, look, grid, .. } = *shot;
        let of = |count: fn(&Model) -> usize| scene.models.iter().map(count).sum::<usize>();
        let (vertices, triangles) = (of(|m| m.mesh.positions.len()), of(|m| m.mesh.triangles.len()));
        let length = triangles.div_ceil(MAX_CHUNKS).clamp(CHUNK, MAX_CHUNK).next_multiple_of(CLUSTER);
        let wanted = self.fitted.unwrap_or_default().join(self.channels).join(possible(scene, &look));
        self.vertices.reserve(vertices, wanted);
        self.surfaces.reserve(of(|m| m.mesh.materials.len() + 1).saturating_sub(self.surfaces.len()));
        let chunks: usize = scene.models.iter().map(|m| m.mesh.triangles.len().div_ceil(length)).sum();
        for _ in self.chunks.len()..chunks {
            self.chunks.push(Chunk::default());
            if let Some(chunk) = self.chunks.last_mut() {
                chunk.begin(0, 0..0, length, grid);
            }
        }
        if self.fitted != Some(wanted) {
            self.fitted = Some(wanted);
            self.slots.iter_mut().for_each(|slot| slot.fit(wanted));
        }
        length
    }
}

/// What of a pixel these products of these surfaces are made from.
fn channels(needs: Needs, surfaces: &[Surface]) -> Channels {
    let color = needs.includes(Needs::COLOR);
    let second = needs.includes(Needs::SECOND_LAYER);
    let any = |what: fn(&Surface) -> bool| surfaces.iter().any(what);
    Channels {
        light: color && any(|s| matches!(s.kind, Kind::Smooth | Kind::Flat | Kind::Toon)),
        flat: color && any(|s| s.kind == Kind::Flat),
        normals: second || needs.includes(Needs::NORMAL) || (color && any(|s| s.kind == Kind::ThreeSteps)),
        uv: color && any(Surface::is_textured),
        colors: color && any(Surface::is_colored),
        surfaces: (color || needs.includes(Needs::OBJECT)) && surfaces.len() > 1,
        second,
        phantoms: any(|s| s.kind == Kind::Phantom),
    }
}

/// All that any of the scene's models may need, in view or not.
fn possible(scene: &Scene, look: &Look) -> Channels {
    let color = look.needs.includes(Needs::COLOR);
    let second = look.needs.includes(Needs::SECOND_LAYER);
    let any = |what: fn(&Model) -> bool| scene.models.iter().any(what);
    let steps = match look.shading {
        Some(shading) => shading == Shading::ThreeSteps,
        None => any(|m| m.shading == Shading::ThreeSteps),
    };
    Channels {
        light: color,
        flat: false,
        normals: second || look.needs.includes(Needs::NORMAL) || (color && steps),
        uv: color && any(|m| m.mesh.materials.iter().any(|material| material.texture.is_some())),
        colors: color && any(|m| !m.mesh.colors.is_empty()),
        surfaces: (color || look.needs.includes(Needs::OBJECT))
            && (scene.models.len() > 1 || any(|m| !m.mesh.materials.is_empty())),
        second,
        phantoms: any(|m| m.phantom),
    }
}

/// Nearest and farthest camera z; vertices that must be cut count as on the near plane. The first is the larger when
/// there are none.
fn extent(depths: Depths, camera: &Camera) -> [f32; 2] {
    let Depths { least, most, cut } = depths;
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    if most > 0.0 {
        (low, high) = (1.0 / most, 1.0 / least);
    }
    if cut {
        (low, high) = (low.min(camera.near), high.max(camera.near));
    }
    [low.max(camera.near) as f32, high.min(camera.far) as f32]
}
