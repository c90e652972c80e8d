//! Y4M (YUV4MPEG2) clips, read a frame at a time from a file or stdin.
//!
//! Read: C420jpeg, C420, C420mpeg2, C420paldv, C422, C444, Cmono at 8 bits, XCOLORRANGE, frame parameters
//! (skipped), any frame rate. Refused by name: interlaced clips, more bits, other chroma. Memory grows with
//! the bytes that really arrive, not with what a header claims. mjpegtools, yuv4mpeg(5).

use super::CameraError;
use super::raw::{LARGEST, PixelFormat, RawFormat, RawRef};
use crate::kernel::yuv::{Range, Siting};
use crate::pixels::Size;
use std::io::{BufRead, Read};

/// A header line longer than this is no header.
const LONGEST_LINE: u64 = 1024;

/// A clip being read.
pub(super) struct Y4m {
    input: Box<dyn BufRead + Send>,
    name: String,
    pub format: RawFormat,
    /// Frames a second as a fraction, both at least 1.
    pub rate: (u64, u64),
    bytes: Vec<u8>,
    line: Vec<u8>,
    frame: u64,
}

impl Y4m {
    /// Reads the header; `name` is for messages.
    pub(super) fn open(mut input: Box<dyn BufRead + Send>, name: String) -> Result<Self, CameraError> {
        let mut line = Vec::new();
        let mut y4m = |input: &mut dyn BufRead| {
            input.take(LONGEST_LINE).read_until(b'\n', &mut line).map_err(|source| CameraError::Read {
                name: name.clone(),
                what: "the Y4M header".into(),
                source,
            })
        };
        y4m(&mut input)?;
        let (format, rate) =
            header(&line).map_err(|reason| CameraError::Format { name: name.clone(), reason })?;
        Ok(Self { input, name, format, rate, bytes: Vec::new(), line, frame: 0 })
    }

    /// Reads the next frame; `false` at the end of the clip.
    pub(super) fn advance(&mut self) -> Result<bool, CameraError> {
        let (name, number) = (&self.name, self.frame);
        let read = |source| CameraError::Read { name: name.clone(), what: format!("frame {number}"), source };
        let refuse = |reason| CameraError::Format { name: name.clone(), reason };
        self.line.clear();
        (&mut self.input).take(LONGEST_LINE).read_until(b'\n', &mut self.line).map_err(read)?;
        if self.line.is_empty() {
            return Ok(false);
        }
        let marked = self.line.starts_with(b"FRAME") && matches!(self.line.get(5), Some(b' ' | b'\n'));
        match (marked, self.line.last()) {
            (true, Some(b'\n')) => {}
            // a cut marker, unless there is other matter in its place
            _ if b"FRAME\n".starts_with(&self.line) || marked => return Err(refuse(cut(number))),
            _ => {
                return Err(refuse(format!(
                    "frame {number} does not begin with FRAME: the clip is damaged there"
                )));
            }
        }
        let needed = self.format.least_bytes().unwrap_or(0);
        self.bytes.clear();
        (&mut self.input).take(needed as u64).read_to_end(&mut self.bytes).map_err(read)?;
        if self.bytes.len() < needed {
            return Err(refuse(cut(number)));
        }
        self.frame += 1;
        Ok(true)
    }

    /// The frame last read.
    pub(super) fn raw(&self) -> RawRef<'_> {
        RawRef { format: self.format, bytes: &self.bytes }
    }
}

fn cut(number: u64) -> String {
    format!("the clip ends within frame {number}: it was cut off; make or copy it again")
}

/// Understands a stream header.
fn header(line: &[u8]) -> Result<(RawFormat, (u64, u64)), String> {
    let not = "it is not a Y4M clip (no YUV4MPEG2 header line)";
    let text = line.strip_suffix(b"\n").and_then(|l| std::str::from_utf8(l).ok()).ok_or(not)?;
    let mut words = text.split(' ');
    if words.next() != Some("YUV4MPEG2") {
        return Err(not.into());
    }
    let (mut size, mut rate) = (Size::new(0, 0), (30, 1));
    let (mut format, mut siting, mut range) = (PixelFormat::Yuv420, Siting::Center, Range::Limited);
    for word in words.filter(|word| !word.is_empty()) {
        let (tag, value) = word.split_at(word.chars().next().map_or(0, char::len_utf8));
        match (tag, value) {
            ("W", _) => size.width = number(word)?,
            ("H", _) => size.height = number(word)?,
            ("F", _) => {
                let (a, b) =
                    value.split_once(':').ok_or_else(|| format!("frame rate {word} is no fraction"))?;
                let parse =
                    |v: &str| v.parse::<u32>().map_err(|_| format!("frame rate {word} is no fraction"));
                let (a, b) = (parse(a)?, parse(b)?);
                // 0:0 means unknown
                rate = if a == 0 || b == 0 { (30, 1) } else { (a.into(), b.into()) };
            }
            ("I", "p" | "?") | ("A", _) => {}
            ("I", _) => return Err(format!("the clip is interlaced ({word}): deinterlace it first")),
            ("C", _) => {
                (format, siting) = match value {
                    "420jpeg" | "420" => (PixelFormat::Yuv420, Siting::Center),
                    "420mpeg2" => (PixelFormat::Yuv420, Siting::Left),
                    "420paldv" => (PixelFormat::Yuv420, Siting::PalDv),
                    "422" => (PixelFormat::Yuv422, Siting::Left),
                    "444" => (PixelFormat::Yuv444, Siting::Center),
                    "mono" => (PixelFormat::Grey, Siting::Center),
                    _ => {
                        return Err(format!(
                            "chroma {word} is not read (8-bit C420jpeg, C420mpeg2, C420paldv, C422, C444 and Cmono are): convert the clip"
                        ));
                    }
                }
            }
            ("X", "COLORRANGE=FULL") => range = Range::Full,
            ("X", "COLORRANGE=LIMITED") => range = Range::Limited,
            _ => {}
        }
    }
    let within = 1..=LARGEST;
    if !within.contains(&size.width) || !within.contains(&size.height) {
        return Err(format!("the picture size {size} is missing or over {LARGEST}x{LARGEST}"));
    }
    let mut raw = RawFormat::new(format, size);
    raw.coding.range = range;
    raw.siting = siting;
    Ok((raw, rate))
}

fn number(word: &str) -> Result<usize, String> {
    word[1..].parse().map_err(|_| format!("{word} in the Y4M header is no number"))
}
