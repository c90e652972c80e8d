//! What the screen shows while there is no camera picture: a line of words, a fault code, a sign of life.

use crate::pixels::{Rgb, Size};
use font8x8::{BASIC_FONTS, UnicodeFonts};
use std::f32::consts::TAU;
use tiny_skia::{FillRule, Mask, PathBuilder, Rect, Transform};

/// Gray of words and dots, and of what is behind them: nobody is dazzled in a dark room.
pub(super) const INK: u8 = 200;
pub(super) const PAPER: u8 = 16;
/// Dots of the wheel.
const DOTS: u32 = 8;
/// Side of a letter in letter pixels.
pub(super) const GLYPH: usize = 8;

/// Draws slates of one size. Words are drawn when they change, the wheel every time: a slate costs little while the
/// camera is away for days.
pub struct Slate {
    canvas: Rgb,
    beat: u32,
    /// What the canvas says now.
    lines: Vec<String>,
    /// The square of the wheel, and its top left corner on the canvas.
    wheel: Option<Mask>,
    corner: (usize, usize),
}

impl Slate {
    /// Slates of the pictures' size.
    pub fn new(size: Size) -> Self {
        let (x, y, radius) = wheel_of(size);
        let half = (radius * 1.3) as usize + 2;
        let corner = ((x as usize).saturating_sub(half), (y as usize).saturating_sub(half));
        let side = |from: usize, whole: usize| (2 * half).min(whole.saturating_sub(from)) as u32;
        let wheel = Mask::new(side(corner.0, size.width), side(corner.1, size.height));
        Self { canvas: Rgb::new(size, [PAPER; 3]), beat: 0, lines: Vec::new(), wheel, corner }
    }

    /// The next slate with these lines (ASCII), the first one large; its wheel has turned on by one dot.
    pub fn draw(&mut self, lines: &[&str]) -> &Rgb {
        self.beat = (self.beat + 1) % DOTS;
        if self.lines != lines {
            self.lines = lines.iter().map(ToString::to_string).collect();
            self.words();
        }
        self.turn();
        &self.canvas
    }

    /// A dark ground with the words.
    fn words(&mut self) {
        let size = self.canvas.size();
        for plane in &mut self.canvas.planes {
            plane.fill(PAPER);
        }
        let Some(mut mask) = Mask::new(size.width as u32, size.height as u32) else { return };
        let mut top = size.height as f32 * 0.6;
        for (number, line) in self.lines.iter().enumerate() {
            let least = if number == 0 { 16 } else { 32 };
            let zoom = (size.width / (GLYPH * line.len().max(least))).max(1) as f32;
            let left = (size.width as f32 - zoom * (GLYPH * line.len()) as f32) * 0.5;
            write(&mut mask, line, left, top, zoom);
            top += 1.6 * GLYPH as f32 * zoom;
        }
        ink(&mut self.canvas, &mask, (0, 0));
    }

    /// A wheel of dots, one larger than the others.
    fn turn(&mut self) {
        let (x, y, radius) = wheel_of(self.canvas.size());
        let Some(mask) = &mut self.wheel else { return };
        mask.clear();
        let mut path = PathBuilder::new();
        let (x, y) = (x - self.corner.0 as f32, y - self.corner.1 as f32);
        for dot in 0..DOTS {
            let turn = TAU * dot as f32 / DOTS as f32;
            let share = if dot == self.beat { 0.24 } else { 0.1 };
            path.push_circle(x + radius * libm::sinf(turn), y - radius * libm::cosf(turn), radius * share);
        }
        if let Some(path) = path.finish() {
            mask.fill_path(&path, FillRule::Winding, true, Transform::identity());
        }
        ink(&mut self.canvas, mask, self.corner);
    }
}

/// Center and radius of the wheel, px.
fn wheel_of(size: Size) -> (f32, f32, f32) {
    let (width, height) = (size.width as f32, size.height as f32);
    (width * 0.5, height * 0.38, width.min(height) * 0.1)
}

/// Ink where the mask is, paper elsewhere, in the mask's rectangle at `corner`.
fn ink(canvas: &mut Rgb, mask: &Mask, (left, top): (usize, usize)) {
    let width = mask.width() as usize;
    let blend = |ink: u8| {
        let (a, ink, paper) = (u32::from(ink), u32::from(INK), u32::from(PAPER));
        ((a * ink + (255 - a) * paper + 127) / 255) as u8
    };
    for (row, line) in mask.data().chunks_exact(width.max(1)).enumerate() {
        for plane in &mut canvas.planes {
            let pixels = plane.row_mut(top + row).iter_mut().skip(left);
            pixels.zip(line).for_each(|(pixel, &ink)| *pixel = blend(ink));
        }
    }
}

/// Writes a line, its letters `zoom` px a letter pixel.
fn write(mask: &mut Mask, line: &str, left: f32, top: f32, zoom: f32) {
    let mut path = PathBuilder::new();
    for (place, letter) in line.chars().enumerate() {
        let Some(rows) = BASIC_FONTS.get(letter) else { continue };
        for (y, row) in rows.into_iter().enumerate() {
            for x in (0..GLYPH).filter(|x| row >> x & 1 == 1) {
                let (x, y) = (left + zoom * (place * GLYPH + x) as f32, top + zoom * y as f32);
                if let Some(dot) = Rect::from_xywh(x, y, zoom, zoom) {
                    path.push_rect(dot);
                }
            }
        }
    }
    if let Some(path) = path.finish() {
        mask.fill_path(&path, FillRule::Winding, false, Transform::identity());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_there_and_the_wheel_turns() {
        for (width, height) in [(640, 480), (1280, 720), (64, 48), (1, 1)] {
            let mut slate = Slate::new(Size::new(width, height));
            let first = slate.draw(&["CAMERA LOST", "C1 - looking for it"]).clone();
            let second = slate.draw(&["CAMERA LOST", "C1 - looking for it"]).clone();
            let empty = Slate::new(Size::new(width, height)).draw(&[]).clone();
            let inked = |p: &Rgb| {
                p.planes[0].samples().iter().zip(empty.planes[0].samples()).filter(|(a, b)| a != b).count()
            };
            if width > 100 {
                assert_ne!(first, second, "a sign of life");
                assert!(inked(&first) > width * height / 200, "words");
                // the words rest, the wheel above them turns
                let words = height * 55 / 100;
                for row in words..height {
                    assert_eq!(first.planes[0].row(row), second.planes[0].row(row));
                }
                // what is drawn once is as what is drawn anew
                let mut other = Slate::new(Size::new(width, height));
                other.draw(&["NO PICTURE", "C2 - waiting for the camera"]);
                assert_eq!(*other.draw(&["CAMERA LOST", "C1 - looking for it"]), second);
            }
        }
    }
}
