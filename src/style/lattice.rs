//! Patterns without an edge: a square lattice over the whole plane, one place in every cell, found from the cell's
//! numbers alone. What a style draws on it can be carried along with the scene.

use crate::geometry::Similarity;
use crate::pixels::{Size, hash_noise};
use glam::DVec2;

/// A rectangle of cells, row by row.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Window {
    first: [i32; 2],
    count: [usize; 2],
}

impl Window {
    /// All cells of `side` that a picture of `size` shows, with one more all around; `motion`: picture px → pattern.
    pub fn over(motion: &Similarity, size: Size, side: f64) -> Self {
        let (right, bottom) = (size.width as f64 - 0.5, size.height as f64 - 0.5);
        let corners = [(-0.5, -0.5), (right, -0.5), (-0.5, bottom), (right, bottom)];
        let corners = corners.map(|(x, y)| motion.apply(DVec2::new(x, y)) / side);
        let low = corners.into_iter().fold(DVec2::INFINITY, DVec2::min).floor() - 1.0;
        let high = corners.into_iter().fold(DVec2::NEG_INFINITY, DVec2::max).floor() + 1.0;
        let cells = |low: f64, high: f64| (high - low + 1.0).clamp(0.0, 65536.0) as usize;
        let first = [low.x as i32, low.y as i32];
        Self { first, count: [cells(low.x, high.x), cells(low.y, high.y)] }
    }

    /// The cells' columns and rows.
    pub fn cells(self) -> impl Iterator<Item = [i32; 2]> {
        let [columns, rows] = self.count.map(|n| n as i32);
        (0..rows).flat_map(move |row| {
            (0..columns).map(move |column| [self.first[0] + column, self.first[1] + row])
        })
    }

    /// How many cells there are.
    pub fn len(self) -> usize {
        self.count[0] * self.count[1]
    }

    /// The place of a cell among the window's; `None` outside.
    pub fn index(self, [column, row]: [i32; 2]) -> Option<usize> {
        let (x, y) = (column.wrapping_sub(self.first[0]), row.wrapping_sub(self.first[1]));
        let inside = x >= 0 && y >= 0 && (x as usize) < self.count[0] && (y as usize) < self.count[1];
        inside.then(|| y as usize * self.count[0] + x as usize)
    }
}

/// The place in a cell, pattern px: anywhere in it, alike for a seed.
pub fn place([column, row]: [i32; 2], side: f64, seed: u64) -> DVec2 {
    let bits = hash_noise(column as u32, row as u32, seed, 0);
    let share = |bits: u64| (bits & 0xffff_ffff) as f64 / 4_294_967_296.0;
    DVec2::new(f64::from(column) + share(bits), f64::from(row) + share(bits >> 32)) * side
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_hold_every_place_in_the_picture() {
        let size = Size::new(64, 40);
        for motion in
            [Similarity::IDENTITY, Similarity { turn: DVec2::new(0.6, 1.1), shift: DVec2::new(-500.0, 33.0) }]
        {
            let window = Window::over(&motion, size, 8.0);
            assert_eq!(window.cells().count(), window.len());
            for (i, cell) in window.cells().enumerate() {
                assert_eq!(window.index(cell), Some(i));
            }
            let back = motion.inverse();
            for (x, y) in (0..40).flat_map(|y| (0..64).map(move |x| (x, y))) {
                let at = motion.apply(DVec2::new(f64::from(x), f64::from(y)));
                let cell = [(at.x / 8.0).floor() as i32, (at.y / 8.0).floor() as i32];
                assert!(window.index(cell).is_some(), "({x}, {y}) lies in cell {cell:?}");
                let place = place(cell, 8.0, 1) / 8.0;
                assert_eq!([place.x.floor() as i32, place.y.floor() as i32], cell);
                assert!(back.apply(place * 8.0).is_finite());
            }
        }
    }
}
