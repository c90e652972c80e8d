//! What of the lens can be drawn: the cone of rays around the picture, and how far an edge may reach
//! before the lens bends it visibly.

use crate::geometry::Lens;
use fearless_simd::{Simd, SimdBase, f64x4, mask64x4};
use glam::DVec2;

/// Largest distance, px, between a drawn straight edge and the curve that the lens makes of it.
pub(super) const SPLIT_TOLERANCE_PX: f64 = 0.1;

/// Beyond this many pixels from the origin undistorted triangles are cut: 2^21 px keep every product of
/// two snapped coordinates in 62 bits.
const GUARD_PX: f64 = 2_000_000.0;

/// A lens and the rays that may go through it.
#[derive(Clone, Debug)]
pub(super) struct Field {
    lens: Lens,
    distorted: bool,
    /// Bounds of x/z and y/z: inside, the lens is one-to-one and snapped coordinates fit.
    low: DVec2,
    high: DVec2,
    /// An edge shorter than this, px, stays within the tolerance.
    straight_px: f64,
}

impl Field {
    pub fn new(lens: Lens) -> Self {
        let distorted = lens.is_distorted();
        let mut field = Self { lens, distorted, low: DVec2::ZERO, high: DVec2::ZERO, straight_px: f64::MAX };
        let usable = lens.focal.is_finite() && lens.center.is_finite() && lens.focal.min_element() > 0.0;
        if !usable {
            field.high = DVec2::splat(-1.0);
        } else if distorted {
            field.measure();
        } else {
            field.low = (DVec2::splat(-GUARD_PX) - lens.center) / lens.focal;
            field.high = (DVec2::splat(GUARD_PX) - lens.center) / lens.focal;
        }
        field
    }

    /// Samples the picture: its rays bound the field, its strongest bend bounds the straight edges.
    fn measure(&mut self) {
        const STEPS: usize = 32;
        const H: f64 = 1e-4;
        let lens = &self.lens;
        let extent = DVec2::new(lens.size.width as f64, lens.size.height as f64);
        let (mut low, mut high) = (DVec2::splat(f64::MAX), DVec2::splat(f64::MIN));
        let (mut bend, mut scale) = (0.0f64, f64::MAX);
        for j in 0..=STEPS {
            for i in 0..=STEPS {
                let px = extent * DVec2::new(i as f64, j as f64) / STEPS as f64 - 0.5;
                let Some(ray) = lens.undistort(px) else { continue };
                low = low.min(ray);
                high = high.max(ray);
                let (_, [dx, dy]) = lens.distort_with_jacobian(ray);
                let (_, [dx_x, dx_y]) = lens.distort_with_jacobian(ray + DVec2::X * H);
                let (_, [dy_x, dy_y]) = lens.distort_with_jacobian(ray + DVec2::Y * H);
                // Frobenius norms bound the second derivative along any direction, px
                let second = (dx_x - dx).length_squared()
                    + (dx_y - dy).length_squared()
                    + (dy_x - dx).length_squared()
                    + (dy_y - dy).length_squared();
                bend = bend.max(second.sqrt() / H * lens.focal.max_element());
                // smallest stretch from ray to px: det / norm ≤ smallest singular value
                let norm = (dx.length_squared() + dy.length_squared()).sqrt();
                scale = scale.min(dx.perp_dot(dy).abs() / norm * lens.focal.min_element());
            }
        }
        let margin = (high - low) * 0.01;
        (self.low, self.high) = (low - margin, high + margin);
        // |deviation| ≤ bend · length² / 8 for a length in ray units
        let length = (8.0 * SPLIT_TOLERANCE_PX / bend).sqrt() * scale;
        self.straight_px = if length.is_finite() { length.max(2.0) } else { 2.0 };
    }

    /// The lens this was measured from.
    pub fn lens(&self) -> &Lens {
        &self.lens
    }

    /// Whether straight edges may bend.
    pub fn bends(&self) -> bool {
        self.distorted
    }

    /// Edges shorter than this, px, need no split.
    pub fn straight_px(&self) -> f64 {
        self.straight_px
    }

    /// The pixel of a ray (x/z, y/z); `None` outside the field.
    #[inline]
    pub fn project(&self, x: f64, y: f64) -> Option<DVec2> {
        let inside = x >= self.low.x && x <= self.high.x && y >= self.low.y && y <= self.high.y;
        if !inside {
            return None;
        }
        let ray = DVec2::new(x, y);
        let px = self.lens.to_pixel(if self.distorted { self.lens.distort(ray) } else { ray });
        let fits = px.x.abs() <= 1.01 * GUARD_PX && px.y.abs() <= 1.01 * GUARD_PX;
        fits.then_some(px)
    }

    /// Four rays by the operations of [`Field::project`]; the mask says which are inside.
    #[inline(always)]
    pub fn project_four<S: Simd>(
        &self,
        simd: S,
        x: f64x4<S>,
        y: f64x4<S>,
    ) -> (f64x4<S>, f64x4<S>, mask64x4<S>) {
        let of = |v: f64| f64x4::splat(simd, v);
        let inside = x.simd_ge(of(self.low.x))
            & x.simd_le(of(self.high.x))
            & y.simd_ge(of(self.low.y))
            & y.simd_le(of(self.high.y));
        let (mut px, mut py) = (x, y);
        if self.distorted {
            let [k1, k2, p1, p2, k3, k4, k5, k6] = self.lens.distortion;
            let r2 = x * x + y * y;
            let above = r2 * (r2 * (r2 * of(k3) + of(k2)) + of(k1)) + of(1.0);
            let below = r2 * (r2 * (r2 * of(k6) + of(k5)) + of(k4)) + of(1.0);
            let radial = above / below;
            px = x * radial + x * of(2.0 * p1) * y + (r2 + x * of(2.0) * x) * of(p2);
            py = y * radial + (r2 + y * of(2.0) * y) * of(p1) + x * of(2.0 * p2) * y;
        }
        let px = px * of(self.lens.focal.x) + of(self.lens.center.x);
        let py = py * of(self.lens.focal.y) + of(self.lens.center.y);
        let limit = of(1.01 * GUARD_PX);
        (px, py, inside & px.abs().simd_le(limit) & py.abs().simd_le(limit))
    }

    /// Rays x/z and y/z that enclose the picture and what is up to `margin_px` outside it.
    pub fn view(&self, margin_px: f64) -> (DVec2, DVec2) {
        if self.distorted {
            return (self.low, self.high); // nothing is drawn beyond
        }
        let Lens { size, focal, center, .. } = self.lens;
        let margin = DVec2::splat(0.5 + margin_px);
        let last = DVec2::new(size.width as f64 - 1.0, size.height as f64 - 1.0);
        ((-margin - center) / focal, (last + margin - center) / focal)
    }

    /// Bounds of x/z and y/z, drawn in by a hair so that points cut on a bound project.
    pub fn bounds(&self) -> (DVec2, DVec2) {
        let hair = (self.high - self.low) * 1e-9;
        (self.low + hair, self.high - hair)
    }
}
