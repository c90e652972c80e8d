//! The illustrative style (Fischer 2006, sections 4.2 and 4.3): black edges and cross-hatching on paper.
//!
//! 1. Edges are where the YUV response reaches a threshold (`contrast`, eq. 4.11).
//! 2. Brightness is Y averaged over 3x3 pixels; hatching is where it stays below the procedural halftone threshold
//!    of the pixel (eq. 4.7, 4.8 and 4.13), which is laid out once a frame size.
//! 3. Either makes a pixel black; every other pixel is paper.
//!
//! One pass over the rows, nothing kept from frame to frame. Models are not filtered: they are drawn over the result
//! from depth and normals of their first two surfaces (`objects`).

mod objects;
mod reference;

pub use reference::{halftone, reference, reference_with};

use super::{ConfigError, Style, StyleInput, StyleName};
use crate::frame::Needs;
use crate::geometry::Similarity;
use crate::kernel::band_rows;
use crate::kernel::color::LUMA;
use crate::kernel::contrast::{self, BLOCK, Weights};
use crate::kernel::sobel::Lines;
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, PlaneMut, Rgb, Size};
use crate::render::Look;
use fearless_simd::{Simd, SimdBase, f32x8, i16x16};
use glam::DVec2;
use rayon::prelude::*;
use reference::threshold;
use serde::{Deserialize, Serialize};

/// Settings of the illustrative style; the paper's (Fig. 4.10) where it gives them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Share of color contrast (against brightness contrast) in an edge, 0 to 1. Default 0.3.
    pub alpha: f32,
    /// Response from which a pixel is an edge, 0 to 10. Default 0.1125.
    pub edge_threshold: f32,
    /// Turn of the hatching, degrees, -360 to 360. Default 20.
    pub theta: f64,
    /// Size of the hatching pattern, px, 1 to 256. Default 4.
    pub n: f64,
    /// Brightness below which strokes are crossed, over 0 up to 1. Default 0.9.
    pub c_cross: f64,
    /// Brightening of the picture before it is hatched, 0 to 100. Default 1.6.
    pub gamma: f32,
    /// Red of the paper, 0 to 1. Default 1.
    pub paper_red: f32,
    /// Green of the paper, 0 to 1. Default 1.
    pub paper_green: f32,
    /// Blue of the paper, 0 to 1. Default 0.92.
    pub paper_blue: f32,
    /// Share of secondary geometry's light that is left behind one surface, 0 to 1. Default 0.7.
    pub alpha_layer: f32,
    /// Share of it that is left behind two surfaces, 0 to `alpha_layer`. Default 0.21.
    pub beta_layer: f32,
    /// Sum of four cosines to the neighbors' normals below which a model has a line, -4 to 4. Default 3.98.
    pub normal_threshold: f32,
    /// Gradient of the models' window depth (0 at the near, 1 at the far plane) from which they have a line, 0 to 10.
    /// Default 0.001.
    pub depth_threshold: f32,
    /// How tightly those planes fit the models: the near plane lies at this share of their nearest depth, their farthest
    /// depth at this share of the far plane; 0.001 to 1. Default 0.1: lines where a surface is seen at less than 17° or
    /// steps back by 1 % of its distance (at `depth_threshold` 0.001). At 1, without any room, nearly every pixel of a
    /// model would be a line.
    pub depth_fit: f32,
    /// Red of lines on the models' second surface, 0 to 1. Default 0.45.
    pub back_layer_red: f32,
    /// Green of them, 0 to 1. Default 0.55.
    pub back_layer_green: f32,
    /// Blue of them, 0 to 1. Default 0.75.
    pub back_layer_blue: f32,
    /// Red of secondary geometry, 0 to 1. Default 0.85.
    pub secondary_red: f32,
    /// Green of it, 0 to 1. Default 0.3.
    pub secondary_green: f32,
    /// Blue of it, 0 to 1. Default 0.1.
    pub secondary_blue: f32,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            alpha: 0.3,
            edge_threshold: 0.1125,
            theta: 20.0,
            n: 4.0,
            c_cross: 0.9,
            gamma: 1.6,
            paper_red: 1.0,
            paper_green: 1.0,
            paper_blue: 0.92,
            alpha_layer: 0.7,
            beta_layer: 0.21,
            normal_threshold: 3.98,
            depth_threshold: 0.001,
            depth_fit: 0.1,
            back_layer_red: 0.45,
            back_layer_green: 0.55,
            back_layer_blue: 0.75,
            secondary_red: 0.85,
            secondary_green: 0.3,
            secondary_blue: 0.1,
        }
    }
}

