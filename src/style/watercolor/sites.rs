//! Where cells begin: the jittered grid, or the sites of a file.

use crate::kernel::voronoi::FARTHEST;
use crate::pixels::{Size, SplitMix64};
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
    /// It cannot be read, or it is not .npy.
    #[error("{path}: cannot read it as .npy: {reason}", path = path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The system's word.
        reason: String,
    },
    /// It holds something else than sites.
    #[error("{path}: sites are an N x 2 array of f64 or f32, N from 1 to 1048576, rows first", path = path.display())]
    Shape {
        /// The file.
        path: PathBuf,
    },
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
    let unreadable = |e: std::io::Error| SitesError::Unreadable { path: path.into(), reason: e.to_string() };
    let shape = || SitesError::Shape { path: path.into() };
    let file = std::fs::File::open(path).map_err(unreadable)?;
    let array = npyz::NpyFile::new(std::io::BufReader::new(file)).map_err(unreadable)?;
    let fine = matches!(*array.shape(), [1..=MOST, 2]) && array.order() == npyz::Order::C;
    if !fine {
        return Err(shape());
    }
    let values: Vec<f64> = match array.try_data::<f64>() {
        Ok(values) => values.collect::<Result<_, _>>().map_err(unreadable)?,
        Err(array) => {
            let values = array.try_data::<f32>().map_err(|_| shape())?;
            values.map(|value| value.map(f64::from)).collect::<Result<_, _>>().map_err(unreadable)?
        }
    };
    let limit = f64::from(FARTHEST / 16);
    let site = |(index, &[x, y]): (usize, &[f64; 2])| match x.abs() < limit && y.abs() < limit {
        true => Ok([lattice(x), lattice(y)]),
        false => Err(SitesError::Place { path: path.into(), index, x, y }),
    };
    values.as_chunks::<2>().0.iter().enumerate().map(site).collect()
}
