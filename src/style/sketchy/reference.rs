//! The sketchy style in plain f64, read straight from the paper.

use super::field::{BACKGROUND, extent};
use super::starts::random;
use super::{Config, Renderer, border, sprites};
use crate::frame::Layer;
use crate::kernel::{gaussian, sobel};
use crate::pixels::{Plane, Rgb, Size};
use crate::style::composite;

/// Draws a camera picture, or an augmented one, without depth; 8-bit result.
pub fn reference(config: &Config, picture: &Rgb) -> Rgb {
    reference_over(config, picture, None)
}

/// Draws a camera picture with models over it; 8-bit result. The first frame of a sequence.
pub fn reference_over(config: &Config, camera: &Rgb, layer: Option<&Layer>) -> Rgb {
    let size = camera.size();
    let mut picture = camera.clone();
    if let Some(layer) = layer {
        composite::over(layer, &mut picture);
    }
    let mut shade = ground(config, size);
    if config.strokes {
        let field = field(config, &camera.planes[0], layer);
        if config.renderer == Renderer::Sprites {
            for start in starts(config, size) {
                if let Some((_, nearness)) = at(&field, size, start) {
                    print(config, start, nearness, &mut shade);
                }
            }
        } else {
            for stroke in strokes(config, &field, size) {
                draw(config, &stroke, &mut shade);
            }
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

/// Light that paper and border let through.
fn ground(config: &Config, size: Size) -> Plane<f64> {
    let mut border = vec![1.0; size.area()];
    if config.border {
        border::draw(size, config.seed, &mut border, size.width);
    }
    Plane::from_fn(size, |x, y| {
        let paper = config.paper.texture().map_or(1.0, |texture| {
            let tile = texture.size();
            f64::from(texture.at(x % tile.width, y % tile.height)) / 255.0
        });
        paper * f64::from(border[y * size.width + x])
    })
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
        // of bytes, so that gradients are exact
        let (length, force) =
            along(sobel::reference(size.width, size.height, x, y, |x, y| f64::from(red.at(x, y))));
        (length > 255.0 * config.threshold).then_some((force, 0.0))
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

/// The edge at the pixel that holds a place; none outside the picture.
fn at(field: &[Option<Edge>], size: Size, [x, y]: [f64; 2]) -> Option<Edge> {
    let (x, y) = ((x + 0.5).floor(), (y + 0.5).floor());
    let inside = x >= 0.0 && y >= 0.0 && x < size.width as f64 && y < size.height as f64;
    if inside { field[y as usize * size.width + x as usize] } else { None }
}

/// The starts of a first frame.
fn starts(config: &Config, size: Size) -> Vec<[f64; 2]> {
    match config.starts.starts() {
        Some(starts) => starts.to_vec(),
        None => random(size, config.density, config.seed).collect(),
    }
}

/// A point of a stroke, and the nearness there.
type Point = ([f64; 2], f64);

/// The strokes from all starts, in order.
fn strokes(config: &Config, field: &[Option<Edge>], size: Size) -> Vec<Vec<Point>> {
    let mut strokes = Vec::new();
    for start in starts(config, size) {
        let Some((mut force, nearness)) = at(field, size, start) else { continue };
        let mut points = vec![(start, nearness)];
        let mut last = [0.0; 2];
        while points.len() < config.points as usize {
            if force[0] * last[0] + force[1] * last[1] < 0.0 {
                force = [-force[0], -force[1]];
            }
            let (from, _) = points[points.len() - 1];
            let next = [from[0] + config.step * force[0], from[1] + config.step * force[1]];
            let Some((onward, nearness)) = at(field, size, next) else { break };
            points.push((next, nearness));
            (last, force) = (force, onward);
        }
        if points.len() >= 2 {
            strokes.push(points);
        }
    }
    strokes
}

/// The pixels of `0..count` within `reach` of a range.
fn within(low: f64, high: f64, reach: f64, count: usize) -> std::ops::Range<usize> {
    (low - reach).floor().max(0.0) as usize..((high + reach).ceil() + 1.0).clamp(0.0, count as f64) as usize
}

/// One over-blend of black: lines of one width, or quads whose brush runs from the first point to the last.
fn draw(config: &Config, points: &[Point], shade: &mut Plane<f64>) {
    let quads = config.renderer == Renderer::Polygons;
    let size = shade.size();
    let reach = |nearness: f64| config.half_width_at(nearness) + 0.5;
    let widest = points.iter().map(|&(_, nearness)| reach(nearness)).fold(0.0, f64::max);
    let range = |c: usize, count: usize| {
        let low = points.iter().map(|(p, _)| p[c]).fold(f64::INFINITY, f64::min);
        within(low, points.iter().map(|(p, _)| p[c]).fold(f64::NEG_INFINITY, f64::max), widest, count)
    };
    for y in range(1, size.height) {
        for x in range(0, size.width) {
            // distance, points passed, side
            let mut nearest = (f64::INFINITY, 0.0, 0.0);
            for (k, ends) in points.windows(2).enumerate() {
                let [a, b] = [ends[0].0, ends[1].0];
                let (along, from) = ([b[0] - a[0], b[1] - a[1]], [x as f64 - a[0], y as f64 - a[1]]);
                let square = along[0] * along[0] + along[1] * along[1];
                let t = ((from[0] * along[0] + from[1] * along[1]) / square).clamp(0.0, 1.0);
                let off = [from[0] - t * along[0], from[1] - t * along[1]];
                let distance = libm::hypot(off[0], off[1]);
                if distance < nearest.0 {
                    nearest = (distance, k as f64 + t, off[1] * along[0] - off[0] * along[1]);
                }
            }
            let (distance, passed, side) = nearest;
            let k = (passed.floor() as usize).min(points.len() - 2);
            let [from, to] =
                if quads { [points[k].1, points[k + 1].1].map(reach) } else { [reach(points[0].1); 2] };
            let reach = from + (to - from) * (passed - k as f64);
            let coverage = (reach - distance).clamp(0.0, 1.0);
            if coverage > 0.0 {
                let mut opacity = config.opacity * coverage;
                if quads {
                    let u = passed / (points.len() - 1) as f64;
                    // a pixel straight ahead of an end lies on neither side: it counts as right
                    let v = 0.5 + 0.5 * if side < 0.0 { -distance } else { distance } / reach;
                    opacity *= (1.0 - config.fade * u) * brush(config, u, v);
                }
                shade.row_mut(y)[x] *= 1.0 - opacity;
            }
        }
    }
}

/// One lone brush print.
fn print(config: &Config, middle: [f64; 2], nearness: f64, shade: &mut Plane<f64>) {
    let (size, reach) = (shade.size(), sprites::reach(config, nearness));
    for y in within(middle[1], middle[1], reach, size.height) {
        for x in within(middle[0], middle[0], reach, size.width) {
            let off = [x as f64 - middle[0], y as f64 - middle[1]];
            let coverage = (reach - libm::hypot(off[0], off[1])).clamp(0.0, 1.0);
            let [u, v] = off.map(|d| (d / reach + 1.0) / 2.0);
            shade.row_mut(y)[x] *= 1.0 - config.opacity * coverage * brush(config, u, v);
        }
    }
}

/// Opacity of the brush at (`u`, `v`) of [0,1]x[0,1], bilinear.
fn brush(config: &Config, u: f64, v: f64) -> f64 {
    let mask = config.brush.mask(&super::brush::BUILT_IN);
    let at = |x: f64, y: f64| {
        let clamped = |i: f64, count: usize| i.clamp(0.0, count as f64 - 1.0) as usize;
        f64::from(mask.at(clamped(x, mask.size().width), clamped(y, mask.size().height))) / 255.0
    };
    let (x, y) = (u * mask.size().width as f64 - 0.5, v * mask.size().height as f64 - 0.5);
    let (x0, y0) = (x.floor(), y.floor());
    let row = |y: f64| at(x0, y) * (1.0 - (x - x0)) + at(x0 + 1.0, y) * (x - x0);
    row(y0) * (1.0 - (y - y0)) + row(y0 + 1.0) * (y - y0)
}
