//! Sub-pixel corners: the whole known pattern laid onto the gray picture.
//!
//! Once the code is read, every edge of the print is known, the inner ones too. The model of a pixel is
//! black + (white - black)·V, both levels planes over the marker, V the pattern blurred by a compact kernel
//! of free width. Homography, levels and width (8 + 6 + 1 numbers) minimize the squared gray residuals by
//! Gauss-Newton (Lucas-Kanade alignment; Baker & Matthews 2004). Pixels away from every edge do not depend on
//! the homography: only a few of them are used, for the levels.

use super::decode::{Decoded, View};
use super::quad::{self, Quad};
use super::rectify;
use crate::geometry::{Homography, solve_spd};
use crate::marker::Ink;
use glam::{DMat3, DVec2, DVec3};

/// Most pixels a marker's alignment looks at: bounds the work on large markers.
const MOST_SAMPLES: usize = 900;
/// Gauss-Newton steps.
const STEPS: usize = 4;
/// Half-width of the kernel in deviations: the variance of (15/16)(1-z²)² is 1/7.
const WIDTH_PER_SIGMA: f64 = 2.645_751_311_064_590_6;
/// Blur to start from, px: a sharp lens and the pixel's own extent.
const START_SIGMA_PX: f64 = 0.7;
/// Squares along the pattern with one of quiet zone on either side.
const MOST_CELLS: usize = 14;
const UNKNOWNS: usize = 15;

#[derive(Clone, Copy, Default)]
struct Sample {
    /// Ideal pixel relative to the marker's center, in `scale` units.
    at: DVec2,
    gray: f64,
}

/// The pattern as numbers, and the kernel over it.
struct Pattern {
    ink: [[f64; MOST_CELLS]; MOST_CELLS],
    cells: usize,
    /// From which to before which square along both sides the print is a picture that is not known.
    picture: Option<(f64, f64)>,
}

/// V and its derivatives by cell coordinates and by the logarithm of the kernel's width.
struct Blurred {
    value: f64,
    slope: DVec2,
    by_width: f64,
}

/// The cells under the kernel along one axis: their weights and derivatives.
struct Span {
    first: usize,
    count: usize,
    weight: [f64; 5],
    slope: [f64; 5],
    by_width: [f64; 5],
}

impl Pattern {
    fn new(found: &Decoded) -> Option<Self> {
        let code = found.family.code(found.reading.id)?;
        let cells = found.family.cells();
        let ink = |column: usize, row: usize| found.family.ink(code, column as isize - 1, row as isize - 1);
        let mut pattern = Self { ink: [[1.0; MOST_CELLS]; MOST_CELLS], cells, picture: None };
        for (row, line) in pattern.ink.iter_mut().enumerate() {
            for (column, value) in line.iter_mut().enumerate() {
                *value = f64::from(u8::from(ink(column, row) == Ink::White));
            }
        }
        let middle = cells / 2 + 1;
        if let Some(first) = (0..middle).find(|&column| ink(column, middle) == Ink::Picture) {
            let border = first as f64 - 1.0;
            pattern.picture = Some((border, cells as f64 - border));
        }
        Some(pattern)
    }

    /// Whether a kernel of half-width `width` at `p` reaches into the picture that is not known.
    fn hidden(&self, p: DVec2, width: DVec2) -> bool {
        self.picture.is_some_and(|(from, to)| {
            let touches = |at: f64, width: f64| at + width > from && at - width < to;
            touches(p.x, width.x) && touches(p.y, width.y)
        })
    }

    /// The kernel's weights around cell coordinate `u` (0 at the border's outer edge), half-width `width`.
    #[inline(always)]
    fn span(&self, u: f64, width: f64) -> Span {
        let most = self.cells + 1;
        let cell = |u: f64| ((u + 1.0).max(0.0) as usize).min(most);
        let first = cell(u - width);
        let last = cell(u + width).min(first + 4);
        let mut span =
            Span { first, count: last - first + 1, weight: [0.0; 5], slope: [0.0; 5], by_width: [0.0; 5] };
        let (mut value, mut slope, mut by_width) = (1.0, 0.0, 0.0);
        for i in 0..span.count {
            let next = if i + 1 < span.count {
                // boundary between this cell and the next
                let z = ((u - (first + i) as f64) / width).clamp(-1.0, 1.0);
                let zz = z * z;
                let bell = 0.9375 * (1.0 - zz) * (1.0 - zz);
                let step = 0.5 + z * (0.9375 + zz * (-0.625 + 0.1875 * zz));
                (step, bell / width, -z * bell)
            } else {
                (0.0, 0.0, 0.0)
            };
            span.weight[i] = value - next.0;
            span.slope[i] = slope - next.1;
            span.by_width[i] = by_width - next.2;
            (value, slope, by_width) = next;
        }
        span
    }

