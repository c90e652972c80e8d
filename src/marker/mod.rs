//! Marker families as data: the codes, how they are printed, and how they are read.
//!
//! Bits are listed row by row from the top-left of the family's official upright picture, 1 = white. Markers
//! with a picture instead of a code (ARToolKit's `.patt`) are in [`Patterns`].

mod board;
mod codes;
mod patterns;
mod read;

pub use board::{Board, Grid, Print};
pub use patterns::{Patch, PatternError, Patterns};

use crate::pixels::{Plane, Size};
use serde::{Deserialize, Serialize};

/// The table of families: one line each, the rest follows from it.
macro_rules! families {
    ($($(#[$doc:meta])* $family:ident, $name:literal, $inner:literal, $corrects:literal, $codes:expr;)*) => {
        /// A family of square markers.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
        #[serde(into = "&str", try_from = "String")]
        pub enum Family {
            $($(#[$doc])* $family,)*
            /// ARToolKit markers with a picture: the id is the place in [`Patterns`]. The picture fills the
            /// middle half of the black square.
            Pattern,
        }

        impl Family {
            /// Every family with codes, in the order of reports.
            pub const ALL: [Family; [$($name),*].len()] = [$(Family::$family),*];

            const fn facts(self) -> Facts {
                match self {
                    $(Family::$family => Facts { name: $name, inner: $inner, corrects: $corrects, codes: $codes },)*
                    Family::Pattern => Facts { name: "pattern", inner: 3, corrects: 0, codes: &[] },
                }
            }
        }
    };
}

/// What is known of a family.
struct Facts {
    name: &'static str,
    inner: usize,
    corrects: u32,
    codes: &'static [u64],
}

families! {
    /// AprilTag 36h11: 587 codes, minimum distance 11.
    Tag36h11, "tag36h11", 6, 3, &codes::TAG36H11;
    /// AprilTag 25h9: 35 codes, minimum distance 9.
    Tag25h9, "tag25h9", 5, 1, &codes::TAG25H9;
    /// AprilTag 16h5: 30 codes, minimum distance 5.
    Tag16h5, "tag16h5", 4, 0, &codes::TAG16H5;
    /// OpenCV DICT_4X4_50, minimum distance 4.
    Aruco4x4_50, "aruco_4x4_50", 4, 0, codes::ARUCO_4X4.split_at(50).0;
    /// OpenCV DICT_4X4_100, minimum distance 3.
    Aruco4x4_100, "aruco_4x4_100", 4, 0, codes::ARUCO_4X4.split_at(100).0;
    /// OpenCV DICT_4X4_250, minimum distance 3.
    Aruco4x4_250, "aruco_4x4_250", 4, 0, codes::ARUCO_4X4.split_at(250).0;
    /// OpenCV DICT_4X4_1000, minimum distance 2.
    Aruco4x4_1000, "aruco_4x4_1000", 4, 0, &codes::ARUCO_4X4;
    /// OpenCV DICT_5X5_50, minimum distance 8.
    Aruco5x5_50, "aruco_5x5_50", 5, 1, codes::ARUCO_5X5.split_at(50).0;
    /// OpenCV DICT_5X5_100, minimum distance 7.
    Aruco5x5_100, "aruco_5x5_100", 5, 1, codes::ARUCO_5X5.split_at(100).0;
    /// OpenCV DICT_5X5_250, minimum distance 6.
    Aruco5x5_250, "aruco_5x5_250", 5, 0, codes::ARUCO_5X5.split_at(250).0;
    /// OpenCV DICT_5X5_1000, minimum distance 5.
    Aruco5x5_1000, "aruco_5x5_1000", 5, 0, &codes::ARUCO_5X5;
    /// OpenCV DICT_6X6_50, minimum distance 13.
    Aruco6x6_50, "aruco_6x6_50", 6, 4, codes::ARUCO_6X6.split_at(50).0;
    /// OpenCV DICT_6X6_100, minimum distance 12.
    Aruco6x6_100, "aruco_6x6_100", 6, 4, codes::ARUCO_6X6.split_at(100).0;
    /// OpenCV DICT_6X6_250, minimum distance 11.
    Aruco6x6_250, "aruco_6x6_250", 6, 3, codes::ARUCO_6X6.split_at(250).0;
    /// OpenCV DICT_6X6_1000, minimum distance 9.
    Aruco6x6_1000, "aruco_6x6_1000", 6, 3, &codes::ARUCO_6X6;
    /// OpenCV DICT_7X7_50, minimum distance 19.
    Aruco7x7_50, "aruco_7x7_50", 7, 4, codes::ARUCO_7X7.split_at(50).0;
    /// OpenCV DICT_7X7_100, minimum distance 18.
    Aruco7x7_100, "aruco_7x7_100", 7, 4, codes::ARUCO_7X7.split_at(100).0;
    /// OpenCV DICT_7X7_250, minimum distance 17.
    Aruco7x7_250, "aruco_7x7_250", 7, 4, codes::ARUCO_7X7.split_at(250).0;
    /// OpenCV DICT_7X7_1000, minimum distance 14.
    Aruco7x7_1000, "aruco_7x7_1000", 7, 4, &codes::ARUCO_7X7;
    /// OpenCV DICT_ARUCO_ORIGINAL without number 1023, which is the same upside down: 1023 codes, minimum
    /// distance 1.
    ArucoOriginal, "aruco_original", 5, 0, codes::ARUCO_ORIGINAL.split_at(1023).0;
    /// ARToolKit AR_MATRIX_CODE_3x3: 64 codes, minimum distance 1.
    Matrix3x3, "matrix_3x3", 3, 0, &codes::MATRIX_3X3;
    /// ARToolKit AR_MATRIX_CODE_3x3_PARITY65: 32 codes, minimum distance 2.
    Matrix3x3Parity65, "matrix_3x3_parity65", 3, 0, &codes::MATRIX_3X3_PARITY65;
    /// ARToolKit AR_MATRIX_CODE_3x3_HAMMING63: 8 codes, minimum distance 1 (3 upright).
    Matrix3x3Hamming63, "matrix_3x3_hamming63", 3, 0, &codes::MATRIX_3X3_HAMMING63;
}

/// A word that names no family; its text lists the nearest name and all of them.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown marker family `{word}`: did you mean `{nearest}`? there are {}", Family::ALL.map(Family::name).join(", "))]
pub struct UnknownFamily {
    /// What was given.
    pub word: String,
    /// The name with the fewest edits to it.
    pub nearest: &'static str,
}

/// A code recognized in read bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reading {
    /// The code's number in its family.
    pub id: u32,
    /// Which of the read quad's corners, counted clockwise as seen, is the upright print's top-left.
    pub rotation: usize,
    /// Bits that differ from the code.
    pub hamming: u32,
}

/// Which of ink and paper is the dark one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Polarity {
    /// As the official picture.
    #[default]
    BlackOnWhite,
    /// Ink and paper exchanged.
    WhiteOnBlack,
}

impl Polarity {
    /// The gray value (0..255) that the official picture would have there.
    #[inline]
    pub fn gray(self, gray: f64) -> f64 {
        match self {
            Polarity::BlackOnWhite => gray,
            Polarity::WhiteOnBlack => 255.0 - gray,
        }
    }
}

/// The ink of a cell of a print.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ink {
    /// Black in the official picture.
    Black,
    /// White, paper included.
    White,
    /// Part of a picture of which only the picture itself is known.
    Picture,
}

impl Family {
    /// The name in files and on command lines.
    pub const fn name(self) -> &'static str {
        self.facts().name
    }

    /// The family of this name.
    pub fn from_name(name: &str) -> Result<Self, UnknownFamily> {
        let found = Self::ALL.into_iter().find(|family| family.name() == name);
        found.ok_or_else(|| {
            let nearest = Self::ALL.map(Self::name).into_iter().min_by_key(|n| strsim::levenshtein(name, n));
            UnknownFamily { word: name.into(), nearest: nearest.unwrap_or_default() }
        })
    }

    /// Bits along a side.
    pub const fn inner(self) -> usize {
        self.facts().inner
    }

    /// Width of the black border, in cells of the code: 1, ARToolKit 1.5 (a quarter of the side).
    pub const fn border(self) -> f64 {
        if self.is_artoolkit() { 1.5 } else { 1.0 }
    }

    const fn is_artoolkit(self) -> bool {
        self.inner() == 3
    }

    /// Equal squares along the black border's outer edge of which the print is made: the code's cells, or half
    /// of them where the border is 1.5 wide. At most 12.
    pub const fn cells(self) -> usize {
        if self.is_artoolkit() { 12 } else { self.inner() + 2 }
    }

    /// The codes by id: bits row by row from the top-left, first bit highest, 1 = white. None for pictures.
    pub const fn codes(self) -> &'static [u64] {
        self.facts().codes
    }

    /// The code of a number; 0 for every picture.
    pub fn code(self, id: u32) -> Option<u64> {
        if self == Family::Pattern { Some(0) } else { self.codes().get(id as usize).copied() }
    }

    /// Wrong bits that are still corrected: as many as the distance allows and random bits pass at most 5 times
    /// in 10⁴ for ([`Family::chance`]), never more than 4; so 4x4, 3x3, 16h5 and the large 5x5 sets correct
    /// nothing.
    pub const fn max_hamming(self) -> u32 {
        self.facts().corrects
    }

    /// How probable it is that random bits are a code of this family with at most `wrong` bits wrong:
    /// orientations x codes x the ways of being wrong, of 2^bits. With [`Family::max_hamming`], 10⁻⁷ (7x7) to
    /// 5·10⁻⁴ for the families that prove themselves; 2·10⁻³ (16h5) to 6·10⁻² (4x4_1000) and 5·10⁻¹ (plain 3x3)
    /// for those that a reader must ask for more evidence.
    pub fn chance(self, wrong: u32) -> f64 {
        let bits = self.inner() * self.inner();
        let (mut ways, mut near) = (1.0, 1.0);
        for wrong in 1..=bits.min(wrong as usize) {
            ways *= (bits + 1 - wrong) as f64 / wrong as f64;
            near += ways;
        }
        4.0 * self.codes().len() as f64 * near / (1u64 << bits) as f64
    }

    /// The ink of the square at `column`, `row` in the print of `code`, counted in [`Family::cells`] from the
    /// border's top-left one; squares outside the border are the white quiet zone.
    pub fn ink(self, code: u64, column: isize, row: isize) -> Ink {
        let cells = self.cells() as isize;
        let outside = |v: isize| v < 0 || v >= cells;
        if outside(column) || outside(row) {
            return Ink::White;
        }
        let (inner, halves) = (self.inner() as isize, if self.is_artoolkit() { 2 } else { 1 });
        let border = (cells - inner * halves) / 2;
        let (column, row) = (column - border, row - border);
        if column < 0 || row < 0 || column >= inner * halves || row >= inner * halves {
            return Ink::Black;
        }
        if self == Family::Pattern {
            return Ink::Picture;
        }
        let bit = row / halves * inner + column / halves;
        if (code >> (inner * inner - 1 - bit)) & 1 == 1 { Ink::White } else { Ink::Black }
    }

    /// Whether the square is white in the print of `code` (see [`Family::ink`]).
    pub fn is_white(self, code: u64, column: isize, row: isize) -> bool {
        self.ink(code, column, row) == Ink::White
    }

    /// The upright print, one sample a square (0 or 255), with the black border and one square of white quiet
    /// zone around it: `cells() + 2` samples a side. `None` when the family has no such code.
    pub fn picture(self, id: u32) -> Option<Plane<u8>> {
        let code = *self.codes().get(id as usize)?;
        let side = self.cells() + 2;
        let ink = |x: usize, y: usize| 255 * u8::from(self.is_white(code, x as isize - 1, y as isize - 1));
        Some(Plane::from_fn(Size::new(side, side), ink))
    }

    /// [`Family::picture`] with ink and paper exchanged: the white-on-black print of the same marker.
    pub fn inverted_picture(self, id: u32) -> Option<Plane<u8>> {
        let picture = self.picture(id)?;
        Some(Plane::from_fn(picture.size(), |x, y| 255 - picture.at(x, y)))
    }
}

