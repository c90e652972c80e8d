//! Sketch-like: black silhouette lines on white, the bilateral cartoon's edges alone; models white, with their
//! silhouettes (Fischer 2006, section 3.2.2).

use super::super::{ConfigError, Style, StyleInput, StyleName, composite};
use crate::frame::Needs;
use crate::kernel::band_rows;
use crate::kernel::canny::Canny;
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, Rgb};
use crate::render::Look;
use fearless_simd::Simd;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Settings of the sketch-like style: Canny's thresholds, by default the thesis's (Fig. 3.8), and the models' lines.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Lines {
    /// Gradient (|gx| + |gy| by Sobel, of gray bytes) above which a pixel is surely an edge, 0 to 2040; fractions
    /// are cut off, as OpenCV does. Default 150.
    pub t1: f32,
    /// Gradient above which a pixel that touches an edge is one too, 0 to `t1`. Default 105.
    pub t2: f32,
    /// Width of the models' silhouette lines, px, 1 to 16. Default 3.
    pub line_width: f32,
}

impl Default for Lines {
    fn default() -> Self {
        Self { t1: 150.0, t2: 105.0, line_width: 3.0 }
    }
}

impl Lines {
    /// Checks every setting against its range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        self.validate_for(StyleName::SketchLike)
    }

    pub(super) fn validate_for(&self, style: StyleName) -> Result<(), ConfigError> {
        let check = |key, value: f32, [low, high]: [f32; 2], expected| match (low..=high).contains(&value) {
            true => Ok(()),
            false => Err(ConfigError::Range { style, key, value: value.into(), expected }),
        };
        check("t1", self.t1, [0.0, 2040.0], "0 to 2040")?;
        check("t2", self.t2, [0.0, self.t1], "0 to t1")?;
        check("line_width", self.line_width, [1.0, 16.0], "1 to 16 pixels")
    }

    /// Low and high, whole; gradients are whole numbers up to 2040.
    pub(super) fn thresholds(&self) -> [i16; 2] {
        [self.t2, self.t1].map(|t| t as i16)
    }
}

/// The style with its buffers.
pub struct SketchLike {
    config: Lines,
    level: Level,
    canny: Canny,
}

impl SketchLike {
    /// The style with these settings (see [`Lines::validate`]), its bodies at `level`.
    pub fn new(config: Lines, level: Level) -> Self {
        Self { config, level, canny: Canny::default() }
    }

    /// The dilated edges of one frame, 0 or 1, for inspection; the picture goes to `out` as in [`Style::draw`]. It
    /// allocates.
    pub fn edges(&mut self, input: StyleInput<'_>, out: &mut Rgb) -> Plane<f32> {
        self.draw(input, out);
        super::edges(&self.canny, out.size())
    }
}

impl Style for SketchLike {
    fn look(&self) -> Look {
        Look { line_width: self.config.line_width.into(), ..Needs::SILHOUETTE.into() }
    }

    fn draw(&mut self, input: StyleInput<'_>, out: &mut Rgb) {
        let picture = &input.frame.color;
        let size = picture.size();
        out.resize(size);
        if size.area() > 0 {
            let (level, canny) = (self.level, &mut self.canny);
            let [low, high] = self.config.thresholds();
            canny.mark(level, picture, low, high);
            canny.connect();
            let canny = &self.canny;
            let band = band_rows(size.height, 8);
            let [r, g, b] = &mut out.planes;
            let bands = r.view_mut().par_bands(band).zip(g.view_mut().par_bands(band));
            bands.zip(b.view_mut().par_bands(band)).for_each(|(((first, mut r), (_, mut g)), (_, mut b))| {
                for y in 0..r.size().height {
                    dispatch!(level, simd => row(simd, canny, first + y, r.row_mut(y)));
                    g.row_mut(y).copy_from_slice(r.row_mut(y));
                    b.row_mut(y).copy_from_slice(r.row_mut(y));
                }
            });
        }
        if let Some(layer) = input.layer {
            composite::whiten(layer, out);
            composite::outline(layer, out);
        }
    }
}

#[inline(always)]
fn row<S: Simd>(_simd: S, canny: &Canny, y: usize, out: &mut [u8]) {
    canny.inverted_row(y, out);
}
