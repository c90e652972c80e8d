//! Cameras of the Linux kernel: finding one, agreeing on a format, grabbing.
//!
//! An error means that this camera must be opened anew (drop it, then `open` again); a time-out does not.

use super::grab::{Grabber, Stats};
use super::negotiate::{self, Granted, Offer, Ranked};
use super::raw::{RawFormat, RawRef};
use super::streaming::{Device, Stream};
use super::{CameraError, Config, Grab};
use crate::frame::{Frame, now};
use crate::pixels::Size;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;
use v4l::frameinterval::FrameIntervalEnum;
use v4l::framesize::FrameSizeEnum;
use v4l::v4l_sys as sys;
use v4l::video::Capture;

/// A video node, and whether it can serve.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// The node.
    pub path: PathBuf,
    /// The name of the device.
    pub card: String,
    /// The kernel driver.
    pub driver: String,
    /// What it offers, best first; empty when it cannot serve.
    pub offers: Vec<Ranked>,
    /// Why it cannot serve.
    pub refusal: Option<String>,
}

/// Every `/dev/video*` node by number, with its offers ranked for `config`.
pub fn probe(config: &Config) -> Vec<Candidate> {
    nodes().into_iter().map(|path| candidate(&path, config).1).collect()
}

fn nodes() -> Vec<PathBuf> {
    let mut found: Vec<(u32, PathBuf)> = std::fs::read_dir("/dev")
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(|entry| {
            let number = entry.file_name().to_str()?.strip_prefix("video")?.parse().ok()?;
            Some((number, entry.path()))
        })
        .collect();
    found.sort();
    found.into_iter().map(|(_, path)| path).collect()
}

fn candidate(path: &Path, config: &Config) -> (Option<Device>, Candidate) {
    let mut candidate = Candidate {
        path: path.to_path_buf(),
        card: String::new(),
        driver: String::new(),
        offers: Vec::new(),
        refusal: None,
    };
    let device = match Device::open(path) {
        Ok(device) => device,
        Err(error) => {
            candidate.refusal = Some(error.to_string());
            return (None, candidate);
        }
    };
    match device.capability() {
        Err(error) => candidate.refusal = Some(format!("not a video device ({error})")),
        Ok(capability) => {
            candidate.card = capability.card;
            candidate.driver = capability.driver;
            candidate.refusal = refusal(capability.flags).map(str::to_string);
        }
    }
    if candidate.refusal.is_none() {
        candidate.offers = negotiate::rank(&offers(&device, config), &config.wish());
        if candidate.offers.is_empty() {
            let names: Vec<String> = device.formats().into_iter().map(negotiate::fourcc_name).collect();
            let wanted = config.format.name();
            candidate.refusal = Some(format!(
                "no format that serves (camera.format = \"{wanted}\"; it has {})",
                names.join(" ")
            ));
        }
    }
    (Some(device), candidate)
}

/// Why a node with these capability bits is not a camera for us.
fn refusal(flags: u32) -> Option<&'static str> {
    if flags & (sys::V4L2_CAP_VIDEO_M2M | sys::V4L2_CAP_VIDEO_M2M_MPLANE) != 0 {
        Some("a converter, not a camera")
    } else if flags & sys::V4L2_CAP_VIDEO_CAPTURE != 0 {
        (flags & sys::V4L2_CAP_STREAMING == 0).then_some("it cannot stream")
    } else if flags & sys::V4L2_CAP_VIDEO_CAPTURE_MPLANE != 0 {
        Some("it captures in several planes only")
    } else {
        Some("it does not capture pictures")
    }
}

fn offers(device: &Device, config: &Config) -> Vec<Offer> {
    let mut found = Vec::new();
    let wished = config.wish().size;
    for code in device.formats() {
        let Some(format) = negotiate::from_fourcc(code) else { continue };
        let name = v4l::FourCC::from(code);
        let mut sizes: Vec<Size> = Vec::new();
        for size in device.inner().enum_framesizes(name).unwrap_or_default() {
            sizes.push(match size.size {
                FrameSizeEnum::Discrete(d) => Size::new(d.width as usize, d.height as usize),
                FrameSizeEnum::Stepwise(s) => Size::new(
                    nearest(wished.width, s.min_width, s.max_width, s.step_width),
                    nearest(wished.height, s.min_height, s.max_height, s.step_height),
                ),
            });
        }
        if sizes.is_empty() {
            // a driver need not list sizes: S_FMT will say
            sizes.push(wished);
        }
        for size in sizes {
            found.push(Offer { format, size, fps: fastest(device, name, size) });
        }
    }
    found
}

