//! Marker families as data: the codes, how they are printed, and how they are read.
//!
//! Bits are listed row by row from the top-left of the family's official upright picture, 1 = white.

mod codes;

use crate::pixels::{Plane, Size};
use serde::{Deserialize, Serialize};

/// A family of square markers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Family {
    /// AprilTag 36h11: 6x6 bits, 587 codes, minimum distance 11.
    #[serde(rename = "tag36h11")]
    Tag36h11,
    /// OpenCV DICT_4X4_50.
    #[serde(rename = "aruco_4x4_50")]
    Aruco4x4_50,
    /// OpenCV DICT_5X5_100.
    #[serde(rename = "aruco_5x5_100")]
    Aruco5x5_100,
    /// OpenCV DICT_6X6_250.
    #[serde(rename = "aruco_6x6_250")]
    Aruco6x6_250,
}

/// A code recognised in read bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reading {
    /// The code's number in its family.
    pub id: u32,
    /// Which of the read quad's corners, counted clockwise as seen, is the upright print's top-left.
    pub rotation: usize,
    /// Bits that differ from the code.
    pub hamming: u32,
}

impl Family {
    /// Every family, in the order of reports.
    pub const ALL: [Family; 4] =
        [Family::Tag36h11, Family::Aruco4x4_50, Family::Aruco5x5_100, Family::Aruco6x6_250];

