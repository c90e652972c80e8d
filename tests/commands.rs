//! The technician's commands, and the new user's path as README writes it.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn run_in(folder: &Path, args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_vernissage"));
    command.args(args).current_dir(folder).output().expect("the built binary runs")
}

fn vernissage(args: &[&str]) -> Output {
    run_in(Path::new("."), args)
}

/// A folder of this test's own, empty.
fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("commands").join(name);
    _ = std::fs::remove_dir_all(&path);
    std::fs::create_dir_all(&path).expect("a test folder");
    path
}

fn told(output: &Output) -> (String, String) {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    assert!(!text(&output.stderr).contains("panicked"), "{}", text(&output.stderr));
    (text(&output.stdout), text(&output.stderr))
}

const COMMANDS: [&str; 15] = [
    "demo",
    "run",
    "render",
    "stylize",
    "detect",
    "draw",
    "plan",
    "bench",
    "sheet",
    "calibrate",
    "check",
    "probe",
    "doctor",
    "completions",
    "manual",
];

#[test]
fn three_commands_of_the_readme_lead_to_a_model_on_a_marker() {
    let readme = include_str!("../README.md");
    let section =
        readme.split("\n## ").find(|section| section.starts_with("Three commands")).expect("the section");
    let block = section.split("```").nth(1).expect("its commands");
    let commands: Vec<Vec<&str>> = block
        .lines()
        .filter_map(|line| line.strip_prefix("vernissage "))
        .map(|line| line.split('#').next().unwrap_or(line).split_whitespace().collect())
        .collect();
    assert_eq!(commands.len(), 3, "{block}");
    let here = folder("readme");
    // word by word as written; without a camera and a screen the run is told of the synthetic ones
    let sheet = run_in(&here, &commands[0]);
    assert!(sheet.status.success(), "{}", told(&sheet).1);
    let file = commands[0].iter().skip_while(|word| **word != "--out").nth(1).copied().unwrap_or("sheet.pdf");
    assert!(std::fs::read(here.join(file)).expect("the sheet").starts_with(b"%PDF"));
    let doctor = run_in(&here, &commands[1]);
    assert!(matches!(doctor.status.code(), Some(0 | 1)), "{}", told(&doctor).1);
    let without = ["--camera", "synthetic", "--display", "null", "--frames", "6", "--json"];
    let run = run_in(&here, &[&commands[2][..], &without].concat());
    let (out, error) = told(&run);
    assert!(run.status.success(), "{error}");
    let figures: serde_json::Value = serde_json::from_str(&out).expect("JSON");
    assert_eq!(figures["shown"], 6);
    // which marker the sheet shows, and its size, need not be said
    let plan = told(&run_in(&here, &[&["plan"], &commands[2][1..]].concat())).0;
    assert!(plan.contains("style   cartoon") && plan.contains("on tag36h11 any"), "{plan}");
}

#[test]
fn flags_stand_in_for_a_file_or_beside_one() {
    let here = folder("flags");
    let synthetic = ["run", "--camera", "synthetic", "--frames", "12", "--json"];
    let more = ["--model", "spot", "--style", "sketch-like", "--marker", "tag36h11:7", "--side-mm", "80"];
    let out = here.join("pictures");
    let run = run_in(&here, &[&synthetic[..], &more, &["--display", "pictures"]].concat());
    assert!(run.status.success(), "{}", told(&run).1);
    assert_eq!(std::fs::read_dir(&out).expect("pictures").count(), 12);
    std::fs::write(
        here.join("visor.toml"),
        "[camera]\nwidth = 320\nheight = 240\n[display]\nsink = \"null\"\n",
    )
    .expect("a file");
    let run = run_in(&here, &[&synthetic[..], &["--config", "visor.toml", "--display", "clip.y4m"]].concat());
    assert!(run.status.success(), "{}", told(&run).1);
    assert!(std::fs::read(here.join("clip.y4m")).expect("a clip").starts_with(b"YUV4MPEG2 W320 H240"));
    for (args, says) in [
        (&["run"][..], "--config"),
        (&["run", "--model", "vase.obj", "--camera", "synthetic"], "--model vase.obj"),
        (&["run", "--model", "spot", "--marker", "tag36h11:900"], "ids 0 to 586"),
        (&["run", "--model", "spot", "--marker", "tag36h12"], "did you mean `tag36h11`"),
        (&["run", "--model", "spot", "--marker", "tag36h11:x"], "tag36h11:7"),
        (&["run", "--model", "spot", "--side-mm", "-1"], "above 0"),
        (&["run", "--model", "spot", "--lens", "nowhere.toml"], "nowhere.toml"),
    ] {
        let output = run_in(&here, args);
        let error = told(&output).1;
        assert_eq!(output.status.code(), Some(2), "{args:?}: {error}");
        assert!(error.contains(says), "{args:?}: {error}");
    }
}

