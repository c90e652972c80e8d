//! Calibrations as files: our `[lens]` table, OpenCV's YAML and ROS's camera_info YAML, read and written.

use super::yaml;
use crate::geometry::Lens;
use crate::pixels::Size;
use glam::DVec2;
use serde::Deserialize;
use std::fmt::Write;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Largest file that is read, bytes.
const MOST_BYTES: u64 = 1 << 16;

/// The `[lens]` table: a calibration, pixel centers at integers, for pictures of `width` x `height`; pictures of another
/// size with the same shape use it scaled. Either a file or the numbers.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LensConfig {
    /// A calibration file beside this one: such a table, or YAML of OpenCV or ROS.
    pub file: Option<PathBuf>,
    /// Width of the calibrated pictures, px.
    pub width: usize,
    /// Height of the calibrated pictures, px.
    pub height: usize,
    /// Focal length along x, px, > 0.
    pub fx: f64,
    /// Focal length along y, px, > 0.
    pub fy: f64,
    /// Principal point, px.
    pub cx: f64,
    /// Principal point, px.
    pub cy: f64,
    /// k1 k2 p1 p2 [k3 [k4 k5 k6]] as OpenCV; missing ones are 0.
    pub dist: Vec<f64>,
}

/// What is wrong with a calibration: the line where known, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{reason}")]
pub struct LensError {
    /// Line, from 1.
    pub line: usize,
    /// What is wrong and what to do.
    pub reason: String,
}

/// Why a calibration file cannot be used; its text is one line.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// It cannot be read.
    #[error("{}: cannot read the calibration: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// It is no calibration.
    #[error("{}:{line}: {reason}", path.display())]
    Wrong {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What is wrong and what to do.
        reason: String,
    },
}

/// A file with our table.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Toml {
    lens: LensConfig,
}

impl LensConfig {
    /// Reads a calibration file: TOML where its name ends so, else YAML.
    pub fn read(path: &Path) -> Result<Self, FileError> {
        let failed = |source| FileError::Read { path: path.into(), source };
        let mut bytes = Vec::new();
        let file = std::fs::File::open(path).map_err(failed)?;
        file.take(MOST_BYTES + 1).read_to_end(&mut bytes).map_err(failed)?;
        let is_toml = path.extension().is_some_and(|end| end.eq_ignore_ascii_case("toml"));
        Self::parse(&bytes, is_toml).map_err(|LensError { line, reason }| FileError::Wrong {
            path: path.into(),
            line,
            reason,
        })
    }

    /// Reads calibration text.
    pub fn parse(bytes: &[u8], is_toml: bool) -> Result<Self, LensError> {
        let wrong = |line, reason: &str| LensError { line, reason: reason.into() };
        if bytes.len() as u64 > MOST_BYTES {
            return Err(wrong(1, "larger than 64 kB: not a calibration"));
        }
        let text = std::str::from_utf8(bytes).map_err(|e| {
            let line = 1 + bytes[..e.valid_up_to()].iter().filter(|&&b| b == b'\n').count();
            wrong(line, "not text (UTF-8): not a calibration")
        })?;
        let lens = if is_toml {
            let toml: Toml = toml::from_str(text).map_err(|e| {
                let at = e.span().map_or(0, |span| span.start).min(text.len());
                let line = 1 + text.as_bytes()[..at].iter().filter(|&&b| b == b'\n').count();
                let reason = e.message().lines().map(str::trim).collect::<Vec<_>>().join(", ");
                wrong(line, &format!("{reason}; a calibration is a [lens] table"))
            })?;
            if toml.lens.file.is_some() {
                return Err(wrong(1, "lens.file: a calibration holds the numbers themselves"));
            }
            toml.lens
        } else {
            yaml::read(text)?
        };
        lens.check().map_err(|reason| wrong(1, &reason))?;
        Ok(lens)
    }

    /// The first thing that is wrong with the numbers, if any. With a `file` there are none.
    pub fn check(&self) -> Result<(), String> {
        let numbers = [self.fx, self.fy, self.cx, self.cy];
        if self.file.is_some() {
            let other = Self { file: self.file.clone(), ..Self::default() };
            return if *self == other { Ok(()) } else { Err("lens: give either file or the numbers".into()) };
        }
        if self.width == 0 || self.height == 0 {
            return Err("lens.width and lens.height must be above 0".into());
        }
        if self.width > 1 << 16 || self.height > 1 << 16 {
            return Err(format!("lens: {} x {} px is no camera's picture", self.width, self.height));
        }
        if !numbers.iter().chain(&self.dist).all(|v| v.is_finite()) || self.fx <= 0.0 || self.fy <= 0.0 {
            return Err("lens: fx and fy must be above 0, all numbers finite".into());
        }
        if ![0, 4, 5, 8].contains(&self.dist.len()) {
            return Err(format!(
                "lens.dist has {} numbers: give 4, 5 or 8 (k1 k2 p1 p2 k3 k4 k5 k6)",
                self.dist.len()
            ));
        }
        Ok(())
    }

    /// The size of the pictures it was made with.
    pub fn size(&self) -> Size {
        Size::new(self.width, self.height)
    }

