//! The conversation: handshake, acknowledgements, what is told and when. No port and no clock: bytes and the time are
//! passed in, bytes and what is asked of the visor come out.
//!
//! Closed → greeting (`HI?` on opening and every 500 ms) → up (after `OK`) → closed (3 s without a valid frame, or the
//! port's end), and opened again after 100 ms, then twice as long each time up to 2 s.

use super::codec::{Dropped, Heard, Line, Outcome, Said, Wire, frame};
use super::console::{self, Command};
use super::press::{Kind, Press, Presses};
use super::status::Status;
use super::{Config, Console};
use std::time::Duration;

/// The protocol spoken.
const PROTOCOL: u32 = 1;
const HI_EVERY: Duration = Duration::from_millis(500);
const SILENCE: Duration = Duration::from_secs(3);
const BEAT_EVERY: Duration = Duration::from_secs(1);
const TRACKED_EVERY: Duration = Duration::from_millis(200);
const REOPEN: [Duration; 2] = [Duration::from_millis(100), Duration::from_secs(2)];
/// Messages whose repeats are known.
const REPEATS: usize = 16;
/// How far a board's time may be ahead of where its clock can stand by now, or before the newest one heard, ms.
const STRAY_MS: i32 = 3000;
/// As far before the newest comes what a board that goes on sends again after 50, 100 and 200 ms, ms.
const RESENT_MS: i32 = 500;
/// So many states one after the other whose time cannot be are no broken bytes: the clock was set anew.
const STRAYS: u32 = 2;
/// Bytes that may wait for a slow port; what else there is to say is left out.
const BACKLOG: usize = 4096;
/// Bit of a chattering button in the fault mask; the visor's own faults have the bits below.
const NOISE_BIT: u32 = 8;

/// What the board, a controller or a technician asks of the visor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ask {
    /// A button, from 1, was pressed.
    Press(u8, Kind),
    /// The style with this number in the list that the link was given.
    Style(usize),
    /// Standby, or its end.
    Standby(bool),
    /// The scene with this number in the list that the link was given.
    Scene(usize),
    /// The picture is to be kept.
    Shot,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum State {
    /// Opened again at `again`; the pause after that.
    Closed {
        again: Duration,
        pause: Duration,
    },
    Greeting {
        next: Duration,
        pause: Duration,
    },
    Up {
        heard: Duration,
    },
}

/// A board's clock, as far as can be told: what is said may be heard late, never early.
#[derive(Clone, Copy, Debug)]
struct Clock {
    /// Its newest time.
    newest: u32,
    /// When that was heard.
    heard: Duration,
    /// Where it stood then, had nothing ever been late.
    stood: u32,
}

/// One end of the line.
#[derive(Debug)]
pub struct Link {
    console: Console,
    styles: Vec<&'static str>,
    scenes: Vec<String>,
    shots: bool,
    state: State,
    wire: Wire,
    presses: Presses,
    told: Vec<Press>,
    seq: u8,
    repeats: [Option<(u8, u16)>; REPEATS],
    clock: Option<Clock>,
    /// A greeting or an opening came since the last time heard: the board may have begun anew.
    anew: bool,
    /// States in a row whose time cannot be.
    strays: u32,
    /// How many buttons the board has.
    buttons: u8,
    status: Status,
    said: Status,
    beat: Duration,
    tracked: Duration,
    watching: bool,
    /// Muted buttons.
    noisy: u32,
    out: Vec<u8>,
}

impl Link {
    /// A link that is to be opened at once. `styles`: names that may be asked for.
    pub fn new(config: &Config, styles: Vec<&'static str>) -> Self {
        Self {
            console: config.console,
            styles,
            scenes: Vec::new(),
            shots: false,
            state: State::Closed { again: Duration::ZERO, pause: REOPEN[0] },
            wire: Wire::default(),
            presses: Presses::new(&config.wanted()),
            told: Vec::new(),
            seq: 0,
            repeats: [None; REPEATS],
            clock: None,
            anew: false,
            strays: 0,
            buttons: 0,
            status: Status::default(),
            said: Status::default(),
            beat: Duration::ZERO,
            tracked: Duration::ZERO,
            watching: false,
            noisy: 0,
            out: Vec::new(),
        }
    }

