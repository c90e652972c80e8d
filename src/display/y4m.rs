//! A Y4M clip: 4:4:4, full range, BT.601, to a file or stdout.

use super::{DisplayError, write_error};
use crate::kernel::yuv;
use crate::pixels::{Plane, Rgb, Size, simd};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Writes one clip. Every frame is written out at once: a reader at the other end of a pipe never waits.
pub struct Y4m {
    out: Box<dyn Write + Send>,
    path: PathBuf,
    size: Size,
    yuv: [Plane<u8>; 3],
}

impl Y4m {
    /// Opens `path` (`-` is stdout) and writes the header. `rate`: frames per second as a fraction.
    pub fn create(path: &Path, size: Size, rate: (u32, u32)) -> Result<Self, DisplayError> {
        let out: Box<dyn Write + Send> = if path.as_os_str() == "-" {
            Box::new(std::io::stdout())
        } else {
            Box::new(std::fs::File::create(path).map_err(|e| write_error(path, e))?)
        };
        Self::start(out, path, size, rate)
    }

    /// Writes the header to `out`; `path` names it in messages.
    pub fn start(
        mut out: Box<dyn Write + Send>,
        path: &Path,
        size: Size,
        rate: (u32, u32),
    ) -> Result<Self, DisplayError> {
        let (num, den) = (rate.0.max(1), rate.1.max(1));
        let Size { width, height } = size;
        let header =
            format!("YUV4MPEG2 W{width} H{height} F{num}:{den} Ip A1:1 C444 XYSCSS=444 XCOLORRANGE=FULL\n");
        out.write_all(header.as_bytes()).map_err(|e| write_error(path, e))?;
        Ok(Self { out, path: path.into(), size, yuv: [(); 3].map(|()| Plane::new(size, 0)) })
    }

    /// Writes one frame of the clip's size.
    pub fn write(&mut self, canvas: &Rgb) -> Result<(), DisplayError> {
        if canvas.size() != self.size {
            let (path, from, to) = (self.path.clone(), self.size, canvas.size());
            return Err(DisplayError::SizeChanged { path, from, to });
        }
        yuv::from_rgb(simd::best(), canvas, &mut self.yuv);
        let mut write = || {
            self.out.write_all(b"FRAME\n")?;
            self.yuv.iter().try_for_each(|plane| self.out.write_all(plane.samples()))?;
            self.out.flush()
        };
        write().map_err(|e| write_error(&self.path, e))
    }

    /// The file, or `-`.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl std::fmt::Debug for Y4m {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Y4m({} {})", self.path.display(), self.size)
    }
}
