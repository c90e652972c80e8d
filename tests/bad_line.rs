//! Buttons on a line that loses, breaks and invents bytes, between the link and a model of a board that shares no code
//! with it; and the same where the visor at times does nothing for seconds and hears all of it late.
//!
//! `VERNISSAGE_SOAK=1` makes a million presses instead of a twentieth.

use std::collections::{HashSet, VecDeque};
use std::time::Duration;
use vernissage::buttons::{Ask, ButtonConfig, Config, Kind, Link};
use vernissage::pixels::SplitMix64;

fn ms(value: u64) -> Duration {
    Duration::from_millis(value)
}

/// A board, written from the specification's text alone: 3 buttons, 1 encoder. Also remembers what it showed of every
/// press, so that it can say which of them anyone could have known of.
struct Board {
    /// Next sequence number.
    seq: u8,
    /// Board clock at 0 of the test's.
    origin: u32,
    linked: bool,
    down: [bool; 3],
    /// Edges without ACK: sequence number, body, when sent first, how often again.
    open: Vec<(u8, String, u64, usize)>,
    next_state: u64,
    line: Vec<u8>,
    /// All that was said lately, in two generations.
    said: [HashSet<String>; 2],
}

fn board_crc(body: &[u8]) -> u16 {
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
        out.extend(format!("${body}*{:04X}\n", board_crc(body.as_bytes())).bytes());
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

    fn turn(&mut self, now: u64, input: &[u8], out: &mut VecDeque<u8>) {
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
        if format!("{:04X}", board_crc(body.as_bytes())) != crc {
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
fn spoil(bytes: &mut VecDeque<u8>, rng: &mut SplitMix64) -> Vec<u8> {
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

/// A press as it was made, ms of the test's clock.
struct Made {
    button: usize,
    down: u64,
    up: u64,
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
                        && crc == format!("{:04X}", board_crc(body.as_bytes()))
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

/// Presses `count` times over a bad line; `button` decides what kinds are told apart. Where `starved`, the visor does
/// nothing for 1 to 10 s now and then, and hears all of it at once after that. Returns what was counted, what was
/// made and could be known of, how many presses nobody could know of, and how many broken frames had a good checksum.
fn hammer(
    count: u64,
    button: impl Fn(u8) -> ButtonConfig,
    starved: bool,
    seed: u64,
) -> ([u64; 3], [u64; 3], u64, u64) {
    let mut rng = SplitMix64::new(seed);
    let config = Config { button: (1..=3).map(button).collect(), ..Config::default() };
    let mut link = Link::new(&config, Vec::new());
    let origin = 4_294_900_000; // the board's clock wraps soon
    let mut board = Board {
        seq: 0,
        origin,
        linked: false,
        down: [false; 3],
        open: Vec::new(),
        next_state: 0,
        line: Vec::new(),
        said: Default::default(),
    };
    let (mut to_visor, mut to_board) = (VecDeque::new(), VecDeque::new());
    let (mut counted, mut known, mut hidden, mut forged) = ([0; 3], [0; 3], 0, 0);
    let mut through = Through::default();
    // per button: when its next edge is, and its present press
    let mut next = [5000, 5300, 5700_u64];
    let mut going: [Option<Made>; 3] = [None, None, None];
    let mut recent: Vec<(Made, bool)> = Vec::new();
    let (mut made, mut now, mut plugged, mut open) = (0, 0_u64, true, false);
    let unplug_every = (count * 250 / 100).max(20_000);
    let mut unplug_at = unplug_every;
    let mut asks = Vec::new();
    let (mut last_up, mut awake) = (0, 0);
    // what the visor hears may be so old, ms, besides what the line makes of it
    let late = if starved { 11_000 } else { 0 };
    while made < count || going.iter().any(Option::is_some) || now < last_up + 12_000 + late {
        now += 1;
        if now % (2000 + late) == 0 {
            board.said.swap(0, 1);
            board.said[0].clear();
        }
        let quiet = now + 8000 >= unplug_at; // nobody presses around an unplugging: those are tested above
        if plugged && now == unplug_at {
            plugged = false;
            link.closed(ms(now));
        } else if !plugged && now == unplug_at + 3000 {
            plugged = true;
            unplug_at = now + unplug_every;
        }
        // as the port's thread does it: closed where the link is, opened when it wants to be
        if open && !link.wants_port(ms(now)) {
            open = false;
            to_visor.clear();
            to_board.clear();
        } else if !open && plugged && link.wants_port(ms(now)) {
            open = true;
            link.opened(ms(now));
        }
        if starved && !quiet && now > awake + 5000 && rng.int(0, 9999) == 0 {
            awake = now + rng.int(1000, 10_000) as u64;
        }
        let asleep = now < awake && now + 2000 < unplug_at;
        for k in 0..3 {
            if now < next[k] {
                continue;
            }
            match going[k].take() {
                None if quiet || made >= count || !link.is_up() || !board.linked => next[k] = now + 100,
                None => {
                    made += 1;
                    board.edge(k, now, &mut to_visor);
                    let hold = if rng.int(0, 49) == 0 { rng.int(1450, 1800) } else { rng.int(35, 400) };
                    next[k] = now + hold as u64;
                    going[k] = Some(Made { button: k, down: now, up: next[k] });
                }
                Some(press) => {
                    board.edge(k, now, &mut to_visor);
                    last_up = now;
                    recent.push((press, false));
                    next[k] = now + rng.int(80, 900) as u64;
                }
            }
        }
        if asleep {
            board.turn(now, &[], &mut to_visor);
            continue;
        }
        if open {
            let was_up = link.is_up();
            let received = spoil(&mut to_visor, &mut rng);
            for body in through.bodies(&received).iter().filter(|_| was_up) {
                if !board.said.iter().any(|said| said.contains(body)) {
                    forged += 1;
                    continue;
                }
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
                recent.iter_mut().for_each(|(press, known)| *known |= shows(press));
                for press in going.iter().flatten().filter(|press| shows(press)) {
                    recent.push((Made { ..*press }, true));
                }
            }
            link.receive(&received, ms(now), &mut asks);
            let mut answer: VecDeque<u8> = link.output().iter().copied().collect();
            link.sent(answer.len());
            to_board.append(&mut answer);
            let received = spoil(&mut to_board, &mut rng);
            board.turn(now, &received, &mut to_visor);
        }
        link.tick(ms(now), &mut asks);
        for ask in asks.drain(..) {
            if let Ask::Press(button, kind) = ask {
                counted[usize::from(button) - 1] += if kind == Kind::Double { 2 } else { 1 };
            } else {
                panic!("nobody asked for {ask:?}");
            }
        }
        // long enough ago for every repeat: what was shown of a press by now is all
        let mut settled = Vec::new();
        recent.retain(|(press, known)| {
            let old = now > press.up + 3000 + late;
            if old {
                settled.push((press.button, press.down, *known));
            }
            !old
        });
        settled.sort_unstable();
        for same in settled.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            if same.iter().any(|&(_, _, known)| known) {
                known[same[0].0] += 1;
            } else {
                hidden += 1;
            }
        }
    }
    assert_eq!(known.iter().sum::<u64>() + hidden, made, "the test's own books");
    (counted, known, hidden, forged)
}

fn plenty() -> u64 {
    if std::env::var_os("VERNISSAGE_SOAK").is_some() { 1_000_000 } else { 50_000 }
}

#[test]
fn no_press_is_lost_and_none_invented_on_a_bad_line() {
    use vernissage::buttons::Action::{Freeze, Standby, StyleNext};
    let plain = |number| ButtonConfig { number, short: Some(StyleNext), long: None, double: None };
    let all =
        |number| ButtonConfig { number, short: Some(StyleNext), long: Some(Standby), double: Some(Freeze) };
    let part = plenty() / 4;
    let runs = [
        hammer(part, plain, false, 1),
        hammer(part, all, false, 2),
        hammer(part, plain, true, 3),
        hammer(part, all, true, 4),
    ];
    for (counted, known, hidden, forged) in runs {
        println!("{counted:?} presses counted, {hidden} never got through, {forged} frames forged by noise");
        // one broken frame in 65536 has a good checksum: such a lie may cost or invent a press, nothing else may
        let off: u64 = counted.iter().zip(known).map(|(counted, known)| counted.abs_diff(known)).sum();
        assert!(off <= forged, "{counted:?} of {known:?}, {forged} forged");
        assert!(hidden * 100_000 <= part, "{hidden} presses of {part} never got through at all");
    }
}
