//! What model files name or carry besides triangles: other files beside them, and textures, decoded within limits.
//! What cannot be had is logged and done without.

use super::{Limits, ModelError, load};
use crate::pixels::{Rgb, picture};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The textures of one model, each file decoded once.
pub(super) struct Textures<'a> {
    limits: &'a Limits,
    /// Where the model lies: names in it are relative to here. `None` = nowhere: nothing beside it is read.
    folder: Option<&'a Path>,
    /// Pixels that may still be decoded.
    left: u64,
    files: HashMap<PathBuf, Option<Arc<Rgb>>>,
}

impl<'a> Textures<'a> {
    pub fn new(limits: &'a Limits, folder: Option<&'a Path>) -> Self {
        Self { limits, folder, left: limits.texels, files: HashMap::new() }
    }

    /// The bytes of the file that a model calls `name`. Only of a plain file: a name may not make us wait on a pipe.
    pub fn bytes(&self, name: &str) -> Option<Result<Vec<u8>, ModelError>> {
        let path = self.path(name)?;
        let fail = |reason| ModelError::Read { path: path.clone(), reason };
        Some(match std::fs::metadata(&path) {
            Ok(about) if about.is_file() => load::read(&path, self.limits),
            Ok(_) => Err(fail(std::io::Error::other("not a file"))),
            Err(reason) => Err(fail(reason)),
        })
    }

    fn path(&self, name: &str) -> Option<PathBuf> {
        self.folder.map(|folder| folder.join(name.replace('\\', "/")))
    }

    /// The picture file that a model calls `name`; `None` is logged.
    pub fn file(&mut self, name: &str) -> Option<Arc<Rgb>> {
        let path = self.path(name)?;
        if let Some(known) = self.files.get(&path) {
            return known.clone();
        }
        let texture = match self.bytes(name)? {
            Ok(bytes) => self.decode(&path.display().to_string(), &bytes),
            Err(error) => {
                log::warn!("{error}; drawing without this texture");
                None
            }
        };
        self.files.insert(path, texture.clone());
        texture
    }

    /// A PNG or JPEG file's bytes, called `name` in messages; `None` is logged.
    pub fn decode(&mut self, name: &str, bytes: &[u8]) -> Option<Arc<Rgb>> {
        match picture::decode(bytes, self.limits.texture_px, self.left) {
            Ok(texture) => {
                self.left = self.left.saturating_sub(texture.size().area() as u64);
                Some(Arc::new(texture))
            }
            Err(reason) => {
                log::warn!("{name}: not a usable texture ({reason}); drawing without it");
                None
            }
        }
    }
}
