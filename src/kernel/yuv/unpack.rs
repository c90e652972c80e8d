//! A block of one row as separate Y, Cb, Cr: chroma interpolated to every pixel, exactly, in sixteenths.
//!
//! A halved chroma row is blended with its neighbor row in quarters (weights from the siting), then across
//! in quarters again: 4·4 = sixteenths fit i16 (255·16 = 4080), so nothing is rounded before the matrix.

use super::{Samples, Siting};
use crate::pixels::{PlaneRef, Size};
use fearless_simd::prelude::*;

/// Pixels handled at a time; even, and a multiple of every vector length.
pub(super) const BLOCK: usize = 512;
/// Room for a block, one chroma pair on either side, and a vector's overhang.
const PADDED: usize = BLOCK + 128;

/// Where a block is unpacked to. On the stack of a band: nothing is allocated.
pub(super) struct Scratch {
    /// Luma as delivered.
    pub y: [u8; PADDED],
    /// Chroma minus 128, in sixteenths.
    pub cb: [i16; PADDED],
    /// Chroma minus 128, in sixteenths.
    pub cr: [i16; PADDED],
    /// Interleaved chroma on its way.
    pairs: [u8; PADDED],
    /// Halved chroma rows: Cb and Cr of the nearer and the farther chroma row.
    halves: [[u8; PADDED]; 4],
    /// One halved chroma row in quarters.
    quarters: [i16; PADDED],
}

/// The two chroma rows around a luma row: the first counts `4 - weight` quarters, the second `weight`.
#[derive(Clone, Copy)]
struct Rows {
    first: usize,
    second: usize,
    weight: i16,
}

impl Rows {
    /// Rows for luma row `y` when chroma row j lies `2j + half_rows/2` luma rows down, of `count`.
    fn new(y: usize, half_rows: usize, count: usize) -> Self {
        // position in quarter chroma rows, one row up so that it cannot be negative
        let at = 2 * y + 4 - half_rows;
        let (row, weight) = (at / 4, at % 4);
        Self { first: row.max(1) - 1, second: row.min(count - 1), weight: weight as i16 }
    }
}

impl Scratch {
    pub(super) fn new() -> Self {
        Self {
            y: [0; PADDED],
            cb: [0; PADDED],
            cr: [0; PADDED],
            pairs: [0; PADDED],
            halves: [[0; PADDED]; 4],
            quarters: [0; PADDED],
        }
    }

    /// No color.
    #[inline(always)]
    pub(super) fn gray(&mut self) {
        self.cb.fill(0);
        self.cr.fill(0);
    }

    /// Chroma of every pixel.
    #[inline(always)]
    pub(super) fn whole_chroma(&mut self, cb: &[u8], cr: &[u8]) {
        for (to, from) in self.cb.iter_mut().zip(cb) {
            *to = (i16::from(*from) - 128) * 16;
        }
        for (to, from) in self.cr.iter_mut().zip(cr) {
            *to = (i16::from(*from) - 128) * 16;
        }
    }

    /// Interleaved Y Cb Cr.
    #[inline(always)]
    pub(super) fn split_packed(&mut self, bytes: &[u8]) {
        let chroma = self.cb.iter_mut().zip(&mut self.cr);
        for ((from, y), (cb, cr)) in bytes.as_chunks::<3>().0.iter().zip(&mut self.y).zip(chroma) {
            *y = from[0];
            *cb = (i16::from(from[1]) - 128) * 16;
            *cr = (i16::from(from[2]) - 128) * 16;
        }
    }

