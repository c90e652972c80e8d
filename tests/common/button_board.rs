//! A board with three buttons whom somebody presses, a line that loses, breaks and invents bytes, and the books of both:
//! which presses were made, and which of them anyone behind the line could have known of.
//!
//! Written from the protocol's text alone; shares no code with the visor.

#![allow(dead_code, reason = "every test binary uses a part")]

use std::collections::{HashSet, VecDeque};
use std::ops::RangeInclusive;
use vernissage::pixels::SplitMix64;

/// A board, written from the specification's text alone: 3 buttons, 1 encoder. Also remembers what it showed of every
/// press, so that it can say which of them anyone could have known of.
pub struct Board {
    /// Next sequence number.
    seq: u8,
    /// Board clock at 0 of the test's.
    origin: u32,
    pub linked: bool,
    down: [bool; 3],
    /// Edges without ACK: sequence number, body, when sent first, how often again.
    open: Vec<(u8, String, u64, usize)>,
    next_state: u64,
    line: Vec<u8>,
    /// All that was said lately, in two generations.
    said: [HashSet<String>; 2],
}

fn crc16(body: &[u8]) -> u16 {
    let mut crc = 0xffff_u16;
    for &byte in body {
        crc ^= u16::from(byte) << 8;
        for _ in 0..8 {
            crc = if crc & 0x8000 == 0 { crc << 1 } else { (crc << 1) ^ 0x1021 };
        }
    }
    crc
}

impl Board {
    fn send(&mut self, rest: &str, out: &mut VecDeque<u8>) -> (u8, String) {
        let seq = self.seq;
        self.seq = seq.wrapping_add(1);
        let body = format!("{seq:02X} {rest}");
        Self::transmit(&body, out);
        self.said[0].insert(body.clone());
        (seq, body)
    }

    fn transmit(body: &str, out: &mut VecDeque<u8>) {
        out.extend(format!("${body}*{:04X}\n", crc16(body.as_bytes())).bytes());
    }

    fn time(&self, now: u64) -> u32 {
        self.origin.wrapping_add(now as u32)
    }

    fn state(&mut self, now: u64, out: &mut VecDeque<u8>) {
        let mask = self.down.iter().enumerate().map(|(k, &down)| u32::from(down) << k).sum::<u32>();
        let body = format!("STATE {mask:X} 0 {}", self.time(now));
        self.send(&body, out);
        self.next_state = now + 1000;
    }

    fn edge(&mut self, button: usize, now: u64, out: &mut VecDeque<u8>) {
        self.down[button] = !self.down[button];
        if !self.linked {
            return;
        }
        let letter = if self.down[button] { 'D' } else { 'U' };
        let (seq, body) = self.send(&format!("BTN {} {letter} {}", button + 1, self.time(now)), out);
        self.open.push((seq, body, now, 0));
        self.state(now, out);
    }

    /// Takes what it hears, and says what is due.
    pub fn turn(&mut self, now: u64, input: &[u8], out: &mut VecDeque<u8>) {
        for &byte in input {
            match byte {
                b'$' => self.line = vec![],
                b'\n' => {
                    let line = String::from_utf8_lossy(&self.line).into_owned();
                    self.line.clear();
                    self.understand(&line, now, out);
                }
                byte => self.line.push(byte),
            }
        }
        let mut again = Vec::new();
        self.open.retain_mut(|(_, body, first, times)| {
            let waits = [50, 150, 350];
            if *times < 3 && now >= *first + waits[*times] {
                *times += 1;
                again.push(body.clone());
            }
            *times < 3
        });
        again.iter().for_each(|body| Self::transmit(body, out));
        if self.linked && now >= self.next_state {
            self.state(now, out);
        }
    }

