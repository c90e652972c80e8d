//! Keys of the kernel's input layer (`gpio-keys`, a keyboard) as a second source of presses, off unless `[keys]` is
//! given. A thread reads the device and opens it again when it left; what a key means is what the button of the same
//! number means.

use super::link::Ask;
use super::press::{Press, Presses, Wanted};
use serde::Deserialize;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// How long a wait for keys is: what is due (long presses) is at most this late.
const WAIT: Duration = Duration::from_millis(20);
/// Pauses before the device is opened again: the first, and the longest.
const REOPEN: [Duration; 2] = [Duration::from_millis(100), Duration::from_secs(2)];
/// Presses that may wait for the frame loop.
const QUEUE: usize = 64;

/// The `[keys]` table.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// The input device, such as `"/dev/input/by-path/platform-gpio-keys-event"`.
    pub device: PathBuf,
    /// Key codes of `linux/input-event-codes.h`, at most 32: the first is button 1, the second button 2, ..
    pub codes: Vec<u16>,
}

impl Config {
    /// Whether everything is within its range; else what is wrong.
    pub fn check(&self) -> Result<(), String> {
        if !(1..=32).contains(&self.codes.len()) {
            return Err(format!("keys.codes has {} codes: give 1 to 32", self.codes.len()));
        }
        let twice = (1..self.codes.len()).find(|&k| self.codes[..k].contains(&self.codes[k]));
        twice.map_or(Ok(()), |k| Err(format!("keys.codes has {} twice", self.codes[k])))
    }

    /// The button that a key is, from 1.
    pub fn button(&self, code: u16) -> Option<u8> {
        self.codes.iter().position(|&own| own == code).map(|index| index as u8 + 1)
    }
}

/// The frame loop's end. Dropping it closes the device.
pub struct Keys {
    asks: Receiver<Ask>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Keys {
    /// Begins to listen. `wanted`: the kinds of presses that mean something, button by button.
    pub fn start(config: &Config, wanted: Vec<Wanted>) -> std::io::Result<Self> {
        let (ask, asks) = sync_channel(QUEUE);
        let stop = Arc::<AtomicBool>::default();
        let (config, stopped) = (config.clone(), stop.clone());
        let listen = move || {
            let send = |asked: Ask| {
                // a full queue means a frame loop that hangs: old presses are worth nothing to a visitor then
                let _ = ask.try_send(asked);
            };
            listen(&config, &wanted, &send, &stopped);
        };
        let thread = Some(std::thread::Builder::new().name("keys".into()).spawn(listen)?);
        Ok(Self { asks, stop, thread })
    }

    /// What was pressed since the last call, oldest first. Never waits.
    pub fn asked(&self) -> impl Iterator<Item = Ask> + '_ {
        self.asks.try_iter()
    }
}

impl Drop for Keys {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // a panic there has been reported
            let _ = thread.join();
        }
    }
}

/// Turns edges into presses.
struct Listener<'a> {
    config: &'a Config,
    presses: Presses,
    told: Vec<Press>,
}

impl<'a> Listener<'a> {
    fn new(config: &'a Config, wanted: &[Wanted]) -> Self {
        Self { config, presses: Presses::new(wanted), told: Vec::new() }
    }

    /// A key went down (1) or up (0) at a time in ms; a repeat (2) says nothing new.
    fn key(&mut self, code: u16, value: i32, at: u32) {
        if let (Some(button), 0 | 1) = (self.config.button(code), value) {
            self.presses.edge(button, value == 1, at, &mut self.told);
        }
    }

    fn tick(&mut self, now: u32, send: &impl Fn(Ask)) {
        self.presses.tick(now, &mut self.told);
        self.flush(send);
    }

    /// The device left: all keys are up.
    fn release(&mut self, send: &impl Fn(Ask)) {
        self.presses.release(&mut self.told);
        self.flush(send);
    }

    fn flush(&mut self, send: &impl Fn(Ask)) {
        for press in self.told.drain(..) {
            match press {
                Press::Done(button, kind) => send(Ask::Press(button, kind)),
                Press::Muted(button, true) => {
                    log::warn!("keys: key {button} chatters: not listened to for 5 s")
                }
                Press::Muted(_, false) => {}
            }
        }
    }
}