    #[inline(always)]
    fn blurred(&self, p: DVec2, width: DVec2) -> Blurred {
        let (across, down) = (self.span(p.x, width.x), self.span(p.y, width.y));
        let mut out = Blurred { value: 0.0, slope: DVec2::ZERO, by_width: 0.0 };
        for j in 0..down.count {
            let row = &self.ink[down.first + j];
            let (mut value, mut slope, mut by_width) = (0.0, 0.0, 0.0);
            for i in 0..across.count {
                let ink = row[across.first + i];
                value += ink * across.weight[i];
                slope += ink * across.slope[i];
                by_width += ink * across.by_width[i];
            }
            out.value += value * down.weight[j];
            out.slope.x += slope * down.weight[j];
            out.slope.y += value * down.slope[j];
            out.by_width += by_width * down.weight[j] + value * down.by_width[j];
        }
        out
    }
}

/// The corners, in ideal pixels and the family's order, of the decoded pattern laid onto the picture. `None` when the fit does not hold: the steps do not converge,
/// or lead away from the quad that was read.
pub fn align(view: &View<'_>, found: &Decoded) -> Option<Quad> {
    let pattern = Pattern::new(found)?;
    let center = (found.quad[0] + found.quad[1] + found.quad[2] + found.quad[3]) * 0.25;
    let scale = quad::area(&found.quad).sqrt().max(1.0);
    let start = Homography::from_square(found.quad.map(|p| (p - center) / scale))?;
    let mut map = start.0;
    map *= 1.0 / map.z_axis.z;
    let mut samples = [Sample::default(); MOST_SAMPLES];
    let count = gather(view, found, &pattern, map, center, scale, &mut samples);
    let samples = &samples[..count];
    if count < 4 * UNKNOWNS {
        return None;
    }

    let mut log_width = libm::log(START_SIGMA_PX * WIDTH_PER_SIGMA / scale);
    let contrast = found.white.mean - found.black.mean;
    // black level and contrast by (1, x, y)
    let (black, step) = (found.black, found.white.slope - found.black.slope);
    let mut levels = [black.mean, black.slope.x, black.slope.y, contrast, step.x, step.y];
    // residuals beyond this are someone's finger or a glint
    let mut reach = 0.35 * contrast.abs();
    for turn in 0..STEPS {
        let (a, b, squares, weights) = normal(samples, &pattern, map, libm::exp(log_width), &levels, reach)?;
        let residual = (squares / weights).sqrt();
        let step = solve_spd(damped(a), b)?;
        map.x_axis += DVec3::new(step[0], step[3], step[6]);
        map.y_axis += DVec3::new(step[1], step[4], step[7]);
        map.z_axis += DVec3::new(step[2], step[5], 0.0);
        for (level, step) in levels.iter_mut().zip(&step[8..14]) {
            *level += step;
        }
        log_width += step[14].clamp(-0.4, 0.4);
        let sigma_px = libm::exp(log_width) * scale / WIDTH_PER_SIGMA;
        log_width += libm::log(sigma_px.clamp(0.3, 5.0) / sigma_px);
        reach = (4.0 * residual).clamp(0.05 * contrast.abs(), 0.35 * contrast.abs());
        let moved = (step[..8].iter().fold(0.0f64, |most, v| v.abs().max(most))) * scale;
        if turn > 0 && moved < 8e-3 {
            break;
        }
    }
    let map = Homography(map);
    let corner = |x: f64, y: f64| center + map.apply(DVec2::new(x, y)) * scale;
    let quad = [corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0), corner(-1.0, -1.0)];
    let cell = scale / pattern.cells as f64;
    let near = quad.iter().zip(&found.quad).all(|(p, q)| (*p - *q).length() <= (0.6 * cell).max(1.5));
    (near && quad::is_convex(&quad)).then_some(quad)
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

/// Where a point lies in the marker (±1), its cell coordinates and their gradients by the picture's axes.
struct Place {
    square: DVec2,
    cell: DVec2,
    across: DVec2,
    down: DVec2,
}

impl Place {
    #[inline(always)]
    fn of(inverse: &DMat3, at: DVec2, cells: f64) -> Self {
        let q = *inverse * at.extend(1.0);
        let square = DVec2::new(q.x / q.z, q.y / q.z);
        let row = |r: usize| DVec2::new(inverse.x_axis[r], inverse.y_axis[r]);
        let (dx, dy) = ((row(0) - square.x * row(2)) / q.z, (row(1) - square.y * row(2)) / q.z);
        let half = 0.5 * cells;
        Self {
            square,
            cell: DVec2::new((square.x + 1.0) * half, (1.0 - square.y) * half),
            across: dx * half,
            down: dy * -half,
        }
    }
}

