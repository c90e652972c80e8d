//! `vernissage render`: models on the markers of photographs, and clips in and out.

use std::path::{Path, PathBuf};
use std::process::Command;

/// A folder of this test's own, empty.
fn folder(name: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&path);
    std::fs::create_dir_all(&path).expect("a test folder");
    path
}

/// Runs `render --json` and gives its lines.
fn render(config: &Path, input: &Path, out: &Path) -> Vec<serde_json::Value> {
    let mut command = Command::new(env!("CARGO_BIN_EXE_vernissage"));
    command
        .args(["render", "--json", "--config"])
        .arg(config)
        .arg("--input")
        .arg(input)
        .arg("--out")
        .arg(out);
    let output = command.output().expect("the built binary runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let lines = String::from_utf8(output.stdout).expect("UTF-8");
    lines.lines().map(|l| serde_json::from_str(l).expect("one JSON object a line")).collect()
}

/// A teapot on every marker of both families of the photographs.
fn scene(folder: &Path) -> PathBuf {
    let model = |family| format!("[[model]]\nfile = \"teapot\"\nmarker = {{ family = \"{family}\" }}\n");
    let text = model("tag36h11") + &model("aruco_6x6_250") + "[style]\nname = \"plain\"\n";
    let path = folder.join("scene.toml");
    std::fs::write(&path, text).expect("a scene file");
    path
}

#[test]
fn every_known_marker_of_the_photographs_carries_a_model() {
    let Some(reference) = std::env::var_os("VERNISSAGE_REFERENCE") else {
        eprintln!("NOT RUN: the photographs; set VERNISSAGE_REFERENCE to the reference folder");
        return;
    };
    let photographs = Path::new(&reference).join("markers");
    let here = folder("photographs");
    let truth = std::fs::read_to_string(photographs.join("truth.jsonl")).expect("truth.jsonl");
    let truth: Vec<serde_json::Value> =
        truth.lines().map(|l| serde_json::from_str(l).expect("a truth line")).collect();
    let mut markers_seen = 0;
    for photo in &truth {
        let name = photo["image"].as_str().expect("a file name");
        let lines = render(&scene(&here), &photographs.join(name), &here.join(name));
        assert_eq!(lines.len(), 1);
        let found = lines[0]["markers"].as_array().expect("a list");
        let listed = photo["markers"].as_array().expect("a list");
        for marker in listed {
            let corners = points(&marker["corners"]);
            let on_it = |s: &&serde_json::Value| {
                s["id"] == marker["id"]
                    && s["posed"] == true
                    && distance(center(&points(&s["corners"])), center(&corners)) < 4.0
            };
            assert!(found.iter().any(|s| on_it(&s)), "{name}: no model on {marker}");
            markers_seen += 1;
        }
        assert!(lines[0]["models"].as_u64() >= Some(listed.len() as u64), "{name}: {lines:?}");
        if listed.is_empty() {
            assert!(found.is_empty(), "{name} shows no marker: {found:?}");
        }
        assert!(here.join(name).join("frame-000000.png").exists() || here.join(name).is_dir());
    }
    assert!(markers_seen >= 20, "only {markers_seen} markers listed");
}

fn points(corners: &serde_json::Value) -> Vec<[f64; 2]> {
    serde_json::from_value(corners.clone()).expect("corners")
}

fn center(points: &[[f64; 2]]) -> [f64; 2] {
    let sum = points.iter().fold([0.0; 2], |s, p| [s[0] + p[0], s[1] + p[1]]);
    sum.map(|v| v / points.len() as f64)
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    libm::hypot(a[0] - b[0], a[1] - b[1])
}

#[test]
fn a_clip_comes_out_as_a_clip_of_the_same_length() {
    let here = folder("clip");
    let mut clip = b"YUV4MPEG2 W33 H17 F25:1 C420jpeg\n".to_vec();
    for value in [40u8, 128, 220] {
        clip.extend(b"FRAME\n");
        clip.extend(vec![value; 33 * 17]);
        clip.extend(vec![128; 2 * 17 * 9]);
    }
    let input = here.join("in.y4m");
    std::fs::write(&input, clip).expect("a clip");
    let out = here.join("out.y4m");
    let lines = render(&scene(&here), &input, &out);
    assert_eq!(lines.len(), 3);
    assert!(lines.iter().all(|l| l["models"] == 0), "a flat picture shows no marker");
    let written = std::fs::read(&out).expect("the written clip");
    let header_end = written.iter().position(|&b| b == b'\n').expect("a header");
    let header = String::from_utf8_lossy(&written[..header_end]).into_owned();
    assert!(header.starts_with("YUV4MPEG2 W33 H17 F25:1") && header.contains("C444"), "{header}");
    assert_eq!(written.len() - header_end - 1, 3 * ("FRAME\n".len() + 3 * 33 * 17));
}
