//! What a screen shows: the canvas placed on a mode, packed as XRGB8888, and a hash of it.
//!
//! All arithmetic is on integers, so that every machine composes the same bytes. Rows are worked on in
//! parallel bands; buffers are kept from picture to picture.

use super::{Filter, Layout, Scale};
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Rgb, Size, simd};
use fearless_simd::Simd;
use rayon::prelude::*;

/// Rows per task: small enough for two cores to share 480 rows evenly.
const BAND: usize = 32;

/// A picture in the display's format: XRGB8888, little-endian, in memory blue, green, red, 0. No row padding.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Xrgb {
    bytes: Vec<u8>,
    size: Size,
}

impl Xrgb {
    /// A black picture.
    pub fn new(size: Size) -> Self {
        Self { bytes: vec![0; size.area() * 4], size }
    }

    /// Width and height.
    pub fn size(&self) -> Size {
        self.size
    }

    /// Rows from the top, four bytes a pixel.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = &[u8]> {
        self.bytes.chunks_exact((self.size.width * 4).max(1))
    }

    /// Red, green, blue at column `x`, row `y`. Panics outside.
    pub fn at(&self, x: usize, y: usize) -> [u8; 3] {
        let at = (y * self.size.width + x) * 4;
        [self.bytes[at + 2], self.bytes[at + 1], self.bytes[at]]
    }

    /// The picture's hash; see [`Hash`].
    pub fn hash(&self) -> u64 {
        let mut hash = Hash::new(self.size);
        self.rows().for_each(|row| hash.row(row));
        hash.finish()
    }
}

/// A 64-bit hash of a screen's pixels: FNV-1a over 32-bit words instead of bytes. The words are width, height,
/// then every pixel from the top left by rows as `red << 16 | green << 8 | blue` (the X byte counts as 0);
/// `hash = (hash ^ word) * 0x100000001b3`, starting from `0xcbf29ce484222325`, all modulo 2⁶⁴.
pub(super) struct Hash(u64);

impl Hash {
    pub(super) fn new(size: Size) -> Self {
        let mut hash = Self(0xcbf2_9ce4_8422_2325);
        hash.word(size.width as u32);
        hash.word(size.height as u32);
        hash
    }

    /// One row of XRGB8888 pixels.
    pub(super) fn row(&mut self, row: &[u8]) {
        row.as_chunks().0.iter().for_each(|&pixel| self.word(u32::from_le_bytes(pixel) & 0x00ff_ffff));
    }

    fn word(&mut self, word: u32) {
        self.0 = (self.0 ^ u64::from(word)).wrapping_mul(0x0100_0000_01b3);
    }

    pub(super) fn finish(self) -> u64 {
        self.0
    }
}

/// What a screen of `mode` pixels shows of `canvas`: the same bytes that a KMS sink of these settings shows.
pub fn compose(canvas: &Rgb, mode: Size, layout: impl Into<Layout>) -> Xrgb {
    let mut composer = Composer::new(mode, layout);
    composer.compose(canvas);
    composer.image
}

/// Places canvases on a screen; keeps its buffers and tables while the canvas keeps its size.
#[derive(Debug)]
pub struct Composer {
    layout: Layout,
    level: Level,
    image: Xrgb,
    /// The canvas turned, where it is.
    turned: Rgb,
    /// What the tables below were made for.
    canvas: Option<Size>,
    place: Place,
    columns: Vec<Tap>,
    rows: Vec<Tap>,
    /// Per band three rows of the canvas, blended between two rows: 8.8 fixed point.
    blended: Vec<u16>,
}

impl Composer {
    /// For a screen of `mode` pixels.
    pub fn new(mode: Size, layout: impl Into<Layout>) -> Self {
        Self {
            layout: layout.into(),
            level: simd::best(),
            image: Xrgb::new(mode),
            turned: Rgb::default(),
            canvas: None,
            place: Place::default(),
            columns: Vec::new(),
            rows: Vec::new(),
            blended: Vec::new(),
        }
    }

    /// The same on another SIMD level: for tests.
    pub fn at_level(self, level: Level) -> Self {
        Self { level, ..self }
    }

    /// Composes one canvas; allocates only when the canvas's size changes.
    pub fn compose(&mut self, canvas: &Rgb) -> &Xrgb {
        if self.layout.turns() {
            let mut turned = std::mem::take(&mut self.turned);
            self.layout.turn(canvas, &mut turned);
            self.place(&turned);
            self.turned = turned;
        } else {
            self.place(canvas);
        }
        &self.image
    }

