//! `display.sink = "window"` on a real X server (Xvfb): its pictures are the composed ones byte for byte, at first and
//! after the window was made larger; closing it ends the run in order; a server that stands still does not hold it, and
//! one that goes away is named.

#[path = "common/folder.rs"]
mod folder;

use folder::Folder;
use std::io::{BufRead, BufReader, Read};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use vernissage::display::{Layout, Scale, compose};
use vernissage::pixels::{Size, picture};
use x11rb::connection::Connection;
use x11rb::protocol::xproto::{
    AtomEnum, ClientMessageEvent, ConfigureWindowAux, ConnectionExt, EventMask, ImageFormat, KEY_PRESS_EVENT,
    KeyButMask, KeyPressEvent,
};
use x11rb::rust_connection::RustConnection;

/// Longer than anything here takes on a loaded machine.
const LONG: Duration = Duration::from_secs(60);
const CANVAS: Size = Size { width: 320, height: 240 };

/// A child that ends with the test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Running {
    /// Whether it ended well, and what it wrote.
    fn ended(mut self) -> (bool, String) {
        let end = Instant::now() + LONG;
        while self.0.try_wait().expect("a child").is_none() {
            assert!(Instant::now() < end, "it does not end");
            std::thread::sleep(Duration::from_millis(20));
        }
        let mut said = String::new();
        let (out, err) = (self.0.stdout.take().expect("piped"), self.0.stderr.take().expect("piped"));
        out.chain(err).read_to_string(&mut said).expect("text");
        (self.0.wait().expect("a child").success(), said)
    }

    fn signal(&self, signal: rustix::process::Signal) {
        let process = rustix::process::Pid::from_child(&self.0);
        rustix::process::kill_process(process, signal).expect("a child");
    }
}

/// An X server, and its name.
fn server() -> Option<(Running, String)> {
    let mut command = Command::new("Xvfb");
    command.args(["-displayfd", "1", "-screen", "0", "800x600x24", "-nolisten", "tcp", "-noreset"]);
    let Ok(mut child) = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn() else {
        assert!(std::env::var_os("CI").is_none(), "no Xvfb: windows are not tested; install xvfb");
        eprintln!("NOT RUN: windows; install xvfb");
        return None;
    };
    let mut number = String::new();
    BufReader::new(child.stdout.take().expect("piped")).read_line(&mut number).expect("a number");
    Some((Running(child), format!(":{}", number.trim())))
}

/// The visor before a table where nothing moves.
fn visor(folder: &Folder, server: &str, more: &[&str]) -> Running {
    folder.write(
        "visor.toml",
        "[camera]\nsource = \"synthetic\"\nwidth = 320\nheight = 240\nfps = 30\n\
         [camera.synthetic]\nnoise = 0\npace = 0\n[style]\nname = \"plain\"\n[display]\nscale = \"fit\"\n",
    );
    started(folder, server, more)
}

/// The visor with the settings that are there.
fn started(folder: &Folder, server: &str, more: &[&str]) -> Running {
    let mut command = Command::new(env!("CARGO_BIN_EXE_vernissage"));
    command.args(["run", "--config"]).arg(folder.0.join("visor.toml")).args(more);
    command.env("DISPLAY", server).stdout(Stdio::piped()).stderr(Stdio::piped());
    Running(command.spawn().expect("the built binary runs"))
}

