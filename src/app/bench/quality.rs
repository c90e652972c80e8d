//! How far a picture is from another: levels, PSNR, SSIM, and CIEDE2000 color differences.

use crate::pixels::Rgb;
use std::fmt;

/// The distance of one picture from another of the same size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    /// Largest difference of a channel, 8-bit levels.
    pub max: u8,
    /// Share of samples off by more than two levels, 0..1.
    pub over_two: f64,
    /// Peak signal-to-noise ratio over all samples, dB; infinite for equal pictures.
    pub psnr: f64,
    /// Mean structural similarity of the luma (Wang et al. 2004: 11x11 Gaussian window, σ 1.5), at most 1.
    pub ssim: f64,
    /// Mean CIEDE2000 difference (CIE 142-2001, D65, sRGB).
    pub delta_e_mean: f64,
    /// The difference that 99 % of the pixels stay below.
    pub delta_e_p99: f64,
}

impl Quality {
    /// Compares two pictures of one size, at least 1x1.
    pub fn of(picture: &Rgb, truth: &Rgb) -> Self {
        let (mut sum, mut max, mut off) = (0.0f64, 0u8, 0u64);
        let planes = picture.planes.iter().zip(&truth.planes);
        for (a, b) in planes.flat_map(|(a, b)| a.rows().zip(b.rows())).flat_map(|(a, b)| a.iter().zip(b)) {
            let miss = a.abs_diff(*b);
            sum += f64::from(miss) * f64::from(miss);
            max = max.max(miss);
            off += u64::from(miss > 2);
        }
        let samples = (3 * truth.size().area()).max(1) as f64;
        let (delta_e_mean, delta_e_p99) = color_differences(picture, truth);
        Self {
            max,
            over_two: off as f64 / samples,
            psnr: psnr(sum / samples),
            ssim: ssim(picture, truth),
            delta_e_mean,
            delta_e_p99,
        }
    }
}

impl fmt::Display for Quality {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { max, over_two, psnr, ssim, delta_e_mean, delta_e_p99 } = self;
        write!(
            f,
            "max {max:>3}, PSNR {psnr:>5.1} dB, SSIM {ssim:.5}, ΔE00 {delta_e_mean:.3} (p99 {delta_e_p99:.2}), \
             off by > 2 levels {:.3} %",
            100.0 * over_two
        )
    }
}

/// PSNR of a mean squared error in levels².
pub fn psnr(mean: f64) -> f64 {
    if mean == 0.0 { f64::INFINITY } else { 10.0 * libm::log10(255.0 * 255.0 / mean) }
}

/// Mean and 99th percentile of CIEDE2000 over all pixels.
fn color_differences(a: &Rgb, b: &Rgb) -> (f64, f64) {
    let linear: Vec<f64> = (0..=255).map(|v| expand(f64::from(v) / 255.0)).collect();
    let lab = |color: [u8; 3]| lab(color.map(|v| linear[usize::from(v)]));
    let size = b.size();
    let mut all: Vec<f64> = (0..size.area())
        .map(|i| {
            let (p, q) = (a.at(i % size.width, i / size.width), b.at(i % size.width, i / size.width));
            if p == q { 0.0 } else { ciede2000(lab(p), lab(q)) }
        })
        .collect();
    let mean = all.iter().sum::<f64>() / all.len().max(1) as f64;
    all.sort_unstable_by(f64::total_cmp);
    let rank = (0.99 * all.len() as f64).ceil() as usize;
    (mean, all.get(rank.max(1) - 1).copied().unwrap_or(0.0))
}

/// sRGB's transfer curve, coded value to linear light.
fn expand(v: f64) -> f64 {
    if v <= 0.04045 { v / 12.92 } else { libm::pow((v + 0.055) / 1.055, 2.4) }
}

