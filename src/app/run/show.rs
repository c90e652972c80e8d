//! The frame loop: the newest picture is drawn and shown, slates while none comes; between two frames presses are
//! acted on and new settings taken. Everything else happens on other threads.

use super::album::Album;
use super::screen::Screen;
use super::settings::{self, Cause, Fresh, Optics, Settings};
use super::tally::Tally;
use super::watch::{self, Captured};
use crate::app::Failed;
use crate::app::config::Config;
use crate::app::fault::Fault;
use crate::app::menu::Choices;
use crate::app::presses::{Presses, Reach};
use crate::app::service::Service;
use crate::camera::{RawRef, trace};
use crate::display::{self, Shown, Slate};
use crate::frame::{Frame, now};
use crate::pipeline::governor::Governor;
use crate::pipeline::{Pipeline, Reader, Stage, Timings};
use crate::pixels::{Rgb, Size};
use anyhow::Context;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How long the first picture may take; a longer pause is none between two pictures.
const FIRST: Duration = Duration::from_secs(1);
/// A slate is shown when no picture came for so many pictures' time, and no sooner than this after the last one was taken:
/// what remains of 300 ms is for drawing it. Then another one so often.
const MISSING: u32 = 3;
const SLATE_AFTER: Duration = Duration::from_millis(220);
const SLATE_EVERY: Duration = Duration::from_millis(250);
/// What is left of that for the next picture at least, however long the last one took to draw.
const LEAST: Duration = Duration::from_millis(150);

/// What the loop works with.
pub struct Show {
    pub pipeline: Box<Pipeline>,
    /// What the pipeline was made from.
    pub config: Arc<Config>,
    pub optics: Optics,
    pub screen: Screen,
    pub presses: Presses,
    /// Over the picture, while somebody chooses.
    pub menu: Choices,
    pub album: Album,
    /// None where nothing changes while it runs.
    pub settings: Option<Settings>,
    pub trace: Option<trace::Writer>,
    /// For cameras: a file that pauses shows its last picture.
    pub slate: Option<Slate>,
    pub service: Service,
    pub tally: Arc<Tally>,
    /// None without a budget.
    pub governor: Option<Governor>,
    /// Stop after so many.
    pub frames: Option<u64>,
}

impl Show {
    /// Runs until told to stop, the window is closed, the camera's thread ends, or nothing can be shown any more.
    pub fn run(&mut self, mut reader: Reader<Captured>, stop: &AtomicBool) -> anyhow::Result<()> {
        // when what is on the screen was captured
        let mut before: Option<Duration> = None;
        let mut last: Option<Duration> = None;
        let wished = Duration::from_secs_f64(1.0 / self.config.camera.fps);
        // how long after `from` a picture is late; a camera may take a while to its first
        let (mut from, mut patience) = (now(), FIRST);
        let frames = self.frames.unwrap_or(u64::MAX);
        while !stop.load(Ordering::Relaxed) && !self.screen.closed() && self.tally.shown.get() < frames {
            let waiting = Instant::now();
            let ended = reader.is_abandoned();
            let left = (from + patience).saturating_sub(now()).max(LEAST);
            let Some(captured) = reader.next(if ended { Duration::ZERO } else { left }) else {
                if ended {
                    break;
                }
                // presses wait: what they do is told with the frame that shows it
                (from, patience, before) = (now(), SLATE_EVERY, None);
                self.renew();
                self.starve()?;
                continue;
            };
            let waited = waiting.elapsed();
            self.between();
            let frame = &captured.frame;
            self.fit(frame.size());
            let mut timings = Timings::default();
            let drawn = self.draw(frame, &mut timings)?;
            timings.add(Stage::Camera, waited);
            if let Some(drawn) = drawn {
                let &Drawn { shown, markers, fresh, .. } = &drawn;
                // the flip's own time where the display tells it, one picture late; else when it was handed over
                if let (Some(before), Some(flipped)) = (before, shown.previous) {
                    self.tally.lasted(flipped.saturating_sub(before));
                } else if fresh && self.screen.sink().is_some_and(|sink| sink.mode().is_none()) {
                    self.tally.lasted(shown.at.saturating_sub(frame.captured_at));
                }
                self.tally.picture(frame.sequence, markers, &timings);
                self.service.shown();
                before = fresh.then_some(frame.captured_at);
                self.keep(&captured, &drawn)?;
                self.presses.shown(frame.sequence, &self.tally);
            } else {
                self.service.alive();
                before = None;
            }
            let since =
                last.map(|last| frame.captured_at.saturating_sub(last)).filter(|since| *since < FIRST);
            patience = (since.unwrap_or(wished).max(wished) * MISSING).max(SLATE_AFTER);
            (from, last) = (frame.captured_at, Some(frame.captured_at));
            drop(captured);
            self.tally.replaced.set(reader.replaced());
        }
        if let Some(trace) = self.trace.take() {
            trace.finish().context(Failed("cannot write the trace"))?;
        }
        Ok(())
    }

