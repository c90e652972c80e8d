//! From edges and states to presses, on the board's clock. Pure: no port, and time only as told.
//!
//! Every button has a short history of what was heard about it, in the board's order of time, not in that of arrival: an
//! edge that is sent again may come after the state that already showed it. A press is a stretch of being down in
//! that history; whatever shows one first (an edge down, an edge up, a state) counts it, and nothing counts it again.
//!
//! A short press is told as early as it can be: 5 ms after the edge where holding and repeating mean nothing, at the
//! release where only holding does, 300 ms later where a second press may follow.

use std::cmp::Ordering;

/// A pulse shorter than this is noise, ms.
const PULSE_MS: u32 = 5;
/// Held so long, it is a long press, ms.
const LONG_MS: u32 = 1500;
/// Between release and second press of a double one, at most, ms.
const DOUBLE_MS: u32 = 300;
/// A second press may come this much late by repeats, ms: 50 + 100 + 200.
const REPEATS_MS: u32 = 350;
/// Edges a button may have in a second.
const EDGES_A_SECOND: usize = 20;
/// How long a button that has more is not listened to, ms.
const MUTE_MS: u32 = 5000;
/// Facts remembered a button: more than a second of the fastest pressing.
const MEMORY: usize = 48;
/// Farther back than any repeat comes: the board's clock was set anew, ms.
const RESTART_MS: i32 = 10_000;

/// Which kinds of presses of a button mean something besides the short one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wanted {
    /// Holding it.
    pub long: bool,
    /// Pressing it twice.
    pub double: bool,
}

/// What kind of press it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Once.
    Short,
    /// Held for 1.5 s.
    Long,
    /// Twice within 300 ms: both presses.
    Double,
}

/// What came of listening.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Press {
    /// A button, from 1, was pressed.
    Done(u8, Kind),
    /// It chatters: nothing is heard from it for 5 s. `false`: it is listened to again.
    Muted(u8, bool),
}

/// What was heard about a button.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fact {
    Down,
    Up,
    IsDown,
    IsUp,
}

/// The buttons of one board.
#[derive(Debug)]
pub struct Presses {
    buttons: Vec<Button>,
    /// Board clock of the last thing heard.
    last: Option<u32>,
}

impl Presses {
    /// Up to 32 buttons, numbered from 1; those past the end of `wanted` only have short presses.
    pub fn new(wanted: &[Wanted]) -> Self {
        let button = |k: usize| Button::new(wanted.get(k).copied().unwrap_or_default());
        Self { buttons: (0..32).map(button).collect(), last: None }
    }

    /// An edge of `button` (from 1) at board time `at`.
    pub fn edge(&mut self, button: u8, down: bool, at: u32, out: &mut Vec<Press>) {
        self.hear(at, out);
        let index = usize::from(button).wrapping_sub(1);
        if let Some(own) = self.buttons.get_mut(index) {
            own.learn(if down { Fact::Down } else { Fact::Up }, at, button, out);
        }
    }

    /// The truth about all buttons at board time `at`: bit n-1 for button n.
    pub fn state(&mut self, mask: u32, at: u32, out: &mut Vec<Press>) {
        self.hear(at, out);
        for (index, own) in self.buttons.iter_mut().enumerate() {
            let fact = if mask >> index & 1 == 1 { Fact::IsDown } else { Fact::IsUp };
            own.learn(fact, at, index as u8 + 1, out);
        }
    }

    /// It is `now` on the board, as far as can be told; never ahead of it.
    pub fn tick(&mut self, now: u32, out: &mut Vec<Press>) {
        for (index, own) in self.buttons.iter_mut().enumerate() {
            own.tick(now, index as u8 + 1, out);
        }
    }

    /// The board is out of reach: everything is released. Presses that were going on are told as they were. What was
    /// heard is remembered: it may be sent again when the same board is back.
    pub fn let_go(&mut self, out: &mut Vec<Press>) {
        for (index, own) in self.buttons.iter_mut().enumerate() {
            own.let_go(index as u8 + 1, out);
        }
    }

    /// The board has begun anew, its clock too: everything is released and forgotten. A button that was down and still
    /// is when the board is back has not been pressed again.
    pub fn release(&mut self, out: &mut Vec<Press>) {
        self.let_go(out);
        self.last = None;
        for own in &mut self.buttons {
            own.facts.clear();
            own.base = false;
        }
    }

