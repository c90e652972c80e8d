//! Settings while it runs: a thread beside the frame loop reads the file again when it changes (or on SIGHUP), builds
//! what is to be shown aside, and hands it over whole. What cannot be used is said, and what runs stays.
//!
//! The frame loop asks for scenes and takes what is ready between two frames; it never waits and frees nothing large.

use super::kept::Kept;
use super::status::Words;
use super::tally::Tally;
use crate::app::config::{Config, Loaded};
use crate::app::fault::Fault;
use crate::app::one_line;
use crate::app::wishes::Wishes;
use crate::geometry::Lens;
use crate::pipeline::Pipeline;
use crate::pixels::{Size, simd};
use crate::style::StyleName;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, SystemTime};

/// How often the file is looked at; a change is taken once it rests that long.
const LOOK_EVERY: Duration = Duration::from_millis(250);

/// Why something new is to be shown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// The settings file changed.
    File,
    /// It was asked for.
    Scene,
}

/// Something new to show.
pub struct Fresh {
    /// Ready to draw; its styles have their buffers.
    pub pipeline: Box<Pipeline>,
    /// The settings it was made from.
    pub config: Arc<Config>,
    /// Which of the scenes it is.
    pub scene: usize,
    /// Why.
    pub cause: Cause,
}

/// What pictures are seen through.
#[derive(Clone, Debug)]
pub struct Optics {
    /// The lens, where the source knows it.
    pub exact: Option<Lens>,
    /// The pictures' size at the start.
    pub size: Size,
}

impl Optics {
    /// The lens for pictures of this size, and what was guessed.
    pub fn lens(&self, config: &Config, size: Size) -> (Lens, Option<String>) {
        match self.exact {
            Some(lens) if lens.size == size => (lens, None),
            _ => config.lens(size),
        }
    }

    /// A pipeline that draws `loaded`.
    pub fn pipeline(&self, loaded: &Loaded) -> Box<Pipeline> {
        let Loaded { config, scene } = loaded;
        let lens = self.lens(config, self.size).0;
        let pipeline = Pipeline::new(scene.clone(), lens, config.track.clone(), &config.style, simd::best());
        let pipeline = pipeline.retouched(&config.retouch);
        Box::new(if config.governor.is_some() { pipeline.governed() } else { pipeline })
    }
}

/// The frame loop's end of the thread.
pub struct Settings {
    asks: SyncSender<usize>,
    fresh: Receiver<Fresh>,
    old: SyncSender<Box<Pipeline>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

/// Shared with the rest of a run.
#[derive(Clone)]
pub struct Shared {
    /// What is counted.
    pub tally: Arc<Tally>,
    /// What is told.
    pub words: Arc<Words>,
    /// Set by SIGHUP.
    pub again: Arc<AtomicBool>,
    /// Where good settings are kept, if anywhere.
    pub kept: Option<Kept>,
}

impl Settings {
    /// Begins to look after the settings file, if there is one. `scenes`: what is meant now.
    pub fn start(
        wishes: &Wishes,
        scenes: Vec<(String, Loaded)>,
        optics: Optics,
        shared: Shared,
    ) -> std::io::Result<Self> {
        let (asks, asked) = sync_channel(8);
        let (ready, fresh) = sync_channel(1);
        let (old, retired) = sync_channel(4);
        let stop = Arc::<AtomicBool>::default();
        let stamps = stamps(wishes, &scenes);
        let began = scenes.first().map(|(_, loaded)| loaded.config.clone()).unwrap_or_default();
        let keeper = Keeper {
            wishes: wishes.clone(),
            began,
            scenes,
            optics,
            shared,
            shown: 0,
            stamps: (stamps.clone(), stamps),
            ready,
            stop: stop.clone(),
        };
        let keep = move || keeper.keep(asked, retired);
        let thread = Some(std::thread::Builder::new().name("settings".into()).spawn(keep)?);
        Ok(Self { asks, fresh, old, stop, thread })
    }

    /// Asks for the scene with this number; whether there is room for the wish.
    pub fn ask(&self, scene: usize) -> bool {
        let taken = self.asks.try_send(scene).is_ok();
        if let Some(thread) = &self.thread {
            thread.thread().unpark();
        }
        taken
    }

    /// What has become ready, if anything.
    pub fn ready(&self) -> Option<Fresh> {
        self.fresh.try_recv().ok()
    }

    /// Has a pipeline freed elsewhere.
    pub fn retire(&self, pipeline: Box<Pipeline>) {
        // a full queue: freed here, for once
        drop(self.old.try_send(pipeline));
    }
}

impl Drop for Settings {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        // what waits to be handed over must not hold the thread up
        let _ = self.fresh.try_recv();
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // a panic there has been reported
            let _ = thread.join();
        }
    }
}

/// When and how large a file was last.
type Stamp = Option<(SystemTime, u64)>;

fn stamps(wishes: &Wishes, scenes: &[(String, Loaded)]) -> Vec<Stamp> {
    let listed = scenes.first().map_or(&[][..], |(_, loaded)| &loaded.config.scenes);
    let stamp = |path: &Path| {
        let facts = std::fs::metadata(path).ok()?;
        Some((facts.modified().ok()?, facts.len()))
    };
    wishes.config.iter().chain(listed).map(|path| stamp(path)).collect()
}

