//! The setting that is a brush: a gray picture whose brightness is opacity.

use crate::pixels::{Plane, Size, picture};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::Arc;

/// Longest side of a brush picture, px.
const LONGEST: usize = 4096;

/// A path whose picture is read as soon as the setting is; "" for the style's own brush.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "PathBuf", into = "PathBuf")]
pub struct BrushFile {
    path: PathBuf,
    mask: Option<Arc<Plane<u8>>>,
}

impl BrushFile {
    /// Opacity, 255 = covered; `built_in` where no file is set.
    pub fn mask<'a>(&'a self, built_in: &'a Plane<u8>) -> &'a Plane<u8> {
        self.mask.as_deref().unwrap_or(built_in)
    }
}

impl From<BrushFile> for PathBuf {
    fn from(file: BrushFile) -> Self {
        file.path
    }
}

/// Why a brush picture is refused.
#[derive(Debug, thiserror::Error)]
pub enum BrushError {
    /// It is not a picture.
    #[error(transparent)]
    Picture(#[from] picture::PictureError),
    /// It is too large for a brush.
    #[error("{path}: {size} px is too large for a brush; at most 4096x4096", path = path.display())]
    Large {
        /// The file.
        path: PathBuf,
        /// Its size.
        size: Size,
    },
}

impl TryFrom<PathBuf> for BrushFile {
    type Error = BrushError;

    fn try_from(path: PathBuf) -> Result<Self, BrushError> {
        if path.as_os_str().is_empty() {
            return Ok(Self::default());
        }
        let mask = picture::read_gray(&path)?;
        let size = mask.size();
        if size.width.max(size.height) > LONGEST {
            return Err(BrushError::Large { path, size });
        }
        Ok(Self { path, mask: Some(Arc::new(mask)) })
    }
}
