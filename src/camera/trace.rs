//! Traces: what the camera delivered and what the screen showed, frame by frame, for exact replay.
//!
//! A file is the 8 bytes `VNTRACE1`, then records. A record is 68 bytes, numbers little-endian:
//!
//! | bytes | what |
//! |---|---|
//! | 4 | `FRAM` |
//! | 8 8 8 | sequence; taken at, shown at: ns on the monotonic clock |
//! | 8 | hash of the shown XRGB pixels, the display room's |
//! | 4 4 | width, height of the display mode |
//! | 1 1 1 1 | pixel format, matrix, range, siting: places in the tables below |
//! | 4 4 4 | width, height, stride of the raw picture |
//! | 4 4 | length of the raw bytes, low and high half |
//!
//! and then the raw bytes. Reading is bounded (8192x8192) and refuses a cut or damaged file by frame number.

use super::grab::Stats;
use super::raw::{Decoder, MOST_BYTES, PixelFormat, RawFormat, RawRef};
use super::{CameraError, Grab};
use crate::frame::Frame;
use crate::kernel::yuv::{Coding, Matrix, Range, Siting};
use crate::pixels::Size;
use std::fs::File;
use std::io::{BufReader, BufWriter, ErrorKind, Read, Write};
use std::path::Path;
use std::time::Duration;

const MAGIC: &[u8; 8] = b"VNTRACE1";
const RECORD: usize = 68;
/// No screen has a longer side, px: a damaged file must not make a replay compose one.
const LARGEST_MODE: u32 = 16_384;
const MATRICES: [Matrix; 4] = [Matrix::Bt601, Matrix::Bt709, Matrix::Bt2020, Matrix::Smpte240m];
const RANGES: [Range; 2] = [Range::Limited, Range::Full];
const SITINGS: [Siting; 3] = [Siting::Center, Siting::Left, Siting::PalDv];

/// What is known of one shown frame besides its raw bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Entry {
    /// The source's running number.
    pub sequence: u64,
    /// Taken, on the monotonic clock.
    pub captured_at: Duration,
    /// On the screen, on the monotonic clock.
    pub shown_at: Duration,
    /// Hash of the whole shown mode, the display room's.
    pub shown_hash: u64,
    /// Width and height of the display mode, px.
    pub mode: [u32; 2],
}

/// Writes a trace.
pub struct Writer {
    out: BufWriter<File>,
    name: String,
}

impl Writer {
    /// Creates or empties the file.
    pub fn create(path: &Path) -> Result<Self, CameraError> {
        let name = path.display().to_string();
        let fail = |source| CameraError::Write { name: name.clone(), source };
        let mut out = BufWriter::with_capacity(1 << 18, File::create(path).map_err(fail)?);
        out.write_all(MAGIC).map_err(fail)?;
        Ok(Self { out, name })
    }

    /// Adds a frame. Allocates nothing.
    pub fn push(&mut self, entry: &Entry, raw: &RawRef<'_>) -> Result<(), CameraError> {
        let place = |found: Option<usize>| found.unwrap_or(0) as u8;
        let RawFormat { format, size, stride, coding, siting } = raw.format;
        let mut record = [0u8; RECORD];
        let mut at = 0;
        let mut put = |bytes: &[u8]| {
            record[at..at + bytes.len()].copy_from_slice(bytes);
            at += bytes.len();
        };
        put(b"FRAM");
        put(&entry.sequence.to_le_bytes());
        put(&(entry.captured_at.as_nanos() as u64).to_le_bytes());
        put(&(entry.shown_at.as_nanos() as u64).to_le_bytes());
        put(&entry.shown_hash.to_le_bytes());
        entry.mode.iter().for_each(|v| put(&v.to_le_bytes()));
        put(&[
            place(PixelFormat::ALL.iter().position(|&f| f == format)),
            place(MATRICES.iter().position(|&m| m == coding.matrix)),
            place(RANGES.iter().position(|&r| r == coding.range)),
            place(SITINGS.iter().position(|&s| s == siting)),
        ]);
        [size.width, size.height, stride].iter().for_each(|&v| put(&(v as u32).to_le_bytes()));
        put(&(raw.bytes.len() as u64).to_le_bytes());
        let name = &self.name;
        let fail = |source| CameraError::Write { name: name.clone(), source };
        self.out.write_all(&record).map_err(fail)?;
        self.out.write_all(raw.bytes).map_err(fail)
    }

    /// Writes out what is still in memory. Dropping does so too, but cannot tell of errors.
    pub fn finish(mut self) -> Result<(), CameraError> {
        let name = self.name.clone();
        self.out.flush().map_err(|source| CameraError::Write { name, source })
    }
}

/// A trace being replayed.
pub struct Trace {
    input: BufReader<File>,
    name: String,
    number: u64,
    /// The next record, read ahead so that its size is known.
    ahead: Option<(Entry, RawFormat, usize)>,
    /// Why there is no next record: told when it is asked for.
    fault: Option<CameraError>,
    last: Option<(Entry, RawFormat)>,
    size: Size,
    bytes: Vec<u8>,
    decoder: Decoder,
}

