//! The print as bits around its junctions, where four cells meet.

use crate::marker::{Family, Ink};

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
    /// Where the ink changes: along every line of junctions, upright and level ones, a bit for every side between
    /// junctions whose cells differ.
    pub edges: [[u16; MOST_CELLS + 1]; 2],
    /// Cells along the border's outer edge.
    pub cells: usize,
    /// From which to before which cell along both sides the print is a picture that is not known.
    pub picture: Option<[f32; 2]>,
}

impl Pattern {
    /// The pattern of a family's print; `None` when there is none of this number.
    pub fn new(family: Family, id: u32) -> Option<Self> {
        let code = family.code(id)?;
        let cells = family.cells();
        if cells > MOST_CELLS {
            return None;
        }
        // a bit for every cell of a row, two cells around the border as well
        let mut white = [0u16; MOST_CELLS + 4];
        for (row, bits) in white.iter_mut().enumerate().take(cells + 4) {
            for column in 0..cells + 4 {
                let ink = family.ink(code, column as isize - 2, row as isize - 2);
                *bits |= u16::from(ink == Ink::White) << column;
            }
        }
        let mut around = [0; STRIDE * STRIDE];
        for row in 0..=cells {
            for column in 0..=cells {
                let four = |k: usize| (white[row + k] >> column & 0xf) << (4 * k);
                around[row * STRIDE + column] = four(0) | four(1) | four(2) | four(3);
            }
        }
        let mut edges = [[0; MOST_CELLS + 1]; 2];
        for line in 0..=cells {
            for k in 0..cells {
                // the cells beside the junction's lower and right side
                let upright = around[k * STRIDE + line] >> 9;
                let level = around[line * STRIDE + k];
                edges[0][line] |= ((upright ^ upright >> 1) & 1) << k;
                edges[1][line] |= ((level >> 6 ^ level >> 10) & 1) << k;
            }
        }
        let middle = (cells / 2) as isize;
        let first = (0..middle).find(|&column| family.ink(code, column, middle) == Ink::Picture);
        let picture = first.map(|border| [border as f32, (cells as isize - border) as f32]);
        Some(Self { around, edges, cells, picture })
    }

    /// The ink of a cell; column and row count from the border's top-left cell and stay inside it.
    pub fn ink(&self, column: usize, row: usize) -> Ink {
        let within = |[from, to]: [f32; 2]| [column, row].iter().all(|&v| (from..to).contains(&(v as f32)));
        match self.around[row * STRIDE + column] >> 10 & 1 {
            _ if self.picture.is_some_and(within) => Ink::Picture,
            0 => Ink::Black,
            _ => Ink::White,
        }
    }
}
