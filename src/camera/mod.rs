//! Where frames come from: a camera (V4L2), a clip (pictures or Y4M), a recorded trace.
//!
//! Comes in: `Config`; goes out: `Frame`s, newest first for cameras, every one for clips and traces, each
//! with a running number and the time it was taken. A `Source` never recovers by itself: an error from a
//! camera means "drop me and open me anew"; `app` decides when. Bad bytes from a device or a file are dropped
//! and counted, or refused with an error that names the file and the frame; they never panic.

mod clip;
mod config;
mod controls;
#[cfg(target_os = "linux")]
mod find;
mod grab;
pub mod negotiate;
mod raw;
mod select;
#[cfg(target_os = "linux")]
mod streaming;
mod synthetic;
pub mod trace;
#[cfg(target_os = "linux")]
mod v4l2;
mod y4m;

pub use clip::Clip;
pub use config::{Config, FormatChoice, Kind};
pub use controls::Exposure;
#[cfg(target_os = "linux")]
pub use find::{Candidate, probe};
pub use grab::Stats;
pub use raw::{Decoder, LARGEST, MOST_BYTES, PixelFormat, RawFormat, RawRef, decode};
pub use synthetic::{Config as SyntheticConfig, Synthetic};
pub use trace::Trace;
#[cfg(target_os = "linux")]
pub use v4l2::V4l2;

use crate::frame::Frame;
use crate::geometry::Lens;
use crate::pixels::{Size, picture::PictureError, simd};
use negotiate::Wish;
use std::time::Duration;

/// What a call for the next frame brought.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grab {
    /// The frame was filled.
    Frame,
    /// Nothing came in time; the source goes on.
    Timeout,
    /// The clip is over.
    End,
}