impl Trace {
    /// Opens a trace and reads the first record's head.
    pub fn open(path: &Path) -> Result<Self, CameraError> {
        let name = path.display().to_string();
        let read = |source| CameraError::Read { name: name.clone(), what: "the trace".into(), source };
        let mut input = BufReader::with_capacity(1 << 18, File::open(path).map_err(read)?);
        let mut magic = Vec::new();
        (&mut input).take(8).read_to_end(&mut magic).map_err(read)?;
        if magic != MAGIC {
            let reason = "it is not a trace (no VNTRACE1 at its start): record one with run --trace";
            return Err(CameraError::Format { name, reason: reason.into() });
        }
        let mut trace = Self {
            input,
            name,
            number: 0,
            ahead: None,
            fault: None,
            last: None,
            size: Size::new(0, 0),
            bytes: Vec::new(),
            decoder: Decoder::default(),
        };
        trace.ahead = trace.record()?;
        trace.size = trace.ahead.map_or(trace.size, |(_, format, _)| format.size);
        Ok(trace)
    }

    /// The size of the next picture, or of the last one.
    pub fn size(&self) -> Size {
        self.size
    }

    /// What was recorded of the frame last replayed.
    pub fn entry(&self) -> Option<&Entry> {
        self.last.as_ref().map(|(entry, _)| entry)
    }

    /// The hash of what was shown for the frame last replayed.
    pub fn shown_hash(&self) -> Option<u64> {
        self.entry().map(|entry| entry.shown_hash)
    }

    /// Fills `frame` with the next recorded picture, its number and its time.
    pub fn next(&mut self, frame: &mut Frame) -> Result<Grab, CameraError> {
        if let Some(fault) = self.fault.take() {
            return Err(fault);
        }
        let Some((entry, format, length)) = self.ahead.take() else { return Ok(Grab::End) };
        self.bytes.clear();
        let taken = (&mut self.input).take(length as u64).read_to_end(&mut self.bytes);
        taken.map_err(|source| self.read_error(source))?;
        if self.bytes.len() < length {
            return Err(self.cut());
        }
        self.decoder.decode(&RawRef { format, bytes: &self.bytes }, frame).map_err(|error| {
            let reason = format!("frame {}: {error}", self.number);
            CameraError::Format { name: self.name.clone(), reason }
        })?;
        frame.sequence = entry.sequence;
        frame.captured_at = entry.captured_at;
        self.last = Some((entry, format));
        self.number += 1;
        match self.record() {
            Ok(ahead) => self.ahead = ahead,
            Err(fault) => self.fault = Some(fault),
        }
        self.size = self.ahead.map_or(format.size, |(_, next, _)| next.size);
        Ok(Grab::Frame)
    }

    pub(super) fn raw(&self) -> Option<RawRef<'_>> {
        self.last.map(|(_, format)| RawRef { format, bytes: &self.bytes })
    }

    pub(super) fn stats(&self) -> Stats {
        Stats { received: self.number, delivered: self.number, ..Stats::default() }
    }

    fn read_error(&self, source: std::io::Error) -> CameraError {
        CameraError::Read { name: self.name.clone(), what: format!("frame {}", self.number), source }
    }

    fn cut(&self) -> CameraError {
        let reason = format!(
            "the trace ends within frame {}: it was cut off; frames before it are whole",
            self.number
        );
        CameraError::Format { name: self.name.clone(), reason }
    }

    /// Reads a record's head; `None` at the end of the file.
    fn record(&mut self) -> Result<Option<(Entry, RawFormat, usize)>, CameraError> {
        let mut record = [0u8; RECORD];
        let mut filled = 0;
        while filled < RECORD {
            match self.input.read(&mut record[filled..]) {
                Ok(0) => break,
                Ok(n) => filled += n,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(self.read_error(error)),
            }
        }
        match filled {
            0 => return Ok(None),
            RECORD => {}
            _ => return Err(self.cut()),
        }
        match parse(&record) {
            Some(parsed) => Ok(Some(parsed)),
            None => {
                let reason = format!(
                    "frame {} is damaged: its head makes no sense; record the trace again",
                    self.number
                );
                Err(CameraError::Format { name: self.name.clone(), reason })
            }
        }
    }
}

fn parse(record: &[u8; RECORD]) -> Option<(Entry, RawFormat, usize)> {
    let (mark, rest) = record.split_first_chunk::<4>()?;
    let u64_at = |at: usize| Some(u64::from_le_bytes(*rest.get(at..)?.first_chunk()?));
    let u32_at = |at: usize| Some(u32::from_le_bytes(*rest.get(at..)?.first_chunk()?));
    if mark != b"FRAM" {
        return None;
    }
    let entry = Entry {
        sequence: u64_at(0)?,
        captured_at: Duration::from_nanos(u64_at(8)?),
        shown_at: Duration::from_nanos(u64_at(16)?),
        shown_hash: u64_at(24)?,
        mode: [u32_at(32)?, u32_at(36)?],
    };
    let place = |at: usize| rest.get(40 + at).map(|&b| usize::from(b));
    let format = RawFormat {
        format: *PixelFormat::ALL.get(place(0)?)?,
        size: Size::new(u32_at(44)? as usize, u32_at(48)? as usize),
        stride: u32_at(52)? as usize,
        coding: Coding { matrix: *MATRICES.get(place(1)?)?, range: *RANGES.get(place(2)?)? },
        siting: *SITINGS.get(place(3)?)?,
    };
    let length = usize::try_from(u64_at(56)?).ok()?;
    if entry.mode.iter().any(|&side| !(1..=LARGEST_MODE).contains(&side)) {
        return None;
    }
    // rows may be padded, but not beyond all measure
    let within = length >= format.least_bytes()? && length <= 4 * MOST_BYTES;
    within.then_some((entry, format, length))
}
