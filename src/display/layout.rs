//! How the canvas lies on the screen: turned, mirrored, once or side by side for two lenses, scaled.

use super::{Filter, Scale};
use crate::pixels::{Rgb, Size};
use rayon::prelude::*;
use serde::Deserialize;

/// Rows per task, and the side of the squares that a quarter turn is made in: they stay in the nearest cache.
const BAND: usize = 32;

/// Where every pixel of the canvas goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Layout {
    /// How it is scaled.
    pub scale: Scale,
    /// How a scaled one is sampled.
    pub filter: Filter,
    /// How it is turned.
    pub rotate: Rotate,
    /// Whether left and right change places, after turning.
    pub mirror: bool,
    /// Whether it is shown twice, in the left and the right half of the screen.
    pub stereo: bool,
}

impl From<(Scale, Filter)> for Layout {
    fn from((scale, filter): (Scale, Filter)) -> Self {
        Self { scale, filter, ..Self::default() }
    }
}

impl Layout {
    /// The canvas's size when it is turned.
    pub fn turned(&self, canvas: Size) -> Size {
        match self.rotate {
            Rotate::None | Rotate::Half => canvas,
            Rotate::Right | Rotate::Left => Size::new(canvas.height, canvas.width),
        }
    }

    /// The part of a screen of `mode` pixels that shows one picture; with stereo an odd last column stays black.
    pub fn eye(&self, mode: Size) -> Size {
        Size::new(if self.stereo { mode.width / 2 } else { mode.width }, mode.height)
    }

    /// The mode that shows the whole canvas pixel for pixel.
    pub fn mode(&self, canvas: Size) -> Size {
        let turned = self.turned(canvas);
        Size::new(turned.width * (1 + usize::from(self.stereo)), turned.height)
    }

    /// What a screen of `mode` pixels shows of the canvas.
    pub fn seen(&self, canvas: Size, mode: Size) -> Seen {
        let (turned, eye) = (self.turned(canvas), self.eye(mode));
        match self.scale {
            Scale::OneToOne => {
                let part = Size::new(turned.width.min(eye.width), turned.height.min(eye.height));
                // turned back, which is as far
                Seen { size: self.turned(part), shrink: 1 }
            }
            Scale::Fit => {
                let share = |from: usize, to: usize| from.div_ceil(to.max(1)).max(1);
                let shrink = share(turned.width, eye.width).max(share(turned.height, eye.height));
                Seen { size: canvas, shrink }
            }
        }
    }

    /// Whether the canvas is not shown the way it is.
    pub fn turns(&self) -> bool {
        self.rotate != Rotate::None || self.mirror
    }

    /// The canvas's pixel that lands on `x`, `y` of the turned one.
    fn source(&self, canvas: Size, x: usize, y: usize) -> (usize, usize) {
        let turned = self.turned(canvas);
        let x = if self.mirror { turned.width - 1 - x } else { x };
        match self.rotate {
            Rotate::None => (x, y),
            Rotate::Right => (y, canvas.height - 1 - x),
            Rotate::Half => (canvas.width - 1 - x, canvas.height - 1 - y),
            Rotate::Left => (canvas.width - 1 - y, x),
        }
    }

    /// Turns a canvas; `out` takes its size. Allocates only to grow.
    pub fn turn(&self, canvas: &Rgb, out: &mut Rgb) {
        let (from, to) = (canvas.size(), self.turned(canvas.size()));
        out.resize(to);
        let crosswise = matches!(self.rotate, Rotate::Right | Rotate::Left);
        for (input, output) in canvas.planes.iter().zip(&mut out.planes) {
            output.view_mut().par_bands(BAND).for_each(|(first, mut band)| {
                let rows = band.size().height;
                if crosswise {
                    for left in (0..to.width).step_by(BAND) {
                        let columns = left..(left + BAND).min(to.width);
                        for y in 0..rows {
                            let out = &mut band.row_mut(y)[columns.clone()];
                            for (x, out) in columns.clone().zip(out) {
                                let (sx, sy) = self.source(from, x, first + y);
                                *out = input.at(sx, sy);
                            }
                        }
                    }
                    return;
                }
                for y in 0..rows {
                    // whole rows, forward or backward
                    let (sx, sy) = self.source(from, 0, first + y);
                    let line = input.row(sy);
                    let out = band.row_mut(y);
                    if sx == 0 {
                        out.copy_from_slice(line);
                    } else {
                        out.iter_mut().zip(line.iter().rev()).for_each(|(out, &v)| *out = v);
                    }
                }
            });
        }
    }
}

/// The part of a canvas that a screen shows: what is to be read lies in it, in strokes wide enough.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seen {
    /// Size of the part, px of the canvas, in whose middle it lies.
    pub size: Size,
    /// So many pixels of the canvas in a row, at most, become one of the screen's; 1 or more.
    pub shrink: usize,
}

