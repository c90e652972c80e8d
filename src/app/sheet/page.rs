//! What is on a page: black shapes of rectangles, and lines of text. Millimetres from the top left, y down.

use crate::marker::Family;

/// A rectangle: left, top, width, height, mm.
pub type Rect = [f64; 4];

/// Where a line of text is held.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hold {
    /// At its left end.
    Left,
    /// At its middle.
    Middle,
}

/// Something printed.
#[derive(Clone, Debug, PartialEq)]
pub enum Mark {
    /// Black rectangles that are one shape: where they touch, no seam may show.
    Ink(Vec<Rect>),
    /// A line of text (ASCII) on a base line.
    Text {
        /// Where it is held: on the base line, mm.
        at: [f64; 2],
        /// Height of the letters' box, mm.
        size: f64,
        /// Which point of it is there.
        hold: Hold,
        /// What it says.
        text: String,
    },
}

/// A page.
#[derive(Clone, Debug, PartialEq)]
pub struct Page {
    /// Width and height, mm.
    pub size: [f64; 2],
    /// What is printed on it.
    pub marks: Vec<Mark>,
}

/// Width of cut marks and ticks, mm.
const LINE: f64 = 0.15;
/// Height of text, mm.
pub const TEXT: f64 = 2.8;

impl Page {
    /// Writes a line of text.
    pub fn text(&mut self, at: [f64; 2], hold: Hold, text: impl Into<String>) {
        self.marks.push(Mark::Text { at, size: TEXT, hold, text: text.into() });
    }

    /// The print of a code, its black border's top left corner at `at`.
    pub fn print(&mut self, family: Family, code: u64, side: f64, at: [f64; 2]) {
        let cells = family.cells();
        let cell = side / cells as f64;
        let mut rects = Vec::new();
        for row in 0..cells {
            let mut column = 0;
            while column < cells {
                let black = |column: usize| !family.is_white(code, column as isize, row as isize);
                let length = (column..cells).take_while(|&column| black(column)).count();
                if length > 0 {
                    let (x, y) = (at[0] + column as f64 * cell, at[1] + row as f64 * cell);
                    rects.push([x, y, length as f64 * cell, cell]);
                }
                column += length.max(1);
            }
        }
        self.marks.push(Mark::Ink(rects));
    }

    /// A cross that says where to cut, its arms `arm` long.
    pub fn cross(&mut self, [x, y]: [f64; 2], arm: f64) {
        let across = [x - arm, y - 0.5 * LINE, 2.0 * arm, LINE];
        self.marks.push(Mark::Ink(vec![across, [x - 0.5 * LINE, y - arm, LINE, 2.0 * arm]]));
    }

    /// A ruler of `centimetres`, its zero at `at`, to the right (or downward): a tick each mm.
    pub fn ruler(&mut self, at: [f64; 2], centimetres: usize, down: bool) {
        let turned = |[x, y, w, h]: Rect| {
            let [x, y, w, h] = if down { [y, x, h, w] } else { [x, y, w, h] };
            [at[0] + x, at[1] + y, w, h]
        };
        let mm = 10 * centimetres;
        let mut rects = vec![turned([0.0, -0.5 * LINE, mm as f64, LINE])];
        for tick in 0..=mm {
            let length = match tick {
                t if t % 10 == 0 => 5.0,
                t if t % 5 == 0 => 3.5,
                _ => 2.0,
            };
            rects.push(turned([tick as f64 - 0.5 * LINE, 0.0, LINE, length]));
        }
        self.marks.push(Mark::Ink(rects));
        for cm in 0..=centimetres {
            let along = 10.0 * cm as f64;
            let (place, hold) = match down {
                false => ([at[0] + along, at[1] + 5.0 + TEXT], Hold::Middle),
                true => ([at[0] + 5.5, at[1] + along + 0.35 * TEXT], Hold::Left),
            };
            self.text(place, hold, cm.to_string());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_black_of_a_print_is_the_black_of_its_picture() {
        for family in [Family::Tag36h11, Family::Aruco4x4_50, Family::Matrix3x3] {
            let mut page = Page { size: [100.0; 2], marks: Vec::new() };
            let code = family.code(3).expect("a code");
            let cells = family.cells() as f64;
            page.print(family, code, cells, [2.0, 5.0]);
            let Some(Mark::Ink(rects)) = page.marks.first() else { panic!("ink") };
            let picture = family.picture(3).expect("a picture");
            for (y, row) in picture.rows().enumerate() {
                for (x, &gray) in row.iter().enumerate() {
                    let at = [x as f64 - 1.0 + 2.5, y as f64 - 1.0 + 5.5];
                    let inside = |r: &&Rect| (0..2).all(|i| (r[i]..r[i] + r[i + 2]).contains(&at[i]));
                    assert_eq!(rects.iter().filter(inside).count(), usize::from(gray == 0), "{x} {y}");
                }
            }
        }
    }
}
