//! The cartoon style (Fischer & Bartz 2005, "Real-time Cartoon-like Stylization of AR Video Streams on the GPU";
//! Fischer 2006, section 3.3): one filter over the whole augmented picture.
//!
//! 1. The camera picture with the models over it shrinks by exact area average (`kernel::area`).
//! 2. Seven photometric steps on YUV flatten its colors (`photometric`): the simplified picture S.
//! 3. On the shrunk grid S becomes RGB and six Sobel gradients (`grid`).
//! 4. One pass over the output rows (`finish`) enlarges those, takes the gradients' magnitudes (eq. 4), adds
//!    the full-resolution edges, turns both into line strength I (eq. 5) and writes S·(1 - I).
//!
//! Nothing of a frame is kept for the next: the same picture always gives the same bytes.

mod finish;
mod grid;
mod reference;

pub use reference::reference;

use super::{ConfigError, Style, StyleInput, StyleName, composite};
use crate::kernel::area::Shrink;
use crate::kernel::{color, photometric};
use crate::pixels::simd::Level;
use crate::pixels::{Plane, Rgb, Size};
use finish::Finish;
use grid::Grid;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Settings of the cartoon style; the defaults are the paper's (Fig. 4 to 6).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Width of the shrunk picture, px; 0 derives it from the frame (240 at 640x480): the frame's aspect at the
    /// shrunk height. At most the frame's width. Default 0.
    pub shrunk_width: u32,
    /// Height of the shrunk picture, px; 0 derives it from the frame (180 at 640x480): 3/8 of its height, at most
    /// 180. At most the frame's height. Default 0.
    pub shrunk_height: u32,
    /// Standard deviation of the photometric weight in UV units, 0.001 to 10; larger is flatter. Default 0.025.
    pub sigma_p: f32,
    /// Photometric filter steps, 0 to 100. Default 7.
    pub steps: u32,
    /// Share of color contrast (against brightness contrast) in an edge, 0 to 1. Default 0.3.
    pub alpha: f32,
    /// Share of the full-resolution picture's edges (against the simplified picture's) in a line, 0 to 1.
    /// Default 0.3.
    pub beta: f32,
    /// Edge response of the simplified picture where lines begin, 0 or more, below `s1`. Default 0.054.
    pub s0: f32,
    /// Edge response of the simplified picture where lines are full. Default 0.064.
    pub s1: f32,
    /// Edge response of the full-resolution picture where lines begin, 0 or more, below `a1`. Default 0.3.
    pub a0: f32,
    /// Edge response of the full-resolution picture where lines are full. Default 0.7.
    pub a1: f32,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            shrunk_width: 0,
            shrunk_height: 0,
            sigma_p: 0.025,
            steps: 7,
            alpha: 0.3,
            beta: 0.3,
            s0: 0.054,
            s1: 0.064,
            a0: 0.3,
            a1: 0.7,
        }
    }
}

impl Config {
    /// Checks every setting against its range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let check = |key, value: f64, fine: bool, expected| match fine {
            true => Ok(()),
            false => Err(ConfigError::Range { style: StyleName::Cartoon, key, value, expected }),
        };
        let unit =
            |key, value: f32| check(key, value.into(), (0.0..=1.0).contains(&value), "a number from 0 to 1");
        let side = |key, value: u32| {
            check(key, value.into(), value <= 65_535, "0 (derived from the frame) to 65535 pixels")
        };
        side("shrunk_width", self.shrunk_width)?;
        side("shrunk_height", self.shrunk_height)?;
        check("sigma_p", self.sigma_p.into(), (0.001..=10.0).contains(&self.sigma_p), "0.001 to 10")?;
        check("steps", self.steps.into(), self.steps <= 100, "0 to 100")?;
        unit("alpha", self.alpha)?;
        unit("beta", self.beta)?;
        for (low, high, from, to, rule) in [
            ("s0", "s1", self.s0, self.s1, "0 or more and below s1"),
            ("a0", "a1", self.a0, self.a1, "0 or more and below a1"),
        ] {
            check(high, to.into(), to.is_finite() && to <= 100.0, "at most 100")?;
            check(low, from.into(), from >= 0.0 && from < to, rule)?;
        }
        Ok(())
    }

    /// Size of the shrunk picture for frames of `frame` (at least 1x1).
    pub fn shrunk(&self, frame: Size) -> Size {
        let height = match self.shrunk_height {
            0 => ((frame.height as f64 * 0.375 + 0.5) as usize).min(180),
            rows => rows as usize,
        };
        let height = height.clamp(1, frame.height.max(1));
        let width = match self.shrunk_width {
            0 => (frame.width as f64 * height as f64 / frame.height.max(1) as f64 + 0.5) as usize,
            columns => columns as usize,
        };
        Size::new(width.clamp(1, frame.width.max(1)), height)
    }
}

