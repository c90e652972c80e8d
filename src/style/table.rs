//! Tables of numbers that settings name as .npy files: sites, starts, grids.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

/// Why a table is refused.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// It cannot be read, or it is not .npy.
    #[error("{path}: cannot read it as .npy: {reason}", path = path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The system's word.
        reason: String,
    },
    /// It has another shape or other numbers.
    #[error("{path}: {what} an N x {columns} array of f64 or f32, N from {least} to {most}, rows first", path = path.display())]
    Shape {
        /// The file.
        path: PathBuf,
        /// What it should hold, with its verb.
        what: &'static str,
        /// Numbers in a row.
        columns: usize,
        /// Fewest rows.
        least: u64,
        /// Most rows.
        most: u64,
    },
}

/// The rows of an N x `K` array of f64 or f32, N within `rows`; `what` it holds begins the refusal ("sites are").
pub fn read<const K: usize>(
    path: &Path,
    rows: RangeInclusive<u64>,
    what: &'static str,
) -> Result<Vec<[f64; K]>, TableError> {
    let unreadable = |e: std::io::Error| TableError::Unreadable { path: path.into(), reason: e.to_string() };
    let (least, most) = (*rows.start(), *rows.end());
    let shape = || TableError::Shape { path: path.into(), what, columns: K, least, most };
    let file = std::fs::File::open(path).map_err(unreadable)?;
    let array = npyz::NpyFile::new(std::io::BufReader::new(file)).map_err(unreadable)?;
    let fine = matches!(*array.shape(), [n, k] if rows.contains(&n) && k == K as u64);
    if !fine || array.order() != npyz::Order::C {
        return Err(shape());
    }
    let values: Vec<f64> = match array.try_data::<f64>() {
        Ok(values) => values.collect::<Result<_, _>>().map_err(unreadable)?,
        Err(array) => {
            let values = array.try_data::<f32>().map_err(|_| shape())?;
            values.map(|value| value.map(f64::from)).collect::<Result<_, _>>().map_err(unreadable)?
        }
    };
    Ok(values.as_chunks::<K>().0.to_vec())
}