/// The thread's end.
struct Keeper {
    wishes: Wishes,
    /// What was meant at the start.
    began: Config,
    scenes: Vec<(String, Loaded)>,
    optics: Optics,
    shared: Shared,
    shown: usize,
    /// The files' stamps when they were read, and at the last look.
    stamps: (Vec<Stamp>, Vec<Stamp>),
    ready: SyncSender<Fresh>,
    stop: Arc<AtomicBool>,
}

impl Keeper {
    fn keep(mut self, asked: Receiver<usize>, retired: Receiver<Box<Pipeline>>) {
        // a pool of its own: what is built here must not wait for the frame loop's workers, nor they for it
        let Ok(alone) = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build() else {
            log::error!("settings: cannot set the thread up");
            return;
        };
        alone.install(move || {
            self.keep_text();
            while !self.stop.load(Ordering::Relaxed) {
                if self.changed() {
                    self.read_again();
                }
                // of several wishes the last counts
                if let Some(scene) = asked.try_iter().last() {
                    self.shown = scene.min(self.scenes.len() - 1);
                    self.hand_over(Cause::Scene);
                }
                retired.try_iter().for_each(drop);
                std::thread::park_timeout(LOOK_EVERY);
            }
        });
    }

    /// Whether the files are others than those read, and at rest.
    fn changed(&mut self) -> bool {
        let told = self.shared.again.swap(false, Ordering::Relaxed);
        let now = stamps(&self.wishes, &self.scenes);
        let rests = now == self.stamps.1;
        self.stamps.1 = now;
        if told || (rests && self.stamps.1 != self.stamps.0) {
            self.stamps.0 = self.stamps.1.clone();
            return true;
        }
        false
    }

    fn read_again(&mut self) {
        let Shared { tally, words, .. } = &self.shared;
        let scenes = match self.wishes.scenes() {
            Ok(scenes) => scenes,
            Err(error) => {
                let why = one_line(&error);
                log::warn!("{}: settings stay as they were: {why}", Fault::Settings.code());
                words.set_refused(Some(why));
                tally.faults.raise(Fault::Settings);
                return;
            }
        };
        tally.faults.clear(Fault::Settings);
        words.set_refused(None);
        let now = scenes.first().map(|(_, loaded)| &loaded.config);
        let later = now.map_or(Vec::new(), |now| at_next_start(&self.began, now));
        if !later.is_empty() {
            log::warn!("settings: taken at the next start only: {}", later.join(", "));
        }
        words.set_restart(later);
        self.keep_text();
        // the list of scenes is told at the start, and stays; what they hold may change
        if self.scenes.iter().map(|s| &s.0).eq(scenes.iter().map(|s| &s.0)) {
            self.scenes = scenes;
            log::info!("settings: taken as they are now");
            self.hand_over(Cause::File);
        }
    }

    /// Keeps what stands in the settings file, if it can be used.
    fn keep_text(&self) {
        let (Some(kept), Some(path)) = (&self.shared.kept, &self.wishes.config) else { return };
        let Ok(text) = std::fs::read_to_string(path) else { return };
        // what cannot be used has been told; an empty file is none to start with again
        if !text.trim().is_empty()
            && Loaded::parse(&text, path).is_ok()
            && let Err(error) = kept.keep(&text)
        {
            log::warn!("settings: cannot be kept for the next start: {error}");
        }
    }

    /// Builds what is to be shown and waits until it is taken, or until the end.
    fn hand_over(&mut self, cause: Cause) {
        let (name, loaded) = &self.scenes[self.shown];
        log::debug!("settings: building {name}");
        let mut pipeline = self.optics.pipeline(loaded);
        pipeline.prepare(self.optics.size);
        let config = Arc::new(loaded.config.clone());
        let mut fresh = Fresh { pipeline, config, scene: self.shown, cause };
        while let Err(TrySendError::Full(back)) = self.ready.try_send(fresh) {
            if self.stop.load(Ordering::Relaxed) {
                return;
            }
            fresh = back;
            std::thread::park_timeout(Duration::from_millis(20));
        }
    }
}

/// What differs from the start and cannot change while it runs.
fn at_next_start(began: &Config, now: &Config) -> Vec<&'static str> {
    let table = [
        ("threads", began.threads() != now.threads()),
        ("camera", began.camera != now.camera),
        ("display", began.display != now.display),
        ("serial", began.serial != now.serial),
        ("keys", began.keys != now.keys),
        ("snapshot", began.snapshot != now.snapshot),
        ("scenes", began.scenes != now.scenes),
    ];
    table.into_iter().filter(|(_, differs)| *differs).map(|(name, _)| name).collect()
}

/// The style that the next pipeline begins with: the visitor's, unless the file now names another.
pub fn front(before: StyleName, after: StyleName, shown: StyleName) -> StyleName {
    if before == after { shown } else { after }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn what_cannot_change_is_named() {
        let config = |text: &str| Config::parse(text, Path::new("visor.toml")).expect("valid");
        let began = config("threads = 2\n");
        assert!(at_next_start(&began, &config("[style]\nname = \"plain\"\n")).is_empty());
        let now = config("threads = 1\nscenes = [\"a.toml\"]\n[camera]\nfps = 25\n[serial]\nbaud = 9600\n");
        assert_eq!(at_next_start(&began, &now), ["threads", "camera", "serial", "scenes"]);
    }

    #[test]
    fn a_visitors_style_stays_unless_the_file_names_another() {
        use StyleName::{Cartoon, Plain, Sketchy};
        assert_eq!(front(Cartoon, Cartoon, Sketchy), Sketchy);
        assert_eq!(front(Cartoon, Plain, Sketchy), Plain);
    }
}
