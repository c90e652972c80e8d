//! Sub-pixel corners: the whole known pattern laid onto the gray picture.
//!
//! Once the code is read, every edge of the print is known, the inner ones too. The model of a pixel is
//! black + (white - black)·V, both levels planes over the marker, V the pattern blurred by a compact kernel
//! of free extent either way. Homography, levels and extent (8 + 6 + 3 numbers) minimize the squared gray residuals by
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
#[cfg(test)]
mod tests;

use super::decode::{Level, View};
use super::quad::{self, Quad};
use super::rectify::Rectify;
use crate::geometry::{Homography, solve_spd};
use crate::pixels::simd::{self, dispatch};
use equations::Sums;
pub use gather::MOST_SAMPLES;
use gather::Samples;
use glam::{DMat3, DVec2, DVec3};
pub use pattern::Pattern;
use std::cell::RefCell;

/// Half-width of the kernel in deviations: the variance of (15/16)(1-z²)² is 1/7.
const WIDTH_PER_SIGMA: f64 = 2.645_751_311_064_590_6;
/// Blur to start from, px: a sharp lens and the pixel's own extent.
const START_SIGMA_PX: f64 = 0.7;
/// Least and most blur, px.
const SIGMA_PX: [f64; 2] = [0.3, 5.0];
/// Most Gauss-Newton steps on the thin set and on the whole one.
const STEPS: [usize; 2] = [6, 5];
/// The same where the fit must settle.
const PATIENCE: [usize; 2] = [8, 6];
/// A fit whose last step was longer has not settled, px.
const SETTLED_PX: f64 = 0.25;
/// Steps on the thin set after which the equations keep their matrix, where the blur is known.
const FRESH: usize = 3;
/// A step shorter than this, px, was the last one: on the thin set or where the next picture goes on, and on the whole
/// set.
const ENOUGH_PX: [f64; 2] = [0.1, 0.02];
/// Pixels of the thin set.
const THIN_SAMPLES: usize = 500;
/// Homography, black and step levels, the kernel's extent.
const UNKNOWNS: usize = 17;

/// The print's place and look as the fit knows them.
#[derive(Clone, Copy, Debug)]
struct Fit {
    /// Marker square (±1, y up) → ideal pixels relative to `center`, in units of `scale`.
    map: DMat3,
    center: DVec2,
    scale: f64,
    /// Black level and step to white by (1, x, y) of the marker square.
    levels: [f64; 6],
    /// The kernel's extent as a symmetric matrix xx, xy, yy: along a direction its half-width squared, in
    /// `scale` units squared. Motion makes it longer one way than the other.
    blur: [f64; 3],
    /// Residuals beyond this are someone's finger or a glint, gray levels.
    reach: f64,
    /// Whether the kernel stays as it is.
    rigid: bool,
}

/// Where to start from.
#[derive(Clone, Copy, Debug)]
pub struct Start<'a> {
    /// The print.
    pub pattern: &'a Pattern,
    /// Its corners in ideal pixels and the family's order.
    pub quad: Quad,
    /// Gray of black ink and paper.
    pub inks: [Level; 2],
    /// Covariance of the blur (xx, xy, yy, px²) where it is known from the frame before. The fit must then settle.
    pub blur: Option<[f64; 3]>,
    /// How far the corners may be off, px, where the blur is known: it blurs the start as well. Without doubt
    /// no thin set of pixels is tried first.
    pub doubt_px: f64,
    /// Most pixels looked at.
    pub most: usize,
}

/// The print laid onto the picture.
#[derive(Clone, Copy, Debug)]
pub struct Aligned {
    /// Corners in ideal pixels and the family's order.
    pub quad: Quad,
    /// Gray of black ink and paper.
    pub inks: [Level; 2],
    /// Covariance of the blur: xx, xy, yy, px².
    pub blur: [f64; 3],
    /// Weighted root mean square of the gray residuals.
    pub rms: f64,
    /// Sum of the pixels' robust weights over their number, 0..1: near 1 where the print explains the picture.
    pub share: f64,
    /// Inverse covariance of the corners (x0 y0 x1 ... y3), 1/px².
    pub information: [[f64; 8]; 8],
}