/// The value of min, min + step, .. max nearest below or at `wished`.
fn nearest(wished: usize, min: u32, max: u32, step: u32) -> usize {
    let (min, max, step) = (min as usize, max as usize, step.max(1) as usize);
    let at = wished.clamp(min, max.max(min));
    at - (at - min) % step
}

fn fastest(device: &Device, name: v4l::FourCC, size: Size) -> Option<f64> {
    let intervals = device.inner().enum_frameintervals(name, size.width as u32, size.height as u32).ok()?;
    let rate =
        |interval: v4l::Fraction| f64::from(interval.denominator) / f64::from(interval.numerator.max(1));
    let rates = intervals.into_iter().map(|i| match i.interval {
        FrameIntervalEnum::Discrete(interval) => rate(interval),
        FrameIntervalEnum::Stepwise(s) => rate(s.min),
    });
    rates.max_by(f64::total_cmp)
}

/// A running camera.
pub struct V4l2 {
    device: String,
    card: String,
    reason: String,
    fps: Option<f64>,
    stream: Stream,
    grabber: Grabber,
}

impl V4l2 {
    /// Opens `config.device` ("auto": the first node that serves), sets format and rate, starts streaming.
    pub fn open(config: &Config) -> Result<Self, CameraError> {
        let (device, candidate) = if config.device == "auto" { first(config)? } else { named(config)? };
        let name = candidate.path.display().to_string();
        let Some(best) = candidate.offers.first() else {
            return Err(CameraError::Unsuitable { device: name, reason: "it offers nothing".into() });
        };
        let fail = |step: &'static str| {
            let device = name.clone();
            move |source: io::Error| classify(device, step, source)
        };
        let Offer { format, size, .. } = best.offer;
        let code = negotiate::fourcc(format);
        let set = device
            .set_format(size.width as u32, size.height as u32, code)
            .map_err(fail("setting the format"))?;
        let raw = negotiate::granted(
            &name,
            &Granted {
                width: set.width,
                height: set.height,
                fourcc: set.fourcc,
                bytes_per_line: set.bytes_per_line,
                colorspace: set.colorspace,
                encoding: set.encoding,
                quantization: set.quantization,
            },
        )?;
        if ![sys::v4l2_field_V4L2_FIELD_NONE, sys::v4l2_field_V4L2_FIELD_ANY].contains(&set.field) {
            log::warn!(
                "{name} delivers interlaced pictures (field order {}); they are shown as they come",
                set.field
            );
        }
        let fps = set_rate(&device, config.fps);
        let stream = device.stream(config.buffers.clamp(2, 32)).map_err(fail("starting the stream"))?;
        log::info!(
            "{name} ({}): {} {}, rows of {} bytes, {:?}, {}; chosen: {}",
            candidate.card,
            raw.format,
            raw.size,
            raw.stride,
            raw.coding,
            fps.map_or("rate not told".into(), |fps| format!("{fps:.2}/s")),
            best.reason
        );
        Ok(Self {
            device: name,
            card: candidate.card,
            reason: best.reason.clone(),
            fps,
            stream,
            grabber: Grabber::new(raw),
        })
    }

    /// The node.
    pub fn device(&self) -> &str {
        &self.device
    }

    /// The name of the device.
    pub fn card(&self) -> &str {
        &self.card
    }

    /// Why this format was chosen.
    pub fn reason(&self) -> &str {
        &self.reason
    }

    /// What the driver set.
    pub fn format(&self) -> RawFormat {
        self.grabber.format
    }

    /// Pictures a second, where the driver says.
    pub fn fps(&self) -> Option<f64> {
        self.fps
    }

    /// The accounts so far.
    pub fn stats(&self) -> Stats {
        self.grabber.stats
    }

    pub(super) fn keep_raw(&mut self, keep: bool) {
        self.grabber.raw = keep.then(Vec::new);
    }

    pub(super) fn raw(&self) -> Option<RawRef<'_>> {
        let bytes = self.grabber.raw.as_deref().filter(|bytes| !bytes.is_empty())?;
        Some(RawRef { format: self.grabber.format, bytes })
    }

    /// The newest frame, waiting up to `timeout` for one.
    pub fn next(&mut self, frame: &mut Frame, timeout: Duration) -> Result<Grab, CameraError> {
        match self.grabber.grab(&mut self.stream, frame, timeout, now) {
            Ok(true) => Ok(Grab::Frame),
            Ok(false) => Ok(Grab::Timeout),
            Err(source) => Err(classify(self.device.clone(), "grabbing a frame", source)),
        }
    }
}

