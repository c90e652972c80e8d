//! Camera color: packed and planar YUV, gray and interleaved RGB to a gray plane and planar RGB, and back to
//! YUV for clips.
//!
//! Comes in: the bytes a camera or clip delivers (`Samples`) and how they code color (`Coding`). Goes out:
//! full-range luma taken from Y as it is (so the tracker never waits for color) and gamma-coded RGB. Chroma
//! is interpolated bilinearly from its siting in exact sixteenths, the matrix is applied in f32; the result
//! differs from the f64 reference only where that lies within 1e-4 of a rounding tie, and then by one level.
//! Same bytes at every SIMD level and thread count.

mod encode;
pub mod reference;
mod unpack;

pub use encode::{from_rgb, luma_of_rgb};

use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, PlaneRef, Rgb, Size};
use fearless_simd::prelude::*;
use rayon::prelude::*;
use unpack::{BLOCK, Scratch};

/// Rows a worker takes at a time.
const BAND: usize = 16;

/// Which numbers stand for black and white.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Range {
    /// Y 16..235, chroma 16..240 around 128 (ITU-R BT.601).
    #[default]
    Limited,
    /// Y 0..255, chroma 128 ± 127.5 (JFIF).
    Full,
}

/// Which weights of red and blue make luma.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Matrix {
    /// Kr = .299, Kb = .114: cameras that say nothing, JPEG.
    #[default]
    Bt601,
    /// Kr = .2126, Kb = .0722.
    Bt709,
    /// Kr = .2627, Kb = .0593.
    Bt2020,
    /// Kr = .212, Kb = .087.
    Smpte240m,
}

impl Matrix {
    /// Luma weights of red and blue; green has the rest.
    pub const fn weights(self) -> (f64, f64) {
        match self {
            Matrix::Bt601 => (0.299, 0.114),
            Matrix::Bt709 => (0.2126, 0.0722),
            Matrix::Bt2020 => (0.2627, 0.0593),
            Matrix::Smpte240m => (0.212, 0.087),
        }
    }
}

/// How sample values mean color.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Coding {
    /// Luma weights.
    pub matrix: Matrix,
    /// Black and white levels.
    pub range: Range,
}

/// Where the chroma samples of 4:2:0 lie between the luma samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Siting {
    /// In the middle of four luma samples (JPEG, MPEG-1).
    #[default]
    Center,
    /// On the left luma column, between rows (MPEG-2).
    Left,
    /// On the left column; Cb on the upper row, Cr on the lower (PAL DV).
    PalDv,
}

impl Siting {
    /// Whether chroma lies on the even luma columns (else midway to the next).
    pub(crate) fn on_column(self) -> bool {
        self != Siting::Center
    }

    /// Distance of a chroma row from the upper of its two luma rows, in half rows, for Cb and Cr.
    pub(crate) fn half_rows(self) -> [usize; 2] {
        if self == Siting::PalDv { [0, 2] } else { [1, 1] }
    }
}

