//! Clips: a folder of pictures in name order, one picture, or Y4M from a file or stdin.

use super::grab::Stats;
use super::raw::{Decoder, PixelFormat, RawFormat, RawRef};
use super::y4m::Y4m;
use super::{CameraError, Grab};
use crate::frame::Frame;
use crate::kernel::yuv::{self, Coding, Range};
use crate::pixels::{Rgb, Size, picture, simd};
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::time::Duration;

const EXTENSIONS: [&str; 6] = ["png", "jpg", "jpeg", "pgm", "ppm", "pnm"];

/// A clip being read. Frames are numbered from 0 and stamped number / rate.
pub struct Clip {
    kind: Kind,
    size: Size,
    rate: (u64, u64),
    sequence: u64,
    decoder: Decoder,
    /// Interleaved copy of the last picture, when wanted.
    packed: Option<Vec<u8>>,
}

enum Kind {
    Y4m(Box<Y4m>),
    /// The first picture is read on opening, so that its size and its faults are known.
    Pictures {
        paths: Vec<PathBuf>,
        first: Option<Rgb>,
    },
}

impl Clip {
    /// Opens a folder, a picture, a Y4M file, or `-` (Y4M on stdin). `fps`: the rate of pictures.
    pub fn open(path: &Path, fps: f64) -> Result<Self, CameraError> {
        let name = path.display().to_string();
        if path.as_os_str().is_empty() {
            let reason = "camera.path names no clip: give a folder of pictures, a picture, a Y4M file, or -";
            return Err(CameraError::Format { name: "clip".into(), reason: reason.into() });
        }
        if path == Path::new("-") {
            // a locked handle cannot leave its thread; a second buffer costs little
            return Self::y4m(Box::new(BufReader::new(std::io::stdin())), "stdin".into());
        }
        let read = |source| CameraError::Read { name: name.clone(), what: "the clip".into(), source };
        if std::fs::metadata(path).map_err(read)?.is_dir() {
            let mut paths = Vec::new();
            for entry in std::fs::read_dir(path).map_err(read)? {
                let path = entry.map_err(read)?.path();
                if is_picture(&path) && path.is_file() {
                    paths.push(path);
                }
            }
            paths.sort();
            if paths.is_empty() {
                let reason = format!("the folder holds no pictures ({})", EXTENSIONS.join(", "));
                return Err(CameraError::Format { name, reason });
            }
            return Self::pictures(paths, fps);
        }
        let mut file = BufReader::with_capacity(1 << 16, File::open(path).map_err(read)?);
        let y4m = file.fill_buf().map_err(read)?.starts_with(b"YUV4MPEG2");
        let named = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("y4m"));
        if y4m || named { Self::y4m(Box::new(file), name) } else { Self::pictures(vec![path.into()], fps) }
    }

    /// Reads Y4M from any stream; `name` is for messages.
    pub fn y4m(input: Box<dyn BufRead + Send>, name: String) -> Result<Self, CameraError> {
        let y4m = Y4m::open(input, name)?;
        let (size, rate) = (y4m.format.size, y4m.rate);
        Ok(Self::new(Kind::Y4m(Box::new(y4m)), size, rate))
    }

    /// Reads these pictures in this order.
    pub fn pictures(paths: Vec<PathBuf>, fps: f64) -> Result<Self, CameraError> {
        let first = match paths.first() {
            Some(path) => Some(picture::read(path)?),
            None => None,
        };
        let size = first.as_ref().map_or(Size::new(0, 0), Rgb::size);
        let rate = ((fps.clamp(0.001, 1e6) * 1000.0).round() as u64, 1000);
        Ok(Self::new(Kind::Pictures { paths, first }, size, rate))
    }

    fn new(kind: Kind, size: Size, rate: (u64, u64)) -> Self {
        Self { kind, size, rate, sequence: 0, decoder: Decoder::default(), packed: None }
    }

    /// The size of the last picture, or of the first before it was taken.
    pub fn size(&self) -> Size {
        self.size
    }

    /// Pictures a second.
    pub fn fps(&self) -> f64 {
        self.rate.0 as f64 / self.rate.1 as f64
    }

    /// How many frames there are, where that is known beforehand.
    pub fn len(&self) -> Option<usize> {
        match &self.kind {
            Kind::Y4m(_) => None,
            Kind::Pictures { paths, .. } => Some(paths.len()),
        }
    }

    /// Whether it is known to hold no frames.
    pub fn is_empty(&self) -> bool {
        self.len() == Some(0)
    }

    /// The file that the last frame came from, for folders.
    pub fn file(&self) -> Option<&Path> {
        match &self.kind {
            Kind::Pictures { paths, .. } if self.sequence > 0 => Some(&paths[self.sequence as usize - 1]),
            _ => None,
        }
    }

    /// Fills `frame` with the next picture. After an error the clip goes on with the next picture of a
    /// folder; a damaged Y4M clip does not.
    pub fn next(&mut self, frame: &mut Frame) -> Result<Grab, CameraError> {
        match &mut self.kind {
            Kind::Y4m(y4m) => {
                if !y4m.advance()? {
                    return Ok(Grab::End);
                }
                self.decoder.decode(&y4m.raw(), frame)?;
            }
            Kind::Pictures { paths, first } => {
                let Some(path) = paths.get(self.sequence as usize) else { return Ok(Grab::End) };
                let color = match first.take() {
                    Some(color) => color,
                    None => picture::read(path).inspect_err(|_| self.sequence += 1)?,
                };
                frame.resize(color.size());
                yuv::luma_of_rgb(simd::best(), &color, &mut frame.luma);
                frame.color.copy_from(&color);
                self.size = color.size();
                if let Some(packed) = &mut self.packed {
                    pack(&color, packed);
                }
            }
        }
        frame.sequence = self.sequence;
        let nanos = u128::from(self.sequence) * 1_000_000_000 * u128::from(self.rate.1);
        frame.captured_at =
            Duration::from_nanos(u64::try_from(nanos / u128::from(self.rate.0.max(1))).unwrap_or(u64::MAX));
        self.sequence += 1;
        Ok(Grab::Frame)
    }

    pub(super) fn keep_raw(&mut self, keep: bool) {
        self.packed = keep.then(Vec::new);
    }

    pub(super) fn raw(&self) -> Option<RawRef<'_>> {
        match &self.kind {
            Kind::Y4m(y4m) => (self.sequence > 0).then(|| y4m.raw()),
            Kind::Pictures { .. } => {
                let bytes = self.packed.as_deref().filter(|bytes| !bytes.is_empty())?;
                let mut format = RawFormat::new(PixelFormat::Rgb3, self.size);
                format.coding = Coding { range: Range::Full, ..Coding::default() };
                Some(RawRef { format, bytes })
            }
        }
    }

    pub(super) fn stats(&self) -> Stats {
        Stats { received: self.sequence, delivered: self.sequence, ..Stats::default() }
    }
}

fn is_picture(path: &Path) -> bool {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    EXTENSIONS.iter().any(|known| extension.eq_ignore_ascii_case(known))
}

fn pack(color: &Rgb, packed: &mut Vec<u8>) {
    packed.clear();
    let [red, green, blue] = &color.planes;
    for ((red, green), blue) in red.rows().zip(green.rows()).zip(blue.rows()) {
        for ((r, g), b) in red.iter().zip(green).zip(blue) {
            packed.extend_from_slice(&[*r, *g, *b]);
        }
    }
}
