//! `vernissage run` from outside: what its status and metrics files say, and settings that change while it runs.

#[path = "common/folder.rs"]
mod folder;

use folder::Folder;
use serde_json::Value;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use vernissage::pixels::{Rgb, picture};

/// How long anything may take on a busy machine.
const PATIENCE: Duration = Duration::from_secs(30);

/// The running visor, ended with the test.
struct Visor(Child);

impl Visor {
    fn start(folder: &Folder, more: &[&str]) -> Self {
        let child = Command::new(env!("CARGO_BIN_EXE_vernissage"))
            .args(["run", "--json", "--config"])
            .arg(folder.0.join("visor.toml"))
            .arg("--status")
            .arg(folder.0.join("status.json"))
            .args(more)
            .env("STATE_DIRECTORY", &folder.0)
            .stdout(Stdio::piped())
            .spawn()
            .expect("the built binary runs");
        Self(child)
    }

    fn signal(&self, name: &str) {
        let sent = Command::new("kill").args([name, &self.0.id().to_string()]).status().expect("kill runs");
        assert!(sent.success());
    }

    /// The closing figures.
    fn ends(mut self) -> Value {
        let begun = Instant::now();
        while self.0.try_wait().expect("a child").is_none() && begun.elapsed() < PATIENCE {
            std::thread::sleep(Duration::from_millis(20));
        }
        assert!(self.0.try_wait().expect("a child").expect("an end").success());
        serde_json::from_reader(self.0.stdout.take().expect("a pipe")).expect("figures")
    }
}

impl Drop for Visor {
    fn drop(&mut self) {
        _ = self.0.kill();
        _ = self.0.wait();
    }
}