impl Seen {
    /// All of a canvas of this size, as it is.
    pub fn all(size: Size) -> Self {
        Self { size, shrink: 1 }
    }
}

/// A turn clockwise, in settings as its degrees: 0, 90, 180 or 270.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(try_from = "i64")]
pub enum Rotate {
    /// As it is.
    #[default]
    None,
    /// A quarter to the right.
    Right,
    /// Upside down.
    Half,
    /// A quarter to the left.
    Left,
}

impl TryFrom<i64> for Rotate {
    type Error = String;

    fn try_from(degrees: i64) -> Result<Self, String> {
        match degrees {
            0 => Ok(Rotate::None),
            90 => Ok(Rotate::Right),
            180 => Ok(Rotate::Half),
            270 => Ok(Rotate::Left),
            _ => Err(format!("rotate = {degrees}: give 0, 90, 180 or 270 (degrees clockwise)")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pixels::Plane;

    const TURNS: [Rotate; 4] = [Rotate::None, Rotate::Right, Rotate::Half, Rotate::Left];

    /// Red: the column, green: the row; both tell where a pixel comes from.
    fn map(size: Size) -> Rgb {
        let plane = |f: fn(usize, usize) -> usize| Plane::from_fn(size, |x, y| f(x, y) as u8);
        Rgb { planes: [plane(|x, _| x), plane(|_, y| y), plane(|x, y| x ^ y)] }
    }

    /// By matrices about the middle, in f64: turn by -angle takes a screen pixel back to the canvas.
    fn reference(layout: Layout, canvas: Size, x: usize, y: usize) -> (usize, usize) {
        let turned = layout.turned(canvas);
        let middle = |size: Size| ((size.width as f64 - 1.0) / 2.0, (size.height as f64 - 1.0) / 2.0);
        let ((cx, cy), (mx, my)) = (middle(turned), middle(canvas));
        let mut dx = x as f64 - cx;
        let dy = y as f64 - cy;
        if layout.mirror {
            dx = -dx;
        }
        let quarters = TURNS.iter().position(|turn| *turn == layout.rotate).expect("listed");
        let (mut dx, mut dy) = (dx, dy);
        for _ in 0..quarters {
            // clockwise on a screen, y down: (1, 0) goes to (0, 1), so back: (x, y) -> (y, -x)
            (dx, dy) = (dy, -dx);
        }
        ((mx + dx).round() as usize, (my + dy).round() as usize)
    }

    #[test]
    fn every_turn_and_mirror_matches_the_plain_reference() {
        for size in [(7, 5), (64, 48), (33, 70), (1, 9), (1, 1)].map(|(w, h)| Size::new(w, h)) {
            let (canvas, mut out) = (map(size), Rgb::default());
            for rotate in TURNS {
                for mirror in [false, true] {
                    let layout = Layout { rotate, mirror, ..Layout::default() };
                    layout.turn(&canvas, &mut out);
                    for y in 0..out.size().height {
                        for x in 0..out.size().width {
                            let (sx, sy) = reference(layout, size, x, y);
                            assert_eq!(out.at(x, y), canvas.at(sx, sy), "{layout:?} {size} at {x},{y}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn four_quarters_and_two_mirrors_are_nothing() {
        let canvas = map(Size::new(40, 23));
        let right = Layout { rotate: Rotate::Right, ..Layout::default() };
        let (mut a, mut b) = (canvas.clone(), Rgb::default());
        for _ in 0..2 {
            right.turn(&a, &mut b);
            right.turn(&b, &mut a);
        }
        assert_eq!(a, canvas);
        let mirror = Layout { mirror: true, ..Layout::default() };
        mirror.turn(&canvas, &mut b);
        mirror.turn(&b, &mut a);
        assert_eq!(a, canvas);
    }

    #[test]
    fn sizes_of_turned_and_doubled_pictures() {
        let size = Size::new(640, 480);
        let layout = Layout { rotate: Rotate::Left, stereo: true, ..Layout::default() };
        assert_eq!((layout.turned(size), layout.mode(size)), (Size::new(480, 640), Size::new(960, 640)));
        assert_eq!(layout.eye(Size::new(1281, 720)), Size::new(640, 720));
        let seen = |layout: Layout, width, height| {
            let Seen { size, shrink } = layout.seen(size, Size::new(width, height));
            (size.width, size.height, shrink)
        };
        // turned by a quarter and twice: an eye of 480 x 300 pixels sees 300 of the canvas's 640 columns
        assert_eq!(seen(layout, 960, 300), (300, 480, 1));
        assert_eq!(seen(layout, 4000, 3000), (640, 480, 1));
        let fit = Layout { scale: Scale::Fit, ..layout };
        assert_eq!((seen(fit, 480, 640), seen(fit, 960, 300)), ((640, 480, 2), (640, 480, 3)));
        assert_eq!(seen(fit, 4000, 3000), (640, 480, 1));
        assert!(Rotate::try_from(45).is_err_and(|e| e.contains("0, 90, 180 or 270")));
    }
}
