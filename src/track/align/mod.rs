//! Sub-pixel corners: the whole known pattern laid onto the gray picture.
//!
//! Once the code is read, every edge of the print is known, the inner ones too. The model of a pixel is
//! black + (white - black)·V, both levels planes over the marker, V the pattern blurred by a compact kernel
//! of free width. Homography, levels and width (8 + 6 + 1 numbers) minimize the squared gray residuals by
//! Gauss-Newton (Lucas-Kanade alignment; Baker & Matthews 2004), far residuals weighted down after Geman &
//! McClure. First a thin set of pixels finds the place and the blur, then every pixel the blurred edges reach
//! takes part: pixels away from every edge do not depend on the homography, only a few of them are used, for
//! the levels.
//!
//! `pattern`: the ink around every junction of cells; `gather`: which pixels take part; `equations`: the normal
//! equations in SIMD; `reference` (tests): the same in plain f64.

mod equations;
mod gather;
mod pattern;
#[cfg(test)]
mod reference;

use super::decode::{Decoded, View};
use super::quad::{self, Quad};
use super::rectify::Rectify;
use crate::geometry::{Homography, solve_spd};
use crate::pixels::simd::{Level, dispatch};
use equations::Sums;
use gather::{MOST_SAMPLES, Samples};
use glam::{DMat3, DVec2, DVec3};
use pattern::Pattern;

/// Half-width of the kernel in deviations: the variance of (15/16)(1-z²)² is 1/7.
const WIDTH_PER_SIGMA: f64 = 2.645_751_311_064_590_6;
/// Blur to start from, px: a sharp lens and the pixel's own extent.
const START_SIGMA_PX: f64 = 0.7;
/// Least and most blur, px.
const SIGMA_PX: [f64; 2] = [0.3, 5.0];
/// Most Gauss-Newton steps on the thin set and on the whole one.
const STEPS: [usize; 2] = [4, 3];
/// Pixels of the thin set.
const THIN_SAMPLES: usize = 500;
/// Homography, black and step levels, logarithm of the kernel's width.
const UNKNOWNS: usize = 15;

/// The print's place and look as the fit knows them.
#[derive(Clone, Copy, Debug)]
struct Fit {
    /// Marker square (±1, y up) → ideal pixels relative to `center`, in units of `scale`.
    map: DMat3,
    center: DVec2,
    scale: f64,
    /// Black level and step to white by (1, x, y) of the marker square.
    levels: [f64; 6],
    /// Logarithm of the kernel's half-width in `scale` units.
    log_width: f64,
    /// Residuals beyond this are someone's finger or a glint, gray levels.
    reach: f64,
}

/// The corners, in ideal pixels and the family's order, of the decoded pattern laid onto the picture. `None` when
/// the fit does not hold: the steps do not converge, or lead away from the quad that was read.
pub fn align(view: &View<'_>, found: &Decoded, rectify: &Rectify, level: Level) -> Option<Quad> {
    let pattern = Pattern::new(found)?;
    let center = (found.quad[0] + found.quad[1] + found.quad[2] + found.quad[3]) * 0.25;
    let scale = quad::area(&found.quad).sqrt().max(1.0);
    let mut map = Homography::from_square(found.quad.map(|p| (p - center) / scale))?.0;
    map *= 1.0 / map.z_axis.z;
    let contrast = found.white.mean - found.black.mean;
    let (black, step) = (found.black, found.white.slope - found.black.slope);
    let mut fit = Fit {
        map,
        center,
        scale,
        levels: [black.mean, black.slope.x, black.slope.y, contrast, step.x, step.y],
        log_width: libm::log(START_SIGMA_PX * WIDTH_PER_SIGMA / scale),
        reach: 0.35 * contrast,
    };
    let mut samples = Samples::default();
    for (whole, steps) in STEPS.into_iter().enumerate() {
        let (most, grow) = if whole == 1 { (MOST_SAMPLES, 1.15) } else { (THIN_SAMPLES, 1.33) };
        dispatch!(level, simd => gather::gather(simd, view, rectify, &fit, &pattern, most, grow, &mut samples));
        if samples.count < 4 * UNKNOWNS {
            return None;
        }
        for _ in 0..steps {
            let sums = dispatch!(level, simd => equations::normal(simd, &samples, &pattern, &fit))?;
            let moved = fit.step(&sums, contrast)?;
            if moved < 0.01 {
                break;
            }
        }
        if whole == 0 && samples.whole {
            break;
        }
    }
    let map = Homography(fit.map);
    let corner = |x: f64, y: f64| center + map.apply(DVec2::new(x, y)) * scale;
    let quad = [corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0), corner(-1.0, -1.0)];
    let cell = scale / pattern.cells as f64;
    let near = quad.iter().zip(&found.quad).all(|(p, q)| (*p - *q).length() <= (0.6 * cell).max(1.5));
    (near && quad::is_convex(&quad)).then_some(quad)
}

impl Fit {
    /// One Gauss-Newton step; returns how far the place moved, px.
    fn step(&mut self, sums: &Sums, contrast: f64) -> Option<f64> {
        let step = solve_spd(damped(sums.a), sums.b)?;
        self.map.x_axis += DVec3::new(step[0], step[3], step[6]);
        self.map.y_axis += DVec3::new(step[1], step[4], step[7]);
        self.map.z_axis += DVec3::new(step[2], step[5], 0.0);
        for (level, step) in self.levels.iter_mut().zip(&step[8..14]) {
            *level += step;
        }
        self.log_width += step[14].clamp(-0.4, 0.4);
        let sigma_px = self.sigma_px();
        self.log_width += libm::log(sigma_px.clamp(SIGMA_PX[0], SIGMA_PX[1]) / sigma_px);
        let residual = (sums.squares / sums.weights).sqrt();
        self.reach = (4.0 * residual).clamp(0.05 * contrast, 0.35 * contrast);
        let moved = step[..8].iter().fold(0.0f64, |most, v| v.abs().max(most)) * self.scale;
        (self.map.is_finite() && moved.is_finite()).then_some(moved)
    }

    /// The fitted blur, px.
    fn sigma_px(&self) -> f64 {
        libm::exp(self.log_width) * self.scale / WIDTH_PER_SIGMA
    }
}

/// A trace of Levenberg's damping keeps the levels' and the width's equations regular.
fn damped(mut a: [[f64; UNKNOWNS]; UNKNOWNS]) -> [[f64; UNKNOWNS]; UNKNOWNS] {
    for (i, row) in a.iter_mut().enumerate() {
        row[i] *= 1.0 + 1e-6;
    }
    // the width is barely seen by sharp prints: hold it a little
    a[UNKNOWNS - 1][UNKNOWNS - 1] *= 1.0 + 1e-2;
    a[UNKNOWNS - 1][UNKNOWNS - 1] += 1e-9;
    a
}
