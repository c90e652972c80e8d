//! The lens: pinhole intrinsics and OpenCV's rational distortion.

use crate::pixels::Size;
use glam::{DVec2, DVec3};

/// Intrinsics and distortion of a camera; image coordinates have pixel centers at integers.
///
/// With x = X/Z, y = Y/Z, r² = x²+y²: radial = (1+k1r²+k2r⁴+k3r⁶)/(1+k4r²+k5r⁴+k6r⁶),
/// x' = x·radial + 2p1xy + p2(r²+2x²), y' = y·radial + p1(r²+2y²) + 2p2xy, u = fx·x' + cx, v = fy·y' + cy
/// (OpenCV's calib3d model).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// The picture the numbers hold for.
    pub size: Size,
    /// Focal lengths fx, fy in px.
    pub focal: DVec2,
    /// Principal point cx, cy in px.
    pub center: DVec2,
    /// k1 k2 p1 p2 k3 k4 k5 k6.
    pub distortion: [f64; 8],
}

impl Lens {
    /// The lens assumed without a calibration: fx = fy = max(W, H), centered, undistorted.
    pub fn guess(size: Size) -> Self {
        let focal = size.width.max(size.height).max(1) as f64;
        let center = DVec2::new(size.width as f64 - 1.0, size.height as f64 - 1.0) / 2.0;
        Self { size, focal: DVec2::splat(focal), center, distortion: [0.0; 8] }
    }

    /// Whether the distortion is not the identity.
    pub fn is_distorted(&self) -> bool {
        self.distortion != [0.0; 8]
    }

    /// Distorts a point of the plane z = 1.
    pub fn distort(&self, p: DVec2) -> DVec2 {
        self.distort_with_jacobian(p).0
    }

    /// The distorted point and the columns ∂/∂x, ∂/∂y of the distortion's Jacobian there.
    pub fn distort_with_jacobian(&self, p: DVec2) -> (DVec2, [DVec2; 2]) {
        let [k1, k2, p1, p2, k3, k4, k5, k6] = self.distortion;
        let (x, y) = (p.x, p.y);
        let r2 = x * x + y * y;
        let above = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let below = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
        let radial = above / below;
        // d radial / d r²
        let slope = ((k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3))
            - radial * (k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6)))
            / below;
        let distorted = DVec2::new(
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        );
        let cross = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y;
        let dx = DVec2::new(radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x, cross);
        let dy = DVec2::new(cross, radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x);
        (distorted, [dx, dy])
    }

    /// The pixel that shows a point of camera space; `None` behind the camera (z ≤ 0) or not finite.
    pub fn project(&self, point: DVec3) -> Option<DVec2> {
        if point.z.is_nan() || point.z <= 0.0 {
            return None;
        }
        let px = self.to_pixel(self.distort(DVec2::new(point.x / point.z, point.y / point.z)));
        px.is_finite().then_some(px)
    }

    /// Distorted coordinates on z = 1 → pixel.
    pub fn to_pixel(&self, distorted: DVec2) -> DVec2 {
        distorted * self.focal + self.center
    }

    /// The undistorted point on z = 1 that this pixel shows, by Newton's method; `None` where the
    /// distortion folds over (no preimage found to 1e-12) or the pixel is not finite.
    pub fn undistort(&self, px: DVec2) -> Option<DVec2> {
        let target = (px - self.center) / self.focal;
        if !target.is_finite() {
            return None;
        }
        if !self.is_distorted() {
            return Some(target);
        }
        let mut guess = target;
        for _ in 0..50 {
            let (at, [dx, dy]) = self.distort_with_jacobian(guess);
            let miss = at - target;
            let det = dx.x * dy.y - dy.x * dx.y;
            if det.is_nan() || det <= 1e-6 {
                return None;
            }
            if miss.length_squared() < 1e-26 {
                return Some(guess);
            }
            let step = DVec2::new(dy.y * miss.x - dy.x * miss.y, dx.x * miss.y - dx.y * miss.x) / det;
            guess -= step.clamp_length_max(0.5);
        }
        let miss = self.distort(guess) - target;
        (miss.length_squared() < 1e-24).then_some(guess)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn barrel() -> Lens {
        Lens {
            distortion: [-0.25, 0.05, 1e-3, -5e-4, 0.01, 0.0, 0.0, 0.0],
            ..Lens::guess(Size::new(640, 480))
        }
    }

    #[test]
    fn undistort_inverts_distort_over_the_frame() {
        let lens = barrel();
        for y in (0..480).step_by(37) {
            for x in (0..640).step_by(41) {
                let px = DVec2::new(x as f64, y as f64);
                let ray = lens.undistort(px).expect("inside the frame");
                let back = lens.project(ray.extend(1.0) * 321.0).expect("in front");
                assert!((back - px).length() < 1e-9, "{px} -> {back}");
            }
        }
    }

    #[test]
    fn jacobian_is_the_derivative() {
        let (lens, p, h) = (barrel(), DVec2::new(0.31, -0.22), 1e-6);
        let (_, [dx, dy]) = lens.distort_with_jacobian(p);
        for (axis, column) in [(DVec2::X, dx), (DVec2::Y, dy)] {
            let numeric = (lens.distort(p + axis * h) - lens.distort(p - axis * h)) / (2.0 * h);
            assert!((numeric - column).length() < 1e-9);
        }
    }

    #[test]
    fn nonsense_is_refused() {
        let lens = barrel();
        assert!(lens.project(DVec3::new(0.0, 0.0, -1.0)).is_none());
        assert!(lens.project(DVec3::new(f64::NAN, 0.0, 1.0)).is_none());
        assert!(lens.project(DVec3::new(0.0, 0.0, f64::NAN)).is_none());
        assert!(lens.undistort(DVec2::new(f64::INFINITY, 0.0)).is_none());
        assert!(lens.undistort(DVec2::new(1e6, 1e6)).is_none(), "past the fold of a barrel lens");
    }
}
