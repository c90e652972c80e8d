//! `stylize` on clips, and what every command does when its output cannot be taken.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn vernissage() -> Command {
    Command::new(env!("CARGO_BIN_EXE_vernissage"))
}

fn run(args: &[&str]) -> Output {
    vernissage().args(args).output().expect("the built binary runs")
}

fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&path);
    std::fs::create_dir_all(&path).expect("a test folder");
    path
}

/// A clip of `frames` frames, 32x24, 4:2:0.
fn clip(folder: &Path, frames: u8) -> String {
    let mut bytes = b"YUV4MPEG2 W32 H24 F25:1 Ip C420jpeg\n".to_vec();
    for frame in 0..frames {
        bytes.extend(b"FRAME\n");
        bytes.extend((0..32 * 24u32).map(|i| (i * 7) as u8 / 2 + 20 + frame));
        bytes.extend([128; 2 * 16 * 12]);
    }
    let path = folder.join("clip.y4m");
    std::fs::write(&path, bytes).expect("a test clip");
    path.to_string_lossy().into_owned()
}

#[test]
fn stylize_draws_every_frame_of_a_clip() {
    let here = folder("stylize-clip");
    let clip = clip(&here, 3);
    let out = here.join("out.y4m");
    let done = run(&["stylize", "--style", "cartoon", &clip, "--out", &out.to_string_lossy()]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let bytes = std::fs::read(&out).expect("a clip");
    assert!(bytes.starts_with(b"YUV4MPEG2 W32 H24 F25:1 Ip A1:1 C444"));
    let header = bytes.iter().position(|&b| b == b'\n').expect("a header line") + 1;
    assert_eq!(bytes.len() - header, 3 * (6 + 3 * 32 * 24));

    // the same through stdin and stdout
    let piped = vernissage()
        .args(["stylize", "--style", "cartoon", "-", "--out", "-"])
        .stdin(File::open(&clip).expect("the clip"))
        .output()
        .expect("the built binary runs");
    assert_eq!(piped.stdout, bytes);

    // and into a folder, whose pictures become a clip again
    let pictures = here.join("pictures");
    let done = run(&["stylize", "--style", "plain", &clip, "--out", &pictures.to_string_lossy()]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    assert_eq!(std::fs::read_dir(&pictures).expect("a folder").count(), 3);
    let again = run(&["stylize", "--style", "cartoon", &pictures.to_string_lossy(), "--out", "-"]);
    assert_eq!(again.stdout.len(), 3 * (6 + 3 * 32 * 24) + header);
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_output_is_a_failure_and_a_closed_one_is_none() {
    let here = folder("full-output");
    let clip = clip(&here, 1);
    let picture = here.join("p.ppm");
    std::fs::write(&picture, [b"P6\n8 8\n255\n".as_slice(), &[90; 192]].concat()).expect("a picture");
    let picture = picture.to_string_lossy().into_owned();
    let scene = here.join("scene.toml");
    std::fs::write(&scene, "[style]\nname = \"plain\"\n").expect("a scene");
    let scene = scene.to_string_lossy().into_owned();
    let cases: [&[&str]; 4] = [
        &["plan", "--config", &scene],
        &["stylize", "--style", "cartoon", &picture, "--repeat", "1", "--json"],
        &["stylize", "--style", "cartoon", &clip, "--out", "-"],
        &["render", "--config", &scene, "--input", &clip, "--out", "-"],
    ];
    for case in cases {
        let full = File::options().write(true).open("/dev/full").expect("/dev/full");
        let done = vernissage().args(case).stdout(full).output().expect("the built binary runs");
        let text = String::from_utf8_lossy(&done.stderr);
        assert_eq!(done.status.code(), Some(1), "{case:?}: {text}");
        assert_eq!(text.matches("No space left").count(), 1, "told once: {text}");
    }
    let done = run(&["stylize", "--style", "cartoon", &picture, "--out", "/dev/full"]);
    assert_eq!(done.status.code(), Some(1), "a picture that did not fit");

    let (reader, writer) = std::io::pipe().expect("a pipe");
    drop(reader);
    let done = vernissage().args(cases[0]).stdout(writer).output().expect("the built binary runs");
    assert_eq!((done.status.code(), done.stderr.as_slice()), (Some(0), b"".as_slice()));
}
