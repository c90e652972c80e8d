//! The camera's settings: the `[camera]` table of the visor file.

use super::controls::Exposure;
use super::negotiate::Wish;
use super::raw::{LARGEST, PixelFormat};
use super::{SyntheticConfig, select};
use crate::pixels::Size;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Which source frames come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A camera of the Linux kernel.
    #[default]
    V4l2,
    /// Pictures or a Y4M clip.
    Clip,
    /// A trace that `run --trace` recorded.
    Trace,
    /// The drawn table with its marker.
    Synthetic,
}

/// The format to ask a camera for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum FormatChoice {
    /// The best that the camera has: see `negotiate::rank`.
    #[default]
    Auto,
    /// Packed 4:2:2.
    Yuyv,
    /// Packed 4:2:2, chroma first.
    Uyvy,
    /// 4:2:0 in two planes.
    Nv12,
    /// Luma alone.
    Grey,
    /// R, G, B bytes.
    Rgb3,
    /// Motion JPEG.
    Mjpg,
}

impl FormatChoice {
    /// The named format, `None` for auto.
    pub fn format(self) -> Option<PixelFormat> {
        match self {
            FormatChoice::Auto => None,
            FormatChoice::Yuyv => Some(PixelFormat::Yuyv),
            FormatChoice::Uyvy => Some(PixelFormat::Uyvy),
            FormatChoice::Nv12 => Some(PixelFormat::Nv12),
            FormatChoice::Grey => Some(PixelFormat::Grey),
            FormatChoice::Rgb3 => Some(PixelFormat::Rgb3),
            FormatChoice::Mjpg => Some(PixelFormat::Mjpg),
        }
    }

    /// The name as in the configuration.
    pub fn name(self) -> &'static str {
        self.format().map_or("auto", PixelFormat::name)
    }
}

/// Settings of the camera room: `[camera]` in the configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// "v4l2", "clip", "trace" or "synthetic".
    pub source: Kind,
    /// The camera's node, as /dev/video0 or a link to it under /dev/v4l/by-id or by-path; "usb:VID:PID" or
    /// "usb:VID:PID:serial" (hexadecimal, as `lsusb` shows them); "auto": the first that serves.
    pub device: String,
    /// Clip: a folder of pictures, a picture, a Y4M file, or "-" for Y4M on stdin. Trace: its file.
    pub path: PathBuf,
    /// Wished width in pixels, 1..8192. Clips and traces have their own.
    pub width: usize,
    /// Wished height in pixels, 1..8192.
    pub height: usize,
    /// Wished pictures a second, 1..1000; for pictures in a folder: the rate they are taken to have.
    pub fps: f64,
    /// "auto", or the only format to use: yuyv, uyvy, nv12, grey, rgb3, mjpg.
    pub format: FormatChoice,
    /// Buffers shared with the driver, 2..32: more survive longer pauses, none add latency.
    pub buffers: u32,
    /// The camera's controls by name, as `v4l2-ctl --list-ctrls` shows them; set at every opening, automatic modes first.
    pub controls: BTreeMap<String, i64>,
    /// "auto" (the default): exposure as the camera likes; "lock": so for `exposure_lock_s` seconds, then kept with gain
    /// and white balance; "fixed": `exposure_value`.
    pub exposure: Exposure,
    /// Seconds of pictures before exposure is locked, 0 to 3600. Default 3.
    pub exposure_lock_s: f64,
    /// The fixed exposure, in the camera's units (UVC: 100 µs).
    pub exposure_value: i64,
    /// The drawn table, for `source = "synthetic"`.
    pub synthetic: SyntheticConfig,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            source: Kind::default(),
            device: "auto".into(),
            path: PathBuf::new(),
            width: 640,
            height: 480,
            fps: 30.0,
            format: FormatChoice::Auto,
            buffers: 4,
            controls: BTreeMap::new(),
            exposure: Exposure::Auto,
            exposure_lock_s: 3.0,
            exposure_value: 156,
            synthetic: SyntheticConfig::default(),
        }
    }
}

impl Config {
    /// Reads clips or pictures from `path`.
    pub fn clip(path: impl Into<PathBuf>) -> Self {
        Self { source: Kind::Clip, path: path.into(), ..Self::default() }
    }

    /// Takes a relative `path` as relative to `folder`; `-` stays stdin.
    pub fn resolve(&mut self, folder: &Path) {
        if self.path != Path::new("-") && !self.path.as_os_str().is_empty() {
            self.path = folder.join(&self.path);
        }
    }

    /// The first setting beyond its range: its key and what to do.
    pub fn check(&self) -> Result<(), (&'static str, String)> {
        for (key, side) in [("width", self.width), ("height", self.height)] {
            if !(1..=LARGEST).contains(&side) {
                return Err((key, format!("camera.{key} = {side}: give 1 to {LARGEST} px")));
            }
        }
        if !(1.0..=1000.0).contains(&self.fps) {
            return Err(("fps", format!("camera.fps = {}: give 1 to 1000", self.fps)));
        }
        if let Err(reason) = select::Named::parse(&self.device) {
            return Err(("device", reason));
        }
        if !(0.0..=3600.0).contains(&self.exposure_lock_s) {
            let value = self.exposure_lock_s;
            return Err(("exposure_lock_s", format!("camera.exposure_lock_s = {value}: give 0 to 3600")));
        }
        let SyntheticConfig { family, id, side_mm, k1, pace, .. } = self.synthetic;
        let codes = family.codes().len();
        if id as usize >= codes {
            let family = family.name();
            return Err(("id", format!("camera.synthetic.id = {id}: {family} has ids 0 to {}", codes - 1)));
        }
        // beyond these nothing can be seen
        let ranges = [("side_mm", side_mm, 1.0, 1000.0), ("k1", k1, -1.0, 1.0), ("pace", pace, 0.0, 100.0)];
        for (key, value, low, high) in ranges {
            if !(low..=high).contains(&value) {
                return Err((key, format!("camera.synthetic.{key} = {value}: give {low} to {high}")));
            }
        }
        Ok(())
    }

    /// What a camera is asked for.
    pub fn wish(&self) -> Wish {
        let fps = if self.fps.is_finite() { self.fps.clamp(1.0, 1000.0) } else { 30.0 };
        let size = Size::new(self.width.clamp(1, LARGEST), self.height.clamp(1, LARGEST));
        Wish { size, fps, format: self.format.format() }
    }
}