    /// Between two frames: presses, and what has become ready.
    fn between(&mut self) {
        self.renew();
        let Self { pipeline, settings, album, menu, tally, .. } = self;
        self.presses.act(Reach { pipeline, settings: settings.as_ref(), album, menu, tally });
        let style = self.pipeline.style();
        if style != self.tally.style() {
            self.governor.iter_mut().for_each(|governor| governor.forget(now()));
            self.tally.set_style(style);
        }
    }

    /// Takes what has become ready.
    fn renew(&mut self) {
        if let Some(fresh) = self.settings.as_ref().and_then(Settings::ready) {
            self.take(fresh);
        }
    }

    /// Another pipeline draws from now on.
    fn take(&mut self, fresh: Fresh) {
        let Fresh { mut pipeline, config, scene, cause } = fresh;
        let shown = self.pipeline.style();
        if cause == Cause::File {
            pipeline.begin_with(settings::front(self.config.style.name, config.style.name, shown));
        }
        let old = std::mem::replace(&mut self.pipeline, pipeline);
        if let Some(settings) = &self.settings {
            settings.retire(old);
        }
        self.presses.taken(&config, cause);
        self.menu.set_style(&config.style);
        // the new pipeline begins in full
        self.governor = config.governor.as_ref().map(Governor::new);
        self.tally.quality.set(0);
        self.config = config;
        self.tally.scene.set(scene as u64);
        self.tally.settings.add(1);
    }

    /// Pictures of another size come through another lens.
    fn fit(&mut self, size: Size) {
        if self.pipeline.lens().size != size {
            let (lens, warning) = self.optics.lens(&self.config, size);
            if let Some(warning) = warning {
                log::warn!("{warning}");
            }
            self.pipeline.set_lens(lens);
        }
    }

    /// Draws and shows one picture, or what stands still instead; `None` while there is no screen.
    fn draw(&mut self, frame: &Frame, timings: &mut Timings) -> anyhow::Result<Option<Drawn>> {
        let Self { pipeline, screen, presses, menu, album, governor, tally, .. } = self;
        let still = presses.stands_still(frame.size());
        let mut fades = false;
        let (canvas, markers): (&Rgb, usize) = if still {
            (presses.picture(), 0)
        } else {
            let drawn = pipeline.draw_frame(frame);
            *timings = drawn.timings;
            fades = drawn.plan.fade.runs;
            presses.drawn(drawn.canvas, drawn.sightings);
            (drawn.canvas, drawn.sightings.len())
        };
        let taken = album.picture(frame.sequence, canvas);
        let (seen, at) = (screen.seen(), now());
        let shown = timings.measure(Stage::Show, || screen.present(menu.over(canvas, seen, at)));
        let shown = shown.context(Failed("cannot show the picture"))?;
        if let Some(taken) = taken {
            presses.kept(taken);
        }
        // two styles at once cost what they cost, for a moment
        if let Some(governor) = governor.as_mut().filter(|_| !still && !fades) {
            govern(governor, pipeline, tally, timings.frame(), frame.captured_at);
        }
        Ok(shown.map(|shown| Drawn { shown, at, markers, fresh: !still }))
    }

    /// No picture came in time: a slate.
    fn starve(&mut self) -> anyhow::Result<()> {
        self.presses.starved(&self.tally);
        if self.presses.sleeps() {
            self.service.alive();
            return Ok(());
        }
        let Some(slate) = &mut self.slate else { return Ok(()) };
        let says = watch::FAULTS.into_iter().find(|&fault| self.tally.faults.has(fault));
        let says = says.and_then(Fault::says).or(Fault::CameraSilent.says()).unwrap_or_default();
        let shown = self.screen.present(slate.draw(&says)).context(Failed("cannot show the picture"))?;
        match shown {
            Some(_) => {
                self.service.shown();
                self.tally.slates.add(1);
            }
            None => self.service.alive(),
        }
        Ok(())
    }