    /// The same link; `scenes` may be asked for too, and pictures to be kept where `shots` says so.
    pub fn offering(self, scenes: Vec<String>, shots: bool) -> Self {
        Self { scenes, shots, ..self }
    }

    /// Whether a board answered and is heard from.
    pub fn is_up(&self) -> bool {
        matches!(self.state, State::Up { .. })
    }

    /// Whether the port should be open at `now`.
    pub fn wants_port(&self, now: Duration) -> bool {
        !matches!(self.state, State::Closed { again, .. } if now < again)
    }

    /// What the receiver dropped.
    pub fn dropped(&self) -> Dropped {
        self.wire.dropped()
    }

    /// Bit n-1 for every button n that is held down.
    pub fn held(&self) -> u32 {
        self.presses.held()
    }

    /// What is to be sent.
    pub fn output(&self) -> &[u8] {
        &self.out
    }

    /// The first `count` bytes of the output are on their way.
    pub fn sent(&mut self, count: usize) {
        self.out.drain(..count.min(self.out.len()));
    }

    /// The port is open.
    pub fn opened(&mut self, now: Duration) {
        if let State::Closed { pause, .. } = self.state {
            self.state = State::Greeting { next: now, pause };
        }
        self.tick(now, &mut Vec::new());
    }

    /// The port could not be opened, ended or failed. All buttons are released.
    pub fn closed(&mut self, now: Duration) {
        let pause = match self.state {
            State::Closed { again, .. } if now < again => return,
            State::Closed { pause, .. } | State::Greeting { pause, .. } => pause,
            State::Up { .. } => REOPEN[0],
        };
        self.state = State::Closed { again: now + pause, pause: (pause * 2).min(REOPEN[1]) };
        self.wire.reset();
        self.out.clear();
        self.watching = false;
        self.doubt();
    }

    /// How the visor is now: told to the board when it is due.
    pub fn set_status(&mut self, status: Status) {
        self.status = status;
    }

    /// What a press did, and the number of the frame in which it shows.
    pub fn act(&mut self, button: u8, action: &str, outcome: Outcome, frame: u64) {
        if self.is_up() {
            self.say(&Said::Act { button, action, outcome, frame });
        }
    }

    /// Takes bytes from the port.
    pub fn receive(&mut self, bytes: &[u8], now: Duration, asks: &mut Vec<Ask>) {
        for &byte in bytes {
            match self.wire.push(byte) {
                Some(Line::Text(text)) if self.console != Console::Off => self.typed(&text, now, asks),
                Some(Line::Message { seq, crc, heard }) => self.message(seq, crc, heard, now, asks),
                _ => {}
            }
        }
        self.flush(asks);
    }

    /// Does what is due at `now`. To be called every few milliseconds.
    pub fn tick(&mut self, now: Duration, asks: &mut Vec<Ask>) {
        match self.state {
            State::Greeting { next, pause } if now >= next => {
                self.state = State::Greeting { next: now + HI_EVERY, pause };
                self.say(&Said::Hi(PROTOCOL, PROTOCOL));
            }
            State::Up { heard } if now >= heard + SILENCE => self.closed(now),
            State::Up { .. } => self.tell(now),
            _ => {}
        }
        if let Some(Clock { newest, heard, .. }) = self.clock {
            let since = now.saturating_sub(heard).as_millis() as u32;
            self.presses.tick(newest.wrapping_add(since), &mut self.told);
        }
        self.flush(asks);
        if self.watching && now >= self.beat + BEAT_EVERY {
            self.beat = now;
            self.comment_status(now);
        }
    }

