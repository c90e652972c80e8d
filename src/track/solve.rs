//! Corners → poses: both minima of a square's pose problem, refined through the lens.
//!
//! IPPE (Collins & Bartoli, "Infinitesimal Plane-Based Pose Estimation", IJCV 2014) gives two poses that
//! explain the homography's first order at the center; each is then refined by Levenberg-Marquardt on the
//! reprojection error of the four corners, in pixels, distortion included.

use crate::frame::Solved;
use crate::geometry::{Homography, Lens, Pose, solve_spd};
use glam::{DMat2, DMat3, DVec2, DVec3};

/// Most Levenberg-Marquardt steps.
const STEPS: usize = 20;
/// Two poses closer than this, in radians, are one.
const SAME_RAD: f64 = 2e-3;
/// Gain below which nothing is left to gain: of the cost, and at all.
const ENOUGH: [f64; 2] = [1e-12, 1e-24];
/// The same where the cost counts deviations.
const ENOUGH_DEVIATIONS: [f64; 2] = [1e-6, 1e-4];

/// Inverse covariance of the corners (x0 y0 x1 ... y3), all of it.
pub type Weights = [[f64; 8]; 8];

/// One minimum of the pose problem as corners of known covariance see it.
#[derive(Clone, Copy, Debug)]
pub struct Minimum {
    /// Marker → camera.
    pub pose: Pose,
    /// Root mean square reprojection error, px.
    pub error_px: f64,
    /// Squared reprojection error in units of the corners' deviations: 2 on average where the pose is right.
    pub cost: f64,
    /// Inverse covariance of the pose: a turn left of the rotation, a shift in sides.
    pub information: [[f64; 6]; 6],
}

impl Minimum {
    /// Where this pose puts the corners, ideal pixels; `None` behind the camera.
    pub fn corners(&self, side: f64, lens: &Lens) -> Option<[DVec2; 4]> {
        let mut out = [DVec2::ZERO; 4];
        for (px, mm) in out.iter_mut().zip(corners_mm(side)) {
            *px = lens.project(self.pose.apply(mm))?;
        }
        Some(out)
    }
}

/// Both minima, the cheaper first, for corners in ideal pixels (`lens` without distortion) of known covariance.
pub fn minima(corners: &[DVec2; 4], weights: &Weights, side: f64, lens: &Lens) -> [Option<Minimum>; 2] {
    let Some(starts) = ippe(corners, side, lens) else { return [None; 2] };
    let [first, second] = starts.map(|start| {
        let pose = descend(start, corners, Some(weights), side, lens)?;
        let print = corners_mm(side);
        let (information, _) = equations(&pose, corners, Some(weights), &print, side, lens)?;
        let cost = |weights| cost(&pose, corners, weights, &print, lens);
        let error_px = (cost(None) * 0.25).sqrt();
        Some(Minimum { pose, error_px, cost: cost(Some(weights)), information })
    });
    match (first, second) {
        (Some(a), Some(b)) => {
            let (best, other) = if b.cost < a.cost { (b, a) } else { (a, b) };
            let distinct = best.pose.angle_to(&other.pose) > SAME_RAD;
            [Some(best), distinct.then_some(other)]
        }
        (one, other) => [one.or(other), None],
    }
}

/// Solves the pose of a square marker from its four corners.
///
/// `corners_px`: image pixels, centers at integers, TL TR BR BL. `side_mm`: printed black edge. Returns marker →
/// camera with the smaller reprojection error first, and the second minimum where there is one. `(None, None)`
/// when the corners are not finite, nearly collinear, not clockwise, or do not stand before the camera.
pub fn solve(corners_px: &[DVec2; 4], side_mm: f64, lens: &Lens) -> (Option<Solved>, Option<Solved>) {
    if !(side_mm.is_finite() && side_mm > 0.0) {
        return (None, None);
    }
    let Some([first, second]) = ippe(corners_px, side_mm, lens) else { return (None, None) };
    let first = refine(first, corners_px, side_mm, lens);
    let second = refine(second, corners_px, side_mm, lens);
    match (first, second) {
        (Some(a), Some(b)) => {
            let (best, other) = if b.error_px < a.error_px { (b, a) } else { (a, b) };
            let distinct = best.pose.angle_to(&other.pose) > SAME_RAD;
            (Some(best), distinct.then_some(other))
        }
        (one, other) => (one.or(other), None),
    }
}

/// The corners of the print in its own frame, mm.
pub fn corners_mm(side_mm: f64) -> [DVec3; 4] {
    let half = 0.5 * side_mm;
    [(-half, half), (half, half), (half, -half), (-half, -half)].map(|(x, y)| DVec3::new(x, y, 0.0))
}

