//! The tile rasteriser: models before the lens become a `Layer`.
//!
//! 1. `vertex`: every vertex to camera space, through the lens to the picture, snapped to 1/256 px, lit (f64).
//! 2. `clip`: only triangles that cross the near plane, leave the lens's field or bend in it are cut (f64).
//! 3. `bins`: what covers no pixel center dies, eight triangles at a time (`sort`); the rest is listed per 64-px
//!    tile, chunk by chunk, in submission order, without locks.
//! 4. `raster`: a tile's lists are walked, small triangles set up four at a time (`setup`): exact coverage (`spans`), 1/z and
//!    attributes of the unsnapped triangle (`slopes`), nearest and second-nearest surface in the same pass (`run`), into
//!    the tile's own pixels (`tile`).
//! 5. `resolve`: a task a row of tiles; each tile is drawn and, while it is at hand, written into the layer, each
//!    pixel's nearest surface shaded (`shade`, `gray`); tiles covered last time only are cleared.
//! 6. `silhouette`: thick outlines are drawn over the depth, where they are asked for.
//!
//! `stages` runs 1 to 5 and owns what they need. `shape` and `kept` are for skipping: what is out of view, and a frame that would be the last one again.
//!
//! Apart from these, `particles` turns models into points for styles that ask for them.
//!
//! Coverage follows vertices snapped to 1/256 px with the top-left rule; depth and attributes come from the
//! unsnapped vertices. Equal depths keep the first submitted. The same bytes for every thread count and
//! SIMD level: chunks and tiles are cut by size alone, and all arithmetic is + - × ÷ sqrt in a fixed order.

mod bins;
mod clip;
mod field;
mod gray;
mod kept;
mod particles;
mod raster;
mod record;
pub mod reference;
mod resolve;
mod run;
mod setup;
mod shade;
mod shape;
mod silhouette;
mod slopes;
mod sort;
mod spans;
mod stages;
mod tile;
mod vertex;

use crate::frame::{Layer, Needs};
use crate::geometry::Lens;
use crate::pixels::simd::Level;
use crate::pixels::{Size, TILE, TileGrid, TileSet};
use crate::scene::{Model, Scene, Shading};
use field::Field;
use glam::DAffine3;
use kept::Kept;
use particles::Particles;
use silhouette::Silhouette;
use stages::{Instance, Shot, Stages, View};

pub use particles::Scatter;

/// The camera as the renderer sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Intrinsics, distortion and picture size.
    pub lens: Lens,
    /// Nearer than this camera z (mm) is clipped.
    pub near: f64,
    /// Beyond this camera z (mm) is nothing.
    pub far: f64,
}

/// What a style asks of the renderer: which products, and how the models look in it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Look {
    /// The products; nothing else is computed.
    pub needs: Needs,
    /// Shading in place of each model's own.
    pub shading: Option<Shading>,
    /// Width of silhouette lines, px.
    pub line_width: f64,
    /// How models become particles.
    pub scatter: Scatter,
}

impl From<Needs> for Look {
    /// These products, models as the scene has them.
    fn from(needs: Needs) -> Self {
        Look { needs, ..Look::default() }
    }
}

/// One model of the scene put before the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// Index into `Scene::models`.
    pub model: usize,
    /// Mesh coordinates → camera space, mm.
    pub to_camera: DAffine3,
}

/// What a frame took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Work {
    /// Frames drawn so far; one that would be as the last is not.
    pub frames: u64,
    /// Placed models of the last drawn frame that may be in view.
    pub models: usize,
    /// Their vertices.
    pub vertices: usize,
    /// Their triangles, without those of clusters that are not in view.
    pub triangles: usize,
}

/// Which of the placed models are drawn.
#[derive(Clone, Copy)]
enum Part {
    Whole,
    Primary,
    Secondary,
}

impl Part {
    /// Phantoms hide both.
    fn holds(self, model: &Model) -> bool {
        match self {
            Part::Whole => true,
            Part::Primary => model.phantom || !model.secondary,
            Part::Secondary => model.phantom || model.secondary,
        }
    }
}

/// Largest picture side: snapped coordinates of the picture stay far below the guard band.
const MAX_SIDE: usize = 16384;

