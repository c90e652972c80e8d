//! `vernissage run`: the appliance. A camera thread hands its newest picture to the pipeline, which draws and
//! shows it; a camera that leaves is opened again, and a slate is shown meanwhile.

use super::config::Loaded;
use super::fault::{Fault, Present};
use super::presses::Presses;
use super::report::ms;
use super::service::Service;
use super::wishes::Wishes;
use super::{Failed, pool, say};
use crate::camera::{self, CameraError, Grab, RawFormat, RawRef, Source, trace};
use crate::display::{self, Sink, Slate};
use crate::frame::{Frame, now};
use crate::pipeline::{Pipeline, Reader, Record, Stage, Timings, Writer, latest};
use crate::pixels::simd;
use anyhow::Context;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::{Duration, Instant};

/// The appliance: camera to screen, until it is stopped.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  vernissage run --config visor.toml\n  \
    vernissage run --model teapot --style cartoon        on every marker of `vernissage sheet`\n  \
    vernissage run --config visor.toml --frames 60 --trace trace.bin   then   vernissage render --trace trace.bin")]
pub struct Args {
    #[command(flatten)]
    wishes: Wishes,
    /// Stop after this many shown frames
    #[arg(long, value_name = "N")]
    frames: Option<u64>,
    /// Record every shown frame: sequence, times, raw camera bytes and what the screen showed
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    /// Print the closing figures as one JSON object
    #[arg(long)]
    json: bool,
}

/// A camera picture with what a trace wants of it.
#[derive(Clone, Default)]
struct Captured {
    frame: Frame,
    /// Kept only for a trace.
    raw: Option<(RawFormat, Vec<u8>)>,
}

/// A picture older than this is worth a word in the log.
const PATIENCE: Duration = Duration::from_secs(1);
/// A slate is shown when no picture came for so many pictures' time, and no sooner than this; then another one so often.
const MISSING: u32 = 3;
const SLATE_EVERY: Duration = Duration::from_millis(250);
/// How often the figures are logged.
const REPORT_EVERY: Duration = Duration::from_secs(10);

pub fn run(args: Args) -> anyhow::Result<()> {
    let Loaded { config, scene } = args.wishes.load()?;
    let source = Source::open(&config.camera)?;
    let size = source.size();
    let (lens, warning) = match source.lens() {
        Some(exact) => (exact, None),
        None => config.lens(size),
    };
    if let Some(warning) = warning {
        log::warn!("{warning}");
    }
    let sink = Sink::open(&config.display, size)?;
    log::info!("camera {source}, display {sink}, style {}", config.style.name);
    let pipeline = Pipeline::new(scene, lens, config.track.clone(), &config.style, simd::best())
        .retouched(&config.retouch);
    let presses =
        Presses::new(&config.serial, &config.style).context(Failed("cannot listen to the buttons"))?;
    let trace = args.trace.as_deref().map(trace::Writer::create).transpose()?;
    let service =
        Service::start().context(Failed("cannot start the thread that reports to the service manager"))?;
    // a file that pauses shows its last picture
    let slate = source.is_live().then(|| Slate::new(size));
    let fault = Arc::<Present>::default();

    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        signal_hook::flag::register(signal, stop.clone()).context(Failed("cannot watch for signals"))?;
    }
    pool(config.threads())?.install(|| {
        let (writer, reader) = latest(Captured::default(), std::thread::current());
        let camera = std::thread::Builder::new().name("camera".into());
        let (stopped, settings, keep_raw) = (stop.clone(), config.camera.clone(), args.trace.is_some());
        let camera_fault = fault.clone();
        let (running, ended) = channel::<()>();
        let camera = camera
            .spawn(move || {
                // gone with the thread, however it ends
                let _running = running;
                watch(source, &settings, keep_raw, writer, &camera_fault, &stopped)
            })
            .context(Failed("cannot start the camera's thread"))?;
        let interval = Duration::from_secs_f64(1.0 / config.camera.fps);
        let display = &config.display;
        let mut show =
            Show { pipeline, sink, presses, trace, slate, service, interval, display, args: &args };
        let shown = show.all(reader, &fault, &stop);
        stop.store(true, Ordering::Relaxed);
        // a camera is closed in order; a thread that hangs in a read (a pipe that nobody fills) ends with us
        if ended.recv_timeout(2 * PATIENCE) == Err(RecvTimeoutError::Timeout) {
            return shown;
        }
        // a panic there has been reported; what was shown decides
        shown.and(camera.join().unwrap_or(Ok(())).map_err(Into::into))
    })
}

