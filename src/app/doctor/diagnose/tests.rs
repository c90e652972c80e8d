//! Every cause as a change of a sound machine.

use super::*;
use crate::app::check::Problem;
use crate::app::machine::{Card, Connector, Thermal};
use std::path::PathBuf;

fn camera_node() -> Camera {
    Camera {
        path: "/dev/video0".into(),
        name: "UVC".into(),
        group: Some("video".into()),
        offer: Some(("YUYV 640x480".into(), Some(18_432_000))),
        usb: Some((480, 1)),
        ..Camera::default()
    }
}

fn card() -> Screen {
    let connector =
        Connector { name: "HDMI-A-1".into(), connected: Some(true), modes: vec!["1920x1080".into()] };
    let card = Card { path: "/dev/dri/card0".into(), driver: "vc4".into(), connectors: vec![connector] };
    Screen { card, access: Access::Granted, group: Some("video".into()), holders: Vec::new() }
}

/// A machine on which everything is as it should be.
fn sound() -> Facts {
    Facts {
        wanted_camera: Some("auto".into()),
        cameras: vec![camera_node()],
        wanted_card: Some("auto".into()),
        cards: vec![card()],
        serial: Some(Serial { path: "/dev/ttyACM0".into(), is_device: true, ..Serial::default() }),
        ports: vec!["/dev/ttyACM0".into(), "/dev/ttyUSB0".into()],
        state: Some(Folder { path: "/var/lib/vernissage".into(), free: 1 << 30, ..Folder::default() }),
        clock: EARLIEST + 1,
        heat: vec![Thermal { name: "cpu".into(), celsius: 45.0, passive: Some(80.0) }],
        throttled: Some(0),
        ..Facts::default()
    }
}

fn held(name: &str) -> Vec<Holder> {
    vec![Holder { pid: 77, name: name.into() }]
}

#[test]
fn a_sound_machine_has_nothing_wrong() {
    let found = diagnose(&sound());
    assert!(found.iter().all(|finding| finding.weight == Weight::Good), "{found:#?}");
    assert_eq!(found.len(), 4);
    // without a machine at all nothing panics
    diagnose(&Facts::default());
}

