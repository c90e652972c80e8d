//! Hiding the printed marker: its square is painted over from what surrounds it.
//!
//! The ring around the square is sampled in 64 places; inside, color is their mean-value interpolation (Floater 2003),
//! which keeps the run of the light across the print and is never darker than the darkest nor lighter than the
//! lightest place of the ring. It is computed on a grid of 17 x 17 places of the print whose weights are the same for
//! every print, and goes to the picture through the print's homography, bilinear between the places.

use super::patch::Patch;
use super::{Mark, RangeError, check, sample};
use crate::geometry::Lens;
use crate::kernel::band_rows;
use crate::pixels::Rgb;
use glam::DVec2;
use rayon::prelude::*;
use serde::Deserialize;

/// The `[retouch.hide]` table.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Paper around the black border that is painted over with it, cells of the marker, 0.5 to 16. The color comes from
    /// just outside: at 1 (the quiet zone) the paper stays and goes blank, past its edge it vanishes too. Default 1.
    pub margin: f64,
}

impl Default for Config {
    fn default() -> Self {
        Self { margin: 1.0 }
    }
}

impl Config {
    /// Checks every setting against its range.
    pub fn validate(&self) -> Result<(), RangeError> {
        let fine = (0.5..=16.0).contains(&self.margin);
        check("retouch.hide.margin", self.margin, fine, "0.5 to 16 cells")
    }
}

/// Cells of the grid along a side.
const SIDE: usize = 16;
/// Places on the ring.
const RING: usize = 4 * SIDE;
/// How far outside the square its ring is sampled, cells of the marker.
const OUTSIDE: [f64; 3] = [0.1, 0.25, 0.4];
/// Over which the paint begins at the square's edge, cells of the marker.
const FEATHER: f64 = 0.25;

/// Paints prints over.
pub struct Hide {
    config: Config,
    /// A row of ring weights, which sum to 1, for every place of the grid, rows first.
    weights: Vec<[f64; RING]>,
    colors: Vec<[f64; 3]>,
}

impl Hide {
    /// With these settings (see [`Config::validate`]).
    pub fn new(config: Config) -> Self {
        let places = (0..=SIDE).flat_map(|row| (0..=SIDE).map(move |column| weights(column, row)));
        let weights: Vec<_> = places.collect();
        Self { config, colors: vec![[0.0; 3]; weights.len()], weights }
    }

    /// Paints one print over. Allocates nothing.
    pub fn paint(&mut self, mark: &Mark, lens: &Lens, picture: &mut Rgb) {
        let half = mark.half_mm(self.config.margin);
        let Some(patch) = Patch::new(&mark.pose, lens, DVec2::ZERO, half) else { return };
        if lens.size != picture.size() {
            return;
        }
        let cell = mark.side_mm / mark.family.cells() as f64 / half;
        let mut ring = [[0.0; 3]; RING];
        for (place, color) in ring.iter_mut().enumerate().map(|(i, color)| (around(i), color)) {
            for outside in OUTSIDE {
                let seen = sample(picture, patch.place(place * (1.0 + outside * cell)));
                for (sum, value) in color.iter_mut().zip(seen) {
                    *sum += value / OUTSIDE.len() as f64;
                }
            }
        }
        for (color, weights) in self.colors.iter_mut().zip(&self.weights) {
            *color = [0.0; 3];
            for (weight, from) in weights.iter().zip(&ring) {
                for (sum, value) in color.iter_mut().zip(from) {
                    *sum += weight * value;
                }
            }
        }
        let (colors, rect) = (&self.colors, patch.rect);
        let rows = band_rows(picture.size().height, 8);
        let [r, g, b] = &mut picture.planes;
        let bands = r.view_mut().par_bands(rows).zip(g.view_mut().par_bands(rows));
        bands.zip(b.view_mut().par_bands(rows)).for_each(|(((first, r), (_, g)), (_, b))| {
            let mut bands = [r, g, b];
            let last = (first + bands[0].size().height).min(rect.y1);
            for y in first.max(rect.y0)..last {
                for x in rect.x0..rect.x1 {
                    let at = patch.under(x, y);
                    let inside = 1.0 - at.abs().max_element();
                    // written so that what is not finite is left alone
                    if inside > 0.0 {
                        let share = (inside / (FEATHER * cell)).min(1.0);
                        for (band, new) in bands.iter_mut().zip(grid(colors, at)) {
                            let value = &mut band.row_mut(y - first)[x];
                            let old = f64::from(*value);
                            *value = (old + (new - old) * share + 0.5).floor() as u8;
                        }
                    }
                }
            }
        });
    }
}

