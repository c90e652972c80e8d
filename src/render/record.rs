//! What is kept of a triangle that may cover pixel centers, for the tiles to draw.

use super::sort::LITTLE;

/// No record.
pub(super) const NONE: u32 = u32::MAX;

/// What a record's triangle is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Extent {
    /// Less than 64 px across.
    Small,
    /// Not known to be small.
    Large,
    /// A piece of one: its corners are the chunk's own vertices, made by cutting.
    Piece,
}

/// Pixels from a first to a last column and row, inclusive.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Bounds {
    /// Left, and 16 bits higher top; none is below 0 or above `i16::MAX`.
    pub low: i32,
    /// Right and bottom likewise.
    pub high: i32,
}

impl Bounds {
    pub fn new([left, top, right, bottom]: [i32; 4]) -> Self {
        Self { low: left | top << 16, high: right | bottom << 16 }
    }

    /// Left, top, right, bottom.
    #[inline(always)]
    pub fn sides(self) -> [i32; 4] {
        [self.low & 0xffff, self.low >> 16, self.high & 0xffff, self.high >> 16]
    }
}

/// A triangle that may cover pixel centers.
#[derive(Clone, Copy, Debug)]
pub(super) struct Record {
    /// Its corners: vertices of the mesh, or the chunk's own. Wound so that the snapped area is positive with y
    /// down.
    pub corners: [u32; 3],
    /// Index into the frame's surfaces.
    pub surface: u32,
    /// Intensity of a flat face; below 0 where intensity is interpolated.
    pub face: f32,
    /// Pixels whose centers it may cover; within the tile unless it is over many.
    pub bounds: Bounds,
    /// The centers it covers of the four by four from left and top on, row by row; 0 where they are not known.
    pub cover: u16,
    pub extent: Extent,
    /// The next record of the same tile.
    pub next: u32,
}

impl Record {
    /// Nothing.
    pub const NONE: Record = Record {
        corners: [0; 3],
        surface: 0,
        face: -1.0,
        bounds: Bounds { low: 0, high: 0 },
        cover: 0,
        extent: Extent::Small,
        next: NONE,
    };

    /// What of it is inside these pixels: left, top, right, bottom.
    pub fn cut(mut self, [x0, y0, x1, y1]: [i32; 4]) -> Self {
        let [left, top, right, bottom] = self.bounds.sides();
        let [first, above, last, below] = [left.max(x0), top.max(y0), right.min(x1), bottom.min(y1)];
        self.bounds = Bounds::new([first, above, last, below]);
        if self.cover != 0 {
            let before = first - left;
            // columns before the first leave their rows, those after the last are none
            let columns = (0xf_u16 >> before).min(0xf >> (LITTLE - 1 - (last - first)));
            let rows = 0xffff >> (LITTLE * (LITTLE - 1 - (below - above)));
            self.cover >>= LITTLE * (above - top) + before;
            self.cover &= (columns * 0x1111) & rows;
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pixels::SplitMix64;

    #[test]
    fn parts_of_a_record_cover_its_pixels_once() {
        let mut rng = SplitMix64::new(9);
        let mut cut = 0;
        for _ in 0..2000 {
            let mut any = |low, high| rng.int(low, high) as i32;
            let (x, y, wide, high) = (any(58, 66), any(58, 66), any(0, 3), any(0, 3));
            let mut record = Record { bounds: Bounds::new([x, y, x + wide, y + high]), ..Record::NONE };
            let pixels = |of: &Record| -> Vec<[i32; 2]> {
                let [left, top, ..] = of.bounds.sides();
                let at = |k: i32| [left + k % 4, top + k / 4];
                (0..16).filter(|k| of.cover >> k & 1 == 1).map(at).collect()
            };
            for k in 0..16 {
                let inside = k % 4 <= wide && k / 4 <= high;
                record.cover |= u16::from(inside && any(0, 1) == 1) << k;
            }
            let mut parts = Vec::new();
            for (left, top) in [(0, 0), (64, 0), (0, 64), (64, 64)] {
                let tile = [left, top, left + 63, top + 63];
                if x > tile[2] || x + wide < left || y > tile[3] || y + high < top {
                    continue;
                }
                let part = pixels(&record.cut(tile));
                assert!(
                    part.iter().all(|p| (left..=tile[2]).contains(&p[0]) && (top..=tile[3]).contains(&p[1]))
                );
                cut += usize::from(!part.is_empty());
                parts.extend(part);
            }
            parts.sort_by_key(|&[x, y]| (y, x));
            assert_eq!(parts, pixels(&record), "{record:?}");
        }
        assert!(cut > 2200, "{cut}");
    }
}
