//! Gray picture → quadrilaterals that may be markers.
//!
//! Comes in: a luma plane, whole or halved; goes out: quads in the whole picture's ideal pixels, largest first.
//! The way through: `threshold` → `segment` → `contour` → `quad`.

use super::contour::{self, Crack};
use super::quad::{self, Quad, Refusal};
use super::rectify::Rectify;
use super::segment::{Blob, Segment};
use super::threshold::Threshold;
use crate::pixels::simd::{Level, dispatch};
use crate::pixels::{Plane, PlaneRef, Size};
use fearless_simd::{Simd, prelude::*, u8x32, u16x16};
use glam::DVec2;
use rayon::prelude::*;

/// A contour that may be a marker's.
#[derive(Clone, Copy, Debug)]
struct Outline {
    from: usize,
    to: usize,
    area: i64,
    /// Whether it leads inside: a border that blur has opened.
    open: bool,
    /// Whether its hull is tried as well.
    small: bool,
    found: Option<Found>,
}

/// A quad of the picture.
#[derive(Clone, Copy, Debug)]
pub struct Found {
    /// In the whole picture's ideal pixels.
    pub quad: Quad,
    /// Whether it is the hull's around an outline that is none.
    pub hull: bool,
}

/// The search with its buffers.
#[derive(Debug, Default)]
pub struct Search {
    threshold: Threshold,
    segment: Segment,
    order: Vec<u32>,
    contours: Vec<Crack>,
    outlines: Vec<Outline>,
    quads: Vec<Found>,
    /// Area of the largest picture that there is room for.
    roomy: usize,
}

/// What a search looks for.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Least longer side of a blob, px of the searched picture.
    pub least_side_px: u32,
    /// Least gray range of a neighborhood that can hold an edge.
    pub least_contrast: u8,
    /// Most outlines that are followed.
    pub most: usize,
    /// Whether blobs that enclose nothing light are followed as well: pictures, and prints all blurred.
    pub solid: bool,
    /// Pixels of the whole picture along one of the searched picture's: 1 or 2.
    pub step: u32,
    /// Where the searched picture begins in the whole one, px.
    pub origin: DVec2,
}

impl Search {
    /// Room for a picture full of things, so that a fuller one seldom asks for more.
    fn reserve(&mut self, size: Size, most: usize) {
        if size.area() <= self.roomy {
            return;
        }
        self.roomy = size.area();
        self.segment.reserve(size);
        let room = size.area() / CRACKS_PER_PIXEL;
        self.contours.clear();
        self.contours.reserve(room);
        self.outlines.clear();
        self.outlines.reserve(most);
        self.quads.clear();
        self.quads.reserve(most);
        self.order.clear();
        self.order.reserve(room / 8);
    }

    /// The quads of a picture, but those whose box (least and greatest corner, px of the whole picture) is
    /// known already. Allocates only when a picture is larger or fuller than any before.
    pub fn quads(
        &mut self,
        luma: PlaneRef<'_, u8>,
        rectify: &Rectify,
        limits: Limits,
        known: &[[DVec2; 2]],
        level: Level,
    ) -> &[Found] {
        self.reserve(luma.size(), limits.most);
        self.threshold.apply(luma, limits.least_contrast, level);
        let mask = self.threshold.mask();
        let blobs = self.segment.blobs(mask, limits.least_side_px);
        self.order.clear();
        self.order.extend(0..blobs.len() as u32);
        let size = |i: &u32| blobs[*i as usize].extent().iter().sum::<u32>();
        self.order.sort_unstable_by_key(|i| (std::cmp::Reverse(size(i)), *i));
        self.order.truncate(limits.most);
        self.contours.clear();
        self.outlines.clear();
        for &i in &self.order {
            let blob = &blobs[i as usize];
            if known.iter().any(|known| covers(known, blob, limits)) {
                continue;
            }
            let from = self.contours.len();
            let Some((area, open)) = contour::trace(mask, blob, &mut self.contours) else { continue };
            let [w, h] = blob.extent().map(i64::from);
            // the thinnest view of a square still fills this much of its box, and in a code something is light
            let solid = !open && i64::from(blob.area) >= area;
            if 6 * area < w * h || (solid && !limits.solid) {
                self.contours.truncate(from);
                continue;
            }
            let (longer, step) = (w.max(h), i64::from(limits.step));
            let small = longer <= i64::from(contour::MOST_OPEN_PX) && longer * step >= LEAST_HULL_PX;
            self.outlines.push(Outline { from, to: self.contours.len(), area, open, small, found: None });
        }
        let contours = &self.contours;
        self.outlines.par_iter_mut().with_min_len(8).for_each(|outline| {
            let contour = &contours[outline.from..outline.to];
            let plain = if outline.open {
                Err(Refusal::Bumpy)
            } else {
                quad::fit(contour, outline.area, limits.step, limits.origin, rectify)
            };
            outline.found = match plain {
                Ok(quad) => Some(Found { quad, hull: false }),
                Err(Refusal::Bumpy) if outline.small => {
                    let hull = quad::fit_hull(contour, limits.step, limits.origin, rectify);
                    hull.map(|quad| Found { quad, hull: true })
                }
                Err(_) => None,
            };
        });
        self.quads.clear();
        self.quads.extend(self.outlines.iter().filter_map(|o| o.found));
        &self.quads
    }
}

