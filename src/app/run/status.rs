//! What a run tells whoever looks: `status.json` and a metrics file in Prometheus' text form, written once a second by
//! a thread of its own that also logs the figures. The frame loop only stores numbers (`tally`).
//!
//! Files are replaced whole (written beside, then renamed): a reader sees the old one or the new one. Keep them on a
//! memory file system, as `/run` is.

use super::tally::{CameraState, Tally};
use crate::app::fault::Fault;
use crate::app::report::VERSION;
use crate::camera::Stats;
use crate::pipeline::Stage;
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

const EVERY: Duration = Duration::from_secs(1);
/// How often the figures are logged.
const LOG_EVERY: Duration = Duration::from_secs(10);

/// Words that change rarely; never touched by the frame loop.
#[derive(Debug, Default)]
pub struct Words {
    camera: Mutex<String>,
    display: Mutex<String>,
    refused: Mutex<Option<String>>,
    restart: Mutex<Vec<&'static str>>,
    /// The settings file.
    pub file: PathBuf,
    /// The scenes' names.
    pub scenes: Vec<String>,
}

impl Words {
    /// Of this settings file and these scenes.
    pub fn new(file: PathBuf, scenes: Vec<String>) -> Self {
        Self { file, scenes, ..Self::default() }
    }

    /// Which camera is open.
    pub fn set_camera(&self, text: String) {
        *self.camera.lock().unwrap_or_else(PoisonError::into_inner) = text;
    }

    /// Which screen is open.
    pub fn set_display(&self, text: String) {
        *self.display.lock().unwrap_or_else(PoisonError::into_inner) = text;
    }

    /// Why the settings file is not used as it is now; `None`: it is.
    pub fn set_refused(&self, text: Option<String>) {
        *self.refused.lock().unwrap_or_else(PoisonError::into_inner) = text;
    }

    /// Tables that changed in the file and are read at the next start only.
    pub fn set_restart(&self, tables: Vec<&'static str>) {
        *self.restart.lock().unwrap_or_else(PoisonError::into_inner) = tables;
    }
}

/// How the visor is, in one word.
pub fn mode(tally: &Tally) -> &'static str {
    let faults = &tally.faults;
    let any = |list: &[Fault]| list.iter().any(|&fault| faults.has(fault));
    if tally.standby.get() > 0 {
        "standby"
    } else if any(&[Fault::ScreenGone, Fault::ScreenOwned]) {
        "no-display"
    } else if any(&[Fault::CameraGone, Fault::CameraSilent, Fault::CameraBusy]) {
        "no-camera"
    } else if faults.mask() != 0 || tally.quality.get() > 0 {
        "degraded"
    } else {
        "run"
    }
}

