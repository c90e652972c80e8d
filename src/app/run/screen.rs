//! A screen that comes back: a sink that is opened again when its card, cable or mastership left. Files and pipes are
//! not: what cannot be written ends the run.

use super::status::Words;
use super::tally::Tally;
use crate::app::fault::Fault;
use crate::display::{Config, DisplayError, Kind, Seen, Shown, Sink};
use crate::frame::now;
use crate::pixels::{Rgb, Size};
use std::sync::Arc;
use std::time::Duration;

/// The faults that a screen may have, one at a time.
const FAULTS: [Fault; 2] = [Fault::ScreenGone, Fault::ScreenOwned];
/// How often a screen that left is looked for: an attempt costs a probe of its cable.
const LOOK_EVERY: Duration = Duration::from_millis(250);
/// How often a screen that is there is asked whether its cable is.
const CHECK_EVERY: Duration = Duration::from_secs(1);

/// Where pictures go, whatever happens to it.
pub struct Screen {
    config: Config,
    canvas: Size,
    sink: Option<Sink>,
    /// Whether somebody closed the window.
    closed: bool,
    /// When to look next: for it, or after it.
    due: Duration,
    /// Lost flips of the sinks before this one.
    lost_flips: u64,
    tally: Arc<Tally>,
    words: Arc<Words>,
}

impl Screen {
    /// Opens the sink for pictures of `canvas`. With `wait` a screen that is not there is waited for.
    pub fn open(
        config: &Config,
        canvas: Size,
        wait: bool,
        tally: Arc<Tally>,
        words: Arc<Words>,
    ) -> Result<Self, DisplayError> {
        let mut screen = Self {
            config: config.clone(),
            canvas,
            sink: None,
            closed: false,
            due: Duration::ZERO,
            lost_flips: 0,
            tally,
            words,
        };
        match Sink::open(config, canvas) {
            Ok(sink) => screen.take(sink),
            Err(error) if wait && screen.may_return() => screen.lose(&error),
            Err(error) => return Err(error),
        }
        Ok(screen)
    }

    fn may_return(&self) -> bool {
        self.config.sink == Kind::Kms
    }

    fn take(&mut self, sink: Sink) {
        log::info!("display {sink}");
        self.words.set_display(sink.to_string());
        self.sink = Some(sink);
        self.due = now() + CHECK_EVERY;
        self.tally.faults.only(&FAULTS, None);
    }

    fn lose(&mut self, error: &DisplayError) {
        let fault = match error {
            DisplayError::Owned { .. } => Fault::ScreenOwned,
            _ => Fault::ScreenGone,
        };
        if !self.tally.faults.has(fault) {
            log::warn!("{}: display: {error}; looking for it", fault.code());
        }
        self.tally.faults.only(&FAULTS, Some(fault));
        self.words.set_display(String::new());
        if let Some(sink) = self.sink.take() {
            self.lost_flips += sink.lost_flips();
        }
        self.due = now() + LOOK_EVERY;
    }

    /// Shows a picture; `None` while there is no screen.
    pub fn present(&mut self, canvas: &Rgb) -> Result<Option<Shown>, DisplayError> {
        let time = now();
        if self.sink.is_none() {
            if self.closed || time < self.due {
                return Ok(None);
            }
            match Sink::open(&self.config, self.canvas) {
                Ok(sink) => {
                    self.take(sink);
                    self.tally.screens.add(1);
                }
                Err(error) => {
                    self.lose(&error);
                    return Ok(None);
                }
            }
        }
        let checks = time >= self.due;
        let Some(sink) = &mut self.sink else { return Ok(None) };
        let shown = match checks {
            true => sink.check().and_then(|()| sink.present(canvas)),
            false => sink.present(canvas),
        };
        self.tally.lost_flips.set(self.lost_flips + sink.lost_flips());
        if checks {
            self.due = time + CHECK_EVERY;
        }
        match shown {
            Ok(shown) => Ok(Some(shown)),
            Err(DisplayError::Closed) => {
                (self.sink, self.closed) = (None, true);
                Ok(None)
            }
            Err(error) if self.may_return() => {
                self.lose(&error);
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    /// Whether somebody closed the window: nothing is to be shown any more.
    pub fn closed(&mut self) -> bool {
        let closed = |sink: &Sink| matches!(sink.check(), Err(DisplayError::Closed));
        self.closed |= self.config.sink == Kind::Window && self.sink.as_ref().is_some_and(closed);
        self.closed
    }

    /// What is seen of the pictures.
    pub fn seen(&self) -> Seen {
        let mode = self.sink.as_ref().and_then(Sink::mode);
        mode.map_or(Seen::all(self.canvas), |mode| self.config.layout().seen(self.canvas, mode))
    }

    /// The pictures' size.
    pub fn size(&self) -> Size {
        self.canvas
    }

    /// The sink, while there is one.
    pub fn sink(&mut self) -> Option<&mut Sink> {
        self.sink.as_mut()
    }
}
