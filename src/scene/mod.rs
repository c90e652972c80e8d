//! What is wanted: models anchored to markers, their materials, the light.
//!
//! Comes in: the scene file's tables and model files; goes out: a `Scene` that the plan and the renderer
//! read. Nothing here knows about pictures or cameras.

mod boards;
mod builtin;
mod config;
mod edges;
mod glb;
mod load;
mod mesh;
mod mtl;
mod obj;
mod ply;
mod stl;
mod texture;

pub use boards::{BoardConfig, BoardError, PrintConfig};
pub use builtin::{BUILTIN, builtin};
pub use config::{AnchorConfig, LightConfig, ModelConfig, SceneError};
pub use edges::{Edge, Edges, KeptEdges};
pub use load::{Limits, ModelError};
pub use mesh::{Material, Mesh, Wrap};

use crate::marker::{Board, Family, Patterns};
use glam::{DAffine3, DVec3, Vec3};
use std::sync::Arc;

/// Everything that is to be drawn.
#[derive(Clone, Debug, Default)]
pub struct Scene {
    /// The models, anchored each to one marker.
    pub models: Vec<Model>,
    /// The one light.
    pub light: Light,
    /// The picture markers that anchors of [`Family::Pattern`] count.
    pub patterns: Patterns,
    /// The prints that are fixed to one another.
    pub boards: Vec<Board>,
}

/// A mesh on a marker.
#[derive(Clone, Debug)]
pub struct Model {
    /// What it is called in messages and plans.
    pub name: String,
    /// The triangles.
    pub mesh: Arc<Mesh>,
    /// The marker it stands on.
    pub anchor: Anchor,
    /// Mesh coordinates → marker space in mm.
    pub to_marker: DAffine3,
    /// How it is shaded.
    pub shading: Shading,
    /// Whether back faces are dropped.
    pub cull_back: bool,
    /// Whether it is secondary geometry: what is inside, for styles that look through surfaces.
    pub secondary: bool,
    /// Whether it is a stand-in for a real thing: not seen itself, it hides what is behind it.
    pub phantom: bool,
}

/// Which printed marker carries a model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Anchor {
    /// Family of the marker.
    pub family: Family,
    /// Its number; `None` = every marker of the family.
    pub id: Option<u32>,
    /// Printed side of the black border's outer edge, mm.
    pub side_mm: f64,
}

impl Anchor {
    /// Whether it is this marker.
    pub fn takes(&self, family: Family, id: u32) -> bool {
        self.family == family && self.id.is_none_or(|own| own == id)
    }
}

/// How intensity becomes color (contracts: `draw`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shading {
    /// Intensity per vertex, interpolated.
    Smooth,
    /// Intensity of the face normal.
    Flat,
    /// Smooth intensity through a 32-entry ramp of `steps` levels from `base` to 1.
    Toon {
        /// Number of levels, at least 2.
        steps: u32,
        /// Lowest level, 0..1.
        base: f32,
    },
    /// The three steps of Chen, Turk & MacIntyre 2008: the normal is interpolated and made unit length per pixel;
    /// intensity above .7 gives 1, above .2 gives .4, else .1. Ambient light has no part in it.
    ThreeSteps,
}

/// One directional light with an ambient part, in camera space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// Unit vector towards the light, camera space (x right, y down, z forward).
    pub direction: Vec3,
    /// Share of light that reaches every surface, 0..1.
    pub ambient: f32,
    /// What the models' colors are multiplied by: the light's own color, 1 = white.
    pub tint: Vec3,
}

impl Default for Light {
    fn default() -> Self {
        let towards = DVec3::new(-0.4, -0.6, -1.0);
        Self { direction: (towards / towards.length()).as_vec3(), ambient: 0.0, tint: Vec3::ONE }
    }
}
