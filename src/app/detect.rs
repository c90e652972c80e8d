//! `vernissage detect`: markers in still pictures, one JSON line each, with times.
//!
//! A job line: `{"image", "family", "size", "camera": {"w","h","fx","fy","cx","cy","dist"}, "seq", "frame"}`; an
//! output line: `{"schema":"markers/1", "image", "ms", "detections"}`, times of the search alone, pictures in memory.

use super::{Failed, say};
use crate::frame::{Sighting, Solved, State};
use crate::geometry::Lens;
use crate::marker::Family;
use crate::pixels::{Plane, Size, picture, simd};
use crate::track::{self, Tracker, Wanted};
use anyhow::{Context, bail, ensure};
use glam::DVec2;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Finds markers in the pictures of a job file and prints one JSON line a picture.
///
/// A job line: {"image": "a.pgm", "family": "tag36h11", "size": 80, "camera": {"w": 640, "h": 480, "fx": 600,
/// "fy": 600, "cx": 319.5, "cy": 239.5, "dist": [k1, k2, p1, p2, k3]}, "seq": null, "frame": null}. Pose and
/// size share a unit. An output line: {"schema": "markers/1", "image", "ms", "detections": [{"family", "id",
/// "corners", "hamming", "score", "pose", "pose_alt"}]}; ms = one search, picture in memory.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  vernissage detect --job job.jsonl --threads 2 --repeat 20 > found.jsonl")]
pub struct Args {
    /// Job file: a JSON object a line with image, family, size and camera
    #[arg(long, value_name = "JOB.jsonl")]
    job: PathBuf,
    /// Worker threads, 1 to 64
    #[arg(long, default_value_t = 2, value_name = "N")]
    threads: usize,
    /// How often each picture is searched; every time is reported
    #[arg(long, default_value_t = 1, value_name = "K", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    repeat: u32,
    /// Every picture on its own, or sequences with what is known from the picture before
    #[arg(long, value_enum, default_value_t = Mode::Detect)]
    mode: Mode,
    /// Accepted for uniformity: the output is always JSON lines
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Mode {
    /// Every picture on its own
    Detect,
    /// Markers are followed within one `seq`, `frame` counted at 30 a second
    Track,
}

/// A line of the job file.
#[derive(Deserialize)]
struct Line {
    image: PathBuf,
    family: String,
    size: Option<f64>,
    camera: Option<Camera>,
    #[serde(rename = "seq")]
    sequence: Option<i64>,
    frame: Option<i64>,
}

#[derive(Deserialize)]
struct Camera {
    w: usize,
    h: usize,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    #[serde(default)]
    dist: Vec<f64>,
}

/// A picture ready to be searched.
struct Job {
    name: String,
    gray: Plane<u8>,
    lens: Lens,
    wanted: Wanted,
    sequence: Option<i64>,
    frame: Option<i64>,
}

/// A line of the output.
#[derive(Serialize)]
struct Report<'a> {
    schema: &'static str,
    image: &'a str,
    ms: &'a [f64],
    detections: Vec<Detection>,
}

#[derive(Serialize)]
struct Detection {
    family: Family,
    id: u32,
    corners: [[f64; 2]; 4],
    hamming: u32,
    score: f32,
    #[serde(skip_serializing_if = "Option::is_none")]
    pose: Option<Placed>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pose_alt: Option<Placed>,
}

/// A pose in the unit of the job's `size`.
#[derive(Serialize)]
struct Placed {
    #[serde(rename = "R")]
    rotation: [[f64; 3]; 3],
    #[serde(rename = "t")]
    translation: [f64; 3],
    err: f64,
}

