//! The print as bits around its junctions, where four cells meet.

use crate::marker::Family;

/// Most cells along the border's outer edge.
pub const MOST_CELLS: usize = 12;
/// Junctions along a row of the table.
pub const STRIDE: usize = 16;

/// The ink around every junction: the 4x4 cells about it, row by row, bit 0 at the top left, 1 = white. The
/// middle 2x2 cells touch the junction. Everything outside the border is white.
#[derive(Clone, Debug)]
pub struct Pattern {
    /// Junction (column, row) counted from the border's top-left corner, at `row · STRIDE + column`.
    pub around: [u16; STRIDE * STRIDE],
    /// Cells along the border's outer edge.
    pub cells: usize,
}

impl Pattern {
    /// The pattern of a family's print; `None` when there is none of this number.
    pub fn new(family: Family, id: u32) -> Option<Self> {
        let code = *family.codes().get(id as usize)?;
        let cells = family.cells();
        if cells > MOST_CELLS {
            return None;
        }
        let mut around = [0; STRIDE * STRIDE];
        for row in 0..=cells {
            for column in 0..=cells {
                let mut bits = 0;
                for k in 0..16 {
                    let (x, y) = (column as isize + k % 4 - 2, row as isize + k / 4 - 2);
                    bits |= u16::from(family.is_white(code, x, y)) << k;
                }
                around[row * STRIDE + column] = bits;
            }
        }
        Some(Self { around, cells })
    }
    /// Whether a cell is white; column and row count from the border's top-left cell and stay inside it.
    pub fn ink(&self, column: usize, row: usize) -> bool {
        self.around[row * STRIDE + column] >> 10 & 1 == 1
    }
}
