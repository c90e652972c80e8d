//! `vernissage detect` as it is typed: the output's form, and one clear line for each kind of bad job.

use std::path::PathBuf;
use std::process::{Command, Output};

fn detect(name: &str, job: &str, extra: &[&str]) -> Output {
    let path = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join(name);
    std::fs::write(&path, job).expect("temporary job file");
    let mut command = Command::new(env!("CARGO_BIN_EXE_vernissage"));
    command.current_dir(env!("CARGO_MANIFEST_DIR")).arg("detect").arg("--job").arg(path).args(extra);
    command.output().expect("the command starts")
}

const IMAGE: &str = "tests/data/markers/duckietown_240x216.png";

#[test]
fn a_job_gives_one_line_a_picture() {
    let job = format!(
        r#"{{"image":"{IMAGE}","family":"tag36h11","size":0.065,"camera":{{"w":240,"h":216,"fx":338.5,"fy":338.9,"cx":160.4,"cy":118.4,"dist":[0,0,0,0,0]}},"seq":null,"frame":null}}
{{"image":"{IMAGE}","family":"aruco_4x4_50","size":1,"camera":{{"w":240,"h":216,"fx":338.5,"fy":338.9,"cx":160.4,"cy":118.4,"dist":[-0.1,0,0,0,0]}},"seq":1,"frame":0}}
"#
    );
    let out = detect("good.jsonl", &job, &["--threads", "1", "--repeat", "3", "--mode", "detect"]);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let lines: Vec<serde_json::Value> = String::from_utf8(out.stdout)
        .expect("UTF-8")
        .lines()
        .map(|line| serde_json::from_str(line).expect("JSON"))
        .collect();
    assert_eq!(lines.len(), 2);
    assert_eq!(lines[0]["schema"], "markers/1");
    assert_eq!(lines[0]["image"], "duckietown_240x216.png");
    assert_eq!(lines[0]["ms"].as_array().map(Vec::len), Some(3));
    let seen = lines[0]["detections"].as_array().expect("detections");
    assert_eq!(seen.len(), 6);
    assert_eq!((&seen[0]["family"], &seen[0]["id"]), (&"tag36h11".into(), &22.into()));
    let z = seen[0]["pose"]["t"][2].as_f64().expect("t");
    assert!((0.5..3.0).contains(&z), "meters, as the size was: {z}");
    assert_eq!(seen[0]["pose"]["R"].as_array().map(Vec::len), Some(3));
    assert!(lines[1]["detections"].as_array().expect("detections").is_empty());
}

#[test]
fn bad_jobs_name_the_file_and_line() {
    let camera = r#"{"w":240,"h":216,"fx":300,"fy":300,"cx":120,"cy":108,"dist":[]}"#;
    let line = |image: &str, family: &str, size: &str, camera: &str| {
        format!("\n{{\"image\":\"{image}\",\"family\":\"{family}\",\"size\":{size},\"camera\":{camera}}}\n")
    };
    for (i, (job, word)) in [
        ("\n{not json\n".to_string(), "not a job"),
        (line(IMAGE, "tag25h8", "1", camera), "did you mean `tag25h9`"),
        (line(IMAGE, "tag36h11", "-2", camera), "size"),
        (line("no/such.pgm", "tag36h11", "1", camera), "no/such.pgm"),
        (line(IMAGE, "tag36h11", "1", &camera.replace("240", "640")), "640x216"),
        (line(IMAGE, "tag36h11", "1", &camera.replace("[]", "[1,2]")), "dist"),
        (line(IMAGE, "tag36h11", "1", &camera.replace("\"fx\":300", "\"fx\":0")), "fx"),
    ]
    .into_iter()
    .enumerate()
    {
        let name = format!("bad{i}.jsonl");
        let out = detect(&name, &job, &[]);
        let said = String::from_utf8_lossy(&out.stderr).into_owned();
        assert_eq!(out.status.code(), Some(2), "{said}");
        assert!(said.contains(&format!("{name}:2")) && said.contains(word), "{said}");
        assert_eq!(said.trim_end().lines().count(), 1, "{said}");
        assert!(out.stdout.is_empty());
    }
    let out = detect("fine.jsonl", "", &["--mode", "track", "--repeat", "2"]);
    assert_eq!(out.status.code(), Some(2));
}
