//! VBP/1 on the wire: `$` BODY `*` CRC LF, bytes → messages and back. Pure: no clock, no port.
//!
//! BODY = SEQ SP VERB {SP ARG}. A `$` starts a new frame wherever it stands, in a poisoned line too. A byte outside
//! 0x20-0x7E, CR and LF poisons its line until LF, as does a line of more than 96 bytes. A bare line is console text;
//! it may end with CR alone, as terminals send it. Everything dropped is counted by its cause.

use std::fmt::{self, Display};

/// A whole frame with `$` and LF, bytes.
pub const LONGEST: usize = 96;

const CRC: crc::Crc<u16> = crc::Crc::<u16>::new(&crc::CRC_16_IBM_3740);

/// CRC-16/IBM-3740 of a body.
pub fn checksum(body: &[u8]) -> u16 {
    CRC.checksum(body)
}

/// What boards and show controllers say.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Heard {
    /// A board presents itself.
    Hello {
        /// Protocol number.
        proto: u32,
        /// Serial number of the board.
        id: u32,
        /// Version of its program.
        firmware: String,
        /// How many buttons it has, numbered from 1.
        buttons: u8,
        /// How many encoders.
        encoders: u8,
        /// Bit mask: 1 encoder, 2 battery, 4 LED, 8 haptics.
        caps: u32,
    },
    /// A button's edge.
    Button {
        /// Which, from 1.
        number: u8,
        /// Pressed or released.
        down: bool,
        /// Board clock, ms modulo 2³².
        at: u32,
    },
    /// An encoder turned.
    Encoder {
        /// Which, from 1.
        number: u8,
        /// Steps since the last message.
        delta: i32,
        /// Where it stands now.
        position: i32,
        /// Board clock, ms modulo 2³².
        at: u32,
    },
    /// The battery.
    Battery {
        /// Voltage, mV.
        millivolt: u32,
        /// Charge, percent.
        percent: u8,
        /// `C`harging, `D`ischarging, `F`ull or `?`.
        state: char,
        /// Board clock, ms modulo 2³².
        at: u32,
    },
    /// The truth about all buttons.
    State {
        /// Bit n-1 is set while button n is down (hexadecimal on the wire, as the other masks are).
        mask: u32,
        /// Board clock, ms modulo 2³².
        at: u32,
    },
    /// Something is wrong with the board.
    Error {
        /// Its own code.
        code: String,
        /// What it says.
        text: String,
    },
    /// A controller asks for a style.
    SetStyle(String),
    /// A controller asks for a scene.
    SetScene(String),
    /// A controller asks for a snapshot.
    Shot,
    /// A controller asks for standby, or its end.
    Standby(bool),
    /// A controller asks for an answer.
    Ping,
}

/// What the visor says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Said<'a> {
    /// Who is there? Protocol numbers that are understood, lowest and highest.
    Hi(u32, u32),
    /// The handshake's end: protocol, the visor's version.
    Ok(u32, &'a str),
    /// The board's protocol is not among those from the lowest to the highest.
    No(u32, u32),
    /// Message number so was heard.
    Ack(u8),
    /// Message number so will not be done, and why.
    Nak(u8, &'a str),
    /// What a press did.
    Act {
        /// The button, from 1.
        button: u8,
        /// Name of the action.
        action: &'a str,
        /// Whether it was done.
        outcome: Outcome,
        /// Sequence number of the frame in which it shows.
        frame: u64,
    },
    /// The visor is alive.
    Beat {
        /// Seconds since it started.
        up_s: u64,
        /// `RUN`, `DEGRADED`, `NOCAM`, `NODISP` or `STANDBY`.
        mode: &'a str,
        /// Tenths of frames shown a second.
        fps10: u32,
        /// Markers tracked.
        tracked: usize,
        /// Style in front.
        style: &'a str,
        /// A bit a fault.
        faults: u32,
    },
    /// Markers tracked: how many, and id and quality 0-99 of as many as the line holds.
    Tracked(usize, &'a [(u32, u8)]),
    /// Another style is in front.
    Style(&'a str),
    /// A fault came or went: its code, the visor's clock in ms.
    Fault(bool, u32, u64),
}

/// What came of an action.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Done.
    Ok,
    /// The button has no such meaning now.
    Ignored,
    /// It failed.
    Error,
}

impl Display for Said<'_> {
    /// Verb and arguments. Names are the visor's own: words without spaces.
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match *self {
            Said::Hi(low, high) => write!(f, "HI? {low} {high}"),
            Said::Ok(proto, version) => write!(f, "OK {proto} {version}"),
            Said::No(low, high) => write!(f, "NO {low} {high}"),
            Said::Ack(seq) => write!(f, "ACK {seq:02X}"),
            Said::Nak(seq, reason) => write!(f, "NAK {seq:02X} {reason}"),
            Said::Act { button, action, outcome, frame } => {
                let outcome = match outcome {
                    Outcome::Ok => "ok",
                    Outcome::Ignored => "ign",
                    Outcome::Error => "err",
                };
                write!(f, "ACT {button} {action} {outcome} {frame}")
            }
            Said::Beat { up_s, mode, fps10, tracked, style, faults } => {
                write!(f, "HB {up_s} {mode} {fps10} {tracked} {style} {faults:08X}")
            }
            Said::Tracked(count, markers) => {
                write!(f, "TRK {count}")?;
                markers.iter().try_for_each(|(id, quality)| write!(f, " {id}:{quality}"))
            }
            Said::Style(name) => write!(f, "STYLE {name}"),
            Said::Fault(came, code, at) => write!(f, "FLT {} {code} {at}", if came { '+' } else { '-' }),
        }
    }
}