/// Place `i` of the ring on the edge of the square ±1: from its top-left corner clockwise.
fn around(i: usize) -> DVec2 {
    let along = (i % SIDE) as f64 / SIDE as f64 * 2.0 - 1.0;
    match i / SIDE {
        0 => DVec2::new(along, 1.0),
        1 => DVec2::new(1.0, -along),
        2 => DVec2::new(-along, -1.0),
        _ => DVec2::new(-1.0, along),
    }
}

/// The grid's color at a place of the square.
#[inline(always)]
fn grid(colors: &[[f64; 3]], at: DVec2) -> [f64; 3] {
    let cell = |v: f64| {
        let v = v * (SIDE as f64 / 2.0);
        let first = (v as usize).min(SIDE - 1);
        (first, v - first as f64)
    };
    let ((column, fx), (row, fy)) = (cell(at.x + 1.0), cell(1.0 - at.y));
    let first = row * (SIDE + 1) + column;
    let corner = |at: usize, c: usize| colors[at][c];
    [0, 1, 2].map(|c| {
        let above = corner(first, c) + (corner(first + 1, c) - corner(first, c)) * fx;
        let below = first + SIDE + 1;
        let below = corner(below, c) + (corner(below + 1, c) - corner(below, c)) * fx;
        above + (below - above) * fy
    })
}

/// Mean-value coordinates of a place of the grid in the ring: w_i = (tan(α_{i-1}/2) + tan(α_i/2)) / r_i with α_i the
/// angle between places i and i+1 as seen from it, scaled to sum 1 (Floater 2003, eq. 1.2 and 2.1).
fn weights(column: usize, row: usize) -> [f64; RING] {
    let coordinate = |v: usize| v as f64 / SIDE as f64 * 2.0 - 1.0;
    let here = DVec2::new(coordinate(column), -coordinate(row));
    let mut weights = [0.0; RING];
    // on the ring itself: its own color
    if let Some(own) = (0..RING).find(|&i| around(i) == here) {
        weights[own] = 1.0;
        return weights;
    }
    let to = |i: usize| around(i % RING) - here;
    let tangent = |i: usize| {
        let (a, b) = (to(i), to(i + 1));
        (a.length() * b.length() - a.dot(b)) / b.perp_dot(a)
    };
    for (i, weight) in weights.iter_mut().enumerate() {
        *weight = (tangent(i + RING - 1) + tangent(i)) / to(i).length();
    }
    let sum: f64 = weights.iter().sum();
    weights.map(|weight| weight / sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mean_values_are_shares_and_reproduce_a_slope() {
        for (row, column) in (0..=SIDE).flat_map(|row| (0..=SIDE).map(move |column| (row, column))) {
            let weights = weights(column, row);
            assert!(weights.iter().all(|&w| (0.0..=1.0).contains(&w)), "({column}, {row}): {weights:?}");
            let mean: DVec2 = weights.iter().enumerate().map(|(i, &w)| around(i) * w).sum();
            let here = DVec2::new(column as f64 / 8.0 - 1.0, 1.0 - row as f64 / 8.0);
            assert!((mean - here).length() < 1e-12, "({column}, {row}) comes out at {mean}");
        }
    }
}