    /// Status lines that are due.
    fn tell(&mut self, now: Duration) {
        let up_ms = now.as_millis() as u64;
        let status = Status { faults: self.status.faults & 0xff, ..self.status };
        let faults = status.faults | if self.noisy == 0 { 0 } else { 1 << NOISE_BIT };
        for code in 0..32 {
            let (is, was) = (faults >> code & 1 == 1, self.said.faults >> code & 1 == 1);
            if is != was {
                self.say(&Said::Fault(is, code, up_ms));
            }
        }
        self.said.faults = faults;
        if status.style != self.said.style {
            self.said.style = status.style;
            self.say(&Said::Style(status.style));
        }
        if status.markers != self.said.markers && now >= self.tracked + TRACKED_EVERY {
            self.tracked = now;
            self.said.markers = status.markers;
            self.say(&Said::Tracked(status.markers.len(), &status.markers));
        }
        if now >= self.beat + BEAT_EVERY {
            self.beat = now;
            let Status { mode, fps10, style, .. } = status;
            let (mode, tracked) = (mode.name(), status.markers.len());
            self.say(&Said::Beat { up_s: now.as_secs(), mode, fps10, tracked, style, faults });
            if self.watching {
                self.comment_status(now);
            }
        }
    }

    fn say(&mut self, message: &Said) {
        let line = frame(self.seq, message);
        if self.out.len() + line.len() <= BACKLOG {
            self.out.extend(line.bytes());
            self.seq = self.seq.wrapping_add(1);
        }
    }

    fn comment(&mut self, text: &str) {
        if self.out.len() + text.len() + 3 <= BACKLOG {
            self.out.extend(format!("# {text}\n").bytes());
        }
    }

    fn comment_status(&mut self, now: Duration) {
        let link = if self.is_up() { "up" } else { "silent" };
        self.comment(&console::status(&self.status, now.as_secs(), link));
    }

    fn message(&mut self, seq: u8, crc: u16, heard: Option<Heard>, now: Duration, asks: &mut Vec<Ask>) {
        if let State::Up { heard } = &mut self.state {
            *heard = now;
        }
        let Some(heard) = heard else { return };
        if let Heard::Hello { proto, buttons, .. } = heard {
            self.buttons = buttons;
            return self.greeted(proto, now);
        }
        if !self.is_up() {
            return; // the board resends, and its state heals what it does not
        }
        let again = self.repeats.contains(&Some((seq, crc)));
        let is_state = matches!(heard, Heard::State { .. });
        if let Heard::Button { at, .. } | Heard::Encoder { at, .. } | Heard::State { at, .. } = heard
            && !again
            && !self.believes(at, now, is_state)
        {
            return;
        }
        if !again {
            self.repeats.rotate_right(1);
            self.repeats[0] = Some((seq, crc));
        }
        match heard {
            Heard::Button { number, .. } if number > self.buttons => {}
            Heard::Button { number, down, at } => {
                self.say(&Said::Ack(seq));
                if !again {
                    self.presses.edge(number, down, at, &mut self.told);
                }
            }
            Heard::Encoder { .. } => self.say(&Said::Ack(seq)),
            Heard::State { mask, at } => {
                let known = u32::MAX.checked_shr(32 - u32::from(self.buttons)).unwrap_or(0);
                self.presses.state(mask & known, at, &mut self.told);
            }
            Heard::Battery { .. } => {}
            Heard::Error { code, text } => log::warn!("buttons: the board reports {code} {text}"),
            Heard::SetStyle(name) => match self.styles.iter().position(|known| *known == name) {
                Some(style) => self.accept(seq, again, Ask::Style(style), asks),
                None => self.say(&Said::Nak(seq, "unknown-style")),
            },
            Heard::Standby(on) => self.accept(seq, again, Ask::Standby(on), asks),
            Heard::SetScene(name) => match self.scenes.iter().position(|known| *known == name) {
                Some(scene) => self.accept(seq, again, Ask::Scene(scene), asks),
                None => self.say(&Said::Nak(seq, "unknown-scene")),
            },
            Heard::Shot if self.shots => self.accept(seq, again, Ask::Shot, asks),
            Heard::Shot => self.say(&Said::Nak(seq, "off")),
            Heard::Ping => self.say(&Said::Ack(seq)),
            Heard::Hello { .. } => {}
        }
    }

    fn accept(&mut self, seq: u8, again: bool, ask: Ask, asks: &mut Vec<Ask>) {
        self.say(&Said::Ack(seq));
        if !again {
            asks.push(ask);
        }
    }