/// The camera's thread: every picture goes to `writer`; a camera that left is opened again.
fn watch(
    mut source: Source,
    settings: &camera::Config,
    keep_raw: bool,
    mut writer: Writer<Captured>,
    fault: &Present,
    stop: &AtomicBool,
) -> Result<(), CameraError> {
    source.keep_raw(keep_raw);
    // a pool of its own: conversions on this thread must not wake the pipeline's workers
    let Ok(alone) = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build() else {
        log::error!("camera: cannot set its thread up");
        return Ok(());
    };
    let (started, mut first) = (now(), None);
    alone.install(move || {
        while !stop.load(Ordering::Relaxed) && !writer.is_abandoned() {
            let grabbed = {
                let mut buffer = writer.buffer();
                let grabbed = source.next(&mut buffer.frame, PATIENCE);
                if !source.is_live() && matches!(grabbed, Ok(Grab::Frame)) {
                    // a file has no clock of its own: it plays at its frame rate, from now on
                    let first = *first.get_or_insert(buffer.frame.captured_at);
                    let due = started + buffer.frame.captured_at.saturating_sub(first);
                    wait_until(due, stop);
                    buffer.frame.captured_at = now();
                }
                if let (Ok(Grab::Frame), Some(raw)) = (&grabbed, source.raw()) {
                    let (format, bytes) = buffer.raw.get_or_insert_with(|| (raw.format, Vec::new()));
                    *format = raw.format;
                    bytes.clear();
                    bytes.extend_from_slice(raw.bytes);
                }
                grabbed
            };
            match grabbed {
                Ok(Grab::Frame) => {
                    fault.set(None);
                    writer.publish();
                }
                Ok(Grab::End) => return Ok(()),
                Ok(Grab::Timeout) => {
                    fault.set(Some(Fault::CameraSilent));
                    log::warn!("{}: camera: no picture for {PATIENCE:?}", Fault::CameraSilent.code());
                }
                Err(error) if !source.is_live() => return Err(error),
                Err(error) => {
                    log::warn!("{}: camera: {error}; opening it again", Fault::CameraGone.code());
                    fault.set(Some(Fault::CameraGone));
                    // the driver frees a lost device only when every descriptor on it is closed
                    drop(source);
                    match reopen(settings, keep_raw, stop) {
                        Some(opened) => source = opened,
                        None => return Ok(()),
                    }
                }
            }
        }
        Ok(())
    })
}

/// Sleeps until `due` on the monotonic clock, but wakes early to stop.
fn wait_until(due: Duration, stop: &AtomicBool) {
    while let Some(left) = due.checked_sub(now()).filter(|left| !left.is_zero()) {
        if stop.load(Ordering::Relaxed) {
            return;
        }
        std::thread::park_timeout(left.min(Duration::from_millis(100)));
    }
}

/// Opens the camera again, however long it takes; `None` when told to stop.
fn reopen(settings: &camera::Config, keep_raw: bool, stop: &AtomicBool) -> Option<Source> {
    let mut wait = Duration::from_millis(50);
    let mut said = None;
    while !stop.load(Ordering::Relaxed) {
        match Source::open(settings) {
            Ok(mut source) => {
                source.keep_raw(keep_raw);
                log::info!("camera {source} is back");
                return Some(source);
            }
            Err(error) => tell_once(&mut said, &error),
        }
        std::thread::park_timeout(wait);
        wait = (wait * 2).min(Duration::from_secs(1));
    }
    None
}

fn tell_once(said: &mut Option<String>, error: &CameraError) {
    let text = error.to_string();
    if said.as_ref() != Some(&text) {
        log::warn!("camera: {text}");
        *said = Some(text);
    }
}

/// The pipeline's side of the loop.
struct Show<'a> {
    pipeline: Pipeline,
    sink: Sink,
    presses: Presses,
    trace: Option<trace::Writer>,
    /// For cameras.
    slate: Option<Slate>,
    service: Service,
    /// From one picture to the next, as wished.
    interval: Duration,
    display: &'a display::Config,
    args: &'a Args,
}

/// Figures of a run.
struct Figures {
    shown: u64,
    slates: u64,
    gaps: u64,
    backwards: u64,
    tracked: u64,
    stages: [Record; 5],
    latency: Record,
    last_sequence: Option<u64>,
}

