//! What the last frame was drawn from: a frame that would be the same is not drawn again.

use super::{Camera, Look, Placed};
use crate::scene::{Light, Mesh, Model, Scene, Shading};
use std::sync::Arc;

/// Everything that a frame follows from, and nothing else.
#[derive(Default)]
pub(super) struct Kept {
    view: Option<(Camera, Look, Light)>,
    placed: Vec<Placed>,
    models: Vec<KeptModel>,
}

/// What a frame takes of a model; holds on to the mesh, so that another cannot take its address.
struct KeptModel {
    mesh: Arc<Mesh>,
    shading: Shading,
    cull_back: bool,
    secondary: bool,
    phantom: bool,
}

impl KeptModel {
    fn of(model: &Model) -> Self {
        let Model { shading, cull_back, secondary, phantom, .. } = *model;
        Self { mesh: model.mesh.clone(), shading, cull_back, secondary, phantom }
    }

    fn is(&self, model: &Model) -> bool {
        Arc::ptr_eq(&self.mesh, &model.mesh)
            && self.shading == model.shading
            && (self.cull_back, self.secondary, self.phantom)
                == (model.cull_back, model.secondary, model.phantom)
    }
}

impl Kept {
    /// Whether this frame follows from the same; keeps what it follows from. What is not a number is never the same.
    pub fn same(&mut self, scene: &Scene, placed: &[Placed], camera: &Camera, look: &Look) -> bool {
        let view = Some((*camera, *look, scene.light));
        let models = self.models.len() == scene.models.len()
            && self.models.iter().zip(&scene.models).all(|(kept, model)| kept.is(model));
        if models && self.view == view && self.placed == placed {
            return true;
        }
        self.view = view;
        self.placed.clear();
        self.placed.extend_from_slice(placed);
        if !models {
            self.models.clear();
            self.models.extend(scene.models.iter().map(KeptModel::of));
        }
        false
    }

    /// Makes the next frame another.
    pub fn forget(&mut self) {
        self.view = None;
    }
}
