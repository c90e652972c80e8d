//! `vernissage run` with a board on its serial port: a simulator of its own, written from the protocol's text
//! (`tests/board_simulator.py`), on a pseudo terminal. Without python3 it is left out, with a
//! word, and fails where `CI` is set.

use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};
use vernissage::pixels::{Rgb, picture};

/// How long anything may take on a busy machine.
const PATIENCE: Duration = Duration::from_secs(20);

/// The simulator, and what it reports.
struct Board {
    child: Child,
    commands: ChildStdin,
    reports: Receiver<String>,
}

impl Board {
    fn start(link: &Path) -> Option<Board> {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/board_simulator.py");
        let mut child = Command::new("python3")
            .arg(script)
            .arg(link)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .ok()?;
        let (commands, output) = (child.stdin.take()?, child.stdout.take()?);
        let (send, reports) = channel();
        std::thread::spawn(move || {
            BufReader::new(output).lines().map_while(Result::ok).try_for_each(|line| send.send(line))
        });
        let board = Board { child, commands, reports };
        board.until("ready", |line| line.contains("ready"));
        Some(board)
    }

    fn order(&mut self, command: &str) {
        writeln!(self.commands, "{command}").expect("the simulator listens");
    }

    /// The first report that is wanted, and all before it.
    fn until(&self, what: &str, wanted: impl Fn(&str) -> bool) -> Vec<String> {
        let (start, mut seen) = (Instant::now(), Vec::new());
        while let Some(left) = PATIENCE.checked_sub(start.elapsed()) {
            let Ok(line) = self.reports.recv_timeout(left) else { break };
            let found = wanted(&line);
            seen.push(line);
            if found {
                return seen;
            }
        }
        panic!("no {what} in {seen:#?}");
    }

    /// The time and the words of the first message with these words in it, whatever its number.
    fn hears(&self, words: &str) -> (u64, Vec<String>) {
        let seen = self.until(words, |line| line.contains(" rx ") && line.contains(words));
        assert!(!seen.iter().any(|line| line.contains(" bad ")), "{seen:#?}");
        let line = seen.last().expect("what was found");
        let mut words = line.split(' ').map(str::to_owned);
        let at = words.next().and_then(|time| time.parse().ok()).expect("a time");
        (at, words.skip(2).collect())
    }