    fn understand(&mut self, line: &str, now: u64, out: &mut VecDeque<u8>) {
        let Some((body, crc)) = line.split_once('*') else { return };
        if format!("{:04X}", crc16(body.as_bytes())) != crc {
            return;
        }
        let words: Vec<&str> = body.split(' ').collect();
        match words[1..] {
            ["HI?", ..] => {
                self.linked = false;
                self.send("HELLO 1 5F3A01C2 1.4.0 3 1 0003", out);
            }
            ["OK", ..] => {
                self.linked = true;
                self.state(now, out);
            }
            ["ACK", seq] => self.open.retain(|(open, ..)| format!("{open:02X}") != seq),
            _ => {}
        }
    }
}

/// A line with 1 % of its bytes wrong or missing, and garbage now and then.
pub fn spoil(bytes: &mut VecDeque<u8>, rng: &mut SplitMix64) -> Vec<u8> {
    let mut out = Vec::new();
    for byte in bytes.drain(..) {
        match rng.int(0, 199) {
            0 => out.push(byte ^ (1 << rng.int(0, 7))),
            1 => {}
            _ => out.push(byte),
        }
    }
    if rng.int(0, 4999) == 0 {
        out.extend((0..rng.int(1, 200)).map(|_| rng.next_u64() as u8));
    }
    out
}

/// The frames of the board that got through whole: what the visor can have known.
#[derive(Default)]
struct Through {
    line: Vec<u8>,
}

impl Through {
    /// Bodies of whole, good frames among these bytes.
    fn bodies(&mut self, bytes: &[u8]) -> Vec<String> {
        let mut bodies = Vec::new();
        for &byte in bytes {
            match byte {
                b'$' => self.line = vec![b'$'],
                b'\n' => {
                    let line = String::from_utf8_lossy(&std::mem::take(&mut self.line)).into_owned();
                    if let Some((body, crc)) = line.strip_prefix('$').and_then(|line| line.split_once('*'))
                        && line.len() < 96
                        && crc == format!("{:04X}", crc16(body.as_bytes()))
                    {
                        bodies.push(body.to_owned());
                    }
                }
                byte => self.line.push(byte),
            }
        }
        bodies
    }
}

/// Nothing is entered or forgotten sooner than after so many looks: a board that is looked at late says late what it had
/// to say.
const LOOKS: u64 = 200;

/// How somebody presses, ms.
pub struct Pace {
    /// A press takes so long; a fiftieth of them are long ones, of 1450 to 1800.
    pub hold: RangeInclusive<i64>,
    /// Until the next one of the same button.
    pub rest: RangeInclusive<i64>,
}

/// A press as it was made, ms of the test's clock.
struct Made {
    button: usize,
    down: u64,
    /// `u64::MAX` while it is held.
    up: u64,
    /// How often the player had been looked at when it was over.
    looks: u64,
    /// Whether something whole that shows it got through.
    known: bool,
    /// Whether the line was down meanwhile.
    doubtful: bool,
}

/// A board, who presses its buttons, and the books.
pub struct Player {
    pub board: Board,
    pace: Pace,
    /// Per button: when its next edge is, and its present press.
    next: [u64; 3],
    going: [Option<Made>; 3],
    recent: Vec<Made>,
    through: Through,
    last_up: u64,
    /// When what was said longest ago is forgotten, ms and looks.
    forget: (u64, u64),
    looks: u64,
    pub made: u64,
    /// Presses that were shown to the visor, by button.
    pub known: [u64; 3],
    /// Presses that nobody could know of.
    pub hidden: u64,
    /// Presses while which the line was down: they may count or not.
    pub doubtful: u64,
    /// Broken frames with a good checksum, while somebody listened and while nobody did.
    pub forged: u64,
    pub unheard: u64,
}

impl Player {
    /// Begins to press at 5000.
    pub fn new(pace: Pace) -> Self {
        let board = Board {
            seq: 0,
            origin: 4_294_900_000, // the board's clock wraps soon
            linked: false,
            down: [false; 3],
            open: Vec::new(),
            next_state: 0,
            line: Vec::new(),
            said: Default::default(),
        };
        Self {
            board,
            pace,
            next: [5000, 5300, 5700],
            going: [None, None, None],
            recent: Vec::new(),
            through: Through::default(),
            last_up: 0,
            forget: (0, 0),
            looks: 0,
            made: 0,
            known: [0; 3],
            hidden: 0,
            doubtful: 0,
            forged: 0,
            unheard: 0,
        }
    }