/// Picks the pixels: all near an edge of the print and a few in its flats, evenly thinned to fit.
fn gather(
    view: &View<'_>,
    found: &Decoded,
    pattern: &Pattern,
    map: DMat3,
    center: DVec2,
    scale: f64,
    samples: &mut [Sample; MOST_SAMPLES],
) -> usize {
    let inverse = map.inverse();
    let cells = pattern.cells as f64;
    // a kernel one third wider than the start: the quad is not exact yet
    let reach = 1.33 * START_SIGMA_PX * WIDTH_PER_SIGMA / scale;
    let size = view.luma.size();
    let outer = found.quad.map(|p| rectify::seen(view.lens, center + (p - center) * (1.0 + 1.2 / cells)));
    let low = outer.iter().fold(DVec2::INFINITY, |a, p| a.min(*p)).max(DVec2::ZERO);
    let high = outer.iter().fold(DVec2::NEG_INFINITY, |a, p| a.max(*p));
    let columns = low.x as usize..(high.x.max(0.0) as usize + 1).min(size.width);
    let rows = low.y as usize..(high.y.max(0.0) as usize + 1).min(size.height);
    // outer edge and about half of the inner cell edges, in px along times px across
    let edges = 4.0 + 1.0 * (cells - 2.0) * (cells - 1.0) / cells;
    let expected = (edges * scale * 2.0 * reach * scale).min(scale * scale * 1.5);
    let thin = ((expected / (0.8 * MOST_SAMPLES as f64)) as usize + 1).max(1);
    let mut count = 0;
    for y in rows {
        let line = view.luma.row(y);
        // rows shifted against each other spread the thinned pixels over every edge direction
        let shift = (y * 5) % thin;
        for x in columns.clone().skip(shift).step_by(thin) {
            let Some(ideal) = rectify::ideal(view.lens, DVec2::new(x as f64, y as f64)) else { continue };
            let at = (ideal - center) / scale;
            let place = Place::of(&inverse, at, cells);
            let inside = |v: f64| (-0.6..=cells + 0.6).contains(&v);
            if !(inside(place.cell.x) && inside(place.cell.y)) {
                continue;
            }
            let width = DVec2::new(place.across.length(), place.down.length()) * reach;
            let there = pattern.blurred(place.cell, width.clamp(DVec2::splat(1e-3), DVec2::splat(1.5)));
            if pattern.hidden(place.cell, width) {
                continue;
            }
            let flat = there.slope == DVec2::ZERO;
            if flat && (x + 2 * y) % 7 != 0 {
                continue;
            }
            if count == MOST_SAMPLES {
                return count;
            }
            samples[count] = Sample { at, gray: f64::from(line[x]) };
            count += 1;
        }
    }
    count
}

type Normal = ([[f64; UNKNOWNS]; UNKNOWNS], [f64; UNKNOWNS], f64, f64);

/// The normal equations of one step (lower triangle), the weighted sum of squares and the sum of weights.
fn normal(
    samples: &[Sample],
    pattern: &Pattern,
    map: DMat3,
    width: f64,
    levels: &[f64; 6],
    reach: f64,
) -> Option<Normal> {
    let inverse = map.inverse();
    if !inverse.is_finite() {
        return None;
    }
    let cells = pattern.cells as f64;
    let mut a = [[0.0; UNKNOWNS]; UNKNOWNS];
    let mut b = [0.0; UNKNOWNS];
    let (mut squares, mut weights) = (0.0, 0.0);
    for sample in samples {
        let place = Place::of(&inverse, sample.at, cells);
        let spread = DVec2::new(place.across.length(), place.down.length()) * width;
        let there = pattern.blurred(place.cell, spread.clamp(DVec2::splat(1e-3), DVec2::splat(1.5)));
        let p = place.square;
        let black = levels[0] + levels[1] * p.x + levels[2] * p.y;
        let step = levels[3] + levels[4] * p.x + levels[5] * p.y;
        let miss = sample.gray - black - step * there.value;
        // Geman-McClure: full weight near, none far
        let ratio = 1.0 + (miss / reach) * (miss / reach);
        let weight = 1.0 / (ratio * ratio);
        let gradient = place.across * there.slope.x + place.down * there.slope.y;
        // moving the pattern by d changes the pixel by -step · gradient · d
        let w = map.x_axis.z * p.x + map.y_axis.z * p.y + map.z_axis.z;
        let g = gradient * (-step / w);
        let inward = -g.dot(sample.at);
        let v = there.value;
        let row = [
            g.x * p.x,
            g.x * p.y,
            g.x,
            g.y * p.x,
            g.y * p.y,
            g.y,
            inward * p.x,
            inward * p.y,
            1.0,
            p.x,
            p.y,
            v,
            v * p.x,
            v * p.y,
            step * there.by_width,
        ];
        for (i, (line, b)) in a.iter_mut().zip(&mut b).enumerate() {
            let scaled = row[i] * weight;
            for (sum, other) in line.iter_mut().zip(&row).take(i + 1) {
                *sum += scaled * other;
            }
            *b += scaled * miss;
        }
        squares += weight * miss * miss;
        weights += weight;
    }
    Some((a, b, squares, weights))
}
