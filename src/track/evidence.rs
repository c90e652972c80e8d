//! What a reading must show besides a code: how much depends on how often random bits are read as one of the family's
//! codes.

use super::ring::Ring;
use crate::marker::Family;

/// What a reading must show besides a code.
pub struct Evidence {
    /// Least share of the border's samples that are dark, and of the quiet zone's that are light.
    pub dark: f64,
    pub light: f64,
    /// Least mean distance of a bit from its threshold, of half the contrast: true bits lie near 1, the bits of
    /// a texture anywhere.
    pub clarity: f64,
    /// Least correlation of the gray values with the blurred print: markers stay above 0.86 in noise, blur and
    /// the edges of shadows, other prints and textures that have a code's bits are mostly below 0.8. 0 = not
    /// asked for.
    pub likeness: f64,
    /// Most that one cell may be off, of the variance: by a shadow's edge 0.7, a cell that is half black 1.
    pub worst: f64,
    /// Least width of a cell, px.
    pub cell_px: f64,
}

/// For codes that no texture shows by chance: read on bent paper and half in the shadow, too.
const SURE: Evidence =
    Evidence { dark: 0.875, light: 0.75, clarity: 0.35, likeness: 0.0, worst: f64::INFINITY, cell_px: 0.0 };
/// For codes that random bits hit once in a hundred thousand to once in a thousand; with wrong bits, in three
/// thousand.
const RARE: Evidence = Evidence { likeness: 0.85, ..SURE };
/// For codes that they hit more often (4x4, 16h5), and the original ArUco codes, whose rows of strokes are what
/// letters and signs look like.
pub const OFTEN: Evidence =
    Evidence { dark: 1.0, light: 0.875, clarity: 0.4, likeness: 0.85, worst: 0.6, cell_px: 0.0 };
/// For codes that they hit more than once in twenty (4x4_1000, ARToolKit's 3x3): the print must be seen well.
const MOSTLY: Evidence =
    Evidence { dark: 1.0, light: 1.0, clarity: 0.65, likeness: 0.92, worst: 0.5, cell_px: SMALL_PX };
/// For these in small prints, where blur makes cells of anything.
const SMALL: Evidence = Evidence { likeness: 0.95, cell_px: 2.0, ..MOSTLY };
/// For bits that are a plain shape, as things nested in each other are.
const SHAPE: Evidence = Evidence { likeness: 0.95, ..MOSTLY };

/// Cells of less than this are small, px.
const SMALL_PX: f64 = 3.5;

impl Evidence {
    /// For a reading of so many wrong bits in cells of `cell_px`; `bits`: what was read, if anything was yet.
    pub fn of(family: Family, wrong: u32, bits: Option<u64>, cell_px: f64) -> &'static Self {
        match family.chance(wrong) {
            _ if bits.is_some_and(|bits| is_shape(bits, family.inner())) => &SHAPE,
            _ if family == Family::ArucoOriginal => &OFTEN,
            chance if chance < 1e-5 => &SURE,
            chance if chance < 3e-4 || (chance < 1e-3 && wrong == 0) => &RARE,
            chance if chance < 5e-2 => &OFTEN,
            _ if cell_px < SMALL_PX => &SMALL,
            _ => &MOSTLY,
        }
    }

    /// Whether the rings, the bits and their size are enough; the fit of the print is asked apart, it costs most.
    pub fn is_shown(&self, ring: &Ring, clarity: f64, cell_px: f64) -> bool {
        ring.dark >= self.dark
            && ring.light >= self.light
            && clarity >= self.clarity
            && cell_px >= self.cell_px
    }
}

/// Whether `inner` x `inner` bits within their black border are a plain shape: few of their cells' sides lie between
/// black and white (a square of half the width has 2·inner of them, a code mostly inner² and more). 3x3 bits are
/// all plain.
fn is_shape(bits: u64, inner: usize) -> bool {
    inner > 3 && outline(bits, inner) as usize <= 2 * inner + 2
}

/// Sides of cells between black and white in `inner` x `inner` bits within their black border.
fn outline(bits: u64, inner: usize) -> u32 {
    let white = |row: usize, column: usize| {
        (row < inner && column < inner) && (bits >> (inner * inner - 1 - (row * inner + column))) & 1 == 1
    };
    let mut sides = 0;
    for row in 0..=inner {
        for column in 0..=inner {
            let here = white(row, column);
            sides += u32::from(here != white(row.wrapping_sub(1), column));
            sides += u32::from(here != white(row, column.wrapping_sub(1)));
        }
    }
    sides
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Squares in squares are plain shapes.
    #[test]
    fn nested_squares_are_shapes_and_codes_are_not() {
        assert!(is_shape(0x0660, 4), "a square in a square");
        assert!(is_shape(0x6600, 4), "a square at the border");
        assert!(!is_shape(0xa5a5, 4));
        let codes = Family::Tag36h11.codes();
        assert!(!codes.is_empty() && codes.iter().all(|&code| !is_shape(code, 6)));
    }
}