    /// Unpacks `n` pixels from column `x` (even) of row `y` of a kind with halved chroma; returns where the
    /// block starts in `self.y`.
    #[inline(always)]
    pub(super) fn halved_chroma<S: Simd>(
        &mut self,
        simd: S,
        samples: &Samples<'_>,
        size: Size,
        x: usize,
        y: usize,
        n: usize,
    ) -> usize {
        let columns = size.width.div_ceil(2);
        let lines = size.height.div_ceil(2);
        let k = x / 2;
        // chroma columns to fetch: one more on either side where there is one
        let (from, to) = (k.max(1) - 1, (k + n.div_ceil(2) + 1).min(columns));
        let mut start = 0;
        let (on_column, rows) = match *samples {
            Samples::Yuyv(bytes) | Samples::Uyvy(bytes) => {
                let (y_out, c_out) = (&mut self.y, &mut self.pairs);
                let bytes = &bytes.row(y)[4 * from..4 * to];
                match samples {
                    Samples::Yuyv(_) => unzip(simd, bytes, y_out, c_out),
                    _ => unzip(simd, bytes, c_out, y_out),
                }
                start = x - 2 * from;
                let [cb, cr, ..] = &mut self.halves;
                unzip(simd, &self.pairs[..2 * (to - from)], cb, cr);
                (true, [Rows { first: y, second: y, weight: 0 }; 2])
            }
            Samples::Nv12(luma, chroma, siting) => {
                self.y[..n].copy_from_slice(&luma.row(y)[x..x + n]);
                let rows = siting.half_rows().map(|h| Rows::new(y, h, lines));
                let [cb, cr, far_cb, far_cr] = &mut self.halves;
                // both components share their rows here: PAL DV is never interleaved
                unzip(simd, &chroma.row(rows[0].first)[2 * from..2 * to], cb, cr);
                unzip(simd, &chroma.row(rows[0].second)[2 * from..2 * to], far_cb, far_cr);
                (siting.on_column(), [rows[0]; 2])
            }
            Samples::Planar420(planes, siting) => {
                self.y[..n].copy_from_slice(&planes[0].row(y)[x..x + n]);
                let rows = siting.half_rows().map(|h| Rows::new(y, h, lines));
                self.copy_halves(&planes, rows, from, to);
                (siting.on_column(), rows)
            }
            Samples::Planar422(planes) => {
                self.y[..n].copy_from_slice(&planes[0].row(y)[x..x + n]);
                let rows = [Rows { first: y, second: y, weight: 0 }; 2];
                self.copy_halves(&planes, rows, from, to);
                (Siting::Left.on_column(), rows)
            }
            _ => return 0,
        };
        let pairs = n.div_ceil(2);
        for (c, rows) in rows.into_iter().enumerate() {
            let lead = usize::from(k == 0);
            let (near, far) = (&self.halves[c][..to - from], &self.halves[c + 2][..to - from]);
            let quarters = &mut self.quarters[..pairs + 2];
            // weight 0 (4:2:2, or a row on the chroma row) leaves the far row out: it may hold anything
            let blended = quarters[lead..].iter_mut().zip(near.iter().zip(far));
            for (q, (a, b)) in blended {
                *q = i16::from(*a) * (4 - rows.weight) + i16::from(*b) * rows.weight;
            }
            if lead == 1 {
                quarters[0] = quarters[1];
            }
            // past the last chroma column, the last one repeats
            let have = lead + to - from;
            if have < pairs + 2 {
                let last = quarters[have - 1];
                quarters[have..].fill(last);
            }
            let out = if c == 0 { &mut self.cb } else { &mut self.cr };
            spread(simd, &self.quarters, pairs, on_column, out);
        }
        start
    }

    #[inline(always)]
    fn copy_halves(&mut self, planes: &[PlaneRef<'_, u8>; 3], rows: [Rows; 2], from: usize, to: usize) {
        for (c, rows) in rows.into_iter().enumerate() {
            let plane = &planes[c + 1];
            self.halves[c][..to - from].copy_from_slice(&plane.row(rows.first)[from..to]);
            self.halves[c + 2][..to - from].copy_from_slice(&plane.row(rows.second)[from..to]);
        }
    }
}

/// Interpolates across: `quarters[i]` is chroma column i - 1 of the block, `out` two pixels a column. Both
/// have a vector's room behind what counts.
#[inline(always)]
fn spread<S: Simd>(simd: S, quarters: &[i16], pairs: usize, on_column: bool, out: &mut [i16]) {
    let step = S::i16s::LEN;
    let mut i = 0;
    while i < pairs {
        let middle = S::i16s::from_slice(simd, &quarters[i + 1..i + 1 + step]);
        let right = S::i16s::from_slice(simd, &quarters[i + 2..i + 2 + step]);
        let (even, odd) = if on_column {
            (middle * 4, (middle + right) * 2)
        } else {
            let left = S::i16s::from_slice(simd, &quarters[i..i + step]);
            (left + middle * 3, middle * 3 + right)
        };
        let (first, second) = (even - 2048).interleave(odd - 2048);
        first.store_slice(&mut out[2 * i..2 * i + step]);
        second.store_slice(&mut out[2 * i + step..2 * i + 2 * step]);
        i += step;
    }
}

/// Parts interleaved bytes: even ones, odd ones.
#[inline(always)]
fn unzip<S: Simd>(simd: S, bytes: &[u8], even: &mut [u8], odd: &mut [u8]) {
    let (step, n) = (S::u8s::LEN, bytes.len() / 2);
    let mut i = 0;
    while i + step <= n {
        let a = S::u8s::from_slice(simd, &bytes[2 * i..2 * i + step]);
        let b = S::u8s::from_slice(simd, &bytes[2 * i + step..2 * i + 2 * step]);
        let (e, o) = a.deinterleave(b);
        e.store_slice(&mut even[i..i + step]);
        o.store_slice(&mut odd[i..i + step]);
        i += step;
    }
    for ((pair, e), o) in bytes[2 * i..].as_chunks::<2>().0.iter().zip(&mut even[i..]).zip(&mut odd[i..]) {
        [*e, *o] = *pair;
    }
}