fn ms(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

/// The status file's contents; `fps`: pictures shown a second lately.
pub fn status(tally: &Tally, words: &Words, fps: f64) -> Value {
    let text = |slot: &Mutex<String>| slot.lock().unwrap_or_else(PoisonError::into_inner).clone();
    let [p50, p99] = tally.latency().percentiles([0.5, 0.99]).map(ms);
    let stages: serde_json::Map<_, _> = Stage::ALL
        .into_iter()
        .map(|stage| (stage.name().into(), ms(tally.stage(stage).percentiles([0.5])[0]).into()))
        .collect();
    let faults: Vec<Value> = Fault::ALL
        .into_iter()
        .filter(|&fault| tally.faults.count(fault) > 0)
        .map(|f| json!({ "code": f.code(), "now": tally.faults.has(f), "count": tally.faults.count(f) }))
        .collect();
    let Stats { received, delivered, missed, stale, damaged, short, undecodable, disordered } =
        tally.eye.stats();
    json!({
        "version": VERSION,
        "up_s": tally.started.elapsed().as_secs_f64(),
        "state": mode(tally),
        "style": tally.style().name(),
        "scene": words.scenes.get(tally.scene.get() as usize),
        "fps": (fps * 100.0).round() / 100.0,
        "tracked": tally.markers.get(),
        "quality": { "level": tally.quality.get(), "steps": tally.quality_steps.get() },
        "frames": {
            "shown": tally.shown.get(), "slates": tally.slates.get(), "tracked": tally.tracked.get(),
            "missing": tally.missing.get(), "replaced": tally.replaced.get(),
            "out_of_order": tally.backwards.get(),
        },
        "latency_ms": { "p50": p50, "p99": p99 },
        "stages_ms": stages,
        "camera": {
            "state": tally.eye.state().name(), "name": text(&words.camera),
            "received": received, "delivered": delivered, "missed": missed, "stale": stale,
            "damaged": damaged, "short": short, "undecodable": undecodable, "disordered": disordered,
            "restarted": tally.eye.restarted.get(), "reopened": tally.eye.reopened.get(),
        },
        "display": {
            "name": text(&words.display), "lost_flips": tally.lost_flips.get(), "reopened": tally.screens.get(),
        },
        "snapshots": tally.snapshots.get(),
        "faults": faults,
        "settings": {
            "file": words.file, "taken": tally.settings.get(),
            "refused": *words.refused.lock().unwrap_or_else(PoisonError::into_inner),
            "at_next_start": *words.restart.lock().unwrap_or_else(PoisonError::into_inner),
        },
    })
}

/// The same numbers in Prometheus' text exposition format 0.0.4.
pub fn metrics(tally: &Tally, fps: f64) -> String {
    let mut text = String::new();
    let mut one = |kind: &str, name: &str, help: &str, lines: &[(String, f64)]| {
        // a String takes everything
        let _ = writeln!(text, "# HELP vernissage_{name} {help}\n# TYPE vernissage_{name} {kind}");
        for (labels, value) in lines {
            let _ = writeln!(text, "vernissage_{name}{labels} {value}");
        }
    };
    let plain = |value: f64| vec![(String::new(), value)];
    let label = |key: &str, word: &str| format!("{{{key}=\"{word}\"}}");
    one("gauge", "up_seconds", "Time since the start.", &plain(tally.started.elapsed().as_secs_f64()));
    one("gauge", "fps", "Pictures shown a second.", &plain(fps));
    one("gauge", "markers", "Markers in the newest picture.", &plain(tally.markers.get() as f64));
    one("gauge", "quality_level", "How far the picture is simplified.", &plain(tally.quality.get() as f64));
    let counts = [
        ("shown", tally.shown.get()),
        ("slate", tally.slates.get()),
        ("tracked", tally.tracked.get()),
        ("missing", tally.missing.get()),
        ("replaced", tally.replaced.get()),
        ("out_of_order", tally.backwards.get()),
    ];
    let lines = counts.map(|(what, count)| (label("what", what), count as f64));
    one("counter", "frames_total", "Frames by what became of them.", &lines);
    let Stats { received, delivered, missed, stale, damaged, short, undecodable, disordered } =
        tally.eye.stats();
    let counts = [
        ("received", received),
        ("delivered", delivered),
        ("missed", missed),
        ("stale", stale),
        ("damaged", damaged),
        ("short", short),
        ("undecodable", undecodable),
        ("disordered", disordered),
        ("restarted", tally.eye.restarted.get()),
        ("reopened", tally.eye.reopened.get()),
    ];
    let lines = counts.map(|(what, count)| (label("what", what), count as f64));
    one("counter", "camera_total", "The camera's buffers by what became of them, and its streams.", &lines);
    let states = [CameraState::Open, CameraState::Run, CameraState::Lost];
    let lines = states.map(|s| (label("state", s.name()), f64::from(u8::from(tally.eye.state() == s))));
    one("gauge", "camera_state", "1 for the state that the camera is in.", &lines);
    let [p50, p99] = tally.latency().percentiles([0.5, 0.99]);
    let lines = [("0.5", p50), ("0.99", p99)].map(|(q, d)| (label("quantile", q), d.as_secs_f64()));
    one("gauge", "latency_seconds", "Camera's time stamp to screen, lately.", &lines);
    let lines = Stage::ALL
        .map(|stage| (label("stage", stage.name()), tally.stage(stage).percentiles([0.5])[0].as_secs_f64()));
    one("gauge", "stage_seconds", "Median time of each stage, lately.", &lines);
    let lines = Fault::ALL.map(|f| (label("code", f.code()), tally.faults.count(f) as f64));
    one("counter", "faults_total", "Faults by code, see board/FAULTS.md.", &lines);
    let lines = Fault::ALL.map(|f| (label("code", f.code()), f64::from(u8::from(tally.faults.has(f)))));
    one("gauge", "fault", "1 while the fault is there.", &lines);
    one("counter", "settings_total", "Settings taken.", &plain(tally.settings.get() as f64));
    text
}

/// Where to write to.
#[derive(Clone, Debug, Default)]
pub struct Files {
    /// The status file.
    pub status: Option<PathBuf>,
    /// The metrics file.
    pub metrics: Option<PathBuf>,
}

/// Writes the files until dropped, and a last time then.
pub struct Reporter {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Reporter {
    /// Begins to write and to log.
    pub fn start(files: Files, tally: Arc<Tally>, words: Arc<Words>) -> std::io::Result<Self> {
        let stop = Arc::<AtomicBool>::default();
        let stopped = stop.clone();
        let write = move || write(&files, &tally, &words, &stopped);
        let thread = Some(std::thread::Builder::new().name("status".into()).spawn(write)?);
        Ok(Self { stop, thread })
    }
}

impl Drop for Reporter {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // a panic there has been reported
            let _ = thread.join();
        }
    }
}

