//! The reference image (sections 3.2 and 4): which pixels are edges, and the force field along them.
//!
//! On the camera's part gradients are exact integers, found for all pixels at once. The models' part is worked out
//! where a stroke asks. It covers the camera's: a pixel whose 3x3 neighbors hold a model is judged by depth alone,
//! unless it is background, where the camera may have an edge as well.

use super::Config;
use crate::frame::Layer;
use crate::kernel::band_rows;
use crate::kernel::sobel::Lines;
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, Size};
use fearless_simd::{Simd, SimdBase};
use rayon::prelude::*;

/// What a pixel without a model counts as, in parts of the depth extent behind the nearest point: one extent behind
/// the farthest, so that every contour is an edge.
pub(super) const BACKGROUND: f64 = 2.0;

/// One edge pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    /// The force: unit vector along the edge, (-gy, gx) / |g|.
    pub force: [f64; 2],
    /// 1 at the models' nearest point, -1 at their farthest, 0 on the camera's edges.
    pub nearness: f64,
}

/// The camera's gradients: four times those of its red, of 0..255.
#[derive(Debug, Default)]
pub struct Gradients {
    /// gx in the low, gy in the high 16 bits: strokes look at both, anywhere in the picture.
    packed: Plane<u32>,
    /// What each band of rows works in.
    lines: Vec<Lines>,
}

impl Gradients {
    /// Finds those of a picture's red. Allocates only when a size or the number of threads grows.
    pub fn run(&mut self, level: Level, red: &Plane<u8>) {
        let size = red.size();
        self.packed.resize(size, 0);
        let rows = band_rows(size.height, 16);
        let bands = size.height.div_ceil(rows.max(1));
        if self.lines.len() < bands {
            self.lines.resize_with(bands, Lines::default);
        }
        self.packed.view_mut().par_bands(rows).zip(&mut self.lines).for_each(
            |((first, mut packed), lines)| {
                lines.fit(size.width);
                lines.push(0, red.row(first.saturating_sub(1)));
                lines.push(1, red.row(first));
                for y in 0..packed.size().height {
                    lines.push(y + 2, red.row((first + y + 1).min(size.height - 1)));
                    dispatch!(level, simd => pack_row(simd, lines, y, packed.row_mut(y)));
                }
            },
        );
    }

    /// gx and gy at a pixel of the picture.
    #[inline(always)]
    fn at(&self, x: usize, y: usize) -> [i32; 2] {
        let packed = self.packed.at(x, y);
        [i32::from(packed as i16), packed as i32 >> 16]
    }
}

#[inline(always)]
fn pack_row<S: Simd>(simd: S, lines: &Lines, top: usize, packed: &mut [u32]) {
    for (block, packed) in packed.chunks_mut(16).enumerate() {
        let [gx, gy] = lines.gradient(simd, top, 16 * block);
        for ((to, &gx), &gy) in packed.iter_mut().zip(gx.as_slice()).zip(gy.as_slice()) {
            *to = u32::from(gx as u16) | u32::from(gy as u16) << 16;
        }
    }
}

/// The reference image of one frame.
#[derive(Clone, Copy)]
pub struct Field<'a> {
    camera: &'a Gradients,
    /// A squared gradient (times 4, of 0..255) above this is an edge.
    limit: i32,
    relief: Option<Relief<'a>>,
}

/// The models' depth.
#[derive(Clone, Copy)]
struct Relief<'a> {
    depth: &'a Plane<f32>,
    near: f64,
    /// 1 / depth extent.
    scale: f64,
    threshold: f64,
    guarded: bool,
}

impl<'a> Field<'a> {
    /// The field of a camera picture and of the models over it, if there are any.
    pub fn new(config: &Config, camera: &'a Gradients, layer: Option<&'a Layer>) -> Self {
        let threshold = config.threshold * (4.0 * 255.0);
        let size = camera.packed.size();
        let layer = layer.filter(|layer| !layer.touched.is_empty() && layer.depth.size() == size);
        let relief = layer.map(|layer| {
            let [near, far] = layer.extent.map(f64::from);
            Relief {
                depth: &layer.depth,
                near,
                scale: 1.0 / extent(near, far),
                threshold: config.depth_threshold,
                guarded: config.slope_guard,
            }
        });
        Self { camera, limit: (threshold * threshold).floor() as i32, relief }
    }

    /// Width and height.
    pub fn size(&self) -> Size {
        self.camera.packed.size()
    }

