//! Settings of the sketchy style.

use super::paper::Paper;
use super::starts::StartsFile;
use crate::kernel::gaussian::MAX_SIGMA;
use crate::style::brush::BrushFile;
use crate::style::{ConfigError, StyleName};
use serde::{Deserialize, Serialize};

/// How strokes are drawn (section 3.3).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Renderer {
    /// Strips of lines of one width and opacity.
    #[default]
    Lines,
    /// Strips of quads with a brush texture, fading along the stroke.
    Polygons,
    /// Lone brush prints that live for some frames and wander along the silhouette.
    Sprites,
}

/// Settings of the sketchy style; the paper's where it gives them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Gradient of the camera picture's red above which a pixel is an edge, 0 to 2. Default 0.12.
    pub threshold: f64,
    /// Gradient of the models' depth, in parts of their depth extent, above which a pixel is an edge, 0 to 2.
    /// Default 0.05.
    pub depth_threshold: f64,
    /// Whether a slanted flat surface of a model is never an edge, however steep (the paper's Fig. 7). Default
    /// true.
    pub slope_guard: bool,
    /// Sigma of the blur, px, 0.3 to 16; it reaches three sigma. Default 3.
    pub sigma: f64,
    /// Candidate strokes a pixel, 0 to 1. Default 0.13.
    pub density: f64,
    /// Distance from one point of a stroke to the next, px, 0.25 to 16. Default 2.
    pub step: f64,
    /// Points a stroke has at most, its start included, 2 to 64. Default 12.
    pub points: u32,
    /// Half the width of a stroke, px, 0 to 16. Default 1.
    pub half_width: f64,
    /// How much wider a model's nearest strokes are, and its farthest narrower, as a share of the width, 0 to 1.
    /// Default 0.
    pub depth_width: f64,
    /// Opacity of a stroke, 0 to 1. Default 0.5.
    pub opacity: f64,
    /// How strokes are drawn: "lines", "polygons" or "sprites". Default "lines".
    pub renderer: Renderer,
    /// Opacity that polygons lose from their first point to their last, 0 to 1. Default 0.8.
    pub fade: f64,
    /// Frames that a sprite lives, 1 to 1000. Default 12.
    pub lifetime: u32,
    /// A gray picture of the brush for polygons (along the stroke from left to right) and sprites, white being
    /// opaque; relative to the working directory. Default "" (built in).
    pub brush: BrushFile,
    /// Seed of where strokes begin, 0 to 2^63 - 1. Default 20051002.
    pub seed: u64,
    /// Whether strokes begin elsewhere in every frame, as in the paper, in place of keeping still. Default false.
    pub lively: bool,
    /// A .npy file of starts (N x 2, x and y in px, pixel centers at integers) in place of random ones; relative
    /// to the working directory. Default "" (random).
    pub starts: StartsFile,
    /// Paper under the picture: true (built in), false, or a gray picture that is tiled from the top left;
    /// relative to the working directory. Default true.
    pub paper: Paper,
    /// Whether the picture colors the paper; else the paper is white. Default true.
    pub color: bool,
    /// Whether the picture is blurred. Default true.
    pub blur: bool,
    /// Whether strokes are drawn. Default true.
    pub strokes: bool,
    /// Whether a sketched border is drawn around the picture. Default false.
    pub border: bool,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            threshold: 0.12,
            depth_threshold: 0.05,
            slope_guard: true,
            sigma: 3.0,
            density: 0.13,
            step: 2.0,
            points: 12,
            half_width: 1.0,
            depth_width: 0.0,
            opacity: 0.5,
            renderer: Renderer::Lines,
            fade: 0.8,
            lifetime: 12,
            brush: BrushFile::default(),
            seed: 20051002,
            lively: false,
            starts: StartsFile::default(),
            paper: Paper::default(),
            color: true,
            blur: true,
            strokes: true,
            border: false,
        }
    }
}

impl Config {
    /// Checks every setting against its range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let check = |key, value: f64, fine: bool, expected| match fine {
            true => Ok(()),
            false => Err(ConfigError::Range { style: StyleName::Sketchy, key, value, expected }),
        };
        for (key, value) in [("threshold", self.threshold), ("depth_threshold", self.depth_threshold)] {
            check(key, value, (0.0..=2.0).contains(&value), "0 to 2")?;
        }
        for (key, value) in [
            ("density", self.density),
            ("depth_width", self.depth_width),
            ("opacity", self.opacity),
            ("fade", self.fade),
        ] {
            check(key, value, (0.0..=1.0).contains(&value), "a number from 0 to 1")?;
        }
        check("sigma", self.sigma, (0.3..=MAX_SIGMA).contains(&self.sigma), "0.3 to 16 pixels")?;
        check("step", self.step, (0.25..=16.0).contains(&self.step), "0.25 to 16 pixels")?;
        check("points", self.points.into(), (2..=64).contains(&self.points), "2 to 64")?;
        let half = self.half_width;
        check("half_width", half, (0.0..=16.0).contains(&half), "0 to 16 pixels")?;
        let lifetime = self.lifetime;
        check("lifetime", lifetime.into(), (1..=1000).contains(&lifetime), "1 to 1000 frames")?;
        check("seed", self.seed as f64, self.seed <= i64::MAX as u64, "0 to 2^63 - 1")
    }

    /// Half the width of a stroke whose object is this near: 1 its nearest, -1 its farthest point, 0 elsewhere.
    pub(super) fn half_width_at(&self, nearness: f64) -> f64 {
        self.half_width * (1.0 + self.depth_width * nearness)
    }
}
