//! What is behind the markers: a wall, a texture, a table full of things.

use super::{between, scaled};
use crate::pixels::{Size, SplitMix64, hash_noise};
use glam::DVec2;
use std::f64::consts::{PI, TAU};
use tiny_skia::{Color, FillRule, Paint, PathBuilder, Pixmap, Rect, Stroke, Transform};

/// What is behind the markers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Background {
    /// An even wall.
    Plain,
    /// Smooth noise.
    Texture,
    /// Polygons, lines, grids, nested squares.
    Clutter,
}

impl Background {
    /// Gray levels under full light, row by row.
    pub fn draw(self, size: Size, seed: u64) -> Vec<f32> {
        let Size { width, height } = size;
        let mut rng = SplitMix64::new(seed);
        let base = between(&mut rng, 70.0, 200.0);
        match self {
            Background::Plain => vec![base as f32; width * height],
            Background::Texture => {
                let amplitude = between(&mut rng, 20.0, 70.0);
                let seed = rng.next_u64();
                let at = |i: usize| {
                    let (x, y) = ((i % width) as f64, (i / width) as f64);
                    let rough = smooth(x, y, 23.0, seed)
                        + 0.5 * smooth(x, y, 9.0, seed + 1)
                        + 0.25 * smooth(x, y, 3.5, seed + 2);
                    (base + amplitude * (rough - 0.875)).clamp(5.0, 250.0) as f32
                };
                (0..width * height).map(at).collect()
            }
            Background::Clutter => clutter(&mut rng, size, base),
        }
    }
}

/// Bilinear hash noise in 0..1.
fn smooth(x: f64, y: f64, cell: f64, seed: u64) -> f64 {
    let (x, y) = (x / cell, y / cell);
    let (i, j) = (x as u32, y as u32);
    let at = |i: u32, j: u32| (hash_noise(i, j, seed, 0) >> 40) as f64 / (1u64 << 24) as f64;
    let (s, t) = (x - f64::from(i), y - f64::from(j));
    (at(i, j) * (1.0 - s) + at(i + 1, j) * s) * (1.0 - t)
        + (at(i, j + 1) * (1.0 - s) + at(i + 1, j + 1) * s) * t
}

/// A table full of things: polygons, lines, checkerboards, nested squares, windows, print.
fn clutter(rng: &mut SplitMix64, size: Size, base: f64) -> Vec<f32> {
    let Some(mut map) = Pixmap::new(size.width as u32, size.height as u32) else { return Vec::new() };
    let ink = |gray: f64| {
        let g = (gray.clamp(0.0, 255.0) + 0.5) as u8;
        let mut paint = Paint::default();
        paint.set_color_rgba8(g, g, g, 255);
        paint
    };
    let g = (base / 255.0) as f32;
    map.fill(Color::from_rgba(g, g, g, 1.0).unwrap_or(Color::BLACK));
    let (w, h) = (size.width as f64, size.height as f64);
    let things = (60.0 * (w * h / 307_200.0)) as usize;
    for _ in 0..things {
        let center = DVec2::new(rng.f64() * w, rng.f64() * h);
        let reach = scaled(rng, 6.0, 120.0);
        let turn = rng.f64() * TAU;
        let (gray, other) = (between(rng, 10.0, 245.0), between(rng, 10.0, 245.0));
        let place = Transform::from_rotate_at((turn * 180.0 / PI) as f32, center.x as f32, center.y as f32);
        let mut rect = |x: f64, y: f64, w: f64, h: f64, gray: f64| {
            if let Some(rect) =
                Rect::from_xywh((center.x + x) as f32, (center.y + y) as f32, w as f32, h as f32)
            {
                map.fill_rect(rect, &ink(gray), place, None);
            }
        };
        match rng.int(0, 6) {
            0 => {
                // nested squares
                let mut r = reach;
                let mut k = 0;
                while r > 3.0 && k < 5 {
                    rect(-r, -r, 2.0 * r, 2.0 * r, if k % 2 == 0 { gray } else { other });
                    (r, k) = (r * between(rng, 0.5, 0.85), k + 1);
                }
            }
            1 => {
                // checkerboard
                let (n, cell) = (rng.int(3, 8), (reach / 4.0).max(3.0));
                for i in 0..n * n {
                    let (x, y) = ((i % n) as f64 * cell, (i / n) as f64 * cell);
                    rect(x, y, cell, cell, if (i % n + i / n) % 2 == 0 { gray } else { other });
                }
            }
            2 => {
                // lines of print
                let height = (reach / 10.0).max(2.0);
                rect(-reach, -reach, 2.0 * reach, 2.0 * reach, between(rng, 200.0, 245.0));
                for line in 0..6 {
                    let mut x = -0.9 * reach;
                    while x < 0.85 * reach {
                        let wide = between(rng, 0.3, 1.6) * height;
                        rect(x, -0.85 * reach + line as f64 * 2.9 * height, wide, 1.6 * height, 30.0);
                        x += wide + between(rng, 0.2, 0.7) * height;
                    }
                }
            }
            3 => rect(-reach, -0.6 * reach, 2.0 * reach, 1.2 * reach, gray),
            kind => {
                let mut path = PathBuilder::new();
                let corners = rng.int(3, 8);
                for i in 0..corners {
                    let angle = (i as f64 + between(rng, -0.3, 0.3)) / corners as f64 * TAU;
                    let r = reach * between(rng, 0.4, 1.0);
                    let (x, y) =
                        ((center.x + r * libm::cos(angle)) as f32, (center.y + r * libm::sin(angle)) as f32);
                    if i == 0 { path.move_to(x, y) } else { path.line_to(x, y) }
                }
                path.close();
                let Some(path) = path.finish() else { continue };
                if kind == 4 {
                    let width = between(rng, 1.0, 6.0) as f32;
                    let stroke = Stroke { width, ..Stroke::default() };
                    map.stroke_path(&path, &ink(gray), &stroke, Transform::identity(), None);
                } else {
                    map.fill_path(&path, &ink(gray), FillRule::Winding, Transform::identity(), None);
                }
            }
        }
    }
    map.pixels().iter().map(|p| f32::from(p.red())).collect()
}
