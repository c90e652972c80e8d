//! The tile rasteriser: models before the lens become a `Layer`.

use crate::frame::{Layer, Needs};
use crate::geometry::Lens;
use crate::pixels::simd::Level;
use crate::scene::Scene;
use glam::DAffine3;

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

/// One model of the scene put before the camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// Index into `Scene::models`.
    pub model: usize,
    /// Mesh coordinates → camera space, mm.
    pub to_camera: DAffine3,
}

/// Draws models; owns every buffer it needs, so that drawing allocates nothing after warm-up.
pub struct Renderer {
    layer: Layer,
}

impl Renderer {
    /// A renderer whose bodies run at `level`.
    pub fn new(_level: Level) -> Self {
        Self { layer: Layer::default() }
    }

    /// Draws the placed models: only the products in `needs`, only the tiles they touch.
    pub fn draw(&mut self, _scene: &Scene, _placed: &[Placed], _camera: &Camera, _needs: Needs) -> &Layer {
        &self.layer
    }
}
