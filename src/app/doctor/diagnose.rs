//! From facts to findings: the true cause first, its consequences left out.

use super::facts::{Camera, Facts, Folder, Screen, Serial};
use crate::app::machine::{Access, Holder};

/// How much a finding matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Weight {
    /// The visor cannot run so.
    Wrong,
    /// It runs, but not well, or not for long.
    Odd,
    /// As it should be.
    Good,
}

impl Weight {
    /// Its word.
    pub fn name(self) -> &'static str {
        match self {
            Weight::Wrong => "wrong",
            Weight::Odd => "odd",
            Weight::Good => "good",
        }
    }
}

/// A conclusion.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// How much it matters.
    pub weight: Weight,
    /// What is so.
    pub what: String,
    /// What it is concluded from.
    pub evidence: String,
    /// What to do; empty where nothing is.
    pub todo: String,
}

/// What one USB 2 port carries for cameras: 3 packets of 1024 bytes in each of 8000 microframes, bytes a second.
const USB2: u64 = 24_576_000;
/// Before this the clock was not set: 2025-01-01.
const EARLIEST: u64 = 1_735_689_600;
/// Room that the state folder should have, bytes.
const ROOM: u64 = 4 << 20;
/// Hot where the machine does not say from where on it slows down, °C.
const HOT: f64 = 80.0;

/// The conclusions, what is wrong first.
pub fn diagnose(facts: &Facts) -> Vec<Finding> {
    let mut found = Vec::new();
    for problem in &facts.config {
        found.push(wrong("the visor file has a mistake", &problem.place, &problem.what));
    }
    camera(facts, &mut found);
    screen(facts, &mut found);
    if let Some(port) = &facts.serial {
        found.push(serial(port, facts));
    }
    if let Some(folder) = &facts.state {
        found.push(state(folder));
    }
    machine(facts, &mut found);
    found.sort_by_key(|finding| finding.weight);
    found
}

fn finding(weight: Weight, what: &str, evidence: impl ToString, todo: impl ToString) -> Finding {
    Finding { weight, what: what.into(), evidence: evidence.to_string(), todo: todo.to_string() }
}

fn wrong(what: &str, evidence: impl ToString, todo: impl ToString) -> Finding {
    finding(Weight::Wrong, what, evidence, todo)
}

fn odd(what: &str, evidence: impl ToString, todo: impl ToString) -> Finding {
    finding(Weight::Odd, what, evidence, todo)
}

fn good(what: &str, evidence: impl ToString) -> Finding {
    finding(Weight::Good, what, evidence, "")
}

/// The right to a device comes with a group.
fn join(group: Option<&str>) -> String {
    match group {
        Some("root") | None => {
            "run it as a user who may open it, or give its group the right (udev rule)".into()
        }
        Some(group) => format!("sudo usermod -aG {group} $USER, then log in anew"),
    }
}