pub fn run(args: Args) -> anyhow::Result<()> {
    if args.mode == Mode::Track {
        ensure!(args.repeat == 1, "--mode track searches each picture once: leave --repeat at 1");
    }
    let pool = super::pool(args.threads)?;
    let jobs = load(&args.job)?;
    pool.install(|| {
        let mut tracker = Tracker::new(track::Config::default(), simd::best());
        for job in jobs.iter().cycle().take(if jobs.is_empty() { 0 } else { 3 }) {
            tracker.find(job.gray.view(), &job.lens, std::slice::from_ref(&job.wanted));
        }
        tracker.forget();
        let mut ms = Vec::with_capacity(args.repeat as usize);
        let (mut last, mut number) = (None, 0);
        for job in &jobs {
            ms.clear();
            let mut detections = Vec::new();
            let sequence = job.sequence.filter(|_| args.mode == Mode::Track);
            number = if sequence == last { number + 1 } else { 0 };
            if sequence != last {
                tracker.forget();
            }
            last = sequence;
            let number = job.frame.and_then(|frame| u32::try_from(frame).ok()).unwrap_or(number);
            let at = Duration::from_secs(number.into()) / 30;
            for turn in 0..args.repeat {
                let start = Instant::now();
                let wanted = std::slice::from_ref(&job.wanted);
                let sightings = match sequence {
                    Some(_) => tracker.follow(job.gray.view(), &job.lens, wanted, at),
                    None => tracker.find(job.gray.view(), &job.lens, wanted),
                };
                ms.push(start.elapsed().as_secs_f64() * 1e3);
                if turn == 0 {
                    // what is out of sight is no detection
                    let seen = sightings.iter().filter(|sighting| sighting.state != State::Held);
                    detections.extend(seen.map(Detection::from));
                }
            }
            let report = Report { schema: "markers/1", image: &job.name, ms: &ms, detections };
            let line = serde_json::to_string(&report).context(Failed("cannot write the result"))?;
            say(line)?;
        }
        Ok(())
    })
}

/// Reads the job file and every picture it names.
fn load(path: &Path) -> anyhow::Result<Vec<Job>> {
    let text = std::fs::read_to_string(path)
        .with_context(|| format!("{}: cannot read the job file", path.display()))?;
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    lines.map(|(i, line)| job(path, line).with_context(|| format!("{}:{}", path.display(), i + 1))).collect()
}

fn job(path: &Path, line: &str) -> anyhow::Result<Job> {
    let line: Line = serde_json::from_str(line).context("not a job: give image, family, size and camera")?;
    let family = Family::from_name(&line.family)?;
    if let Some(size) = line.size {
        ensure!(size.is_finite() && size > 0.0, "size {size}: give the printed side, greater than 0");
    }
    // pictures lie where the path says, or beside the job file
    let beside = path.parent().map(|folder| folder.join(&line.image)).filter(|p| p.exists());
    let place = if line.image.exists() { line.image.clone() } else { beside.unwrap_or(line.image.clone()) };
    let gray = picture::read_gray(&place)?;
    let lens = match line.camera {
        Some(camera) => lens(&camera, gray.size())?,
        None => {
            log::warn!("{}: no camera given, guessing fx = fy = max(W, H)", line.image.display());
            Lens::guess(gray.size())
        }
    };
    let name = line.image.file_name().map_or(String::new(), |n| n.to_string_lossy().into_owned());
    // without a size there is no unit: no pose then
    let wanted = Wanted { family, id: None, side_mm: line.size.unwrap_or(f64::NAN) };
    Ok(Job { name, gray, lens, wanted, sequence: line.sequence, frame: line.frame })
}

fn lens(camera: &Camera, size: Size) -> anyhow::Result<Lens> {
    let given = Size::new(camera.w, camera.h);
    ensure!(given == size, "the camera is for {given} but the picture is {size}");
    if !matches!(camera.dist.len(), 0 | 4 | 5 | 8) {
        bail!("dist has {} numbers: give k1 k2 p1 p2 [k3 [k4 k5 k6]]", camera.dist.len());
    }
    let mut distortion = [0.0; 8];
    distortion[..camera.dist.len()].copy_from_slice(&camera.dist);
    let lens = Lens {
        size,
        focal: DVec2::new(camera.fx, camera.fy),
        center: DVec2::new(camera.cx, camera.cy),
        distortion,
    };
    let finite =
        lens.focal.is_finite() && lens.center.is_finite() && distortion.iter().all(|k| k.is_finite());
    ensure!(finite && lens.focal.min_element() > 0.0, "the camera needs finite numbers and fx, fy > 0");
    Ok(lens)
}

impl From<&Sighting> for Detection {
    fn from(sighting: &Sighting) -> Self {
        Self {
            family: sighting.family,
            id: sighting.id,
            corners: sighting.corners.map(|c| [c.x, c.y]),
            hamming: sighting.hamming,
            score: sighting.margin,
            pose: sighting.pose.as_ref().map(Placed::from),
            pose_alt: sighting.pose_alt.as_ref().map(Placed::from),
        }
    }
}

impl From<&Solved> for Placed {
    fn from(solved: &Solved) -> Self {
        let (r, t) = (solved.pose.rotation, solved.pose.translation);
        Self {
            rotation: [0, 1, 2].map(|row| [r.x_axis[row], r.y_axis[row], r.z_axis[row]]),
            translation: [t.x, t.y, t.z],
            err: solved.error_px,
        }
    }
}