#[test]
fn check_tells_every_problem_at_once_with_its_line() {
    let here = folder("check");
    std::fs::write(
        here.join("visor.toml"),
        r#"thread = 2

[camera]
source = "v4l2"
device = "/dev/no-such-camera"
width = 99999
formt = "mjpg"

[lens]
file = "lens.yaml"

[[model]]
file = "vase.obj"
marker = { id = 1 }

[[model]]
file = "teapot"
marker = { family = "tag36h11", id = 9999 }

[[model]]
file = "spot"
marker = { famly = "tag36h11" }

[[board]]
prints = [
  { id = 1, at_mm = [0, 0, 0] },
  { id = 1, at_mm = [9, 0, 0] },
]

[style]
name = "cartoony"

[serial]
port = "/dev/no-such-port"
baud = 7

[display]
sink = "kms"
card = "/dev/dri/no-such-card"
"#,
    )
    .expect("a file");
    std::fs::write(here.join("lens.yaml"), "%YAML:1.0\n---\nimage_width: 640\n").expect("a file");
    let output = run_in(&here, &["check", "visor.toml"]);
    let (out, error) = told(&output);
    assert_eq!(output.status.code(), Some(2), "{error}");
    for (place, says) in [
        ("visor.toml:1: ", "did you mean `threads`"),
        ("visor.toml:5: ", "/dev/no-such-camera is no device"),
        ("visor.toml:6: ", "camera.width = 99999"),
        ("visor.toml:7: ", "did you mean `format`"),
        ("visor.toml:9: ", "lens.yaml:3: no camera_matrix"),
        ("visor.toml:12: ", "vase.obj"),
        ("visor.toml:16: ", "ids 0 to 586"),
        ("visor.toml:22: ", "did you mean `family`"),
        ("visor.toml:24: ", "fixed twice"),
        ("visor.toml:31: ", "cartoony"),
        ("visor.toml:34: ", "/dev/no-such-port is no device"),
        ("visor.toml:35: ", "serial.baud = 7"),
        ("visor.toml:39: ", "no-such-card is no device"),
    ] {
        assert!(
            out.lines().any(|line| line.starts_with(place) && line.contains(says)),
            "{place}{says}\nin\n{out}"
        );
    }
    assert_eq!(out.lines().count(), 13, "{out}");
    assert!(error.contains("13 problems"), "{error}");
    let json = told(&run_in(&here, &["check", "visor.toml", "--json", "--no-devices"])).0;
    let lines: Vec<serde_json::Value> =
        json.lines().map(|l| serde_json::from_str(l).expect("JSON")).collect();
    assert_eq!(lines.len(), 10, "{json}");
}