/// What is changed on the sound machine, and the one finding that comes of it: weight, words of what, of the
/// evidence, of what to do.
type Case = (fn(&mut Facts), Weight, &'static str, &'static str, &'static str);

const CASES: &[Case] = &[
    (|f| f.cameras.clear(), Weight::Wrong, "no camera", "/dev/video*", "plug one in"),
    (
        |f| f.cameras[0].access = Access::Denied,
        Weight::Wrong,
        "may not open the camera",
        "group video",
        "usermod -aG video",
    ),
    (
        |f| f.cameras[0].holders = held("zoom"),
        Weight::Wrong,
        "another program has the camera",
        "zoom (process 77)",
        "end that program",
    ),
    (|f| f.cameras[0].holders = held("vernissage"), Weight::Good, "a visor is running", "vernissage", ""),
    (
        |f| f.cameras[0].refusal = Some("it does not capture pictures".into()),
        Weight::Wrong,
        "no node is a camera",
        "does not capture",
        "another camera",
    ),
    (
        |f| {
            let meta = Camera {
                path: "/dev/video1".into(),
                refusal: Some("it does not capture pictures".into()),
                ..Camera::default()
            };
            f.cameras.push(meta);
            f.wanted_camera = Some("/dev/video1".into());
        },
        Weight::Wrong,
        "is no camera",
        "/dev/video1: it does not capture",
        "/dev/video0",
    ),
    (
        |f| f.wanted_camera = Some("/dev/video7".into()),
        Weight::Wrong,
        "is not there",
        "/dev/video7",
        "/dev/video0",
    ),
    (
        |f| f.cameras[0].offer = Some(("YUYV 1280x720".into(), Some(55_296_000))),
        Weight::Odd,
        "too much for its USB",
        "55.3 MB/s",
        "mjpg",
    ),
    (
        |f| f.cameras.push(Camera { path: "/dev/video2".into(), holders: held("obs"), ..camera_node() }),
        Weight::Odd,
        "share one USB bus",
        "bus 1",
        "another bus",
    ),
    (|f| f.cards.clear(), Weight::Wrong, "no screen to draw on", "/dev/dri", "--display window"),
    (
        |f| f.cards[0].card.connectors[0].connected = Some(false),
        Weight::Wrong,
        "no screen is plugged in",
        "HDMI-A-1",
        "plug a screen in",
    ),
    (
        |f| f.cards[0].access = Access::Denied,
        Weight::Wrong,
        "may not open the screen",
        "group video",
        "usermod",
    ),
    (
        |f| f.cards[0].holders = held("gnome-shell"),
        Weight::Wrong,
        "desktop owns the screen",
        "gnome-shell (process 77)",
        "isolate",
    ),
    (
        |f| f.cards[0].holders = held("mystery"),
        Weight::Odd,
        "another program has the screen",
        "mystery",
        "end that",
    ),
    (
        |f| {
            f.serial =
                Some(Serial { path: "/dev/ttyACM3".into(), access: Access::Missing, ..Serial::default() })
        },
        Weight::Wrong,
        "serial port is not there",
        "/dev/ttyACM3",
        "/dev/ttyUSB0",
    ),
    (
        |f| {
            let port = f.serial.as_mut().expect("a port");
            (port.access, port.group) = (Access::Denied, Some("dialout".into()));
        },
        Weight::Wrong,
        "may not open the buttons'",
        "dialout",
        "usermod -aG dialout",
    ),
    (
        |f| f.serial.as_mut().expect("a port").holders = held("ModemManager"),
        Weight::Wrong,
        "port open",
        "ModemManager",
        "disable ModemManager",
    ),
    (
        |f| f.serial.as_mut().expect("a port").is_device = false,
        Weight::Wrong,
        "no device",
        "ttyACM0",
        "serial.port",
    ),
    (|f| f.state.as_mut().expect("a folder").read_only = true, Weight::Odd, "read-only", "/var/lib", "mount"),
    (|f| f.state.as_mut().expect("a folder").free = 1000, Weight::Odd, "full", "0 kB free", "delete"),
    (
        |f| f.state.as_mut().expect("a folder").access = Access::Denied,
        Weight::Odd,
        "may not write",
        "/var/lib",
        "systemctl",
    ),
    (|f| f.clock = 1000, Weight::Odd, "clock is not set", "1000 s", "time server"),
    (|f| f.heat[0].celsius = 81.0, Weight::Odd, "hot", "81 °C", "heat sink"),
    (|f| f.throttled = Some(0x5_0005), Weight::Odd, "too little voltage", "0x50005, now", "power supply"),
    (|f| f.throttled = Some(0x4), Weight::Odd, "holds the processor back", "0x4", "air"),
    (|f| f.root = true, Weight::Odd, "this is root", "user 0", "service"),
    (
        |f| f.config = vec![Problem { place: "visor.toml:3".into(), what: "unknown field".into() }],
        Weight::Wrong,
        "mistake",
        "visor.toml:3",
        "unknown field",
    ),
];

#[test]
fn every_cause_is_found_with_its_evidence_and_what_to_do() {
    let usual = diagnose(&sound());
    for (change, weight, what, evidence, todo) in CASES {
        let mut facts = sound();
        change(&mut facts);
        let new: Vec<Finding> =
            diagnose(&facts).into_iter().filter(|finding| !usual.contains(finding)).collect();
        let fits = |f: &Finding| {
            f.weight == *weight
                && f.what.contains(what)
                && f.evidence.contains(evidence)
                && f.todo.contains(todo)
        };
        assert!(new.iter().any(fits), "{what}: {new:#?}");
        assert_eq!(
            new.iter().filter(|f| f.weight != Weight::Good).count(),
            usize::from(*weight != Weight::Good),
            "{what}: consequences are left out: {new:#?}"
        );
    }
}

#[test]
fn what_is_not_wanted_is_not_missed() {
    let facts =
        Facts { wanted_camera: None, wanted_card: None, cameras: Vec::new(), cards: Vec::new(), ..sound() };
    assert!(diagnose(&facts).iter().all(|finding| finding.weight == Weight::Good));
    let mut cards = vec![Screen {
        card: Card { path: PathBuf::from("/dev/dri/card1"), driver: "v3d".into(), connectors: Vec::new() },
        ..card()
    }];
    cards.push(card());
    assert!(diagnose(&Facts { cards, ..sound() }).iter().all(|finding| finding.weight == Weight::Good));
}
