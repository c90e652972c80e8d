//! The fit against its reference in plain f64, and against numeric derivatives.

use super::*;
use crate::geometry::Lens;
use crate::marker::Family;
use crate::pixels::{Plane, Size};

/// A picture of gray steps, a print laid on it askew, and the pixels that take part; cells of `cell_px`.
fn askew(cell_px: f64, reach: f64) -> (Samples, Pattern, Fit) {
    let size = Size::new(120, 110);
    let picture = Plane::from_fn(size, |x, y| (40 + (x * 7 + y * 13) % 150) as u8);
    let lens = Lens::guess(size);
    let view = View::new(picture.view(), &lens);
    let mut rectify = Rectify::default();
    rectify.prepare(&lens, size);
    let pattern = Pattern::new(PRINT.0, PRINT.1).expect("a known number");
    let (center, scale) = (DVec2::new(60.0, 55.0), 8.0 * cell_px);
    let quad = [(-0.52, -0.48), (0.5, -0.45), (0.47, 0.55), (-0.49, 0.46)];
    let mut map = Homography::from_square(quad.map(|(x, y)| DVec2::new(x, y))).expect("convex").0;
    map *= 1.0 / map.z_axis.z;
    let unit = (0.9 * WIDTH_PER_SIGMA / scale) * (0.9 * WIDTH_PER_SIGMA / scale);
    let levels = [60.0, 3.0, -4.0, 90.0, 5.0, 6.0];
    let blur = [unit, 0.2 * unit, 0.7 * unit];
    let fit = Fit { map, center, scale, levels, blur, reach, rigid: false };
    let mut samples = Samples::NONE;
    let level = simd::best();
    dispatch!(level, simd => gather::gather(simd, &view, &rectify, &fit, &pattern, MOST_SAMPLES, &mut samples));
    assert!(samples.count > 200);
    (samples, pattern, fit)
}

const PRINT: (Family, u32) = (Family::Tag36h11, 7);

/// Every pixel of the print that an edge reaches takes part once, and few others do; where not all fit, as many
/// as asked for.
#[test]
fn pixels_that_edges_reach_take_part() {
    for cell_px in [11.0, 6.0, 4.0, 2.5] {
        let (samples, _, fit) = askew(cell_px, 40.0);
        let mut taken = std::collections::BTreeSet::new();
        for (x, y) in samples.x[..samples.count].iter().zip(&samples.y) {
            let p = fit.center + DVec2::new(f64::from(*x), f64::from(*y)) * fit.scale;
            assert!((p - p.round()).abs().max_element() < 1e-3);
            assert!(taken.insert((p.x.round() as i32, p.y.round() as i32)), "{p} twice");
        }
        if !samples.whole {
            assert!(
                cell_px == 11.0 && (MOST_SAMPLES * 3 / 4..=MOST_SAMPLES).contains(&samples.count),
                "{}",
                samples.count
            );
            continue;
        }
        let (mut reached, mut spare) = (0, 0);
        for (x, y) in (0..110).flat_map(|y| (0..120).map(move |x| (x, y))) {
            let p = (DVec2::new(f64::from(x), f64::from(y)) - fit.center) / fit.scale;
            let (on_print, sees_edge) = reference::reach(PRINT.0, PRINT.1, &fit, p);
            let took = taken.contains(&(x, y));
            assert!(took || !(on_print && sees_edge), "cell {cell_px} px: {x} {y} is left out");
            reached += usize::from(took && sees_edge);
            spare += usize::from(took && !sees_edge);
        }
        assert!(2 * spare < reached, "cell {cell_px} px: {spare} spare ones, {reached} reached");
    }
}

/// The same sums as in plain f64, to what f32 leaves of them, and the same bits at every SIMD level.
#[test]
fn equations_are_those_of_the_reference() {
    for cell_px in [9.0, 4.0, 2.5] {
        let (samples, pattern, fit) = askew(cell_px, 40.0);
        let plain = reference::normal(PRINT.0, PRINT.1, &samples, &fit);
        let [first, others @ ..] = &simd::available()
            .into_iter()
            .map(|level| {
                dispatch!(level, simd => equations::normal(simd, &samples, &pattern, &fit, true))
                    .expect("regular")
            })
            .collect::<Vec<_>>()[..]
        else {
            panic!("there is always the scalar level");
        };
        assert!(others.iter().all(|sums| sums.a == first.a && sums.b == first.b));
        assert!((first.squares / plain.squares - 1.0).abs() < 1e-5);
        assert!((first.weights / plain.weights - 1.0).abs() < 1e-5);
        for i in 0..UNKNOWNS {
            let size = (plain.a[i][i] * plain.squares).sqrt();
            assert!((first.b[i] - plain.b[i]).abs() < 1e-5 * size, "b {i}, cell {cell_px} px");
            for j in 0..=i {
                let size = (plain.a[i][i] * plain.a[j][j]).sqrt();
                assert!((first.a[i][j] - plain.a[i][j]).abs() < 1e-5 * size, "a {i} {j}, cell {cell_px} px");
            }
        }
    }
}

/// b is half the descent of the sum of squares, unknown by unknown. For cells narrower than the kernel the
/// homography also moves the kernel's extent, which the equations leave out.
#[test]
fn equations_are_the_derivatives_of_the_squares() {
    for (cell_px, bound) in [(9.0, 0.02), (2.5, 0.1)] {
        let (samples, pattern, fit) = askew(cell_px, 1e9);
        let level = simd::best();
        let sums = |fit: &Fit| {
            dispatch!(level, simd => equations::normal(simd, &samples, &pattern, fit, true)).expect("regular")
        };
        let at = sums(&fit);
        for k in 0..UNKNOWNS {
            let step = if k < 8 {
                2e-4
            } else if k < 14 {
                0.05
            } else {
                0.01
            };
            let moved = |sign: f64| {
                let mut fit = fit;
                let step = sign * step;
                match k {
                    0 => fit.map.x_axis.x += step,
                    1 => fit.map.y_axis.x += step,
                    2 => fit.map.z_axis.x += step,
                    3 => fit.map.x_axis.y += step,
                    4 => fit.map.y_axis.y += step,
                    5 => fit.map.z_axis.y += step,
                    6 => fit.map.x_axis.z += step,
                    7 => fit.map.y_axis.z += step,
                    k if k < 14 => fit.levels[k - 8] += step,
                    k => fit.blur[k - 14] += step * fit.blur_size(),
                }
                sums(&fit).squares
            };
            let slope = (moved(1.0) - moved(-1.0)) / (2.0 * step);
            let size = (at.squares * at.a[k][k]).sqrt();
            assert!(
                (slope + 2.0 * at.b[k]).abs() < bound * size,
                "unknown {k}, cell {cell_px} px: {slope} against {} of {size}",
                -2.0 * at.b[k]
            );
        }
    }
}
