//! A list that lies over the picture while somebody chooses from it with one button.
//!
//! Drawn straight into a copy of the picture, letter pixels as squares: nothing is allocated but that copy, and nothing
//! is done while the list is closed.

use super::Seen;
use super::slate::{GLYPH, INK, PAPER};
use crate::pixels::{Rgb, Size};
use font8x8::{BASIC_FONTS, UnicodeFonts};
use std::time::Duration;

/// It closes by itself when nobody has pressed for so long.
const PATIENCE: Duration = Duration::from_secs(10);
/// Height of a line in letter pixels.
const LINE: usize = 12;
/// Letters of a line at most, the mark before them included.
const LETTERS: usize = 24;

/// A list of lines, one of them chosen while it is open.
#[derive(Debug, Default)]
pub struct Menu {
    lines: Vec<String>,
    /// The lines that say what is so now.
    now: Vec<bool>,
    chosen: Option<usize>,
    until: Duration,
    picture: Rgb,
}

impl Menu {
    /// Puts the lines in place of what was there; ASCII is shown. Closes the menu.
    pub fn set_lines(&mut self, lines: Vec<String>) {
        self.now = vec![false; lines.len()];
        (self.lines, self.chosen) = (lines, None);
    }

    /// Opens it at `time` with the first line chosen that says what `is_now`; those lines get a mark.
    pub fn open(&mut self, time: Duration, is_now: impl Fn(usize) -> bool) {
        self.now.iter_mut().enumerate().for_each(|(line, now)| *now = is_now(line));
        let first = self.now.iter().position(|&now| now).unwrap_or(0);
        self.chosen = Some(first).filter(|_| !self.lines.is_empty());
        self.until = time + PATIENCE;
    }

    /// Closes it.
    pub fn close(&mut self) {
        self.chosen = None;
    }

    /// The chosen line while it is open at `time`.
    pub fn chosen(&mut self, time: Duration) -> Option<usize> {
        if time >= self.until {
            self.chosen = None;
        }
        self.chosen
    }

    /// The next line is chosen, after the last the first.
    pub fn step(&mut self, time: Duration) {
        if let Some(line) = self.chosen(time) {
            self.chosen = Some((line + 1) % self.lines.len());
            self.until = time + PATIENCE;
        }
    }

    /// The picture with the list on it, in the part of it that is `seen`, or as it is while the list is closed.
    pub fn over<'a>(&'a mut self, picture: &'a Rgb, seen: Seen, time: Duration) -> &'a Rgb {
        let Some(chosen) = self.chosen(time) else { return picture };
        self.picture.copy_from(picture);
        let place = Place::of(picture.size(), seen, self.lines.len(), chosen);
        for row in 0..place.rows {
            let line = place.first + row;
            place.draw(&mut self.picture, row, &self.lines[line], self.now[line], line == chosen);
        }
        &self.picture
    }
}

/// Where the list lies on pictures of a size.
struct Place {
    /// Side of a letter pixel, px.
    zoom: usize,
    left: usize,
    top: usize,
    width: usize,
    /// The first line that is seen, and how many are.
    first: usize,
    rows: usize,
}

impl Place {
    /// In the middle, as large as goes; the chosen line is among those seen.
    fn of(size: Size, seen: Seen, lines: usize, chosen: usize) -> Self {
        let Seen { size: part, shrink } = seen;
        let zoom = (part.width / (GLYPH * LETTERS)).min(part.height / (LINE * 8)).max(shrink);
        let rows = (part.height / (LINE * zoom)).min(lines);
        let first = (chosen + 1).saturating_sub(rows.div_ceil(2)).min(lines - rows);
        let width = (GLYPH * LETTERS * zoom).min(part.width);
        let (left, top) = ((size.width - width) / 2, (size.height - rows * LINE * zoom) / 2);
        Self { zoom, left, top, width, first, rows }
    }

    /// One line: light on dark, the chosen one dark on light; a star before what is so now.
    fn draw(&self, picture: &mut Rgb, row: usize, text: &str, now: bool, chosen: bool) {
        let (ink, paper) = if chosen { (PAPER, INK) } else { (INK, PAPER) };
        let top = self.top + row * LINE * self.zoom;
        for plane in &mut picture.planes {
            for y in top..top + LINE * self.zoom {
                plane.row_mut(y)[self.left..self.left + self.width].fill(paper);
            }
        }
        let mark = if now { '*' } else { ' ' };
        let letters = std::iter::once(mark).chain(text.chars());
        let room = self.width / (GLYPH * self.zoom);
        for (place, letter) in letters.take(room).enumerate() {
            let Some(glyph) = BASIC_FONTS.get(letter) else { continue };
            let corner = (self.left + place * GLYPH * self.zoom, top + (LINE - GLYPH) / 2 * self.zoom);
            self.letter(picture, glyph, corner, ink);
        }
    }