/// Linear sRGB to CIELAB under D65.
fn lab([r, g, b]: [f64; 3]) -> [f64; 3] {
    let x = (0.4124564 * r + 0.3575761 * g + 0.1804375 * b) / 0.95047;
    let y = 0.2126729 * r + 0.7151522 * g + 0.0721750 * b;
    let z = (0.0193339 * r + 0.1191920 * g + 0.9503041 * b) / 1.08883;
    let f = |t: f64| {
        if t > 216.0 / 24389.0 { libm::cbrt(t) } else { (24389.0 / 27.0 * t + 16.0) / 116.0 }
    };
    let [x, y, z] = [x, y, z].map(f);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// The CIEDE2000 difference of two CIELAB colors (G. Sharma, W. Wu, E. Dalal 2005, eq. 2 to 22).
fn ciede2000([l1, a1, b1]: [f64; 3], [l2, a2, b2]: [f64; 3]) -> f64 {
    let seventh = |c: f64| {
        let c7 = libm::pow(c, 7.0);
        (c7 / (c7 + libm::pow(25.0, 7.0))).sqrt()
    };
    let chroma = |a: f64, b: f64| (a * a + b * b).sqrt();
    let g = 0.5 * (1.0 - seventh((chroma(a1, b1) + chroma(a2, b2)) / 2.0));
    let (a1, a2) = (a1 * (1.0 + g), a2 * (1.0 + g));
    let (c1, c2) = (chroma(a1, b1), chroma(a2, b2));
    let hue = |a: f64, b: f64| {
        let degrees = libm::atan2(b, a).to_degrees();
        if degrees < 0.0 { degrees + 360.0 } else { degrees }
    };
    let (h1, h2) = (hue(a1, b1), hue(a2, b2));
    let gray = c1 * c2 == 0.0;
    let turn = match h2 - h1 {
        _ if gray => 0.0,
        d if d > 180.0 => d - 360.0,
        d if d < -180.0 => d + 360.0,
        d => d,
    };
    let (dl, dc) = (l2 - l1, c2 - c1);
    let dh = 2.0 * (c1 * c2).sqrt() * libm::sin((turn / 2.0).to_radians());
    let (l, c) = ((l1 + l2) / 2.0, (c1 + c2) / 2.0);
    let h = match h1 + h2 {
        sum if gray => sum,
        sum if (h1 - h2).abs() <= 180.0 => sum / 2.0,
        sum if sum < 360.0 => (sum + 360.0) / 2.0,
        sum => (sum - 360.0) / 2.0,
    };
    let cos = |degrees: f64| libm::cos(degrees.to_radians());
    let t = 1.0 - 0.17 * cos(h - 30.0) + 0.24 * cos(2.0 * h) + 0.32 * cos(3.0 * h + 6.0)
        - 0.20 * cos(4.0 * h - 63.0);
    let bend = (h - 275.0) / 25.0;
    let rotation = -2.0 * seventh(c) * libm::sin((60.0 * libm::exp(-bend * bend)).to_radians());
    let middle = (l - 50.0) * (l - 50.0);
    let l = dl / (1.0 + 0.015 * middle / (20.0 + middle).sqrt());
    let h = dh / (1.0 + 0.015 * c * t);
    let c = dc / (1.0 + 0.045 * c);
    (l * l + c * c + h * h + rotation * c * h).sqrt()
}

/// Mean SSIM of the luma; windows reach over the border by clamping.
fn ssim(a: &Rgb, b: &Rgb) -> f64 {
    const REACH: isize = 5;
    let size = b.size();
    let (width, height) = (size.width, size.height);
    let weights: Vec<f64> = (-REACH..=REACH).map(|d| libm::exp(-((d * d) as f64) / 4.5)).collect();
    let total: f64 = weights.iter().sum();
    let luma = |picture: &Rgb, i: usize| {
        let [r, g, b] = picture.at(i % width, i / width).map(f64::from);
        0.299 * r + 0.587 * g + 0.114 * b
    };
    let blur = |values: Vec<f64>| {
        let tap = |i: usize, d: isize, n: usize| i.saturating_add_signed(d).min(n - 1);
        let along = |at: &dyn Fn(isize) -> f64| {
            (-REACH..=REACH).zip(&weights).map(|(d, w)| w * at(d)).sum::<f64>() / total
        };
        let across: Vec<f64> = (0..values.len())
            .map(|i| along(&|d| values[i / width * width + tap(i % width, d, width)]))
            .collect();
        let down = |i: usize| along(&|d| across[tap(i / width, d, height) * width + i % width]);
        (0..across.len()).map(down).collect::<Vec<f64>>()
    };
    let product = |p: &Rgb, q: &Rgb| blur((0..size.area()).map(|i| luma(p, i) * luma(q, i)).collect());
    let mean = |p: &Rgb| blur((0..size.area()).map(|i| luma(p, i)).collect());
    let (ma, mb, aa, bb, ab) = (mean(a), mean(b), product(a, a), product(b, b), product(a, b));
    let (c1, c2) = (0.01 * 255.0 * (0.01 * 255.0), 0.03 * 255.0 * (0.03 * 255.0));
    let index = |i: usize| {
        let (m, n) = (ma[i], mb[i]);
        let (va, vb, cov) = (aa[i] - m * m, bb[i] - n * n, ab[i] - m * n);
        (2.0 * m * n + c1) * (2.0 * cov + c2) / ((m * m + n * n + c1) * (va + vb + c2))
    };
    (0..size.area()).map(index).sum::<f64>() / size.area().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pixels::{Plane, Size};

    /// Pairs from Table 1 of Sharma, Wu & Dalal: the tricky hues, large and small differences.
    #[test]
    fn color_differences_match_the_published_pairs() {
        for (one, two, expected) in [
            ([50.0, 2.6772, -79.7751], [50.0, 0.0, -82.7485], 2.0425),
            ([50.0, 3.1571, -77.2803], [50.0, 0.0, -82.7485], 2.8615),
            ([50.0, -1.3802, -84.2814], [50.0, 0.0, -82.7485], 1.0),
            ([50.0, 0.0, 0.0], [50.0, -1.0, 2.0], 2.3669),
            ([50.0, 2.49, -0.001], [50.0, -2.49, 0.0009], 7.1792),
            ([50.0, 2.49, -0.001], [50.0, -2.49, 0.0011], 7.2195),
            ([50.0, 2.5, 0.0], [73.0, 25.0, -18.0], 27.1492),
            ([60.2574, -34.0099, 36.2677], [60.4626, -34.1751, 39.4387], 1.2644),
            ([2.0776, 0.0795, -1.135], [0.9033, -0.0636, -0.5514], 0.9082),
        ] {
            let found = ciede2000(one, two);
            assert!((found - expected).abs() < 5e-5, "{one:?} {two:?}: {found}");
            assert!((ciede2000(two, one) - expected).abs() < 5e-5, "symmetric");
        }
    }

    #[test]
    fn white_is_white_and_equal_is_equal() {
        let [l, a, b] = lab([1.0; 3]);
        assert!((l - 100.0).abs() < 1e-3 && a.abs() < 1e-2 && b.abs() < 1e-2, "{l} {a} {b}");
        let ramp = Plane::from_fn(Size::new(40, 30), |x, y| (x * 5 + y) as u8);
        let picture = Rgb { planes: [ramp.clone(), ramp.clone(), ramp] };
        let same = Quality::of(&picture, &picture);
        assert_eq!((same.max, same.psnr, same.delta_e_p99), (0, f64::INFINITY, 0.0));
        assert!((same.ssim - 1.0).abs() < 1e-12);
        let mut other = picture.clone();
        other.planes[0].samples_mut().iter_mut().for_each(|v| *v = v.wrapping_add(3));
        let off = Quality::of(&other, &picture);
        assert_eq!(off.max, 3);
        assert!((off.over_two - 1.0 / 3.0).abs() < 1e-12);
        assert!((off.psnr - psnr(3.0)).abs() < 1e-9 && off.ssim < 1.0 && off.delta_e_mean > 0.1);
    }
}
