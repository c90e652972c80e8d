//! A square of a marker's plane as the picture shows it.

use crate::geometry::{Homography, Lens, Pose};
use crate::pixels::Rect;
use glam::{DMat3, DVec2};

/// The square and the pixels it may cover. The lens's bend is taken at the corners; between them edges are straight.
#[derive(Clone, Copy, Debug)]
pub struct Patch {
    /// Its corners in the picture: top-left, top-right, bottom-right, bottom-left of the print.
    pub corners: [DVec2; 4],
    /// The pixels around it.
    pub rect: Rect,
    map: Homography,
    back: DMat3,
}

impl Patch {
    /// The square of `2 · half_mm` around `center` (marker space, mm); `None` where it is not wholly before the lens
    /// or outside the picture.
    pub fn new(pose: &Pose, lens: &Lens, center: DVec2, half_mm: f64) -> Option<Self> {
        let mut corners = [DVec2::ZERO; 4];
        for (corner, (x, y)) in corners.iter_mut().zip([(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)]) {
            let place = center + DVec2::new(x, y) * half_mm;
            *corner = lens.project(pose.apply(place.extend(0.0)))?;
        }
        let map = Homography::from_square(corners)?;
        let back = map.0.inverse();
        let [a, b, c, d] = corners;
        let (low, high) = (a.min(b).min(c.min(d)), a.max(b).max(c.max(d)));
        let (width, height) = (lens.size.width, lens.size.height);
        let from = |v: f64, n: usize| v.floor().clamp(0.0, n as f64) as usize;
        let to = |v: f64, n: usize| (v.ceil() + 1.0).clamp(0.0, n as f64) as usize;
        let rect = Rect {
            x0: from(low.x, width),
            y0: from(low.y, height),
            x1: to(high.x, width),
            y1: to(high.y, height),
        };
        let seen = back.is_finite() && rect.x0 < rect.x1 && rect.y0 < rect.y1;
        seen.then_some(Self { corners, rect, map, back })
    }

    /// Where a place of the square (±1, y up) is in the picture, px.
    pub fn place(&self, at: DVec2) -> DVec2 {
        self.map.apply(at)
    }

    /// Which place of the square's plane (±1 inside, y up) a pixel shows.
    #[inline(always)]
    pub fn under(&self, x: usize, y: usize) -> DVec2 {
        let q = self.back * DVec2::new(x as f64, y as f64).extend(1.0);
        DVec2::new(q.x / q.z, q.y / q.z)
    }
}