#[test]
fn check_looks_into_scenes_snapshots_and_keys() {
    let here = folder("scenes");
    let write = |name: &str, text: &str| std::fs::write(here.join(name), text).expect("a file");
    let visor = r#"scenes = ["day.toml", "night.toml", "noon.toml", "dusk.toml"]
[camera]
source = "synthetic"
[display]
sink = "null"
[snapshot]
dir = "day.toml/kept"
[keys]
device = "/dev/input/no-such-keys"
codes = [30, 30]
"#;
    write("visor.toml", visor);
    write("day.toml", "[[model]]\nfile = \"teapot\"\nmarker = { id = 7 }\n");
    let night = "[camera]\n[style]\nname = \"sketchi\"\n\n[[model]]\nfile = \"vase.obj\"\nmarker = {}\n\n\
                 [[model]]\nfile = \"spot\"\nmarker = { family = \"aruco_4x4_50\", id = 50 }\n";
    write("night.toml", night);
    write("dusk.toml", "[style]\nname = \"plain\"\n");
    let output = run_in(&here, &["check", "visor.toml"]);
    let (out, error) = told(&output);
    assert_eq!(output.status.code(), Some(2), "{error}");
    for (place, says) in [
        ("visor.toml:1: ", "noon.toml: No such file"),
        ("visor.toml:7: ", "snapshot.dir: day.toml is no folder; name a folder"),
        ("visor.toml:10: ", "keys.codes has 30 twice"),
        ("night.toml:1: ", "unknown field `camera`"),
        ("night.toml:3: ", "did you mean `sketchy`"),
        ("night.toml:5: ", "vase.obj"),
        ("night.toml:9: ", "ids 0 to 49"),
        ("dusk.toml: ", "no [[model]]"),
    ] {
        let told = out.lines().any(|line| line.starts_with(place) && line.contains(says));
        assert!(told, "{place}{says}\nin\n{out}");
    }
    assert_eq!(out.lines().count(), 8, "{out}");

    // the codes put right, the device is looked for; presses that would do nothing are told
    let visor = "[camera]\nsource = \"synthetic\"\n[[model]]\nfile = \"teapot\"\nmarker = {}\n[display]\nsink = \"null\"\n\
                 [keys]\ndevice = \"/dev/input/no-such-keys\"\ncodes = [30, 31]\n[[serial.button]]\nnumber = 1\n\
                 short = \"snapshot\"\nlong = \"scene-next\"\n";
    write("visor.toml", visor);
    let out = told(&run_in(&here, &["check", "visor.toml"])).0;
    for says in [
        "visor.toml:8: keys.device: /dev/input/no-such-keys is no device; there is",
        "visor.toml:11: button 1: snapshot does nothing without [snapshot]",
        "visor.toml:11: button 1: scene-next does nothing: list two",
    ] {
        assert!(out.contains(says), "{says}\nin\n{out}");
    }
    assert_eq!(out.lines().count(), 3, "{out}");

    // a folder that can be made, scenes that are sound
    let visor = "scenes = [\"day.toml\", \"dawn.toml\"]\n[camera]\nsource = \"synthetic\"\n[display]\nsink = \"null\"\n\
                 [snapshot]\ndir = \"a/b\"\n";
    write("visor.toml", visor);
    write("dawn.toml", "[[model]]\nfile = \"spot\"\nmarker = {}\n");
    let output = run_in(&here, &["check", "visor.toml"]);
    assert_eq!(output.status.code(), Some(0), "{:?}", told(&output));
    assert!(!here.join("a").exists(), "check makes nothing");
}

