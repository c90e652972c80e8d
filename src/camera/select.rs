//! Which node a camera's name means, and who has it. Reads what the kernel tells under `/sys` and `/proc`; opens
//! nothing.

use std::path::{Path, PathBuf};

/// Where the kernel lists video nodes.
pub(super) const NODES: &str = "/sys/class/video4linux";

/// A camera as the settings name it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Named {
    /// The first that serves.
    Auto,
    /// A node, or a link to one (`/dev/v4l/by-id/..`, `/dev/v4l/by-path/..`).
    Path(PathBuf),
    /// By vendor, product and perhaps serial number.
    Usb { vendor: u16, product: u16, serial: Option<String> },
}

impl Named {
    /// Reads `auto`, a path, or `usb:VID:PID[:serial]` (hexadecimal).
    pub(super) fn parse(text: &str) -> Result<Self, String> {
        if text == "auto" {
            return Ok(Named::Auto);
        }
        let Some(rest) = text.strip_prefix("usb:") else {
            return Ok(Named::Path(text.into()));
        };
        let wrong = || {
            format!(
                "camera.device = \"{text}\": write usb:VID:PID or usb:VID:PID:serial, such as usb:046d:0825"
            )
        };
        let number = |digits: Option<&str>| {
            let hex = |d: &&str| (1..=4).contains(&d.len()) && d.bytes().all(|b| b.is_ascii_hexdigit());
            let digits = digits.filter(hex).ok_or_else(wrong)?;
            u16::from_str_radix(digits, 16).map_err(|_| wrong())
        };
        let mut parts = rest.splitn(3, ':');
        let (vendor, product) = (number(parts.next())?, number(parts.next())?);
        let serial = parts.next().filter(|serial| !serial.is_empty()).map(str::to_owned);
        Ok(Named::Usb { vendor, product, serial })
    }
}

/// The nodes of a USB device, by number; `nodes` is [`NODES`] but in tests.
pub(super) fn usb_nodes(nodes: &Path, vendor: u16, product: u16, serial: Option<&str>) -> Vec<PathBuf> {
    let mut found: Vec<(u32, PathBuf)> = std::fs::read_dir(nodes)
        .into_iter()
        .flatten()
        .flatten()
        .filter_map(|entry| {
            let name = entry.file_name();
            let number = name.to_str()?.strip_prefix("video")?.parse().ok()?;
            // the node's device is an interface; the device itself is above it
            let device = std::fs::canonicalize(entry.path().join("device")).ok()?;
            let device = device.parent()?;
            let fact = |name: &str| std::fs::read_to_string(device.join(name)).ok();
            let number_of = |name: &str| u16::from_str_radix(fact(name)?.trim(), 16).ok();
            let same = number_of("idVendor") == Some(vendor)
                && number_of("idProduct") == Some(product)
                && serial.is_none_or(|serial| fact("serial").is_some_and(|own| own.trim() == serial));
            same.then(|| (number, Path::new("/dev").join(name)))
        })
        .collect();
    found.sort();
    found.into_iter().map(|(_, path)| path).collect()
}

/// The program that has a file open, as far as the system lets us see: `mpv (process 4711)`.
pub(super) fn holder(path: &Path) -> Option<String> {
    let node = std::fs::canonicalize(path).ok()?;
    let own = std::process::id();
    for process in std::fs::read_dir("/proc").ok()?.flatten() {
        let Some(id) = process.file_name().to_str().and_then(|name| name.parse::<u32>().ok()) else {
            continue;
        };
        if id == own {
            continue;
        }
        let Ok(files) = std::fs::read_dir(process.path().join("fd")) else { continue };
        if files.flatten().any(|file| std::fs::read_link(file.path()).is_ok_and(|target| target == node)) {
            let name = std::fs::read_to_string(process.path().join("comm")).unwrap_or_default();
            return Some(format!("{} (process {id})", name.trim()));
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn names_are_read() {
        assert_eq!(Named::parse("auto"), Ok(Named::Auto));
        assert_eq!(Named::parse("/dev/video3"), Ok(Named::Path("/dev/video3".into())));
        let usb = |serial: Option<&str>| {
            Ok(Named::Usb { vendor: 0x46d, product: 0x825, serial: serial.map(str::to_owned) })
        };
        assert_eq!(Named::parse("usb:046d:0825"), usb(None));
        assert_eq!(Named::parse("usb:046D:825:A1:B2"), usb(Some("A1:B2")), "a serial may hold anything");
        for wrong in ["usb:", "usb:046d", "usb:046d:", "usb:46d00:1", "usb:x:y", "usb::1", "usb:+1:2"] {
            assert!(
                Named::parse(wrong).is_err_and(|e| e.contains(wrong) && e.contains("usb:VID:PID")),
                "{wrong}"
            );
        }
    }

    #[test]
    fn a_usb_camera_is_found_by_its_numbers() {
        let root = std::env::temp_dir().join(format!("vernissage-usb-{}", std::process::id()));
        let nodes = root.join("class");
        std::fs::create_dir_all(&nodes).expect("a folder");
        for (node, device, ids) in [
            ("video10", "1-1", ["046d", "0825", "A1"]),
            ("video2", "1-1", ["046d", "0825", "A1"]),
            ("video0", "1-2", ["046d", "0825", "B2"]),
        ] {
            let interface = root.join(device).join(format!("{device}:1.0"));
            std::fs::create_dir_all(&interface).expect("a folder");
            for (name, text) in ["idVendor", "idProduct", "serial"].into_iter().zip(ids) {
                std::fs::write(root.join(device).join(name), format!("{text}\n")).expect("a fact");
            }
            std::fs::create_dir_all(nodes.join(node)).expect("a folder");
            symlink(&interface, nodes.join(node).join("device")).expect("a link");
        }
        std::fs::create_dir_all(nodes.join("v4l-subdev0")).expect("a folder");
        let find = |vendor, product, serial| {
            usb_nodes(&nodes, vendor, product, serial)
                .iter()
                .map(|p| p.display().to_string())
                .collect::<Vec<_>>()
        };
        assert_eq!(find(0x46d, 0x825, None), ["/dev/video0", "/dev/video2", "/dev/video10"]);
        assert_eq!(find(0x46d, 0x825, Some("A1")), ["/dev/video2", "/dev/video10"]);
        assert!(find(0x46d, 0x826, None).is_empty() && find(0x46d, 0x825, Some("C")).is_empty());
        assert!(usb_nodes(Path::new("/none"), 1, 1, None).is_empty());
        std::fs::remove_dir_all(&root).expect("its own folder");
    }

    #[test]
    fn who_has_a_file_is_named() {
        let path = std::env::temp_dir().join(format!("vernissage-held-{}", std::process::id()));
        let file = std::fs::File::create(&path).expect("a file");
        // held by ourselves only: nobody else
        assert_eq!(holder(&path), None);
        let mut child =
            std::process::Command::new("sleep").arg("60").stdout(file).spawn().expect("sleep runs");
        let name = holder(&path);
        child.kill().expect("ours");
        child.wait().expect("ours");
        assert_eq!(name, Some(format!("sleep (process {})", child.id())));
        std::fs::remove_file(&path).expect("ours");
        assert_eq!(holder(&path), None);
    }
}