impl Show<'_> {
    fn all(
        &mut self,
        mut reader: Reader<Captured>,
        fault: &Present,
        stop: &AtomicBool,
    ) -> anyhow::Result<()> {
        let mut figures = Figures {
            shown: 0,
            slates: 0,
            gaps: 0,
            backwards: 0,
            tracked: 0,
            stages: std::array::from_fn(|_| Record::new(4096)),
            latency: Record::new(4096),
            last_sequence: None,
        };
        let start = Instant::now();
        let mut reported = Instant::now();
        let mut captured_before = None;
        // a camera may take a while to its first picture
        let mut patience = PATIENCE;
        while !stop.load(Ordering::Relaxed) && self.args.frames.is_none_or(|n| figures.shown < n) {
            let waiting = Instant::now();
            let ended = reader.is_abandoned();
            let Some(captured) = reader.next(if ended { Duration::ZERO } else { patience }) else {
                if ended {
                    break;
                }
                self.presses.starved(self.pipeline.style());
                patience = SLATE_EVERY;
                if let Some(slate) = self.slate.as_mut().filter(|_| !self.presses.sleeps()) {
                    let says = fault.get().unwrap_or(Fault::CameraSilent).says();
                    self.sink.present(slate.draw(&says)).context(Failed("cannot show the picture"))?;
                    self.service.shown();
                    figures.slates += 1;
                }
                continue;
            };
            figures.stages[Stage::Camera as usize].push(waiting.elapsed());
            let frame = &captured.frame;
            self.presses.act(&mut self.pipeline);
            let style = self.pipeline.style();
            let mut timings = Timings::default();
            let (canvas, sightings) = if self.presses.stands_still(frame.size()) {
                (self.presses.picture(), &[][..])
            } else {
                let drawn = self.pipeline.draw_frame(frame);
                timings = drawn.timings;
                self.presses.drawn(drawn.canvas);
                (drawn.canvas, drawn.sightings)
            };
            let shown = timings.measure(Stage::Show, || self.sink.present(canvas));
            let shown = shown.context(Failed("cannot show the picture"))?;
            self.service.shown();
            // the flip's own time where the display tells it, one picture late; else when it was handed over
            if let (Some(before), Some(flipped)) = (captured_before, shown.previous) {
                figures.latency.push(flipped.saturating_sub(before));
            } else if self.sink.mode().is_none() {
                figures.latency.push(shown.at.saturating_sub(frame.captured_at));
            }
            let since = captured_before.map(|before| frame.captured_at.saturating_sub(before));
            let interval = since.filter(|since| *since < PATIENCE).unwrap_or(self.interval);
            patience = (interval.max(self.interval) * MISSING).max(SLATE_EVERY);
            captured_before = Some(frame.captured_at);
            figures.count(frame.sequence, !sightings.is_empty());
            for stage in Stage::ALL.into_iter().skip(1) {
                figures.stages[stage as usize].push(timings.of(stage));
            }
            if let Some(trace) = &mut self.trace {
                let Some((format, bytes)) = &captured.raw else {
                    anyhow::bail!(
                        "--trace: this source has no raw bytes to keep; trace a camera or a Y4M clip"
                    );
                };
                let mode = self.sink.mode().unwrap_or(frame.size());
                // what the screen shows; without one, what a screen of the picture's size would show
                let hash = self.sink.scan_out_hash().unwrap_or_else(|| {
                    display::compose(canvas, mode, self.display.scale, self.display.filter).hash()
                });
                let entry = trace::Entry {
                    sequence: frame.sequence,
                    captured_at: frame.captured_at,
                    shown_at: shown.at,
                    shown_hash: hash,
                    mode: [mode.width as u32, mode.height as u32],
                };
                trace
                    .push(&entry, &RawRef { format: *format, bytes })
                    .context(Failed("cannot write the trace"))?;
            }
            self.presses.shown(frame.sequence, style, sightings);
            if reported.elapsed() > REPORT_EVERY {
                drop(captured);
                log::info!("{}", figures.line(start.elapsed(), reader.replaced()));
                reported = Instant::now();
            }
        }
        if let Some(trace) = self.trace.take() {
            trace.finish().context(Failed("cannot write the trace"))?;
        }
        if self.args.json {
            say(figures.json(start.elapsed(), reader.replaced()))?;
        } else {
            say(figures.line(start.elapsed(), reader.replaced()))?;
        }
        Ok(())
    }
}