fn list(holders: &[Holder]) -> String {
    holders.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

/// Whether the visor itself has it.
fn ourselves(holders: &[Holder]) -> bool {
    holders.iter().all(|holder| holder.name == "vernissage")
}

/// The camera that is wanted, or any.
fn camera(facts: &Facts, found: &mut Vec<Finding>) {
    let Some(wanted) = &facts.wanted_camera else { return };
    let named = wanted.starts_with('/');
    if facts.cameras.is_empty() {
        let todo = "plug one in; on a board with a ribbon cable enable the camera in its firmware; to try without: --camera synthetic";
        found.push(wrong("there is no camera", "no /dev/video*", todo));
        return;
    }
    let all: Vec<&Camera> =
        facts.cameras.iter().filter(|camera| !named || camera.path.as_os_str() == wanted.as_str()).collect();
    let usable = |camera: &&&Camera| camera.access == Access::Granted && camera.refusal.is_none();
    if all.is_empty() {
        let others = facts.cameras.iter().filter(|camera| camera.refusal.is_none());
        let others: Vec<String> = others.map(|camera| camera.path.display().to_string()).collect();
        let todo = match others.is_empty() {
            true => "plug it in again".to_string(),
            false => format!("set camera.device to \"auto\" or {}", others.join(", ")),
        };
        found.push(wrong("the camera that the settings name is not there", wanted, todo));
        return;
    }
    let Some(best) = all.iter().find(usable) else {
        let denied = all.iter().find(|camera| camera.access == Access::Denied);
        found.push(match denied {
            Some(camera) => wrong(
                "this user may not open the camera",
                format!("{}, group {}", camera.path.display(), camera.group.as_deref().unwrap_or("?")),
                join(camera.group.as_deref()),
            ),
            None => {
                let seen: Vec<String> = all
                    .iter()
                    .map(|c| format!("{}: {}", c.path.display(), c.refusal.as_deref().unwrap_or("not there")))
                    .collect();
                let serving = facts.cameras.iter().find(|camera| usable(&camera));
                let todo = match serving {
                    Some(camera) => format!("set camera.device to {}, or \"auto\"", camera.path.display()),
                    None => "another camera: this one sends no pictures that the visor reads".into(),
                };
                let what = if named {
                    "the node that the settings name is no camera"
                } else {
                    "no node is a camera"
                };
                wrong(what, seen.join("; "), todo)
            }
        });
        return;
    };
    let name = format!("{} {}", best.path.display(), best.name);
    if !best.holders.is_empty() {
        let (what, seen) =
            ("another program has the camera open", format!("{name}: {}", list(&best.holders)));
        match ourselves(&best.holders) {
            true => found.push(good("a visor is running", seen)),
            false => {
                found.push(wrong(what, seen, "end that program, or set camera.device to another camera"))
            }
        }
    }
    load(best, &all, found);
    if best.holders.is_empty() {
        let offer = best.offer.as_ref().map_or(String::new(), |(offer, _)| format!(", {offer}"));
        found.push(good("the camera can be used", format!("{name}{offer}")));
    }
}

/// What the camera sends, against what its USB port carries.
fn load(camera: &Camera, all: &[&Camera], found: &mut Vec<Finding>) {
    let (Some((offer, Some(bytes))), Some((speed, bus))) = (&camera.offer, camera.usb) else { return };
    let limit = if speed <= 12 { 1_000_000 } else { USB2 };
    if speed > 480 {
        return;
    }
    let mb = |bytes: u64| format!("{:.1} MB/s", bytes as f64 / 1e6);
    if *bytes > limit {
        found.push(odd(
            "the camera's pictures are too much for its USB port",
            format!("{offer} is {}, a port of {speed} Mbit/s carries {}", mb(*bytes), mb(limit)),
            "it will send fewer pictures, or none (ENOSPC): set camera.format = \"mjpg\", a smaller width and height, or use a blue (USB 3) port",
        ));
    } else {
        let beside: Vec<&&Camera> = all
            .iter()
            .filter(|other| other.path != camera.path && other.usb.is_some_and(|(_, b)| b == bus))
            .filter(|other| !other.holders.is_empty())
            .collect();
        if !beside.is_empty() && 2 * bytes > limit {
            found.push(odd(
                "two cameras share one USB bus",
                format!("bus {bus}; {offer} alone is {} of {}", mb(*bytes), mb(limit)),
                "plug one of them into a port of another bus, or set camera.format = \"mjpg\"",
            ));
        }
    }
}

/// Programs that draw on the whole screen.
const DESKTOPS: [&str; 14] = [
    "Xorg",
    "X",
    "Xwayland",
    "gnome-shell",
    "kwin_wayland",
    "sway",
    "weston",
    "labwc",
    "wayfire",
    "Hyprland",
    "cage",
    "plymouthd",
    "gdm",
    "sddm",
];

/// The screen that is wanted, or any.
fn screen(facts: &Facts, found: &mut Vec<Finding>) {
    let Some(wanted) = &facts.wanted_card else { return };
    let all: Vec<&Screen> = facts
        .cards
        .iter()
        .filter(|screen| wanted == "auto" || screen.card.path.as_os_str() == wanted.as_str())
        // render nodes and cards without sockets show nothing
        .filter(|screen| !screen.card.connectors.is_empty() || wanted != "auto")
        .collect();
    if all.is_empty() {
        let evidence = if wanted == "auto" { "no /dev/dri/card* with a connector" } else { wanted };
        let todo = "load the display's driver (on a Raspberry Pi: dtoverlay=vc4-kms-v3d), or show the pictures elsewhere: --display window on a desktop";
        found.push(wrong("there is no screen to draw on", evidence, todo));
        return;
    }
    let lit = all.iter().find(|s| s.card.connectors.iter().any(|c| c.connected != Some(false)));
    let Some(screen) = lit else {
        let sockets: Vec<String> = all
            .iter()
            .flat_map(|s| s.card.connectors.iter().map(|c| format!("{} {}", s.card.path.display(), c.name)))
            .collect();
        let todo = "plug a screen in and switch it on; the visor takes it as soon as it is there";
        found.push(wrong("no screen is plugged in", format!("disconnected: {}", sockets.join(", ")), todo));
        return;
    };
    let path = screen.card.path.display();
    let socket = screen.card.connectors.iter().find(|c| c.connected != Some(false));
    let name = socket.map_or(String::new(), |socket| format!("{path} {}", socket.name));
    if screen.access != Access::Granted {
        let evidence = format!("{path}, group {}", screen.group.as_deref().unwrap_or("?"));
        found.push(wrong("this user may not open the screen", evidence, join(screen.group.as_deref())));
        return;
    }
    let desktop: Vec<Holder> =
        screen.holders.iter().filter(|h| DESKTOPS.contains(&h.name.as_str())).cloned().collect();
    if !desktop.is_empty() {
        let todo =
            "go to a console (Ctrl+Alt+F3) and stop the desktop (sudo systemctl isolate multi-user.target)";
        found.push(wrong("a desktop owns the screen", format!("{path}: {}", list(&desktop)), todo));
    } else if !screen.holders.is_empty() && !ourselves(&screen.holders) {
        let todo = "end that program if the visor says that another program owns the screen";
        found.push(odd(
            "another program has the screen open",
            format!("{path}: {}", list(&screen.holders)),
            todo,
        ));
    } else {
        let mode = socket.and_then(|socket| socket.modes.first());
        found
            .push(good("the screen can be used", mode.map_or(name.clone(), |mode| format!("{name} {mode}"))));
    }
}

fn serial(port: &Serial, facts: &Facts) -> Finding {
    let path = port.path.display();
    let others: Vec<String> =
        facts.ports.iter().filter(|other| **other != port.path).map(|p| p.display().to_string()).collect();
    if port.access == Access::Missing {
        let todo = match others.is_empty() {
            true => "plug the button board in".to_string(),
            false => format!("plug the button board in, or set serial.port to {}", others.join(" or ")),
        };
        return wrong("the buttons' serial port is not there", path, todo);
    }
    if !port.is_device {
        return wrong("the buttons' serial port is no device", path, "set serial.port to a /dev/tty*");
    }
    if port.access == Access::Denied {
        let evidence = format!("{path}, group {}", port.group.as_deref().unwrap_or("?"));
        return wrong(
            "this user may not open the buttons' serial port",
            evidence,
            join(port.group.as_deref()),
        );
    }
    if !port.holders.is_empty() && !ourselves(&port.holders) {
        let evidence = format!("{path}: {}", list(&port.holders));
        let todo = "end it: a modem manager or a getty on this port eats the presses (systemctl disable ModemManager; remove console= from the kernel's command line)";
        return wrong("another program has the buttons' serial port open", evidence, todo);
    }
    good("the buttons' serial port can be used", path)
}

fn state(folder: &Folder) -> Finding {
    let path = folder.path.display();
    if folder.read_only {
        let todo = "mount it for writing; after a power cut look at the kernel log and check the card";
        odd("the state folder cannot be written: its file system is read-only", path, todo)
    } else if folder.free < ROOM {
        let free = format!("{path}: {} kB free", folder.free / 1024);
        odd("the state folder is full", free, "delete what fills its disk (journalctl --vacuum-size=50M)")
    } else if folder.access == Access::Denied {
        let todo = "run as the service does: systemctl start vernissage";
        odd("this user may not write the state folder", path, todo)
    } else {
        good("the state folder can be written", path)
    }
}

/// Clock, heat, supply.
fn machine(facts: &Facts, found: &mut Vec<Finding>) {
    if facts.clock < EARLIEST {
        let evidence = format!("{} s since 1970", facts.clock);
        let todo =
            "let it find a time server, or give it a battery; pictures are not timed by it, only log lines";
        found.push(odd("the clock is not set", evidence, todo));
    }
    let mut cool = true;
    for zone in &facts.heat {
        let limit = zone.passive.unwrap_or(HOT);
        if zone.celsius >= limit - 2.0 && zone.celsius < 150.0 {
            cool = false;
            found.push(odd(
                "the machine is hot and slows down",
                format!("{} {:.0} °C, it slows down from {limit:.0} °C", zone.name, zone.celsius),
                "give it air or a heat sink; a lighter style (sketch-like, illustrative) or fewer pictures a second",
            ));
        }
    }
    let bits = facts.throttled.unwrap_or(0);
    let supply = |now: bool| bits & if now { 0x1 } else { 0x1_0000 } != 0;
    if supply(true) || supply(false) {
        let when = if supply(true) { "now" } else { "since it was switched on" };
        let todo = "a stronger power supply and a short, thick cable";
        found.push(odd("the board gets too little voltage", format!("firmware: {bits:#x}, {when}"), todo));
    } else if bits & 0x6 != 0 && cool {
        // with too little voltage it is that what holds the processor back
        let todo = "give it air or a heat sink";
        found.push(odd("the firmware holds the processor back", format!("firmware: {bits:#x}"), todo));
    }
    if facts.root {
        let todo = "run it as a service (systemd/README.md), or as a user of the groups video and dialout";
        found.push(odd("this is root", "user 0", todo));
    }
}

#[cfg(test)]
mod tests;