/// The two IPPE poses (§4: eq. 9-13 of the paper).
fn ippe(corners_px: &[DVec2; 4], side_mm: f64, lens: &Lens) -> Option<[Pose; 2]> {
    let mut rays = [DVec2::ZERO; 4];
    for (ray, px) in rays.iter_mut().zip(corners_px) {
        *ray = lens.undistort(*px)?;
    }
    let map = Homography::from_square(rays)?.0;
    let map = map * (1.0 / map.z_axis.z);
    // image of the center and the Jacobian there, per half side
    let center = DVec2::new(map.z_axis.x, map.z_axis.y);
    let column = |c: DVec3| DVec2::new(c.x, c.y) - center * c.z;
    let jacobian = DMat2::from_cols(column(map.x_axis), column(map.y_axis));
    if jacobian.determinant() >= 0.0 || !jacobian.is_finite() {
        // y up in the print, y down in the picture: seen from the front the sign is negative
        return None;
    }
    // the rotation that takes the optical axis to the center's ray
    let ray = center.extend(1.0) / center.extend(1.0).length();
    let towards = axis_to(ray);
    // columns of [1 0 -p; 0 1 -q]·R_v, upper left
    let project = |c: DVec3| DVec2::new(c.x - center.x * c.z, c.y - center.y * c.z);
    let b = DMat2::from_cols(project(towards.x_axis), project(towards.y_axis));
    let a = b.inverse() * jacobian;
    // largest singular value
    let (r0, r1) = (DVec2::new(a.x_axis.x, a.y_axis.x), DVec2::new(a.x_axis.y, a.y_axis.y));
    let (s, t, u) = (r0.length_squared(), r1.length_squared(), r0.dot(r1));
    let gamma = (0.5 * (s + t + ((s - t) * (s - t) + 4.0 * u * u).sqrt())).sqrt();
    if !(gamma > 1e-12 && gamma.is_finite()) {
        return None;
    }
    let (c0, c1) = (a.x_axis / gamma, a.y_axis / gamma);
    // the third row makes the columns unit and orthogonal
    let z0 = (1.0 - c0.length_squared()).max(0.0).sqrt();
    let z1 = (1.0 - c1.length_squared()).max(0.0).sqrt();
    let z1 = if c0.dot(c1) > 0.0 { -z1 } else { z1 };
    let translation = center.extend(1.0) * (0.5 * side_mm / gamma);
    let pose = |sign: f64| {
        let (x, y) = (c0.extend(sign * z0), c1.extend(sign * z1));
        let rotation = orthonormal(towards * DMat3::from_cols(x, y, x.cross(y)))?;
        Some(Pose { rotation, translation })
    };
    Some([pose(1.0)?, pose(-1.0)?])
}

/// The rotation by the shortest arc that takes +z to the unit vector `ray` (z > 0). Rodrigues.
fn axis_to(ray: DVec3) -> DMat3 {
    let (x, y, z) = (ray.x, ray.y, ray.z);
    let k = 1.0 / (1.0 + z);
    DMat3::from_cols(
        DVec3::new(1.0 - x * x * k, -x * y * k, -x),
        DVec3::new(-x * y * k, 1.0 - y * y * k, -y),
        DVec3::new(x, y, z),
    )
}

/// The nearest rotation by Gram-Schmidt, twice for full precision; `None` when the columns are degenerate.
pub(super) fn orthonormal(m: DMat3) -> Option<DMat3> {
    let mut m = m;
    for _ in 0..2 {
        let x = m.x_axis / m.x_axis.length();
        let y = m.y_axis - x * x.dot(m.y_axis);
        let y = y / y.length();
        m = DMat3::from_cols(x, y, x.cross(y));
    }
    m.is_finite().then_some(m)
}

/// Squared reprojection error, px² or deviations; infinite behind the camera.
pub(super) fn cost(
    pose: &Pose,
    corners_px: &[DVec2; 4],
    weights: Option<&Weights>,
    print: &[DVec3; 4],
    lens: &Lens,
) -> f64 {
    let mut miss = [0.0; 8];
    for (i, (corner, point)) in corners_px.iter().zip(print).enumerate() {
        let Some(px) = lens.project(pose.apply(*point)) else { return f64::INFINITY };
        (miss[2 * i], miss[2 * i + 1]) = (corner.x - px.x, corner.y - px.y);
    }
    match weights {
        None => miss.iter().map(|v| v * v).sum(),
        Some(weights) => weights.iter().zip(&miss).map(|(row, v)| v * dot(row, &miss)).sum(),
    }
}

fn dot(a: &[f64; 8], b: &[f64; 8]) -> f64 {
    (0..8).map(|i| a[i] * b[i]).sum()
}

