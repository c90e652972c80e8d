//! The scene's part of the settings file, and how it becomes a `Scene`.

use super::{Anchor, Light, Mesh, Model, Scene, Shading};
use crate::marker::{Family, Patterns};
use glam::{DAffine3, DMat3, DVec3, Vec3};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// A `[[model]]` table: one model on one marker.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelConfig {
    /// A built-in model (`teapot`, `spot`) or an OBJ, `.glb`, PLY or STL file, relative to the settings file.
    pub file: String,
    /// The marker it stands on.
    pub marker: AnchorConfig,
    /// Fits the model to the marker: footprint inside the print, lowest point on it. Without, the mesh keeps its
    /// size and its origin is the marker's center.
    #[serde(default = "yes")]
    pub fit: bool,
    /// What one mesh unit is where the model is not fitted: `mm`, `cm`, `m` or `in`. Left out: `m` for a `.glb` file,
    /// as the format says, `mm` for all others.
    #[serde(default)]
    pub unit: Option<Unit>,
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
    /// A stand-in for a real thing on the table: not drawn itself, it hides the models behind it, so that the camera
    /// picture shows in their place.
    #[serde(default)]
    pub phantom: bool,
}

/// Which printed marker: a code of a family, or a picture of one's own.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AnchorConfig {
    /// Marker family; `tag36h11` if left out.
    #[serde(default)]
    pub family: Option<Family>,
    /// Its number in the family; left out, the model stands on every marker of the family.
    #[serde(default)]
    pub id: Option<u32>,
    /// Instead of family and id: a `.patt` file of ARToolKit, relative to the settings file.
    #[serde(default)]
    pub pattern: Option<PathBuf>,
    /// Correlation with the pattern's picture that is enough, 0.5 to 0.95; 0.7 if left out.
    #[serde(default)]
    pub least_match: Option<f64>,
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

/// What one unit of a mesh's coordinates is.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Unit {
    /// A millimetre.
    Mm,
    /// A centimetre.
    Cm,
    /// A metre.
    M,
    /// An inch, 25.4 mm.
    In,
}