impl Figures {
    fn count(&mut self, sequence: u64, tracked: bool) {
        self.shown += 1;
        self.tracked += u64::from(tracked);
        if let Some(last) = self.last_sequence {
            self.gaps += sequence.saturating_sub(last + 1);
            self.backwards += u64::from(sequence <= last);
        }
        self.last_sequence = Some(sequence);
    }

    fn line(&self, elapsed: Duration, replaced: u64) -> String {
        let latency = (ms(self.latency.percentile(0.5)), ms(self.latency.percentile(0.99)));
        let mut line = format!(
            "{} shown ({:.1}/s), {} tracked, {} missing in the sequence ({replaced} replaced by newer), \
             {} out of order; capture to shown p50 {} ms, p99 {} ms;",
            self.shown,
            self.shown as f64 / elapsed.as_secs_f64().max(1e-9),
            self.tracked,
            self.gaps,
            self.backwards,
            latency.0,
            latency.1,
        );
        for stage in Stage::ALL {
            line += &format!(" {} {}", stage.name(), ms(self.stages[stage as usize].percentile(0.5)));
        }
        line + " ms"
    }

    fn json(&self, elapsed: Duration, replaced: u64) -> serde_json::Value {
        let in_ms = |d: Duration| d.as_secs_f64() * 1e3;
        let stages: serde_json::Map<_, _> = Stage::ALL
            .iter()
            .map(|&s| (s.name().to_string(), in_ms(self.stages[s as usize].percentile(0.5)).into()))
            .collect();
        serde_json::json!({
            "shown": self.shown, "seconds": elapsed.as_secs_f64(), "tracked": self.tracked,
            "slates": self.slates, "missing": self.gaps, "replaced": replaced, "out_of_order": self.backwards,
            "latency_ms": { "p50": in_ms(self.latency.percentile(0.5)), "p99": in_ms(self.latency.percentile(0.99)) },
            "stages_ms": stages,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Lens;
    use crate::pixels::{Plane, Rgb, Size, picture};
    use crate::scene::Scene;
    use crate::{style, track};

    /// A camera that pauses: slates meanwhile, its pictures again afterwards.
    #[test]
    fn slates_are_shown_while_the_camera_is_silent() {
        let size = Size::new(160, 120);
        let folder = std::env::temp_dir().join(format!("vernissage-slates-{}", std::process::id()));
        let path = Some(folder.clone());
        let display = display::Config { sink: display::Kind::Png, path, ..display::Config::default() };
        let style = style::Config::default();
        let track = track::Config::default();
        let pipeline =
            Pipeline::new(Scene::default(), Lens::guess(size), track, &style, simd::Level::fallback());
        let args = Args { wishes: Wishes::default(), frames: Some(4), trace: None, json: true };
        let (mut writer, reader) = latest(Captured::default(), std::thread::current());
        let (fault, stop) = (Present::default(), AtomicBool::new(false));
        fault.set(Some(Fault::CameraGone));
        let mut show = Show {
            pipeline,
            sink: Sink::open(&display, size).expect("a folder"),
            presses: Presses::new(&Default::default(), &style).expect("no buttons"),
            trace: None,
            slate: Some(Slate::new(size)),
            service: Service::start().expect("nobody listens"),
            interval: Duration::from_millis(33),
            display: &display,
            args: &args,
        };
        std::thread::scope(|scope| {
            scope.spawn(move || {
                for sequence in 0..4 {
                    // the pause itself is what is tested
                    std::thread::sleep(Duration::from_millis(if sequence == 2 { 900 } else { 100 }));
                    writer.buffer().frame = Frame {
                        sequence,
                        captured_at: now(),
                        luma: Plane::new(size, 90),
                        color: Rgb::new(size, [90; 3]),
                    };
                    writer.publish();
                }
            });
            show.all(reader, &fault, &stop).expect("shown");
        });
        let files = std::fs::read_dir(&folder).expect("pictures").flatten();
        let mut files: Vec<_> = files.map(|file| file.path()).collect();
        files.sort();
        let dark = |file: &PathBuf| picture::read(file).expect("a picture").at(1, 1)[0] < 40;
        let slates: Vec<bool> = files.iter().map(dark).collect();
        // a busy machine may show more slates, but between the second picture and the third there is one
        let pictures: Vec<usize> = (0..slates.len()).filter(|&k| !slates[k]).collect();
        assert_eq!(pictures.len(), 4, "{slates:?}");
        assert!(pictures[2] > pictures[1] + 1, "{slates:?}");
        std::fs::remove_dir_all(&folder).expect("its own folder");
    }
}