    /// Bit n-1 for every button n that is held down.
    pub fn held(&self) -> u32 {
        let bit = |(index, own): (usize, &Button)| u32::from(own.is_down) << index;
        self.buttons.iter().enumerate().map(bit).sum()
    }

    fn hear(&mut self, at: u32, out: &mut Vec<Press>) {
        if self.last.is_some_and(|last| later(last, at) > RESTART_MS) {
            self.release(out);
        }
        if self.last.is_none_or(|last| later(at, last) > 0) {
            self.last = Some(at);
        }
    }
}

/// How much later `a` is than `b`, ms, on a clock that wraps.
fn later(a: u32, b: u32) -> i32 {
    a.wrapping_sub(b) as i32
}

/// What is known about the press that is going on, or just was.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Going {
    /// Nothing.
    Idle,
    /// Down since then, or longer where the edge is not known; not told yet. `second`: of a double press.
    Down { since: u32, edge: bool, second: bool },
    /// Told, and still down.
    Told,
    /// Released then; a second press may follow.
    Between { until: u32 },
}

#[derive(Debug)]
struct Button {
    wanted: Wanted,
    /// In the board's order.
    facts: Vec<(u32, Fact)>,
    /// Whether it was down before the first fact that is remembered.
    base: bool,
    is_down: bool,
    /// It was down when the board got out of reach.
    was_down: bool,
    /// The first thing heard is no news.
    fresh: bool,
    going: Going,
    muted: Option<u32>,
}

impl Button {
    fn new(wanted: Wanted) -> Self {
        Self {
            wanted,
            facts: Vec::with_capacity(MEMORY + 1),
            base: false,
            is_down: false,
            was_down: false,
            fresh: true,
            going: Going::Idle,
            muted: None,
        }
    }

    fn let_go(&mut self, number: u8, out: &mut Vec<Press>) {
        match self.going {
            Going::Down { second: true, .. } => out.push(Press::Done(number, Kind::Double)),
            Going::Down { .. } | Going::Between { .. } => out.push(Press::Done(number, Kind::Short)),
            Going::Idle | Going::Told => {}
        }
        self.was_down |= self.is_down;
        (self.is_down, self.going, self.muted) = (false, Going::Idle, None);
    }

    fn learn(&mut self, fact: Fact, at: u32, number: u8, out: &mut Vec<Press>) {
        if self.facts.is_empty() {
            // what was down when we began to listen, or stopped to, is no new press
            let known = match fact {
                Fact::IsDown | Fact::Up => self.fresh || self.was_down,
                Fact::Down | Fact::IsUp => false,
            };
            (self.base, self.fresh) = (known, false);
            self.going = if known { Going::Told } else { Going::Idle };
        }
        self.was_down = false;
        let not_after = |known: &(u32, Fact)| order(*known, (at, fact)) != Ordering::Greater;
        let place = self.facts.iter().rposition(not_after).map_or(0, |before| before + 1);
        if self.facts.contains(&(at, fact)) || (place == 0 && self.facts.len() == MEMORY) {
            return; // known, or too old to know
        }
        let before = self.count();
        self.facts.insert(place, (at, fact));
        let new = self.count() > before;
        let newest = place + 1 == self.facts.len();
        let joins = self.facts[place + 1..].iter().all(|(_, later)| later.is_down());
        if self.facts.len() > MEMORY {
            self.base = self.facts.remove(0).1.is_down();
        }
        let (last, is_down) = self.facts.last().map_or((at, self.base), |&(t, f)| (t, f.is_down()));
        self.is_down = is_down;
        self.mute(at, number, out);
        if self.muted.is_some() {
            self.going = Going::Told;
            return;
        }
        match &mut self.going {
            _ if new && newest => {
                // where it was down still, its release was missed
                self.close(at, number, out);
                let second = self.follows(at, number, out);
                self.going = Going::Down { since: at, edge: fact == Fact::Down, second };
            }
            // a press before the one that is going on
            _ if new => out.push(Press::Done(number, Kind::Short)),
            // this is when the one that is going on began
            Going::Down { since, edge, .. } if fact == Fact::Down && joins => (*since, *edge) = (at, true),
            _ => {}
        }
        if !self.is_down {
            self.close(last, number, out);
        }
        self.tick(last, number, out);
    }

