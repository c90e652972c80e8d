//! What blurs a picture: the lens or the hand.

use crate::pixels::Size;
use glam::DVec2;

/// What blurs the picture.
#[derive(Clone, Copy, Debug)]
pub enum Blur {
    /// Only the pixels' own extent.
    Sharp,
    /// A Gaussian of this deviation, px.
    Gaussian(f64),
    /// Motion along this vector, px; truth holds for its middle.
    Motion(DVec2),
}

impl Blur {
    /// Blurs gray levels, row by row.
    pub fn apply(self, frame: &mut [f32], size: Size) {
        match self {
            Blur::Sharp => {}
            Blur::Gaussian(sigma) => gaussian(frame, size, sigma),
            Blur::Motion(way) => motion(frame, size, way),
        }
    }
}

/// Separable Gaussian, clamped at the border.
fn gaussian(frame: &mut [f32], size: Size, sigma: f64) {
    let radius = (4.0 * sigma).ceil() as isize;
    let weight = |k: isize| libm::exp(-0.5 * (k as f64 / sigma) * (k as f64 / sigma));
    let total: f64 = (-radius..=radius).map(weight).sum();
    let weights: Vec<f32> = (-radius..=radius).map(|k| (weight(k) / total) as f32).collect();
    let (width, height) = (size.width as isize, size.height as isize);
    for (across, down) in [(1, 0), (0, 1)] {
        let from = frame.to_vec();
        for y in 0..height {
            for x in 0..width {
                let mut sum = 0.0;
                for (k, w) in (-radius..=radius).zip(&weights) {
                    let u = (x + k * across).clamp(0, width - 1);
                    let v = (y + k * down).clamp(0, height - 1);
                    sum += w * from[(v * width + u) as usize];
                }
                frame[(y * width + x) as usize] = sum;
            }
        }
    }
}

/// Mean along a straight way, bilinear steps of a third of a pixel, clamped at the border.
fn motion(frame: &mut [f32], size: Size, way: DVec2) {
    let steps = ((3.0 * way.length()).ceil() as usize).max(2);
    let from = frame.to_vec();
    let (width, height) = (size.width, size.height);
    for y in 0..height {
        for x in 0..width {
            let mut sum = 0.0;
            for k in 0..steps {
                let t = (k as f64 + 0.5) / steps as f64 - 0.5;
                let p = DVec2::new(x as f64, y as f64) + way * t;
                let p = p.clamp(DVec2::ZERO, DVec2::new(width as f64 - 1.001, height as f64 - 1.001));
                let (i, j) = (p.x as usize, p.y as usize);
                let (s, t) = ((p.x - i as f64) as f32, (p.y - j as f64) as f32);
                let at = j * width + i;
                let top = from[at] * (1.0 - s) + from[at + 1] * s;
                let bottom = from[at + width] * (1.0 - s) + from[at + width + 1] * s;
                sum += top * (1.0 - t) + bottom * t;
            }
            frame[y * width + x] = sum / steps as f32;
        }
    }
}
