//! The normal equations in plain f64, as the module's first lines say them: every cell of the print weighed by
//! the kernel, no tables, no lanes.

use super::Fit;
use super::equations::Sums;
use super::gather::{QUIET, Samples};
use crate::marker::{Family, Ink};
use glam::DVec2;

/// S(z): how much of the kernel 15/16 (1 - z²)² lies below z, and the kernel itself.
fn kernel(z: f64) -> (f64, f64) {
    let z = z.clamp(-1.0, 1.0);
    let bell = 15.0 / 16.0 * (1.0 - z * z) * (1.0 - z * z);
    (0.5 + 15.0 / 16.0 * (z - 2.0 / 3.0 * z * z * z + z * z * z * z * z / 5.0), bell)
}

/// The weight of cell `i` at `u` for a kernel of half-width `w`, and its derivatives by u and by ln w.
fn weight(i: isize, u: f64, w: f64) -> [f64; 3] {
    let at = |boundary: f64| {
        let (share, bell) = kernel((u - boundary) / w);
        [share, bell / w, -(u - boundary) / w * bell]
    };
    let (low, high) = (at(i as f64), at((i + 1) as f64));
    [0, 1, 2].map(|k| low[k] - high[k])
}

/// Residual, its derivatives by the unknowns, and the residual's weight (Geman & McClure).
fn row(family: Family, id: u32, fit: &Fit, p: DVec2, gray: f64) -> (f64, [f64; super::UNKNOWNS], f64) {
    let code = family.code(id).expect("a known number");
    let cells = family.cells() as f64;
    let inverse = fit.map.inverse();
    let place = |p: DVec2| {
        let q = inverse * p.extend(1.0);
        DVec2::new(q.x / q.z, q.y / q.z)
    };
    let square = place(p);
    let (u, v) = ((square.x + 1.0) * 0.5 * cells, (1.0 - square.y) * 0.5 * cells);
    // ∂square/∂p from the homography's own derivative
    let (m, h) = (fit.map, square);
    let w = m.x_axis.z * h.x + m.y_axis.z * h.y + m.z_axis.z;
    let column = |c: glam::DVec3| DVec2::new(c.x - p.x * c.z, c.y - p.y * c.z) / w;
    let jacobian = glam::DMat2::from_cols(column(m.x_axis), column(m.y_axis)).inverse();
    let by = |r: usize, sign: f64| DVec2::new(jacobian.x_axis[r], jacobian.y_axis[r]) * (0.5 * cells * sign);
    let (grad_u, grad_v) = (by(0, 1.0), by(1, -1.0));
    let [xx, xy, yy] = fit.blur;
    let wide = |g: DVec2| (xx * g.x * g.x + 2.0 * xy * g.x * g.y + yy * g.y * g.y).sqrt().clamp(1e-3, 1.5);
    let (wide_u, wide_v) = (wide(grad_u), wide(grad_v));

    let (mut value, mut by_u, mut by_v, mut by_wide_u, mut by_wide_v) = (0.0, 0.0, 0.0, 0.0, 0.0);
    let near = |v: f64| v.floor() as isize - 3..=v.floor() as isize + 3;
    for i in near(u) {
        for j in near(v) {
            if family.ink(code, i, j) == Ink::White {
                let (a, b) = (weight(i, u, wide_u), weight(j, v, wide_v));
                value += a[0] * b[0];
                by_u += a[1] * b[0];
                by_v += a[0] * b[1];
                by_wide_u += a[2] * b[0];
                by_wide_v += a[0] * b[2];
            }
        }
    }
    let l = &fit.levels;
    let step = l[3] + l[4] * h.x + l[5] * h.y;
    let miss = gray - (l[0] + l[1] * h.x + l[2] * h.y) - step * value;
    let g = (grad_u * by_u + grad_v * by_v) * (-step / w);
    let inward = -g.dot(p);
    let size = 0.5 * (xx + yy);
    let blur = |a: f64, b: f64| {
        step * size * (by_wide_u * a / (wide_u * wide_u) + by_wide_v * b / (wide_v * wide_v))
    };
    let derivatives = [
        g.x * h.x,
        g.x * h.y,
        g.x,
        g.y * h.x,
        g.y * h.y,
        g.y,
        inward * h.x,
        inward * h.y,
        1.0,
        h.x,
        h.y,
        value,
        value * h.x,
        value * h.y,
        blur(0.5 * grad_u.x * grad_u.x, 0.5 * grad_v.x * grad_v.x),
        blur(grad_u.x * grad_u.y, grad_v.x * grad_v.y),
        blur(0.5 * grad_u.y * grad_u.y, 0.5 * grad_v.y * grad_v.y),
    ];
    let root = 1.0 / (1.0 + (miss / fit.reach) * (miss / fit.reach));
    (miss, derivatives, root * root)
}

/// Whether a place is on the print or the quiet zone that is looked at, and whether an edge's kernel reaches it.
pub fn reach(family: Family, id: u32, fit: &Fit, p: DVec2) -> (bool, bool) {
    let q = fit.map.inverse() * p.extend(1.0);
    let within = (q.truncate() / q.z).abs().max_element() < 1.0 + 2.0 * QUIET / family.cells() as f64;
    let (_, derivatives, _) = row(family, id, fit, p, 0.0);
    (within, derivatives[2].abs().max(derivatives[5].abs()) > 1e-6)
}

/// The equations of the samples.
pub fn normal(family: Family, id: u32, samples: &Samples, fit: &Fit) -> Sums {
    let mut sums = Sums { a: Default::default(), b: Default::default(), squares: 0.0, weights: 0.0 };
    for k in 0..samples.count {
        let p = DVec2::new(f64::from(samples.x[k]), f64::from(samples.y[k]));
        let (miss, row, weight) = row(family, id, fit, p, f64::from(samples.gray[k]));
        for i in 0..row.len() {
            for j in 0..=i {
                sums.a[i][j] += weight * row[i] * row[j];
            }
            sums.b[i] += weight * row[i] * miss;
        }
        sums.squares += weight * miss * miss;
        sums.weights += weight;
    }
    sums
}
