//! `vernissage run` under a service manager: ready once a picture is shown, alive while pictures are shown, given time
//! while a screen is waited for.

#[path = "common/folder.rs"]
mod folder;

use folder::Folder;
use std::io::Write;
use std::os::unix::net::UnixDatagram;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// Runs the appliance with a manager that listens and wants a sign of life every second.
fn run(folder: &Folder, camera: &str, more: &[&str]) -> (UnixDatagram, Child) {
    let config = folder.0.join("visor.toml");
    let sink = if more.contains(&"--wait") { "kms\"\ncard = \"/dev/dri/no-such-card" } else { "null" };
    let text = format!("[camera]\n{camera}\nwidth = 160\nheight = 120\n[display]\nsink = \"{sink}\"\n");
    std::fs::write(&config, text).expect("a settings file");
    let path = folder.0.join("notify");
    let socket = UnixDatagram::bind(&path).expect("a socket");
    socket.set_read_timeout(Some(Duration::from_secs(20))).expect("a limit");
    let child = Command::new(env!("CARGO_BIN_EXE_vernissage"))
        .args(["run", "--config"])
        .arg(&config)
        .args(more)
        .env("NOTIFY_SOCKET", &path)
        .env("WATCHDOG_USEC", "1000000")
        .env_remove("WATCHDOG_PID")
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .expect("the program starts");
    (socket, child)
}

fn next(socket: &UnixDatagram) -> Option<String> {
    let mut bytes = [0; 512];
    let length = socket.recv(&mut bytes).ok()?;
    Some(String::from_utf8_lossy(&bytes[..length]).into_owned())
}

#[test]
fn ready_with_the_first_picture_alive_with_every_other() {
    let folder = Folder::new("service");
    let (socket, mut child) = run(&folder, "source = \"synthetic\"", &["--frames", "90"]);
    let mut heard = Vec::new();
    while let Some(message) = next(&socket) {
        let last = message.contains("STOPPING=1");
        heard.push(message);
        if last {
            break;
        }
    }
    assert!(child.wait().expect("an end").success());
    assert!(heard[0].contains("READY=1"), "{heard:?}");
    let alive = heard.iter().filter(|message| message.contains("WATCHDOG=1")).count();
    // three seconds of pictures or more, a sign of life every quarter of a second
    assert!(alive >= 4, "{heard:?}");
    assert!(heard.last().expect("messages").contains("STOPPING=1"), "{heard:?}");
}

/// A source that sends nothing shows nothing: neither ready nor alive.
#[test]
fn nothing_shown_is_not_ready() {
    let folder = Folder::new("service-silent");
    let (socket, mut child) = run(&folder, "source = \"clip\"\npath = \"-\"", &[]);
    let mut input = child.stdin.take().expect("a pipe");
    input.write_all(b"YUV4MPEG2 W160 H120 F30:1 C444\n").expect("the clip's head");
    socket.set_read_timeout(Some(Duration::from_secs(2))).expect("a limit");
    assert_eq!(next(&socket), None, "nothing was shown");
    // one picture, and it is ready; then silence, and no sign of life
    input.write_all(b"FRAME\n").expect("a frame's head");
    input.write_all(&vec![128; 3 * 160 * 120]).expect("a frame");
    input.flush().expect("sent");
    socket.set_read_timeout(Some(Duration::from_secs(10))).expect("a limit");
    assert!(next(&socket).expect("a message").contains("READY=1"));
    socket.set_read_timeout(Some(Duration::from_secs(2))).expect("a limit");
    assert_eq!(next(&socket), None, "nothing more was shown");
    drop(input);
    socket.set_read_timeout(Some(Duration::from_secs(10))).expect("a limit");
    assert!(next(&socket).expect("a message").contains("STOPPING=1"));
    assert!(child.wait().expect("an end").success());
}

/// A screen that is not there yet is no failure: more time to start, and never ready.
#[test]
fn a_screen_that_is_waited_for_is_given_time() {
    let folder = Folder::new("service-waits");
    let (socket, mut child) = run(&folder, "source = \"synthetic\"", &["--wait", "--frames", "1"]);
    let mut heard = Vec::new();
    while heard.iter().filter(|m: &&String| m.starts_with("EXTEND_TIMEOUT_USEC=30000000")).count() < 3 {
        heard.push(next(&socket).expect("a message"));
    }
    assert!(heard.iter().any(|message| message.contains("STATUS=nothing to show on")), "{heard:?}");
    assert!(!heard.iter().any(|m| m.contains("READY=1") || m.contains("WATCHDOG=1")), "{heard:?}");
    child.kill().expect("it runs");
    child.wait().expect("an end");
}