    /// Presses and lets go what is due; `begins`: whether another press may begin.
    pub fn play(&mut self, now: u64, begins: bool, rng: &mut SplitMix64, out: &mut VecDeque<u8>) {
        self.looks += 1;
        for k in 0..3 {
            if now < self.next[k] {
                continue;
            }
            match self.going[k].take() {
                None if !begins || !self.board.linked => self.next[k] = now + 100,
                None => {
                    self.made += 1;
                    self.board.edge(k, now, out);
                    let hold = if rng.int(0, 49) == 0 { 1450..=1800 } else { self.pace.hold.clone() };
                    self.next[k] = now + rng.int(*hold.start(), *hold.end()) as u64;
                    self.going[k] = Some(Made {
                        button: k,
                        down: now,
                        up: u64::MAX,
                        looks: 0,
                        known: false,
                        doubtful: false,
                    });
                }
                Some(press) => {
                    self.board.edge(k, now, out);
                    self.last_up = now;
                    self.recent.push(Made { up: now, looks: self.looks, ..press });
                    self.next[k] = now + rng.int(*self.pace.rest.start(), *self.pace.rest.end()) as u64;
                }
            }
        }
    }

    /// Whether all presses are entered.
    pub fn is_settled(&self) -> bool {
        self.going.iter().all(Option::is_none) && self.recent.is_empty()
    }

    /// Whether nothing is held down, and nothing was for so long.
    pub fn rests(&self, now: u64, since: u64) -> bool {
        self.going.iter().all(Option::is_none) && now >= self.last_up + since
    }

    /// These bytes of the board are before the visor; `up`: whether it listens.
    pub fn delivered(&mut self, bytes: &[u8], up: bool) {
        let bodies = self.through.bodies(bytes);
        for body in &bodies {
            if !self.board.said.iter().any(|said| said.contains(body)) {
                match up {
                    true => self.forged += 1,
                    false => self.unheard += 1,
                }
                continue;
            }
            if !up {
                continue;
            }
            let origin = self.board.origin;
            let words: Vec<&str> = body.split(' ').collect();
            let at = |word: &str| u64::from(word.parse::<u32>().expect("a time").wrapping_sub(origin));
            let shown: Option<(Option<usize>, u64)> = match words[1..] {
                ["BTN", n, _, t] => Some((n.parse::<usize>().ok().map(|n| n - 1), at(t))),
                ["STATE", _, _, t] => Some((None, at(t))),
                _ => None,
            };
            let Some((button, t)) = shown else { continue };
            // an edge shows its own press, a state those that are down in it
            let shows = |press: &Made| match button {
                Some(button) => button == press.button && (t == press.down || t == press.up),
                None => press.down <= t && t < press.up,
            };
            for press in self.recent.iter_mut().chain(self.going.iter_mut().flatten()) {
                press.known |= shows(press);
            }
        }
    }

    /// The line is down, or was: what is going on may count or not.
    pub fn doubt(&mut self) {
        for press in self.recent.iter_mut().chain(self.going.iter_mut().flatten()) {
            press.doubtful = true;
        }
    }

    /// Enters presses that were over `late` ms ago: what was shown of them by now is all, unless nobody looked meanwhile.
    pub fn settle(&mut self, now: u64, late: u64) {
        if now >= self.forget.0 && self.looks >= self.forget.1 {
            self.forget = (now + late, self.looks + LOOKS);
            self.board.said.swap(0, 1);
            self.board.said[0].clear();
        }
        let Self { recent, known, hidden, doubtful, looks, .. } = self;
        recent.retain(|press| {
            let old = now > press.up.saturating_add(late) && *looks > press.looks + LOOKS;
            if old && press.doubtful {
                *doubtful += 1;
            } else if old && press.known {
                known[press.button] += 1;
            } else if old {
                *hidden += 1;
            }
            !old
        });
    }
}
