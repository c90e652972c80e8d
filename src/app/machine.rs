//! What the machine has, as the system tells it without a device being disturbed: /proc, /sys and access rights.
//!
//! `probe` prints it, `doctor` draws conclusions. Everything missing is simply absent: nothing here fails.

use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::path::{Path, PathBuf};

/// Whether a file may be opened for reading and writing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Access {
    /// Yes.
    #[default]
    Granted,
    /// It is not there.
    Missing,
    /// The rights do not allow it.
    Denied,
}

/// A program that has a file open.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Holder {
    /// Its number.
    pub pid: u32,
    /// Its name.
    pub name: String,
}

impl std::fmt::Display for Holder {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} (process {})", self.name, self.pid)
    }
}

/// A display card.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Card {
    /// Its node.
    pub path: PathBuf,
    /// The kernel driver.
    pub driver: String,
    /// Its sockets.
    pub connectors: Vec<Connector>,
}

/// A socket for a screen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Connector {
    /// Such as `HDMI-A-1`.
    pub name: String,
    /// Whether a screen is plugged in; `None` where the driver does not know.
    pub connected: Option<bool>,
    /// Sizes of its modes as the kernel lists them, the preferred one first.
    pub modes: Vec<String>,
}

/// A place where temperature is measured.
#[derive(Clone, Debug, PartialEq)]
pub struct Thermal {
    /// What is measured.
    pub name: String,
    /// Now, °C.
    pub celsius: f64,
    /// From where on the machine slows down, °C.
    pub passive: Option<f64>,
}

/// Rights to a file.
pub fn access(path: &Path) -> Access {
    use rustix::fs::{Access as Wish, access};
    if !path.exists() {
        return Access::Missing;
    }
    match access(path, Wish::READ_OK | Wish::WRITE_OK) {
        Ok(()) => Access::Granted,
        Err(_) => Access::Denied,
    }
}

/// The programs other than this one that have a file open, as far as this user may see.
pub fn holders(path: &Path) -> Vec<Holder> {
    let Ok(wanted) = std::fs::canonicalize(path) else { return Vec::new() };
    let own = std::process::id();
    let mut found = Vec::new();
    for entry in std::fs::read_dir("/proc").into_iter().flatten().flatten() {
        let Some(pid) = entry.file_name().to_str().and_then(|name| name.parse::<u32>().ok()) else {
            continue;
        };
        if pid == own {
            continue;
        }
        let files = std::fs::read_dir(entry.path().join("fd")).into_iter().flatten().flatten();
        if files.take(4096).any(|file| std::fs::read_link(file.path()).is_ok_and(|target| target == wanted)) {
            found.push(Holder { pid, name: line(&entry.path().join("comm")).unwrap_or_default() });
        }
    }
    found.sort_by_key(|holder| holder.pid);
    found
}

/// The first line of a small file.
pub fn line(path: &Path) -> Option<String> {
    use std::io::Read;
    let mut text = String::new();
    std::fs::File::open(path).ok()?.take(4096).read_to_string(&mut text).ok()?;
    Some(text.lines().next().unwrap_or_default().trim().to_string())
}

/// Entries of a folder whose names begin so, in order of the numbers in them.
pub fn entries(folder: &str, name: &str) -> Vec<PathBuf> {
    let listed = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut found: Vec<PathBuf> =
        listed.filter(|e| e.file_name().to_string_lossy().starts_with(name)).map(|e| e.path()).collect();
    let number = |path: &PathBuf| {
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let digits: String = name.chars().filter(char::is_ascii_digit).collect();
        (digits.parse::<u64>().unwrap_or_default(), name)
    };
    found.sort_by_key(number);
    found
}

