//! Which pixels take part in the fit: those the blurred edges of the print reach, and a few of its flats.

use super::Fit;
use super::pattern::{Pattern, STRIDE};
use crate::geometry::Homography;
use crate::track::decode::View;
use crate::track::rectify::{self, Rectify};
use fearless_simd::{Simd, SimdBase, SimdFrom, f32x8, i32x8, prelude::*};
use glam::{DMat3, DVec2};

/// Most pixels a fit looks at: bounds the work on large markers.
pub const MOST_SAMPLES: usize = 4096;
/// Pixels taken at once.
const RUN: usize = 8;
/// Cells of quiet zone that are looked at.
const QUIET: f64 = 0.6;

/// Pixels as the fit sees them.
pub struct Samples {
    /// Ideal place relative to the fit's center, in its scale.
    pub x: [f32; MOST_SAMPLES],
    /// The same down.
    pub y: [f32; MOST_SAMPLES],
    /// Gray.
    pub gray: [f32; MOST_SAMPLES],
    /// How many there are.
    pub count: usize,
    /// Whether nothing was left out.
    pub whole: bool,
}

impl Samples {
    /// None yet.
    pub const NONE: Self = Self {
        x: [0.0; MOST_SAMPLES],
        y: [0.0; MOST_SAMPLES],
        gray: [0.0; MOST_SAMPLES],
        count: 0,
        whole: false,
    };
}

/// Fills `samples` with about `most` pixels at most: runs are left out evenly where there would be more. An edge
/// reaches `grow` kernel half-widths.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "one kernel, called once")]
pub fn gather<S: Simd>(
    simd: S,
    view: &View<'_>,
    rectify: &Rectify,
    fit: &Fit,
    pattern: &Pattern,
    most: usize,
    grow: f64,
    samples: &mut Samples,
) {
    samples.count = 0;
    samples.whole = true;
    let map = Homography(fit.map);
    let cells = pattern.cells as f64;
    let blur = fit.blur.map(|v| v * grow * grow);
    let reach_px = (0.5 * (blur[0] + blur[2])).sqrt() * fit.scale;
    let quiet = QUIET;
    let edge = 1.0 + 2.0 * quiet / cells;
    let outer = [(-edge, edge), (edge, edge), (edge, -edge), (-edge, -edge)]
        .map(|(x, y)| rectify::seen(view.lens, fit.center + map.apply(DVec2::new(x, y)) * fit.scale));
    if !outer.iter().all(|p| p.is_finite()) {
        return;
    }
    let inverse = fit.map.inverse();
    if !inverse.is_finite() {
        return;
    }
    // outer edge and about half of the inner cell edges, px along times px across
    let edges = 4.0 + (cells - 2.0) * (cells - 1.0) / cells;
    let expected = (edges * fit.scale * 2.0 * reach_px).min(1.3 * fit.scale * fit.scale);
    let thin = ((expected / (0.9 * most as f64)) as usize + 1).max(1);
    samples.whole = thin == 1;
    let size = view.luma.size();
    // distortion bends the outline by less than this
    let slack = if view.lens.is_distorted() { 3.0 } else { 1.0 };
    let (low, high) = outer.iter().fold((f64::MAX, f64::MIN), |(l, h), p| (l.min(p.y), h.max(p.y)));
    let rows = (low - slack).max(0.0) as usize..((high + slack).max(0.0) as usize + 1).min(size.height);
    let near =
        Near { simd, inverse: f32s(&inverse), pattern, blur: blur.map(|v| v as f32), quiet: quiet as f32 };
    let sides = [0, 1, 2, 3].map(|i| Side::new(outer[i], outer[(i + 1) % 4]));
    for y in rows {
        let Some([from, to]) = span(&sides, y as f64, slack) else { continue };
        let from = from.max(0.0) as usize;
        let to = (to.max(0.0) as usize + 1).min(size.width);
        let line = view.luma.row(y);
        // runs are left out slantwise: no edge runs along what is left out
        let mut start = from + RUN * (y * 5 % thin);
        while start < to {
            let count = RUN.min(to - start);
            if samples.count + RUN > MOST_SAMPLES {
                return;
            }
            let (px, py) = rectify.run(simd, start, y);
            let center = fit.center.as_vec2();
            let scale = (1.0 / fit.scale) as f32;
            let (x, y_at) = ((px - center.x) * scale, (py - center.y) * scale);
            let mut taken = near.taken(x, y_at, (start + 2 * y) % 8);
            if count < RUN {
                taken &= (1 << count) - 1;
            }
            if taken != 0 {
                let (xs, ys) = (x.as_slice(), y_at.as_slice());
                while taken != 0 {
                    let lane = taken.trailing_zeros() as usize % RUN;
                    taken &= taken - 1;
                    let at = samples.count;
                    samples.x[at] = xs[lane];
                    samples.y[at] = ys[lane];
                    samples.gray[at] = f32::from(line[start + lane]);
                    samples.count += 1;
                }
            }
            start += RUN * thin;
        }
    }
}

/// The matrix's columns as f32.
pub fn f32s(m: &DMat3) -> [[f32; 3]; 3] {
    [m.x_axis, m.y_axis, m.z_axis].map(|c| [c.x as f32, c.y as f32, c.z as f32])
}

/// A side of the outline, from its upper end.
#[derive(Clone, Copy)]
struct Side {
    upper: DVec2,
    lower: f64,
    slope: f64,
}