#[cfg(not(target_os = "linux"))]
fn listen(config: &Config, _: &[Wanted], _: &impl Fn(Ask), _: &AtomicBool) {
    log::warn!("keys: {}: input devices need Linux", config.device.display());
}

#[cfg(target_os = "linux")]
fn listen(config: &Config, wanted: &[Wanted], send: &impl Fn(Ask), stop: &AtomicBool) {
    let mut listener = Listener::new(config, wanted);
    let (mut pause, mut said) = (REOPEN[0], None);
    while !stop.load(Ordering::Relaxed) {
        let error = match evdev::Device::open(&config.device) {
            Ok(mut device) => {
                log::info!("keys: listening on {}", config.device.display());
                pause = REOPEN[0];
                read(&mut device, &mut listener, send, stop)
            }
            Err(error) => error,
        };
        listener.release(send);
        let text = error.to_string();
        if said.as_ref() != Some(&text) && !stop.load(Ordering::Relaxed) {
            log::warn!("keys: {}: {text}; opening it again", config.device.display());
            said = Some(text);
        }
        std::thread::park_timeout(pause);
        pause = (pause * 2).min(REOPEN[1]);
    }
}

/// Reads until the device fails or the end is wished; why it ended.
#[cfg(target_os = "linux")]
fn read(
    device: &mut evdev::Device,
    listener: &mut Listener<'_>,
    send: &impl Fn(Ask),
    stop: &AtomicBool,
) -> std::io::Error {
    use rustix::event::{PollFd, PollFlags, Timespec, poll};
    let ms = |time: std::time::SystemTime| {
        time.duration_since(std::time::UNIX_EPOCH).map_or(0, |since| since.as_millis() as u32)
    };
    if let Err(error) = device.set_nonblocking(true) {
        return error;
    }
    let timeout = Timespec { tv_sec: 0, tv_nsec: WAIT.as_nanos() as _ };
    while !stop.load(Ordering::Relaxed) {
        let ready = poll(&mut [PollFd::new(&*device, PollFlags::IN)], Some(&timeout));
        if ready.is_ok_and(|count| count > 0) {
            match device.fetch_events() {
                Ok(events) => {
                    for event in events.filter(|event| event.event_type() == evdev::EventType::KEY) {
                        listener.key(event.code(), event.value(), ms(event.timestamp()));
                    }
                }
                Err(error) if error.kind() == std::io::ErrorKind::WouldBlock => {}
                Err(error) => return error,
            }
        }
        // events are stamped by the same clock
        listener.tick(ms(std::time::SystemTime::now()), send);
    }
    std::io::Error::other("stopped")
}

#[cfg(test)]
mod tests {
    use super::super::Kind;
    use super::*;
    use std::cell::RefCell;

    #[test]
    fn keys_are_buttons_by_their_place() {
        let config: Config =
            toml::from_str("device = \"/dev/input/event0\"\ncodes = [256, 257, 28]").expect("valid");
        assert_eq!([256, 257, 28, 1].map(|code| config.button(code)), [Some(1), Some(2), Some(3), None]);
        assert!(config.check().is_ok());
        let twice = Config { codes: vec![5, 6, 5], ..config.clone() };
        assert!(twice.check().is_err_and(|e| e.contains("5 twice")));
        assert!(Config { codes: vec![], ..config }.check().is_err());
    }

    #[test]
    fn edges_become_presses_and_repeats_do_not() {
        let config = Config { device: "x".into(), codes: vec![256, 257] };
        let wanted = [Wanted { long: true, double: false }, Wanted::default()];
        let (mut listener, heard) = (Listener::new(&config, &wanted), RefCell::new(Vec::new()));
        let send = |ask: Ask| heard.borrow_mut().push(ask);
        let mut play = |events: &[(u16, i32, u32)], until: u32| {
            for &(code, value, at) in events {
                listener.key(code, value, at);
                listener.tick(at, &send);
            }
            listener.tick(until, &send);
            heard.take()
        };
        let short = |button| Ask::Press(button, Kind::Short);
        assert_eq!(play(&[(256, 1, 1000), (256, 2, 1250), (256, 2, 1280), (256, 0, 1300)], 1400), [short(1)]);
        assert_eq!(play(&[(257, 1, 2000), (999, 1, 2001), (257, 0, 2100)], 2200), [short(2)]);
        assert_eq!(play(&[(256, 1, 3000)], 4600), [Ask::Press(1, Kind::Long)]);
    }
}