impl Config {
    /// Checks every setting against its range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let check = |key, value: f64, fine: bool, expected| match fine {
            true => Ok(()),
            false => Err(ConfigError::Range { style: StyleName::Illustrative, key, value, expected }),
        };
        for (key, value) in [
            ("alpha", self.alpha),
            ("paper_red", self.paper_red),
            ("paper_green", self.paper_green),
            ("paper_blue", self.paper_blue),
            ("alpha_layer", self.alpha_layer),
            ("back_layer_red", self.back_layer_red),
            ("back_layer_green", self.back_layer_green),
            ("back_layer_blue", self.back_layer_blue),
            ("secondary_red", self.secondary_red),
            ("secondary_green", self.secondary_green),
            ("secondary_blue", self.secondary_blue),
        ] {
            check(key, value.into(), (0.0..=1.0).contains(&value), "a number from 0 to 1")?;
        }
        let (edge, gamma) = (self.edge_threshold, self.gamma);
        check("edge_threshold", edge.into(), (0.0..=10.0).contains(&edge), "0 to 10")?;
        check("theta", self.theta, (-360.0..=360.0).contains(&self.theta), "-360 to 360 degrees")?;
        check("n", self.n, (1.0..=256.0).contains(&self.n), "1 to 256 pixels")?;
        check("c_cross", self.c_cross, self.c_cross > 0.0 && self.c_cross <= 1.0, "over 0 up to 1")?;
        check("gamma", gamma.into(), (0.0..=100.0).contains(&gamma), "0 to 100")?;
        let (beta, normal, depth) = (self.beta_layer, self.normal_threshold, self.depth_threshold);
        check("beta_layer", beta.into(), (0.0..=self.alpha_layer).contains(&beta), "0 to alpha_layer")?;
        check("normal_threshold", normal.into(), (-4.0..=4.0).contains(&normal), "-4 to 4")?;
        check("depth_threshold", depth.into(), (0.0..=10.0).contains(&depth), "0 to 10")?;
        let fit = self.depth_fit;
        check("depth_fit", fit.into(), (0.001..=1.0).contains(&fit), "0.001 to 1")
    }

    fn weights(&self) -> Weights {
        Weights { yuv: [1.0 - self.alpha, self.alpha * 0.5, self.alpha * 0.5], rgb: 0.0 }
    }

    /// Near and far plane of the window depth for models of this extent.
    fn planes(&self, [near, far]: [f32; 2]) -> [f32; 2] {
        [near * self.depth_fit, far / self.depth_fit]
    }

    /// The paper in bytes.
    fn paper(&self) -> [u8; 3] {
        self.paper_color().map(|v| (v * 255.0 + 0.5).floor() as u8)
    }

    fn paper_color(&self) -> [f32; 3] {
        [self.paper_red, self.paper_green, self.paper_blue]
    }

    fn back_layer_color(&self) -> [f32; 3] {
        [self.back_layer_red, self.back_layer_green, self.back_layer_blue]
    }

    fn secondary_color(&self) -> [f32; 3] {
        [self.secondary_red, self.secondary_green, self.secondary_blue]
    }
}

/// The style with its buffers.
pub struct Illustrative {
    config: Config,
    level: Level,
    halftone: Plane<f32>,
    /// How the scene has moved, where the hatching moves with it.
    motion: Option<Similarity>,
    /// The size and motion that `halftone` is laid out for.
    laid: Option<(Size, Option<Similarity>)>,
    scratch: Vec<[Lines; 3]>,
}

/// The intermediate planes of one frame, for inspection.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stages {
    /// Edge response.
    pub response: Plane<f32>,
    /// Y averaged over 3x3 pixels, 0..1.
    pub intensity: Plane<f32>,
    /// Halftone threshold, 0..1.
    pub halftone: Plane<f32>,
}

impl Illustrative {
    /// The style with these settings (see [`Config::validate`]), its bodies at `level`.
    pub fn new(config: Config, level: Level) -> Self {
        Self { config, level, halftone: Plane::default(), motion: None, laid: None, scratch: Vec::new() }
    }

    /// Carries the hatching along (see [`super::Styler::anchor`]).
    pub fn anchor(&mut self, motion: Option<Similarity>) {
        self.motion = motion;
    }

