//! A folder of numbered PNG files.

use super::{DisplayError, write_error};
use crate::pixels::{Rgb, picture};
use std::path::{Path, PathBuf};

/// Writes `frame-000000.png`, `frame-000001.png`, ... into a folder; sizes may differ.
#[derive(Debug)]
pub struct PngDir {
    folder: PathBuf,
    next: u64,
}

impl PngDir {
    /// Makes the folder where it is missing; pictures of the same names are overwritten.
    pub fn create(folder: &Path) -> Result<Self, DisplayError> {
        std::fs::create_dir_all(folder).map_err(|e| write_error(folder, e))?;
        Ok(Self { folder: folder.into(), next: 0 })
    }

    /// Writes the next picture.
    pub fn write(&mut self, canvas: &Rgb) -> Result<(), DisplayError> {
        let path = self.folder.join(format!("frame-{:06}.png", self.next));
        picture::write_png(&path, canvas)?;
        self.next += 1;
        Ok(())
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.folder
    }
}
