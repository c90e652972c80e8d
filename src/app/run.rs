//! `vernissage run`: the appliance. A camera thread hands its newest picture to the frame loop, which draws and shows
//! it; what leaves is opened again, what changes is built aside.
//!
//! `watch` is the camera's thread and `ladder` what it does when the camera falters; `show` is the frame loop, `screen`
//! a display that comes back; `settings` reads the file again when it changes, `kept` has the last good ones, `refused`
//! says on the screen what is wrong with a file at the start; `album` keeps snapshots; `tally` is what all of them
//! count, `status` tells it.

pub(super) mod album;
mod figures;
mod kept;
mod ladder;
mod refused;
mod screen;
pub(super) mod settings;
mod show;
mod status;
pub(super) mod tally;
mod watch;

pub(super) use status::mode;

use super::config::Loaded;
use super::fault::Fault;
use super::menu::Choices;
use super::presses::Presses;
use super::service::Service;
use super::wishes::Wishes;
use super::{Failed, one_line, pool, say};
use crate::camera::{self, CameraError, Source, trace};
use crate::display::{self, Slate};
use crate::pipeline::governor::Governor;
use crate::pipeline::latest;
use crate::pixels::Size;
use album::Album;
use anyhow::Context;
use kept::Kept;
use screen::Screen;
use settings::{Optics, Settings, Shared};
use show::Show;
use status::{Files, Reporter, Words};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;
use tally::Tally;
use watch::{Captured, Watch};

/// The appliance: camera to screen, until it is stopped.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  vernissage run --config visor.toml\n  \
    vernissage run --model teapot --style cartoon        on every marker of `vernissage sheet`\n  \
    vernissage run --config visor.toml --frames 60 --trace trace.bin   then   vernissage render --trace trace.bin\n\n\
    The settings file is read again when it changes, and on SIGHUP. What is wrong with it is told with its line, and \
    what runs stays.")]
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
    /// Begin without a camera or a screen that is not there yet, and wait for it. Where the settings file cannot be used
    /// the screen says why; then begin with the last good one, where the service manager gives a state directory to keep
    /// it, or else when the file is right
    #[arg(long)]
    wait: bool,
    /// Write counters, faults and latency there every second, as JSON; default: status.json in the service manager's
    /// runtime directory, where there is one
    #[arg(long, value_name = "FILE")]
    status: Option<PathBuf>,
    /// The same for Prometheus, as its text format
    #[arg(long, value_name = "FILE")]
    metrics: Option<PathBuf>,
}

impl Args {
    fn files(&self) -> Files {
        let runtime = std::env::var_os("RUNTIME_DIRECTORY").filter(|folder| !folder.is_empty());
        let own = runtime.map(|folder| PathBuf::from(folder).join("status.json"));
        Files { status: self.status.clone().or(own), metrics: self.metrics.clone() }
    }
}

/// How long a camera that hangs in a read may take to close.
const CLOSE: Duration = Duration::from_secs(2);

