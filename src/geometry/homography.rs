//! Plane-to-plane projective maps.

use glam::{DMat3, DVec2, DVec3};

/// A projective map of the plane, H·(x, y, 1)ᵀ up to scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Homography(pub DMat3);

impl Homography {
    /// The map that takes the square's corners (-1,1), (1,1), (1,-1), (-1,-1) (top-left first, y up) to the
    /// four given points; `None` when three of them are nearly collinear or one is not finite.
    ///
    /// Closed form of Heckbert 1989 (Fundamentals of Texture Mapping, §2.2.3).
    pub fn from_square(corners: [DVec2; 4]) -> Option<Self> {
        let [p0, p1, p2, p3] = corners;
        let (d1, d2, sum) = (p1 - p2, p3 - p2, p0 - p1 + p2 - p3);
        let det = d1.perp_dot(d2);
        let extent = d1.length_squared().max(d2.length_squared());
        if !det.is_finite() || det.abs() <= 1e-9 * extent || !sum.is_finite() {
            return None;
        }
        let (g, h) = (sum.perp_dot(d2) / det, d1.perp_dot(sum) / det);
        // unit square (s right, t down) → image
        let unit =
            DMat3::from_cols(((p1 - p0) + g * p1).extend(g), ((p3 - p0) + h * p3).extend(h), p0.extend(1.0));
        // (x, y) in ±1 with y up → (s, t)
        let to_unit = DMat3::from_cols(
            DVec3::new(0.5, 0.0, 0.0),
            DVec3::new(0.0, -0.5, 0.0),
            DVec3::new(0.5, 0.5, 1.0),
        );
        let map = Self(unit * to_unit);
        // a fold inside the square means the corners were not those of a seen square
        let front = [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)];
        let positive = |&(x, y): &(f64, f64)| (map.0 * DVec3::new(x, y, 1.0)).z > 1e-12;
        (map.0.is_finite() && front.iter().all(positive)).then_some(map)
    }

    /// The image of a point; not finite where the point maps to infinity.
    pub fn apply(&self, p: DVec2) -> DVec2 {
        let q = self.0 * p.extend(1.0);
        DVec2::new(q.x / q.z, q.y / q.z)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn square_corners_go_where_told() {
        let corners =
            [DVec2::new(10.0, 20.0), DVec2::new(95.0, 31.0), DVec2::new(80.0, 99.0), DVec2::new(5.0, 70.0)];
        let map = Homography::from_square(corners).expect("convex");
        for (corner, (x, y)) in corners.into_iter().zip([(-1., 1.), (1., 1.), (1., -1.), (-1., -1.)]) {
            assert!((map.apply(DVec2::new(x, y)) - corner).length() < 1e-9);
        }
    }

    #[test]
    fn degenerate_corners_are_refused() {
        let line = [DVec2::ZERO, DVec2::X, DVec2::X * 2.0, DVec2::X * 3.0];
        assert!(Homography::from_square(line).is_none());
        assert!(Homography::from_square([DVec2::ZERO; 4]).is_none());
        assert!(Homography::from_square([DVec2::NAN; 4]).is_none());
        let arrow = [DVec2::ZERO, DVec2::new(4.0, 0.0), DVec2::new(1.0, 1.0), DVec2::new(0.0, 4.0)];
        assert!(Homography::from_square(arrow).is_none(), "a reflex corner is no square in view");
    }
}
