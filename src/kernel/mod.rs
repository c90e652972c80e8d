//! One image kernel a file: a fast body, generic over the SIMD level, and its plain f64 reference.
//!
//! Values: colors are f = byte / 255 on gamma-coded sRGB; borders clamp to the edge. A kernel divides its rows
//! into bands for rayon's current pool; no result depends on where the bands lie.

pub mod area;
pub mod bilateral;
pub mod canny;
pub mod color;
pub mod contrast;
pub mod enlarge;
pub mod gaussian;
pub mod interleave;
pub mod mix;
pub mod photometric;
pub mod pyramid;
pub mod sobel;
pub mod voronoi;
pub mod yuv;

#[cfg(test)]
pub(crate) mod sweep;

/// Rows a band: about four bands a thread, so that a thread that was interrupted is helped out, and at least
/// `least` rows, so that the work shared between bands stays small.
pub(crate) fn band_rows(height: usize, least: usize) -> usize {
    let threads = rayon::current_num_threads();
    if threads == 1 { height.max(1) } else { height.div_ceil(4 * threads).max(least) }
}