/// Draws models; owns every buffer it needs, so that drawing allocates nothing after warm-up.
pub struct Renderer {
    level: Level,
    layer: Layer,
    /// What the layer's planes are allocated for.
    shape: Option<(Size, Needs)>,
    previous: TileSet,
    field: Option<Field>,
    stages: Stages,
    silhouette: Silhouette,
    kept: Kept,
    work: Work,
    /// Draws the secondary models where they are apart.
    secondary: Option<Box<Renderer>>,
    particles: Particles,
    /// Where its layer goes when it is done.
    spare: Option<Box<Layer>>,
}

impl Renderer {
    /// A renderer whose bodies run at `level`.
    pub fn new(level: Level) -> Self {
        Self {
            level,
            layer: Layer::default(),
            shape: None,
            previous: TileSet::default(),
            field: None,
            stages: Stages::default(),
            silhouette: Silhouette::default(),
            kept: Kept::default(),
            work: Work::default(),
            secondary: None,
            particles: Particles::default(),
            spare: None,
        }
    }

    /// What was drawn last.
    pub fn layer(&self) -> &Layer {
        &self.layer
    }

    /// What the last drawn frame took; of secondary models apart nothing.
    pub fn work(&self) -> Work {
        self.work
    }

    /// Draws the next frame whatever it is.
    pub fn restart(&mut self) {
        self.kept.forget();
    }

    /// Draws the placed models: only the products that `look` needs, only the tiles they touch.
    ///
    /// Depth comes with color even when it is not asked for, since it is the coverage mask. Equal depths
    /// keep the fragment submitted first: in the order of `placed`, then of the mesh's triangles. Triangles
    /// that are not finite, not in range or without area draw nothing; a `placed` whose model does not
    /// exist, an unusable camera (near ≤ 0, far ≤ near, not finite, picture side above 16384 px) likewise.
    /// Straight edges that the lens bends are split until they are within `SPLIT_TOLERANCE_PX` of the
    /// curve. Phantoms are not seen, they hide what is behind them. A frame that follows from the same scene, places,
    /// camera and look as the last one is that one: nothing is drawn. Runs on rayon's current pool.
    pub fn draw(
        &mut self,
        scene: &Scene,
        placed: &[Placed],
        camera: &Camera,
        look: impl Into<Look>,
    ) -> &Layer {
        let look = look.into();
        if self.kept.same(scene, placed, camera, &look) {
            return &self.layer;
        }
        self.work.frames += 1;
        // between frames the secondary models' layer is part of ours; to be drawn it goes back to its renderer
        if let (Some(mut layer), Some(renderer)) = (self.layer.secondary.take(), &mut self.secondary) {
            std::mem::swap(&mut *layer, &mut renderer.layer);
            self.spare = Some(layer);
        }
        if !look.needs.includes(Needs::SECONDARY) {
            self.draw_part(scene, placed, camera, look, Part::Whole);
            return &self.layer;
        }
        self.draw_part(scene, placed, camera, look, Part::Primary);
        let level = self.level;
        let renderer = self.secondary.get_or_insert_with(|| Box::new(Renderer::new(level)));
        renderer.draw_part(scene, placed, camera, Needs::NORMAL.into(), Part::Secondary);
        self.layer.touched.union(&renderer.layer.touched);
        let mut layer = self.spare.take().unwrap_or_default();
        std::mem::swap(&mut *layer, &mut renderer.layer);
        self.layer.secondary = Some(layer);
        &self.layer
    }