#[test]
fn check_is_content_with_what_runs() {
    let here = folder("sound");
    let text = "[camera]\nsource = \"synthetic\"\n[[model]]\nfile = \"teapot\"\nmarker = {}\n[display]\nsink = \"null\"\n";
    std::fs::write(here.join("visor.toml"), text).expect("a file");
    let output = run_in(&here, &["check", "visor.toml"]);
    assert_eq!(output.status.code(), Some(0), "{:?}", told(&output));
    assert!(told(&output).0.contains("nothing is wrong; 1 models, style cartoon"));
    for board in ["laptop", "rpi4", "rpi5", "virtual"] {
        let path = format!("{}/board/{board}.toml", env!("CARGO_MANIFEST_DIR"));
        let output = vernissage(&["check", "--no-devices", &path]);
        assert_eq!(output.status.code(), Some(0), "{board}: {:?}", told(&output));
    }
    let output = vernissage(&["check", "nowhere.toml"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(told(&output).0.contains("nowhere.toml: cannot read settings"));
}

#[test]
fn check_never_panics_on_damaged_files() {
    let here = folder("damaged");
    let whole = include_str!("../board/rpi4.toml");
    let mut rng = vernissage::pixels::SplitMix64::new(3);
    for round in 0..40 {
        let mut bytes = whole.as_bytes().to_vec();
        for _ in 0..rng.int(1, 8) {
            if bytes.is_empty() {
                break;
            }
            let at = rng.int(0, bytes.len() as i64 - 1) as usize;
            match rng.int(0, 2) {
                0 => bytes[at] = b"[]{}=\"'#\n,.x\xff"[rng.int(0, 12) as usize],
                1 => bytes.truncate(at + 1),
                _ => drop(bytes.drain(at..(at + 9).min(bytes.len()))),
            }
        }
        let path = here.join("visor.toml");
        std::fs::write(&path, &bytes).expect("a file");
        let output = vernissage(&["check", "--no-devices", path.to_str().expect("plain path")]);
        let (out, _) = told(&output);
        assert!(matches!(output.status.code(), Some(0 | 2)), "round {round}: {out}");
        assert_eq!(
            out.lines().any(|line| line.contains("nothing is wrong")),
            output.status.success(),
            "{out}"
        );
    }
}

#[test]
fn probe_works_whatever_is_attached() {
    let output = vernissage(&["probe"]);
    let (out, error) = told(&output);
    assert!(output.status.success(), "{error}");
    for word in ["processor", "cores", "cameras", "screens", "serial ports"] {
        assert!(out.contains(word), "{word} in {out}");
    }
    let json = told(&vernissage(&["probe", "--json"])).0;
    let facts: serde_json::Value = serde_json::from_str(&json).expect("one JSON object");
    assert!(facts["cores"].as_u64().expect("cores") >= 1 && facts["simd"].is_string());
    for list in ["cameras", "screens", "serial_ports", "thermal"] {
        assert!(facts[list].is_array(), "{list} in {json}");
    }
}

#[test]
fn doctor_tells_what_is_wrong_with_this_machine_or_file() {
    let here = folder("doctor");
    let sound = "[camera]\nsource = \"synthetic\"\n[[model]]\nfile = \"teapot\"\nmarker = {}\n[display]\nsink = \"null\"\n";
    std::fs::write(here.join("sound.toml"), sound).expect("a file");
    let output = run_in(&here, &["doctor", "sound.toml"]);
    let (out, error) = told(&output);
    assert_eq!(output.status.code(), Some(0), "neither camera nor screen are wanted: {out}{error}");
    std::fs::write(
        here.join("wrong.toml"),
        sound.replace("teapot", "vase.obj") + "[serial]\nport = \"/dev/no-such\"\n",
    )
    .expect("a file");
    let output = run_in(&here, &["doctor", "wrong.toml", "--json"]);
    let (out, error) = told(&output);
    assert_eq!(output.status.code(), Some(1), "{out}{error}");
    assert!(error.contains("2 things keep the visor from running"), "{error}");
    let findings: Vec<serde_json::Value> =
        out.lines().map(|l| serde_json::from_str(l).expect("JSON")).collect();
    let wrong: Vec<_> = findings.iter().filter(|f| f["weight"] == "wrong").collect();
    assert!(wrong[0]["evidence"].as_str().expect("where").starts_with("wrong.toml:3"), "{out}");
    assert!(wrong[1]["what"].as_str().expect("what").contains("serial port is not there"), "{out}");
    assert!(findings.iter().all(|f| f["what"].is_string() && f["evidence"].is_string()));
}

#[test]
fn shells_and_man_know_every_command() {
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let (out, error) = told(&vernissage(&["completions", shell]));
        for command in COMMANDS {
            assert!(out.contains(command), "{shell} knows {command}: {error}");
        }
    }
    let manual = told(&vernissage(&["manual"])).0;
    assert!(manual.contains(".TH vernissage 1"), "{}", &manual[..200]);
    for command in COMMANDS {
        assert!(manual.contains(&format!(".SH VERNISSAGE {}", command.to_uppercase())), "{command}");
    }
    for part in ["\\-\\-side\\-mm", "EXIT STATUS", "vernissage sheet \\-\\-board"] {
        assert!(manual.contains(part), "{part} in the manual");
    }
    assert_eq!(manual.matches("\n.TH").count() + usize::from(manual.starts_with(".TH")), 1, "one page");
    let help = told(&vernissage(&["--help"])).0;
    for command in COMMANDS {
        assert!(help.contains(&format!("  {command} ")), "--help names {command}");
    }
}
