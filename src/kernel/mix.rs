//! Two pictures into one: everywhere by one share, or by a mask.
//!
//! A share is in 1/256, 0 to 256; a mixed byte is floor(from·(1 - share) + to·share + 1/2), exactly.

use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, Rgb};
use fearless_simd::Simd;
use rayon::prelude::*;

/// Makes `to` the mixture of `from` and itself: its own share is `share` of 256. Pictures of two sizes stay as they
/// are. Allocates nothing.
pub fn fade(level: Level, from: &Rgb, share: u16, to: &mut Rgb) {
    let share = share.min(256);
    rows(from, to, |_, from, to| dispatch!(level, simd => fade_row(simd, from, share, to)));
}

/// Makes `to` the mixture of `from` and itself: its own share is 0 where `mask` is 0 and 1 where it is 255.
/// Pictures of other sizes than the mask's stay as they are. Allocates nothing.
pub fn mask(level: Level, from: &Rgb, mask: &Plane<u8>, to: &mut Rgb) {
    if mask.size() == to.size() {
        rows(from, to, |y, from, to| dispatch!(level, simd => mask_row(simd, from, mask.row(y), to)));
    }
}

/// The share, of 256, that a mask's byte stands for.
pub fn share(mask: u8) -> u16 {
    u16::from(mask) + u16::from(mask >> 7)
}

/// Calls `mix` with every row's number and both pictures' bytes, channel by channel.
fn rows(from: &Rgb, to: &mut Rgb, mix: impl Fn(usize, &[u8], &mut [u8]) + Sync) {
    if from.size() != to.size() {
        return;
    }
    let rows = super::band_rows(from.size().height, 16);
    for (from, to) in from.planes.iter().zip(&mut to.planes) {
        to.view_mut().par_bands(rows).for_each(|(first, mut band)| {
            for y in 0..band.size().height {
                mix(first + y, from.row(first + y), band.row_mut(y));
            }
        });
    }
}

#[inline(always)]
fn fade_row<S: Simd>(_simd: S, from: &[u8], share: u16, to: &mut [u8]) {
    for (to, &from) in to.iter_mut().zip(from) {
        *to = ((u16::from(from) * (256 - share) + u16::from(*to) * share + 128) >> 8) as u8;
    }
}

#[inline(always)]
fn mask_row<S: Simd>(_simd: S, from: &[u8], mask: &[u8], to: &mut [u8]) {
    for ((to, &from), &mask) in to.iter_mut().zip(from).zip(mask) {
        let share = share(mask);
        *to = ((u16::from(from) * (256 - share) + u16::from(*to) * share + 128) >> 8) as u8;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::sweep;

    /// The definition.
    fn reference(from: u8, to: u8, share: u16) -> u8 {
        let share = f64::from(share) / 256.0;
        (f64::from(from) * (1.0 - share) + f64::from(to) * share + 0.5).floor() as u8
    }

    #[test]
    fn every_pair_of_bytes_is_rounded_exactly() {
        let all = crate::pixels::Size::new(256, 256);
        let (a, b) = (Plane::from_fn(all, |x, _| x as u8), Plane::from_fn(all, |_, y| y as u8));
        let from = Rgb { planes: [a.clone(), b.clone(), a.clone()] };
        for share in [0, 1, 77, 128, 200, 255, 256] {
            let mut to = Rgb { planes: [b.clone(), a.clone(), b.clone()] };
            fade(crate::pixels::simd::best(), &from, share, &mut to);
            for (x, y) in (0..256).flat_map(|y| (0..256).map(move |x| (x, y))) {
                let [r, g, _] = [from.at(x, y)[0], from.at(x, y)[1], 0];
                assert_eq!(to.at(x, y)[..2], [reference(r, y as u8, share), reference(g, x as u8, share)]);
            }
        }
    }

    #[test]
    fn a_mask_shares_pixel_by_pixel() {
        for case in sweep::cases() {
            let size = case.plane.size();
            let from =
                Rgb { planes: [0, 1, 2].map(|c| Plane::from_fn(size, |x, y| (x * 7 + y * 3 + c) as u8)) };
            let mixed = sweep::everywhere(&case.label, |level| {
                let mut to = Rgb::new(size, [9, 120, 255]);
                mask(level, &from, &case.plane, &mut to);
                to
            });
            for (x, y) in (0..size.height).flat_map(|y| (0..size.width).map(move |x| (x, y))) {
                let (from, own) = (from.at(x, y), share(case.plane.at(x, y)));
                let truth = [9, 120, 255].iter().zip(from).map(|(&to, from)| reference(from, to, own));
                assert!(mixed.at(x, y).into_iter().eq(truth), "{} at ({x}, {y})", case.label);
            }
        }
        assert_eq!([share(0), share(127), share(128), share(255)], [0, 127, 129, 256]);
    }
}
