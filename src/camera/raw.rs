//! Raw pictures as a camera or clip delivers them, and the one way from them to a `Frame`.
//!
//! Live grabbing and trace replay decode through the same function, so they give the same bytes.

use super::CameraError;
use crate::frame::Frame;
use crate::kernel::yuv::{self, Coding, Matrix, Range, Samples, Siting};
use crate::pixels::{PlaneRef, Size, simd};
use serde::{Deserialize, Serialize};
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

/// The largest picture taken, each way, in pixels.
pub const LARGEST: usize = 8192;
/// The most bytes one raw picture may have: three full planes of the largest.
pub const MOST_BYTES: usize = 3 * LARGEST * LARGEST;

/// How a raw picture's bytes are laid out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PixelFormat {
    /// Packed 4:2:2, Y0 Cb Y1 Cr.
    Yuyv,
    /// Packed 4:2:2, Cb Y0 Cr Y1.
    Uyvy,
    /// Y plane, then Cb Cr pairs at half size, rows equally far apart.
    Nv12,
    /// Y alone.
    Grey,
    /// R, G, B bytes.
    Rgb3,
    /// One JPEG file a picture.
    Mjpg,
    /// Clips: three tight planes, chroma halved both ways.
    Yuv420,
    /// Clips: three tight planes, chroma halved across.
    Yuv422,
    /// Clips: three tight planes.
    Yuv444,
}

impl PixelFormat {
    /// All, in the order of the trace file's numbers.
    pub const ALL: [PixelFormat; 9] = [
        PixelFormat::Yuyv,
        PixelFormat::Uyvy,
        PixelFormat::Nv12,
        PixelFormat::Grey,
        PixelFormat::Rgb3,
        PixelFormat::Mjpg,
        PixelFormat::Yuv420,
        PixelFormat::Yuv422,
        PixelFormat::Yuv444,
    ];

    /// The name as in the configuration.
    pub const fn name(self) -> &'static str {
        match self {
            PixelFormat::Yuyv => "yuyv",
            PixelFormat::Uyvy => "uyvy",
            PixelFormat::Nv12 => "nv12",
            PixelFormat::Grey => "grey",
            PixelFormat::Rgb3 => "rgb3",
            PixelFormat::Mjpg => "mjpg",
            PixelFormat::Yuv420 => "yuv420",
            PixelFormat::Yuv422 => "yuv422",
            PixelFormat::Yuv444 => "yuv444",
        }
    }
}

impl std::fmt::Display for PixelFormat {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// Everything needed to understand a raw picture's bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RawFormat {
    /// Layout.
    pub format: PixelFormat,
    /// Picture size in pixels.
    pub size: Size,
    /// Bytes from row to row of the first plane; MJPG and clip planes do not use it.
    pub stride: usize,
    /// Matrix and range. MJPG is always full-range BT.601.
    pub coding: Coding,
    /// Where 4:2:0 chroma lies.
    pub siting: Siting,
}

impl RawFormat {
    /// A tight picture with the default coding.
    pub fn new(format: PixelFormat, size: Size) -> Self {
        let stride = row_bytes(format, size.width);
        Self { format, size, stride, coding: Coding::default(), siting: Siting::default() }
    }

    /// The fewest bytes a whole picture has (MJPG: 2); `None` when size or stride are out of bounds.
    pub fn least_bytes(&self) -> Option<usize> {
        let Size { width, height } = self.size;
        let within = (1..=LARGEST).contains(&width) && (1..=LARGEST).contains(&height);
        let row = row_bytes(self.format, width);
        if !within {
            return None;
        }
        let half = Size::new(width.div_ceil(2), height.div_ceil(2));
        match self.format {
            PixelFormat::Mjpg => Some(2),
            PixelFormat::Yuv420 => Some(self.size.area() + 2 * half.area()),
            PixelFormat::Yuv422 => Some(self.size.area() + 2 * half.width * height),
            PixelFormat::Yuv444 => Some(3 * self.size.area()),
            _ if self.stride < row || self.stride > 8 * LARGEST => None,
            // the pairs' rows are 2·⌈width/2⌉ long, one byte over an odd width
            PixelFormat::Nv12 if self.stride < 2 * half.width => None,
            PixelFormat::Nv12 => Some(self.stride * (height + half.height - 1) + 2 * half.width),
            _ => Some(self.stride * (height - 1) + row),
        }
    }
}

fn row_bytes(format: PixelFormat, width: usize) -> usize {
    match format {
        PixelFormat::Yuyv | PixelFormat::Uyvy => 4 * width.div_ceil(2),
        PixelFormat::Nv12 => 2 * width.div_ceil(2),
        PixelFormat::Rgb3 => 3 * width,
        PixelFormat::Mjpg => 0,
        _ => width,
    }
}

/// A raw picture, borrowed.
#[derive(Clone, Copy, Debug)]
pub struct RawRef<'a> {
    /// What the bytes mean.
    pub format: RawFormat,
    /// The bytes, as delivered.
    pub bytes: &'a [u8],
}

/// Decodes raw pictures; keeps the memory MJPEG needs.
#[derive(Clone, Debug, Default)]
pub struct Decoder {
    ycbcr: Vec<u8>,
}

