//! Cameras of the Linux kernel: agreeing on a format, setting controls, grabbing.
//!
//! An error means that this camera must be opened anew (drop it, then `open` again); a time-out does not.

use super::controls::{self, Exposure, LockClock, Setting};
use super::find::{Candidate, find, is_gone};
use super::grab::{Grabber, Stats};
use super::negotiate::{self, Granted, Offer, Ranked};
use super::raw::{RawFormat, RawRef};
use super::select;
use super::streaming::{Device, Stream};
use super::{CameraError, Config, Grab};
use crate::frame::{Frame, now};
use std::io;
use std::path::Path;
use std::time::Duration;
use v4l::v4l_sys as sys;
use v4l::video::Capture;

/// A running camera.
pub struct V4l2 {
    device: String,
    card: String,
    reason: String,
    fps: Option<f64>,
    stream: Stream,
    grabber: Grabber,
    /// When automatic modes are switched off.
    lock: Option<LockClock>,
}

impl V4l2 {
    /// Opens `config.device` ("auto": the first node that serves), sets format, rate and controls, starts streaming.
    /// Where the bus has no room for a format (`ENOSPC`), the next best is taken.
    pub fn open(config: &Config) -> Result<Self, CameraError> {
        let (device, candidate) = find(config)?;
        let name = candidate.path.display().to_string();
        if candidate.offers.is_empty() {
            return Err(CameraError::Unsuitable { device: name, reason: "it offers nothing".into() });
        }
        let mut device = Some(device);
        let (best, running) = step_down(&candidate.offers, |offer| {
            // a stream that could not start took its descriptor with it
            let device = match device.take() {
                Some(device) => device,
                None => Device::open(&candidate.path)
                    .map_err(|source| classify(name.clone(), "opening it again", source))?,
            };
            start(device, &name, offer, config)
        })?;
        let Running { stream, raw, fps } = running;
        let mut camera = Self {
            lock: (config.exposure == Exposure::Lock)
                .then(|| LockClock::new(Duration::from_secs_f64(config.exposure_lock_s.clamp(0.0, 3600.0)))),
            device: name,
            card: candidate.card.clone(),
            reason: best.reason.clone(),
            fps,
            stream,
            grabber: Grabber::new(raw),
        };
        camera.tune(config);
        camera.tell(&candidate);
        Ok(camera)
    }

    fn tell(&self, candidate: &Candidate) {
        let raw = self.grabber.format;
        log::info!(
            "{} ({}): {} {}, rows of {} bytes, {:?}, {}; chosen: {}",
            self.device,
            candidate.card,
            raw.format,
            raw.size,
            raw.stride,
            raw.coding,
            self.fps.map_or("rate not told".into(), |fps| format!("{fps:.2}/s")),
            self.reason
        );
    }

    /// Sets the controls that the settings name, modes first. A control that cannot be set is no reason not to see.
    fn tune(&mut self, config: &Config) {
        let fixes = config.exposure == Exposure::Fixed;
        if config.controls.is_empty() && !fixes {
            return;
        }
        let known = self.stream.controls();
        let (mut list, mut wrong) = controls::settings(&config.controls, &known);
        if fixes {
            list.extend(controls::fixed(config.exposure_value, &known));
        }
        for Setting { id, name, value } in list {
            match self.stream.set_control(id, value) {
                // read back: drivers round, and some refuse in silence
                Ok(set) if set == value => log::debug!("{}: {name} = {value}", self.device),
                Ok(set) => wrong.push(format!("{name} = {value} became {set}")),
                Err(error) => wrong.push(format!("{name} = {value}: {error}")),
            }
        }
        for reason in wrong {
            log::warn!("{}: camera.controls: {reason}", self.device);
        }
    }