pub fn run(args: Args) -> anyhow::Result<()> {
    let service =
        Service::start().context(Failed("cannot start the thread that reports to the service manager"))?;
    let (stop, again) = (Arc::<AtomicBool>::default(), Arc::<AtomicBool>::default());
    let kept = Kept::open();
    let (scenes, refused) = match scenes(&args, kept.as_ref()) {
        Ok(scenes) => scenes,
        Err(why) if args.wait && args.wishes.config.is_some() => {
            heed_signals(&stop, &again)?;
            match refused::wait(&args.wishes, why, args.files(), &service, &stop)? {
                Some(scenes) => (scenes, None),
                None => return Ok(()),
            }
        }
        Err(error) => return Err(error),
    };
    let (_, first) = scenes.first().context("no scene")?;
    let config = Arc::new(first.config.clone());
    let tally = Arc::<Tally>::default();
    let names: Vec<String> = scenes.iter().map(|(name, _)| name.clone()).collect();
    let words = Arc::new(Words::new(args.wishes.config.clone().unwrap_or_default(), names.clone()));

    if refused.is_some() {
        tally.faults.raise(Fault::Settings);
        words.set_refused(refused.clone());
    }
    let source = open_camera(&config.camera, args.wait, &tally)?;
    let live = source.as_ref().is_none_or(Source::is_live);
    let size = source.as_ref().map_or(Size::new(config.camera.width, config.camera.height), Source::size);
    let optics = Optics { exact: source.as_ref().and_then(Source::lens), size };
    if let Some(warning) = optics.lens(&config, size).1 {
        log::warn!("{warning}");
    }
    let mut screen = Screen::open(&config.display, size, args.wait, tally.clone(), words.clone())?;
    if let Some(source) = &source {
        log::info!("camera {source}, style {}", config.style.name);
        words.set_camera(source.to_string());
    }
    let pipeline = optics.pipeline(first);
    let menu = Choices::new(&config.style, names.clone());
    let presses = Presses::new(&config, names).context(Failed("cannot listen to the buttons"))?;
    let trace = args.trace.as_deref().map(trace::Writer::create).transpose()?;
    let album = Album::open(config.snapshot.as_ref(), size, tally.clone())
        .context(Failed("cannot start the thread that writes snapshots"))?;

    heed_signals(&stop, &again)?;
    if let Some(why) = refused.filter(|_| config.display.sink != display::Kind::Null) {
        refused::say(&why, &mut screen, &service, &tally, &stop)?;
    }
    let shared = Shared { tally: tally.clone(), words: words.clone(), again, kept };
    let settings = Settings::start(&args.wishes, scenes, optics.clone(), shared)
        .context(Failed("cannot start the thread that looks after the settings"))?;
    let reporter = Reporter::start(args.files(), tally.clone(), words.clone())
        .context(Failed("cannot start the thread that writes the status"))?;
    let threads = config.threads();
    let mut show = Show {
        pipeline,
        config: config.clone(),
        optics,
        screen,
        presses,
        menu,
        album,
        settings: Some(settings),
        trace,
        slate: live.then(|| Slate::new(size)),
        service,
        tally: tally.clone(),
        // a trace is drawn again without a clock: in full
        governor: config.governor.as_ref().filter(|_| args.trace.is_none()).map(Governor::new),
        frames: args.frames,
    };
    let done = pool(threads)?.install(|| {
        let (writer, reader) = latest(Captured::default(), std::thread::current());
        let watch = Watch {
            settings: config.camera.clone(),
            keep_raw: args.trace.is_some(),
            writer,
            tally: tally.clone(),
            words,
            stop: stop.clone(),
        };
        let (running, ended) = channel::<()>();
        let camera = std::thread::Builder::new().name("camera".into());
        let camera = camera
            .spawn(move || {
                // gone with the thread, however it ends
                let _running = running;
                watch.run(source)
            })
            .context(Failed("cannot start the camera's thread"))?;
        let shown = show.run(reader, &stop);
        stop.store(true, Ordering::Relaxed);
        // a camera is closed in order; a thread that hangs in a read (a pipe that nobody fills) ends with us
        if ended.recv_timeout(CLOSE) == Err(RecvTimeoutError::Timeout) {
            return shown;
        }
        // a panic there has been reported; what was shown decides
        shown.and(camera.join().unwrap_or(Ok(())).map_err(Into::into))
    });
    // the screen and all threads end before the figures are told
    drop(show);
    drop(reporter);
    done?;
    if args.json { say(figures::json(&tally)) } else { say(figures::line(&tally)) }
}

/// From now on signals are wishes. Not sooner than there is somebody to fulfil them: opening a pipe may wait for ever.
fn heed_signals(stop: &Arc<AtomicBool>, again: &Arc<AtomicBool>) -> anyhow::Result<()> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    for (signal, flag) in [(SIGTERM, stop), (SIGINT, stop), (SIGHUP, again)] {
        signal_hook::flag::register(signal, flag.clone()).context(Failed("cannot watch for signals"))?;
    }
    Ok(())
}

/// Scenes by name.
type Scenes = Vec<(String, Loaded)>;

/// The scenes that the settings mean, or those that were good last, and why. A file of no words is what file systems
/// leave of one that was written when the power went.
fn scenes(args: &Args, kept: Option<&Kept>) -> anyhow::Result<(Scenes, Option<String>)> {
    let emptied = |path: &PathBuf| {
        std::fs::read(path)
            .is_ok_and(|bytes| bytes.iter().all(|byte| byte.is_ascii_whitespace() || *byte == 0))
    };
    let error = match args.wishes.scenes() {
        _ if kept.is_some() && args.wait && args.wishes.config.as_ref().is_some_and(emptied) => {
            anyhow::anyhow!("the settings file is empty")
        }
        Ok(scenes) => return Ok((scenes, None)),
        Err(error) => error,
    };
    let last =
        kept.filter(|_| args.wait).and_then(Kept::text).and_then(|text| args.wishes.scenes_of(&text).ok());
    let Some(scenes) = last else { return Err(error) };
    let why = one_line(&error);
    log::warn!("{}: settings as they were last: {why}", Fault::Settings.code());
    Ok((scenes, Some(why)))
}

/// The camera; `None`: it is not there, and is to be waited for.
fn open_camera(settings: &camera::Config, wait: bool, tally: &Tally) -> Result<Option<Source>, CameraError> {
    match Source::open(settings) {
        Ok(source) => Ok(Some(source)),
        Err(error) if wait && settings.source == camera::Kind::V4l2 => {
            log::warn!("{}: camera: {error}", Fault::CameraGone.code());
            tally.faults.raise(Fault::CameraGone);
            tally.eye.set_state(tally::CameraState::Lost);
            Ok(None)
        }
        Err(error) => Err(error),
    }
}
