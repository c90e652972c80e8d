//! Bilateral cartoon and sketch-like: the first stylization filter for augmented reality, on the CPU.
//!
//! J. Fischer, *Rendering Methods for Augmented Reality* (2006), section 3.2. The camera picture alone is filtered;
//! the models are drawn over it with a toon ramp and thick outlines (section 3.2.2). Per frame:
//!
//! 1. `levels` levels down the Gaussian pyramid;
//! 2. `iterations` bilateral steps on the smallest level: flat colors;
//! 3. back up to full size;
//! 4. Canny's edges of the camera picture, thickened by one 3x3 dilation;
//! 5. black on the edges: AND with their inverse;
//! 6. the models' color over that, then their silhouettes, black.
//!
//! Sketch-like is the inverted edges alone, models white with black silhouettes. Edges are connected on one thread while the others filter colors.

mod finish;
mod reference;
mod sketch;

pub use reference::{reference, sketch_reference};
pub use sketch::{Lines, SketchLike};

use super::{ConfigError, Style, StyleInput, StyleName, composite};
use crate::frame::Needs;
use crate::kernel::bilateral::Bilateral;
use crate::kernel::canny::Canny;
use crate::kernel::pyramid::{self, Down, Up};
use crate::pixels::simd::Level;
use crate::pixels::{Plane, Rgb, Size};
use crate::render::Look;
use crate::scene::Shading;
use finish::Finish;
use serde::{Deserialize, Serialize};

/// Settings of the bilateral cartoon style; the thresholds are the thesis's (Fig. 3.8), as are two levels and two
/// iterations (Table 3.2).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Levels of the Gaussian pyramid, each half as wide and high, 1 to 8; more is faster and blurrier. Default 2.
    pub levels: u32,
    /// Bilateral filter steps on the smallest level, 0 to 100. Default 2.
    pub iterations: u32,
    /// Standard deviation of the spatial weight, pixels of the smallest level, 0.1 to 100; the window is 9x9.
    /// Default 2.
    pub sigma_d: f32,
    /// Standard deviation of the color weight, Euclidean distance in RGB of 0..1, 0.001 to 10; larger is flatter.
    /// Default 0.1.
    pub sigma_r: f32,
    /// Gradient (|gx| + |gy| by Sobel, of gray bytes) above which a pixel is surely an edge, 0 to 2040, whole
    /// numbers. Default 150.
    pub t1: f32,
    /// Gradient above which a pixel that touches an edge is one too, 0 to `t1`. Default 105.
    pub t2: f32,
    /// Levels of the models' toon ramp, 2 to 32. Default 4.
    pub toon_steps: u32,
    /// Lowest level of the models' toon ramp, 0 to 1. Default 0.25.
    pub toon_base: f32,
    /// Width of the models' silhouette lines, px, 1 to 16. Default 3.
    pub line_width: f32,
}

impl Default for Config {
    fn default() -> Self {
        let Lines { t1, t2, line_width } = Lines::default();
        Self {
            levels: 2,
            iterations: 2,
            sigma_d: 2.0,
            sigma_r: 0.1,
            t1,
            t2,
            toon_steps: 4,
            toon_base: 0.25,
            line_width,
        }
    }
}

impl Config {
    /// Checks every setting against its range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let check = |key, value: f32, fine: bool, expected| match fine {
            true => Ok(()),
            false => {
                let (style, value) = (StyleName::BilateralCartoon, value.into());
                Err(ConfigError::Range { style, key, value, expected })
            }
        };
        check("levels", self.levels as f32, (1..=8).contains(&self.levels), "1 to 8")?;
        check("iterations", self.iterations as f32, self.iterations <= 100, "0 to 100")?;
        check("sigma_d", self.sigma_d, (0.1..=100.0).contains(&self.sigma_d), "0.1 to 100")?;
        check("sigma_r", self.sigma_r, (0.001..=10.0).contains(&self.sigma_r), "0.001 to 10")?;
        check("toon_steps", self.toon_steps as f32, (2..=32).contains(&self.toon_steps), "2 to 32")?;
        check("toon_base", self.toon_base, (0.0..=1.0).contains(&self.toon_base), "0 to 1")?;
        self.lines().validate_for(StyleName::BilateralCartoon)
    }

    /// The settings of its edges and silhouettes.
    pub fn lines(&self) -> Lines {
        Lines { t1: self.t1, t2: self.t2, line_width: self.line_width }
    }
}

/// The style with its buffers.
pub struct BilateralCartoon {
    config: Config,
    level: Level,
    canny: Canny,
    colors: Colors,
    finish: Finish,
}