    /// Keeps exposure, gain and white balance as the automatic modes have them now.
    fn lock_exposure(&self) {
        for (mode, fixed, value) in controls::LOCKS {
            let held = self.stream.control(value);
            // a camera without the mode has nothing to lock
            if self.stream.set_control(mode, fixed).is_ok()
                && let Ok(held) = held
            {
                let kept = self.stream.set_control(value, held);
                log::info!("{}: control {value:#x} locked at {held} ({kept:?})", self.device);
            }
        }
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

    /// Stops the stream and starts it again.
    pub fn restart(&mut self) -> Result<(), CameraError> {
        self.grabber.restarted();
        let restarted = self.stream.restart();
        restarted.map_err(|source| classify(self.device.clone(), "starting the stream again", source))
    }

    /// The newest frame, waiting up to `timeout` for one.
    pub fn next(&mut self, frame: &mut Frame, timeout: Duration) -> Result<Grab, CameraError> {
        let grabbed = self.grabber.grab(&mut self.stream, frame, timeout, now);
        if self.stream.has_changed() {
            return Err(CameraError::Changed { device: self.device.clone() });
        }
        match grabbed {
            Ok(true) => {
                if self.lock.as_mut().is_some_and(|lock| lock.strikes(frame.captured_at)) {
                    self.lock_exposure();
                }
                Ok(Grab::Frame)
            }
            Ok(false) => Ok(Grab::Timeout),
            Err(source) => Err(classify(self.device.clone(), "grabbing a frame", source)),
        }
    }
}

/// Gone, busy or faulty?
fn classify(device: String, step: &'static str, source: io::Error) -> CameraError {
    match source {
        _ if is_gone(&source) => CameraError::Lost { device, source },
        _ if source.kind() == io::ErrorKind::ResourceBusy => {
            let holder = select::holder(Path::new(&device));
            CameraError::Busy { holder: holder.unwrap_or("another program".into()), device }
        }
        _ => CameraError::Fault { device, step, source },
    }
}

/// A stream that runs, and what the driver granted for it.
struct Running {
    stream: Stream,
    raw: RawFormat,
    fps: Option<f64>,
}

/// Sets format and rate of an offer and starts streaming.
fn start(device: Device, name: &str, offer: &Offer, config: &Config) -> Result<Running, CameraError> {
    let fail = |step: &'static str| {
        let device = name.to_string();
        move |source: io::Error| classify(device, step, source)
    };
    let (size, code) = (offer.size, negotiate::fourcc(offer.format));
    let set =
        device.set_format(size.width as u32, size.height as u32, code).map_err(fail("setting the format"))?;
    let raw = negotiate::granted(
        name,
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
    Ok(Running { stream, raw, fps })
}

/// Starts the first offer that the bus has room for; any other failure ends it.
fn step_down<T>(
    offers: &[Ranked],
    mut start: impl FnMut(&Offer) -> Result<T, CameraError>,
) -> Result<(&Ranked, T), CameraError> {
    const ENOSPC: i32 = 28;
    let mut last = CameraError::Raw("no offers".into());
    for ranked in offers {
        match start(&ranked.offer) {
            Ok(started) => return Ok((ranked, started)),
            Err(CameraError::Fault { source, step, device }) if source.raw_os_error() == Some(ENOSPC) => {
                log::warn!("{device}: the bus has no room for {}; trying the next best", ranked.reason);
                last = CameraError::Fault { source, step, device };
            }
            Err(error) => return Err(error),
        }
    }
    Err(last)
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
    use crate::pixels::Size;

    #[test]
    fn a_full_bus_steps_down_the_formats_and_nothing_else_does() {
        let offers: Vec<Offer> = [640, 320, 160]
            .map(|width| Offer { format: PixelFormat::Yuyv, size: Size::new(width, 120), fps: None })
            .into();
        let wish = negotiate::Wish { size: Size::new(640, 120), fps: 30.0, format: None };
        let ranked = negotiate::rank(&offers, &wish);
        let fail =
            |code: i32| classify("x".into(), "starting the stream", io::Error::from_raw_os_error(code));
        let taken = |failing: &[(usize, i32)]| {
            let outcome =
                step_down(&ranked, |offer| match failing.iter().find(|f| f.0 == offer.size.width) {
                    Some(&(_, code)) => Err(fail(code)),
                    None => Ok(offer.size.width),
                });
            outcome.map(|(ranked, width)| (ranked.offer.size.width, width))
        };
        assert_eq!(taken(&[]).expect("the best"), (640, 640));
        assert_eq!(taken(&[(640, 28), (320, 28)]).expect("the last"), (160, 160));
        assert!(matches!(taken(&[(640, 28), (320, 19)]), Err(CameraError::Lost { .. })));
        assert!(matches!(taken(&[(640, 5)]), Err(CameraError::Fault { .. })));
        let all = taken(&[(640, 28), (320, 28), (160, 28)]).expect_err("no room at all");
        assert!(all.to_string().contains("starting the stream"), "{all}");
        assert!(step_down::<()>(&[], |_| Ok(())).is_err());
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