/// Smaller prints are not read through much blur, px of the whole picture.
const LEAST_HULL_PX: i64 = 14;

/// Cracks that have room, for every pixel of the picture: contours of a picture full of things.
const CRACKS_PER_PIXEL: usize = 8;

/// Whether the blob is, by its box, the border of a marker already read.
fn covers(known: &[DVec2; 2], blob: &Blob, limits: Limits) -> bool {
    let step = f64::from(limits.step);
    let mut apart = 0.0f64;
    let [low, high] = known;
    for axis in 0..=1 {
        let low_blob = limits.origin[axis] + (f64::from(blob.low[axis]) - 0.5) * step;
        let high_blob = limits.origin[axis] + (f64::from(blob.high[axis]) + 0.5) * step;
        apart = apart.max((low[axis] - low_blob).abs()).max((high[axis] - high_blob).abs());
    }
    apart < 3.0
}

/// The mean of every 2x2 pixels, rounded; a last odd row or column is left out.
pub fn halve(luma: PlaneRef<'_, u8>, half: &mut Plane<u8>, level: Level) {
    let size = Size::new(luma.size().width / 2, luma.size().height / 2);
    half.resize(size, 0);
    half.view_mut().par_bands(BAND).for_each(|(top, mut band)| {
        for y in 0..band.size().height {
            let (above, below) = (luma.row(2 * (top + y)), luma.row(2 * (top + y) + 1));
            let out = band.row_mut(y);
            dispatch!(level, simd => mean(simd, above, below, out));
        }
    });
}

/// The negative of a picture.
pub fn invert(luma: PlaneRef<'_, u8>, inverse: &mut Plane<u8>) {
    inverse.resize(luma.size(), 0);
    for y in 0..luma.size().height {
        for (out, gray) in inverse.row_mut(y).iter_mut().zip(luma.row(y)) {
            *out = 255 - gray;
        }
    }
}

/// Rows of a halved picture that a task takes.
const BAND: usize = 64;

/// Means made at once.
const RUN: usize = 32;

#[inline(always)]
fn mean<S: Simd>(simd: S, above: &[u8], below: &[u8], out: &mut [u8]) {
    let mut runs = out.chunks_exact_mut(RUN);
    for (i, out) in (&mut runs).enumerate() {
        let low = half(simd, above, below, 2 * i * RUN);
        low.relaxed_narrow(half(simd, above, below, (2 * i + 1) * RUN)).store_slice(out);
    }
    let rest = runs.into_remainder();
    let from = 2 * (above.len() / 2 - rest.len());
    let pairs = above[from..].as_chunks::<2>().0.iter().zip(below[from..].as_chunks::<2>().0);
    for (out, (a, b)) in rest.iter_mut().zip(pairs) {
        let sum = u16::from(a[0]) + u16::from(a[1]) + u16::from(b[0]) + u16::from(b[1]);
        *out = ((sum + 2) >> 2) as u8;
    }
}

/// Means of 2x2 pixels from `at` on.
#[inline(always)]
fn half<S: Simd>(simd: S, above: &[u8], below: &[u8], at: usize) -> u16x16<S> {
    (pairs(simd, above, at) + pairs(simd, below, at) + 2) >> 2
}

/// Sums of neighbors two by two, 32 pixels from `at` on.
#[inline(always)]
pub fn pairs<S: Simd>(simd: S, row: &[u8], at: usize) -> u16x16<S> {
    let gray: u16x16<S> = u8x32::from_slice(simd, &row[at..at + 32]).bitcast();
    (gray & 0xff) + (gray >> 8)
}
