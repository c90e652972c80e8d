//! A first guess of lens and poses: homographies, and what they say of the focal length.

use super::View;
use crate::geometry::{Lens, Pose, solve_spd};
use crate::pixels::Size;
use glam::{DMat3, DVec2, DVec3};

/// The sheet → picture homography by least squares (Hartley's normalization; the entry lower right is 1, which holds
/// since the points' middle is seen). `None` where the points do not decide one.
pub fn homography(view: &View) -> Option<DMat3> {
    let from = normalizer(view.points.iter().map(|p| p.sheet_mm))?;
    let to = normalizer(view.points.iter().map(|p| p.px))?;
    let apply = |m: &DMat3, p: DVec2| (*m * p.extend(1.0)).truncate();
    let (mut a, mut b) = ([[0.0; 8]; 8], [0.0; 8]);
    for point in &view.points {
        let (s, p) = (apply(&from, point.sheet_mm), apply(&to, point.px));
        let rows = [
            ([s.x, s.y, 1.0, 0.0, 0.0, 0.0, -p.x * s.x, -p.x * s.y], p.x),
            ([0.0, 0.0, 0.0, s.x, s.y, 1.0, -p.y * s.x, -p.y * s.y], p.y),
        ];
        for (row, right) in rows {
            for i in 0..8 {
                for j in 0..=i {
                    a[i][j] += row[i] * row[j];
                }
                b[i] += row[i] * right;
            }
        }
    }
    let h = solve_spd(a, b)?;
    let rows = DMat3::from_cols(
        DVec3::new(h[0], h[1], h[2]),
        DVec3::new(h[3], h[4], h[5]),
        DVec3::new(h[6], h[7], 1.0),
    );
    let map = to.inverse() * rows.transpose() * from;
    map.is_finite().then_some(map)
}

/// Moves points to mean 0 and mean distance √2.
fn normalizer(points: impl Iterator<Item = DVec2> + Clone) -> Option<DMat3> {
    let count = points.clone().count() as f64;
    let mean = points.clone().sum::<DVec2>() / count;
    let reach = points.map(|p| (p - mean).length()).sum::<f64>() / count;
    let scale = std::f64::consts::SQRT_2 / reach;
    let m = DMat3::from_cols(
        DVec3::new(scale, 0.0, 0.0),
        DVec3::new(0.0, scale, 0.0),
        (-mean * scale).extend(1.0),
    );
    (scale > 0.0 && m.is_finite()).then_some(m)
}

/// Focal lengths from homographies, the principal point taken to be the picture's middle: each says that the sheet's
/// axes are perpendicular and equally long (Zhang 2000, A Flexible New Technique for Camera Calibration, eq. 3 and 4
/// with two unknowns). The guess of [`Lens::guess`] where they decide nothing.
pub fn lens(maps: &[DMat3], size: Size) -> Lens {
    let guess = Lens::guess(size);
    let center = DMat3::from_cols(DVec3::X, DVec3::Y, (-guess.center).extend(1.0));
    let (mut a, mut b) = ([[0.0; 2]; 2], [0.0; 2]);
    for map in maps {
        let map = center * *map;
        let (x, y) = (map.x_axis, map.y_axis);
        let scale = 1.0 / (x.length() * y.length());
        let rows = [(x * y, 1.0), ((x * x - y * y) * 0.5, 1.0)];
        for (row, weight) in rows {
            let row = row * (weight * scale);
            for i in 0..2 {
                for j in 0..=i {
                    a[i][j] += row[i] * row[j];
                }
                b[i] -= row[i] * row.z;
            }
        }
    }
    let longest = size.width.max(size.height) as f64;
    let usable = |f: f64| (0.2 * longest..=20.0 * longest).contains(&f);
    // one focal length for both axes where two are not decided
    let both = (b[0] + b[1]) / (a[0][0] + a[1][1] + 2.0 * a[1][0]);
    let focal = solve_spd(a, b)
        .map(|[x, y]| DVec2::new(1.0 / x.sqrt(), 1.0 / y.sqrt()))
        .filter(|f| usable(f.x) && usable(f.y) && (0.7..=1.4).contains(&(f.x / f.y)))
        .or(Some(DVec2::splat(1.0 / both.sqrt())).filter(|f| usable(f.x)));
    Lens { focal: focal.unwrap_or(guess.focal), ..guess }
}

/// The sheet's pose from its homography and the lens without distortion (Zhang 2000, §3.1).
pub fn pose(map: &DMat3, lens: &Lens) -> Option<Pose> {
    let inverse = DMat3::from_cols(
        DVec3::new(1.0 / lens.focal.x, 0.0, 0.0),
        DVec3::new(0.0, 1.0 / lens.focal.y, 0.0),
        DVec3::new(-lens.center.x / lens.focal.x, -lens.center.y / lens.focal.y, 1.0),
    );
    let m = inverse * *map;
    let scale = 2.0 / (m.x_axis.length() + m.y_axis.length());
    // before the camera
    let scale = if m.z_axis.z < 0.0 { -scale } else { scale };
    let x = (m.x_axis * scale).normalize();
    let y = m.y_axis * scale;
    let y = (y - x * x.dot(y)).normalize();
    let rotation = DMat3::from_cols(x, y, x.cross(y));
    let translation = m.z_axis * scale;
    (rotation.is_finite() && translation.is_finite() && translation.z > 0.0)
        .then_some(Pose { rotation, translation })
}