/// Display cards by number, from /sys: opening one could take it from the program that draws on it.
pub fn cards() -> Vec<Card> {
    let whole = |path: &PathBuf| {
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        name.strip_prefix("card").is_some_and(|n| n.parse::<u32>().is_ok())
    };
    let of = |path: PathBuf| {
        let name = path.file_name()?.to_string_lossy().into_owned();
        let driver = std::fs::read_link(path.join("device/driver")).ok();
        let driver = driver.and_then(|d| Some(d.file_name()?.to_string_lossy().into_owned()));
        let connectors = entries(&path.to_string_lossy(), &format!("{name}-")).into_iter().map(|socket| {
            let own = socket.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
            let modes = std::fs::read_to_string(socket.join("modes")).unwrap_or_default();
            let mut modes: Vec<String> = modes.lines().map(str::to_string).collect();
            modes.dedup();
            let connected = match line(&socket.join("status")).as_deref() {
                Some("connected") => Some(true),
                Some("disconnected") => Some(false),
                _ => None,
            };
            Connector { name: own[name.len() + 1..].to_string(), connected, modes }
        });
        let connectors = connectors.collect();
        Some(Card { path: Path::new("/dev/dri").join(&name), driver: driver.unwrap_or_default(), connectors })
    };
    entries("/sys/class/drm", "card").into_iter().filter(whole).filter_map(of).collect()
}

/// Temperatures.
pub fn thermal() -> Vec<Thermal> {
    let degrees = |path: PathBuf| line(&path)?.parse::<f64>().ok().map(|milli| milli / 1000.0);
    let of = |zone: PathBuf| {
        let celsius = degrees(zone.join("temp"))?;
        let passive = (0..12).find_map(|k| {
            let is = line(&zone.join(format!("trip_point_{k}_type")))? == "passive";
            is.then(|| degrees(zone.join(format!("trip_point_{k}_temp"))))?
        });
        let name = line(&zone.join("type")).unwrap_or_default();
        Some(Thermal { name, celsius, passive: passive.filter(|c| *c > 0.0) })
    };
    entries("/sys/class/thermal", "thermal_zone").into_iter().filter_map(of).collect()
}

/// Clock of the first core, MHz: now, and the most it may have.
pub fn clock_mhz() -> Option<(u64, u64)> {
    let of = |name: &str| {
        let path = format!("/sys/devices/system/cpu/cpu0/cpufreq/{name}");
        line(Path::new(&path))?.parse::<u64>().ok().map(|khz| khz / 1000)
    };
    Some((of("scaling_cur_freq")?, of("cpuinfo_max_freq")?))
}

/// Serial ports: path and what the system says of it.
pub fn serial_ports() -> Vec<(PathBuf, String)> {
    use serialport::SerialPortType;
    let mut ports: Vec<(PathBuf, String)> = serialport::available_ports()
        .unwrap_or_default()
        .into_iter()
        .map(|port| {
            let what = match port.port_type {
                SerialPortType::UsbPort(usb) => {
                    let product = usb.product.map(|name| format!(" {name}")).unwrap_or_default();
                    format!("USB {:04x}:{:04x}{product}", usb.vid, usb.pid)
                }
                SerialPortType::PciPort => "PCI".into(),
                SerialPortType::BluetoothPort => "Bluetooth".into(),
                SerialPortType::Unknown => "on the board".into(),
            };
            (PathBuf::from(port.port_name), what)
        })
        .collect();
    ports.sort();
    ports
}

/// Speed of the USB link that a video node hangs on, Mbit/s, and the bus with it.
pub fn usb_of(node: &Path) -> Option<(u64, u64)> {
    let name = node.file_name()?.to_string_lossy().into_owned();
    let device = std::fs::canonicalize(format!("/sys/class/video4linux/{name}/device")).ok()?;
    let usb = device.ancestors().find(|folder| folder.join("busnum").exists())?;
    let number = |key: &str| line(&usb.join(key))?.parse::<u64>().ok();
    Some((number("speed")?, number("busnum")?))
}

/// Whether a path is a device.
pub fn is_device(path: &Path) -> bool {
    std::fs::metadata(path).is_ok_and(|m| m.file_type().is_char_device())
}

/// Name of the group that a file belongs to, as /etc/group has it.
pub fn group_of(path: &Path) -> Option<String> {
    let gid = std::fs::metadata(path).ok()?.gid();
    let groups = std::fs::read_to_string("/etc/group").ok()?;
    let named = groups.lines().find_map(|line| {
        let mut fields = line.split(':');
        let name = fields.next()?;
        (fields.nth(1)?.parse() == Ok(gid)).then(|| name.to_string())
    });
    Some(named.unwrap_or_else(|| gid.to_string()))
}