    fn draw_part(&mut self, scene: &Scene, placed: &[Placed], camera: &Camera, look: Look, part: Part) {
        let needs = look.needs;
        let size = camera.lens.size;
        let grid = TileGrid::new(size);
        self.fit(size, needs);
        std::mem::swap(&mut self.previous, &mut self.layer.touched);
        self.layer.touched.reset(grid);
        self.layer.grid = Some(grid);
        self.layer.light = scene.light.direction;
        self.layer.extent = [f32::INFINITY, f32::NEG_INFINITY];
        self.silhouette.clear();
        let usable = camera.near > 0.0 && camera.far > camera.near && camera.far.is_finite();
        let drawn = size.area() > 0 && size.width.max(size.height) <= MAX_SIDE;
        let drawn = drawn && usable && needs != Needs::NOTHING;
        self.stages.clear();
        if drawn {
            if self.field.as_ref().is_none_or(|field| *field.lens() != camera.lens) {
                self.field = Some(Field::new(camera.lens));
            }
            if needs.without(Needs::PARTICLES) != Needs::NOTHING {
                self.sort(scene, placed, camera, grid, look, part);
            }
        }
        let Self { level, layer, field, stages, previous, silhouette, .. } = self;
        let field = field.as_ref().filter(|_| drawn);
        let shot = field.map(|field| Shot { scene, camera, field, grid, look });
        let lines = needs.includes(Needs::SILHOUETTE).then_some(silhouette);
        stages.paint(*level, (scene, camera), shot, layer, previous, lines);
        if needs.includes(Needs::SILHOUETTE) {
            self.silhouette.draw(&mut self.layer, grid, &self.previous, look.line_width, camera.far);
        }
        self.layer.particles.clear();
        if drawn && needs.includes(Needs::PARTICLES) {
            self.scatter(scene, placed, camera, grid, look.scatter);
        }
    }

    /// Gives the layer's planes the size that `needs` wants, all background when anything changed.
    fn fit(&mut self, size: Size, needs: Needs) {
        if self.shape == Some((size, needs)) {
            return;
        }
        let none = Size::new(0, 0);
        let when = |wanted: bool| if wanted { size } else { none };
        let color = when(needs.includes(Needs::COLOR));
        let depth = when(needs.without(Needs::PARTICLES) != Needs::NOTHING);
        let normal = when(needs.includes(Needs::NORMAL));
        let second = when(needs.includes(Needs::SECOND_LAYER));
        for plane in &mut self.layer.color.planes {
            plane.resize(color, 0);
            plane.fill(0);
        }
        for (plane, size) in [(&mut self.layer.depth, depth), (&mut self.layer.depth2, second)] {
            plane.resize(size, f32::INFINITY);
            plane.fill(f32::INFINITY);
        }
        for (planes, size) in [(&mut self.layer.normal, normal), (&mut self.layer.normal2, second)] {
            for plane in planes {
                plane.resize(size, 0.0);
                plane.fill(0.0);
            }
        }
        self.layer.object.resize(when(needs.includes(Needs::OBJECT)), 0);
        self.layer.object.fill(0);
        self.layer.silhouette.resize(when(needs.includes(Needs::SILHOUETTE)), 0);
        self.layer.silhouette.fill(0);
        let grid = TileGrid::new(size);
        self.layer.touched.reset(grid);
        self.previous.reset(grid);
        self.stages.resize(if size.width.max(size.height) <= MAX_SIDE { grid.rows() } else { 0 });
        self.shape = Some((size, needs));
    }

    /// The models as particles.
    fn scatter(
        &mut self,
        scene: &Scene,
        placed: &[Placed],
        camera: &Camera,
        grid: TileGrid,
        scatter: Scatter,
    ) {
        let Self { layer, field, particles, .. } = self;
        let Some(field) = field.as_ref() else { return };
        particles.draw(scene, placed, camera, field, scatter, &mut layer.particles);
        for particle in &layer.particles {
            let at = |v: f32, length: usize| ((v + 0.5) as usize).min(length - 1) / TILE;
            let size = camera.lens.size;
            let (column, row) = (at(particle.x, size.width), at(particle.y, size.height));
            layer.touched.insert(row * grid.columns() + column);
        }
        let depth = |particle: Option<&crate::frame::Particle>| particle.map(|particle| particle.z);
        if let (Some(far), Some(near)) = (depth(layer.particles.first()), depth(layer.particles.last())) {
            layer.extent = [layer.extent[0].min(near), layer.extent[1].max(far)];
        }
    }

    /// Steps 1 to 3.
    fn sort(
        &mut self,
        scene: &Scene,
        placed: &[Placed],
        camera: &Camera,
        grid: TileGrid,
        look: Look,
        part: Part,
    ) {
        let Self { level, layer, field, stages, silhouette, work, .. } = self;
        let Some(field) = field.as_ref() else { return };
        let shot = Shot { scene, camera, field, grid, look };
        let lines = look.needs.includes(Needs::SILHOUETTE).then_some(silhouette);
        let (extent, done) = stages.sort(*level, &shot, placed, part, lines);
        layer.extent = extent;
        *work = Work { frames: work.frames, ..done };
    }
}