    /// The name in files and on command lines.
    pub const fn name(self) -> &'static str {
        match self {
            Family::Tag36h11 => "tag36h11",
            Family::Aruco4x4_50 => "aruco_4x4_50",
            Family::Aruco5x5_100 => "aruco_5x5_100",
            Family::Aruco6x6_250 => "aruco_6x6_250",
        }
    }

    /// The family of this name; `None` when there is none.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|family| family.name() == name)
    }

    /// Bits along a side.
    pub const fn inner(self) -> usize {
        match self {
            Family::Aruco4x4_50 => 4,
            Family::Aruco5x5_100 => 5,
            Family::Tag36h11 | Family::Aruco6x6_250 => 6,
        }
    }

    /// Width of the black border in cells.
    pub const fn border(self) -> usize {
        1
    }

    /// Cells along the black border's outer edge.
    pub const fn cells(self) -> usize {
        self.inner() + 2 * self.border()
    }

    /// The codes by id: bits row by row from the top-left, first bit highest, 1 = white.
    pub fn codes(self) -> &'static [u64] {
        match self {
            Family::Tag36h11 => &codes::TAG36H11,
            Family::Aruco4x4_50 => &codes::ARUCO_4X4_50,
            Family::Aruco5x5_100 => &codes::ARUCO_5X5_100,
            Family::Aruco6x6_250 => &codes::ARUCO_6X6_250,
        }
    }

    /// Wrong bits that are still corrected. Less than the distance would allow: what limits it is how often
    /// random bits would pass (36h11 and 6x6 with 3: 3 and 1 in 10⁴; 5x5 with 1: 3 in 10⁴; 4x4 with 0: 3 in
    /// 10³, so that family corrects nothing).
    pub const fn max_hamming(self) -> u32 {
        match self {
            Family::Aruco4x4_50 => 0,
            Family::Aruco5x5_100 => 1,
            Family::Tag36h11 | Family::Aruco6x6_250 => 3,
        }
    }

    /// Whether the cell is white in the print of `code`; column and row count from the border's top-left
    /// cell, cells outside the border are the white quiet zone.
    pub fn is_white(self, code: u64, column: isize, row: isize) -> bool {
        let (border, inner, cells) = (self.border() as isize, self.inner() as isize, self.cells() as isize);
        let outside = |v: isize| v < 0 || v >= cells;
        if outside(column) || outside(row) {
            return true;
        }
        let (column, row) = (column - border, row - border);
        let bit = row * inner + column;
        (0..inner).contains(&column)
            && (0..inner).contains(&row)
            && (code >> (inner * inner - 1 - bit)) & 1 == 1
    }

    /// The upright print, one sample a cell (0 or 255), with the black border and one cell of white quiet
    /// zone around it: `cells() + 2` samples a side. `None` when the family has no such id.
    pub fn picture(self, id: u32) -> Option<Plane<u8>> {
        let code = *self.codes().get(id as usize)?;
        let side = self.cells() + 2;
        let ink = |x: usize, y: usize| 255 * u8::from(self.is_white(code, x as isize - 1, y as isize - 1));
        Some(Plane::from_fn(Size::new(side, side), ink))
    }

    /// Finds the code nearest to bits read row by row from the read quad's first corner; `None` when every
    /// code differs in more than `max_hamming()` bits in each of the four orientations. Mirrored prints are
    /// never tried.
    pub fn read(self, bits: u64) -> Option<Reading> {
        let mut turned = [bits; 4];
        for turn in 1..4 {
            turned[turn] = self.turn(turned[turn - 1]);
        }
        let mut best: Option<Reading> = None;
        let mut bound = self.max_hamming();
        for (id, code) in (0u32..).zip(self.codes()) {
            for (rotation, view) in turned.iter().enumerate() {
                let hamming = (code ^ view).count_ones();
                if hamming < bound || (hamming == bound && best.is_none()) {
                    best = Some(Reading { id, rotation, hamming });
                    bound = hamming;
                }
            }
        }
        best
    }

    /// The bits as they are read when one starts from the next corner clockwise.
    pub fn turn(self, bits: u64) -> u64 {
        let n = self.inner();
        let mut turned = 0;
        for row in 0..n {
            for column in 0..n {
                let from = column * n + (n - 1 - row);
                turned = (turned << 1) | ((bits >> (n * n - 1 - from)) & 1);
            }
        }
        turned
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The distances the families are published with hold over every pair and rotation; so a transcription
    /// error of the tables would show.
    #[test]
    fn codes_keep_their_distance() {
        for (family, count, distance) in [
            (Family::Tag36h11, 587, 11),
            (Family::Aruco4x4_50, 50, 4),
            (Family::Aruco5x5_100, 100, 7),
            (Family::Aruco6x6_250, 250, 11),
        ] {
            let codes = family.codes();
            assert_eq!(codes.len(), count);
            let mut least = u32::MAX;
            for (i, &code) in codes.iter().enumerate() {
                assert_eq!(code >> (family.inner() * family.inner()), 0);
                let mut view = code;
                for turn in 0..4 {
                    for (j, other) in codes.iter().enumerate() {
                        if !(turn == 0 && i == j) {
                            least = least.min((view ^ other).count_ones());
                        }
                    }
                    view = family.turn(view);
                }
                assert_eq!(view, code, "four quarter turns are none");
            }
            assert_eq!(least, distance, "{}", family.name());
            assert!(2 * family.max_hamming() < distance);
        }
    }

    #[test]
    fn every_code_reads_as_itself_in_every_orientation() {
        for family in Family::ALL {
            assert_eq!(Family::from_name(family.name()), Some(family));
            for (id, &code) in (0u32..).zip(family.codes()) {
                let mut view = code;
                for turn in 0..4 {
                    let rotation = (4 - turn) % 4;
                    assert_eq!(family.read(view), Some(Reading { id, rotation, hamming: 0 }));
                    view = family.turn(view);
                }
            }
            let damaged = family.codes()[7] ^ ((1 << family.max_hamming()) - 1);
            let reading = family.read(damaged).expect("within the bound");
            assert_eq!((reading.id, reading.hamming), (7, family.max_hamming()));
        }
    }

    #[test]
    fn picture_is_the_official_print() {
        let picture = Family::Aruco4x4_50.picture(0).expect("id 0");
        let rows: Vec<String> = picture
            .rows()
            .map(|row| row.iter().map(|&ink| if ink == 0 { '#' } else { '.' }).collect())
            .collect();
        // DICT_4X4_50 number 0: 1011 0101 0011 0010
        let expected =
            ["........", ".######.", ".#.#..#.", ".##.#.#.", ".###..#.", ".###.##.", ".######.", "........"];
        assert_eq!(rows, expected);
        assert!(Family::Aruco4x4_50.picture(50).is_none());
    }
}