/// A picture's bytes. Views of interleaved kinds are as wide as the bytes of a row; subsampled planes have
/// ⌈n/2⌉ columns (and rows). 4:2:2 chroma lies on the even columns.
#[derive(Clone, Copy, Debug)]
pub enum Samples<'a> {
    /// Y0 Cb Y1 Cr: rows of 4·⌈width/2⌉ bytes.
    Yuyv(PlaneRef<'a, u8>),
    /// Cb Y0 Cr Y1: rows of 4·⌈width/2⌉ bytes.
    Uyvy(PlaneRef<'a, u8>),
    /// Y plane, then Cb Cr pairs: rows of 2·⌈width/2⌉ bytes, ⌈height/2⌉ rows.
    Nv12(PlaneRef<'a, u8>, PlaneRef<'a, u8>, Siting),
    /// Three planes, chroma halved both ways.
    Planar420([PlaneRef<'a, u8>; 3], Siting),
    /// Three planes, chroma halved across.
    Planar422([PlaneRef<'a, u8>; 3]),
    /// Three planes of one size.
    Planar444([PlaneRef<'a, u8>; 3]),
    /// Y Cb Cr: rows of 3·width bytes.
    Packed444(PlaneRef<'a, u8>),
    /// Y alone.
    Gray(PlaneRef<'a, u8>),
    /// R G B: rows of 3·width bytes. `Coding::matrix` does not matter.
    Rgb(PlaneRef<'a, u8>),
}

/// Converts a picture of `size` to full-range luma and RGB, resizing both to `size`.
///
/// Luma is Y stretched to 0..255 (RGB sources: (9798R + 19235G + 3735B + 16384) >> 15). RGB follows
/// `coding`; every value is rounded by floor(v + .5) after clamping. Panics when a view of `samples` is
/// smaller than `size` asks for. ITU-R BT.601, BT.709; JFIF 1.02.
pub fn to_rgb(
    level: Level,
    samples: &Samples<'_>,
    size: Size,
    coding: Coding,
    luma: &mut Plane<u8>,
    color: &mut Rgb,
) {
    luma.resize(size, 0);
    color.resize(size);
    let [red, green, blue] = &mut color.planes;
    let bands = red.view_mut().par_bands(BAND).zip(green.view_mut().par_bands(BAND));
    let bands = bands.zip(blue.view_mut().par_bands(BAND)).zip(luma.view_mut().par_bands(BAND));
    let terms = Terms::new(coding);
    bands.for_each(|((((first, mut red), (_, mut green)), (_, mut blue)), (_, mut luma))| {
        dispatch!(level, simd => {
            let mut scratch = Scratch::new();
            for y in 0..red.size().height {
                let out = [luma.row_mut(y), red.row_mut(y), green.row_mut(y), blue.row_mut(y)];
                row(simd, samples, size, first + y, &terms, &mut scratch, out);
            }
        });
    });
}

/// The matrix in the units of the inner loop: chroma in sixteenths around 0.
struct Terms {
    full: bool,
    /// Y to full range, rounding included: `scale·Y + offset`.
    scale: f32,
    offset: f32,
    red_cr: f32,
    green_cb: f32,
    green_cr: f32,
    blue_cb: f32,
}

impl Terms {
    fn new(coding: Coding) -> Self {
        let (kr, kb) = coding.matrix.weights();
        let kg = 1.0 - kr - kb;
        let (scale, chroma, black) = match coding.range {
            Range::Limited => (255.0 / 219.0, 255.0 / 224.0 / 16.0, 16.0),
            Range::Full => (1.0, 1.0 / 16.0, 0.0),
        };
        Self {
            full: coding.range == Range::Full,
            scale: scale as f32,
            offset: (0.5 - black * scale) as f32,
            red_cr: (2.0 * (1.0 - kr) * chroma) as f32,
            green_cb: (2.0 * (1.0 - kb) * kb / kg * chroma) as f32,
            green_cr: (2.0 * (1.0 - kr) * kr / kg * chroma) as f32,
            blue_cb: (2.0 * (1.0 - kb) * chroma) as f32,
        }
    }
}

/// One row; `out` is luma, red, green, blue.
#[inline(always)]
fn row<S: Simd>(
    simd: S,
    samples: &Samples<'_>,
    size: Size,
    y: usize,
    terms: &Terms,
    scratch: &mut Scratch,
    out: [&mut [u8]; 4],
) {
    let [luma, red, green, blue] = out;
    let mut x = 0;
    while x < size.width {
        let n = BLOCK.min(size.width - x);
        let to = x..x + n;
        let out = [&mut luma[to.clone()], &mut red[to.clone()], &mut green[to.clone()], &mut blue[to]];
        match samples {
            Samples::Rgb(bytes) => encode::split_rgb(&bytes.row(y)[3 * x..3 * (x + n)], terms.full, out),
            Samples::Gray(plane) => {
                scratch.y[..n].copy_from_slice(&plane.row(y)[x..x + n]);
                scratch.gray();
                color(simd, terms, scratch, 0, out);
            }
            Samples::Packed444(bytes) => {
                scratch.split_packed(&bytes.row(y)[3 * x..3 * (x + n)]);
                color(simd, terms, scratch, 0, out);
            }
            Samples::Planar444(planes) => {
                scratch.y[..n].copy_from_slice(&planes[0].row(y)[x..x + n]);
                scratch.whole_chroma(&planes[1].row(y)[x..x + n], &planes[2].row(y)[x..x + n]);
                color(simd, terms, scratch, 0, out);
            }
            _ => {
                let first = scratch.halved_chroma(simd, samples, size, x, y, n);
                color(simd, terms, scratch, first, out);
            }
        }
        x += n;
    }
}

/// Applies the matrix to a block; its luma starts at `scratch.y[first]`.
#[inline(always)]
fn color<S: Simd>(simd: S, terms: &Terms, scratch: &Scratch, first: usize, out: [&mut [u8]; 4]) {
    let [luma, red, green, blue] = out;
    let n = luma.len();
    if terms.full {
        luma.copy_from_slice(&scratch.y[first..first + n]);
    }
    let step = S::u8s::LEN;
    let mut x = 0;
    while x + step <= n {
        let [l, r, g, b] = vector(simd, terms, scratch, first, x);
        if !terms.full {
            l.store_slice(&mut luma[x..x + step]);
        }
        r.store_slice(&mut red[x..x + step]);
        g.store_slice(&mut green[x..x + step]);
        b.store_slice(&mut blue[x..x + step]);
        x += step;
    }
    if x < n {
        let [l, r, g, b] = vector(simd, terms, scratch, first, x);
        if !terms.full {
            luma[x..].copy_from_slice(&l.as_slice()[..n - x]);
        }
        red[x..].copy_from_slice(&r.as_slice()[..n - x]);
        green[x..].copy_from_slice(&g.as_slice()[..n - x]);
        blue[x..].copy_from_slice(&b.as_slice()[..n - x]);
    }
}

/// Luma, red, green and blue of one vector of pixels.
#[inline(always)]
fn vector<S: Simd>(simd: S, terms: &Terms, scratch: &Scratch, first: usize, x: usize) -> [S::u8s; 4] {
    let y = &scratch.y[first + x..first + x + S::u8s::LEN];
    let (y0, y1) = S::u8s::from_slice(simd, y).widen();
    let half = S::i16s::LEN;
    let (cb, cr) = (&scratch.cb[x..x + 2 * half], &scratch.cr[x..x + 2 * half]);
    let low = half_vector(simd, terms, y0, &cb[..half], &cr[..half]);
    let high = half_vector(simd, terms, y1, &cb[half..], &cr[half..]);
    [
        low[0].relaxed_narrow(high[0]),
        low[1].relaxed_narrow(high[1]),
        low[2].relaxed_narrow(high[2]),
        low[3].relaxed_narrow(high[3]),
    ]
}

#[inline(always)]
fn half_vector<S: Simd>(simd: S, terms: &Terms, y: S::u16s, cb: &[i16], cr: &[i16]) -> [S::u16s; 4] {
    let (y0, y1) = y.widen();
    let (cb0, cb1) = S::i16s::from_slice(simd, cb).widen();
    let (cr0, cr1) = S::i16s::from_slice(simd, cr).widen();
    let low = quarter_vector(simd, terms, y0, cb0, cr0);
    let high = quarter_vector(simd, terms, y1, cb1, cr1);
    [
        low[0].relaxed_narrow(high[0]),
        low[1].relaxed_narrow(high[1]),
        low[2].relaxed_narrow(high[2]),
        low[3].relaxed_narrow(high[3]),
    ]
}

#[inline(always)]
fn quarter_vector<S: Simd>(simd: S, terms: &Terms, y: S::u32s, cb: S::i32s, cr: S::i32s) -> [S::u32s; 4] {
    let y = S::f32s::float_from(y.bitcast::<S::i32s>()) * terms.scale + terms.offset;
    let (cb, cr) = (S::f32s::float_from(cb), S::f32s::float_from(cr));
    [
        to_level(simd, y),
        to_level(simd, y + cr * terms.red_cr),
        to_level(simd, y - (cb * terms.green_cb + cr * terms.green_cr)),
        to_level(simd, y + cb * terms.blue_cb),
    ]
}

/// Clamps to 0..255 and drops the fraction.
#[inline(always)]
fn to_level<S: Simd>(simd: S, v: S::f32s) -> S::u32s {
    let (zero, top) = (S::f32s::splat(simd, 0.0), S::f32s::splat(simd, 255.0));
    S::i32s::truncate_from(v.max(zero).min(top)).bitcast()
}

#[cfg(test)]
mod tests;
