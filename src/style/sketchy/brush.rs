//! The brush of polygons and sprites.

use crate::pixels::{Plane, Size, hash_noise};
use std::sync::LazyLock;

/// Side of the built-in brush, px.
const SIDE: usize = 64;

/// The built-in brush.
pub static BUILT_IN: LazyLock<Plane<u8>> = LazyLock::new(built_in);

/// Bristles: streaks along x that break up, thin at both sides.
fn built_in() -> Plane<u8> {
    let noise = |x: usize, y: usize, layer: u64| {
        (hash_noise(x as u32, y as u32, layer, 0) >> 40) as f64 / (1u64 << 24) as f64
    };
    Plane::from_fn(Size::new(SIDE, SIDE), |x, y| {
        let v = (y as f64 + 0.5) / (SIDE as f64 / 2.0) - 1.0;
        let bristle = 0.55 + 0.45 * noise(0, y / 3, 1);
        let broken = 0.75 + 0.25 * noise(x / 6, y / 2, 2);
        let side = (1.0 - v * v * v * v).max(0.0);
        ((bristle * broken * side).clamp(0.0, 1.0) * 255.0 + 0.5).floor() as u8
    })
}

/// A brush to look up opacities in.
#[derive(Clone, Copy)]
pub struct Brush<'a> {
    mask: &'a Plane<u8>,
}

impl<'a> Brush<'a> {
    /// Looks up in `mask`, 255 = opaque.
    pub fn new(mask: &'a Plane<u8>) -> Self {
        Self { mask }
    }

    /// Opacity 0..1 at (`u`, `v`), the brush being [0,1]x[0,1]; bilinear, borders repeated.
    #[inline(always)]
    pub fn at(self, u: f32, v: f32) -> f32 {
        let taps = |t: f32, count: usize| {
            let last = (count - 1) as f32;
            let at = (t * count as f32 - 0.5).clamp(0.0, last);
            let first = at as usize;
            (first, (first + 1).min(count - 1), at - first as f32)
        };
        let size = self.mask.size();
        let (x0, x1, right) = taps(u, size.width);
        let (y0, y1, down) = taps(v, size.height);
        let row = |y: usize| {
            let row = self.mask.row(y);
            let (a, b) = (f32::from(row[x0]), f32::from(row[x1]));
            a + (b - a) * right
        };
        let (above, below) = (row(y0), row(y1));
        (above + (below - above) * down) / 255.0
    }
}
