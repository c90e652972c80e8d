//! The plain f64 twins: one pixel at a time, from the definitions.

use super::{Coding, Range, Samples, Siting};
use crate::pixels::{Plane, PlaneRef, Rgb, Size};

/// Luma, red, green, blue of one pixel before rounding, in levels, not clamped.
pub fn pixel(samples: &Samples<'_>, size: Size, coding: Coding, x: usize, y: usize) -> [f64; 4] {
    let half = Size::new(size.width.div_ceil(2), size.height.div_ceil(2));
    let (xf, yf) = (x as f64, y as f64);
    // chroma at a position of the chroma grid, by byte offsets in interleaved rows
    let sample = |plane: &PlaneRef<'_, u8>, step: usize, offset: usize, count: Size, u: f64, v: f64| {
        let clamp = |i: f64, n: usize| (i.max(0.0) as usize).min(n - 1);
        let at = |i: f64, j: f64| {
            f64::from(plane.at(clamp(i, count.width) * step + offset, clamp(j, count.height)))
        };
        let (i, j) = (u.floor(), v.floor());
        let (s, t) = (u - i, v - j);
        let upper = at(i, j) * (1.0 - s) + at(i + 1.0, j) * s;
        let lower = at(i, j + 1.0) * (1.0 - s) + at(i + 1.0, j + 1.0) * s;
        upper * (1.0 - t) + lower * t
    };
    let across = |siting: Siting| if siting == Siting::Center { (xf - 0.5) / 2.0 } else { xf / 2.0 };
    let down = |siting: Siting, c: usize| match (siting, c) {
        (Siting::PalDv, 0) => yf / 2.0,
        (Siting::PalDv, _) => (yf - 1.0) / 2.0,
        _ => (yf - 0.5) / 2.0,
    };
    let wide = Size::new(half.width, size.height);
    let (luma, cb, cr) = match samples {
        Samples::Rgb(bytes) => return rgb([0, 1, 2].map(|c| bytes.at(3 * x + c, y)), coding),
        Samples::Yuyv(p) => {
            (p.at(2 * x, y), sample(p, 4, 1, wide, xf / 2.0, yf), sample(p, 4, 3, wide, xf / 2.0, yf))
        }
        Samples::Uyvy(p) => {
            (p.at(2 * x + 1, y), sample(p, 4, 0, wide, xf / 2.0, yf), sample(p, 4, 2, wide, xf / 2.0, yf))
        }
        Samples::Nv12(luma, c, siting) => (
            luma.at(x, y),
            sample(c, 2, 0, half, across(*siting), down(*siting, 0)),
            sample(c, 2, 1, half, across(*siting), down(*siting, 0)),
        ),
        Samples::Planar420(p, siting) => (
            p[0].at(x, y),
            sample(&p[1], 1, 0, half, across(*siting), down(*siting, 0)),
            sample(&p[2], 1, 0, half, across(*siting), down(*siting, 1)),
        ),
        Samples::Planar422(p) => {
            (p[0].at(x, y), sample(&p[1], 1, 0, wide, xf / 2.0, yf), sample(&p[2], 1, 0, wide, xf / 2.0, yf))
        }
        Samples::Planar444(p) => (p[0].at(x, y), f64::from(p[1].at(x, y)), f64::from(p[2].at(x, y))),
        Samples::Packed444(p) => {
            (p.at(3 * x, y), f64::from(p.at(3 * x + 1, y)), f64::from(p.at(3 * x + 2, y)))
        }
        Samples::Gray(p) => (p.at(x, y), 128.0, 128.0),
    };
    let (black, white, swing) = match coding.range {
        Range::Limited => (16.0, 219.0, 224.0),
        Range::Full => (0.0, 255.0, 255.0),
    };
    let (kr, kb) = coding.matrix.weights();
    let luma = (f64::from(luma) - black) / white;
    let (cb, cr) = ((cb - 128.0) / swing, (cr - 128.0) / swing);
    let (red, blue) = (luma + 2.0 * (1.0 - kr) * cr, luma + 2.0 * (1.0 - kb) * cb);
    let green = (luma - kr * red - kb * blue) / (1.0 - kr - kb);
    [luma, red, green, blue].map(|v| v * 255.0)
}

fn rgb(bytes: [u8; 3], coding: Coding) -> [f64; 4] {
    let channels = bytes.map(|v| match coding.range {
        Range::Full => f64::from(v),
        Range::Limited => (f64::from(v) - 16.0) * 255.0 / 219.0,
    });
    let [r, g, b] = channels.map(|v| u32::from(round(v)));
    let luma = (9798 * r + 19235 * g + 3735 * b + 16384) >> 15;
    [f64::from(luma), channels[0], channels[1], channels[2]]
}

/// Clamps to 0..255 and rounds by floor(v + .5).
pub fn round(v: f64) -> u8 {
    (v.clamp(0.0, 255.0) + 0.5).floor() as u8
}

/// The twin of [`super::to_rgb`].
pub fn to_rgb(samples: &Samples<'_>, size: Size, coding: Coding) -> (Plane<u8>, Rgb) {
    let channel = |c: usize| Plane::from_fn(size, |x, y| round(pixel(samples, size, coding, x, y)[c]));
    (channel(0), Rgb { planes: [channel(1), channel(2), channel(3)] })
}

/// The twin of [`super::from_rgb`].
pub fn from_rgb(color: &Rgb) -> [Plane<u8>; 3] {
    let value = |c: usize, x: usize, y: usize| {
        let [r, g, b] = color.at(x, y).map(f64::from);
        // thousandths as whole numbers, so that ties are ties
        let luma = (299.0 * r + 587.0 * g + 114.0 * b) / 1000.0;
        round(match c {
            0 => luma,
            1 => (886.0 * b - 299.0 * r - 587.0 * g) / 1772.0 + 128.0,
            _ => (701.0 * r - 587.0 * g - 114.0 * b) / 1402.0 + 128.0,
        })
    };
    [0, 1, 2].map(|c| Plane::from_fn(color.size(), |x, y| value(c, x, y)))
}
