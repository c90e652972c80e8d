//! What presses do to the appliance: other styles, a picture that stands still, a dark screen.
//!
//! Asked between two frames; the frame that follows shows it, and its number is told to the board once it is on its
//! way to the screen.

use crate::buttons::{Action, Ask, Config, Markers, Mode, Outcome, Port, PortError, Status};
use crate::frame::Sighting;
use crate::pipeline::Pipeline;
use crate::pixels::{Rgb, Size};
use crate::style::{self, StyleName};
use clap::ValueEnum;
use std::time::{Duration, Instant};

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

/// The buttons, and what they have done.
pub struct Presses {
    port: Option<Port>,
    config: Config,
    style: style::Config,
    still: Still,
    /// The picture that stands still.
    picture: Rgb,
    done: Vec<Done>,
    /// Frames shown since then, for the rate.
    since: Instant,
    shown: u32,
    fps10: u32,
}

impl Presses {
    /// Begins to listen, where the settings name a port. `style`: what styles are asked for with.
    pub fn new(config: &Config, style: &style::Config) -> Result<Self, PortError> {
        let names = StyleName::value_variants().iter().map(|style| style.name()).collect();
        Ok(Self {
            port: Port::start(config, names)?,
            config: config.clone(),
            style: style.clone(),
            still: Still::No,
            picture: Rgb::default(),
            done: Vec::with_capacity(16),
            since: Instant::now(),
            shown: 0,
            fps10: 0,
        })
    }

    /// Does what was asked since the last frame. Never waits.
    pub fn act(&mut self, pipeline: &mut Pipeline) {
        let Some(port) = self.port.take() else { return };
        for ask in port.asked() {
            match ask {
                Ask::Press(button, kind) => {
                    let action = self.config.action(button, kind);
                    let outcome = action.map_or(Outcome::Ignored, |action| self.perform(action, pipeline));
                    self.done.push(Done { button, action, outcome });
                }
                Ask::Style(index) => {
                    if let Some(&name) = StyleName::value_variants().get(index) {
                        pipeline.switch(&style::Config { name, ..self.style.clone() });
                        self.still = Still::No;
                    }
                }
                Ask::Standby(on) => self.still = if on { Still::Dark } else { Still::No },
            }
        }
        self.port = Some(port);
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
        }
        Outcome::Ok
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

    /// A new picture was drawn: kept, if it is to stand still.
    pub fn drawn(&mut self, canvas: &Rgb) {
        if self.still == Still::Wanted {
            self.picture.copy_from(canvas);
            self.still = Still::Frozen;
        }
    }

    /// The picture numbered `sequence` is shown: tells the board what presses did, and how the visor is.
    pub fn shown(&mut self, sequence: u64, style: StyleName, sightings: &[Sighting]) {
        let Some(port) = &self.port else { return };
        for Done { button, action, outcome } in self.done.drain(..) {
            port.acted(button, action, outcome, sequence);
        }
        self.shown += 1;
        let past = self.since.elapsed();
        if past >= Duration::from_secs(1) {
            self.fps10 = (f64::from(self.shown) * 10.0 / past.as_secs_f64() + 0.5) as u32;
            (self.since, self.shown) = (Instant::now(), 0);
        }
        let quality = |margin: f32| (margin.clamp(0.0, 255.0) * (99.0 / 255.0)) as u8;
        let markers: Markers = sightings.iter().map(|s| (s.id, quality(s.margin))).collect();
        let mode = if self.still == Still::Dark { Mode::Standby } else { Mode::Run };
        port.tell(Status { mode, fps10: self.fps10, style: style.name(), faults: 0, markers });
    }

    /// No picture came for a while.
    pub fn starved(&mut self, style: StyleName) {
        if let Some(port) = &self.port {
            let mode = Mode::NoCamera;
            port.tell(Status { mode, fps10: 0, style: style.name(), faults: 1, markers: Markers::default() });
        }
    }
}