    /// Places a canvas that is turned as it is to be shown.
    fn place(&mut self, canvas: &Rgb) {
        if self.canvas != Some(canvas.size()) {
            self.lay_out(canvas.size());
        }
        let place = self.place;
        if place.shown.area() == 0 {
            return;
        }
        let pitch = self.image.size.width * 4;
        let inside = place.left * 4..(place.left + place.shown.width) * 4;
        // the right eye's picture is the left one's, so many bytes further
        let other = self.layout.stereo.then_some(self.layout.eye(self.image.size).width * 4);
        let used = &mut self.image.bytes[place.top * pitch..][..place.shown.height * pitch];
        let bands = used.par_chunks_mut(BAND * pitch).enumerate();
        let (columns, rows) = (&self.columns[..], &self.rows[..]);
        let straight = columns.is_empty();
        let scratch = 3 * canvas.size().width.max(1);
        // pixel for pixel needs no scratch, yet the zip wants as many chunks as bands
        let blended = self.blended.par_chunks_mut(if straight { 1 } else { scratch });
        let (layout, level) = (self.layout, self.level);
        bands.zip(blended).for_each(|((band, bytes), blended)| {
            let outs = bytes.chunks_exact_mut(pitch).enumerate();
            let outs = outs.map(|(row, out)| (band * BAND + row, &mut out[inside.clone()]));
            if straight {
                dispatch!(level, simd => pack_band(simd, canvas, place, outs));
            } else if layout.filter == Filter::Nearest {
                nearest_band(canvas, columns, rows, outs);
            } else {
                dispatch!(level, simd => bilinear_band(simd, canvas, columns, rows, blended, outs));
            }
            if let Some(other) = other {
                for row in bytes.chunks_exact_mut(pitch) {
                    row.copy_within(inside.clone(), inside.start + other);
                }
            }
        });
    }

    fn lay_out(&mut self, canvas: Size) {
        self.canvas = Some(canvas);
        self.image.bytes.fill(0);
        self.place = Place::new(canvas, self.layout.eye(self.image.size), self.layout.scale);
        let shown = self.place.shown;
        let bands = shown.height.div_ceil(BAND);
        self.columns.clear();
        self.rows.clear();
        self.blended.clear();
        if self.layout.scale == Scale::OneToOne || shown == canvas {
            self.blended.resize(bands, 0);
        } else {
            let tap = match self.layout.filter {
                Filter::Nearest => Tap::nearest,
                Filter::Bilinear => Tap::bilinear,
            };
            self.columns.extend((0..shown.width).map(|o| tap(o, canvas.width, shown.width)));
            self.rows.extend((0..shown.height).map(|o| tap(o, canvas.height, shown.height)));
            self.blended.resize(bands * 3 * canvas.width, 0);
        }
    }
}

/// Where the canvas lies on the screen.
#[derive(Clone, Copy, Debug)]
struct Place {
    /// First column and row of the screen that show the canvas.
    left: usize,
    top: usize,
    /// First column and row of the canvas that are shown (pixel for pixel only).
    skip_x: usize,
    skip_y: usize,
    /// The area covered on the screen.
    shown: Size,
}

impl Default for Place {
    fn default() -> Self {
        Self { left: 0, top: 0, skip_x: 0, skip_y: 0, shown: Size::new(0, 0) }
    }
}

impl Place {
    fn new(canvas: Size, mode: Size, scale: Scale) -> Self {
        if canvas.area() == 0 || mode.area() == 0 {
            return Self::default();
        }
        let shown = match scale {
            Scale::OneToOne => Size::new(canvas.width.min(mode.width), canvas.height.min(mode.height)),
            // the side that fills the screen is exact, the other is rounded to the nearest pixel
            Scale::Fit if mode.width * canvas.height <= mode.height * canvas.width => {
                let height = (2 * canvas.height * mode.width + canvas.width) / (2 * canvas.width);
                Size::new(mode.width, height.clamp(1, mode.height))
            }
            Scale::Fit => {
                let width = (2 * canvas.width * mode.height + canvas.height) / (2 * canvas.height);
                Size::new(width.clamp(1, mode.width), mode.height)
            }
        };
        Self {
            left: (mode.width - shown.width) / 2,
            top: (mode.height - shown.height) / 2,
            skip_x: canvas.width.saturating_sub(mode.width) / 2,
            skip_y: canvas.height.saturating_sub(mode.height) / 2,
            shown,
        }
    }
}

