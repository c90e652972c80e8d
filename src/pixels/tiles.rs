//! Tiles of 64 x 64 pixels: the unit of "what was touched" and "what can be skipped".

use super::Size;

/// Side of a tile in pixels.
pub const TILE: usize = 64;

/// A rectangle of pixels, `x0 <= x < x1`, `y0 <= y < y1`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rect {
    /// First column.
    pub x0: usize,
    /// First row.
    pub y0: usize,
    /// Column after the last.
    pub x1: usize,
    /// Row after the last.
    pub y1: usize,
}

/// How a picture divides into tiles: row by row, the last column and row may be cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileGrid {
    size: Size,
}

impl TileGrid {
    /// The grid over a picture of this size.
    pub fn new(size: Size) -> Self {
        Self { size }
    }

    /// Tiles in a row.
    pub fn columns(&self) -> usize {
        self.size.width.div_ceil(TILE)
    }

    /// Rows of tiles.
    pub fn rows(&self) -> usize {
        self.size.height.div_ceil(TILE)
    }

    /// Number of tiles.
    pub fn count(&self) -> usize {
        self.columns() * self.rows()
    }

    /// The pixels of tile `index` (row by row), cut to the picture.
    pub fn rect(&self, index: usize) -> Rect {
        let (x0, y0) = (index % self.columns() * TILE, index / self.columns() * TILE);
        Rect { x0, y0, x1: (x0 + TILE).min(self.size.width), y1: (y0 + TILE).min(self.size.height) }
    }
}

/// A set of tiles of one grid.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TileSet {
    words: Vec<u64>,
}

impl TileSet {
    /// The empty set over `grid`.
    pub fn new(grid: TileGrid) -> Self {
        Self { words: vec![0; grid.count().div_ceil(64)] }
    }

    /// Empties the set and fits it to `grid`; allocates only to grow.
    pub fn reset(&mut self, grid: TileGrid) {
        self.words.clear();
        self.words.resize(grid.count().div_ceil(64), 0);
    }

    /// Adds tile `index`.
    pub fn insert(&mut self, index: usize) {
        self.words[index / 64] |= 1 << (index % 64);
    }

    /// Whether tile `index` is in the set.
    pub fn contains(&self, index: usize) -> bool {
        self.words.get(index / 64).is_some_and(|word| word >> (index % 64) & 1 == 1)
    }

    /// Adds all tiles of another set of the same grid.
    pub fn union(&mut self, other: &TileSet) {
        for (mine, theirs) in self.words.iter_mut().zip(&other.words) {
            *mine |= theirs;
        }
    }

    /// Number of tiles in the set.
    pub fn len(&self) -> usize {
        self.words.iter().map(|word| word.count_ones() as usize).sum()
    }

    /// Whether no tile is in the set.
    pub fn is_empty(&self) -> bool {
        self.words.iter().all(|&word| word == 0)
    }

    /// The tiles in the set, lowest first.
    pub fn iter(&self) -> impl Iterator<Item = usize> {
        self.words
            .iter()
            .enumerate()
            .flat_map(|(i, &word)| (0..64).filter(move |b| word >> b & 1 == 1).map(move |b| i * 64 + b))
    }
}
