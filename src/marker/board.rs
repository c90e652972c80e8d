//! Rigid boards: prints whose places to each other are known.

use super::Family;
use crate::geometry::Pose;
use glam::{DMat3, DVec3};

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

/// A flat sheet of equal prints in rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grid {
    /// Family of all prints.
    pub family: Family,
    /// Number of the top-left print; the others count on along the rows.
    pub first: u32,
    /// Prints in a row, 1 or more.
    pub columns: u32,
    /// Rows, 1 or more.
    pub rows: u32,
    /// Printed side of the black borders' outer edges, mm, > 0.
    pub side_mm: f64,
}

impl Grid {
    /// White between neighboring prints, in sides: two cells of a 6x6 code.
    pub const GAP: f64 = 0.25;

    /// How many prints.
    pub fn count(&self) -> u32 {
        self.columns.saturating_mul(self.rows)
    }

    /// Width and height from the first print's outer edge to the last one's, mm.
    pub fn extent_mm(&self) -> [f64; 2] {
        [self.columns, self.rows].map(|n| self.side_mm * (f64::from(n) * (1.0 + Self::GAP) - Self::GAP))
    }

    /// The board; its origin is the middle of the sheet. `None` where the family has too few codes.
    pub fn board(&self) -> Option<Board> {
        let last = u64::from(self.first) + u64::from(self.count());
        if last > self.family.codes().len() as u64 {
            return None;
        }
        let pitch = self.side_mm * (1.0 + Self::GAP);
        let middle = |n: u32| 0.5 * f64::from(n - 1);
        let print = |k: u32| {
            let (column, row) = (f64::from(k % self.columns), f64::from(k / self.columns));
            let at = DVec3::new(column - middle(self.columns), middle(self.rows) - row, 0.0) * pitch;
            let to_board = Pose { rotation: DMat3::IDENTITY, translation: at };
            Print { family: self.family, id: self.first + k, side_mm: self.side_mm, to_board }
        };
        Some(Board { prints: (0..self.count()).map(print).collect() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_grid_counts_along_its_rows_from_the_top_left() {
        let grid = Grid { family: Family::Tag36h11, first: 5, columns: 3, rows: 2, side_mm: 40.0 };
        let board = grid.board().expect("enough codes");
        let at = |k: usize| (board.prints[k].id, board.prints[k].to_board.translation);
        assert_eq!(board.prints.len(), 6);
        assert_eq!(at(0), (5, DVec3::new(-50.0, 25.0, 0.0)));
        assert_eq!(at(5), (10, DVec3::new(50.0, -25.0, 0.0)));
        assert_eq!(grid.extent_mm(), [140.0, 90.0]);
        assert_eq!(Grid { first: 582, ..grid }.board(), None, "587 codes");
    }
}
