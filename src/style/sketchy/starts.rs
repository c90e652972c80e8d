//! Where strokes may begin: random pixels, or the places of a file. Ordered by row, so that tracing walks down the
//! picture; how strokes were numbered is kept beside them.

use crate::geometry::Similarity;
use crate::pixels::{Size, SplitMix64, hash_noise};
use crate::style::lattice::{Window, place};
use crate::style::table::{self, TableError};
use glam::DVec2;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Most starts a file may hold.
const MOST: u64 = 1 << 22;
/// Coordinates in a file lie within this many px of 0.
const FARTHEST: f64 = 65536.0;

/// A place where a stroke may begin.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Start {
    /// x, y in px, pixel centers at integers.
    pub at: [f64; 2],
    /// Its number in drawing order.
    pub number: u32,
}

/// ⌊density · W · H⌋ random pixels of a picture, in drawing order.
pub fn random(size: Size, density: f64, seed: u64) -> impl Iterator<Item = [f64; 2]> {
    let count = (density * size.width as f64 * size.height as f64).floor() as usize;
    let mut rng = SplitMix64::new(seed);
    (0..count).map(move |_| {
        let x = rng.int(0, size.width as i64 - 1);
        [x as f64, rng.int(0, size.height as i64 - 1) as f64]
    })
}

/// As many random places of an endless plane as `density` says, those that lie in a picture of `size`, on its pixels;
/// `motion`: picture px → that plane.
pub fn anchored(size: Size, density: f64, seed: u64, motion: Similarity) -> impl Iterator<Item = [f64; 2]> {
    let side = 1.0 / density.max(1e-6).sqrt();
    let back = motion.inverse();
    let inside = DVec2::new(size.width as f64, size.height as f64);
    let window = if density > 0.0 { Window::over(&motion, size, side) } else { Window::default() };
    window.cells().filter_map(move |cell| {
        let at = (back.apply(place(cell, side, seed)) + 0.5).floor();
        (at.cmpge(DVec2::ZERO).all() && at.cmplt(inside).all()).then_some([at.x, at.y])
    })
}

/// The seed of frame number `frame`: the first frame has the seed itself.
pub fn seed_of(seed: u64, frame: u64) -> u64 {
    if frame == 0 { seed } else { hash_noise(0, 0, seed, frame) }
}

/// The starts of one frame, upper rows first.
#[derive(Debug, Default)]
pub struct Starts {
    numbered: Vec<Start>,
    ordered: Vec<Start>,
    /// Where each row begins.
    rows: Vec<usize>,
}

impl Starts {
    /// Makes room for this many.
    pub fn reserve(&mut self, most: usize) {
        for list in [&mut self.numbered, &mut self.ordered] {
            list.reserve(most.saturating_sub(list.len()));
        }
    }

    /// Takes these places. Allocates only to grow.
    pub fn fill(&mut self, height: usize, places: impl Iterator<Item = [f64; 2]>) {
        self.numbered.clear();
        self.numbered.extend((0..).zip(places).map(|(number, at)| Start { at, number }));
        // counting sort by row: stable, without allocating
        let row_of = |start: &Start| ((start.at[1] + 0.5).floor().max(0.0) as usize).min(height - 1);
        self.rows.clear();
        self.rows.resize(height + 1, 0);
        self.numbered.iter().for_each(|start| self.rows[row_of(start) + 1] += 1);
        for row in 0..height {
            self.rows[row + 1] += self.rows[row];
        }
        self.ordered.resize(self.numbered.len(), Start::default());
        for start in &self.numbered {
            let row = &mut self.rows[row_of(start)];
            self.ordered[*row] = *start;
            *row += 1;
        }
    }

    /// All of them, in drawing order.
    pub fn by_number(&self) -> &[Start] {
        &self.numbered
    }

    /// All of them, upper rows first.
    pub fn ordered(&self) -> &[Start] {
        &self.ordered
    }
}

/// The setting `starts`: a path whose file is read as soon as the setting is; "" for none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "PathBuf", into = "PathBuf")]
pub struct StartsFile {
    path: PathBuf,
    starts: Option<Arc<Vec<[f64; 2]>>>,
}

impl StartsFile {
    /// The starts, where a file is named.
    pub fn starts(&self) -> Option<&[[f64; 2]]> {
        self.starts.as_ref().map(|starts| starts.as_slice())
    }
}

impl From<StartsFile> for PathBuf {
    fn from(file: StartsFile) -> Self {
        file.path
    }
}

/// Why a file of starts is refused.
#[derive(Debug, thiserror::Error)]
pub enum StartsError {
    /// It is no such table.
    #[error(transparent)]
    Table(#[from] TableError),
    /// A coordinate is not a place.
    #[error("{path}: start {index} is at ({x}, {y}); coordinates lie within 65536 px of 0", path = path.display())]
    Place {
        /// The file.
        path: PathBuf,
        /// Which start, from 0.
        index: usize,
        /// Its x.
        x: f64,
        /// Its y.
        y: f64,
    },
}

impl TryFrom<PathBuf> for StartsFile {
    type Error = StartsError;

    fn try_from(path: PathBuf) -> Result<Self, StartsError> {
        if path.as_os_str().is_empty() {
            return Ok(Self::default());
        }
        let starts = Some(Arc::new(read(&path)?));
        Ok(Self { path, starts })
    }
}

fn read(path: &Path) -> Result<Vec<[f64; 2]>, StartsError> {
    let rows = table::read::<2>(path, 0..=MOST, "starts are")?;
    match rows.iter().position(|[x, y]| !(x.abs() < FARTHEST && y.abs() < FARTHEST)) {
        Some(index) => {
            Err(StartsError::Place { path: path.into(), index, x: rows[index][0], y: rows[index][1] })
        }
        None => Ok(rows),
    }
}
