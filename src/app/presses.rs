//! What presses do to the appliance: other styles and scenes, by steps or from a menu, a picture that stands still or is
//! kept, a dark screen.
//!
//! Asked between two frames; the frame that follows shows it, and its number is told to the board once it is on its
//! way to the screen. A scene is told when it is shown.

use super::config::Config as Visor;
use super::fault::Fault;
use super::menu::{Choice, Choices};
use super::run::album::Album;
use super::run::settings::{Cause, Settings};
use super::run::tally::Tally;
use crate::buttons::keys::Keys;
use crate::buttons::{Action, Ask, Config, Kind, Markers, Mode, Outcome, Port, Status};
use crate::frame::{Sighting, now};
use crate::pipeline::Pipeline;
use crate::pixels::{Rgb, Size};
use crate::style::{self, StyleName};
use clap::ValueEnum;
use std::time::{Duration, Instant};

/// How long a board may take to answer after the start before that is a fault.
const GREETING: Duration = Duration::from_secs(5);

/// What is shown instead of new pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Still {
    /// Nothing: pictures follow each other.
    No,
    /// The next picture is the last one for a while.
    Wanted,
    /// The last picture.
    Frozen,
    /// Darkness.
    Dark,
}

/// A press that was acted on, to be told with its frame's number.
#[derive(Clone, Copy)]
struct Done {
    button: u8,
    action: Option<Action>,
    outcome: Outcome,
}

/// What presses act on.
pub struct Reach<'a> {
    pub pipeline: &'a mut Pipeline,
    pub settings: Option<&'a Settings>,
    pub album: &'a mut Album,
    pub menu: &'a mut Choices,
    pub tally: &'a Tally,
}

/// The buttons, and what they have done.
pub struct Presses {
    port: Option<Port>,
    keys: Option<Keys>,
    /// What was asked, while it is done.
    asked: Vec<Ask>,
    config: Config,
    style: style::Config,
    scenes: usize,
    still: Still,
    /// The picture that stands still.
    picture: Rgb,
    done: Vec<Done>,
    /// Those whose scene is not shown yet.
    waiting: Vec<Done>,
    markers: Markers,
    began: Instant,
    /// Frames shown since then, for the rate.
    since: Instant,
    shown: u32,
    fps10: u32,
}

impl Presses {
    /// Begins to listen, where the settings name a port. `scenes`: the names that may be asked for.
    pub fn new(config: &Visor, scenes: Vec<String>) -> anyhow::Result<Self> {
        let names = StyleName::value_variants().iter().map(|style| style.name()).collect();
        let count = scenes.len();
        Ok(Self {
            port: Port::start(&config.serial, names, scenes, config.snapshot.is_some())?,
            keys: config.keys.as_ref().map(|keys| Keys::start(keys, config.serial.wanted())).transpose()?,
            asked: Vec::with_capacity(128),
            config: config.serial.clone(),
            style: config.style.clone(),
            scenes: count,
            still: Still::No,
            picture: Rgb::default(),
            done: Vec::with_capacity(16),
            waiting: Vec::with_capacity(16),
            markers: Markers::default(),
            began: Instant::now(),
            since: Instant::now(),
            shown: 0,
            fps10: 0,
        })
    }

    /// Does what was asked since the last frame. Never waits.
    pub fn act(&mut self, mut reach: Reach<'_>) {
        let mut asked = std::mem::take(&mut self.asked);
        asked.extend(self.port.iter().flat_map(Port::asked));
        asked.extend(self.keys.iter().flat_map(Keys::asked));
        for ask in asked.drain(..) {
            match ask {
                Ask::Press(button, kind) => self.press(button, kind, &mut reach),
                Ask::Style(index) => {
                    if let Some(&name) = StyleName::value_variants().get(index) {
                        self.show(name, reach.pipeline);
                    }
                }
                Ask::Standby(on) => self.still = if on { Still::Dark } else { Still::No },
                Ask::Scene(scene) => {
                    // a full queue is one of wishes that nobody has seen fulfilled: the next one counts
                    let _ = reach.settings.map(|settings| settings.ask(scene));
                }
                Ask::Shot => {
                    reach.album.want();
                }
            }
        }
        if self.sleeps() {
            reach.menu.close();
        }
        reach.tally.standby.set(u64::from(self.sleeps()));
        self.asked = asked;
    }

    fn press(&mut self, button: u8, kind: Kind, reach: &mut Reach<'_>) {
        let time = now();
        let choosing = self.config.chooses(button) && reach.menu.is_open(time);
        let kind = if choosing { kind } else { self.config.meant(button, kind) };
        let action = if choosing { Some(Action::Menu) } else { self.config.action(button, kind) };
        let mut done = Done { button, action, outcome: Outcome::Ignored };
        match action {
            Some(Action::Menu) if choosing => match reach.menu.pressed(kind, time) {
                Some(Choice::Scene(scene)) if scene != reach.tally.scene.get() as usize => {
                    return self.change(scene, done, reach);
                }
                Some(Choice::Style(style)) if style != reach.pipeline.style() => {
                    self.show(style, reach.pipeline);
                    done.outcome = Outcome::Ok;
                }
                _ => done.outcome = Outcome::Ok,
            },
            Some(Action::Menu) if !self.sleeps() => {
                reach.menu.open(time, reach.pipeline.style(), reach.tally.scene.get() as usize);
                done.outcome = Outcome::Ok;
            }
            Some(Action::SceneNext) if !self.sleeps() && self.scenes > 1 => {
                let next = (reach.tally.scene.get() as usize + 1 + self.waiting.len()) % self.scenes;
                return self.change(next, done, reach);
            }
            Some(Action::Snapshot) if !self.sleeps() && reach.album.want() => done.outcome = Outcome::Ok,
            Some(action) => done.outcome = self.perform(action, reach.pipeline),
            None => {}
        }
        self.done.push(done);
    }

