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
fn orthonormal(m: DMat3) -> Option<DMat3> {
    let mut m = m;
    for _ in 0..2 {
        let x = m.x_axis / m.x_axis.length();
        let y = m.y_axis - x * x.dot(m.y_axis);
        let y = y / y.length();
        m = DMat3::from_cols(x, y, x.cross(y));
    }
    m.is_finite().then_some(m)
}

/// Sum of squared reprojection errors, px²; infinite behind the camera.
fn cost(pose: &Pose, corners_px: &[DVec2; 4], print: &[DVec3; 4], lens: &Lens) -> f64 {
    let mut sum = 0.0;
    for (corner, point) in corners_px.iter().zip(print) {
        match lens.project(pose.apply(*point)) {
            Some(px) => sum += (px - *corner).length_squared(),
            None => return f64::INFINITY,
        }
    }
    sum
}

/// Levenberg-Marquardt from a start; `None` when it does not end in a finite pose before the camera.
fn refine(start: Pose, corners_px: &[DVec2; 4], side_mm: f64, lens: &Lens) -> Option<Solved> {
    let print = corners_mm(side_mm);
    let mut pose = start;
    let mut now = cost(&pose, corners_px, &print, lens);
    if !now.is_finite() {
        return None;
    }
    let mut damping = 1e-4;
    for _ in 0..STEPS {
        let Some((a, b)) = equations(&pose, corners_px, &print, lens) else { break };
        let mut damped = a;
        for (i, row) in damped.iter_mut().enumerate() {
            row[i] += damping * row[i] + 1e-300;
        }
        let Some(step) = solve_spd(damped, b) else { break };
        let next = Pose {
            rotation: cayley(DVec3::new(step[0], step[1], step[2])) * pose.rotation,
            translation: pose.translation + DVec3::new(step[3], step[4], step[5]) * side_mm,
        };
        let then = cost(&next, corners_px, &print, lens);
        if then < now {
            let gain = now - then;
            (pose, now) = (next, then);
            damping = (damping * 0.1).max(1e-12);
            if gain <= 1e-12 * now + 1e-24 {
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
    let error_px = (cost(&pose, corners_px, &print, lens) * 0.25).sqrt();
    (error_px.is_finite() && pose.translation.is_finite()).then_some(Solved { pose, error_px })
}

/// A rotation by about `turn` (radians along each axis), exactly orthonormal without sine or cosine.
fn cayley(turn: DVec3) -> DMat3 {
    let h = turn * 0.5;
    let k = 2.0 / (1.0 + h.length_squared());
    let skew =
        DMat3::from_cols(DVec3::new(0.0, h.z, -h.y), DVec3::new(-h.z, 0.0, h.x), DVec3::new(h.y, -h.x, 0.0));
    DMat3::IDENTITY + (skew + skew * skew) * k
}

type Equations = ([[f64; 6]; 6], [f64; 6]);

/// Normal equations of the reprojection error by a turn (left of the rotation) and a shift in sides.
fn equations(pose: &Pose, corners_px: &[DVec2; 4], print: &[DVec3; 4], lens: &Lens) -> Option<Equations> {
    let side = print[1].x - print[0].x;
    let (mut a, mut b) = ([[0.0; 6]; 6], [0.0; 6]);
    for (corner, point) in corners_px.iter().zip(print) {
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
            let row = [by_turn.x, by_turn.y, by_turn.z, by_shift.x, by_shift.y, by_shift.z];
            for i in 0..6 {
                for j in 0..=i {
                    a[i][j] += row[i] * row[j];
                }
                b[i] += row[i] * miss[axis];
            }
        }
    }
    Some((a, b))
}