impl Unit {
    fn mm(self) -> f64 {
        match self {
            Unit::Mm => 1.0,
            Unit::Cm => 10.0,
            Unit::M => 1000.0,
            Unit::In => 25.4,
        }
    }
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

impl ModelConfig {
    /// A model on a marker, everything else as where a settings file leaves it out.
    pub fn new(file: String, marker: AnchorConfig) -> Self {
        Self {
            file,
            marker,
            fit: yes(),
            unit: None,
            up: Up::default(),
            scale: one(),
            rotate_deg: [0.0; 3],
            translate_mm: [0.0; 3],
            color: None,
            texture: None,
            shading: ShadingConfig::default(),
            toon_steps: four(),
            toon_base: quarter(),
            cull_back: false,
            secondary: false,
            phantom: false,
        }
    }
}

impl AnchorConfig {
    /// A marker of a family, or each of them.
    pub fn new(family: Option<Family>, id: Option<u32>, side_mm: Option<f64>) -> Self {
        Self { family, id, pattern: None, least_match: None, side_mm: side_mm.unwrap_or_else(eighty) }
    }
}

impl Scene {
    /// Loads the models; paths are relative to `folder`.
    pub fn build(models: &[ModelConfig], light: &LightConfig, folder: &Path) -> Result<Scene, SceneError> {
        let mut scene = Scene { light: light.to_light(), ..Scene::default() };
        for (index, config) in models.iter().enumerate() {
            let fail = |reason| SceneError { number: index + 1, file: config.file.clone(), reason };
            let model = config.build(folder, &mut scene.patterns).map_err(fail)?;
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

impl AnchorConfig {
    fn build(&self, folder: &Path, patterns: &mut Patterns) -> Result<Anchor, String> {
        let side_mm = self.side_mm;
        if let Some(pattern) = &self.pattern {
            if self.family.is_some() || self.id.is_some() {
                return Err("a marker has a `pattern`, or a `family` and an `id`: not both".into());
            }
            let least_match = self.least_match.unwrap_or(Patterns::LEAST_MATCH);
            let id = patterns.load(&folder.join(pattern), least_match).map_err(|e| e.to_string())?;
            return Ok(Anchor { family: Family::Pattern, id: Some(id), side_mm });
        }
        if self.least_match.is_some() {
            return Err("marker.least_match is for a `pattern`: codes are read bit by bit".into());
        }
        let family = self.family.unwrap_or(Family::Tag36h11);
        let (name, codes) = (family.name(), family.codes().len());
        match self.id {
            Some(id) if id as usize >= codes => {
                Err(format!("marker.id = {id}: {name} has ids 0 to {}", codes - 1))
            }
            id => Ok(Anchor { family, id, side_mm }),
        }
    }
}

impl ModelConfig {
    fn build(&self, folder: &Path, patterns: &mut Patterns) -> Result<Model, String> {
        let positive = |value: f64, name: &str| {
            let good = value.is_finite() && value > 0.0;
            good.then_some(()).ok_or(format!("{name} = {value}: give a number above 0"))
        };
        positive(self.scale, "scale")?;
        positive(self.marker.side_mm, "marker.side_mm")?;
        let anchor = self.marker.build(folder, patterns)?;
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
            anchor,
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
            phantom: self.phantom,
        })
    }

    fn load(&self, folder: &Path) -> Result<Mesh, String> {
        match super::builtin(&self.file) {
            Some(mesh) => Ok(mesh),
            None => Mesh::load(&folder.join(&self.file)).map_err(|e| {
                format!(
                    "{e}; `file` is an OBJ, .glb, PLY or STL file or one of the built-in models: {}",
                    super::BUILTIN.join(", ")
                )
            }),
        }
    }

    /// Mesh coordinates → marker space: stand up, fit or take to mm, scale, turn, shift.
    fn to_marker(&self, mesh: &Mesh) -> DAffine3 {
        let stand = match self.up {
            Up::Z => DMat3::IDENTITY,
            // mesh x right, y up, z to the viewer → marker x right, z up, -y to the viewer
            Up::Y => DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y),
        };
        let is_glb = Path::new(&self.file).extension().is_some_and(|e| e.eq_ignore_ascii_case("glb"));
        let unit = self.unit.unwrap_or(if is_glb { Unit::M } else { Unit::Mm });
        let mut fit = DAffine3::from_mat3(stand * unit.mm());
        if self.fit {
            let (low, high) = mesh.bounds().unwrap_or_default();
            let corners = [low, high].map(|p| stand * p.as_dvec3());
            let (low, high) = (corners[0].min(corners[1]), corners[0].max(corners[1]));
            let extent = (high - low).truncate().max_element();
            if extent.is_finite() && extent > 0.0 {
                let base = DVec3::new((low.x + high.x) / 2.0, (low.y + high.y) / 2.0, low.z);
                let size = self.marker.side_mm / extent;
                let stand = DAffine3::from_mat3(stand);
                fit = DAffine3::from_scale(DVec3::splat(size)) * DAffine3::from_translation(-base) * stand;
            }
        }
        let [x, y, z] = self.rotate_deg.map(f64::to_radians);
        let turn = DMat3::from_rotation_z(z) * DMat3::from_rotation_y(y) * DMat3::from_rotation_x(x);
        DAffine3 { matrix3: turn * self.scale, translation: DVec3::from(self.translate_mm) } * fit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_count_where_nothing_is_fitted() {
        let mesh = Mesh { positions: vec![Vec3::Y], ..Mesh::default() };
        let tip = |text: &str| {
            let text = format!("marker = {{}}\nfit = false\n{text}");
            let model: ModelConfig = toml::from_str(&text).expect("a valid model table");
            model.to_marker(&mesh).transform_point3(DVec3::Y)
        };
        assert_eq!(tip("file = \"a.obj\""), DVec3::Z);
        assert_eq!(tip("file = \"a.stl\"\nup = \"z\"\nunit = \"in\""), DVec3::Y * 25.4);
        assert_eq!(tip("file = \"a.GLB\""), DVec3::Z * 1000.0);
        assert_eq!(tip("file = \"a.glb\"\nunit = \"cm\"\nscale = 2"), DVec3::Z * 20.0);
        let fitted = "file = \"teapot\"\nmarker = {}\nunit = \"m\"";
        let fitted: ModelConfig = toml::from_str(fitted).expect("a valid model table");
        let (teapot, plain) = (
            crate::scene::builtin("teapot").expect("built in"),
            ModelConfig { unit: None, ..fitted.clone() },
        );
        assert_eq!(fitted.to_marker(&teapot), plain.to_marker(&teapot));
    }

    fn build(marker: &str, folder: &Path) -> Result<Scene, String> {
        let model =
            toml::from_str(&format!("file = \"teapot\"\nmarker = {marker}")).map_err(|e| e.to_string())?;
        Scene::build(&[model], &LightConfig::default(), folder).map_err(|e| e.to_string())
    }

    #[test]
    fn a_marker_is_named_by_family_or_by_pattern() {
        let folder = Path::new("tests/data/markers");
        let anchor = |marker| build(marker, folder).expect("a scene").models[0].anchor;
        let plain = Anchor { family: Family::Tag36h11, id: None, side_mm: 80.0 };
        assert_eq!(anchor("{}"), plain);
        let other = Anchor { family: Family::Aruco7x7_1000, id: Some(999), side_mm: 30.0 };
        assert_eq!(anchor("{ family = \"aruco_7x7_1000\", id = 999, side_mm = 30 }"), other);
        let scene = build("{ pattern = \"leaf.patt\", side_mm = 50 }", folder).expect("a scene");
        let own = Anchor { family: Family::Pattern, id: Some(0), side_mm: 50.0 };
        assert_eq!((scene.models[0].anchor, scene.patterns.len()), (own, 1));
        for (marker, says) in [
            ("{ pattern = \"leaf.patt\", id = 3 }", "not both"),
            ("{ pattern = \"none.patt\" }", "none.patt: cannot read"),
            ("{ pattern = \"duckietown_240x216.png\" }", "not a pattern of ARToolKit"),
            ("{ pattern = \"leaf.patt\", least_match = 0.2 }", "least_match = 0.2: give"),
            ("{ id = 3, least_match = 0.8 }", "for a `pattern`"),
            ("{ family = \"aruco_original\", id = 1023 }", "aruco_original has ids 0 to 1022"),
            ("{ family = \"tag25h8\" }", "did you mean `tag25h9`"),
        ] {
            let error = build(marker, folder).expect_err(marker);
            assert!(error.contains(says), "{marker}: {error}");
        }
    }
}