    /// Whether a press at `at` is the second of a double one; a first one without a second is told.
    fn follows(&mut self, at: u32, number: u8, out: &mut Vec<Press>) -> bool {
        let Going::Between { until } = self.going else { return false };
        let second = later(at, until) <= DOUBLE_MS as i32;
        if !second {
            out.push(Press::Done(number, Kind::Short));
        }
        second
    }

    /// How many presses the facts show.
    fn count(&self) -> usize {
        let (mut down, mut presses) = (self.base, 0);
        for &(_, fact) in &self.facts {
            presses += usize::from(match fact {
                Fact::Down => true,
                Fact::Up | Fact::IsDown => !down,
                Fact::IsUp => false,
            });
            down = fact.is_down();
        }
        presses
    }

    /// More edges than a hand makes: not listened to for a while.
    fn mute(&mut self, at: u32, number: u8, out: &mut Vec<Press>) {
        if let Some(since) = self.muted {
            if later(at, since) > MUTE_MS as i32 {
                self.muted = None;
                out.push(Press::Muted(number, false));
            }
            return;
        }
        let edges = self.facts.iter().filter(|(_, fact)| matches!(fact, Fact::Down | Fact::Up));
        let edges: usize = edges.filter(|(t, _)| (0..1000).contains(&later(at, *t))).count();
        if edges > EDGES_A_SECOND {
            self.muted = Some(at);
            out.push(Press::Muted(number, true));
        }
    }

    /// It is up again.
    fn close(&mut self, until: u32, number: u8, out: &mut Vec<Press>) {
        let Going::Down { since, edge, second } = self.going else {
            if self.going == Going::Told {
                self.going = Going::Idle;
            }
            return;
        };
        let (held, kind) = (later(until, since), if second { Kind::Double } else { Kind::Short });
        self.going = Going::Idle;
        if edge && held < PULSE_MS as i32 {
            return;
        }
        if self.wanted.long && held >= LONG_MS as i32 {
            if second {
                out.push(Press::Done(number, Kind::Short));
            }
            out.push(Press::Done(number, Kind::Long));
        } else if self.wanted.double && !second {
            self.going = Going::Between { until };
        } else {
            out.push(Press::Done(number, kind));
        }
    }

    fn tick(&mut self, now: u32, number: u8, out: &mut Vec<Press>) {
        if self.muted.is_some_and(|since| later(now, since) > MUTE_MS as i32) {
            self.muted = None;
            out.push(Press::Muted(number, false));
        }
        match self.going {
            Going::Down { since, second, .. } => {
                let held = later(now, since);
                let soon = !self.wanted.long && !self.wanted.double && held >= PULSE_MS as i32;
                if soon {
                    self.going = Going::Told;
                    out.push(Press::Done(number, Kind::Short));
                } else if self.wanted.long && held >= LONG_MS as i32 {
                    self.going = Going::Told;
                    if second {
                        out.push(Press::Done(number, Kind::Short));
                    }
                    out.push(Press::Done(number, Kind::Long));
                }
            }
            Going::Between { until } if later(now, until) > (DOUBLE_MS + REPEATS_MS) as i32 => {
                self.going = Going::Idle;
                out.push(Press::Done(number, Kind::Short));
            }
            _ => {}
        }
    }
}

impl Fact {
    /// Whether the button is down after it.
    fn is_down(self) -> bool {
        matches!(self, Fact::Down | Fact::IsDown)
    }
}

/// The board's order. In one millisecond a state stands before the edge it does not know of, and after the one it does.
fn order(a: (u32, Fact), b: (u32, Fact)) -> Ordering {
    let rank = |fact: Fact, other: Fact| match (fact, other) {
        (Fact::IsUp, Fact::Down) | (Fact::IsDown, Fact::Up) => -1,
        (Fact::IsDown, Fact::Down) | (Fact::IsUp, Fact::Up) => 1,
        _ => 0,
    };
    later(a.0, b.0).cmp(&0).then_with(|| match (rank(a.1, b.1), rank(b.1, a.1)) {
        (0, other) => 0.cmp(&other),
        (own, _) => own.cmp(&0),
    })
}