fn write(files: &Files, tally: &Tally, words: &Words, stop: &AtomicBool) {
    let (mut since, mut shown, mut fps) = (Instant::now(), tally.shown.get(), 0.0);
    let (mut said, mut logged, mut quality) = (None, Instant::now(), 0);
    loop {
        let last = stop.load(Ordering::Relaxed);
        let (now, count) = (Instant::now(), tally.shown.get());
        let past = (now - since).as_secs_f64();
        if past > 0.2 {
            fps = (count - shown) as f64 / past;
            (since, shown) = (now, count);
        }
        if now - logged > LOG_EVERY {
            log::info!("{}", super::figures::line(tally));
            logged = now;
        }
        if quality != tally.quality.get() {
            quality = tally.quality.get();
            log::info!("governor: {} is drawn {quality} levels simpler", tally.style());
        }
        let status = || format!("{:#}\n", status(tally, words, fps));
        let done = (files.status.as_deref().map_or(Ok(()), |path| replace(path, &status()))).and_then(|()| {
            files.metrics.as_deref().map_or(Ok(()), |path| replace(path, &metrics(tally, fps)))
        });
        match done {
            Ok(()) => said = None,
            Err(error) if said.as_ref() == Some(&error) => {}
            Err(error) => {
                log::warn!("{error}");
                said = Some(error);
            }
        }
        if last {
            return;
        }
        // `stop` is set before the wake-up: a park that misses it returns at once
        if !stop.load(Ordering::Relaxed) {
            std::thread::park_timeout(EVERY);
        }
    }
}

/// Puts `text` in place of the file, whole.
pub fn replace(path: &Path, text: &str) -> Result<(), String> {
    let mut beside = path.as_os_str().to_owned();
    beside.push(".new");
    let done = std::fs::write(&beside, text).and_then(|()| std::fs::rename(&beside, path));
    done.map_err(|error| format!("{}: cannot write: {error}; check the path", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::Timings;

    #[test]
    fn the_mode_is_the_worst_that_is_there() {
        let tally = Tally::default();
        assert_eq!(mode(&tally), "run");
        tally.quality.set(1);
        assert_eq!(mode(&tally), "degraded");
        tally.faults.raise(Fault::CameraSilent);
        assert_eq!(mode(&tally), "no-camera");
        tally.faults.raise(Fault::ScreenGone);
        assert_eq!(mode(&tally), "no-display");
        tally.standby.set(1);
        assert_eq!(mode(&tally), "standby");
    }

    #[test]
    fn every_metric_line_has_a_type_and_a_finite_number() {
        let tally = Tally::default();
        tally.picture(3, 1, &Timings::default());
        tally.lasted(Duration::from_millis(21));
        tally.faults.raise(Fault::CameraGone);
        let text = metrics(&tally, 29.97);
        let mut kinds = std::collections::HashSet::new();
        for line in text.lines() {
            if let Some(rest) = line.strip_prefix("# TYPE ") {
                let (name, kind) = rest.split_once(' ').expect("name and kind");
                assert!(["gauge", "counter"].contains(&kind) && kinds.insert(name.to_owned()), "{line}");
                assert_eq!(kind == "counter", name.ends_with("_total"), "{line}");
            } else if !line.starts_with("# HELP ") {
                let (name, value) = line.rsplit_once(' ').expect("name and value");
                assert!(value.parse::<f64>().expect("a number").is_finite(), "{line}");
                assert!(kinds.contains(name.split('{').next().expect("a name")), "{line}");
            }
        }
        for line in [
            "vernissage_frames_total{what=\"shown\"} 1",
            "vernissage_latency_seconds{quantile=\"0.99\"} 0.021",
            "vernissage_fault{code=\"C1\"} 1",
            "vernissage_fps 29.97",
        ] {
            assert!(text.lines().any(|l| l == line), "{line} in\n{text}");
        }
    }
}