impl From<Family> for &'static str {
    fn from(family: Family) -> Self {
        family.name()
    }
}

impl TryFrom<String> for Family {
    type Error = UnknownFamily;

    fn try_from(name: String) -> Result<Self, UnknownFamily> {
        Self::from_name(&name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn picture_is_the_official_print() {
        let rows = |family: Family, id| -> Vec<String> {
            let picture = family.picture(id).expect("id");
            let line = |row: &[u8]| row.iter().map(|&ink| if ink == 0 { '#' } else { '.' }).collect();
            picture.rows().map(line).collect()
        };
        // DICT_4X4_50 number 0: 1011 0101 0011 0010
        let expected =
            ["........", ".######.", ".#.#..#.", ".##.#.#.", ".###..#.", ".###.##.", ".######.", "........"];
        assert_eq!(rows(Family::Aruco4x4_50, 0), expected);
        assert!(Family::Aruco4x4_50.picture(50).is_none());
        // tag16h5 number 0 as AprilRobotics print it: 0010 0011 0001 1011
        let expected =
            ["........", ".######.", ".###.##.", ".###..#.", ".####.#.", ".#.#..#.", ".######.", "........"];
        assert_eq!(rows(Family::Tag16h5, 0), expected);
        // matrix code 1 of ARToolKit: the last of its six cells black, besides two corners; half cells
        let print = rows(Family::Matrix3x3, 1);
        assert_eq!((print.len(), print[3].as_str()), (14, ".############."));
        for (row, expected) in [(4, ".#####....###."), (6, ".###......###."), (8, ".#######..###.")] {
            assert_eq!([&print[row], &print[row + 1]], [expected; 2]);
        }
        assert_eq!(Family::Matrix3x3.inverted_picture(1).map(|p| (p.at(0, 0), p.at(1, 1))), Some((0, 255)));
    }

    #[test]
    fn names_are_read_and_mistakes_are_answered() {
        for family in Family::ALL {
            assert_eq!(Family::from_name(family.name()), Ok(family));
            let json = serde_json::to_string(&family).expect("a name");
            assert_eq!(json, format!("\"{}\"", family.name()));
            assert_eq!(serde_json::from_str::<Family>(&json).expect("the name again"), family);
        }
        let wrong = Family::from_name("aruco_5x5_1O0").expect_err("no such family").to_string();
        assert!(
            wrong.contains("`aruco_5x5_1O0`") && wrong.contains("did you mean `aruco_5x5_100`"),
            "{wrong}"
        );
        assert!(wrong.contains("tag25h9") && !wrong.contains('\n'), "{wrong}");
        assert!(Family::from_name("pattern").is_err(), "pictures are named by their file");
    }
}