    /// The intermediate planes of one frame's camera side, computed everywhere; that side goes to `out`.
    /// Slower than drawing, and it allocates.
    pub fn stages(&mut self, input: StyleInput<'_>, out: &mut Rgb) -> Stages {
        let picture = &input.frame.color;
        let size = picture.size();
        out.resize(size);
        let mut stages = Stages::default();
        if size.area() > 0 {
            self.fit(size, size.height);
            stages.response.resize(size, 0.0);
            stages.intensity.resize(size, 0.0);
            stages.halftone = self.halftone.clone();
            let work = Work { config: &self.config, picture, halftone: &self.halftone };
            let planes = out.planes.each_mut().map(|plane| plane.view_mut());
            let kept = Some([stages.response.view_mut(), stages.intensity.view_mut()]);
            let lines = &mut self.scratch[0];
            dispatch!(self.level, simd => draw_band::<_, true>(simd, work, 0, lines, planes, kept));
        }
        stages
    }

    fn fit(&mut self, size: Size, rows: usize) {
        if self.laid != Some((size, self.motion)) {
            self.laid = Some((size, self.motion));
            self.halftone.resize(size, 0.0);
            let (level, config) = (self.level, &self.config);
            let motion = self.motion.unwrap_or(Similarity::IDENTITY);
            self.halftone.view_mut().par_bands(band_rows(size.height, 8)).for_each(|(first, band)| {
                dispatch!(level, simd => lay_band(simd, config, motion, first, band));
            });
        }
        let bands = size.height.div_ceil(rows.max(1));
        if self.scratch.len() < bands {
            self.scratch.resize_with(bands, Default::default);
        }
        self.scratch[..bands].iter_mut().flatten().for_each(|lines| lines.fit(size.width));
    }
}

impl Style for Illustrative {
    fn look(&self) -> Look {
        Needs::NORMAL.and(Needs::SECOND_LAYER).and(Needs::SECONDARY).into()
    }

    fn draw(&mut self, input: StyleInput<'_>, out: &mut Rgb) {
        let picture = &input.frame.color;
        let size = picture.size();
        out.resize(size);
        if size.area() > 0 {
            let rows = band_rows(size.height, 8);
            self.fit(size, rows);
            let work = Work { config: &self.config, picture, halftone: &self.halftone };
            let level = self.level;
            let [r, g, b] = &mut out.planes;
            let bands = r.view_mut().par_bands(rows).zip(g.view_mut().par_bands(rows));
            let bands = bands.zip(b.view_mut().par_bands(rows)).zip(&mut self.scratch);
            bands.for_each(|((((first, r), (_, g)), (_, b)), lines)| {
                dispatch!(level, simd => draw_band::<_, false>(simd, work, first, lines, [r, g, b], None));
            });
            if let Some(layer) = input.layer {
                objects::draw(level, &self.config, &self.halftone, layer, out);
            }
        }
    }
}

/// Lays the hatching's thresholds out for some rows.
#[inline(always)]
fn lay_band<S: Simd>(
    _simd: S,
    config: &Config,
    motion: Similarity,
    first: usize,
    mut band: PlaneMut<'_, f32>,
) {
    let turn = libm::sincos(config.theta.to_radians());
    for y in 0..band.size().height {
        for (x, to) in band.row_mut(y).iter_mut().enumerate() {
            let at = motion.apply(DVec2::new(x as f64, (first + y) as f64)) + 0.5;
            *to = threshold(turn, config.n, config.c_cross, at.x, at.y) as f32;
        }
    }
}

/// Borrowed inputs of a band.
#[derive(Clone, Copy)]
struct Work<'a> {
    config: &'a Config,
    picture: &'a Rgb,
    halftone: &'a Plane<f32>,
}