    /// A board says who it is: at its start, or when asked.
    fn greeted(&mut self, proto: u32, now: Duration) {
        if proto != PROTOCOL {
            self.say(&Said::No(PROTOCOL, PROTOCOL));
            log::warn!(
                "buttons: the board speaks protocol {proto}, this visor {PROTOCOL}: update its program"
            );
            return;
        }
        self.say(&Said::Ok(PROTOCOL, env!("CARGO_PKG_VERSION")));
        if !self.is_up() {
            // all is news to a board
            self.said = Status::default();
            (self.beat, self.tracked) = (Duration::ZERO, Duration::ZERO);
        }
        self.doubt();
        self.state = State::Up { heard: now };
    }

    /// All buttons are released. Whether the board began anew, or goes on and may send again what was counted, is told
    /// by the next time it says.
    fn doubt(&mut self) {
        self.presses.let_go(&mut self.told);
        (self.anew, self.repeats, self.noisy, self.strays) = (true, [None; REPEATS], 0, 0);
    }

    /// Takes the board's clock from a message; `false` when that time cannot be: a checksum of 16 bits lets one broken
    /// frame in 65536 through. What is late, on its way or here, is believed. That the clock was set anew is told by
    /// states alone: an edge may be sent again by a board that was held up for long.
    fn believes(&mut self, at: u32, now: Duration, is_state: bool) -> bool {
        let mut stands = at;
        if let Some(Clock { newest, heard, stood }) = self.clock {
            let since = now.saturating_sub(heard).as_millis() as u32;
            let back = if self.anew { RESENT_MS } else { STRAY_MS };
            let (off, ahead) =
                (at.wrapping_sub(newest) as i32, at.wrapping_sub(stood.wrapping_add(since)) as i32);
            if off < -back || ahead > STRAY_MS {
                self.strays += u32::from(is_state);
                if !is_state || (self.strays < STRAYS && !self.anew) {
                    return false;
                }
                self.presses.release(&mut self.told);
                self.clock = None;
            } else if ahead < 0 {
                // a board's clock may be slow, by one part in 128
                stands = at.wrapping_add(ahead.unsigned_abs().saturating_sub(since / 128));
            }
        }
        (self.strays, self.anew) = (0, false);
        // repeats are old
        if self.clock.is_none_or(|clock| at.wrapping_sub(clock.newest) as i32 > 0) {
            self.clock = Some(Clock { newest: at, heard: now, stood: stands });
        }
        true
    }

    /// Turns what the buttons told into what is asked.
    fn flush(&mut self, asks: &mut Vec<Ask>) {
        for k in 0..self.told.len() {
            match self.told[k] {
                Press::Done(button, kind) => {
                    asks.push(Ask::Press(button, kind));
                    if self.watching {
                        self.comment(&format!("button {button}: {kind:?}").to_lowercase());
                    }
                }
                Press::Muted(button, muted) => {
                    let bit = 1_u32.checked_shl(u32::from(button).wrapping_sub(1)).unwrap_or(0);
                    self.noisy = if muted { self.noisy | bit } else { self.noisy & !bit };
                    if muted {
                        log::warn!(
                            "buttons: button {button} chatters: not listened to for 5 s; check its wiring"
                        );
                    }
                }
            }
        }
        self.told.clear();
    }

    fn typed(&mut self, text: &str, now: Duration, asks: &mut Vec<Ask>) {
        match Command::parse(text, self.console) {
            Ok(Command::Help) => console::HELP.iter().for_each(|line| self.comment(line)),
            Ok(Command::Status) => self.comment_status(now),
            Ok(Command::Watch) => {
                self.watching = !self.watching;
                self.comment(if self.watching { "watching" } else { "no longer watching" });
            }
            Ok(Command::Press(button)) => {
                self.comment("pressed");
                asks.push(Ask::Press(button, Kind::Short));
            }
            Ok(Command::Style(name)) => match self.styles.iter().position(|known| *known == name) {
                Some(style) => {
                    self.comment("done");
                    asks.push(Ask::Style(style));
                }
                None => {
                    let known = self.styles.join(" ");
                    self.comment("no such style; there are:");
                    known.as_bytes().chunks(80).for_each(|part| self.comment(&String::from_utf8_lossy(part)));
                }
            },
            Err(reason) => self.comment(reason),
        }
    }
}