    /// The lens for pictures of `size`; `None` where they have another shape than the calibrated ones.
    pub fn lens(&self, size: Size) -> Option<Lens> {
        let scale =
            DVec2::new(size.width as f64 / self.width as f64, size.height as f64 / self.height as f64);
        let stretch = (scale.x / scale.y - 1.0).abs();
        if stretch.is_nan() || stretch > 0.01 {
            return None;
        }
        let mut distortion = [0.0; 8];
        for (to, from) in distortion.iter_mut().zip(&self.dist) {
            *to = *from;
        }
        // pixel centers at integers: scaling keeps the picture's edge at -.5
        let center = (DVec2::new(self.cx, self.cy) + 0.5) * scale - 0.5;
        Some(Lens { size, focal: DVec2::new(self.fx, self.fy) * scale, center, distortion })
    }

    /// The calibration of a lens.
    pub fn of(lens: &Lens) -> Self {
        let rational = lens.distortion[5..].iter().any(|k| *k != 0.0);
        Self {
            file: None,
            width: lens.size.width,
            height: lens.size.height,
            fx: lens.focal.x,
            fy: lens.focal.y,
            cx: lens.center.x,
            cy: lens.center.y,
            dist: lens.distortion[..if rational { 8 } else { 5 }].to_vec(),
        }
    }

    /// As our table; `remark` becomes a comment.
    pub fn to_toml(&self, remark: &str) -> String {
        let Self { width, height, fx, fy, cx, cy, .. } = self;
        let dist = self.dist.iter().map(|k| exact(*k)).collect::<Vec<_>>().join(", ");
        let [fx, fy, cx, cy] = [fx, fy, cx, cy].map(|v| exact(*v));
        format!(
            "# {remark}\n[lens]\nwidth = {width}\nheight = {height}\nfx = {fx}\nfy = {fy}\ncx = {cx}\ncy = {cy}\n\
             dist = [{dist}]    # k1 k2 p1 p2 k3, as OpenCV\n"
        )
    }

    /// As OpenCV's FileStorage writes it.
    pub fn to_opencv(&self, rms_px: f64) -> String {
        let Self { width, height, .. } = self;
        let matrix = |name: &str, rows: usize, values: &[f64]| {
            let columns = values.len() / rows;
            let data = values.iter().map(|v| exact(*v)).collect::<Vec<_>>().join(", ");
            format!(
                "{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {data} ]\n"
            )
        };
        format!(
            "%YAML:1.0\n---\nimage_width: {width}\nimage_height: {height}\n{}{}avg_reprojection_error: {}\n",
            matrix("camera_matrix", 3, &self.matrix()),
            matrix("distortion_coefficients", self.dist.len().max(1), &self.dist),
            exact(rms_px)
        )
    }

    /// As ROS's camera_info.
    pub fn to_ros(&self, name: &str) -> String {
        let Self { width, height, .. } = self;
        let matrix = |name: &str, rows: usize, values: &[f64]| {
            let columns = values.len() / rows;
            let data = values.iter().map(|v| exact(*v)).collect::<Vec<_>>().join(", ");
            format!("{name}:\n  rows: {rows}\n  cols: {columns}\n  data: [{data}]\n")
        };
        let [a, b, c, d, e, f, ..] = self.matrix();
        let model = if self.dist.len() > 5 { "rational_polynomial" } else { "plumb_bob" };
        let mut out = format!("image_width: {width}\nimage_height: {height}\ncamera_name: {name}\n");
        // writing to a String cannot fail
        _ = write!(
            out,
            "{}distortion_model: {model}\n{}{}{}",
            matrix("camera_matrix", 3, &self.matrix()),
            matrix("distortion_coefficients", 1, &self.dist),
            matrix("rectification_matrix", 3, &[1., 0., 0., 0., 1., 0., 0., 0., 1.]),
            matrix("projection_matrix", 3, &[a, b, c, 0., d, e, f, 0., 0., 0., 1., 0.])
        );
        out
    }

    /// The camera matrix, row by row.
    fn matrix(&self) -> [f64; 9] {
        [self.fx, 0.0, self.cx, 0.0, self.fy, self.cy, 0.0, 0.0, 1.0]
    }
}

/// With all its digits, and a point or an exponent: some readers take `1` for a whole number.
fn exact(v: f64) -> String {
    format!("{v:?}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn some() -> LensConfig {
        LensConfig {
            width: 640,
            height: 480,
            fx: 571.25,
            fy: 566.5,
            cx: 327.4,
            cy: 231.9,
            dist: vec![-0.24, 0.09, 8e-4, -1.1e-3, 1e-7],
            ..LensConfig::default()
        }
    }

    #[test]
    fn what_is_written_is_read_again() {
        let eight = LensConfig { dist: vec![-0.2, 0.1, 0.0, 0.0, 0.01, 0.3, 0.2, 0.1], ..some() };
        for lens in [some(), eight] {
            for (text, is_toml) in
                [(lens.to_toml("by hand"), true), (lens.to_opencv(0.1), false), (lens.to_ros("visor"), false)]
            {
                assert_eq!(LensConfig::parse(text.as_bytes(), is_toml).expect(&text), lens);
            }
        }
    }

    #[test]
    fn a_calibration_scales_with_the_picture() {
        let lens = some().lens(Size::new(1280, 960)).expect("the same shape");
        assert_eq!((lens.focal.x, lens.center.x, lens.distortion[0]), (1142.5, 655.3, -0.24));
        assert!(some().lens(Size::new(1280, 720)).is_none(), "another shape");
        assert_eq!(LensConfig::of(&some().lens(Size::new(640, 480)).expect("itself")), some());
    }
}
