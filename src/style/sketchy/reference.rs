//! The sketchy style in plain f64, read straight from the paper.

use super::field::{BACKGROUND, extent};
use super::starts::random;
use super::{Config, Renderer};
use crate::frame::Layer;
use crate::kernel::{gaussian, sobel};
use crate::pixels::{Plane, Rgb, Size};
use crate::style::composite;

/// Draws a camera picture, or an augmented one, without depth; 8-bit result.
pub fn reference(config: &Config, picture: &Rgb) -> Rgb {
    reference_over(config, picture, None)
}

/// Draws a camera picture with models over it; 8-bit result. The first frame of a sequence, no border, and strokes
/// of lines alone.
pub fn reference_over(config: &Config, camera: &Rgb, layer: Option<&Layer>) -> Rgb {
    let size = camera.size();
    let mut picture = camera.clone();
    if let Some(layer) = layer {
        composite::over(layer, &mut picture);
    }
    let mut shade: Plane<f64> = Plane::new(size, 1.0);
    if let Some(texture) = config.paper.texture() {
        let tile = texture.size();
        shade = Plane::from_fn(size, |x, y| f64::from(texture.at(x % tile.width, y % tile.height)) / 255.0);
    }
    if config.strokes && config.renderer == Renderer::Lines {
        let field = field(config, &camera.planes[0], layer);
        for stroke in strokes(config, &field, size) {
            draw(config, &stroke, &mut shade);
        }
    }
    let mut out = Rgb::new(size, [0; 3]);
    for (from, to) in picture.planes.iter().zip(&mut out.planes) {
        let blurred = gaussian::reference(from.view(), config.sigma);
        for (i, blurred) in blurred.into_iter().enumerate() {
            let (x, y) = (i % size.width, i / size.width);
            let value = match (config.color, config.blur) {
                (false, _) => 1.0,
                (true, true) => blurred,
                (true, false) => f64::from(from.at(x, y)) / 255.0,
            };
            let value = value * shade.at(x, y);
            to.row_mut(y)[x] = (value.clamp(0.0, 1.0) * 255.0 + 0.5).floor() as u8;
        }
    }
    out
}

/// An edge: the force, and how near the object is.
type Edge = ([f64; 2], f64);

/// Force and nearness of every edge pixel, rows first.
fn field(config: &Config, red: &Plane<u8>, layer: Option<&Layer>) -> Vec<Option<Edge>> {
    let size = red.size();
    let layer = layer
        .filter(|layer| layer.depth.size() == size && layer.depth.rows().flatten().any(|z| z.is_finite()));
    let along = |[gx, gy]: [f64; 2]| {
        let length = libm::hypot(gx, gy);
        (length, [-gy / length, gx / length])
    };
    let pixel = |i: usize| {
        let (x, y) = (i % size.width, i / size.width);
        if let Some(layer) = layer {
            let near = f64::from(layer.extent[0]);
            let extent = extent(near, f64::from(layer.extent[1]));
            let z = |x: usize, y: usize| f64::from(layer.depth.at(x, y));
            let relative = |x: usize, y: usize| match z(x, y).is_finite() {
                true => (z(x, y) - near) / extent,
                false => BACKGROUND,
            };
            let (length, force) = along(sobel::reference(size.width, size.height, x, y, relative));
            let near_by = || {
                (x.saturating_sub(1)..=(x + 1).min(size.width - 1))
                    .flat_map(|x| (y.saturating_sub(1)..=(y + 1).min(size.height - 1)).map(move |y| (x, y)))
            };
            let inside = near_by().all(|(x, y)| z(x, y).is_finite());
            if length > config.depth_threshold
                && !(config.slope_guard && inside && flat(config, layer, extent, x, y))
            {
                let nearest = near_by().map(|(x, y)| relative(x, y)).fold(1.0, f64::min);
                return Some((force, 1.0 - 2.0 * nearest));
            }
            if z(x, y).is_finite() {
                return None;
            }
        }
        let value = |x, y| f64::from(red.at(x, y)) / 255.0;
        let (length, force) = along(sobel::reference(size.width, size.height, x, y, value));
        (length > config.threshold).then_some((force, 0.0))
    };
    (0..size.area()).map(pixel).collect()
}

