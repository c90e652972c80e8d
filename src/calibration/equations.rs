//! The parts of the calibration's equations: derivatives of a point, poses taken out, what remains in doubt.

use crate::geometry::{Lens, Pose, solve_spd};
use glam::{DMat3, DVec2, DVec3};

/// Numbers of the lens that are solved for: fx fy cx cy k1 k2 p1 p2 k3.
pub const NUMBERS: usize = 9;

/// Over the lens's numbers: the lower triangle counts.
pub type Wide = [[f64; NUMBERS]; NUMBERS];

/// A view's own six equations, their right side, and how the lens enters them.
pub type Own = ([[f64; 6]; 6], [f64; 6], [[f64; NUMBERS]; 6]);

/// What the views say together: the lens's equations with the poses eliminated.
pub struct Equations {
    /// Of the lens's numbers.
    pub a: Wide,
    /// Their right side.
    pub b: [f64; NUMBERS],
    /// Of each view.
    pub own: Vec<Own>,
}

/// Takes a view's pose out of the lens's equations: A - Wᵀ V⁻¹ W and b - Wᵀ V⁻¹ r.
pub fn eliminate(
    v: &[[f64; 6]; 6],
    right: &[f64; 6],
    w: &[[f64; NUMBERS]; 6],
    a: &mut Wide,
    b: &mut [f64; NUMBERS],
) -> Option<()> {
    let own = solve_spd(*v, *right)?;
    for i in 0..NUMBERS {
        let column = solve_spd(*v, std::array::from_fn(|k| w[k][i]))?;
        for j in 0..=i {
            a[i][j] -= (0..6).map(|k| w[k][j] * column[k]).sum::<f64>();
        }
        b[i] -= (0..6).map(|k| w[k][i] * own[k]).sum::<f64>();
    }
    Some(())
}

/// Leaves all but the first `count` numbers where they are.
pub fn hold(a: &mut Wide, b: &mut [f64; NUMBERS], count: usize) {
    for i in count..NUMBERS {
        a[i] = [0.0; NUMBERS];
        a[i][i] = 1.0;
        b[i] = 0.0;
    }
}

/// Square roots of the diagonal of the inverse, times the variance of a coordinate.
pub fn deviations(equations: &Equations, variance: f64) -> Option<[f64; NUMBERS]> {
    let (mut a, mut b) = (equations.a, equations.b);
    for (v, right, w) in &equations.own {
        eliminate(v, right, w, &mut a, &mut b)?;
    }
    // in units in which the diagonal is 1, so that the pivots are judged alike
    let units: [f64; NUMBERS] = std::array::from_fn(|i| 1.0 / a[i][i].sqrt());
    for (i, row) in a.iter_mut().enumerate() {
        for (j, v) in row.iter_mut().enumerate() {
            *v *= units[i] * units[j];
        }
    }
    let mut out = [0.0; NUMBERS];
    for (i, out) in out.iter_mut().enumerate() {
        let column = solve_spd(a, std::array::from_fn(|k| f64::from(u8::from(k == i))))?;
        *out = (column[i] * variance).sqrt() * units[i];
    }
    out.iter().all(|v| v.is_finite()).then_some(out)
}

/// A point's miss (seen - expected, px) and the derivatives of the expected place: by the lens's numbers, and by a
/// turn of the sheet about the camera's axes (radians) with a shift in `unit` mm. `None` behind the camera.
#[expect(clippy::type_complexity, reason = "both axes' rows")]
pub fn derivatives(
    lens: &Lens,
    pose: &Pose,
    unit: f64,
    sheet: DVec2,
    px: DVec2,
) -> Option<(DVec2, [[f64; NUMBERS]; 2], [[f64; 6]; 2])> {
    let turned = pose.rotation * sheet.extend(0.0);
    let p = turned + pose.translation;
    if p.z.is_nan() || p.z <= 0.0 {
        return None;
    }
    let flat = DVec2::new(p.x / p.z, p.y / p.z);
    let (distorted, [dx, dy]) = lens.distort_with_jacobian(flat);
    let (f, DVec2 { x, y }) = (lens.focal, flat);
    let r2 = flat.length_squared();
    let below = {
        let [.., k4, k5, k6] = lens.distortion;
        1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
    };
    let radial = |power: f64| flat * (power / below);
    // k1 k2 p1 p2 k3
    let by_k = [
        radial(r2),
        radial(r2 * r2),
        DVec2::new(2.0 * x * y, r2 + 2.0 * y * y),
        DVec2::new(r2 + 2.0 * x * x, 2.0 * x * y),
        radial(r2 * r2 * r2),
    ];
    let by_lens = [0, 1].map(|axis| {
        let only = |k: usize, v: f64| if k == axis { v } else { 0.0 };
        let k = by_k.map(|k| k[axis] * f[axis]);
        [only(0, distorted.x), only(1, distorted.y), only(0, 1.0), only(1, 1.0), k[0], k[1], k[2], k[3], k[4]]
    });
    let by_pose = [0, 1].map(|axis| {
        let (du, dv) = (dx[axis] * f[axis] / p.z, dy[axis] * f[axis] / p.z);
        let by_point = DVec3::new(du, dv, -(du * x + dv * y));
        let (turn, shift) = (turned.cross(by_point), by_point * unit);
        [turn.x, turn.y, turn.z, shift.x, shift.y, shift.z]
    });
    Some((px - lens.to_pixel(distorted), by_lens, by_pose))
}

/// The pose after a step of [`derivatives`]' unknowns; the rotation stays exact (Cayley's form).
pub fn moved(pose: &Pose, unit: f64, step: [f64; 6]) -> Pose {
    let h = DVec3::new(step[0], step[1], step[2]) * 0.5;
    let k = 2.0 / (1.0 + h.length_squared());
    let skew =
        DMat3::from_cols(DVec3::new(0.0, h.z, -h.y), DVec3::new(-h.z, 0.0, h.x), DVec3::new(h.y, -h.x, 0.0));
    let turn = DMat3::IDENTITY + (skew + skew * skew) * k;
    Pose {
        rotation: turn * pose.rotation,
        translation: pose.translation + DVec3::new(step[3], step[4], step[5]) * unit,
    }
}
