//! Rigid boards: prints whose places to each other are known.

use super::Family;
use crate::geometry::Pose;

/// One print of a board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Print {
    /// Its family.
    pub family: Family,
    /// Its number.
    pub id: u32,
    /// Printed side of the black border's outer edge, mm.
    pub side_mm: f64,
    /// Its marker space → the board's, mm.
    pub to_board: Pose,
}

/// Prints fixed to one another: on a sheet, on the sides of a box. No print is named twice.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Board {
    /// The prints.
    pub prints: Vec<Print>,
}
