//! The scene's part of the settings file, and how it becomes a `Scene`.

use super::{Anchor, Light, Mesh, Model, Scene, Shading};
use crate::marker::Family;
use glam::{DAffine3, DMat3, DVec3, Vec3};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// A `[[model]]` table: one model on one marker.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelConfig {
    /// A built-in model (`teapot`, `spot`) or an OBJ file, relative to the settings file.
    pub file: String,
    /// The marker it stands on.
    pub marker: AnchorConfig,
    /// Fits the model to the marker: footprint inside the print, lowest point on it. Without, mesh units are
    /// millimetres and the mesh's origin is the marker's center.
    #[serde(default = "yes")]
    pub fit: bool,
    /// Which mesh axis points out of the print.
    #[serde(default)]
    pub up: Up,
    /// Factor on the (fitted) size, > 0.
    #[serde(default = "one")]
    pub scale: f64,
    /// Turns about the marker's x, then y, then z axis, degrees.
    #[serde(default)]
    pub rotate_deg: [f64; 3],
    /// Shift along the marker's x (right), y (up), z (out of the print), mm.
    #[serde(default)]
    pub translate_mm: [f64; 3],
    /// Replaces the material colors: sRGB 0..1.
    #[serde(default)]
    pub color: Option<[f32; 3]>,
    /// Replaces the material textures: a picture file, relative to the settings file.
    #[serde(default)]
    pub texture: Option<PathBuf>,
    /// How intensity becomes color.
    #[serde(default)]
    pub shading: ShadingConfig,
    /// Levels of the toon ramp, 2..32.
    #[serde(default = "four")]
    pub toon_steps: u32,
    /// Lowest level of the toon ramp, 0..1.
    #[serde(default = "quarter")]
    pub toon_base: f32,
    /// Leaves out back faces; only for closed models.
    #[serde(default)]
    pub cull_back: bool,
    /// Secondary geometry: what is inside other models. Styles that look through surfaces (illustrative) draw it in a
    /// color of its own and always visibly; the others as any model.
    #[serde(default)]
    pub secondary: bool,
}

/// Which printed marker.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AnchorConfig {
    /// Marker family.
    #[serde(default = "tag36h11")]
    pub family: Family,
    /// Its number in the family; left out, the model stands on every marker of the family.
    #[serde(default)]
    pub id: Option<u32>,
    /// Printed side of the black border's outer edge, mm, > 0.
    #[serde(default = "eighty")]
    pub side_mm: f64,
}

/// The `[light]` table.
#[derive(Clone, Copy, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LightConfig {
    /// Direction towards the light in camera space: x right, y down, z away from the viewer.
    pub direction: [f32; 3],
    /// Share of light that reaches every surface, 0..1.
    pub ambient: f32,
}

impl Default for LightConfig {
    fn default() -> Self {
        Self { direction: [-0.4, -0.6, -1.0], ambient: 0.25 }
    }
}

/// A mesh axis.
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Up {
    /// Mesh y is up (most OBJ files).
    #[default]
    Y,
    /// Mesh z is up.
    Z,
}

/// Names of [`Shading`].
#[derive(Clone, Copy, Debug, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ShadingConfig {
    /// Interpolated over the surface.
    #[default]
    Smooth,
    /// One intensity a face.
    Flat,
    /// A few levels.
    Toon,
}

fn yes() -> bool {
    true
}
fn one() -> f64 {
    1.0
}
fn four() -> u32 {
    4
}
fn quarter() -> f32 {
    0.25
}
fn eighty() -> f64 {
    80.0
}
fn tag36h11() -> Family {
    Family::Tag36h11
}

/// Why a scene cannot be built; names the model's table.
#[derive(Debug, thiserror::Error)]
#[error("[[model]] number {number} ({file}): {reason}")]
pub struct SceneError {
    /// Which `[[model]]` table, counted from 1.
    pub number: usize,
    /// What its `file` says.
    pub file: String,
    /// What is wrong and what to do.
    pub reason: String,
}

impl Scene {
    /// Loads the models; paths are relative to `folder`.
    pub fn build(models: &[ModelConfig], light: &LightConfig, folder: &Path) -> Result<Scene, SceneError> {
        let mut scene = Scene { models: Vec::new(), light: light.to_light() };
        for (index, config) in models.iter().enumerate() {
            let fail = |reason| SceneError { number: index + 1, file: config.file.clone(), reason };
            let model = config.build(folder).map_err(fail)?;
            let same = |m: &&Model| (m.anchor.family, m.anchor.id) == (model.anchor.family, model.anchor.id);
            if let Some(first) = scene.models.iter().find(same).filter(|m| m.anchor != model.anchor) {
                let (one, other) = (first.anchor.side_mm, model.anchor.side_mm);
                return Err(fail(format!(
                    "its marker is {other} mm wide here and {one} mm for an earlier model: a print has one side_mm"
                )));
            }
            scene.models.push(model);
        }
        Ok(scene)
    }
}