/// The frame of a message with sequence number `seq`. Arguments that would make it too long, or that hold bytes a frame
/// may not, are left out from there on.
pub fn frame(seq: u8, message: &impl Display) -> String {
    let mut body = format!("{seq:02X}");
    let text = message.to_string();
    for word in text.split(' ') {
        let sound = word.bytes().all(|b| (0x21..=0x7e).contains(&b) && b != b'$' && b != b'*');
        // `$`, a space, `*`, four digits, LF
        if !sound || word.is_empty() || body.len() + word.len() + 8 > LONGEST {
            break;
        }
        body.push(' ');
        body.push_str(word);
    }
    format!("${body}*{:04X}\n", checksum(body.as_bytes()))
}

/// What a line turned out to be.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Line {
    /// A checked message. `heard` is `None` for a verb or arguments that this version does not know.
    Message {
        /// The sender's number for it.
        seq: u8,
        /// Of the body: with `seq` it tells a repeat.
        crc: u16,
        /// What it says.
        heard: Option<Heard>,
    },
    /// A technician typed this.
    Text(String),
}

/// How often something was dropped, and why.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Dropped {
    /// Lines with bytes that do not belong on the wire.
    pub poisoned: u64,
    /// Lines of more than 96 bytes.
    pub too_long: u64,
    /// Lines that another frame's `$` cut off.
    pub cut: u64,
    /// Frames without `*` and four digits, or without number and verb.
    pub malformed: u64,
    /// Frames whose checksum is not their body's.
    pub bad_crc: u64,
    /// Checked messages with an unknown verb.
    pub unknown: u64,
    /// Checked messages whose arguments make no sense.
    pub bad_args: u64,
    /// Arguments more than this version knows.
    pub extra_args: u64,
}

/// The receiver: takes bytes, gives lines.
#[derive(Debug, Default)]
pub struct Wire {
    line: Vec<u8>,
    poisoned: bool,
    /// A CR that LF must follow.
    cr: bool,
    /// How many positions a STATE holds: as the last HELLO said.
    encoders: Option<u8>,
    dropped: Dropped,
}

impl Wire {
    /// What was dropped so far.
    pub fn dropped(&self) -> Dropped {
        self.dropped
    }

    /// Forgets the line begun: the port was closed.
    pub fn reset(&mut self) {
        self.line.clear();
        (self.poisoned, self.cr) = (false, false);
    }

    /// Takes one byte; the line that it ends, if there is anything in it to know.
    pub fn push(&mut self, byte: u8) -> Option<Line> {
        match byte {
            b'$' => {
                self.dropped.cut += u64::from(!self.line.is_empty());
                self.reset();
                self.line.push(byte);
                None
            }
            b'\n' => self.end(),
            b'\r' if !self.poisoned && !self.line.starts_with(b"$") => self.end(),
            b'\r' if !self.cr => {
                self.cr = true;
                None
            }
            0x20..=0x7e if !self.cr => {
                if self.poisoned {
                    return None;
                }
                // LF makes it one more
                if self.line.len() + 1 == LONGEST {
                    self.dropped.too_long += 1;
                    self.poison();
                } else {
                    self.line.push(byte);
                }
                None
            }
            _ => {
                if !self.poisoned {
                    self.dropped.poisoned += 1;
                    self.poison();
                }
                None
            }
        }
    }

    fn poison(&mut self) {
        self.line.clear();
        self.poisoned = true;
    }

    fn end(&mut self) -> Option<Line> {
        let line = std::mem::take(&mut self.line);
        let read = if self.poisoned { None } else { self.read(&line) };
        self.line = line;
        self.reset();
        read
    }

    fn read(&mut self, line: &[u8]) -> Option<Line> {
        match line {
            [] | [b'#', ..] => None,
            [b'$', frame @ ..] => self.message(frame),
            text => Some(Line::Text(String::from_utf8_lossy(text).trim().to_owned()))
                .filter(|t| *t != Line::Text(String::new())),
        }
    }

