//! Finding a camera: the nodes there are, whether each can serve, and the one that the settings name.

use super::negotiate::{self, Offer, Ranked};
use super::select::{self, Named};
use super::streaming::Device;
use super::{CameraError, Config};
use crate::pixels::Size;
use std::io;
use std::path::{Path, PathBuf};
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

/// A node, open where it opens, and what is to be said of it.
fn candidate(path: &Path, config: &Config) -> (io::Result<Device>, Candidate) {
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
            return (Err(error), candidate);
        }
    };
    match device.capability() {
        Err(error) => {
            candidate.refusal = Some(format!("not a video device ({error})"));
            return (Err(error), candidate);
        }
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
    (Ok(device), candidate)
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

/// The node that the settings name, open, and what it offers.
pub(super) fn find(config: &Config) -> Result<(Device, Candidate), CameraError> {
    let wrong = |reason| CameraError::Format { name: "camera".into(), reason };
    match Named::parse(&config.device).map_err(wrong)? {
        Named::Auto => first(nodes(), "/dev/video*", config),
        Named::Path(path) => named(&path, config),
        Named::Usb { vendor, product, serial } => {
            let nodes = select::usb_nodes(Path::new(select::NODES), vendor, product, serial.as_deref());
            first(nodes, &config.device, config)
        }
    }
}

/// Whether the system says that a device is not there any more.
pub(super) fn is_gone(error: &io::Error) -> bool {
    const ENXIO: i32 = 6;
    const ENODEV: i32 = 19;
    matches!(error.raw_os_error(), Some(ENXIO | ENODEV)) || error.kind() == io::ErrorKind::NotFound
}

fn named(path: &Path, config: &Config) -> Result<(Device, Candidate), CameraError> {
    let device = config.device.clone();
    if let Err(source) = std::fs::metadata(path) {
        return Err(match source.kind() {
            io::ErrorKind::NotFound => CameraError::NoCamera { device, others: others() },
            _ => CameraError::Fault { device, step: "looking at it", source },
        });
    }
    match candidate(path, config) {
        (Ok(device), candidate) if candidate.refusal.is_none() => Ok((device, candidate)),
        // it is leaving while we look
        (Err(source), _) if is_gone(&source) => Err(CameraError::Lost { device, source }),
        (_, candidate) => {
            Err(CameraError::Unsuitable { device, reason: candidate.refusal.unwrap_or_default() })
        }
    }
}

/// The first of these nodes that serves; says so where it is not the only one. `what`: how they were looked for.
fn first(nodes: Vec<PathBuf>, what: &str, config: &Config) -> Result<(Device, Candidate), CameraError> {
    let (mut found, mut others, mut refused) = (None, Vec::new(), Vec::new());
    for path in nodes {
        match candidate(&path, config) {
            (Ok(device), candidate) if candidate.refusal.is_none() => match found {
                None => found = Some((device, candidate)),
                Some(_) => others.push(format!("{} ({})", path.display(), candidate.card)),
            },
            (_, c) => refused.push(format!("{}: {}", path.display(), c.refusal.unwrap_or_default())),
        }
    }
    let Some((device, candidate)) = found else {
        let others = if refused.is_empty() { String::new() } else { format!(" ({})", refused.join("; ")) };
        return Err(CameraError::NoCamera { device: what.into(), others });
    };
    if !others.is_empty() {
        let (path, card) = (candidate.path.display(), &candidate.card);
        log::warn!(
            "camera.device = \"{}\" is ambiguous: taking {path} ({card}); there is also {}",
            config.device,
            others.join(", ")
        );
    }
    Ok((device, candidate))
}

/// What else there is; nothing is opened: a camera that left is looked for often.
fn others() -> String {
    let nodes: Vec<String> = nodes().iter().map(|path| path.display().to_string()).collect();
    if nodes.is_empty() { String::new() } else { format!(" (there is {})", nodes.join(", ")) }
}

#[cfg(test)]
mod tests {
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
    fn a_camera_that_leaves_is_lost_not_unsuitable() {
        let gone = |code| is_gone(&io::Error::from_raw_os_error(code));
        assert!(gone(19) && gone(6) && gone(2) && !gone(13) && !gone(16) && !gone(5));
        let config = Config { device: "/dev/null".into(), ..Config::default() };
        let error = find(&config).err().expect("no camera").to_string();
        assert!(error.contains("not a video device"), "{error}");
    }

    #[test]
    fn stepwise_sizes_come_nearest_to_the_wish() {
        assert_eq!(nearest(640, 16, 3840, 2), 640);
        assert_eq!(nearest(641, 16, 3840, 2), 640);
        assert_eq!(nearest(8, 16, 3840, 2), 16);
        assert_eq!(nearest(9000, 16, 3840, 0), 3840);
        assert_eq!(nearest(10, 20, 5, 1), 20);
    }
}
