//! The paper: a gray texture, tiled from the top left, that the picture is multiplied by.

use crate::pixels::{Plane, Size, hash_noise, picture};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;

/// Side of the built-in paper, px.
const SIDE: usize = 256;
/// Longest side of a paper picture, px.
const LONGEST: usize = 8192;

/// The setting `paper`: a truth value, or a path whose picture is read as soon as the setting is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Written", into = "Written")]
pub struct Paper {
    written: Written,
    texture: Option<Arc<Plane<u8>>>,
}

/// The setting as it stands in a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "write true, false, or the path of a gray picture")]
enum Written {
    Switch(bool),
    Path(PathBuf),
}

impl Paper {
    /// The texture, 255 = white; `None` without paper.
    pub fn texture(&self) -> Option<&Plane<u8>> {
        self.texture.as_deref()
    }
}

impl Default for Paper {
    fn default() -> Self {
        Self { written: Written::Switch(true), texture: Some(Arc::new(built_in())) }
    }
}

impl From<Paper> for Written {
    fn from(paper: Paper) -> Self {
        paper.written
    }
}

/// Why a paper picture is refused.
#[derive(Debug, thiserror::Error)]
enum PaperError {
    #[error(transparent)]
    Picture(#[from] picture::PictureError),
    #[error("{path}: {size} px is too large for a paper; at most 8192x8192", path = path.display())]
    Large { path: PathBuf, size: Size },
}

impl TryFrom<Written> for Paper {
    type Error = PaperError;

    fn try_from(written: Written) -> Result<Self, PaperError> {
        let texture = match &written {
            Written::Switch(true) => return Ok(Self::default()),
            Written::Switch(false) => None,
            Written::Path(path) => {
                let texture = picture::read_gray(path)?;
                let size = texture.size();
                if size.width.max(size.height) > LONGEST {
                    return Err(PaperError::Large { path: path.clone(), size });
                }
                Some(Arc::new(texture))
            }
        };
        Ok(Self { written, texture })
    }
}

/// Rough drawing paper: lumps of several sizes under a fine grain, from .72 to 1.
fn built_in() -> Plane<u8> {
    let noise = |x: usize, y: usize, octave: u64| {
        (hash_noise(x as u32, y as u32, octave, 0) >> 40) as f64 / (1u64 << 24) as f64
    };
    // noise on a lattice of `cell` px, smooth in between, repeating after SIDE
    let lumps = |x: usize, y: usize, cell: usize, octave: u64| {
        let smooth = |i: usize| {
            let t = (i % cell) as f64 / cell as f64;
            t * t * (3.0 - 2.0 * t)
        };
        let count = SIDE / cell;
        let ([x0, y0], [u, v]) = ([x / cell, y / cell], [smooth(x), smooth(y)]);
        let (x1, y1) = ((x0 + 1) % count, (y0 + 1) % count);
        let above = noise(x0, y0, octave) * (1.0 - u) + noise(x1, y0, octave) * u;
        let below = noise(x0, y1, octave) * (1.0 - u) + noise(x1, y1, octave) * u;
        above * (1.0 - v) + below * v
    };
    Plane::from_fn(Size::new(SIDE, SIDE), |x, y| {
        let rough = 0.4 * lumps(x, y, 4, 1)
            + 0.25 * lumps(x, y, 16, 2)
            + 0.1 * lumps(x, y, 64, 3)
            + 0.25 * noise(x, y, 0);
        ((1.0 - 0.28 * rough) * 255.0 + 0.5).floor() as u8
    })
}
