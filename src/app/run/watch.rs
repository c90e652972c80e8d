//! The camera's thread: every picture goes to the frame loop, newest first; a camera that falters is treated as
//! `ladder` says. Files play at their own rate.

use super::ladder::{Act, Cause, Heard, Ladder};
use super::status::Words;
use super::tally::{CameraState, Tally};
use crate::app::fault::Fault;
use crate::camera::{self, CameraError, Grab, RawFormat, Source};
use crate::frame::{Frame, now};
use crate::pipeline::Writer;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// The faults that the camera may have, one at a time.
pub const FAULTS: [Fault; 3] = [Fault::CameraGone, Fault::CameraSilent, Fault::CameraBusy];
/// Nothing waits longer than this for one thing: a stop is noticed.
const NAP: Duration = Duration::from_millis(100);
/// How long a file may take for a picture.
const PATIENCE: Duration = Duration::from_secs(1);

/// A camera picture with what a trace wants of it.
#[derive(Clone, Default)]
pub struct Captured {
    /// The picture.
    pub frame: Frame,
    /// Kept only for a trace.
    pub raw: Option<(RawFormat, Vec<u8>)>,
}

/// What the thread needs.
pub struct Watch {
    /// How to open the camera again.
    pub settings: camera::Config,
    /// Whether raw bytes go along.
    pub keep_raw: bool,
    /// Where pictures go.
    pub writer: Writer<Captured>,
    /// What is counted.
    pub tally: Arc<Tally>,
    /// What is told.
    pub words: Arc<Words>,
    /// Set to end it.
    pub stop: Arc<AtomicBool>,
}

/// Running numbers that go on where a stream is started again and counts from 0.
#[derive(Clone, Copy, Debug, Default)]
struct Numbering {
    last: Option<u64>,
    shift: u64,
    anew: bool,
}

impl Numbering {
    fn number(&mut self, sequence: u64) -> u64 {
        if std::mem::take(&mut self.anew) {
            self.shift = self.last.map_or(0, |last| (last + 1).saturating_sub(sequence));
        }
        let number = sequence.saturating_add(self.shift);
        self.last = Some(number);
        number
    }
}

impl Watch {
    /// Runs until it is told to stop, the frame loop is gone, or a file ends or fails.
    /// Without a source it begins by opening one.
    pub fn run(mut self, mut source: Option<Source>) -> Result<(), CameraError> {
        if let Some(source) = &mut source {
            source.keep_raw(self.keep_raw);
        }
        // a pool of its own: conversions on this thread must not wake the pipeline's workers
        let Ok(alone) = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build() else {
            log::error!("camera: cannot set its thread up");
            return Ok(());
        };
        alone.install(move || match source {
            Some(file) if !file.is_live() => self.play(file),
            camera => {
                self.watch(camera);
                Ok(())
            }
        })
    }

    fn ends(&self) -> bool {
        self.stop.load(Ordering::Relaxed) || self.writer.is_abandoned()
    }

    /// A file has no clock of its own: it plays at its frame rate, from now on.
    fn play(&mut self, mut source: Source) -> Result<(), CameraError> {
        let (started, mut first) = (now(), None);
        self.tally.eye.set_state(CameraState::Run);
        while !self.ends() {
            let grabbed = {
                let mut buffer = self.writer.buffer();
                let grabbed = source.next(&mut buffer.frame, PATIENCE)?;
                if grabbed == Grab::Frame {
                    let first = *first.get_or_insert(buffer.frame.captured_at);
                    let due = started + buffer.frame.captured_at.saturating_sub(first);
                    wait_until(due, &self.stop);
                    buffer.frame.captured_at = now();
                    keep_raw(&source, &mut buffer);
                }
                grabbed
            };
            self.tally.eye.count(&source.stats());
            match grabbed {
                Grab::Frame => self.writer.publish(),
                Grab::End => return Ok(()),
                Grab::Timeout => log::warn!("{source}: no picture for {PATIENCE:?}"),
            }
        }
        Ok(())
    }

