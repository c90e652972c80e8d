//! What flows through a frame: `Frame` from the camera, `Sighting`s from the tracker, the `Layer` from the
//! renderer, and the `Needs` by which a style says what it wants of it.

use crate::geometry::Pose;
use crate::marker::Family;
use crate::pixels::{Plane, Rgb, Size, TileGrid, TileSet};
use glam::{DVec2, Vec3};
use std::time::Duration;

/// The monotonic clock that pictures are stamped with: by the kernel when taken, by us when shown.
pub fn now() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    Duration::new(time.tv_sec.max(0) as u64, time.tv_nsec as u32)
}

/// One camera picture.
#[derive(Clone, Debug, Default)]
pub struct Frame {
    /// Gray picture for the tracker (full range 0..255).
    pub luma: Plane<u8>,
    /// Color picture for the styles; same size as `luma`.
    pub color: Rgb,
    /// The source's running number; a gap is a frame the source dropped.
    pub sequence: u64,
    /// When the picture was taken, on the monotonic clock (clips: sequence / frame rate).
    pub captured_at: Duration,
}

impl Frame {
    /// Width and height.
    pub fn size(&self) -> Size {
        self.luma.size()
    }

    /// Fits both pictures to `size`; allocates only to grow.
    pub fn resize(&mut self, size: Size) {
        self.luma.resize(size, 0);
        self.color.resize(size);
    }
}

/// The tracker's claim that a marker is in view, and what it solved from it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// The family whose code was read.
    pub family: Family,
    /// The code's number in its family.
    pub id: u32,
    /// Outer corners of the black border, px, in the family's order: TL TR BR BL of the upright print.
    pub corners: [DVec2; 4],
    /// Bits corrected.
    pub hamming: u32,
    /// Decision margin: mean gray distance of the bits from their threshold, 0..255.
    pub margin: f32,
    /// The better pose and the other local minimum, where the corners decide at least one.
    pub pose: Option<Solved>,
    /// The second minimum of the pose problem, where there is one.
    pub pose_alt: Option<Solved>,
    /// How it comes to be known.
    pub state: State,
}

/// How a sighting comes to be known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum State {
    /// Searched for and read in this picture.
    #[default]
    Found,
    /// Known from the picture before, and seen again where it was expected.
    Followed,
    /// Not seen in this picture: where it would be if it kept moving.
    Held,
}

/// A pose and how well it explains the corners.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solved {
    /// Marker → camera, mm.
    pub pose: Pose,
    /// Root mean square reprojection error of the four corners, px.
    pub error_px: f64,
}

/// What a style wants from the renderer; the renderer computes nothing else.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Needs(u8);

impl Needs {
    /// Nothing: the style draws the camera picture alone.
    pub const NOTHING: Needs = Needs(0);
    /// Shaded color and coverage.
    pub const COLOR: Needs = Needs(1);
    /// Camera z per pixel (kept for the depth test anyway; asks for it as output).
    pub const DEPTH: Needs = Needs(2);
    /// Unit normals in camera space.
    pub const NORMAL: Needs = Needs(4);
    /// Depth and normal of the second-nearest surface.
    pub const SECOND_LAYER: Needs = Needs(8);
    /// Thick outlines; faces turned away are not filled.
    pub const SILHOUETTE: Needs = Needs(16);
    /// The models as points instead of surfaces.
    pub const PARTICLES: Needs = Needs(32);
    /// Secondary models drawn on their own, apart from the others: depth and normal.
    pub const SECONDARY: Needs = Needs(64);
    /// Which model each pixel shows.
    pub const OBJECT: Needs = Needs(128);

    /// Both.
    pub const fn and(self, other: Needs) -> Needs {
        Needs(self.0 | other.0)
    }

    /// What both want.
    pub const fn within(self, other: Needs) -> Needs {
        Needs(self.0 & other.0)
    }

    /// Without the other.
    pub const fn without(self, other: Needs) -> Needs {
        Needs(self.0 & !other.0)
    }

    /// Whether all of `other` is wanted.
    pub const fn includes(self, other: Needs) -> bool {
        self.0 & other.0 == other.0
    }
}

/// A point of a model as it is seen, hidden or not.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Particle {
    /// Where it is in the picture, px; inside it.
    pub x: f32,
    /// Where it is in the picture, px; inside it.
    pub y: f32,
    /// Camera z, mm.
    pub z: f32,
    /// Lit red, green, blue, 0..1.
    pub color: [f32; 3],
}

/// The renderer's output: the drawn models over nothing. Outside `touched` tiles every plane holds its
/// background; products that were not asked for keep size 0x0.
#[derive(Clone, Debug, Default)]
pub struct Layer {
    /// Shaded color, 0 outside the models.
    pub color: Rgb,
    /// Camera z in mm, +∞ outside the models: `depth < ∞` is the coverage mask.
    pub depth: Plane<f32>,
    /// Unit normal x, y, z in camera space, 0 outside.
    pub normal: [Plane<f32>; 3],
    /// Second-nearest camera z, +∞ where there is none.
    pub depth2: Plane<f32>,
    /// Second-nearest normal, 0 where there is none.
    pub normal2: [Plane<f32>; 3],
    /// Which of the scene's models is nearest, counted from 1; 0 outside the models.
    pub object: Plane<u16>,
    /// Thick outlines of the models: 255 on a visible line, else 0.
    pub silhouette: Plane<u8>,
    /// The secondary models alone, their depth and normal; they are then in no other product.
    pub secondary: Option<Box<Layer>>,
    /// The models' points that face the viewer, far to near; its capacity is the most there can be.
    pub particles: Vec<Particle>,
    /// Nearest and farthest camera z of all drawn models, mm (secondary
    /// ones left out where they are apart); the first is the larger when nothing is drawn.
    pub extent: [f32; 2],
    /// Unit vector towards the light that shaded the models, camera space.
    pub light: Vec3,
    /// Tiles with at least one pixel that is covered, on a line or under a particle, secondary models included.
    pub touched: TileSet,
    /// How the picture divides into those tiles.
    pub grid: Option<TileGrid>,
}
