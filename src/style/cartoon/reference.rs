//! The cartoon filter in plain f64, read straight from the paper: what the fast form is held to.

use super::Config;
use crate::kernel::{area, color};
use crate::pixels::{Rgb, Size};

/// An RGB picture in f64, rows top first.
struct Picture {
    size: Size,
    pixels: Vec<[f64; 3]>,
}

impl Picture {
    fn from_fn(size: Size, f: impl Fn(usize, usize) -> [f64; 3]) -> Self {
        let at = |i: usize| f(i % size.width, i / size.width);
        Self { size, pixels: (0..size.area()).map(at).collect() }
    }

    /// The pixel, coordinates clamped to the border.
    fn at(&self, x: isize, y: isize) -> [f64; 3] {
        let clamp = |v: isize, n: usize| v.clamp(0, n as isize - 1) as usize;
        self.pixels[clamp(y, self.size.height) * self.size.width + clamp(x, self.size.width)]
    }

    /// An interpolated texture access, pixel centers at integers, clamped to the border.
    fn sample(&self, x: f64, y: f64) -> [f64; 3] {
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let (x0, y0) = (x0 as isize, y0 as isize);
        std::array::from_fn(|c| {
            let top = self.at(x0, y0)[c] * (1.0 - fx) + self.at(x0 + 1, y0)[c] * fx;
            let bottom = self.at(x0, y0 + 1)[c] * (1.0 - fx) + self.at(x0 + 1, y0 + 1)[c] * fx;
            top * (1.0 - fy) + bottom * fy
        })
    }
}

/// Draws `augmented` (camera picture with the models over it) as the paper's equations say; 8-bit result.
pub fn reference(config: &Config, augmented: &Rgb) -> Rgb {
    let size = augmented.size();
    let mut out = Rgb::new(size, [0; 3]);
    if size.area() == 0 {
        return out;
    }
    let shrunk = config.shrunk(size);
    let mean = |x, y| augmented.planes.each_ref().map(|plane| area::reference(plane.view(), shrunk, x, y));
    let mut simplified = Picture::from_fn(shrunk, mean);
    for _ in 0..config.steps {
        simplified = simplify(&simplified, f64::from(config.sigma_p));
    }
    let original = Picture::from_fn(size, |x, y| augmented.at(x, y).map(|v| f64::from(v) / 255.0));
    for y in 0..size.height {
        for x in 0..size.width {
            // (x_s, y_s): the same place in the simplified picture, pixel centers aligned
            let along = |o: usize, n: usize, out: usize| (o as f64 + 0.5) * n as f64 / out as f64 - 0.5;
            let (xs, ys) = (along(x, shrunk.width, size.width), along(y, shrunk.height, size.height));
            let edge_s = edge(config, |dx, dy| simplified.sample(xs + dx as f64, ys + dy as f64));
            let edge_a = edge(config, |dx, dy| original.at(x as isize + dx, y as isize + dy));
            // eq. 5
            let line = (1.0 - f64::from(config.beta)) * smoothstep(config.s0, config.s1, edge_s)
                + f64::from(config.beta) * smoothstep(config.a0, config.a1, edge_a);
            let color = simplified.sample(xs, ys).map(|v| v * (1.0 - line));
            out.set(x, y, color.map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5).floor() as u8));
        }
    }
    out
}

/// One step of the non-linear filter, eq. 1 to 3: 5x5, weights from U and V alone.
fn simplify(f: &Picture, sigma_p: f64) -> Picture {
    Picture::from_fn(f.size, |x, y| {
        let center = color::yuv_reference(f.at(x as isize, y as isize));
        let (mut h, mut k) = ([0.0; 3], 0.0);
        for (dx, dy) in (-2..=2).flat_map(|dy| (-2..=2).map(move |dx| (dx, dy))) {
            let rgb = f.at(x as isize + dx, y as isize + dy);
            let yuv = color::yuv_reference(rgb);
            let distance = libm::hypot(yuv[1] - center[1], yuv[2] - center[2]) / sigma_p;
            let s = libm::exp(-0.5 * distance * distance);
            k += s;
            for (sum, value) in h.iter_mut().zip(rgb) {
                *sum += value * s;
            }
        }
        h.map(|sum| sum / k)
    })
}

/// Edge response, eq. 4, from RGB taps one step apart.
fn edge(config: &Config, tap: impl Fn(isize, isize) -> [f64; 3]) -> f64 {
    let (mut gx, mut gy) = ([0.0; 3], [0.0; 3]);
    for (dx, dy) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))) {
        let yuv = color::yuv_reference(tap(dx, dy));
        let weight = |along: isize, across: isize| along as f64 * (2 - across.abs()) as f64 / 4.0;
        for c in 0..3 {
            gx[c] += weight(dx, dy) * yuv[c];
            gy[c] += weight(dy, dx) * yuv[c];
        }
    }
    let [y, u, v] = [0, 1, 2].map(|c| libm::hypot(gx[c], gy[c]));
    let alpha = f64::from(config.alpha);
    (1.0 - alpha) * y + alpha * (u + v) / 2.0
}

/// GLSL's smoothstep.
fn smoothstep(e0: f32, e1: f32, x: f64) -> f64 {
    let t = ((x - f64::from(e0)) / f64::from(e1 - e0)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Frame;
    use crate::kernel::sweep;
    use crate::pixels::simd;
    use crate::style::{Style, StyleInput, cartoon::Cartoon};

    /// The bounds of the whole picture: PSNR 55 dB, at most .1 % of the pixels off by more than 2 levels (at
    /// least one may be: an edge pixel can flip, the smoothstep band is .01 wide).
    #[test]
    fn the_fast_form_keeps_its_bounds_at_every_size_and_content() {
        for (w, h) in [(1, 1), (2, 5), (9, 4), (33, 31), (67, 45), (101, 160), (160, 120)] {
            for content in ["flat", "ramp", "impulse", "checkerboard", "noise", "photograph"] {
                let size = Size::new(w, h);
                let [r, g] = [content, "photograph"].map(|c| sweep::case(c, size).plane.view().to_plane());
                let color = Rgb { planes: [r.clone(), g, r] };
                let exact = reference(&Config::default(), &color);
                let frame = Frame { color, ..Frame::default() };
                let mut out = Rgb::default();
                let input = StyleInput { frame: &frame, layer: None };
                Cartoon::new(Config::default(), simd::best()).draw(input, &mut out);
                let (mut squares, mut off, mut worst) = (0.0, 0, 0.0f64);
                for (a, b) in (0..w * h).map(|i| (out.at(i % w, i / w), exact.at(i % w, i / w))) {
                    let miss = [0, 1, 2].map(|c| f64::from(a[c].abs_diff(b[c])));
                    worst = miss.into_iter().fold(worst, f64::max);
                    squares += miss.iter().map(|m| m * m).sum::<f64>();
                    off += usize::from(miss.iter().any(|&m| m > 2.0));
                }
                let psnr = 10.0 * libm::log10(255.0 * 255.0 * 3.0 * (w * h) as f64 / squares);
                assert!(off <= (w * h / 1000).max(1), "{content} {size}: {off} pixels off");
                // a gray that lies on a rounding tie is one level off everywhere: 48 dB, and nothing is wrong
                assert!(off > 0 || worst <= 1.0 || psnr >= 55.0, "{content} {size}: {psnr:.1} dB");
            }
        }
    }
}
