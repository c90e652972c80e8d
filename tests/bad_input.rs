//! Bad input gives one clear line that names the thing and what to do, and exit code 2; never a panic.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn vernissage(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_vernissage")).args(args).output().expect("the built binary runs")
}

/// A folder of this test's own.
fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::create_dir_all(&path).expect("a test folder");
    path
}

fn file(folder: &Path, name: &str, content: impl AsRef<[u8]>) -> String {
    let path = folder.join(name);
    std::fs::write(&path, content).expect("a test file");
    path.to_string_lossy().into_owned()
}

/// Exit code 2 and one line that holds all of `words`.
fn refuses(output: Output, words: &[&str]) {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(!text.contains("panicked"), "{text}");
    let errors: Vec<&str> = text.lines().filter(|l| !l.starts_with("vernissage: warn")).collect();
    assert_eq!(errors.len(), 1, "one line, not: {text}");
    for word in words {
        assert!(text.contains(word), "no {word:?} in: {text}");
    }
}

const PHOTO: &[u8] = include_bytes!("data/filters/micro_coffee_160x120.png");

#[test]
fn a_missing_picture() {
    let out = folder("missing");
    let out = out.join("x.png");
    refuses(
        vernissage(&["stylize", "--style", "cartoon", "nowhere.png", "--out", &out.to_string_lossy()]),
        &["nowhere.png"],
    );
}

#[test]
fn a_truncated_png() {
    let here = folder("truncated-png");
    let cut = file(&here, "cut.png", &PHOTO[..PHOTO.len() / 2]);
    let out = here.join("x.png");
    refuses(
        vernissage(&["stylize", "--style", "cartoon", &cut, "--out", &out.to_string_lossy()]),
        &["cut.png", "not a readable"],
    );
}

fn scene(folder: &Path, extra: &str) -> String {
    file(folder, "scene.toml", format!("[style]\nname = \"plain\"\n{extra}"))
}

#[test]
fn a_truncated_y4m() {
    let here = folder("truncated-y4m");
    let mut clip = b"YUV4MPEG2 W16 H8 F30:1 C444\nFRAME\n".to_vec();
    clip.extend([128; 16 * 8 * 3]);
    clip.extend(b"FRAME\n");
    clip.extend([128; 100]);
    let clip = file(&here, "cut.y4m", clip);
    let (config, out) = (scene(&here, ""), here.join("out"));
    refuses(
        vernissage(&["render", "--config", &config, "--input", &clip, "--out", &out.to_string_lossy()]),
        &["cut.y4m", "frame 1"],
    );
}

#[test]
fn a_wrong_key_in_the_scene_file() {
    let here = folder("wrong-key");
    let config = scene(&here, "[light]\nambiant = 1\n");
    refuses(
        vernissage(&["plan", "--config", &config]),
        &["scene.toml:4", "ambiant", "did you mean `ambient`"],
    );
    refuses(vernissage(&["run", "--config", "nowhere.toml"]), &["nowhere.toml"]);
}

#[test]
fn a_scene_with_a_missing_model_or_marker() {
    let here = folder("missing-model");
    let config = scene(&here, "[[model]]\nfile = \"vase.obj\"\nmarker = { id = 1 }\n");
    refuses(vernissage(&["plan", "--config", &config]), &["scene.toml:3", "vase.obj", "teapot"]);
    let config = scene(&here, "[[model]]\nfile = \"teapot\"\nmarker = { id = 9999 }\n");
    refuses(vernissage(&["plan", "--config", &config]), &["scene.toml:3", "9999", "0 to 586"]);
    let model = |side| format!("[[model]]\nfile = \"teapot\"\nmarker = {{ id = 1, side_mm = {side} }}\n");
    let config = scene(&here, &(model(80) + &model(90)));
    refuses(vernissage(&["plan", "--config", &config]), &["scene.toml:6", "90 mm", "80 mm"]);
}

#[test]
fn an_obj_with_bad_indices_is_drawn_without_its_bad_faces() {
    let here = folder("bad-obj");
    let camera = file(
        &here,
        "camera.json",
        r#"{"width":32,"height":24,"fx":30,"fy":30,"cx":15.5,"cy":11.5,"near":0.1,"far":100,
            "world_to_camera":[1,0,0,0, 0,1,0,0, 0,0,1,3, 0,0,0,1]}"#,
    );
    let model = file(&here, "bad.obj", "v -1 -1 0\nv 1 -1 0\nv 0 1 0\nf 1 2 99\nf 0 1 2\nf a b c\nf 1 3 2\n");
    let prefix = here.join("view");
    let output = vernissage(&[
        "draw",
        "--model",
        &model,
        "--camera",
        &camera,
        "--out",
        &prefix.to_string_lossy(),
        "--shading",
        "flat",
    ]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let depth = std::fs::read(here.join("view_depth.f32")).expect("depth was written");
    let covered = depth.chunks_exact(4).filter(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]).is_finite());
    assert!(covered.count() > 20, "the good face is drawn");
    refuses(
        vernissage(&[
            "draw",
            "--model",
            "nowhere.obj",
            "--camera",
            &camera,
            "--out",
            &prefix.to_string_lossy(),
        ]),
        &["nowhere.obj"],
    );
    let garbage = file(&here, "garbage.json", "{\"width\": 3");
    refuses(
        vernissage(&["draw", "--model", &model, "--camera", &garbage, "--out", &prefix.to_string_lossy()]),
        &["garbage.json"],
    );
}

#[test]
fn no_camera_and_no_display() {
    let here = folder("no-devices");
    let camera =
        "[camera]\nsource = \"v4l2\"\ndevice = \"/dev/no-such-camera\"\n[display]\nsink = \"null\"\n";
    refuses(vernissage(&["run", "--config", &scene(&here, camera)]), &["/dev/no-such-camera", "plug"]);
    let display =
        "[camera]\nsource = \"synthetic\"\n[display]\nsink = \"kms\"\ncard = \"/dev/dri/no-such-card\"\n";
    refuses(vernissage(&["run", "--config", &scene(&here, display)]), &["no-such-card", "display"]);
}

#[test]
fn bad_usage() {
    for args in [&["stylize"][..], &["stylize", "--style", "nonsense", "a.png", "--out", "b.png"], &["dance"]]
    {
        let output = vernissage(args);
        assert_eq!(output.status.code(), Some(2), "{args:?}");
    }
    let help = vernissage(&["--help"]);
    assert_eq!(help.status.code(), Some(0));
    let technician = ["sheet", "calibrate", "check", "probe", "doctor", "completions", "manual"];
    for command in
        ["demo", "run", "render", "stylize", "detect", "draw", "plan", "bench"].iter().chain(&technician)
    {
        assert!(String::from_utf8_lossy(&help.stdout).contains(command), "--help names {command}");
    }
}