/// Steps 1 to 3 but for the last level up.
#[derive(Default)]
struct Colors {
    /// R, G, B of each level, the largest (half the picture) first.
    pyramid: Vec<[Plane<f32>; 3]>,
    bilateral: Bilateral,
    down: Down,
    up: Up,
}

/// The intermediate planes of one frame, for inspection.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stages {
    /// The smallest level before filtering: R, G, B in 0..1.
    pub pyramid: [Plane<f32>; 3],
    /// The smallest level after filtering.
    pub filtered: [Plane<f32>; 3],
    /// Dilated edges, 0 or 1, frame size.
    pub edges: Plane<f32>,
}

impl BilateralCartoon {
    /// The style with these settings (see [`Config::validate`]), its bodies at `level`.
    pub fn new(config: Config, level: Level) -> Self {
        let (canny, colors, finish) = (Canny::default(), Colors::default(), Finish::default());
        Self { config, level, canny, colors, finish }
    }

    /// The intermediate planes of one frame, computed anew; the picture goes to `out` as in [`Style::draw`]. It
    /// allocates.
    pub fn stages(&mut self, input: StyleInput<'_>, out: &mut Rgb) -> Stages {
        self.draw(input, out);
        let size = out.size();
        let mut stages = Stages { edges: edges(&self.canny, size), ..Stages::default() };
        if size.area() > 0 {
            let mut colors = Colors::default();
            colors.descend(self.level, &input.frame.color, self.config.levels as usize);
            stages.pyramid = colors.pyramid.last().cloned().unwrap_or_default();
            colors.filter(self.level, &self.config);
            stages.filtered = colors.pyramid.last().cloned().unwrap_or_default();
        }
        stages
    }
}

impl Style for BilateralCartoon {
    fn look(&self) -> Look {
        let Config { toon_steps: steps, toon_base: base, line_width, .. } = self.config;
        Look {
            needs: Needs::COLOR.and(Needs::SILHOUETTE),
            shading: Some(Shading::Toon { steps, base }),
            line_width: line_width.into(),
            ..Look::default()
        }
    }

    fn draw(&mut self, input: StyleInput<'_>, out: &mut Rgb) {
        let picture = &input.frame.color;
        out.resize(picture.size());
        if picture.size().area() > 0 {
            let (level, config) = (self.level, &self.config);
            let (canny, colors) = (&mut self.canny, &mut self.colors);
            let [low, high] = config.lines().thresholds();
            canny.mark(level, picture, low, high);
            colors.descend(level, picture, config.levels as usize);
            rayon::join(|| colors.filter(level, config), || canny.connect());
            colors.ascend(level);
            self.finish.draw(level, &colors.pyramid[0], canny, out);
        }
        if let Some(layer) = input.layer {
            composite::over(layer, out);
            composite::outline(layer, out);
        }
    }
}

impl Colors {
    /// Builds the pyramid of a picture that is not empty.
    fn descend(&mut self, level: Level, picture: &Rgb, levels: usize) {
        self.pyramid.resize_with(levels.max(1), Default::default);
        for (from, to) in picture.planes.iter().zip(&mut self.pyramid[0]) {
            self.down.run(level, from.view(), to);
        }
        for i in 1..self.pyramid.len() {
            let (above, below) = self.pyramid.split_at_mut(i);
            for (from, to) in above[i - 1].iter().zip(&mut below[0]) {
                self.down.run(level, from.view(), to);
            }
        }
    }

    /// Filters the smallest level.
    fn filter(&mut self, level: Level, config: &Config) {
        if let Some(smallest) = self.pyramid.last_mut() {
            for _ in 0..config.iterations {
                self.bilateral.step(level, config.sigma_d, config.sigma_r, smallest);
            }
        }
    }

    /// Enlarges level by level, up to half the picture's size.
    fn ascend(&mut self, level: Level) {
        for i in (1..self.pyramid.len()).rev() {
            let (above, below) = self.pyramid.split_at_mut(i);
            for (from, to) in below[0].iter().zip(&mut above[i - 1]) {
                let size = to.size();
                debug_assert_eq!(pyramid::half(size), from.size());
                self.up.run(level, from, size, to);
            }
        }
    }
}

/// The dilated edges as a plane of 0 and 1.
fn edges(canny: &Canny, size: Size) -> Plane<f32> {
    let mut row = vec![0; size.width];
    let mut edges = Plane::new(size, 0.0);
    for y in 0..size.height {
        canny.inverted_row(y, &mut row);
        edges.row_mut(y).iter_mut().zip(&row).for_each(|(to, &v)| *to = f32::from(u8::from(v == 0)));
    }
    edges
}