    /// A camera, for ever.
    fn watch(&mut self, mut source: Option<Source>) {
        let mut ladder = Ladder::new(self.interval(source.as_ref()), now());
        let mut numbering = Numbering::default();
        let (mut said, mut away) = (None, source.is_none().then(now));
        let begun = if source.is_some() { Heard::Started } else { Heard::Failed(Cause::Gone) };
        let mut act = ladder.next(begun, now());
        while !self.ends() {
            let heard = match act {
                Act::Grab(time) => match &mut source {
                    Some(camera) => self.grab(camera, time, &mut numbering),
                    None => Heard::Failed(Cause::Gone),
                },
                Act::Restart => {
                    log::warn!(
                        "{}: camera: no picture; starting its stream again",
                        Fault::CameraSilent.code()
                    );
                    self.tally.eye.restarted.add(1);
                    numbering.anew = true;
                    match source.as_mut().map(Source::restart) {
                        Some(Ok(())) => Heard::Started,
                        Some(Err(error)) => self.failed(&error),
                        None => Heard::Failed(Cause::Gone),
                    }
                }
                Act::Open => {
                    // the driver frees a lost device only when every descriptor on it is closed
                    source = None;
                    self.tally.eye.anew();
                    numbering.anew = true;
                    match Source::open(&self.settings) {
                        Ok(mut camera) => {
                            camera.keep_raw(self.keep_raw);
                            self.tally.eye.reopened.add(1);
                            ladder.set_interval(self.interval(Some(&camera)));
                            log::info!("camera {camera} is open again");
                            self.words.set_camera(camera.to_string());
                            (source, said) = (Some(camera), None);
                            Heard::Started
                        }
                        Err(error) => {
                            let text = error.to_string();
                            if said.as_ref() != Some(&text) {
                                log::warn!("camera: {text}");
                                said = Some(text);
                            }
                            self.failed(&error)
                        }
                    }
                }
                Act::Rest(time) => {
                    source = None;
                    wait_until(now() + time, &self.stop);
                    Heard::Rested
                }
            };
            match heard {
                Heard::Picture => {
                    if let Some(since) = away.take() {
                        log::info!("camera: pictures again after {:?}", now() - since);
                    }
                    self.tally.faults.only(&FAULTS, None);
                    self.tally.eye.set_state(CameraState::Run);
                }
                Heard::Silence => {
                    away.get_or_insert(now());
                    self.tally.faults.only(&FAULTS, Some(Fault::CameraSilent));
                    self.tally.eye.set_state(CameraState::Open);
                }
                Heard::Failed(_) => {
                    away.get_or_insert(now());
                }
                _ => {}
            }
            act = ladder.next(heard, now());
        }
    }

    /// From one picture to the next.
    fn interval(&self, source: Option<&Source>) -> Duration {
        let fps = source.and_then(Source::fps).unwrap_or(self.settings.fps).clamp(1.0, 1000.0);
        Duration::from_secs_f64(1.0 / fps)
    }

    fn grab(&mut self, source: &mut Source, time: Duration, numbering: &mut Numbering) -> Heard {
        let until = Instant::now() + time;
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let grabbed = {
                let mut buffer = self.writer.buffer();
                let grabbed = source.next(&mut buffer.frame, left.min(NAP));
                if matches!(grabbed, Ok(Grab::Frame)) {
                    buffer.frame.sequence = numbering.number(buffer.frame.sequence);
                    keep_raw(source, &mut buffer);
                }
                grabbed
            };
            self.tally.eye.count(&source.stats());
            match grabbed {
                Ok(Grab::Frame) => {
                    self.writer.publish();
                    return Heard::Picture;
                }
                Ok(_) if left > NAP && !self.ends() => {}
                Ok(_) => return Heard::Silence,
                Err(error) => {
                    log::warn!("{}: camera: {error}; opening it again", Fault::CameraGone.code());
                    return self.failed(&error);
                }
            }
        }
    }

    /// Raises the fault that an error is.
    fn failed(&self, error: &CameraError) -> Heard {
        let (cause, fault) = match error {
            CameraError::Busy { .. } => (Cause::Busy, Fault::CameraBusy),
            CameraError::NoCamera { .. } | CameraError::Lost { .. } => (Cause::Gone, Fault::CameraGone),
            CameraError::Changed { .. } => return Heard::Failed(Cause::Changed),
            _ => (Cause::Faulty, Fault::CameraGone),
        };
        self.tally.faults.only(&FAULTS, Some(fault));
        self.tally.eye.set_state(CameraState::Lost);
        Heard::Failed(cause)
    }
}

fn keep_raw(source: &Source, buffer: &mut Captured) {
    if let Some(raw) = source.raw() {
        let (format, bytes) = buffer.raw.get_or_insert_with(|| (raw.format, Vec::new()));
        *format = raw.format;
        bytes.clear();
        bytes.extend_from_slice(raw.bytes);
    }
}

/// Sleeps until `due` on the monotonic clock, but wakes early to stop.
fn wait_until(due: Duration, stop: &AtomicBool) {
    while let Some(left) = due.checked_sub(now()).filter(|left| !left.is_zero()) {
        if stop.load(Ordering::Relaxed) {
            return;
        }
        std::thread::park_timeout(left.min(NAP));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_go_on_over_streams() {
        let mut numbering = Numbering::default();
        assert_eq!([3, 4, 6].map(|n| numbering.number(n)), [3, 4, 6]);
        numbering.anew = true;
        assert_eq!([0, 1, 3].map(|n| numbering.number(n)), [7, 8, 10]);
        numbering.anew = true;
        assert_eq!([20, 21].map(|n| numbering.number(n)), [20, 21], "ahead already");
    }
}
