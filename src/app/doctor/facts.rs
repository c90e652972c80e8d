//! What is looked at before conclusions are drawn. Nothing is streamed, no screen is taken.

use crate::app::check;
use crate::app::config::Config;
use crate::app::machine::{self, Access, Card, Holder, Thermal, access, holders};
use crate::camera;
use crate::display;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// All facts.
#[derive(Clone, Debug, Default)]
pub struct Facts {
    /// The user is root.
    pub root: bool,
    /// Problems of the visor file, where one is given and has any.
    pub config: Vec<check::Problem>,
    /// Which camera is wanted: a node, `auto`, or none at all (clips, the synthetic one).
    pub wanted_camera: Option<String>,
    /// Every video node.
    pub cameras: Vec<Camera>,
    /// Whether the screen is wanted, and which card: a node or `auto`.
    pub wanted_card: Option<String>,
    /// Every display card.
    pub cards: Vec<Screen>,
    /// The serial port that the file names.
    pub serial: Option<Serial>,
    /// Other serial ports.
    pub ports: Vec<PathBuf>,
    /// The state folder.
    pub state: Option<Folder>,
    /// Seconds since 1970 by the machine's clock.
    pub clock: u64,
    /// Temperatures.
    pub heat: Vec<Thermal>,
    /// What a Raspberry Pi's firmware says of its supply and heat, bit by bit.
    pub throttled: Option<u32>,
}

/// A video node.
#[derive(Clone, Debug, Default)]
pub struct Camera {
    /// The node.
    pub path: PathBuf,
    /// Name of the device.
    pub name: String,
    /// Rights to it.
    pub access: Access,
    /// Its group.
    pub group: Option<String>,
    /// Why it cannot serve, as far as its driver tells.
    pub refusal: Option<String>,
    /// Programs that have it open.
    pub holders: Vec<Holder>,
    /// Mbit/s and number of its USB bus.
    pub usb: Option<(u64, u64)>,
    /// The best offer: its name, and bytes a second where it is not compressed.
    pub offer: Option<(String, Option<u64>)>,
}

/// A display card.
#[derive(Clone, Debug)]
pub struct Screen {
    /// What it has.
    pub card: Card,
    /// Rights to it.
    pub access: Access,
    /// Its group.
    pub group: Option<String>,
    /// Programs that have it open.
    pub holders: Vec<Holder>,
}

/// A serial port.
#[derive(Clone, Debug, Default)]
pub struct Serial {
    /// The port.
    pub path: PathBuf,
    /// Rights to it.
    pub access: Access,
    /// Whether it is a device.
    pub is_device: bool,
    /// Its group.
    pub group: Option<String>,
    /// Programs that have it open.
    pub holders: Vec<Holder>,
}

/// A folder that is written to.
#[derive(Clone, Debug, Default)]
pub struct Folder {
    /// The folder.
    pub path: PathBuf,
    /// Rights to it.
    pub access: Access,
    /// Its file system is mounted read-only.
    pub read_only: bool,
    /// Bytes free.
    pub free: u64,
}

/// Where a service keeps what must survive.
const STATE: &str = "/var/lib/vernissage";

/// Looks at everything.
pub fn collect(config: Option<&Path>) -> Facts {
    let (problems, settings) = match config {
        // devices are looked at here, and closer
        Some(path) => check::problems(path, false),
        None => (Vec::new(), Some(Config::default())),
    };
    let settings = settings.unwrap_or_default();
    let camera = &settings.camera;
    let state = std::env::var_os("STATE_DIRECTORY").map_or_else(|| PathBuf::from(STATE), PathBuf::from);
    Facts {
        root: rustix::process::geteuid().is_root(),
        config: problems,
        wanted_camera: (camera.source == camera::Kind::V4l2).then(|| camera.device.clone()),
        cameras: cameras(camera),
        wanted_card: (settings.display.sink == display::Kind::Kms).then(|| settings.display.card.clone()),
        cards: machine::cards().into_iter().map(screen).collect(),
        serial: settings.serial.port.as_deref().map(serial),
        ports: machine::serial_ports().into_iter().map(|(path, _)| path).collect(),
        state: folder(&state),
        clock: SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |time| time.as_secs()),
        heat: machine::thermal(),
        throttled: machine::line(Path::new("/sys/devices/platform/soc/soc:firmware/get_throttled"))
            .and_then(|hex| u32::from_str_radix(hex.trim_start_matches("0x"), 16).ok()),
    }
}

fn cameras(wished: &camera::Config) -> Vec<Camera> {
    let of = |candidate: camera::Candidate| {
        let path = candidate.path;
        let offer = candidate.offers.first().map(|ranked| {
            let offer = &ranked.offer;
            let raw = camera::RawFormat::new(offer.format, offer.size);
            let compressed = offer.format == camera::PixelFormat::Mjpg;
            let bytes = raw.least_bytes().filter(|_| !compressed);
            let fps = offer.fps.unwrap_or(wished.fps).min(wished.fps);
            (format!("{} {}", offer.format, offer.size), bytes.map(|bytes| (bytes as f64 * fps) as u64))
        });
        Camera {
            name: candidate.card,
            access: access(&path),
            group: machine::group_of(&path),
            refusal: candidate.refusal,
            holders: holders(&path),
            usb: machine::usb_of(&path),
            offer,
            path,
        }
    };
    camera::probe(wished).into_iter().map(of).collect()
}

fn screen(card: Card) -> Screen {
    let path = &card.path;
    let (access, group, holders) = (access(path), machine::group_of(path), holders(path));
    Screen { card, access, group, holders }
}

fn serial(path: &Path) -> Serial {
    Serial {
        path: path.into(),
        access: access(path),
        is_device: machine::is_device(path),
        group: machine::group_of(path),
        holders: holders(path),
    }
}

/// `None` where it is not there: then this machine has no service, or none that ran.
fn folder(path: &Path) -> Option<Folder> {
    let system = rustix::fs::statvfs(path).ok()?;
    Some(Folder {
        path: path.into(),
        access: access(path),
        read_only: system.f_flag.contains(rustix::fs::StatVfsMountFlags::RDONLY),
        free: system.f_bavail.saturating_mul(system.f_frsize),
    })
}