/// Levenberg-Marquardt on the plain reprojection error.
fn refine(start: Pose, corners_px: &[DVec2; 4], side_mm: f64, lens: &Lens) -> Option<Solved> {
    let pose = descend(start, corners_px, None, side_mm, lens)?;
    let error_px = (cost(&pose, corners_px, None, &corners_mm(side_mm), lens) * 0.25).sqrt();
    error_px.is_finite().then_some(Solved { pose, error_px })
}

/// Levenberg-Marquardt from a start; `None` when it does not end in a finite pose before the camera.
fn descend(
    start: Pose,
    corners_px: &[DVec2; 4],
    weights: Option<&Weights>,
    side_mm: f64,
    lens: &Lens,
) -> Option<Pose> {
    let print = corners_mm(side_mm);
    let mut pose = start;
    let mut now = cost(&pose, corners_px, weights, &print, lens);
    if !now.is_finite() {
        return None;
    }
    let [part, least] = if weights.is_some() { ENOUGH_DEVIATIONS } else { ENOUGH };
    let mut damping = 1e-4;
    for _ in 0..STEPS {
        let Some((a, b)) = equations(&pose, corners_px, weights, &print, side_mm, lens) else { break };
        let mut damped = a;
        for (i, row) in damped.iter_mut().enumerate() {
            row[i] += damping * row[i] + 1e-300;
        }
        let Some(step) = solve_spd(damped, b) else { break };
        let next = Pose {
            rotation: cayley(DVec3::new(step[0], step[1], step[2])) * pose.rotation,
            translation: pose.translation + DVec3::new(step[3], step[4], step[5]) * side_mm,
        };
        let then = cost(&next, corners_px, weights, &print, lens);
        if then < now {
            let gain = now - then;
            (pose, now) = (next, then);
            damping = (damping * 0.1).max(1e-12);
            if gain <= part * now + least {
                break;
            }
        } else {
            damping *= 10.0;
            if damping > 1e8 {
                break;
            }
        }
    }
    let pose = Pose { rotation: orthonormal(pose.rotation)?, translation: pose.translation };
    pose.translation.is_finite().then_some(pose)
}

/// A rotation by about `turn` (radians along each axis), exactly orthonormal without sine or cosine.
pub(super) fn cayley(turn: DVec3) -> DMat3 {
    let h = turn * 0.5;
    let k = 2.0 / (1.0 + h.length_squared());
    let skew =
        DMat3::from_cols(DVec3::new(0.0, h.z, -h.y), DVec3::new(-h.z, 0.0, h.x), DVec3::new(h.y, -h.x, 0.0));
    DMat3::IDENTITY + (skew + skew * skew) * k
}

type Equations = ([[f64; 6]; 6], [f64; 6]);

/// Normal equations of the reprojection error of four points (`print`) by a turn (left of the rotation) and a shift
/// in units of `side`: A's lower triangle and the right side.
pub(super) fn equations(
    pose: &Pose,
    corners_px: &[DVec2; 4],
    weights: Option<&Weights>,
    print: &[DVec3; 4],
    side: f64,
    lens: &Lens,
) -> Option<Equations> {
    let (mut rows, mut misses) = ([[0.0; 8]; 6], [0.0; 8]);
    for (k, (corner, point)) in corners_px.iter().zip(print).enumerate() {
        let turned = pose.rotation * *point;
        let p = turned + pose.translation;
        if p.z.is_nan() || p.z <= 0.0 {
            return None;
        }
        let flat = DVec2::new(p.x / p.z, p.y / p.z);
        let (distorted, [dx, dy]) = lens.distort_with_jacobian(flat);
        let miss = *corner - lens.to_pixel(distorted);
        for axis in 0..2 {
            let (du, dv) = (dx[axis] * lens.focal[axis] / p.z, dy[axis] * lens.focal[axis] / p.z);
            // by the camera-space point, then by turn × point
            let by_point = DVec3::new(du, dv, -(du * flat.x + dv * flat.y));
            let by_turn = turned.cross(by_point);
            let by_shift = by_point * side;
            let at = 2 * k + axis;
            let row = [by_turn.x, by_turn.y, by_turn.z, by_shift.x, by_shift.y, by_shift.z];
            for (line, v) in rows.iter_mut().zip(row) {
                line[at] = v;
            }
            misses[at] = miss[axis];
        }
    }
    let weigh = |row: &[f64; 8]| match weights {
        None => *row,
        Some(weights) => std::array::from_fn(|i| dot(&weights[i], row)),
    };
    let (mut a, mut b) = ([[0.0; 6]; 6], [0.0; 6]);
    for i in 0..6 {
        let row = weigh(&rows[i]);
        for j in 0..=i {
            a[i][j] = dot(&row, &rows[j]);
        }
        b[i] = dot(&row, &misses);
    }
    Some((a, b))
}
