//! The grid of sampling points: where strokes go, how large they are and how their color is changed (section 3.4.2),
//! in drawing order.

use crate::pixels::{Size, SplitMix64};
use crate::style::table::{self, TableError};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Largest radius of a stroke, px.
pub(super) const MAX_RADIUS: u32 = 64;
/// Farthest a site may lie from the frame's origin, px.
const FARTHEST: f64 = 65535.0;
/// Most sites a file may hold.
const MOST: u64 = 1 << 22;

/// One sampling point (Table 3.4).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Site {
    /// Column of the pixel it lies on; may be outside the frame.
    pub x: i32,
    /// Row of the pixel it lies on; may be outside the frame.
    pub y: i32,
    /// The stroke covers `2·radius + 1` pixels across and down.
    pub radius: u32,
    /// What is added to R, G, B, in shares of full brightness.
    pub offset: [f64; 3],
}

impl Site {
    /// As a row of a grid file: x, y, radius, dr, dg, db.
    pub fn to_row(&self) -> [f64; 6] {
        let [r, g, b] = self.offset;
        [f64::from(self.x), f64::from(self.y), f64::from(self.radius), r, g, b]
    }
}

/// What a grid is made from (eq. 3.11).
#[derive(Clone, Copy, Debug)]
pub(super) struct Spread {
    /// `colSkip` and `rowSkip`: steps of the regular grid, px.
    pub skip: [u32; 2],
    /// Farthest a site is moved from it along each axis, px.
    pub range: u32,
    /// Smallest and largest radius, px.
    pub radius: [u32; 2],
    /// Largest change of a color channel.
    pub color_offset: f64,
    /// Where the random numbers begin.
    pub seed: u64,
}

impl Spread {
    /// The sites of a frame of `size`, shuffled into the order they are drawn in.
    pub fn sites(&self, size: Size) -> Vec<Site> {
        let mut rng = SplitMix64::new(self.seed);
        let [columns, rows] = [(size.width, 0), (size.height, 1)]
            .map(|(length, axis)| length.div_ceil(self.skip[axis].max(1) as usize));
        let range = i64::from(self.range);
        let [least, most] = self.radius.map(i64::from);
        let mut sites = Vec::with_capacity(columns * rows);
        for row in 0..rows {
            for column in 0..columns {
                let x = (column * self.skip[0] as usize) as i64 + rng.int(-range, range);
                let y = (row * self.skip[1] as usize) as i64 + rng.int(-range, range);
                let radius = rng.int(least, most) as u32;
                let offset = [(); 3].map(|()| (2.0 * rng.f64() - 1.0) * self.color_offset);
                sites.push(Site { x: x as i32, y: y as i32, radius, offset });
            }
        }
        // Fisher & Yates, from the end
        for k in (1..sites.len()).rev() {
            sites.swap(k, (rng.next_u64() % (k as u64 + 1)) as usize);
        }
        sites
    }
}

/// The setting `grid`: a path whose file is read as soon as the setting is; "" for none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "PathBuf", into = "PathBuf")]
pub struct GridFile {
    path: PathBuf,
    sites: Option<Arc<Vec<Site>>>,
}

impl GridFile {
    /// The sites in drawing order, where a file is named.
    pub fn sites(&self) -> Option<&[Site]> {
        self.sites.as_ref().map(|sites| sites.as_slice())
    }
}

impl From<GridFile> for PathBuf {
    fn from(file: GridFile) -> Self {
        file.path
    }
}

/// Why a grid file is refused.
#[derive(Debug, thiserror::Error)]
pub enum GridError {
    /// It is no such table.
    #[error(transparent)]
    Table(#[from] TableError),
    /// A number is outside its range.
    #[error("{path}: site {index}: {name} is {value}, not {expected}", path = path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// Which site, from 0.
        index: usize,
        /// Which of its numbers.
        name: &'static str,
        /// The number.
        value: f64,
        /// The allowed range.
        expected: &'static str,
    },
}

impl TryFrom<PathBuf> for GridFile {
    type Error = GridError;

    fn try_from(path: PathBuf) -> Result<Self, GridError> {
        if path.as_os_str().is_empty() {
            return Ok(Self::default());
        }
        let sites = Some(Arc::new(read(&path)?));
        Ok(Self { path, sites })
    }
}

fn read(path: &Path) -> Result<Vec<Site>, GridError> {
    let rows = table::read::<6>(path, 1..=MOST, "a grid (x, y, radius, dr, dg, db) is")?;
    rows.into_iter().enumerate().map(|(index, row)| site(path, index, row)).collect()
}

fn site(path: &Path, index: usize, row: [f64; 6]) -> Result<Site, GridError> {
    let [x, y, radius, offset @ ..] = row;
    let whole = |v: f64, low: f64, high: f64| v >= low && v <= high && v == v.floor();
    let check = |name, value, fine, expected| match fine {
        true => Ok(()),
        false => Err(GridError::Value { path: path.into(), index, name, value, expected }),
    };
    for (name, value) in [("x", x), ("y", y)] {
        check(name, value, whole(value, -FARTHEST, FARTHEST), "a whole number within 65535 px of 0")?;
    }
    let fits = whole(radius, 0.0, f64::from(MAX_RADIUS));
    check("radius", radius, fits, "a whole number from 0 to 64 px")?;
    for (name, value) in ["dr", "dg", "db"].into_iter().zip(offset) {
        check(name, value, (-1.0..=1.0).contains(&value), "from -1 to 1")?;
    }
    Ok(Site { x: x as i32, y: y as i32, radius: radius as u32, offset })
}
