//! Picture files in and out, through the `image` crate: PNG, JPEG, PGM/PPM in; PNG out.

use super::{Plane, Rgb, Size};
use std::path::{Path, PathBuf};

/// Why a picture file could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// The file cannot be opened.
    #[error("{}: cannot open picture: {source}", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file opens, but is not a whole picture of a kind we read.
    #[error("{}: not a readable PNG, JPEG or PGM/PPM picture ({reason}); convert or copy it again", path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// What the decoder said.
        reason: String,
    },
    /// The file cannot be written.
    #[error("{}: cannot write picture: {reason}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the encoder or the system said.
        reason: String,
    },
}

/// Reads a picture as planar RGB; gray is repeated, alpha dropped, 16 bits are rounded to 8.
pub fn read(path: &Path) -> Result<Rgb, PictureError> {
    Ok(planar(open(path)?))
}

/// Decodes a PNG, JPEG or PGM/PPM file in memory as [`read`] does. Refuses sides above `side_px` and more than `area`
/// pixels before it makes room for them; the error says why.
pub fn decode(bytes: &[u8], side_px: u32, area: u64) -> Result<Rgb, String> {
    let reader = |max_alloc| {
        let cursor = std::io::Cursor::new(bytes);
        let mut reader = image::ImageReader::new(cursor).with_guessed_format().map_err(|e| e.to_string())?;
        let mut limits = image::Limits::default();
        limits.max_alloc = Some(max_alloc);
        reader.limits(limits);
        Ok::<_, String>(reader)
    };
    let (width, height) = reader(1 << 20)?.into_dimensions().map_err(|e| e.to_string())?;
    let pixels = u64::from(width) * u64::from(height);
    if width.max(height) > side_px || pixels > area {
        return Err(format!("{width}x{height}: at most {side_px} px a side and {area} pixels in all"));
    }
    if pixels == 0 {
        return Err("it has no pixels".into());
    }
    // four channels of 16 bits, and as much again for the decoder itself
    reader(16 * pixels + (1 << 20))?.decode().map(planar).map_err(|e| e.to_string())
}

fn planar(picture: image::DynamicImage) -> Rgb {
    let decoded = picture.into_rgb8();
    let size = Size::new(decoded.width() as usize, decoded.height() as usize);
    let bytes = decoded.as_raw();
    let channel = |c: usize| Plane::from_fn(size, |x, y| bytes[(y * size.width + x) * 3 + c]);
    Rgb { planes: [channel(0), channel(1), channel(2)] }
}

/// Reads a picture as one gray plane (BT.601 luma for color files).
pub fn read_gray(path: &Path) -> Result<Plane<u8>, PictureError> {
    let decoded = open(path)?;
    let gray = if decoded.color().has_color() {
        let rgb = decoded.into_rgb8();
        let luma = |p: &image::Rgb<u8>| {
            let [r, g, b] = p.0.map(u32::from);
            ((9798 * r + 19235 * g + 3735 * b + 16384) >> 15) as u8
        };
        image::GrayImage::from_fn(rgb.width(), rgb.height(), |x, y| image::Luma([luma(rgb.get_pixel(x, y))]))
    } else {
        decoded.into_luma8()
    };
    let size = Size::new(gray.width() as usize, gray.height() as usize);
    Ok(Plane::from_vec(size, gray.into_raw()).unwrap_or_default())
}

fn open(path: &Path) -> Result<image::DynamicImage, PictureError> {
    let fail = |reason: String| PictureError::Decode { path: path.into(), reason };
    let open = |source| PictureError::Open { path: path.into(), source };
    let reader = image::ImageReader::open(path).map_err(open)?.with_guessed_format().map_err(open)?;
    let picture = reader.decode().map_err(|e| fail(e.to_string()))?;
    if picture.width() == 0 || picture.height() == 0 {
        return Err(fail("it has no pixels".into()));
    }
    Ok(picture)
}

/// Writes an 8-bit RGB PNG.
pub fn write_png(path: &Path, picture: &Rgb) -> Result<(), PictureError> {
    let size = picture.size();
    let buffer = image::RgbImage::from_fn(size.width as u32, size.height as u32, |x, y| {
        image::Rgb(picture.at(x as usize, y as usize))
    });
    let fail = |reason: String| PictureError::Write { path: path.into(), reason };
    // encoded in memory: the file's last bytes would otherwise be written on drop, where errors are lost
    let mut file = std::io::Cursor::new(Vec::new());
    buffer.write_to(&mut file, image::ImageFormat::Png).map_err(|e| fail(e.to_string()))?;
    std::fs::write(path, file.into_inner()).map_err(|e| fail(e.to_string()))
}
