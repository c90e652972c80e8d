//! The illustrative filter in plain f64, read straight from the paper.

use super::Config;
use crate::kernel::{color, contrast};
use crate::pixels::Rgb;

/// The halftone threshold of the pixel at column `x`, row `y` (eq. 4.7, 4.8): `theta` in degrees, `n` in px.
pub fn halftone(theta: f64, n: f64, c_cross: f64, x: usize, y: usize) -> f64 {
    let (sin, cos) = libm::sincos(theta.to_radians());
    let (x, y) = (x as f64 + 0.5, y as f64 + 0.5);
    let fraction = |v: f64| v / n - (v / n).floor();
    let (s, t) = (fraction(cos * x - sin * y), fraction(sin * x + cos * y));
    if s <= c_cross { c_cross * t } else { (1.0 - c_cross) * s + c_cross }
}

/// Draws `augmented` (camera picture with the models over it) as the paper's equations say; 8-bit result.
pub fn reference(config: &Config, augmented: &Rgb) -> Rgb {
    let size = augmented.size();
    let paper = [config.paper_red, config.paper_green, config.paper_blue];
    let paper = paper.map(|v| (f64::from(v) * 255.0 + 0.5).floor() as u8);
    let mut out = Rgb::new(size, [0; 3]);
    let alpha = f64::from(config.alpha);
    for (x, y) in (0..size.height).flat_map(|y| (0..size.width).map(move |x| (x, y))) {
        let response = contrast::reference(augmented, x, y, [1.0 - alpha, alpha / 2.0, alpha / 2.0], 0.0);
        let mut brightness = 0.0;
        for (dx, dy) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))) {
            let x = x.saturating_add_signed(dx).min(size.width - 1);
            let y = y.saturating_add_signed(dy).min(size.height - 1);
            brightness += color::reference(augmented.at(x, y))[0] / 9.0;
        }
        let tau = halftone(config.theta, config.n, config.c_cross, x, y);
        let black =
            response >= f64::from(config.edge_threshold) || f64::from(config.gamma) * brightness < tau;
        if !black {
            out.set(x, y, paper);
        }
    }
    out
}