impl Decoder {
    /// Decodes `raw` into the luma and color of `frame`, resizing it; sequence and time stay as they are.
    ///
    /// The same bytes give the same frame everywhere. On an error `frame` keeps its picture. Allocates only
    /// for MJPG and to grow.
    pub fn decode(&mut self, raw: &RawRef<'_>, frame: &mut Frame) -> Result<(), CameraError> {
        let RawFormat { format, size, stride, siting, .. } = raw.format;
        let Some(least) = raw.format.least_bytes() else {
            return Err(CameraError::Raw(format!(
                "{format} {size} with rows of {stride} bytes is out of bounds"
            )));
        };
        if raw.bytes.len() < least {
            let have = raw.bytes.len();
            return Err(CameraError::Raw(format!("{format} {size} needs {least} bytes, here are {have}")));
        }
        if format == PixelFormat::Mjpg {
            return self.decode_jpeg(raw, frame);
        }
        let half = Size::new(size.width.div_ceil(2), size.height.div_ceil(2));
        let wide = Size::new(half.width, size.height);
        let rows = |from: usize, width: usize, height: usize, stride: usize| {
            let bytes = raw.bytes.get(from..).unwrap_or_default();
            PlaneRef::new(bytes, Size::new(width, height), stride)
        };
        let packed = || rows(0, row_bytes(format, size.width), size.height, stride);
        let planar = |chroma: Size| {
            let first = size.area();
            let cb = rows(first, chroma.width, chroma.height, chroma.width)?;
            let cr = rows(first + chroma.area(), chroma.width, chroma.height, chroma.width)?;
            Some([rows(0, size.width, size.height, size.width)?, cb, cr])
        };
        let samples = match format {
            PixelFormat::Yuyv => packed().map(Samples::Yuyv),
            PixelFormat::Uyvy => packed().map(Samples::Uyvy),
            PixelFormat::Grey => packed().map(Samples::Gray),
            PixelFormat::Rgb3 => packed().map(Samples::Rgb),
            PixelFormat::Nv12 => rows(0, size.width, size.height, stride)
                .zip(rows(stride * size.height, 2 * half.width, half.height, stride))
                .map(|(luma, pairs)| Samples::Nv12(luma, pairs, siting)),
            PixelFormat::Yuv420 => planar(half).map(|planes| Samples::Planar420(planes, siting)),
            PixelFormat::Yuv422 => planar(wide).map(Samples::Planar422),
            PixelFormat::Yuv444 => planar(size).map(Samples::Planar444),
            PixelFormat::Mjpg => None,
        };
        let Some(samples) = samples else {
            return Err(CameraError::Raw(format!("{format} {size}: the planes do not fit")));
        };
        yuv::to_rgb(simd::best(), &samples, size, raw.format.coding, &mut frame.luma, &mut frame.color);
        Ok(())
    }

    fn decode_jpeg(&mut self, raw: &RawRef<'_>, frame: &mut Frame) -> Result<(), CameraError> {
        let size = raw.format.size;
        let fail = |reason: String| CameraError::Raw(format!("MJPEG picture: {reason}"));
        let options = DecoderOptions::default()
            .set_strict_mode(true)
            .set_max_width(size.width)
            .set_max_height(size.height)
            .jpeg_set_out_colorspace(ColorSpace::YCbCr);
        let mut decoder = JpegDecoder::new_with_options(ZCursor::new(raw.bytes), options);
        decoder.decode_headers().map_err(|e| fail(format!("{e:?}")))?;
        let info = decoder.info().ok_or_else(|| fail("no header".into()))?;
        if (usize::from(info.width), usize::from(info.height)) != (size.width, size.height) {
            return Err(fail(format!("it is {}x{}, not {size}", info.width, info.height)));
        }
        let gray = match decoder.input_colorspace() {
            Some(ColorSpace::Luma) => true,
            Some(ColorSpace::YCbCr) => false,
            other => return Err(fail(format!("color space {other:?}"))),
        };
        if gray {
            decoder.set_options(options.jpeg_set_out_colorspace(ColorSpace::Luma));
        }
        let row = if gray { size.width } else { 3 * size.width };
        let needed = row * size.height;
        if decoder.output_buffer_size() != Some(needed) {
            return Err(fail("an output of unexpected size".into()));
        }
        if self.ycbcr.len() < needed {
            self.ycbcr.resize(needed, 0);
        }
        let bytes = &mut self.ycbcr[..needed];
        decoder.decode_into(bytes).map_err(|e| fail(format!("{e:?}")))?;
        let Some(view) = PlaneRef::new(bytes, Size::new(row, size.height), row) else {
            return Err(fail("an output of unexpected size".into()));
        };
        let samples = if gray { Samples::Gray(view) } else { Samples::Packed444(view) };
        let coding = Coding { matrix: Matrix::Bt601, range: Range::Full };
        yuv::to_rgb(simd::best(), &samples, size, coding, &mut frame.luma, &mut frame.color);
        Ok(())
    }
}

/// Decodes one raw picture; see [`Decoder::decode`].
pub fn decode(raw: &RawRef<'_>, frame: &mut Frame) -> Result<(), CameraError> {
    Decoder::default().decode(raw, frame)
}
