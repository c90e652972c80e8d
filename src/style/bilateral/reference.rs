//! Both styles in plain f64 and integers, read straight from the thesis: what the fast forms are held to.

use super::{Config, Lines};
use crate::kernel::{bilateral, canny, pyramid};
use crate::pixels::{Plane, Rgb, Size};

/// An RGB picture in f64.
type Picture = Plane<[f64; 3]>;

/// Draws a camera picture as section 3.2.1 says; 8-bit result.
pub fn reference(config: &Config, camera: &Rgb) -> Rgb {
    let size = camera.size();
    let mut out = Rgb::new(size, [0; 3]);
    if size.area() == 0 {
        return out;
    }
    let mut picture = Plane::from_fn(size, |x, y| camera.at(x, y).map(|v| f64::from(v) / 255.0));
    let mut sizes = Vec::new();
    for _ in 0..config.levels {
        sizes.push(picture.size());
        picture = channels(pyramid::half(picture.size()), |x, y, c| {
            pyramid::down_reference(picture.size(), x, y, |x, y| picture.at(x, y)[c])
        });
    }
    let (sigma_d, sigma_r) = (f64::from(config.sigma_d), f64::from(config.sigma_r));
    for _ in 0..config.iterations {
        let size = picture.size();
        let filtered = |x, y| bilateral::reference(size, sigma_d, sigma_r, x, y, |x, y| picture.at(x, y));
        picture = Plane::from_fn(size, filtered);
    }
    while let Some(size) = sizes.pop() {
        picture =
            channels(size, |x, y, c| pyramid::up_reference(picture.size(), x, y, |x, y| picture.at(x, y)[c]));
    }
    let paper = sketch_reference(&config.lines(), camera);
    for (x, y) in (0..size.height).flat_map(|y| (0..size.width).map(move |x| (x, y))) {
        let color = picture.at(x, y).map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5).floor() as u8);
        let paper = paper.at(x, y);
        out.set(x, y, [0, 1, 2].map(|c| color[c] & paper[c]));
    }
    out
}

/// The inverted, dilated edges of a camera picture.
pub fn sketch_reference(config: &Lines, camera: &Rgb) -> Rgb {
    let size = camera.size();
    let gray = Plane::from_fn(size, |x, y| canny::gray(camera.at(x, y)));
    let edges = canny::dilate_reference(&canny::reference(&gray, config.t2 as i32, config.t1 as i32));
    let paper = Plane::from_fn(size, |x, y| if edges.at(x, y) { 0 } else { 255 });
    Rgb { planes: [paper.clone(), paper.clone(), paper] }
}

fn channels(size: Size, f: impl Fn(usize, usize, usize) -> f64) -> Picture {
    Plane::from_fn(size, |x, y| [0, 1, 2].map(|c| f(x, y, c)))
}
