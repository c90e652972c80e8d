//! The display: where finished pictures go. A kernel display (KMS), a window, a Y4M clip, a folder of PNGs, or nowhere.
//!
//! Comes in: the canvas, planar RGB of any size. Goes out: pixels on a screen or in files, and the time at
//! which they were shown. A KMS picture is composed in ordinary memory (scan-out memory is slow to read) and
//! copied once, by rows, into a buffer that the screen is not reading. [`compose`] and [`Xrgb::hash`] are pure:
//! a replay on another machine computes what a screen of a given mode showed without having one.
//!
//! This room never waits for a device that left: waits are bounded, errors are typed and name what was looked
//! at, and recovery belongs to the caller (drop the sink, open it again).

#[cfg(target_os = "linux")]
mod card;
mod config;
#[cfg(target_os = "linux")]
mod flips;
#[cfg(target_os = "linux")]
mod kms;
mod layout;
mod menu;
mod png_dir;
mod slate;
#[cfg(feature = "window")]
mod window;
mod xrgb;
mod y4m;

pub use config::{Config, Filter, Kind, ModeSize, Scale};
#[cfg(target_os = "linux")]
pub use kms::Kms;
pub use layout::{Layout, Rotate, Seen};
pub use menu::Menu;
pub use png_dir::PngDir;
pub use slate::Slate;
#[cfg(feature = "window")]
pub use window::Window;
pub use xrgb::{Composer, Xrgb, compose};
pub use y4m::Y4m;

use crate::frame::now;
use crate::pixels::picture::PictureError;
use crate::pixels::{Rgb, Size};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Why a picture cannot be shown or written.
#[derive(Debug, thiserror::Error)]
pub enum DisplayError {
    /// No card has a connected connector and dumb buffers, or none may be opened.
    #[error(
        "no display: {looked}; plug in a screen and load its driver, or set display.sink to \"window\" (on a desktop), \"y4m\", \"png\" or \"null\""
    )]
    NoDisplay {
        /// Every place that was looked at, and what was wrong there.
        looked: String,
    },
    /// The card is there, but another program drives it.
    #[error("{}: another program owns the screen; stop it (a second vernissage) and start again, or set display.sink to \"window\" under a desktop", card.display())]
    Owned {
        /// The card's node.
        card: PathBuf,
    },
    /// The kernel refused a display request.
    #[error("{}: cannot {doing}: {source}; check the cable, then the kernel log", card.display())]
    Refused {
        /// The card's node.
        card: PathBuf,
        /// What was asked.
        doing: &'static str,
        /// What the system said.
        source: std::io::Error,
    },
    /// The card takes no more page flips.
    #[error("{}: the screen stopped taking pictures; open it again", card.display())]
    Stuck {
        /// The card's node.
        card: PathBuf,
    },
    /// The cable was pulled out.
    #[error("{}: {screen} is unplugged; plug it in again", card.display())]
    Unplugged {
        /// The card's node.
        card: PathBuf,
        /// The connector's name.
        screen: String,
    },
    /// No window can be opened.
    #[error(
        "no window: {why}; start it from a desktop, or set display.sink to \"kms\", \"y4m\", \"png\" or \"null\""
    )]
    NoWindow {
        /// What is missing.
        why: String,
    },
    /// The window's server went away, or takes no pictures.
    #[error("the window is lost: {why}; start again when the desktop is back")]
    WindowLost {
        /// What happened.
        why: String,
    },
    /// Somebody closed the window: the run is over.
    #[error("the window was closed")]
    Closed,
    /// The sink writes files, and the settings do not say where.
    #[error("display.sink = \"{sink}\" needs display.path: name a {what}")]
    NoPath {
        /// The sink.
        sink: &'static str,
        /// What the path should be.
        what: &'static str,
    },
    /// The file or folder cannot be written.
    #[error("{}: cannot write: {source}; check the path and the free space", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The program that read our clip ended.
    #[error("{}: the reader of the clip has gone", path.display())]
    ReaderGone {
        /// The file, or `-`.
        path: PathBuf,
    },
    /// A clip has one size.
    #[error("{}: a clip has one size, it began with {from} and now comes {to}; write to a folder", path.display())]
    SizeChanged {
        /// The file, or `-`.
        path: PathBuf,
        /// Size of the frames so far.
        from: Size,
        /// Size of the refused frame.
        to: Size,
    },
    /// A picture file cannot be written.
    #[error(transparent)]
    Picture(#[from] PictureError),
}

/// When a picture was shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shown {
    /// When this picture was handed to the screen or the file, on the monotonic clock.
    pub at: Duration,
    /// When the screen began to show the picture of the call before this one, by the kernel's flip event on
    /// the monotonic clock. `None` for files, for the first picture, and where the event never came.
    pub previous: Option<Duration>,
}

/// Where pictures go.
#[derive(Debug)]
pub enum Sink {
    /// A kernel display.
    #[cfg(target_os = "linux")]
    Kms(Box<Kms>),
    /// A window on a desktop.
    #[cfg(feature = "window")]
    Window(Box<Window>),
    /// One clip file or stdout.
    Y4m(Y4m),
    /// A folder of PNG files.
    PngDir(PngDir),
    /// Nowhere: for measurements.
    Null,
}