/// Two neighbors in the canvas and the weight of the second, in 1/256.
#[derive(Clone, Copy, Debug)]
struct Tap {
    first: u32,
    second: u32,
    weight: u16,
}

impl Tap {
    /// The canvas sample that holds the center of output sample `o`: floor((o + .5) · input / output).
    fn nearest(o: usize, input: usize, output: usize) -> Self {
        let at = ((2 * o + 1) * input / (2 * output)) as u32;
        Self { first: at, second: at, weight: 0 }
    }

    /// Centers aligned, clamped to the border: position (o + .5) · input / output - .5, in 1/256 rounded to
    /// nearest.
    fn bilinear(o: usize, input: usize, output: usize) -> Self {
        let position = ((2 * o + 1) * input * 256 + output) / (2 * output);
        let position = position.saturating_sub(128).min((input - 1) * 256);
        let first = position / 256;
        let second = (first + 1).min(input - 1);
        Self { first: first as u32, second: second as u32, weight: (position % 256) as u16 }
    }

    /// The 8-bit value between two samples in 8.8 fixed point.
    #[inline(always)]
    fn of(self, line: &[u16]) -> u8 {
        let (a, b) = (u32::from(line[self.first as usize]), u32::from(line[self.second as usize]));
        let weight = u32::from(self.weight);
        ((a * (256 - weight) + b * weight + (1 << 15)) >> 16) as u8
    }
}

#[inline(always)]
fn pack_band<'a, S: Simd>(
    simd: S,
    canvas: &Rgb,
    place: Place,
    outs: impl Iterator<Item = (usize, &'a mut [u8])>,
) {
    simd.vectorize(
        #[inline(always)]
        || {
            for (row, out) in outs {
                let [r, g, b] = [0, 1, 2].map(|c| &canvas.planes[c].row(place.skip_y + row)[place.skip_x..]);
                for (((out, &r), &g), &b) in out.as_chunks_mut().0.iter_mut().zip(r).zip(g).zip(b) {
                    *out = pixel(r, g, b);
                }
            }
        },
    );
}

#[inline(always)]
fn pixel(r: u8, g: u8, b: u8) -> [u8; 4] {
    (u32::from(r) << 16 | u32::from(g) << 8 | u32::from(b)).to_le_bytes()
}

fn nearest_band<'a>(
    canvas: &Rgb,
    columns: &[Tap],
    rows: &[Tap],
    outs: impl Iterator<Item = (usize, &'a mut [u8])>,
) {
    for (row, out) in outs {
        let [r, g, b] = [0, 1, 2].map(|c| canvas.planes[c].row(rows[row].first as usize));
        for (out, tap) in out.as_chunks_mut().0.iter_mut().zip(columns) {
            let x = tap.first as usize;
            *out = pixel(r[x], g[x], b[x]);
        }
    }
}

/// Rows are blended first (whole rows, in lanes), then columns are gathered. 255 · 256 fits 16 bits; weights
/// in 1/256 move a value by at most 255/512 in each direction before the one rounding at the end.
#[inline(always)]
fn bilinear_band<'a, S: Simd>(
    simd: S,
    canvas: &Rgb,
    columns: &[Tap],
    rows: &[Tap],
    blended: &mut [u16],
    outs: impl Iterator<Item = (usize, &'a mut [u8])>,
) {
    let width = canvas.size().width;
    simd.vectorize(
        #[inline(always)]
        || {
            for (row, out) in outs {
                let tap = rows[row];
                for (c, blended) in blended.chunks_exact_mut(width).enumerate() {
                    let first = canvas.planes[c].row(tap.first as usize);
                    let second = canvas.planes[c].row(tap.second as usize);
                    for ((blended, &a), &b) in blended.iter_mut().zip(first).zip(second) {
                        *blended = u16::from(a) * (256 - tap.weight) + u16::from(b) * tap.weight;
                    }
                }
                let (r, rest) = blended.split_at(width);
                let (g, b) = rest.split_at(width);
                for (out, tap) in out.as_chunks_mut().0.iter_mut().zip(columns) {
                    *out = pixel(tap.of(r), tap.of(g), tap.of(b));
                }
            }
        },
    );
}
