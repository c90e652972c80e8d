//! The bilateral filter on colors (Tomasi & Manduchi; 003 eq. 3.1 to 3.4), 9x9 with the center, borders clamped.
//!
//! h(x) = Σ f(ξ)·c·s / Σ c·s, c = exp(-|ξ-x|² / 2σ_d²), s = exp(-|f(ξ)-f(x)|² / 2σ_r²), distance of colors Euclidean
//! over R, G, B. Colors are scaled by 1/(σ_r·√(2·ln 2)), so that c·s = 2^-(|Δf|² + |Δx|²/(2·ln 2·σ_d²)): one power a
//! tap. Taps are summed in one fixed order, so neither bands nor the SIMD level touch a bit.
#![allow(clippy::needless_range_loop)] // channels index several arrays in step

use super::photometric::{chroma_gain, half_to};
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, Size};
use fearless_simd::{Simd, SimdBase};
use rayon::prelude::*;

/// Pixels the window reaches from its center.
pub const REACH: usize = 4;
/// Side of the window.
const SIDE: usize = 2 * REACH + 1;
/// Room for the last vector of a row.
const SLACK: usize = 16;

/// The filter with its copy of the picture; keep it from frame to frame.
#[derive(Clone, Debug, Default)]
pub struct Bilateral {
    grown: [Plane<f32>; 3],
}

impl Bilateral {
    /// One step, in place, on planes R, G, B in 0..1 of one size; both deviations are above 0. Allocates only when
    /// the size grows.
    pub fn step(&mut self, level: Level, sigma_d: f32, sigma_r: f32, planes: &mut [Plane<f32>; 3]) {
        let size = planes[0].size();
        if size.area() == 0 {
            return;
        }
        let gain = chroma_gain(sigma_r);
        let grown = Size::new(size.width + 2 * REACH + SLACK, size.height + 2 * REACH);
        for (to, from) in self.grown.iter_mut().zip(planes.iter()) {
            to.resize(grown, 0.0);
            grow(from, gain, to);
        }
        let space = distances(sigma_d);
        let (grown, scale) = (&self.grown, 1.0 / gain);
        let band = super::band_rows(size.height, 4);
        let [r, g, b] = planes;
        let bands = r.view_mut().par_bands(band).zip(g.view_mut().par_bands(band));
        bands.zip(b.view_mut().par_bands(band)).for_each(|(((first, mut r), (_, mut g)), (_, mut b))| {
            for y in 0..r.size().height {
                let out = [r.row_mut(y), g.row_mut(y), b.row_mut(y)];
                dispatch!(level, simd => row(simd, grown, first + y, &space, scale, out));
            }
        });
    }
}

/// The exponent's spatial part by distance from the center: |Δx|² / (2·ln 2·σ_d²).
fn distances(sigma_d: f32) -> [[f32; SIDE]; SIDE] {
    let unit = 1.0 / (2.0 * std::f64::consts::LN_2 * f64::from(sigma_d) * f64::from(sigma_d));
    std::array::from_fn(|y| {
        std::array::from_fn(|x| {
            let (dx, dy) = (x.abs_diff(REACH), y.abs_diff(REACH));
            ((dx * dx + dy * dy) as f64 * unit) as f32
        })
    })
}

/// Copies `from`, times `gain`, with its border repeated all round.
fn grow(from: &Plane<f32>, gain: f32, to: &mut Plane<f32>) {
    let size = from.size();
    for y in 0..to.size().height {
        let line = from.row(y.saturating_sub(REACH).min(size.height - 1));
        let (before, rest) = to.row_mut(y).split_at_mut(REACH);
        let (pixels, after) = rest.split_at_mut(size.width);
        before.fill(line[0] * gain);
        pixels.iter_mut().zip(line).for_each(|(to, &from)| *to = from * gain);
        after.fill(line[size.width - 1] * gain);
    }
}