/// The style with its buffers.
pub struct Cartoon {
    config: Config,
    level: Level,
    canvas: Rgb,
    shrinks: [Shrink; 3],
    small: [Plane<f32>; 3],
    simple: [Plane<f32>; 3],
    other: [Plane<f32>; 3],
    grid: Grid,
    finish: Finish,
}

/// The intermediate planes of one frame, for inspection.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stages {
    /// The shrunk picture: R, G, B in 0..1.
    pub small: [Plane<f32>; 3],
    /// The simplified picture: R, G, B in 0..1, as large as `small`.
    pub simplified: [Plane<f32>; 3],
    /// Edge response of the simplified picture, frame size (eq. 4).
    pub edge_s: Plane<f32>,
    /// Edge response of the augmented picture, frame size (eq. 4).
    pub edge_a: Plane<f32>,
    /// Line strength 0..1, frame size (eq. 5).
    pub lines: Plane<f32>,
}

impl Cartoon {
    /// The style with these settings (see [`Config::validate`]), its bodies at `level`.
    pub fn new(config: Config, level: Level) -> Self {
        Self {
            config,
            level,
            canvas: Rgb::default(),
            shrinks: Default::default(),
            small: Default::default(),
            simple: Default::default(),
            other: Default::default(),
            grid: Grid::default(),
            finish: Finish::default(),
        }
    }

    /// The intermediate planes of one frame, computed anew and everywhere; the picture goes to `out` as in
    /// [`Style::draw`]. Slower than drawing, and it allocates.
    pub fn stages(&mut self, input: StyleInput<'_>, out: &mut Rgb) -> Stages {
        let mut canvas = std::mem::take(&mut self.canvas);
        let picture = composite::augmented(&input, &mut canvas);
        let mut stages = Stages::default();
        if self.simplify(picture) {
            out.resize(picture.size());
            self.finish.tapped(self.level, &self.config, picture, &self.grid, &mut stages, out);
            stages.small = self.small.clone();
            stages.simplified = self.grid.simplified();
        }
        self.canvas = canvas;
        stages
    }

    /// Steps 1 to 3; `false` when the picture is empty.
    fn simplify(&mut self, picture: &Rgb) -> bool {
        let size = picture.size();
        if size.area() == 0 {
            return false;
        }
        let shrunk = self.config.shrunk(size);
        for ((shrink, plane), small) in self.shrinks.iter_mut().zip(&picture.planes).zip(&mut self.small) {
            small.resize(shrunk, 0.0);
            shrink.run(self.level, plane.view(), small);
        }
        let gain = photometric::chroma_gain(self.config.sigma_p);
        to_scaled_yuv(&self.small, gain, &mut self.simple);
        for _ in 0..self.config.steps {
            photometric::step(self.level, &self.simple, &mut self.other);
            std::mem::swap(&mut self.simple, &mut self.other);
        }
        self.grid.build(self.level, &self.simple, gain, self.config.alpha);
        true
    }
}

impl Style for Cartoon {
    fn draw(&mut self, input: StyleInput<'_>, out: &mut Rgb) {
        let mut canvas = std::mem::take(&mut self.canvas);
        let picture = composite::augmented(&input, &mut canvas);
        out.resize(picture.size());
        if self.simplify(picture) {
            self.finish.draw(self.level, &self.config, picture, &self.grid, out);
        }
        self.canvas = canvas;
    }
}

/// RGB in 0..1 to Y, U·gain, V·gain.
fn to_scaled_yuv(rgb: &[Plane<f32>; 3], gain: f32, yuv: &mut [Plane<f32>; 3]) {
    let size = rgb[0].size();
    yuv.iter_mut().for_each(|plane| plane.resize(size, 0.0));
    let [y, u, v] = yuv;
    let bands = y.view_mut().par_bands(64).zip(u.view_mut().par_bands(64));
    bands.zip(v.view_mut().par_bands(64)).for_each(|(((first, mut y), (_, mut u)), (_, mut v))| {
        for row in 0..y.size().height {
            let [r, g, b] = [0, 1, 2].map(|c| rgb[c].row(first + row));
            let (y, u, v) = (y.row_mut(row), u.row_mut(row), v.row_mut(row));
            for x in 0..y.len() {
                let of = color::yuv_of([r[x], g[x], b[x]]);
                (y[x], u[x], v[x]) = (of[0], of[1] * gain, of[2] * gain);
            }
        }
    });
}