/// Gone, busy or faulty?
fn classify(device: String, step: &'static str, source: io::Error) -> CameraError {
    const ENXIO: i32 = 6;
    const ENODEV: i32 = 19;
    match source.raw_os_error() {
        Some(ENXIO | ENODEV) => CameraError::Lost { device, source },
        _ if source.kind() == io::ErrorKind::ResourceBusy => CameraError::Busy { device },
        _ => CameraError::Fault { device, step, source },
    }
}

fn named(config: &Config) -> Result<(Device, Candidate), CameraError> {
    let path = Path::new(&config.device);
    if let Err(source) = std::fs::metadata(path) {
        let device = config.device.clone();
        return Err(match source.kind() {
            io::ErrorKind::NotFound => CameraError::NoCamera { device, others: others(config) },
            _ => CameraError::Fault { device, step: "looking at it", source },
        });
    }
    match candidate(path, config) {
        (Some(device), candidate) if candidate.refusal.is_none() => Ok((device, candidate)),
        (_, candidate) => Err(CameraError::Unsuitable {
            device: config.device.clone(),
            reason: candidate.refusal.unwrap_or_default(),
        }),
    }
}

fn first(config: &Config) -> Result<(Device, Candidate), CameraError> {
    let mut refused = Vec::new();
    for path in nodes() {
        match candidate(&path, config) {
            (Some(device), candidate) if candidate.refusal.is_none() => return Ok((device, candidate)),
            (_, c) => refused.push(format!("{}: {}", path.display(), c.refusal.unwrap_or_default())),
        }
    }
    let others = if refused.is_empty() { String::new() } else { format!(" ({})", refused.join("; ")) };
    Err(CameraError::NoCamera { device: "/dev/video*".into(), others })
}

fn others(config: &Config) -> String {
    let serving: Vec<String> = probe(config)
        .into_iter()
        .filter(|c| c.refusal.is_none())
        .map(|c| c.path.display().to_string())
        .collect();
    if serving.is_empty() { String::new() } else { format!(" (there is {})", serving.join(", ")) }
}

/// Asks for a rate; gives the one the driver holds, if it holds one.
fn set_rate(device: &Device, fps: f64) -> Option<f64> {
    let wished = v4l::Fraction::new(1000, (fps.clamp(1.0, 1000.0) * 1000.0) as u32);
    let parameters = v4l::video::capture::Parameters::new(wished);
    // inputs paced by a signal have no rate to set
    let set = device.inner().set_params(&parameters).or_else(|_| device.inner().params()).ok()?;
    let interval = set.interval;
    (interval.numerator > 0 && interval.denominator > 0)
        .then(|| f64::from(interval.denominator) / f64::from(interval.numerator))
}

#[cfg(test)]
mod tests {
    use super::super::raw::PixelFormat;
    use super::*;

    #[test]
    fn nodes_that_do_not_capture_are_refused_by_name() {
        let capture = sys::V4L2_CAP_VIDEO_CAPTURE | sys::V4L2_CAP_STREAMING;
        assert_eq!(refusal(capture), None);
        assert_eq!(refusal(sys::V4L2_CAP_VIDEO_CAPTURE), Some("it cannot stream"));
        assert_eq!(refusal(sys::V4L2_CAP_VIDEO_M2M | capture), Some("a converter, not a camera"));
        assert_eq!(refusal(sys::V4L2_CAP_VIDEO_OUTPUT), Some("it does not capture pictures"));
        assert_eq!(refusal(sys::V4L2_CAP_VIDEO_CAPTURE_MPLANE), Some("it captures in several planes only"));
    }

    #[test]
    fn stepwise_sizes_come_nearest_to_the_wish() {
        assert_eq!(nearest(640, 16, 3840, 2), 640);
        assert_eq!(nearest(641, 16, 3840, 2), 640);
        assert_eq!(nearest(8, 16, 3840, 2), 16);
        assert_eq!(nearest(9000, 16, 3840, 0), 3840);
        assert_eq!(nearest(10, 20, 5, 1), 20);
    }

    #[test]
    fn errors_are_told_apart() {
        let io = io::Error::from_raw_os_error;
        assert!(matches!(classify("x".into(), "s", io(19)), CameraError::Lost { .. }));
        assert!(matches!(classify("x".into(), "s", io(16)), CameraError::Busy { .. }));
        assert!(matches!(classify("x".into(), "s", io(5)), CameraError::Fault { .. }));
    }

    #[test]
    fn formats_round_trip_through_fourcc() {
        for format in &PixelFormat::ALL[..6] {
            assert_eq!(negotiate::from_fourcc(negotiate::fourcc(*format)), Some(*format));
        }
        assert_eq!(negotiate::from_fourcc(u32::from_le_bytes(*b"H264")), None);
    }
}