    fn letter(&self, picture: &mut Rgb, glyph: [u8; GLYPH], (left, top): (usize, usize), ink: u8) {
        for (y, row) in glyph.into_iter().enumerate() {
            for x in (0..GLYPH).filter(|x| row >> x & 1 == 1) {
                let (left, top) = (left + x * self.zoom, top + y * self.zoom);
                for plane in &mut picture.planes {
                    for y in top..top + self.zoom {
                        plane.row_mut(y)[left..left + self.zoom].fill(ink);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const START: Duration = Duration::from_secs(7);

    fn menu(count: usize) -> Menu {
        let mut menu = Menu::default();
        menu.set_lines((0..count).map(|line| format!("a line with the number {line}")).collect());
        menu
    }

    /// Rows of the picture that are paper of the chosen line, from the first to the last.
    fn bar(picture: &Rgb) -> Option<(usize, usize)> {
        let middle = picture.size().width / 2;
        let light = |&y: &usize| {
            let row = picture.planes[1].row(y);
            row[middle - 30..middle + 30].iter().filter(|&&value| value == INK).count() > 30
        };
        let rows: Vec<usize> = (0..picture.size().height).filter(light).collect();
        Some((*rows.first()?, *rows.last()?))
    }

    #[test]
    fn one_line_is_chosen_and_seen_on_every_screen() {
        for size in [(160, 120), (128, 64), (320, 240), (640, 480), (480, 640), (1920, 1080), (61, 13)] {
            let size = Size::new(size.0, size.1);
            let canvas = Rgb::new(size, [90; 3]);
            for count in [1, 3, 9, 40] {
                let mut menu = menu(count);
                menu.open(START, |line| line == count / 2);
                let mut bars = Vec::new();
                for step in 0..count {
                    assert_eq!(menu.chosen(START), Some((count / 2 + step) % count));
                    let (top, bottom) =
                        bar(menu.over(&canvas, Seen::all(size), START)).expect("the chosen line is seen");
                    assert!(bottom - top < size.height.min(300), "one line");
                    bars.push(top);
                    menu.step(START);
                }
                assert_eq!(menu.chosen(START), Some(count / 2), "round");
                if size.height >= 120 && count > 1 {
                    bars.dedup();
                    assert!(bars.len() > 1, "it moves");
                }
            }
        }
    }

    #[test]
    fn what_is_so_now_has_a_mark_and_what_lies_around_is_the_picture() {
        let size = Size::new(640, 480);
        let mut canvas = Rgb::new(size, [0; 3]);
        for y in 0..size.height {
            canvas.planes[2].row_mut(y).iter_mut().enumerate().for_each(|(x, value)| *value = (x ^ y) as u8);
        }
        let mut menu = menu(3);
        let all = Seen::all(size);
        let closed = menu.over(&canvas, all, START).clone();
        assert_eq!(closed, canvas);
        menu.open(START, |_| false);
        let without = menu.over(&canvas, all, START).clone();
        menu.open(START, |line| line == 2);
        menu.step(START); // the first again
        let with = menu.over(&canvas, all, START).clone();
        let differ =
            |a: &Rgb, b: &Rgb| (0..480).filter(|&y| a.planes[2].row(y) != b.planes[2].row(y)).count();
        assert!((1..40).contains(&differ(&without, &with)), "a star");
        assert!((60..120).contains(&differ(&without, &canvas)), "three lines of 36 px");
        assert_eq!(without.planes[2].row(100), canvas.planes[2].row(100));
    }

    #[test]
    fn it_lies_where_the_screen_shows_it_in_strokes_that_it_shows() {
        let size = Size::new(640, 480);
        let canvas = Rgb::new(size, [90; 3]);
        let part = Size::new(240, 160);
        let drawn = |seen| {
            let mut menu = menu(30);
            menu.open(START, |_| false);
            let drawn = menu.over(&canvas, seen, START).clone();
            let rows = (0..480).filter(|&y| drawn.planes[0].row(y) != canvas.planes[0].row(y));
            let rows: Vec<usize> = rows.collect();
            let row = drawn.planes[0].row(240);
            let columns: Vec<usize> = (0..640).filter(|&x| row[x] != 90).collect();
            let left = columns[0];
            let chosen = (0..480).filter(|&y| drawn.planes[0].at(left, y) == INK).count();
            (rows[0], rows[rows.len() - 1], left, columns[columns.len() - 1], chosen)
        };
        let (top, bottom, left, right, chosen) = drawn(Seen { size: part, shrink: 1 });
        assert!(top >= 160 && bottom < 320 && left >= 200 && right < 440, "{top} {bottom} {left} {right}");
        assert_eq!(chosen, LINE);
        for shrink in [2, 4, 5] {
            let (.., chosen) = drawn(Seen { size, shrink });
            assert_eq!(chosen, LINE * shrink.max(3), "letter pixels of {shrink}");
        }
    }

    #[test]
    fn it_closes_by_itself() {
        let mut menu = menu(5);
        assert_eq!(menu.chosen(START), None);
        menu.step(START);
        menu.open(START, |_| false);
        let late = START + PATIENCE;
        menu.step(late - Duration::from_millis(1));
        assert_eq!(menu.chosen(late), Some(1), "a step gives it time");
        assert_eq!(menu.chosen(late + PATIENCE), None);
        menu.step(late + PATIENCE);
        assert_eq!(menu.chosen(late), None, "closed is closed");
        menu.set_lines(Vec::new());
        menu.open(START, |_| true);
        assert_eq!(menu.chosen(START), None, "nothing to choose from");
    }
}