/// Lays the known pattern onto the picture. `None` when the fit does not hold: too few pixels, equations that do
/// not decide, or a place that leads away from the start.
pub fn align(view: &View<'_>, start: &Start<'_>, rectify: &Rectify, level: simd::Level) -> Option<Aligned> {
    SAMPLES.with_borrow_mut(|samples| align_with(samples, view, start, rectify, level))
}

thread_local! {
    /// Each thread's own: too many to be laid out anew for every marker.
    static SAMPLES: RefCell<Samples> = const { RefCell::new(Samples::NONE) };
}

fn align_with(
    samples: &mut Samples,
    view: &View<'_>,
    start: &Start<'_>,
    rectify: &Rectify,
    level: simd::Level,
) -> Option<Aligned> {
    let pattern = start.pattern;
    let center = (start.quad[0] + start.quad[1] + start.quad[2] + start.quad[3]) * 0.25;
    let scale = quad::area(&start.quad).sqrt().max(1.0);
    let mut map = Homography::from_square(start.quad.map(|p| (p - center) / scale))?.0;
    map *= 1.0 / map.z_axis.z;
    let [black, white] = start.inks;
    let (contrast, step) = (white.mean - black.mean, white.slope - black.slope);
    let unit = WIDTH_PER_SIGMA / scale;
    let sharp = START_SIGMA_PX * START_SIGMA_PX;
    let doubt = start.doubt_px * start.doubt_px;
    let mut fit = Fit {
        map,
        center,
        scale,
        levels: [black.mean, black.slope.x, black.slope.y, contrast, step.x, step.y],
        blur: start
            .blur
            .map_or([sharp, 0.0, sharp], |[xx, xy, yy]| [xx + doubt, xy, yy + doubt])
            .map(|v| v * unit * unit),
        reach: 0.35 * contrast.abs(),
        rigid: false,
    };
    let most = start.most.min(MOST_SAMPLES);
    let (mut last, mut settled) = (None, false);
    for whole in [false, true] {
        if !whole && start.blur.is_some() && start.doubt_px == 0.0 {
            continue;
        }
        // a doubtful place is found with the kernel that blurs the doubt away, then the kernel as it was
        fit.rigid = start.blur.is_some() && !whole;
        if let (true, Some(blur)) = (whole, start.blur) {
            fit.blur = blur.map(|v| v * unit * unit);
        }
        let known = start.blur.is_some();
        let steps = if known { PATIENCE } else { STEPS }[usize::from(whole)];
        let most = if whole { most } else { THIN_SAMPLES };
        dispatch!(level, simd => gather::gather(simd, view, rectify, &fit, pattern, most, samples));
        if samples.count < 4 * UNKNOWNS {
            return None;
        }
        let mut a = None;
        for turn in 0..steps {
            // near the end A changes no more
            let fresh = !known || whole || turn < FRESH || a.is_none();
            let mut sums = dispatch!(level, simd => equations::normal(simd, samples, pattern, &fit, fresh))?;
            match a {
                Some(a) if !fresh => sums.a = a,
                _ => a = Some(sums.a),
            }
            let moved = fit.step(&sums, contrast.abs())?;
            last = Some(sums);
            settled = moved < SETTLED_PX;
            if moved < ENOUGH_PX[usize::from(whole && !known)] {
                break;
            }
        }
        if samples.whole && !fit.rigid {
            break;
        }
    }
    if start.blur.is_some() && !settled {
        return None;
    }
    let sums = last?;
    let map = Homography(fit.map);
    let corner = |x: f64, y: f64| center + map.apply(DVec2::new(x, y)) * scale;
    let quad = [corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0), corner(-1.0, -1.0)];
    let cell = scale / pattern.cells as f64;
    // of a picture only the border is known: that leads less far
    let reach_px = if pattern.picture.is_some() { 1.0 } else { (0.6 * cell).max(1.5) };
    let near = quad.iter().zip(&start.quad).all(|(p, q)| (*p - *q).length() <= reach_px);
    if !(near && quad::is_convex(&quad)) {
        return None;
    }
    let [b, bx, by, c, cx, cy] = fit.levels;
    let ink = |mean: f64, x: f64, y: f64| Level { mean, slope: DVec2::new(x, y) };
    let variance = (sums.squares / sums.weights).max(LEAST_VARIANCE);
    Some(Aligned {
        quad,
        inks: [ink(b, bx, by), ink(b + c, bx + cx, by + cy)],
        blur: fit.blur.map(|v| v / (unit * unit)),
        rms: variance.sqrt(),
        share: sums.weights / samples.count as f64,
        information: fit.information(&sums.a, variance)?,
    })
}

