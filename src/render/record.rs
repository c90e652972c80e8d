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
    /// Pixels whose centers it may cover: x0, y0, x1, y1, all inclusive; within the tile unless it is over many.
    pub bounds: [i16; 4],
    /// The centers it covers of the four by four from x0, y0 on, row by row; 0 where they are not known.
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
        bounds: [0; 4],
        cover: 0,
        extent: Extent::Small,
        next: NONE,
    };

    /// What of it is inside these pixels.
    pub fn cut(mut self, [x0, y0, x1, y1]: [i16; 4]) -> Self {
        let [left, top, right, bottom] = self.bounds;
        self.bounds = [left.max(x0), top.max(y0), right.min(x1), bottom.min(y1)];
        if self.cover != 0 {
            let side = LITTLE as i16;
            let before = self.bounds[0] - left;
            // columns before the first leave their rows, those after the last are none
            let columns = (0xf_u16 >> before).min(0xf >> (side - 1 - (self.bounds[2] - self.bounds[0])));
            let rows = 0xffff >> (side * (side - 1 - (self.bounds[3] - self.bounds[1])));
            self.cover >>= side * (self.bounds[1] - top) + before;
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
            let mut any = |low, high| rng.int(low, high) as i16;
            let (x, y, wide, high) = (any(58, 66), any(58, 66), any(0, 3), any(0, 3));
            let mut record = Record { bounds: [x, y, x + wide, y + high], ..Record::NONE };
            let pixels = |of: &Record| -> Vec<[i16; 2]> {
                let at = |k: i16| [of.bounds[0] + k % 4, of.bounds[1] + k / 4];
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