    /// All reports until nothing came for so long.
    fn rest(&self, quiet: Duration) -> Vec<String> {
        std::iter::from_fn(|| self.reports.recv_timeout(quiet).ok()).take(500).collect()
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A board on this terminal, where python3 is.
fn plugged(link: &Path) -> Option<Board> {
    let _ = std::fs::remove_file(link);
    let board = Board::start(link);
    if board.is_none() {
        assert!(std::env::var_os("CI").is_none(), "no python3: the visor is not driven by a board");
        eprintln!("NOT RUN: the visor driven by a board; install python3");
    }
    board
}

/// The visor, ended with the test.
struct Visor(Child);

impl Visor {
    fn start(config: &Path) -> Self {
        let visor = Command::new(env!("CARGO_BIN_EXE_vernissage"))
            .args(["run", "--config"])
            .arg(config)
            .stdout(Stdio::null())
            .spawn();
        Self(visor.expect("the built binary runs"))
    }
}

impl Drop for Visor {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{}", std::process::id()));
    std::fs::create_dir_all(&path).expect("a test folder");
    path
}

#[test]
fn a_board_drives_the_visor() {
    let folder = folder("board");
    let link = folder.join("tty");
    let Some(mut board) = plugged(&link) else { return };
    let config = folder.join("visor.toml");
    for scene in ["day.toml", "night.toml"] {
        std::fs::write(folder.join(scene), "").expect("a test file");
    }
    let text = format!(
        "scenes = [\"day.toml\", \"night.toml\"]\n[snapshot]\ndir = \"kept\"\n[camera]\nsource = \"synthetic\"\nwidth = 160\nheight = 120\n[display]\nsink = \"null\"\n[style]\nname = \"plain\"\n\
         cycle = [\"plain\", \"cartoon\"]\nfade_ms = 0\n[serial]\nport = {link:?}\n[[serial.button]]\nnumber = 1\n\
         short = \"style-next\"\n[[serial.button]]\nnumber = 2\nshort = \"freeze\"\nlong = \"standby\"\n[[serial.button]]\nnumber = 3\n\
         short = \"scene-next\"\n"
    );
    std::fs::write(&config, text).expect("a test file");
    let _visor = Visor::start(&config);

    // handshake, then the news
    board.hears("HI? 1 1");
    board.hears(&format!("OK 1 {}", env!("CARGO_PKG_VERSION")));
    board.hears("STYLE plain");
    board.hears(" RUN ");

    // a press shows in a frame
    let mut frames = Vec::new();
    let (mut took, mut shows) = (Vec::new(), Vec::new());
    for style in ["cartoon", "plain", "cartoon", "plain", "cartoon"] {
        board.order("down 1");
        let sent = board.until("BTN", |line| line.contains(" tx ") && line.contains("BTN 1 D"));
        let sent: u64 = sent.last().and_then(|line| line.split(' ').next()?.parse().ok()).expect("a time");
        board.hears(" ACK ");
        let (shown, words) = board.hears("ACT 1 style-next ok ");
        frames.push(words.last().and_then(|frame| frame.parse::<u64>().ok()).expect("a frame's number"));
        took.push(shown - sent);
        shows.push(shown);
        board.hears(&format!("STYLE {style}"));
        board.order("up 1");
        board.hears(" ACK ");
    }
    assert!(frames.windows(2).all(|pair| pair[0] < pair[1]), "{frames:?}");
    eprintln!("press to shown: {took:?} ms at 30 frames a second");
    // two frames, as long as they are on this machine, and the way there and back (the port is read every 4 ms, the
    // simulator looks every 5); the least of five: a busy machine delays some
    let (frames, times) = ((frames[4] - frames[0]) as f64, (shows[4] - shows[0]) as f64);
    let bound = 2.0 * (times / frames).max(34.0) + 30.0;
    let least = took.iter().copied().min().expect("presses") as f64;
    assert!(least <= bound, "press to shown: {took:?} ms, of which one is to be at most {bound:.0}");

    // the visor is not heard: the board sends again, and it counts once
    board.order("deaf 120");
    board.order("down 1");
    let mut seen = board.until("HB plain", |line| line.contains(" HB ") && line.contains(" plain "));
    board.order("up 1");
    seen.extend(board.rest(Duration::from_millis(900)));
    let count = |words: &str| seen.iter().filter(|line| line.contains(words)).count();
    assert!(count("BTN 1 D") >= 2 && count(" rx ") > 0, "{seen:#?}");
    // twice would be back at the cartoon
    assert!(count("ACT 1") <= 1 && count("STYLE cartoon") == 0, "{seen:#?}");

    // the board is not heard at all until after the press: its state tells
    board.order("mute 700");
    board.order("down 1");
    board.hears("ACT 1 style-next ok ");
    board.hears("STYLE cartoon");
    board.order("up 1");
    board.hears(" ACK ");

    // noise is no press
    board.order("raw 00ff2430312042544e2031204420310aff2a");
    board.order("raw 2430312042544e203120442039393939392a303030300a");
    let seen = board.rest(Duration::from_millis(400));
    assert!(!seen.iter().any(|line| line.contains(" ACT ") || line.contains(" ACK ")), "{seen:#?}");

    // the console looks, and no more
    board.order("type status");
    board.until("status", |line| line.contains("text # RUN cartoon"));
    board.order("type style plain");
    board.until("refusal", |line| line.contains("only with console"));

    // held: standby; the next press brings it back
    board.order("down 2");
    board.hears("ACT 2 standby ok ");
    board.order("up 2");
    board.hears(" STANDBY ");
    board.order("down 1");
    board.hears("ACT 1 style-next ign ");
    board.order("up 1");
    board.hears(" RUN ");

    // unplugged while pressed, and plugged in again while still pressed: no press
    board.order("down 2");
    board.hears(" ACK ");
    board.order("unplug");
    // how long the plug is out, not a wait for anything: the visor must cope with whatever it is doing by then
    std::thread::sleep(Duration::from_millis(300));
    board.order("plug");
    board.hears("OK 1 ");
    board.hears(" RUN ");
    board.order("up 2");
    let seen = board.rest(Duration::from_millis(500));
    // what was begun when it left is told as a short press, once
    assert!(seen.iter().filter(|line| line.contains(" ACT ")).count() <= 1, "{seen:#?}");

    // the board starts again
    board.order("reboot");
    board.hears("OK 1 ");
    board.order("down 1");
    board.hears("ACT 1 style-next ok ");
    board.order("up 1");
    board.hears(" ACK ");

    // scenes, by a press and by a controller: told when they are shown, the style is the scene's own
    board.order("down 3");
    board.hears("ACT 3 scene-next ok ");
    board.order("up 3");
    board.hears(" ACK ");
    board.order("send SET scene day");
    board.hears(" ACK ");
    board.order("send SET scene noon");
    board.until("refusal", |line| line.contains(" rx ") && line.contains(" unknown-scene"));

    // a picture is kept because the settings say where
    board.order("send SHOT");
    board.hears(" ACK ");
    let start = Instant::now();
    let kept = || std::fs::read_dir(folder.join("kept")).map_or(0, |files| files.flatten().count());
    while kept() == 0 && start.elapsed() < PATIENCE {
        std::thread::sleep(Duration::from_millis(20));
    }
    assert_eq!(kept(), 1);
}

#[test]
fn a_visitor_chooses_from_the_menu() {
    let folder = folder("menu");
    let link = folder.join("tty");
    let Some(mut board) = plugged(&link) else { return };
    let (config, pictures) = (folder.join("visor.toml"), folder.join("pictures"));
    let _ = std::fs::remove_dir_all(&pictures);
    let text = format!(
        "[camera]\nsource = \"synthetic\"\nwidth = 320\nheight = 240\nfps = 10\n[camera.synthetic]\nnoise = 0\npace = 0\n\
         [display]\nsink = \"png\"\npath = {pictures:?}\n[style]\nname = \"plain\"\ncycle = [\"plain\", \"sketch-like\"]\n\
         fade_ms = 0\n[serial]\nport = {link:?}\n[[serial.button]]\nnumber = 1\nshort = \"menu\"\n\
         [[serial.button]]\nnumber = 2\nshort = \"style-previous\"\ndouble = \"menu\"\n"
    );
    std::fs::write(&config, text).expect("a test file");
    let visor = Visor::start(&config);
    board.hears("STYLE plain");
    // a finger is slower than a pulse that is noise
    let press = |board: &mut Board| {
        board.order("down 1");
        board.hears(" ACK ");
        std::thread::sleep(Duration::from_millis(30));
        board.order("up 1");
        board.hears(" ACK ");
        board.hears("ACT 1 menu ok ");
    };
    let hold = |board: &mut Board| {
        board.order("down 1");
        board.hears("ACT 1 menu ok ");
    };
    // opened, two lines on, and left as it was
    (0..3).for_each(|_| press(&mut board));
    hold(&mut board);
    board.order("up 1");
    board.hears(" ACK ");
    // opened again, one line on, and chosen
    (0..2).for_each(|_| press(&mut board));
    hold(&mut board);
    board.hears("STYLE sketch-like");
    board.order("up 1");
    board.hears(" ACK ");
    board.hears(" HB ");
    // held down, a button that means nothing by it does what a short press does: the menu is closed
    board.order("down 2");
    board.hears("ACT 2 style-previous ok ");
    board.order("up 2");
    board.hears(" HB ");
    drop(visor);

    // the pictures that were shown: plain, with a list on it twice, drawn, and plain at the end
    let mut files: Vec<_> =
        std::fs::read_dir(&pictures).expect("pictures").flatten().map(|f| f.path()).collect();
    files.sort();
    files.pop(); // it may have been written when the visor ended
    let mut kinds: Vec<Rgb> = Vec::new();
    for file in files {
        let picture = picture::read(&file).expect("a picture");
        if kinds.last() != Some(&picture) {
            kinds.push(picture);
        }
    }
    let paper = |picture: &Rgb| {
        let row = picture.planes[0].row(120);
        row[160 - 90..160 + 90].iter().filter(|&&value| value == 16 || value == 200).count() == 180
    };
    let listed: Vec<bool> = kinds.iter().map(paper).collect();
    assert_eq!(listed, [false, true, true, true, false, true, true, false, false]);
    assert!(kinds[0] == kinds[4] && kinds[0] != kinds[7] && kinds[0] == kinds[8]);
    assert!(kinds[1] == kinds[5] && kinds[2] == kinds[6] && kinds[1] != kinds[2] && kinds[2] != kinds[3]);
}