/// The status once it is as wanted; every state of the file on the way must be whole.
fn status(folder: &Folder, what: &str, wanted: impl Fn(&Value) -> bool) -> Value {
    let (begun, mut last) = (Instant::now(), Value::Null);
    while begun.elapsed() < PATIENCE {
        if let Ok(text) = std::fs::read_to_string(folder.0.join("status.json")) {
            last = serde_json::from_str(&text).expect("a whole file");
            if wanted(&last) {
                return last;
            }
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    panic!("never {what}: {last:#}");
}

#[test]
fn the_status_says_what_the_run_says() {
    let folder = Folder::new("status");
    folder.write(
        "visor.toml",
        "[camera]\nsource = \"synthetic\"\nwidth = 160\nheight = 120\n[[model]]\nfile = \"teapot\"\nmarker = { id = 7 }\n\
         [style]\nname = \"plain\"\n[display]\nsink = \"null\"\n",
    );
    let metrics = folder.0.join("metrics.prom");
    let visor =
        Visor::start(&folder, &["--frames", "60", "--metrics", metrics.to_str().expect("plain path")]);
    // while it runs: about a frame's rate, and a version
    let early = status(&folder, "running", |s| s["frames"]["shown"].as_u64() > Some(20));
    assert_eq!((early["state"].as_str(), early["camera"]["state"].as_str()), (Some("run"), Some("run")));
    assert!(early["version"].as_str().expect("text").starts_with(env!("CARGO_PKG_VERSION")));
    let figures = visor.ends();
    let last = status(&folder, "written", |_| true);
    for key in ["shown", "tracked", "missing", "replaced", "out_of_order", "slates"] {
        assert_eq!(last["frames"][key], figures[key], "{key}");
    }
    assert_eq!(last["frames"]["shown"], 60);
    assert!(last["frames"]["tracked"].as_u64() > Some(50) && last["tracked"] == 1, "{last:#}");
    assert_eq!((&last["latency_ms"], &last["stages_ms"]), (&figures["latency_ms"], &figures["stages_ms"]));
    let latency = |p: &str| last["latency_ms"][p].as_f64().expect("a number");
    assert!(latency("p50") > 0.0 && latency("p50") <= latency("p99"), "{last:#}");
    assert_eq!(last["camera"]["delivered"].as_u64(), last["camera"]["received"].as_u64());
    assert!(last["camera"]["delivered"].as_u64() >= Some(60), "{last:#}");
    assert_eq!((last["faults"].as_array().map(Vec::len), last["style"].as_str()), (Some(0), Some("plain")));
    assert_eq!((last["scene"].as_str(), last["settings"]["taken"].as_u64()), (Some("visor"), Some(0)));
    let text = std::fs::read_to_string(metrics).expect("metrics");
    assert!(text.lines().any(|line| line == "vernissage_frames_total{what=\"shown\"} 60"), "{text}");
    assert!(!folder.0.join("status.json.new").exists(), "nothing is left beside it");
}

/// The shown pictures in order.
fn shown(folder: &Path) -> Vec<Rgb> {
    let mut files: Vec<_> =
        std::fs::read_dir(folder).expect("pictures").flatten().map(|f| f.path()).collect();
    files.sort();
    files.iter().map(|file| picture::read(file).expect("a whole picture")).collect()
}

/// A still camera: pictures of a style are all the same, so that one that is half of another would be seen.
fn still(style: &str, more: &str) -> String {
    format!(
        "[camera]\nsource = \"synthetic\"\nwidth = 160\nheight = 120\nfps = 20\n[camera.synthetic]\nnoise = 0\npace = 0\n\
         [style]\nname = \"{style}\"\nfade_ms = 0\n{more}\n[display]\nsink = \"png\"\npath = \"{{}}\"\n"
    )
}

#[test]
fn settings_are_taken_between_two_frames_or_refused_with_their_line() {
    let folder = Folder::new("settings");
    let pictures = folder.0.join("pictures");
    let text =
        |style: &str, more: &str| still(style, more).replace("{}", pictures.to_str().expect("plain path"));
    folder.write("visor.toml", &text("plain", ""));
    let visor = Visor::start(&folder, &[]);
    let styled = |name: &'static str| move |s: &Value| s["style"] == name;
    status(&folder, "started", |s| s["frames"]["shown"].as_u64() > Some(5));

    folder.write("visor.toml", &text("illustrative", ""));
    let taken = status(&folder, "illustrative", styled("illustrative"));
    assert_eq!((taken["settings"]["taken"].as_u64(), &taken["settings"]["refused"]), (Some(1), &Value::Null));

    // wrong: the old ones stay, and the reason names the line
    folder.write("visor.toml", &text("sketch-like", "wrong = 1"));
    let refused = status(&folder, "refused", |s| s["settings"]["refused"].is_string());
    let reason = refused["settings"]["refused"].as_str().expect("a reason");
    assert!(reason.contains("visor.toml:12: unknown field `wrong`"), "{reason}");
    assert_eq!(
        (refused["style"].as_str(), refused["state"].as_str()),
        (Some("illustrative"), Some("degraded"))
    );
    assert_eq!(refused["faults"], serde_json::json!([{ "code": "S1", "now": true, "count": 1 }]));

    // right again, and told by a signal; the camera cannot change while it runs
    folder.write("visor.toml", &text("sketch-like", "").replace("fps = 20", "fps = 25"));
    visor.signal("-HUP");
    let taken = status(&folder, "sketch-like", styled("sketch-like"));
    assert_eq!(taken["settings"]["at_next_start"], serde_json::json!(["camera"]));
    assert_eq!((taken["settings"]["refused"].is_null(), &taken["faults"][0]["now"]), (true, &false.into()));
    let seen = taken["frames"]["shown"].as_u64().expect("a count");
    status(&folder, "going on", |s| s["frames"]["shown"].as_u64() > Some(seen));
    visor.signal("-TERM");
    let figures = visor.ends();

    // nothing is lost but what a newer picture replaced, nothing is shown twice or half
    assert_eq!((&figures["out_of_order"], &figures["slates"]), (&0.into(), &0.into()), "{figures}");
    assert!(figures["missing"].as_u64() <= figures["replaced"].as_u64(), "{figures}");
    let pictures = shown(&pictures);
    assert_eq!(Some(pictures.len() as u64), figures["shown"].as_u64());
    let mut kinds: Vec<&Rgb> = Vec::new();
    for picture in &pictures {
        if kinds.last() != Some(&picture) {
            kinds.push(picture);
        }
    }
    assert_eq!(kinds.len(), 3, "each style once, and nothing between two of them");
}

/// A settings file that was cut short when the power went, or lost: the visor starts with the last good one.
#[test]
fn a_settings_file_that_was_cut_short_is_stood_in_for() {
    let folder = Folder::new("kept");
    let text = |style: &str| still(style, "").replace("sink = \"png\"\npath = \"{}\"", "sink = \"null\"");
    folder.write("visor.toml", &text("illustrative"));
    let visor = Visor::start(&folder, &["--wait"]);
    status(&folder, "started", |s| s["frames"]["shown"].as_u64() > Some(2));
    folder.write("visor.toml", &text("sketch-like"));
    status(&folder, "taken", |s| s["style"] == "sketch-like");
    visor.signal("-TERM");
    visor.ends();

    for torn in [Some(&text("plain")[..90]), Some(""), None] {
        match torn {
            Some(torn) => folder.write("visor.toml", torn),
            None => std::fs::remove_file(folder.0.join("visor.toml")).expect("it was there"),
        };
        std::fs::remove_file(folder.0.join("status.json")).expect("of the last run");
        let visor = Visor::start(&folder, &["--wait"]);
        let began = status(&folder, "started", |s| s["frames"]["shown"].as_u64() > Some(2));
        assert_eq!(
            (began["style"].as_str(), &began["state"]),
            (Some("sketch-like"), &"degraded".into()),
            "{torn:?}"
        );
        assert!(began["settings"]["refused"].is_string(), "{began:#}");
        assert_eq!(began["faults"], serde_json::json!([{ "code": "S1", "now": true, "count": 1 }]));
        folder.write("visor.toml", &text("illustrative"));
        let taken = status(&folder, "right again", |s| s["style"] == "illustrative");
        assert_eq!((&taken["state"], &taken["settings"]["refused"]), (&"run".into(), &Value::Null));
        folder.write("visor.toml", &text("sketch-like"));
        status(&folder, "as before", |s| s["style"] == "sketch-like");
        visor.signal("-TERM");
        visor.ends();
    }
}

/// Settings with a mistake, on a card that somebody wrote elsewhere: the screen says which, and what was good last, or the
/// file once it is right, is shown then.
#[test]
fn a_mistake_in_the_settings_is_told_on_the_screen() {
    let folder = Folder::new("mistake");
    let pictures = folder.0.join("pictures");
    let good = still("illustrative", "").replace("{}", pictures.to_str().expect("plain path"));
    let wrong = good.replace("fade_ms", "fade");
    let reason = "visor.toml:11: unknown field `fade`";
    let wait = ["--wait", "--display", pictures.to_str().expect("plain path")];
    let refused = |s: &Value| s["settings"]["refused"].as_str().is_some_and(|r| r.contains(reason));
    let slates = |s: &Value| s["frames"]["slates"].as_u64();

    // nothing to go on with
    folder.write("visor.toml", &wrong);
    let visor = Visor::start(&folder, &wait);
    let told = status(&folder, "told", |s| slates(s) > Some(2));
    assert!(refused(&told), "{told:#}");
    assert_eq!(told["faults"], serde_json::json!([{ "code": "S1", "now": true, "count": 1 }]));
    let picture = &shown(&pictures)[0];
    let ink = picture.planes[0].samples().iter().filter(|&&value| value > 100).count();
    assert!((1000..50_000).contains(&ink), "{ink} pixels of words");
    folder.write("visor.toml", &good);
    let taken = status(&folder, "right", |s| s["frames"]["shown"].as_u64() > Some(2));
    assert_eq!((&taken["style"], &taken["settings"]["refused"]), (&"illustrative".into(), &Value::Null));
    visor.signal("-TERM");
    visor.ends();

    // what was good last stands in, once it was said
    folder.write("visor.toml", &wrong);
    std::fs::remove_file(folder.0.join("status.json")).expect("of the last run");
    let visor = Visor::start(&folder, &wait);
    let told = status(&folder, "told", |s| slates(s) > Some(2));
    assert!(refused(&told) && told["frames"]["shown"] == 0, "{told:#}");
    let stands_in = status(&folder, "going on", |s| s["frames"]["shown"].as_u64() > Some(2));
    assert!(refused(&stands_in) && stands_in["style"] == "illustrative", "{stands_in:#}");
    visor.signal("-TERM");
    visor.ends();

    // told to stop while there is nothing to go on with
    let folder = Folder::new("stopped");
    folder.write("visor.toml", &wrong);
    let visor = Visor::start(&folder, &["--wait", "--display", "null"]);
    status(&folder, "told", |s| slates(s) > Some(0));
    visor.signal("-TERM");
    let mut visor = visor;
    assert!(visor.0.wait().expect("a child").success());
}

/// User and system time of a process, in seconds.
fn cpu(process: u32) -> f64 {
    let text = std::fs::read_to_string(format!("/proc/{process}/stat")).expect("a running process");
    let (_, rest) = text.rsplit_once(')').expect("a name");
    let ticks: Vec<u64> =
        rest.split_whitespace().skip(11).take(2).map(|n| n.parse().expect("ticks")).collect();
    (ticks[0] + ticks[1]) as f64 / 100.0
}

#[test]
fn a_visor_that_waits_for_its_camera_says_so_and_costs_little() {
    let folder = Folder::new("waits");
    let pictures = folder.0.join("pictures");
    folder.write(
        "visor.toml",
        &format!(
            "[camera]\nsource = \"v4l2\"\ndevice = \"/dev/no-such-camera\"\nwidth = 160\nheight = 120\n\
             [display]\nsink = \"png\"\npath = {pictures:?}\n"
        ),
    );
    let visor = Visor::start(&folder, &["--wait"]);
    let lost = status(&folder, "slates", |s| s["frames"]["slates"].as_u64() > Some(3));
    assert_eq!((lost["state"].as_str(), lost["camera"]["state"].as_str()), (Some("no-camera"), Some("lost")));
    assert_eq!(lost["faults"], serde_json::json!([{ "code": "C1", "now": true, "count": 1 }]));
    let (begun, before) = (Instant::now(), cpu(visor.0.id()));
    let slates = lost["frames"]["slates"].as_u64().expect("a count");
    status(&folder, "more slates", |s| s["frames"]["slates"].as_u64() > Some(slates + 12));
    let share = (cpu(visor.0.id()) - before) / begun.elapsed().as_secs_f64();
    eprintln!("{:.1} % of a core while the camera is lost", 100.0 * share);
    // slates are drawn and packed as PNG meanwhile
    assert!(share < 0.05, "{share} of a core");
    visor.signal("-TERM");
    let figures = visor.ends();
    assert_eq!((&figures["shown"], &figures["missing"]), (&0.into(), &0.into()));
    // words on a dark ground, and a sign of life
    let slates = shown(&pictures);
    assert!(slates.len() > 3 && slates[0] != slates[1] && slates[0].at(1, 1)[0] < 40);
}
