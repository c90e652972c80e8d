//! How a camera sees: its lens solved from pictures of a flat sheet of markers, and the files that keep it.
//!
//! Comes in: for each picture, where points of the sheet are seen ([`View`]); goes out: the [`Calibration`], or what
//! is missing to decide it. `start` gives the first guess, `solve` with its `equations` the best fit, `file` and `yaml` read and write.
//! Nothing here knows markers or pictures.

mod equations;
mod file;
mod solve;
mod start;
mod yaml;

pub use file::{FileError, LensConfig, LensError};
pub use solve::{Calibration, Fitted, PARTS, Undetermined, solve};
pub use start::homography;

use glam::DVec2;

/// A point of the sheet and where it is seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// On the sheet: right, up, mm.
    pub sheet_mm: DVec2,
    /// In the picture: pixel centers at integers.
    pub px: DVec2,
}

/// What one picture shows of the sheet.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct View {
    /// Its points.
    pub points: Vec<Point>,
}