    /// Another style, whatever stood still.
    fn show(&mut self, name: StyleName, pipeline: &mut Pipeline) {
        pipeline.switch(&style::Config { name, ..self.style.clone() });
        self.still = Still::No;
    }

    /// Asks for a scene; told when it is shown.
    fn change(&mut self, scene: usize, done: Done, reach: &Reach<'_>) {
        if reach.settings.is_some_and(|settings| settings.ask(scene)) && self.waiting.len() < 16 {
            self.waiting.push(done);
        } else {
            self.done.push(Done { outcome: Outcome::Error, ..done });
        }
    }

    fn perform(&mut self, action: Action, pipeline: &mut Pipeline) -> Outcome {
        // any press brings a dark screen back
        if self.sleeps() {
            self.still = Still::No;
            return if action == Action::Standby { Outcome::Ok } else { Outcome::Ignored };
        }
        match action {
            Action::StyleNext | Action::StylePrevious => {
                let before = pipeline.style();
                pipeline.step_style(if action == Action::StyleNext { 1 } else { -1 });
                if pipeline.style() == before {
                    return Outcome::Ignored; // a cycle of one, or none
                }
                self.still = Still::No;
            }
            Action::Freeze => self.still = if self.still == Still::No { Still::Wanted } else { Still::No },
            Action::Standby => self.still = Still::Dark,
            // one scene only, or nothing is ever kept
            Action::SceneNext | Action::Snapshot | Action::Menu => return Outcome::Ignored,
        }
        Outcome::Ok
    }

    /// New settings or another scene are shown from the next frame on.
    pub fn taken(&mut self, config: &Visor, cause: Cause) {
        self.style = config.style.clone();
        if cause == Cause::Scene {
            self.still = Still::No;
            self.done.extend(self.waiting.drain(..).map(|done| Done { outcome: Outcome::Ok, ..done }));
        }
    }

    /// Whether the picture that was to be kept could be copied.
    pub fn kept(&mut self, taken: bool) {
        if !taken {
            let shots = self.done.iter_mut().filter(|done| done.action == Some(Action::Snapshot));
            shots.for_each(|done| done.outcome = Outcome::Error);
        }
    }

    /// Whether the screen is dark because someone wished so.
    pub fn sleeps(&self) -> bool {
        self.still == Still::Dark
    }

    /// Whether [`Presses::picture`] is shown instead of a new picture of `size`.
    pub fn stands_still(&mut self, size: Size) -> bool {
        match self.still {
            Still::Frozen => self.picture.size() == size,
            Still::Dark => {
                self.picture.resize(size);
                self.picture.planes.iter_mut().for_each(|plane| plane.fill(0));
                true
            }
            Still::No | Still::Wanted => false,
        }
    }

    /// The picture that stands still.
    pub fn picture(&self) -> &Rgb {
        &self.picture
    }

    /// A new picture was drawn, with these markers in it: kept, if it is to stand still.
    pub fn drawn(&mut self, canvas: &Rgb, sightings: &[Sighting]) {
        let quality = |margin: f32| (margin.clamp(0.0, 255.0) * (99.0 / 255.0)) as u8;
        self.markers = sightings.iter().map(|s| (s.id, quality(s.margin))).collect();
        if self.still == Still::Wanted {
            self.picture.copy_from(canvas);
            self.still = Still::Frozen;
        }
    }

    /// The picture numbered `sequence` is shown: tells the board what presses did, and how the visor is.
    pub fn shown(&mut self, sequence: u64, tally: &Tally) {
        let Some(port) = &self.port else { return self.done.clear() };
        for Done { button, action, outcome } in self.done.drain(..) {
            port.acted(button, action, outcome, sequence);
        }
        self.shown += 1;
        let past = self.since.elapsed();
        if past >= Duration::from_secs(1) {
            self.fps10 = (f64::from(self.shown) * 10.0 / past.as_secs_f64() + 0.5) as u32;
            (self.since, self.shown) = (Instant::now(), 0);
        }
        let markers = if self.still == Still::No { self.markers } else { Markers::default() };
        port.tell(Status { fps10: self.fps10, markers, ..status(tally) });
        match port.is_up() {
            true => {
                tally.faults.clear(Fault::ButtonsGone);
            }
            false if self.began.elapsed() > GREETING => {
                tally.faults.raise(Fault::ButtonsGone);
            }
            false => {}
        }
    }

    /// No picture came for a while.
    pub fn starved(&mut self, tally: &Tally) {
        if let Some(port) = &self.port {
            let Status { mode, faults, style, .. } = status(tally);
            // nothing is told to be wrong yet: the picture is only late
            let mode = if mode == Mode::Run || mode == Mode::Degraded { Mode::NoCamera } else { mode };
            let faults = faults | if mode == Mode::NoCamera && faults & 7 == 0 { 2 } else { 0 };
            port.tell(Status { mode, faults, style, ..Status::default() });
        }
    }
}

/// How the visor is, as far as counted.
fn status(tally: &Tally) -> Status {
    let mode = match super::run::mode(tally) {
        "standby" => Mode::Standby,
        "no-display" => Mode::NoDisplay,
        "no-camera" => Mode::NoCamera,
        "degraded" => Mode::Degraded,
        _ => Mode::Run,
    };
    Status { mode, style: tally.style().name(), faults: tally.faults.mask(), ..Status::default() }
}