/// The window of the visor, by its name, as soon as there is one.
fn window(client: &RustConnection, screen: usize) -> u32 {
    let root = client.setup().roots[screen].root;
    let end = Instant::now() + LONG;
    loop {
        let tree = client.query_tree(root).expect("sent").reply().expect("the windows");
        for child in tree.children {
            // it may have gone meanwhile
            let name = client.get_property(false, child, AtomEnum::WM_NAME, AtomEnum::STRING, 0, 64);
            if name.expect("sent").reply().is_ok_and(|name| name.value == b"vernissage") {
                return child;
            }
        }
        assert!(Instant::now() < end, "no window");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Waits until the window's pixels are `expected` (blue, green, red, nothing).
fn shows(client: &RustConnection, window: u32, size: Size, expected: &[u8]) {
    let end = Instant::now() + LONG;
    loop {
        let (width, height) = (size.width as u16, size.height as u16);
        let image = client.get_image(ImageFormat::Z_PIXMAP, window, 0, 0, width, height, !0).expect("sent");
        // not yet mapped, or not yet as large
        let image = image.reply().map(|image| image.data).unwrap_or_default();
        let same = image.len() == expected.len()
            && image.iter().zip(expected).enumerate().all(|(at, (a, b))| at % 4 == 3 || a == b);
        if same {
            return;
        }
        assert!(Instant::now() < end, "not the composed picture of {size}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// A visor in a window that shows the right pictures.
struct Opened {
    folder: Folder,
    xvfb: Running,
    display: String,
    visor: Running,
    client: RustConnection,
    window: u32,
}

/// Opens one, and makes its window larger.
fn opened(name: &str) -> Option<Opened> {
    let (xvfb, display) = server()?;
    let folder = Folder::new(name);
    let pictures = folder.0.join("pictures");
    let pictures = pictures.to_str().expect("a plain path");
    assert!(
        visor(&folder, "", &["--display", pictures, "--frames", "2"]).ended().0,
        "pictures to compare with"
    );
    let canvas = std::fs::read_dir(pictures).expect("a folder").flatten().map(|file| file.path()).max();
    let canvas = picture::read(&canvas.expect("a picture")).expect("a picture");
    let composed = |size| {
        let fit = Layout { scale: Scale::Fit, ..Layout::default() };
        compose(&canvas, size, fit).rows().collect::<Vec<_>>().concat()
    };
    let (client, screen) = RustConnection::connect(Some(&display)).expect("the server");
    let visor = visor(&folder, &display, &["--display", "window", "--json"]);
    let window = window(&client, screen);
    shows(&client, window, CANVAS, &composed(CANVAS));
    // larger than the canvas, and of another shape
    let size = Size::new(500, 300);
    let larger = ConfigureWindowAux::new().width(size.width as u32).height(size.height as u32);
    client.configure_window(window, &larger).expect("sent").check().expect("a larger window");
    shows(&client, window, size, &composed(size));
    Some(Opened { folder, xvfb, display, visor, client, window })
}

/// Asks for the window's end, as a desktop does.
fn close(client: &RustConnection, window: u32) {
    let atom =
        |name: &str| client.intern_atom(false, name.as_bytes()).expect("sent").reply().expect("it").atom;
    let closes = [atom("WM_DELETE_WINDOW"), 0, 0, 0, 0];
    let message = ClientMessageEvent::new(32, window, atom("WM_PROTOCOLS"), closes);
    client.send_event(false, window, EventMask::NO_EVENT, message).expect("sent").check().expect("taken");
}

#[test]
fn closing_the_window_ends_the_run_in_order() {
    let Some(Opened { folder, xvfb: _xvfb, display, visor, client, window }) = opened("window-close") else {
        return;
    };
    close(&client, window);
    let (well, said) = visor.ended();
    assert!(well && said.contains("\"shown\":"), "{said}");

    // and so does the key q, in another window
    let visor = self::visor(&folder, &display, &["--display", "window"]);
    let window = self::window(&client, 0);
    let keys = client.get_keyboard_mapping(8, 248).expect("sent").reply().expect("keys");
    let each = usize::from(keys.keysyms_per_keycode);
    let q = keys.keysyms.chunks(each).position(|key| key[0] == u32::from(b'q')).expect("a keyboard") + 8;
    let root = client.setup().roots[0].root;
    let press = KeyPressEvent {
        response_type: KEY_PRESS_EVENT,
        detail: q as u8,
        sequence: 0,
        time: 0,
        root,
        event: window,
        child: 0,
        root_x: 0,
        root_y: 0,
        event_x: 0,
        event_y: 0,
        state: KeyButMask::default(),
        same_screen: true,
    };
    client.send_event(false, window, EventMask::KEY_PRESS, press).expect("sent").check().expect("taken");
    let (well, said) = visor.ended();
    assert!(well && said.contains("shown"), "{said}");
}

#[test]
fn what_is_wrong_with_the_settings_is_said_until_the_window_is_closed() {
    let Some((_xvfb, display)) = server() else { return };
    let folder = Folder::new("window-refused");
    folder.write("visor.toml", "[style]\nnmae = \"plain\"\n");
    let (client, screen) = RustConnection::connect(Some(&display)).expect("the server");
    let visor = started(&folder, &display, &["--display", "window", "--wait"]);
    let window = window(&client, screen);
    close(&client, window);
    let (well, said) = visor.ended();
    assert!(well && said.contains("nmae"), "{said}");
}

#[test]
fn a_server_that_stands_still_does_not_hold_the_run() {
    let Some((xvfb, display)) = server() else { return };
    let folder = Folder::new("window-still");
    let (client, screen) = RustConnection::connect(Some(&display)).expect("the server");
    let status = folder.0.join("status.json");
    let status = status.to_str().expect("a plain path");
    // 3 s of pictures; a server that takes none is given 5
    let visor =
        visor(&folder, &display, &["--display", "window", "--frames", "90", "--json", "--status", status]);
    window(&client, screen);
    xvfb.signal(rustix::process::Signal::STOP);
    let (well, said) = visor.ended();
    assert!(well && said.contains("\"shown\":90"), "{said}");
    let status = std::fs::read_to_string(status).expect("a status");
    let status: serde_json::Value = serde_json::from_str(&status).expect("JSON");
    let dropped = status["display"]["lost_flips"].as_u64();
    assert!(dropped.is_some_and(|dropped| dropped > 30), "pictures not taken are counted: {status}");
}

#[test]
fn a_server_that_takes_no_pictures_for_long_is_named() {
    let Some(Opened { folder: _folder, xvfb, visor, .. }) = opened("window-stuck") else { return };
    xvfb.signal(rustix::process::Signal::STOP);
    let (well, said) = visor.ended();
    assert!(!well && said.contains("the window is lost: the X server takes no pictures"), "{said}");
}

#[test]
fn a_server_that_goes_away_is_named() {
    let Some(Opened { folder: _folder, xvfb, visor, .. }) = opened("window-gone") else { return };
    drop(xvfb);
    let (well, said) = visor.ended();
    assert!(!well && said.contains("the window is lost: ") && said.contains("desktop"), "{said}");
}

#[test]
fn without_a_server_it_says_what_to_do() {
    let folder = Folder::new("window-none");
    for (server, why) in [("", "DISPLAY names no X server"), (":4711", "X server :4711: ")] {
        let (well, said) = visor(&folder, server, &["--display", "window"]).ended();
        assert!(!well && said.contains(&format!("no window: {why}")) && said.contains("\"png\""), "{said}");
    }
}
