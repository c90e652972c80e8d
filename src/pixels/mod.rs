//! The ground floor: planes of pixels, strided views, planar RGB, tiles, hash noise and the SIMD level.
//!
//! Comes in: nothing; goes out: the containers that every other room reads and writes. A `Plane` owns its
//! samples, `PlaneRef`/`PlaneMut` borrow a (possibly strided) rectangle of someone's samples. Row padding
//! is junk by contract: no kernel may read it. This room never computes on pixel values.

mod noise;
pub mod picture;
mod plane;
mod rgb;
pub mod simd;
mod tiles;

pub use noise::{SplitMix64, hash_noise};
pub use plane::{Plane, PlaneMut, PlaneRef};
pub use rgb::Rgb;
pub use tiles::{Rect, TILE, TileGrid, TileSet};

/// Width and height in pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Size {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Size {
    /// `width` x `height` pixels.
    pub const fn new(width: usize, height: usize) -> Self {
        Self { width, height }
    }

    /// Number of pixels.
    pub const fn area(self) -> usize {
        self.width * self.height
    }
}

impl std::fmt::Display for Size {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}
