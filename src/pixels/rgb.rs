//! Planar 8-bit RGB: gamma-coded sRGB values, three planes of one size.

use super::{Plane, Size};

/// A picture as three 8-bit planes of one size (red, green, blue), gamma-coded sRGB.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rgb {
    /// Red, green, blue.
    pub planes: [Plane<u8>; 3],
}

impl Rgb {
    /// A picture of one color.
    pub fn new(size: Size, color: [u8; 3]) -> Self {
        Self { planes: color.map(|value| Plane::new(size, value)) }
    }

    /// Width and height.
    pub fn size(&self) -> Size {
        self.planes[0].size()
    }

    /// Gives the picture this size; see [`Plane::resize`].
    pub fn resize(&mut self, size: Size) {
        for plane in &mut self.planes {
            plane.resize(size, 0);
        }
    }

    /// The color at column `x`, row `y`. Panics outside.
    pub fn at(&self, x: usize, y: usize) -> [u8; 3] {
        [0, 1, 2].map(|c| self.planes[c].at(x, y))
    }

    /// Sets the color at column `x`, row `y`. Panics outside.
    pub fn set(&mut self, x: usize, y: usize, color: [u8; 3]) {
        for (plane, value) in self.planes.iter_mut().zip(color) {
            plane.row_mut(y)[x] = value;
        }
    }

    /// Copies another picture of the same size without allocating; takes its size otherwise.
    pub fn copy_from(&mut self, other: &Rgb) {
        self.resize(other.size());
        for (to, from) in self.planes.iter_mut().zip(&other.planes) {
            for y in 0..from.size().height {
                to.row_mut(y).copy_from_slice(from.row(y));
            }
        }
    }
}