    /// Adds the picture to the trace.
    fn keep(&mut self, captured: &Captured, drawn: &Drawn) -> anyhow::Result<()> {
        let Some(trace) = &mut self.trace else { return Ok(()) };
        let Some((format, bytes)) = &captured.raw else {
            anyhow::bail!("--trace: this source has no raw bytes to keep; trace a camera or a Y4M clip");
        };
        let frame = &captured.frame;
        let (layout, seen) = (self.config.display.layout(), self.screen.seen());
        let Some(sink) = self.screen.sink() else { return Ok(()) };
        let mode = sink.mode().unwrap_or(frame.size());
        // what the screen shows; without one, what a screen of the picture's size would show
        let canvas = if drawn.fresh { self.pipeline.canvas() } else { self.presses.picture() };
        let canvas = self.menu.over(canvas, seen, drawn.at);
        let hash = sink.scan_out_hash().unwrap_or_else(|| display::compose(canvas, mode, layout).hash());
        let entry = trace::Entry {
            sequence: frame.sequence,
            captured_at: frame.captured_at,
            shown_at: drawn.shown.at,
            shown_hash: hash,
            mode: [mode.width as u32, mode.height as u32],
        };
        trace.push(&entry, &RawRef { format: *format, bytes }).context(Failed("cannot write the trace"))
    }
}

/// Lets the governor see what a frame cost, and does what it says.
fn govern(governor: &mut Governor, pipeline: &mut Pipeline, tally: &Tally, cost: Duration, at: Duration) {
    let forms = pipeline.forms();
    if let Some(quality) = governor.observe(cost, forms, at) {
        pipeline.set_quality(quality);
        tally.quality.set(quality as u64);
        tally.quality_steps.add(1);
    }
    match governor.is_beaten(forms) {
        true => tally.faults.raise(Fault::Slow),
        false => tally.faults.clear(Fault::Slow),
    };
}

/// What came of one picture.
struct Drawn {
    shown: Shown,
    /// When it was given to the screen.
    at: Duration,
    markers: usize,
    /// Not one that stands still.
    fresh: bool,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::run::status::Words;
    use crate::display::Kind;
    use crate::pipeline::latest;
    use crate::pixels::{Plane, picture, simd};
    use crate::scene::Scene;
    use std::path::PathBuf;

    /// A camera that pauses: slates meanwhile, its pictures again afterwards.
    #[test]
    fn slates_are_shown_while_the_camera_is_silent() {
        let size = Size::new(160, 120);
        let folder = std::env::temp_dir().join(format!("vernissage-slates-{}", std::process::id()));
        let mut config = Config::default();
        config.style.name = crate::style::StyleName::Plain;
        (config.display.sink, config.display.path) = (Kind::Png, Some(folder.clone()));
        let (tally, words) = (Arc::<Tally>::default(), Arc::<Words>::default());
        tally.faults.raise(Fault::CameraGone);
        let optics = Optics { exact: None, size };
        let lens = optics.lens(&config, size).0;
        let pipeline = Pipeline::new(
            Scene::default(),
            lens,
            config.track.clone(),
            &config.style,
            simd::Level::fallback(),
        );
        let (mut writer, reader) = latest(Captured::default(), std::thread::current());
        let mut show = Show {
            pipeline: Box::new(pipeline),
            screen: Screen::open(&config.display, size, false, tally.clone(), words).expect("a folder"),
            presses: Presses::new(&config, Vec::new()).expect("no buttons"),
            menu: Choices::new(&config.style, Vec::new()),
            album: Album::open(None, size, tally.clone()).expect("no album"),
            config: Arc::new(config),
            optics,
            settings: None,
            trace: None,
            slate: Some(Slate::new(size)),
            service: Service::start().expect("nobody listens"),
            tally: tally.clone(),
            governor: None,
            frames: Some(4),
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
            show.run(reader, &AtomicBool::new(false)).expect("shown");
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
        assert_eq!((tally.shown.get(), tally.slates.get()), (4, slates.len() as u64 - 4));
        std::fs::remove_dir_all(&folder).expect("its own folder");
    }
}
