//! Interleaved RGB bytes (as decoders and displays keep them) to planes and back.

use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Rgb, Size};
use fearless_simd::{Simd, SimdBase, u8x16};
use rayon::prelude::*;

/// Splits rows of R, G, B bytes into `picture`, which is fitted to `size`. `bytes` holds `3 * size.area()`
/// bytes; nothing happens when it is shorter.
pub fn split(level: Level, bytes: &[u8], size: Size, picture: &mut Rgb) {
    picture.resize(size);
    if bytes.len() < 3 * size.area() || size.area() == 0 {
        return;
    }
    let rows = super::band_rows(size.height, 8);
    let [r, g, b] = &mut picture.planes;
    let bands = r.view_mut().par_bands(rows).zip(g.view_mut().par_bands(rows));
    bands.zip(b.view_mut().par_bands(rows)).for_each(|(((first, mut r), (_, mut g)), (_, mut b))| {
        for y in 0..r.size().height {
            let from = &bytes[(first + y) * size.width * 3..][..size.width * 3];
            let (r, g, b) = (r.row_mut(y), g.row_mut(y), b.row_mut(y));
            dispatch!(level, simd => split_row(simd, from, r, g, b));
        }
    });
}

#[inline(always)]
fn split_row<S: Simd>(simd: S, from: &[u8], r: &mut [u8], g: &mut [u8], b: &mut [u8]) {
    let [red, green, blue] =
        [Gather::new(simd, &PICKS[0]), Gather::new(simd, &PICKS[1]), Gather::new(simd, &PICKS[2])];
    let whole = r.len() / LANES;
    let blocks = from.as_chunks::<{ 3 * LANES }>().0.iter().zip(r.as_chunks_mut::<LANES>().0);
    let blocks = blocks.zip(g.as_chunks_mut::<LANES>().0).zip(b.as_chunks_mut::<LANES>().0);
    for (((from, r), g), b) in blocks {
        let x = u8x16::from_slice(simd, &from[..LANES]);
        let y = u8x16::from_slice(simd, &from[LANES..2 * LANES]);
        let z = u8x16::from_slice(simd, &from[2 * LANES..]);
        red.of(simd, x, y, z).store_slice(r);
        green.of(simd, x, y, z).store_slice(g);
        blue.of(simd, x, y, z).store_slice(b);
    }
    let rest = from.as_chunks::<3>().0.iter().zip(r).zip(g).zip(b).skip(LANES * whole);
    for (((from, r), g), b) in rest {
        [*r, *g, *b] = *from;
    }
}

/// Joins `picture` into rows of R, G, B bytes. `bytes` holds `3 * area` bytes; nothing happens when it is
/// shorter.
pub fn join(level: Level, picture: &Rgb, bytes: &mut [u8]) {
    let size = picture.size();
    if bytes.len() < 3 * size.area() || size.area() == 0 {
        return;
    }
    let rows = super::band_rows(size.height, 8);
    bytes[..3 * size.area()].par_chunks_mut(3 * size.width * rows).enumerate().for_each(|(band, bytes)| {
        for (y, to) in bytes.chunks_mut(3 * size.width).enumerate() {
            let [r, g, b] = [0, 1, 2].map(|c| picture.planes[c].row(band * rows + y));
            dispatch!(level, simd => join_row(simd, r, g, b, to));
        }
    });
}

#[inline(always)]
fn join_row<S: Simd>(simd: S, r: &[u8], g: &[u8], b: &[u8], to: &mut [u8]) {
    let [first, second, third] =
        [Gather::new(simd, &PLACES[0]), Gather::new(simd, &PLACES[1]), Gather::new(simd, &PLACES[2])];
    let whole = r.len() / LANES;
    let blocks = to.as_chunks_mut::<{ 3 * LANES }>().0.iter_mut().zip(r.as_chunks::<LANES>().0);
    for (((to, r), g), b) in blocks.zip(g.as_chunks::<LANES>().0).zip(b.as_chunks::<LANES>().0) {
        let r = u8x16::from_slice(simd, r);
        let g = u8x16::from_slice(simd, g);
        let b = u8x16::from_slice(simd, b);
        first.of(simd, r, g, b).store_slice(&mut to[..LANES]);
        second.of(simd, r, g, b).store_slice(&mut to[LANES..2 * LANES]);
        third.of(simd, r, g, b).store_slice(&mut to[2 * LANES..]);
    }
    let rest = to.as_chunks_mut::<3>().0.iter_mut().zip(r).zip(g).zip(b).skip(LANES * whole);
    for (((to, &r), &g), &b) in rest {
        *to = [r, g, b];
    }
}

/// Where each byte of a vector comes from, of three vectors.
struct Gather<S: Simd> {
    x: u8x16<S>,
    y: u8x16<S>,
    z: u8x16<S>,
}

impl<S: Simd> Gather<S> {
    #[inline(always)]
    fn new(simd: S, [x, y, z]: &[[u8; LANES]; 3]) -> Self {
        Self { x: u8x16::from_slice(simd, x), y: u8x16::from_slice(simd, y), z: u8x16::from_slice(simd, z) }
    }

    #[inline(always)]
    fn of(&self, simd: S, x: u8x16<S>, y: u8x16<S>, z: u8x16<S>) -> u8x16<S> {
        let xy = simd.swizzle_dyn_precise_u8x16(x, self.x) | simd.swizzle_dyn_precise_u8x16(y, self.y);
        xy | simd.swizzle_dyn_precise_u8x16(z, self.z)
    }
}

/// Pixels that are moved at a time: 48 bytes, three vectors.
const LANES: usize = 16;
/// An index that picks nothing: the lane becomes 0.
const NONE: u8 = 255;

/// Of channel c and part p of 48 interleaved bytes: which byte of the part each pixel's channel is.
const PICKS: [[[u8; LANES]; 3]; 3] = {
    let mut picks = [[[NONE; LANES]; 3]; 3];
    let mut byte = 0;
    while byte < 3 * LANES {
        picks[byte % 3][byte / LANES][byte / 3] = (byte % LANES) as u8;
        byte += 1;
    }
    picks
};

/// Of part p and channel c: which pixel's channel each interleaved byte is.
const PLACES: [[[u8; LANES]; 3]; 3] = {
    let mut places = [[[NONE; LANES]; 3]; 3];
    let mut byte = 0;
    while byte < 3 * LANES {
        places[byte / LANES][byte % 3][byte % LANES] = (byte / 3) as u8;
        byte += 1;
    }
    places
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::sweep;
    use crate::pixels::Plane;

    #[test]
    fn there_and_back_is_exact() {
        for case in sweep::cases() {
            let size = case.plane.size();
            let turned = Plane::from_fn(size, |x, y| case.plane.at(size.width - 1 - x, y));
            let picture = Rgb { planes: [case.plane.clone(), turned, case.plane] };
            let bytes = sweep::everywhere(&case.label, |level| {
                let mut bytes = vec![0; size.area() * 3];
                join(level, &picture, &mut bytes);
                bytes
            });
            for i in 0..size.area() {
                let color = picture.at(i % size.width, i / size.width);
                assert_eq!(bytes[3 * i..3 * i + 3], color, "{}: pixel {i}", case.label);
            }
            let back = sweep::everywhere(&case.label, |level| {
                let mut back = Rgb::default();
                split(level, &bytes, size, &mut back);
                back
            });
            assert_eq!(back, picture, "{}", case.label);
        }
    }
}
