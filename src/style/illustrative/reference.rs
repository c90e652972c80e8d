//! The illustrative filter in plain f64, read straight from the paper.

use super::Config;
use crate::frame::Layer;
use crate::kernel::{color, contrast, sobel};
use crate::pixels::{Plane, Rgb};
use glam::DVec3;

/// The halftone threshold of the pixel at column `x`, row `y` (eq. 4.7, 4.8): `theta` in degrees, `n` in px.
pub fn halftone(theta: f64, n: f64, c_cross: f64, x: usize, y: usize) -> f64 {
    threshold(libm::sincos(theta.to_radians()), n, c_cross, x as f64 + 0.5, y as f64 + 0.5)
}

/// The same at any place of the pattern; `turn`: sine and cosine of theta.
#[inline(always)]
pub(super) fn threshold((sin, cos): (f64, f64), n: f64, c_cross: f64, x: f64, y: f64) -> f64 {
    let fraction = |v: f64| v / n - (v / n).floor();
    let (s, t) = (fraction(cos * x - sin * y), fraction(sin * x + cos * y));
    if s <= c_cross { c_cross * t } else { (1.0 - c_cross) * s + c_cross }
}

/// Draws a camera picture as the paper's equations say; 8-bit result.
pub fn reference(config: &Config, camera: &Rgb) -> Rgb {
    let size = camera.size();
    let paper = [config.paper_red, config.paper_green, config.paper_blue];
    let paper = paper.map(|v| (f64::from(v) * 255.0 + 0.5).floor() as u8);
    let mut out = Rgb::new(size, [0; 3]);
    let alpha = f64::from(config.alpha);
    for (x, y) in (0..size.height).flat_map(|y| (0..size.width).map(move |x| (x, y))) {
        let response = contrast::reference(camera, x, y, [1.0 - alpha, alpha / 2.0, alpha / 2.0], 0.0);
        let mut brightness = 0.0;
        for (dx, dy) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))) {
            let x = x.saturating_add_signed(dx).min(size.width - 1);
            let y = y.saturating_add_signed(dy).min(size.height - 1);
            brightness += color::reference(camera.at(x, y))[0] / 9.0;
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

/// The same with the models of `layer` in view: the camera side from `camera`, and where a model covers it the object
/// side (section 4.2.3, Algorithm 6). The layer has both surfaces and their normals.
pub fn reference_with(config: &Config, camera: &Rgb, layer: &Layer) -> Rgb {
    let mut out = reference(config, camera);
    let size = camera.size();
    let paper = config.paper_color().map(f64::from);
    let (back, inner) = (config.back_layer_color().map(f64::from), config.secondary_color().map(f64::from));
    let surfaces = [(&layer.depth, &layer.normal), (&layer.depth2, &layer.normal2)];
    for (x, y) in (0..size.height).flat_map(|y| (0..size.width).map(move |x| (x, y))) {
        let [z1, z2] = surfaces.map(|(depth, _)| f64::from(depth.at(x, y)));
        let secondary = layer.secondary.as_deref().filter(|s| s.depth.at(x, y) < f32::INFINITY);
        if z1 == f64::INFINITY && secondary.is_none() {
            continue;
        }
        let [silhouette1, silhouette2] =
            surfaces.map(|(depth, normal)| silhouette(config, layer.extent, depth, normal, x, y));
        let lit = |normal: &[Plane<f32>; 3]| at(normal, x, y).dot(layer.light.as_dvec3()).max(0.0);
        let mut strength = 0.0;
        if let Some(secondary) = secondary {
            let z = f64::from(secondary.depth.at(x, y));
            let seen = match () {
                () if z < z1 => 1.0,
                () if z < z2 => f64::from(config.alpha_layer),
                () => f64::from(config.beta_layer),
            };
            strength = if silhouette2 && z2 <= z { 0.0 } else { seen * lit(&secondary.normal) };
        }
        let tau = halftone(config.theta, config.n, config.c_cross, x, y);
        let hatched = z1 < f64::INFINITY && lit(&layer.normal) < tau;
        let color = [0, 1, 2].map(|k| {
            let color = if silhouette2 { back[k] } else { paper[k] };
            let color = (1.0 - strength) * color + strength * inner[k];
            if silhouette1 || hatched { 0 } else { (color * 255.0 + 0.5).floor() as u8 }
        });
        out.set(x, y, color);
    }
    out
}

/// Eq. 4.3 to 4.5 where the surface is; elsewhere there is none.
fn silhouette(
    config: &Config,
    [near, far]: [f32; 2],
    depth: &Plane<f32>,
    normal: &[Plane<f32>; 3],
    x: usize,
    y: usize,
) -> bool {
    if depth.at(x, y) == f32::INFINITY {
        return false;
    }
    let fit = f64::from(config.depth_fit);
    let (near, far) = (f64::from(near) * fit, f64::from(far) / fit);
    let window = |x, y| match f64::from(depth.at(x, y)) {
        f64::INFINITY => 1.0,
        _ if far <= near => 0.0,
        z => far / (far - near) * (1.0 - near / z),
    };
    let size = depth.size();
    let [gx, gy] = sobel::reference(size.width, size.height, x, y, window);
    let around = [(-1, 0), (1, 0), (0, -1), (0, 1)].map(|(dx, dy)| {
        let x = x.saturating_add_signed(dx).min(size.width - 1);
        at(normal, x, y.saturating_add_signed(dy).min(size.height - 1))
    });
    let similarity: f64 = around.into_iter().map(|n| n.dot(at(normal, x, y))).sum();
    libm::hypot(gx, gy) >= f64::from(config.depth_threshold)
        || similarity < f64::from(config.normal_threshold)
}

fn at(normal: &[Plane<f32>; 3], x: usize, y: usize) -> DVec3 {
    DVec3::from_array([0, 1, 2].map(|k| f64::from(normal[k].at(x, y))))
}