/// Whether the depth around a pixel is that of a plane: the second differences of 1/z, as depth, stay small.
fn flat(config: &Config, layer: &Layer, extent: f64, x: usize, y: usize) -> bool {
    let size = layer.depth.size();
    let inverse = |dx: isize, dy: isize| {
        let x = x.saturating_add_signed(dx).min(size.width - 1);
        1.0 / f64::from(layer.depth.at(x, y.saturating_add_signed(dy).min(size.height - 1)))
    };
    let mut bend = [0.0; 2];
    for (k, weight) in [(-1, 0.25), (0, 0.5), (1, 0.25)] {
        bend[0] += weight * (inverse(-1, k) - 2.0 * inverse(0, k) + inverse(1, k));
        bend[1] += weight * (inverse(k, -1) - 2.0 * inverse(k, 0) + inverse(k, 1));
    }
    let z = 1.0 / inverse(0, 0);
    libm::hypot(bend[0], bend[1]) * z * z / extent <= config.depth_threshold
}

/// A stroke: its points, and the nearness at its start.
type Stroke = (Vec<[f64; 2]>, f64);

/// The strokes from all starts, in order.
fn strokes(config: &Config, field: &[Option<Edge>], size: Size) -> Vec<Stroke> {
    let at = |[x, y]: [f64; 2]| {
        let (x, y) = ((x + 0.5).floor(), (y + 0.5).floor());
        let inside = x >= 0.0 && y >= 0.0 && x < size.width as f64 && y < size.height as f64;
        if inside { field[y as usize * size.width + x as usize] } else { None }
    };
    let starts: Vec<_> = match config.starts.starts() {
        Some(starts) => starts.to_vec(),
        None => random(size, config.density, config.seed).collect(),
    };
    let mut strokes = Vec::new();
    for start in starts {
        let Some((mut force, nearness)) = at(start) else { continue };
        let mut points = vec![start];
        let mut last = [0.0; 2];
        while points.len() < config.points as usize {
            if force[0] * last[0] + force[1] * last[1] < 0.0 {
                force = [-force[0], -force[1]];
            }
            let from = points[points.len() - 1];
            let next = [from[0] + config.step * force[0], from[1] + config.step * force[1]];
            let Some((onward, _)) = at(next) else { break };
            points.push(next);
            (last, force) = (force, onward);
        }
        if points.len() >= 2 {
            strokes.push((points, nearness));
        }
    }
    strokes
}

/// One over-blend of black.
fn draw(config: &Config, (points, nearness): &Stroke, shade: &mut Plane<f64>) {
    let size = shade.size();
    let reach = config.half_width_at(*nearness) + 0.5;
    let range = |c: usize, count: usize| {
        let low = points.iter().map(|p| p[c]).fold(f64::INFINITY, f64::min) - reach;
        let high = points.iter().map(|p| p[c]).fold(f64::NEG_INFINITY, f64::max) + reach;
        low.floor().max(0.0) as usize..((high.ceil() + 1.0).max(0.0) as usize).min(count)
    };
    for y in range(1, size.height) {
        for x in range(0, size.width) {
            let distance = points
                .windows(2)
                .map(|ends| {
                    let [a, b] = [ends[0], ends[1]];
                    let (along, from) = ([b[0] - a[0], b[1] - a[1]], [x as f64 - a[0], y as f64 - a[1]]);
                    let t = (from[0] * along[0] + from[1] * along[1])
                        / (along[0] * along[0] + along[1] * along[1]);
                    let t = t.clamp(0.0, 1.0);
                    libm::hypot(from[0] - t * along[0], from[1] - t * along[1])
                })
                .fold(f64::INFINITY, f64::min);
            shade.row_mut(y)[x] *= 1.0 - config.opacity * (reach - distance).clamp(0.0, 1.0);
        }
    }
}