/// Draws the rows of one band. `TAP` computes response and brightness everywhere and keeps them.
#[inline(always)]
fn draw_band<S: Simd, const TAP: bool>(
    simd: S,
    work: Work<'_>,
    first: usize,
    lines: &mut [Lines; 3],
    mut out: [PlaneMut<'_, u8>; 3],
    mut kept: Option<[PlaneMut<'_, f32>; 2]>,
) {
    let Work { config, picture, halftone } = work;
    let size = picture.size();
    let (weights, paper) = (config.weights(), config.paper());
    let quiet = i16x16::splat(simd, weights.quiet(config.edge_threshold));
    let threshold = f32x8::splat(simd, config.edge_threshold);
    for (lines, plane) in lines.iter_mut().zip(&picture.planes) {
        lines.push(0, plane.row(first.saturating_sub(1)));
        lines.push(1, plane.row(first));
    }
    for y in 0..out[0].size().height {
        for (lines, plane) in lines.iter_mut().zip(&picture.planes) {
            lines.push(y + 2, plane.row((first + y + 1).min(size.height - 1)));
        }
        let tau = halftone.row(first + y);
        for block in 0..size.width.div_ceil(BLOCK) {
            let x = BLOCK * block;
            let count = BLOCK.min(size.width - x);
            let [r, g, b] = &*lines;
            let gradients = [r.gradient(simd, y, x), g.gradient(simd, y, x), b.gradient(simd, y, x)];
            let mut black = 0;
            let mut response = [f32x8::splat(simd, 0.0); 2];
            let largest = contrast::largest(simd, &gradients);
            if TAP || simd.any_true_mask16x16(simd.simd_gt_i16x16(largest, quiet)) {
                response = contrast::response(simd, &gradients, weights);
                let low = simd.to_bitmask_mask32x8(simd.simd_ge_f32x8(response[0], threshold));
                let high = simd.to_bitmask_mask32x8(simd.simd_ge_f32x8(response[1], threshold));
                black = low | high << 8;
            }
            let sums = [r.nine(simd, y, x), g.nine(simd, y, x), b.nine(simd, y, x)];
            let intensity = brightness(simd, sums);
            let mut thresholds = [0.0; BLOCK];
            thresholds[..count].copy_from_slice(&tau[x..x + count]);
            let of = [f32x8::from_slice(simd, &thresholds[..8]), f32x8::from_slice(simd, &thresholds[8..])];
            let low = simd.to_bitmask_mask32x8(simd.simd_lt_f32x8(intensity[0] * config.gamma, of[0]));
            let high = simd.to_bitmask_mask32x8(simd.simd_lt_f32x8(intensity[1] * config.gamma, of[1]));
            black |= low | high << 8;
            for (plane, paper) in out.iter_mut().zip(paper) {
                for (lane, to) in plane.row_mut(y)[x..x + count].iter_mut().enumerate() {
                    *to = paper & ((black >> lane & 1) as u8).wrapping_sub(1);
                }
            }
            if TAP && let Some(kept) = &mut kept {
                for (plane, [low, high]) in kept.iter_mut().zip([response, intensity]) {
                    let mut values = [0.0; BLOCK];
                    low.store_slice(&mut values[..8]);
                    high.store_slice(&mut values[8..]);
                    plane.row_mut(first + y)[x..x + count].copy_from_slice(&values[..count]);
                }
            }
        }
    }
}

/// Y in 0..1 of sixteen pixels from the sums of nine R, G, B bytes each.
#[inline(always)]
fn brightness<S: Simd>(simd: S, sums: [i16x16<S>; 3]) -> [f32x8<S>; 2] {
    let mut y = [f32x8::splat(simd, 0.0); 2];
    for (sum, weight) in sums.into_iter().zip(LUMA) {
        let (low, high) = simd.widen_i16x16(sum);
        y[0] += simd.cvt_f32_i32x8(low) * (weight / (9.0 * 255.0));
        y[1] += simd.cvt_f32_i32x8(high) * (weight / (9.0 * 255.0));
    }
    y
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Frame;
    use crate::kernel::sweep;

    #[test]
    fn the_hatching_moves_with_the_scene() {
        let size = Size::new(67, 45);
        let frame = Frame { color: Rgb::new(size, [90, 80, 70]), ..Frame::default() };
        let draw = |motion: Option<Similarity>| {
            sweep::everywhere("hatching", |level| {
                let mut style = Illustrative::new(Config::default(), level);
                style.anchor(motion);
                let mut out = Rgb::default();
                style.draw(StyleInput { frame: &frame, layer: None }, &mut out);
                (out, style.halftone)
            })
        };
        let (still, tau) = draw(None);
        assert!(
            draw(Some(Similarity::IDENTITY)) == (still.clone(), tau.clone()),
            "at rest it is the still's"
        );
        // the scene has moved by (5, 3): so has the hatching
        let shift = DVec2::new(-5.0, -3.0);
        let (moved, _) = draw(Some(Similarity { shift, ..Similarity::IDENTITY }));
        for (x, y) in (3..45).flat_map(|y| (5..67).map(move |x| (x, y))) {
            assert_eq!(moved.at(x, y), still.at(x - 5, y - 3), "({x}, {y})");
        }
        let motion = Similarity { turn: DVec2::new(0.9, 0.5), shift: DVec2::new(-31.0, 8.0) };
        let (_, turned) = draw(Some(motion));
        let Config { theta, n, c_cross, .. } = Config::default();
        for (x, y) in (0..45).flat_map(|y| (0..67).map(move |x| (x, y))) {
            let at = motion.apply(DVec2::new(x as f64, y as f64)) + 0.5;
            let truth = threshold(libm::sincos(theta.to_radians()), n, c_cross, at.x, at.y);
            assert_eq!(turned.at(x, y), truth as f32);
        }
    }
}
