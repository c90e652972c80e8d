//! Which format to ask a camera for, and what its answer means. Pure: tested as tables.

use super::CameraError;
use super::raw::{LARGEST, PixelFormat, RawFormat};
use crate::kernel::yuv::{Coding, Matrix, Range, Siting};
use crate::pixels::Size;

/// One way a camera can deliver pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Offer {
    /// Layout of the bytes.
    pub format: PixelFormat,
    /// Picture size in pixels.
    pub size: Size,
    /// The most pictures a second, where the camera says.
    pub fps: Option<f64>,
}

/// What is wanted of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wish {
    /// This size.
    pub size: Size,
    /// At least so many pictures a second.
    pub fps: f64,
    /// This format only; `None`: the best one.
    pub format: Option<PixelFormat>,
}

/// An offer in its place, and why it stands there.
#[derive(Clone, Debug, PartialEq)]
pub struct Ranked {
    /// The offer.
    pub offer: Offer,
    /// For people: size, speed, and what the format costs or spares.
    pub reason: String,
}

/// Orders offers, best first: the size nearest to the wish, then fast enough, then the format that keeps
/// most and costs least. With a named format only its offers are left.
pub fn rank(offers: &[Offer], wish: &Wish) -> Vec<Ranked> {
    let slow = |offer: &Offer| offer.fps.is_some_and(|fps| fps < 0.95 * wish.fps);
    let distance = |size: Size| size.width.abs_diff(wish.size.width) + size.height.abs_diff(wish.size.height);
    let mut kept: Vec<Offer> =
        offers.iter().filter(|o| wish.format.is_none_or(|format| o.format == format)).copied().collect();
    kept.sort_by_key(|o| (distance(o.size), slow(o), preference(o.format).0));
    let reason = |o: &Offer| {
        let size = if o.size == wish.size { "as wished".into() } else { format!("wished {}", wish.size) };
        let speed = match o.fps {
            None => "speed not told".into(),
            Some(fps) if slow(o) => format!("only {fps:.1}/s, wished {}", wish.fps),
            Some(fps) => format!("{fps:.1}/s"),
        };
        format!("{} {} ({size}), {speed}, {}", o.format, o.size, preference(o.format).1)
    };
    kept.into_iter().map(|offer| Ranked { reason: reason(&offer), offer }).collect()
}

/// Rank and reason of a format, size and speed being equal.
fn preference(format: PixelFormat) -> (u8, &'static str) {
    match format {
        PixelFormat::Yuyv => (0, "luma as it is, chroma on every row"),
        PixelFormat::Uyvy => (1, "luma as it is, chroma on every row"),
        PixelFormat::Nv12 => (2, "luma as it is, chroma on every other row"),
        PixelFormat::Rgb3 => (3, "luma must be computed"),
        PixelFormat::Mjpg => (4, "lossy, and decoding costs milliseconds"),
        PixelFormat::Grey => (5, "no color"),
        _ => (6, "a clip's format"),
    }
}

/// FourCC as the kernel writes it.
pub(super) const fn fourcc(format: PixelFormat) -> u32 {
    u32::from_le_bytes(match format {
        PixelFormat::Yuyv => *b"YUYV",
        PixelFormat::Uyvy => *b"UYVY",
        PixelFormat::Nv12 => *b"NV12",
        PixelFormat::Grey => *b"GREY",
        PixelFormat::Rgb3 => *b"RGB3",
        PixelFormat::Mjpg => *b"MJPG",
        PixelFormat::Yuv420 => *b"YU12",
        PixelFormat::Yuv422 => *b"422P",
        PixelFormat::Yuv444 => *b"444P",
    })
}

/// The format of a FourCC that a camera may deliver; motion JPEG has two names.
pub(super) fn from_fourcc(code: u32) -> Option<PixelFormat> {
    let live = &PixelFormat::ALL[..6];
    let jpeg = (code == u32::from_le_bytes(*b"JPEG")).then_some(PixelFormat::Mjpg);
    live.iter().copied().find(|&format| fourcc(format) == code).or(jpeg)
}

/// A FourCC for people.
pub(super) fn fourcc_name(code: u32) -> String {
    code.to_le_bytes().iter().map(|&b| if b.is_ascii_graphic() { char::from(b) } else { '?' }).collect()
}

/// The colorimetry numbers of `linux/videodev2.h` as a coding; zeros take the defaults that header states:
/// BT.709 for Rec. 709 and DCI-P3, BT.2020 and SMPTE 240M for theirs, else BT.601; full range for RGB and
/// JPEG, else limited.
pub fn coding(format: PixelFormat, colorspace: u32, encoding: u32, quantization: u32) -> Coding {
    let matrix = match (encoding, colorspace) {
        (2 | 4, _) | (0, 3 | 12) => Matrix::Bt709,
        (6 | 7, _) | (0, 10) => Matrix::Bt2020,
        (8, _) | (0, 2) => Matrix::Smpte240m,
        _ => Matrix::Bt601,
    };
    let full_by_default = matches!(format, PixelFormat::Rgb3 | PixelFormat::Mjpg) || colorspace == 7;
    let range = match quantization {
        1 => Range::Full,
        2 => Range::Limited,
        _ if full_by_default => Range::Full,
        _ => Range::Limited,
    };
    Coding { matrix, range }
}

/// What the driver set, as far as decoding goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Granted {
    /// Pixels.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// Four characters, little-endian.
    pub fourcc: u32,
    /// Bytes from row to row, 0 where that means nothing.
    pub bytes_per_line: u32,
    /// `V4L2_COLORSPACE_*`.
    pub colorspace: u32,
    /// `V4L2_YCBCR_ENC_*`.
    pub encoding: u32,
    /// `V4L2_QUANTIZATION_*`.
    pub quantization: u32,
}

/// The raw format to decode after a driver has set what it could. Refuses sizes out of bounds, row lengths
/// that cannot hold a row, and formats that were not asked for and cannot be decoded.
pub fn granted(device: &str, granted: &Granted) -> Result<RawFormat, CameraError> {
    let size = Size::new(granted.width as usize, granted.height as usize);
    let refuse = |reason: String| CameraError::Unsuitable { device: device.into(), reason };
    let Some(format) = from_fourcc(granted.fourcc) else {
        return Err(refuse(format!("it set format {}, which is not decoded", fourcc_name(granted.fourcc))));
    };
    let mut raw = RawFormat::new(format, size);
    if granted.bytes_per_line > 0 && format != PixelFormat::Mjpg {
        raw.stride = granted.bytes_per_line as usize;
    }
    raw.coding = coding(format, granted.colorspace, granted.encoding, granted.quantization);
    raw.siting = Siting::Center;
    if raw.least_bytes().is_none() {
        let reason = format!("it set {format} {size} with rows of {} bytes (largest {LARGEST})", raw.stride);
        return Err(refuse(reason));
    }
    Ok(raw)
}