/// Rounding to whole gray levels alone: 1/12; and no lens is modeled perfectly.
const LEAST_VARIANCE: f64 = 0.25;

impl Fit {
    /// One Gauss-Newton step; returns how far the place moved, px.
    fn step(&mut self, sums: &Sums, contrast: f64) -> Option<f64> {
        let step = self.solve(sums)?;
        self.map.x_axis += DVec3::new(step[0], step[3], step[6]);
        self.map.y_axis += DVec3::new(step[1], step[4], step[7]);
        self.map.z_axis += DVec3::new(step[2], step[5], 0.0);
        for (level, step) in self.levels.iter_mut().zip(&step[8..14]) {
            *level += step;
        }
        let size = self.blur_size();
        self.widen([step[14] * size, step[15] * size, step[16] * size]);
        let residual = (sums.squares / sums.weights).sqrt();
        self.reach = (5.0 * residual).clamp(0.2 * contrast, 0.35 * contrast);
        let moved = step[..8].iter().fold(0.0f64, |most, v| v.abs().max(most)) * self.scale;
        (self.map.is_finite() && moved.is_finite()).then_some(moved)
    }

    /// The step that the equations ask for. A trace of Levenberg's damping keeps them regular; a weak belief in a
    /// sharp lens holds the blur where a small or noisy print hardly shows it.
    fn solve(&self, sums: &Sums) -> Option<[f64; UNKNOWNS]> {
        let (mut a, mut b) = (sums.a, sums.b);
        for (i, row) in a.iter_mut().enumerate() {
            row[i] *= 1.0 + 1e-6;
        }
        let unit = START_SIGMA_PX * WIDTH_PER_SIGMA / self.scale;
        let (sharp, size) = (unit * unit, self.blur_size());
        // the belief: off by about three times the sharp lens's blur
        let trust = sums.squares / sums.weights * (size / (3.0 * sharp)) * (size / (3.0 * sharp));
        for (k, (now, sharp)) in self.blur.into_iter().zip([sharp, 0.0, sharp]).enumerate() {
            let i = UNKNOWNS - 3 + k;
            a[i][i] += trust;
            b[i] += trust * (sharp - now) / size;
            if self.rigid {
                a[i] = [0.0; UNKNOWNS];
                (a[i][i], b[i]) = (1.0, 0.0);
            }
        }
        solve_spd(a, b)
    }