impl Side {
    fn new(p: DVec2, q: DVec2) -> Self {
        let (p, q) = if p.y <= q.y { (p, q) } else { (q, p) };
        Self { upper: p, lower: q.y, slope: (q.x - p.x) / (q.y - p.y).max(1e-9) }
    }
}

/// Least and greatest x of the quadrilateral within `slack` of row `y`.
fn span(sides: &[Side; 4], y: f64, slack: f64) -> Option<[f64; 2]> {
    let (mut least, mut most) = (f64::MAX, f64::MIN);
    let (top, bottom) = (y - slack, y + slack);
    for side in sides {
        if side.lower < top || side.upper.y > bottom {
            continue;
        }
        for y in [top, bottom] {
            let down = y.max(side.upper.y).min(side.lower) - side.upper.y;
            let x = side.upper.x + down * side.slope;
            (least, most) = (if x < least { x } else { least }, if x > most { x } else { most });
        }
    }
    (least <= most).then_some([least - slack, most + slack])
}

/// The test whether an edge reaches a pixel.
struct Near<'a, S: Simd> {
    simd: S,
    inverse: [[f32; 3]; 3],
    pattern: &'a Pattern,
    blur: [f32; 3],
    quiet: f32,
}

impl<S: Simd> Near<'_, S> {
    /// One bit a lane: pixels an edge reaches, and lane `flat` where it lies on the print.
    #[inline(always)]
    fn taken(&self, x: f32x8<S>, y: f32x8<S>, flat: usize) -> u32 {
        let simd = self.simd;
        let m = &self.inverse;
        let over = f32x8::splat(simd, 1.0) / (x * m[0][2] + y * m[1][2] + m[2][2]);
        let px = (x * m[0][0] + y * m[1][0] + m[2][0]) * over;
        let py = (x * m[0][1] + y * m[1][1] + m[2][1]) * over;
        let cells = self.pattern.cells as f32;
        let half = 0.5 * cells;
        let (u, v) = (px * half + half, half - py * half);
        let (low, high) = (f32x8::splat(simd, -self.quiet), f32x8::splat(simd, cells + self.quiet));
        let mut inside = u.simd_ge(low) & u.simd_le(high) & v.simd_ge(low) & v.simd_le(high);
        if !inside.any_true() {
            return 0;
        }
        // the kernel's half-width in cells: the gradient of the cell coordinate is cells per unit
        let (ax, ay) = ((px * -m[0][2] + m[0][0]) * over, (px * -m[1][2] + m[1][0]) * over);
        let (bx, by) = ((py * -m[0][2] + m[0][1]) * over, (py * -m[1][2] + m[1][1]) * over);
        let [xx, xy, yy] = self.blur;
        let wide_u = (ax * ax * xx + ax * ay * (2.0 * xy) + ay * ay * yy).sqrt() * half;
        let wide_v = (bx * bx * xx + bx * by * (2.0 * xy) + by * by * yy).sqrt() * half;
        if let Some([from, to]) = self.pattern.picture {
            // what the picture's ink may reach is not known
            let (from, to) = (f32x8::splat(simd, from), f32x8::splat(simd, to));
            let touched = (u + wide_u).simd_gt(from)
                & (u - wide_u).simd_lt(to)
                & (v + wide_v).simd_gt(from)
                & (v - wide_v).simd_lt(to);
            inside &= !touched;
        }
        let flats = inside.to_bitmask() as u32 & (1 << flat);
        let (first, last) = (f32x8::splat(simd, 0.0), f32x8::splat(simd, cells));
        let bu = (u + 0.5).floor().max(first).min(last);
        let bv = (v + 0.5).floor().max(first).min(last);
        let (du, dv) = (u - bu, v - bv);
        let (near_u, near_v) = (du.abs().simd_lt(wide_u), dv.abs().simd_lt(wide_v));
        let candidates = (near_u | near_v) & inside;
        if !candidates.any_true() {
            return flats;
        }
        // a kernel wider than a cell nearly always sees an edge
        let wide = f32x8::splat(simd, 0.5);
        if (wide_u.simd_ge(wide) | wide_v.simd_ge(wide)).any_true() {
            return candidates.to_bitmask() as u32 | flats;
        }
        let at: i32x8<S> = (bv * STRIDE as f32 + bu).to_int();
        let mut codes = [0i32; RUN];
        for (code, &at) in codes.iter_mut().zip(at.as_slice()) {
            *code = i32::from(self.pattern.around[at as usize % (STRIDE * STRIDE)]);
        }
        let code = i32x8::simd_from(simd, codes);
        // the four cells that touch the junction are bits 5, 6 (above) and 9, 10
        let across = code ^ (code >> 1);
        let down = code ^ (code >> 4);
        let zero = i32x8::splat(simd, 0);
        let (above, left) = (dv.simd_lt(first), du.simd_lt(first));
        // where the cells on either side of the boundary differ, in this pixel's row or, near it, the next
        let upper = (across & i32x8::splat(simd, 1 << 5)).simd_gt(zero) & (above | near_v);
        let lower = (across & i32x8::splat(simd, 1 << 9)).simd_gt(zero) & (!above | near_v);
        let before = (down & i32x8::splat(simd, 1 << 5)).simd_gt(zero) & (left | near_u);
        let after = (down & i32x8::splat(simd, 1 << 6)).simd_gt(zero) & (!left | near_u);
        let seen = (near_u & (upper | lower)) | (near_v & (before | after));
        (seen & inside).to_bitmask() as u32 | flats
    }
}
