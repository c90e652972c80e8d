//! Every kind, coding, size, level and thread count against the f64 twins.

use super::*;
use crate::kernel::sweep::{case, cases, everywhere};
use crate::pixels::SplitMix64;

/// Values of a kernel this close to a rounding tie may fall on its other side: f32 keeps a value of up to
/// 600 levels to 3 roundings of 2⁻²⁴.
const TIE: f64 = 1e-4;

const CODINGS: [Coding; 3] = [
    Coding { matrix: Matrix::Bt601, range: Range::Limited },
    Coding { matrix: Matrix::Bt601, range: Range::Full },
    Coding { matrix: Matrix::Bt709, range: Range::Limited },
];

/// `bytes` per row and rows of noise with junk between the rows.
fn noise(width: usize, height: usize, seed: u64) -> Plane<u8> {
    let mut rng = SplitMix64::new(seed);
    let mut plane = Plane::with_stride(Size::new(width, height), width + 7, 0);
    plane.samples_mut().iter_mut().for_each(|v| *v = rng.next_u64() as u8);
    plane
}

/// Runs `check` with every kind of samples of `size`: luma from `luma`, chroma noise.
fn kinds(size: Size, luma: &Plane<u8>, check: impl Fn(&str, &Samples<'_>)) {
    let (w, h) = (size.width, size.height);
    let (cw, ch) = (w.div_ceil(2), h.div_ceil(2));
    let mut packed = noise(4 * cw, h, 1);
    for y in 0..h {
        for x in 0..w {
            packed.row_mut(y)[2 * x] = luma.at(x, y);
        }
    }
    let mut packed_uyvy = noise(4 * cw, h, 2);
    for y in 0..h {
        for x in 0..w {
            packed_uyvy.row_mut(y)[2 * x + 1] = luma.at(x, y);
        }
    }
    let pairs = noise(2 * cw, ch, 3);
    let (quarter, wide, full) =
        ([4, 5].map(|s| noise(cw, ch, s)), [6, 7].map(|s| noise(cw, h, s)), [8, 9].map(|s| noise(w, h, s)));
    let triples = noise(3 * w, h, 10);
    let three = |[cb, cr]: [Plane<u8>; 2]| [luma.clone(), cb, cr];
    let (p420, p422, p444) = (three(quarter), three(wide), three(full));
    check("yuyv", &Samples::Yuyv(packed.view()));
    check("uyvy", &Samples::Uyvy(packed_uyvy.view()));
    check("nv12", &Samples::Nv12(luma.view(), pairs.view(), Siting::Center));
    check("nv12 left", &Samples::Nv12(luma.view(), pairs.view(), Siting::Left));
    let v = [p420[0].view(), p420[1].view(), p420[2].view()];
    check("420", &Samples::Planar420(v, Siting::Center));
    check("420 left", &Samples::Planar420(v, Siting::Left));
    check("420 pal-dv", &Samples::Planar420(v, Siting::PalDv));
    check("422", &Samples::Planar422([p422[0].view(), p422[1].view(), p422[2].view()]));
    check("444", &Samples::Planar444([p444[0].view(), p444[1].view(), p444[2].view()]));
    check("ycbcr", &Samples::Packed444(triples.view()));
    check("gray", &Samples::Gray(luma.view()));
    check("rgb", &Samples::Rgb(triples.view()));
}

#[test]
fn every_kind_matches_the_reference() {
    let counted = std::sync::Mutex::new(std::collections::BTreeMap::<String, (usize, usize)>::new());
    for case in cases() {
        let size = case.plane.size();
        let large = size.area() > 100_000;
        for coding in CODINGS {
            if large && coding != CODINGS[0] {
                continue;
            }
            kinds(size, &case.plane, |kind, samples| {
                let label = format!("{kind} {coding:?} {}", case.label);
                let (luma, color) = everywhere(&label, |level| {
                    let (mut luma, mut color) = (Plane::default(), Rgb::default());
                    to_rgb(level, samples, size, coding, &mut luma, &mut color);
                    (luma, color)
                });
                let mut off = 0;
                for y in 0..size.height {
                    for x in 0..size.width {
                        let exact = reference::pixel(samples, size, coding, x, y);
                        let [r, g, b] = color.at(x, y);
                        for (got, exact) in [luma.at(x, y), r, g, b].into_iter().zip(exact) {
                            let wanted = reference::round(exact);
                            if got != wanted {
                                let tie = (exact - exact.floor() - 0.5).abs();
                                let near = got.abs_diff(wanted) == 1 && tie < TIE;
                                assert!(near, "{label} at {x},{y}: {got}, exact {exact}");
                                off += 1;
                            }
                        }
                    }
                }
                let mut counted = counted.lock().expect("no panic before");
                let entry = counted.entry(kind.to_string()).or_default();
                *entry = (entry.0 + off, entry.1 + 4 * size.area());
            });
        }
    }
    for (kind, (off, of)) in counted.into_inner().expect("no panic") {
        println!("{kind}: {off} of {of} values one level off at a tie");
    }
}

#[test]
fn every_luma_and_chroma_value_is_right() {
    // one pixel of each (Y, C, C) on a grid that holds the extremes
    let values: Vec<u8> = (0..=255).step_by(5).collect();
    let n = values.len();
    let size = Size::new(n, n * n);
    let planes =
        [0, 1, 2].map(|c: usize| Plane::from_fn(size, |x, y| [values[x], values[y / n], values[y % n]][c]));
    let samples = Samples::Planar444([planes[0].view(), planes[1].view(), planes[2].view()]);
    for matrix in [Matrix::Bt601, Matrix::Bt709, Matrix::Bt2020, Matrix::Smpte240m] {
        for range in [Range::Limited, Range::Full] {
            let coding = Coding { matrix, range };
            let (mut luma, mut color) = (Plane::default(), Rgb::default());
            to_rgb(crate::pixels::simd::best(), &samples, size, coding, &mut luma, &mut color);
            let (exact_luma, exact) = reference::to_rgb(&samples, size, coding);
            assert!(luma == exact_luma, "{coding:?}: luma differs");
            let mut off = 0;
            for c in 0..3 {
                for (got, exact) in color.planes[c].samples().iter().zip(exact.planes[c].samples()) {
                    assert!(got.abs_diff(*exact) <= 1, "{coding:?}");
                    off += usize::from(got != exact);
                }
            }
            assert!(off * 10_000 <= 3 * size.area(), "{coding:?}: {off} ties off in {}", 3 * size.area());
        }
    }
}

#[test]
fn rgb_to_yuv_is_exact_and_comes_back() {
    for base in cases() {
        let size = base.plane.size();
        let color =
            Rgb { planes: [base.plane.clone(), noise(size.width, size.height, 3), case("ramp", size).plane] };
        let yuv = everywhere(&base.label, |level| {
            let mut yuv = [Plane::default(), Plane::default(), Plane::default()];
            from_rgb(level, &color, &mut yuv);
            yuv
        });
        assert!(yuv == reference::from_rgb(&color), "{}", base.label);
        let samples = Samples::Planar444([yuv[0].view(), yuv[1].view(), yuv[2].view()]);
        let (mut luma, mut back) = (Plane::default(), Rgb::default());
        let coding = Coding { range: Range::Full, ..Coding::default() };
        to_rgb(crate::pixels::simd::best(), &samples, size, coding, &mut luma, &mut back);
        for y in 0..size.height {
            for x in 0..size.width {
                for (a, b) in color.at(x, y).into_iter().zip(back.at(x, y)) {
                    // half a level of Y and half a level of chroma times at most 1.772
                    assert!(a.abs_diff(b) <= 2, "{} at {x},{y}: {a} became {b}", base.label);
                }
            }
        }
    }
}

#[test]
fn all_gray_levels_of_rgb_give_that_luma() {
    let gray = Plane::from_fn(Size::new(256, 1), |x, _| x as u8);
    let color = Rgb { planes: [gray.clone(), gray.clone(), gray.clone()] };
    let mut luma = Plane::default();
    luma_of_rgb(crate::pixels::simd::best(), &color, &mut luma);
    assert!(luma == gray);
}