/// One row of the result.
#[inline(always)]
fn row<S: Simd>(
    simd: S,
    grown: &[Plane<f32>; 3],
    y: usize,
    space: &[[f32; SIDE]; SIDE],
    scale: f32,
    out: [&mut [f32]; 3],
) {
    let lanes = S::f32s::LEN;
    let width = out[0].len();
    let [out_r, out_g, out_b] = out;
    for x in (0..width).step_by(lanes) {
        let at = x + REACH;
        let r0 = S::f32s::from_slice(simd, &grown[0].row(y + REACH)[at..at + lanes]);
        let g0 = S::f32s::from_slice(simd, &grown[1].row(y + REACH)[at..at + lanes]);
        let b0 = S::f32s::from_slice(simd, &grown[2].row(y + REACH)[at..at + lanes]);
        let mut k = S::f32s::splat(simd, 0.0);
        let (mut r, mut g, mut b) = (k, k, k);
        for dy in 0..SIDE {
            let window = SIDE - 1 + lanes;
            let red = &grown[0].row(y + dy)[x..x + window];
            let green = &grown[1].row(y + dy)[x..x + window];
            let blue = &grown[2].row(y + dy)[x..x + window];
            for dx in 0..SIDE {
                let rs = S::f32s::from_slice(simd, &red[dx..dx + lanes]);
                let gs = S::f32s::from_slice(simd, &green[dx..dx + lanes]);
                let bs = S::f32s::from_slice(simd, &blue[dx..dx + lanes]);
                let (dr, dg, db) = (rs - r0, gs - g0, bs - b0);
                let weight = half_to(simd, (dr * dr + dg * dg) + (db * db + space[dy][dx]));
                k += weight;
                r += rs * weight;
                g += gs * weight;
                b += bs * weight;
            }
        }
        let scale = S::f32s::splat(simd, scale) / k;
        let mean = [r * scale, g * scale, b * scale];
        if x + lanes <= width {
            mean[0].store_slice(&mut out_r[x..x + lanes]);
            mean[1].store_slice(&mut out_g[x..x + lanes]);
            mean[2].store_slice(&mut out_b[x..x + lanes]);
        } else {
            let rest = width - x;
            out_r[x..].copy_from_slice(&mean[0].as_slice()[..rest]);
            out_g[x..].copy_from_slice(&mean[1].as_slice()[..rest]);
            out_b[x..].copy_from_slice(&mean[2].as_slice()[..rest]);
        }
    }
}

/// One pixel of one step in f64, straight from eq. 3.1 to 3.4; `at` takes coordinates inside the picture.
pub fn reference(
    size: Size,
    sigma_d: f64,
    sigma_r: f64,
    x: usize,
    y: usize,
    at: impl Fn(usize, usize) -> [f64; 3],
) -> [f64; 3] {
    let center = at(x, y);
    let (mut k, mut sum) = (0.0, [0.0; 3]);
    let reach = REACH as isize;
    for (dx, dy) in (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy))) {
        let sx = x.saturating_add_signed(dx).min(size.width - 1);
        let sy = y.saturating_add_signed(dy).min(size.height - 1);
        let f = at(sx, sy);
        let apart: f64 = (0..3).map(|c| (f[c] - center[c]) * (f[c] - center[c])).sum();
        let far = (dx * dx + dy * dy) as f64;
        let weight = libm::exp(-0.5 * (far / (sigma_d * sigma_d) + apart / (sigma_r * sigma_r)));
        k += weight;
        (0..3).for_each(|c| sum[c] += weight * f[c]);
    }
    sum.map(|sum| sum / k)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::sweep;

    /// The power's 3e-6 and f32 roundings, far below a level (4e-3).
    const BOUND: f64 = 2e-5;

    #[test]
    fn every_picture_matches_the_reference() {
        for case in sweep::cases().iter().filter(|case| case.plane.size().area() < 500_000) {
            let size = case.plane.size();
            let (w, h) = (size.width, size.height);
            let unit = |v: u8| f32::from(v) / 255.0;
            let planes = [
                Plane::from_fn(size, |x, y| unit(case.plane.at(x, y))),
                Plane::from_fn(size, |x, y| unit(case.plane.at(w - 1 - x, y)) * 0.3),
                Plane::from_fn(size, |x, y| unit(case.plane.at(x, h - 1 - y)) * 0.5 + 0.2),
            ];
            for (sigma_d, sigma_r) in [(2.0, 0.1), (0.5, 1.0)] {
                let found = sweep::everywhere(&case.label, |level| {
                    let mut planes = planes.clone();
                    Bilateral::default().step(level, sigma_d, sigma_r, &mut planes);
                    planes
                });
                for i in (0..size.area()).step_by((size.area() / 1000).max(1)) {
                    let (x, y) = (i % w, i / w);
                    let at = |x, y| planes.each_ref().map(|plane| f64::from(plane.at(x, y)));
                    let truth = reference(size, sigma_d.into(), sigma_r.into(), x, y, at);
                    for c in 0..3 {
                        let error = (f64::from(found[c].at(x, y)) - truth[c]).abs();
                        assert!(error <= BOUND, "{}: ({x}, {y}) channel {c}: {error:e}", case.label);
                    }
                }
            }
        }
    }
}