impl Sink {
    /// Opens the sink that `config` names for a canvas of this size.
    ///
    /// A KMS sink changes the mode and shows black; a window sink opens its window; a Y4M sink writes the header; a PNG
    /// sink makes the folder.
    pub fn open(config: &Config, canvas: Size) -> Result<Self, DisplayError> {
        let path = |sink, what| config.path.as_deref().ok_or(DisplayError::NoPath { sink, what });
        Ok(match config.sink {
            Kind::Kms => Self::open_kms(config, canvas)?,
            #[cfg(feature = "window")]
            Kind::Window => Sink::Window(Box::new(Window::open(config, canvas)?)),
            #[cfg(not(feature = "window"))]
            Kind::Window => {
                let why = "this program is built without windows (the feature `window`)".into();
                return Err(DisplayError::NoWindow { why });
            }
            Kind::Y4m => {
                Sink::Y4m(Y4m::create(path("y4m", "file, or - for stdout")?, canvas, (config.fps, 1))?)
            }
            Kind::Png => Sink::PngDir(PngDir::create(path("png", "folder")?)?),
            Kind::Null => Sink::Null,
        })
    }

    #[cfg(target_os = "linux")]
    fn open_kms(config: &Config, canvas: Size) -> Result<Self, DisplayError> {
        Ok(Sink::Kms(Box::new(Kms::open(config, canvas)?)))
    }

    #[cfg(not(target_os = "linux"))]
    fn open_kms(_: &Config, _: Size) -> Result<Self, DisplayError> {
        Err(DisplayError::NoDisplay { looked: "this system has no Linux kernel display".into() })
    }

    /// Shows or writes one picture. Returns once the picture is queued (KMS, one flip ahead of the screen) or
    /// written. KMS and null sinks allocate nothing after the first picture of a size.
    pub fn present(&mut self, canvas: &Rgb) -> Result<Shown, DisplayError> {
        match self {
            #[cfg(target_os = "linux")]
            Sink::Kms(kms) => kms.present(canvas),
            #[cfg(feature = "window")]
            Sink::Window(window) => window.present(canvas),
            Sink::Y4m(clip) => clip.write(canvas).map(|()| Shown { at: now(), previous: None }),
            Sink::PngDir(dir) => dir.write(canvas).map(|()| Shown { at: now(), previous: None }),
            Sink::Null => Ok(Shown { at: now(), previous: None }),
        }
    }

    /// [`Xrgb::hash`] of the buffer that the screen is showing, read back from scan-out memory after the flip
    /// of the last picture has ended. `None` unless this is a KMS sink. Slow: for traces and tests.
    pub fn scan_out_hash(&mut self) -> Option<u64> {
        match self {
            #[cfg(target_os = "linux")]
            Sink::Kms(kms) => Some(kms.scan_out_hash()),
            _ => None,
        }
    }

    /// Whether the screen is still there: a quick look at its connector or window, to be taken once a second or so. Files
    /// always are.
    pub fn check(&self) -> Result<(), DisplayError> {
        match self {
            #[cfg(target_os = "linux")]
            Sink::Kms(kms) => kms.check(),
            #[cfg(feature = "window")]
            Sink::Window(window) => window.check(),
            _ => Ok(()),
        }
    }

    /// Size of the screen's mode or of the window; `None` for files and for nowhere.
    pub fn mode(&self) -> Option<Size> {
        match self {
            #[cfg(target_os = "linux")]
            Sink::Kms(kms) => Some(kms.mode()),
            #[cfg(feature = "window")]
            Sink::Window(window) => Some(window.mode()),
            _ => None,
        }
    }

    /// Since opening: flips whose event never came within the time-out, pictures that a window's server had no time for.
    pub fn lost_flips(&self) -> u64 {
        match self {
            #[cfg(target_os = "linux")]
            Sink::Kms(kms) => kms.lost_flips(),
            #[cfg(feature = "window")]
            Sink::Window(window) => window.dropped(),
            _ => 0,
        }
    }
}

impl std::fmt::Display for Sink {
    /// For log lines: `/dev/dri/card0 HDMI-A-1 640x480 at 60 Hz`, `clip.y4m`, `out/`, `nowhere`.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            #[cfg(target_os = "linux")]
            Sink::Kms(kms) => kms.fmt(f),
            #[cfg(feature = "window")]
            Sink::Window(window) => window.fmt(f),
            Sink::Y4m(clip) => write!(f, "{}", clip.path().display()),
            Sink::PngDir(dir) => write!(f, "{}/", dir.path().display()),
            Sink::Null => write!(f, "nowhere"),
        }
    }
}

fn write_error(path: &Path, source: std::io::Error) -> DisplayError {
    match source.kind() {
        std::io::ErrorKind::BrokenPipe => DisplayError::ReaderGone { path: path.into() },
        _ => DisplayError::Write { path: path.into(), source },
    }
}