    /// The corners' inverse covariance: that of the homography with everything else eliminated (Schur's
    /// complement), carried over to the corners.
    #[expect(clippy::needless_range_loop, reason = "the textbook's indices")]
    fn information(&self, a: &[[f64; UNKNOWNS]; UNKNOWNS], variance: f64) -> Option<[[f64; 8]; 8]> {
        // eliminate from the last unknown to the ninth
        let mut a = *a;
        for k in (8..UNKNOWNS).rev() {
            let pivot = a[k][k];
            if !(pivot > 0.0 && pivot.is_finite()) {
                continue;
            }
            for i in 0..k {
                let share = a[k][i] / pivot;
                for j in 0..=i {
                    a[i][j] -= share * a[k][j];
                }
            }
        }
        // rows: how the homography's entries move when one corner coordinate moves by 1 px
        let map = Homography(self.map);
        let mut corners = [[0.0; 8]; 8];
        for (i, (x, y)) in [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)].into_iter().enumerate() {
            let at = map.apply(DVec2::new(x, y));
            let w = (self.map.x_axis.z * x + self.map.y_axis.z * y + self.map.z_axis.z) / self.scale;
            corners[2 * i] = [x, y, 1.0, 0.0, 0.0, 0.0, -at.x * x, -at.x * y].map(|v| v / w);
            corners[2 * i + 1] = [0.0, 0.0, 0.0, x, y, 1.0, -at.y * x, -at.y * y].map(|v| v / w);
        }
        let inverse = invert(corners)?;
        let full = |i: usize, j: usize| if i >= j { a[i][j] } else { a[j][i] };
        let mut half = [[0.0; 8]; 8];
        for (i, row) in half.iter_mut().enumerate() {
            for (j, sum) in row.iter_mut().enumerate() {
                *sum = (0..8).map(|k| full(i, k) * inverse[k][j]).sum();
            }
        }
        let mut out = [[0.0; 8]; 8];
        for (i, row) in out.iter_mut().enumerate() {
            for (j, sum) in row.iter_mut().enumerate().take(i + 1) {
                *sum = (0..8).map(|k| inverse[k][i] * half[k][j]).sum::<f64>() / variance;
            }
        }
        for i in 0..8 {
            for j in i + 1..8 {
                out[i][j] = out[j][i];
            }
        }
        out.iter().flatten().all(|v| v.is_finite()).then_some(out)
    }

    /// Mean square of the kernel's half-width.
    fn blur_size(&self) -> f64 {
        0.5 * (self.blur[0] + self.blur[2])
    }

    /// The kernel's half-width in cells of a print of so many where it is widest: at one of its corners. `None` where
    /// the map has no inverse.
    fn widest_cells(&self, cells: f64) -> Option<f64> {
        let inverse = self.map.inverse();
        let [xx, xy, yy] = self.blur;
        let mut widest = 0.0f64;
        for (x, y) in [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)] {
            let w = self.map.x_axis.z * x + self.map.y_axis.z * y + self.map.z_axis.z;
            for (r, p) in [x, y].into_iter().enumerate() {
                let across = (inverse.x_axis[r] - p * inverse.x_axis.z) * w;
                let down = (inverse.y_axis[r] - p * inverse.y_axis.z) * w;
                widest = widest.max(xx * across * across + 2.0 * xy * across * down + yy * down * down);
            }
        }
        inverse.is_finite().then(|| widest.sqrt() * 0.5 * cells)
    }

    /// Adds to the blur, by at most about half of it, and keeps it within `SIGMA_PX` every way.
    fn widen(&mut self, step: [f64; 3]) {
        let [xx, xy, yy] = self.blur;
        let most = 0.3 * (xx + yy);
        let size = step[0].abs().max(step[1].abs()).max(step[2].abs()).max(1e-300);
        let share = (most / size).min(1.0);
        let [xx, xy, yy] = [xx + share * step[0], xy + share * step[1], yy + share * step[2]];
        // principal axes
        let (mean, half) = (0.5 * (xx + yy), 0.5 * (xx - yy));
        let root = (half * half + xy * xy).sqrt();
        let unit = WIDTH_PER_SIGMA / self.scale;
        let [least, most] = SIGMA_PX.map(|sigma| (sigma * unit) * (sigma * unit));
        let (long, short) = ((mean + root).clamp(least, most), (mean - root).clamp(least, most));
        let (mean, stretch) = (0.5 * (long + short), 0.5 * (long - short) / root.max(1e-300));
        self.blur = [mean + stretch * half, stretch * xy, mean - stretch * half];
    }
}

/// The inverse by Gauss-Jordan with row pivots; `None` where there is none.
#[expect(clippy::needless_range_loop, reason = "the textbook's indices")]
fn invert(mut a: [[f64; 8]; 8]) -> Option<[[f64; 8]; 8]> {
    let mut inverse = [[0.0; 8]; 8];
    for i in 0..8 {
        inverse[i][i] = 1.0;
    }
    for k in 0..8 {
        let pivot = (k..8).max_by(|&i, &j| a[i][k].abs().total_cmp(&a[j][k].abs()))?;
        a.swap(k, pivot);
        inverse.swap(k, pivot);
        let scale = 1.0 / a[k][k];
        if !scale.is_finite() {
            return None;
        }
        for j in 0..8 {
            a[k][j] *= scale;
            inverse[k][j] *= scale;
        }
        for i in 0..8 {
            if i != k {
                let share = a[i][k];
                for j in 0..8 {
                    a[i][j] -= share * a[k][j];
                    inverse[i][j] -= share * inverse[k][j];
                }
            }
        }
    }
    Some(inverse)
}
