//! Where cells begin: the jittered grid, or the sites of a file.

use crate::kernel::voronoi::FARTHEST;
use crate::pixels::{Size, SplitMix64};
use crate::style::table::{self, TableError};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Sites in steps of 1/16 px: x, y in the continuous frame `[0,W]x[0,H]`.
pub type Sites = Vec<[i32; 2]>;

/// Most sites a file may hold.
const MOST: u64 = 1 << 20;

/// The sites a frame of `size` begins with: one in each cell of a grid, jittered by up to half a cell (section 3.1).
pub fn initial(size: Size, cell: u32, seed: u64) -> Sites {
    let mut rng = SplitMix64::new(seed);
    let across = |length: usize| (length / cell.max(1) as usize).max(1);
    let (columns, rows) = (across(size.width), across(size.height));
    let mut jittered = |length: usize, count: usize, i: usize| {
        let at = length as f64 / count as f64 * (i as f64 + 0.5 + (rng.f64() - 0.5));
        lattice(at)
    };
    let mut sites = Vec::with_capacity(columns * rows);
    for i in 0..rows {
        for j in 0..columns {
            let x = jittered(size.width, columns, j);
            sites.push([x, jittered(size.height, rows, i)]);
        }
    }
    sites
}

/// A coordinate in px to the nearest step of the lattice.
fn lattice(at: f64) -> i32 {
    (16.0 * at + 0.5).floor() as i32
}

/// The setting `sites`: a path whose file is read as soon as the setting is; "" for none.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "PathBuf", into = "PathBuf")]
pub struct SitesFile {
    path: PathBuf,
    sites: Option<Arc<Sites>>,
}

impl SitesFile {
    /// The sites, where a file is named.
    pub fn sites(&self) -> Option<&[[i32; 2]]> {
        self.sites.as_ref().map(|sites| sites.as_slice())
    }
}

impl From<SitesFile> for PathBuf {
    fn from(file: SitesFile) -> Self {
        file.path
    }
}

/// Why a file of sites is refused.
#[derive(Debug, thiserror::Error)]
pub enum SitesError {
    /// It is no such table.
    #[error(transparent)]
    Table(#[from] TableError),
    /// A coordinate is not a place.
    #[error("{path}: site {index} is at ({x}, {y}); coordinates lie within 65536 px of 0", path = path.display())]
    Place {
        /// The file.
        path: PathBuf,
        /// Which site, from 0.
        index: usize,
        /// Its x.
        x: f64,
        /// Its y.
        y: f64,
    },
}

impl TryFrom<PathBuf> for SitesFile {
    type Error = SitesError;

    fn try_from(path: PathBuf) -> Result<Self, SitesError> {
        if path.as_os_str().is_empty() {
            return Ok(Self::default());
        }
        let sites = Some(Arc::new(read(&path)?));
        Ok(Self { path, sites })
    }
}

fn read(path: &Path) -> Result<Sites, SitesError> {
    let rows = table::read::<2>(path, 1..=MOST, "sites are")?;
    let limit = f64::from(FARTHEST / 16);
    let site = |(index, [x, y]): (usize, [f64; 2])| match x.abs() < limit && y.abs() < limit {
        true => Ok([lattice(x), lattice(y)]),
        false => Err(SitesError::Place { path: path.into(), index, x, y }),
    };
    rows.into_iter().enumerate().map(site).collect()
}
