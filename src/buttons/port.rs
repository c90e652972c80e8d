//! The device: a thread that opens the serial port, opens it again when it left, and carries bytes between it and the
//! link. The frame loop never waits for it: what is asked comes through a queue, what is told goes through one, and
//! the status lies behind a lock that the loop only takes when it is free.

use super::codec::Outcome;
use super::link::{Ask, Link};
use super::status::Status;
use super::{Action, Config};
use serialport::SerialPort;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// How long a read waits: what is due is at most this late.
const WAIT: Duration = Duration::from_millis(4);
/// Asks and answers that may wait.
const QUEUE: usize = 64;

/// Why the port cannot be listened to at all. That it is not there now is no reason: it is opened when it comes.
#[derive(Debug, thiserror::Error)]
pub enum PortError {
    /// No thread.
    #[error("{}: cannot start the buttons' thread: {reason}", path.display())]
    Thread {
        /// The device.
        path: PathBuf,
        /// What the system said.
        reason: std::io::Error,
    },
}

/// What a press did, on its way to the board.
struct Act {
    button: u8,
    action: Option<Action>,
    outcome: Outcome,
    frame: u64,
}

/// The frame loop's end of the line. Dropping it closes the port.
pub struct Port {
    asks: Receiver<Ask>,
    acts: SyncSender<Act>,
    status: Arc<Mutex<Status>>,
    up: Arc<AtomicBool>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Port {
    /// Begins to listen on `config.port`; `None` where there is none. `styles`, `scenes`: names that may be asked for;
    /// `shots`: whether pictures may be.
    pub fn start(
        config: &Config,
        styles: Vec<&'static str>,
        scenes: Vec<String>,
        shots: bool,
    ) -> Result<Option<Port>, PortError> {
        let Some(path) = config.port.clone() else { return Ok(None) };
        let (ask, asks) = sync_channel(QUEUE);
        let (acts, act) = sync_channel(QUEUE);
        let (status, stop) = (Arc::new(Mutex::new(Status::default())), Arc::new(AtomicBool::new(false)));
        let link = Link::new(config, styles).offering(scenes, shots);
        let (baud, device) = (config.baud, path.clone());
        let (seen, stopped, up) = (status.clone(), stop.clone(), Arc::<AtomicBool>::default());
        let is_up = up.clone();
        let listen =
            move || Listener { link, ask, act, status: seen, up: is_up }.listen(&device, baud, &stopped);
        let thread = std::thread::Builder::new().name("buttons".into()).spawn(listen);
        let thread = thread.map_err(|reason| PortError::Thread { path, reason })?;
        Ok(Some(Port { asks, acts, status, up, stop, thread: Some(thread) }))
    }

    /// What was asked since the last call, oldest first. Never waits.
    pub fn asked(&self) -> impl Iterator<Item = Ask> + '_ {
        self.asks.try_iter()
    }

    /// Whether a board answers.
    pub fn is_up(&self) -> bool {
        self.up.load(Ordering::Relaxed)
    }

    /// Tells what a press did, and the number of the frame in which it shows. Never waits.
    pub fn acted(&self, button: u8, action: Option<Action>, outcome: Outcome, frame: u64) {
        // a full queue means a port that hangs: nobody would hear it
        let _ = self.acts.try_send(Act { button, action, outcome, frame });
    }

    /// Says how the visor is. Never waits: left for the next frame where the other end is looking.
    pub fn tell(&self, status: Status) {
        if let Ok(mut told) = self.status.try_lock() {
            *told = status;
        }
    }
}

impl Drop for Port {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // a panic there has been reported
            let _ = thread.join();
        }
    }
}

/// The thread's end.
struct Listener {
    link: Link,
    ask: SyncSender<Ask>,
    act: Receiver<Act>,
    status: Arc<Mutex<Status>>,
    up: Arc<AtomicBool>,
}

impl Listener {
    fn listen(mut self, path: &Path, baud: u32, stop: &AtomicBool) {
        let start = Instant::now();
        let mut said = None;
        while !stop.load(Ordering::Relaxed) {
            if !self.link.wants_port(start.elapsed()) {
                std::thread::park_timeout(Duration::from_millis(20));
                self.turn(&[], start.elapsed());
                continue;
            }
            let error = match open(path, baud) {
                Ok(mut port) => {
                    log::info!("buttons: listening on {}", path.display());
                    self.link.opened(start.elapsed());
                    self.converse(&mut *port, start, stop)
                }
                Err(error) => error.to_string(),
            };
            self.link.closed(start.elapsed());
            if said.as_ref() != Some(&error) && !stop.load(Ordering::Relaxed) {
                log::warn!("buttons: {}: {error}; opening it again", path.display());
                said = Some(error);
            }
        }
    }

    /// Carries bytes until the port ends or the link wants it closed; why it ended.
    fn converse(&mut self, port: &mut dyn SerialPort, start: Instant, stop: &AtomicBool) -> String {
        let mut bytes = [0; 256];
        let mut was_up = false;
        while !stop.load(Ordering::Relaxed) {
            let count = match port.read(&mut bytes) {
                Ok(0) => return "unplugged".into(),
                Ok(count) => count,
                Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => 0,
                Err(error) => return error.to_string(),
            };
            self.turn(&bytes[..count], start.elapsed());
            if was_up != self.link.is_up() {
                was_up = !was_up;
                if !was_up {
                    return "nothing heard for 3 s".into();
                }
                log::info!("buttons: a board answers");
            }
            if self.link.output().is_empty() {
                continue;
            }
            match port.write(self.link.output()) {
                Ok(count) => self.link.sent(count),
                Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => {}
                Err(error) => return error.to_string(),
            }
        }
        "stopped".into()
    }

    /// One step of the link.
    fn turn(&mut self, bytes: &[u8], now: Duration) {
        self.link.set_status(*self.status.lock().unwrap_or_else(PoisonError::into_inner));
        for Act { button, action, outcome, frame } in self.act.try_iter() {
            match action {
                Some(action) => self.link.act(button, action.name(), outcome, frame),
                None => self.link.act(button, "none", outcome, frame),
            }
        }
        let mut asks = Vec::new();
        self.link.receive(bytes, now, &mut asks);
        self.link.tick(now, &mut asks);
        self.up.store(self.link.is_up(), Ordering::Relaxed);
        for ask in asks {
            // a full queue means a frame loop that hangs: old presses are worth nothing to a visitor then
            let _ = self.ask.try_send(ask);
        }
    }
}

fn open(path: &Path, baud: u32) -> Result<Box<dyn SerialPort>, serialport::Error> {
    let mut port = serialport::new(path.to_string_lossy(), baud).timeout(WAIT).open()?;
    // boards that watch the line want it; a pseudo terminal has none
    let _ = port.write_data_terminal_ready(true);
    Ok(port)
}