    /// The edge at a pixel of the picture, if there is one.
    #[inline]
    pub fn edge(&self, x: usize, y: usize) -> Option<Edge> {
        if let Some(relief) = &self.relief {
            let around = around(relief.depth, x, y);
            if around.iter().flatten().any(|&z| z < f32::INFINITY) {
                let edge = relief.edge(around);
                if edge.is_some() || around[1][1] < f32::INFINITY {
                    return edge;
                }
            }
        }
        let [gx, gy] = self.camera.at(x, y);
        (gx * gx + gy * gy > self.limit)
            .then(|| Edge { force: along([f64::from(gx), f64::from(gy)]), nearness: 0.0 })
    }

    /// The force at a pixel whether or not it is an edge; 0 where nothing changes.
    pub fn force(&self, x: usize, y: usize) -> [f64; 2] {
        match self.edge(x, y) {
            Some(edge) => edge.force,
            None => {
                let [gx, gy] = self.camera.at(x, y);
                along([f64::from(gx), f64::from(gy)])
            }
        }
    }
}

/// The depth extent, never so small that rounding would look like relief.
pub(super) fn extent(near: f64, far: f64) -> f64 {
    (far - near).max(1e-3 * far)
}

impl Relief<'_> {
    /// The models' edge at the middle of 3x3 depths of which one at least is finite.
    fn edge(&self, around: [[f32; 3]; 3]) -> Option<Edge> {
        let depth = each(around, |z| match z < f32::INFINITY {
            true => (f64::from(z) - self.near) * self.scale,
            false => BACKGROUND,
        });
        let [a, b, c] = depth;
        let gx = ((a[2] - a[0]) + 2.0 * (b[2] - b[0]) + (c[2] - c[0])) * 0.25;
        let gy = ((c[0] - a[0]) + 2.0 * (c[1] - a[1]) + (c[2] - a[2])) * 0.25;
        let inside = around.iter().flatten().all(|&z| z < f32::INFINITY);
        let steep = gx * gx + gy * gy > self.threshold * self.threshold;
        if !steep || (self.guarded && inside && self.flat(around)) {
            return None;
        }
        let nearest = depth.iter().flatten().fold(1.0f64, |least, &d| if d < least { d } else { least });
        Some(Edge { force: along([gx, gy]), nearness: 1.0 - 2.0 * nearest })
    }

    /// Whether 3x3 depths are those of a plane, up to the threshold: the inverse depth of a plane is linear in the
    /// picture, however steep the plane, so its second differences vanish; at a jump they are the jump.
    fn flat(&self, around: [[f32; 3]; 3]) -> bool {
        let [a, b, c] = each(around, |z| 1.0 / f64::from(z));
        let bend = |first: f64, middle: f64, last: f64| (first - middle) - (middle - last);
        let across = (bend(a[0], a[1], a[2]) + 2.0 * bend(b[0], b[1], b[2]) + bend(c[0], c[1], c[2])) * 0.25;
        let down = (bend(a[0], b[0], c[0]) + 2.0 * bend(a[1], b[1], c[1]) + bend(a[2], b[2], c[2])) * 0.25;
        // a small change of 1/z is one of z by -z²
        let z = f64::from(around[1][1]);
        let bend = (across * across + down * down).sqrt() * z * z * self.scale;
        bend <= self.threshold
    }
}

/// The unit vector along an edge with this gradient; 0 without one.
fn along([gx, gy]: [f64; 2]) -> [f64; 2] {
    let length = (gx * gx + gy * gy).sqrt();
    if length > 0.0 { [-gy / length, gx / length] } else { [0.0; 2] }
}

/// The 3x3 samples around a pixel, borders repeated.
#[inline(always)]
fn around<T: Copy>(plane: &Plane<T>, x: usize, y: usize) -> [[T; 3]; 3] {
    let (size, stride) = (plane.size(), plane.stride());
    if x > 0 && y > 0 && x + 1 < size.width && y + 1 < size.height {
        let rows = &plane.samples()[(y - 1) * stride + x - 1..][..2 * stride + 3];
        return [three(rows, 0, 1, 2), three(&rows[stride..], 0, 1, 2), three(&rows[2 * stride..], 0, 1, 2)];
    }
    let (left, right) = (x.saturating_sub(1), (x + 1).min(size.width - 1));
    let (above, below) = (y.saturating_sub(1), (y + 1).min(size.height - 1));
    let row = |y: usize| three(plane.row(y), left, x, right);
    [row(above), row(y), row(below)]
}

#[inline(always)]
fn three<T: Copy>(row: &[T], a: usize, b: usize, c: usize) -> [T; 3] {
    [row[a], row[b], row[c]]
}

/// `f` of all of them; written out, as this is where strokes spend their time.
#[inline(always)]
fn each<T: Copy, U>([a, b, c]: [[T; 3]; 3], f: impl Fn(T) -> U) -> [[U; 3]; 3] {
    [[f(a[0]), f(a[1]), f(a[2])], [f(b[0]), f(b[1]), f(b[2])], [f(c[0]), f(c[1]), f(c[2])]]
}