    fn message(&mut self, frame: &[u8]) -> Option<Line> {
        let frame = str::from_utf8(frame).ok()?;
        let parts = frame.split_once('*').and_then(|(body, crc)| {
            let (seq, rest) = body.split_once(' ')?;
            Some((body, hex(seq, 2)? as u8, rest, hex(crc, 4)? as u16))
        });
        let Some((body, seq, rest, crc)) = parts else {
            self.dropped.malformed += 1;
            return None;
        };
        if checksum(body.as_bytes()) != crc {
            self.dropped.bad_crc += 1;
            return None;
        }
        let (verb, args) = rest.split_once(' ').unwrap_or((rest, ""));
        let mut args = Args { rest: args };
        let heard = match read_verb(verb, &mut args, self.encoders) {
            None => {
                self.dropped.unknown += 1;
                None
            }
            Some(None) => {
                self.dropped.bad_args += 1;
                None
            }
            Some(heard) => {
                self.dropped.extra_args += args.left();
                if let Some(Heard::Hello { encoders, .. }) = heard {
                    self.encoders = Some(encoders);
                }
                heard
            }
        };
        Some(Line::Message { seq, crc, heard })
    }
}

/// `digits` upper-case hexadecimal digits.
fn hex(text: &str, digits: usize) -> Option<u32> {
    let good = |b: u8| matches!(b, b'0'..=b'9' | b'A'..=b'F');
    (text.len() == digits && text.bytes().all(good)).then(|| u32::from_str_radix(text, 16).ok())?
}

/// A hexadecimal mask of one to eight digits.
fn mask(text: &str) -> Option<u32> {
    if text.len() > 8 { None } else { hex(text, text.len()) }
}

/// The arguments of a message, one after the other.
struct Args<'a> {
    rest: &'a str,
}

impl<'a> Args<'a> {
    fn word(&mut self) -> Option<&'a str> {
        let (word, rest) = self.rest.split_once(' ').unwrap_or((self.rest, ""));
        self.rest = rest;
        Some(word).filter(|word| !word.is_empty())
    }

    /// A whole number, digits only but for a sign.
    fn number<T: std::str::FromStr>(&mut self) -> Option<T> {
        self.word().filter(|word| !word.starts_with('+')).and_then(|word| word.parse().ok())
    }

    /// Which button or encoder, from 1.
    fn which(&mut self) -> Option<u8> {
        self.number().filter(|number| (1..=32).contains(number))
    }

    fn left(&self) -> u64 {
        self.rest.split(' ').filter(|word| !word.is_empty()).count() as u64
    }
}

/// `None` for an unknown verb, `Some(None)` for arguments that make no sense.
fn read_verb(verb: &str, args: &mut Args, encoders: Option<u8>) -> Option<Option<Heard>> {
    Some(match verb {
        "HELLO" => (|| {
            Some(Heard::Hello {
                proto: args.number()?,
                id: hex(args.word()?, 8)?,
                firmware: args.word()?.to_owned(),
                buttons: args.number().filter(|&n| n <= 32)?,
                encoders: args.number().filter(|&n| n <= 32)?,
                caps: mask(args.word()?)?,
            })
        })(),
        "BTN" => (|| {
            let number = args.which()?;
            let down = match args.word()? {
                "D" => true,
                "U" => false,
                _ => return None,
            };
            Some(Heard::Button { number, down, at: args.number()? })
        })(),
        "ENC" => (|| {
            let (number, delta) = (args.which()?, args.number()?);
            Some(Heard::Encoder { number, delta, position: args.number()?, at: args.number()? })
        })(),
        "BAT" => (|| {
            let (millivolt, percent) = (args.number()?, args.number().filter(|&percent| percent <= 100)?);
            let state = args.word()?.chars().next().filter(|c| "CDF?".contains(*c))?;
            Some(Heard::Battery { millivolt, percent, state, at: args.number()? })
        })(),
        // mask, a position for every encoder, time; before any HELLO the last number is the time
        "STATE" => (|| {
            let mask = mask(args.word()?)?;
            let positions = encoders.map_or(args.left().saturating_sub(1), u64::from);
            for _ in 0..positions {
                args.number::<i32>()?;
            }
            Some(Heard::State { mask, at: args.number()? })
        })(),
        "ERR" => (|| {
            let code = args.word()?.to_owned();
            let text = std::mem::take(&mut args.rest).to_owned();
            Some(Heard::Error { code, text })
        })(),
        "SET" => (|| match (args.word()?, args.word()?.to_owned()) {
            ("style", name) => Some(Heard::SetStyle(name)),
            ("scene", name) => Some(Heard::SetScene(name)),
            _ => None,
        })(),
        "SHOT" => Some(Heard::Shot),
        "STANDBY" => (|| match args.word()? {
            "on" => Some(Heard::Standby(true)),
            "off" => Some(Heard::Standby(false)),
            _ => None,
        })(),
        "PING" => {
            args.rest = "";
            Some(Heard::Ping)
        }
        _ => return None,
    })
}