impl LightConfig {
    /// A direction that is zero or not finite shines from the viewer.
    fn to_light(self) -> Light {
        let direction = Vec3::from(self.direction).try_normalize().unwrap_or(Vec3::NEG_Z);
        Light { direction, ambient: self.ambient.clamp(0.0, 1.0), ..Light::default() }
    }
}

impl ModelConfig {
    fn build(&self, folder: &Path) -> Result<Model, String> {
        let positive = |value: f64, name: &str| {
            let good = value.is_finite() && value > 0.0;
            good.then_some(()).ok_or(format!("{name} = {value}: give a number above 0"))
        };
        positive(self.scale, "scale")?;
        positive(self.marker.side_mm, "marker.side_mm")?;
        let (family, codes) = (self.marker.family.name(), self.marker.family.codes().len());
        if let Some(id) = self.marker.id.filter(|&id| id as usize >= codes) {
            return Err(format!("marker.id = {id}: {family} has ids 0 to {}", codes - 1));
        }
        let finite = |values: &[f64; 3]| values.iter().all(|v| v.is_finite());
        if !finite(&self.rotate_deg) || !finite(&self.translate_mm) {
            return Err("rotate_deg and translate_mm must be finite numbers".into());
        }
        let mut mesh = self.load(folder)?;
        if let Some(color) = self.color {
            mesh.set_color(Vec3::from(color).clamp(Vec3::ZERO, Vec3::ONE));
        }
        if let Some(path) = &self.texture {
            let texture = crate::pixels::picture::read(&folder.join(path)).map_err(|e| e.to_string())?;
            mesh.set_texture(std::sync::Arc::new(texture));
        }
        let to_marker = self.to_marker(&mesh);
        Ok(Model {
            name: self.file.clone(),
            mesh: mesh.into(),
            anchor: Anchor { family: self.marker.family, id: self.marker.id, side_mm: self.marker.side_mm },
            to_marker,
            shading: match self.shading {
                ShadingConfig::Smooth => Shading::Smooth,
                ShadingConfig::Flat => Shading::Flat,
                ShadingConfig::Toon => Shading::Toon {
                    steps: self.toon_steps.clamp(2, 32),
                    base: self.toon_base.clamp(0.0, 1.0),
                },
            },
            cull_back: self.cull_back,
            secondary: self.secondary,
        })
    }

    fn load(&self, folder: &Path) -> Result<Mesh, String> {
        match super::builtin(&self.file) {
            Some(mesh) => Ok(mesh),
            None => Mesh::load(&folder.join(&self.file)).map_err(|e| {
                format!(
                    "{e}; `file` is an OBJ file or one of the built-in models: {}",
                    super::BUILTIN.join(", ")
                )
            }),
        }
    }

    /// Mesh coordinates → marker space: stand up, fit, scale, turn, shift.
    fn to_marker(&self, mesh: &Mesh) -> DAffine3 {
        let stand = match self.up {
            Up::Z => DMat3::IDENTITY,
            // mesh x right, y up, z to the viewer → marker x right, z up, -y to the viewer
            Up::Y => DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y),
        };
        let mut fit = DAffine3::from_mat3(stand);
        if self.fit {
            let (low, high) = mesh.bounds().unwrap_or_default();
            let corners = [low, high].map(|p| stand * p.as_dvec3());
            let (low, high) = (corners[0].min(corners[1]), corners[0].max(corners[1]));
            let extent = (high - low).truncate().max_element();
            if extent.is_finite() && extent > 0.0 {
                let base = DVec3::new((low.x + high.x) / 2.0, (low.y + high.y) / 2.0, low.z);
                let size = self.marker.side_mm / extent;
                fit = DAffine3::from_scale(DVec3::splat(size)) * DAffine3::from_translation(-base) * fit;
            }
        }
        let [x, y, z] = self.rotate_deg.map(f64::to_radians);
        let turn = DMat3::from_rotation_z(z) * DMat3::from_rotation_y(y) * DMat3::from_rotation_x(x);
        DAffine3 { matrix3: turn * self.scale, translation: DVec3::from(self.translate_mm) } * fit
    }
}