/// Why there is no frame.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// Nothing there to open.
    #[error(
        "no camera at {device}{others}: plug one in, or name another with camera.device; without one, set camera.source = \"synthetic\""
    )]
    NoCamera {
        /// The node asked for.
        device: String,
        /// What else was found, in parentheses, or nothing.
        others: String,
    },
    /// It is there and cannot serve.
    #[error(
        "{device} cannot serve as the camera: {reason}; name another with camera.device or change camera.format"
    )]
    Unsuitable {
        /// The node.
        device: String,
        /// Why.
        reason: String,
    },
    /// Another program streams from it.
    #[error("{device} is in use by {holder}: stop that one, or name another camera with camera.device")]
    Busy {
        /// The node.
        device: String,
        /// The program that has it, or "another program" where the system does not let us see it.
        holder: String,
    },
    /// It was unplugged or its driver let go. Open it anew.
    #[error("{device} is gone: plug it in again ({source})")]
    Lost {
        /// The node.
        device: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// Its signal has another size or rate than before. Open it anew.
    #[error("{device} has another signal now")]
    Changed {
        /// The node.
        device: String,
    },
    /// It failed in a way that may pass. Open it anew.
    #[error("{device} failed while {step}: {source}; unplug it and plug it in again if that persists")]
    Fault {
        /// The node.
        device: String,
        /// What was being done.
        step: &'static str,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file cannot be opened or read.
    #[error("{name}: cannot read {what}: {source}")]
    Read {
        /// The file.
        name: String,
        /// Which part of it.
        what: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// A trace cannot be written.
    #[error("{name}: cannot write the trace: {source}; check the path and the free space")]
    Write {
        /// The file.
        name: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// A file is not what it should be.
    #[error("{name}: {reason}")]
    Format {
        /// The file.
        name: String,
        /// What is wrong, where, and what to do.
        reason: String,
    },
    /// A picture of a folder or its first file.
    #[error(transparent)]
    Picture(#[from] PictureError),
    /// Raw bytes that do not hold the picture they should.
    #[error("{0}")]
    Raw(String),
    /// This build or configuration has no such source.
    #[error("camera.source = \"{0}\" is not available here: {1}")]
    Unavailable(&'static str, &'static str),
}

/// A source of frames.
pub enum Source {
    /// A camera of the Linux kernel.
    #[cfg(target_os = "linux")]
    V4l2(Box<V4l2>),
    /// Pictures or a Y4M clip: every frame, as fast as asked.
    Clip(Box<Clip>),
    /// A recorded trace: every frame, as fast as asked.
    Trace(Box<Trace>),
    /// The drawn table: every frame, as fast as asked.
    Synthetic(Box<Synthetic>),
}

impl Source {
    /// Opens what `config` names and learns the picture size.
    pub fn open(config: &Config) -> Result<Self, CameraError> {
        match config.source {
            #[cfg(target_os = "linux")]
            Kind::V4l2 => Ok(Source::V4l2(Box::new(V4l2::open(config)?))),
            #[cfg(not(target_os = "linux"))]
            Kind::V4l2 => Err(CameraError::Unavailable("v4l2", "it needs Linux")),
            Kind::Clip => Ok(Source::Clip(Box::new(Clip::open(&config.path, config.wish().fps)?))),
            Kind::Trace => Ok(Source::Trace(Box::new(Trace::open(&config.path)?))),
            Kind::Synthetic => {
                let Wish { size, fps, .. } = config.wish();
                Ok(Source::Synthetic(Box::new(Synthetic::new(&config.synthetic, size, fps, simd::best()))))
            }
        }
    }

    /// The size of the next picture; folders of pictures may change it.
    pub fn size(&self) -> Size {
        match self {
            #[cfg(target_os = "linux")]
            Source::V4l2(camera) => camera.format().size,
            Source::Clip(clip) => clip.size(),
            Source::Trace(trace) => trace.size(),
            Source::Synthetic(table) => table.lens().size,
        }
    }

    /// Pictures a second, where known.
    pub fn fps(&self) -> Option<f64> {
        match self {
            #[cfg(target_os = "linux")]
            Source::V4l2(camera) => camera.fps(),
            Source::Clip(clip) => Some(clip.fps()),
            Source::Trace(_) => None,
            Source::Synthetic(table) => Some(table.fps()),
        }
    }

    /// Whether pictures come when the device takes them, not when they are asked for.
    pub fn is_live(&self) -> bool {
        #[cfg(target_os = "linux")]
        let live = matches!(self, Source::V4l2(_));
        #[cfg(not(target_os = "linux"))]
        let live = false;
        live
    }

    /// How many frames there are in all, where known.
    pub fn frames(&self) -> Option<u64> {
        match self {
            Source::Synthetic(table) => table.frames(),
            _ => None,
        }
    }

    /// The lens, where the source knows it exactly.
    pub fn lens(&self) -> Option<Lens> {
        match self {
            Source::Synthetic(table) => Some(table.lens()),
            _ => None,
        }
    }

    /// What a trace recorded of the frame last given.
    pub fn recorded(&self) -> Option<&trace::Entry> {
        match self {
            Source::Trace(trace) => trace.entry(),
            _ => None,
        }
    }

    /// Fills `frame` with the next picture (cameras: the newest; waits up to `timeout`). Unless it returns
    /// `Grab::Frame`, `frame` keeps its picture. Allocates only to grow, for MJPEG and for picture files.
    pub fn next(&mut self, frame: &mut Frame, timeout: Duration) -> Result<Grab, CameraError> {
        match self {
            #[cfg(target_os = "linux")]
            Source::V4l2(camera) => camera.next(frame, timeout),
            Source::Clip(clip) => clip.next(frame),
            Source::Trace(trace) => trace.next(frame),
            Source::Synthetic(table) => Ok(if table.next(frame) { Grab::Frame } else { Grab::End }),
        }
    }

    /// Stops a camera's stream and starts it again; its numbers begin anew. Files have nothing to start.
    pub fn restart(&mut self) -> Result<(), CameraError> {
        match self {
            #[cfg(target_os = "linux")]
            Source::V4l2(camera) => camera.restart(),
            Source::Clip(_) | Source::Trace(_) | Source::Synthetic(_) => Ok(()),
        }
    }

    /// Whether to keep the raw bytes of the last frame for [`Source::raw`]; Y4M clips and traces always do.
    pub fn keep_raw(&mut self, keep: bool) {
        match self {
            #[cfg(target_os = "linux")]
            Source::V4l2(camera) => camera.keep_raw(keep),
            Source::Clip(clip) => clip.keep_raw(keep),
            Source::Trace(_) | Source::Synthetic(_) => {}
        }
    }

    /// The last frame as it was delivered: [`decode`] gives the same luma and color from it.
    pub fn raw(&self) -> Option<RawRef<'_>> {
        match self {
            #[cfg(target_os = "linux")]
            Source::V4l2(camera) => camera.raw(),
            Source::Clip(clip) => clip.raw(),
            Source::Trace(trace) => trace.raw(),
            Source::Synthetic(_) => None,
        }
    }

    /// What became of the source's frames so far.
    pub fn stats(&self) -> Stats {
        match self {
            #[cfg(target_os = "linux")]
            Source::V4l2(camera) => camera.stats(),
            Source::Clip(clip) => clip.stats(),
            Source::Trace(trace) => trace.stats(),
            Source::Synthetic(table) => table.stats(),
        }
    }
}

impl std::fmt::Display for Source {
    /// For log lines.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            #[cfg(target_os = "linux")]
            Source::V4l2(camera) => {
                let format = camera.format();
                write!(f, "{} ({}) {} {}", camera.device(), camera.card(), format.format.name(), format.size)
            }
            Source::Clip(clip) => write!(f, "clip {}", clip.size()),
            Source::Trace(trace) => write!(f, "trace {}", trace.size()),
            Source::Synthetic(table) => write!(f, "synthetic {}", table.lens().size),
        }
    }
}
