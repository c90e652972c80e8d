//! Buttons on a serial line: the specification's samples, what edges and states make of presses, the conversation.

use std::time::Duration;
use vernissage::buttons::{
    Ask, Config, Console, Heard, Kind, Line, Link, Mode, Outcome, Press, Presses, Said, Status, Wanted, Wire,
    checksum, frame,
};

fn lines(wire: &mut Wire, bytes: &[u8]) -> Vec<Line> {
    bytes.iter().filter_map(|&byte| wire.push(byte)).collect()
}

fn heard(text: &str) -> (u8, Option<Heard>) {
    match &lines(&mut Wire::default(), text.as_bytes())[..] {
        [Line::Message { seq, heard, .. }] => (*seq, heard.clone()),
        other => panic!("{text}: {other:?}"),
    }
}

/// A frame with the checksum it needs.
fn framed(body: &str) -> String {
    format!("${body}*{:04X}\n", checksum(body.as_bytes()))
}

#[test]
fn the_samples_of_the_specification() {
    assert_eq!(checksum(b"123456789"), 0x29b1);
    let hello = Heard::Hello {
        proto: 1,
        id: 0x5f3a_01c2,
        firmware: "1.4.0".into(),
        buttons: 3,
        encoders: 1,
        caps: 3,
    };
    for (text, expected) in [
        ("$00 HELLO 1 5F3A01C2 1.4.0 3 1 0003*9F94\n", (0, hello)),
        ("$01 BTN 1 D 48213*0C31\n", (1, Heard::Button { number: 1, down: true, at: 48213 })),
        ("$02 BTN 1 U 48377*BD1C\r\n", (2, Heard::Button { number: 1, down: false, at: 48377 })),
        ("$04 STATE 0 118 49000*B546\n", (4, Heard::State { mask: 0, at: 49000 })),
    ] {
        assert_eq!(heard(text), (expected.0, Some(expected.1)), "{text}");
    }
    let act = Said::Act { button: 1, action: "style-next", outcome: Outcome::Ok, frame: 91822 };
    for (seq, said, text) in [
        (0, Said::Hi(1, 1), "$00 HI? 1 1*2323\n"),
        (2, Said::Ack(1), "$02 ACK 01*4E54\n"),
        (3, act, "$03 ACT 1 style-next ok 91822*2670\n"),
    ] {
        assert_eq!(frame(seq, &said), text);
    }
}

#[test]
fn all_that_is_said_fits_and_is_framed() {
    let markers: Vec<(u32, u8)> = (0..60).map(|k| (500 + k, 99)).collect();
    for said in [
        Said::Ok(1, "0.1.0"),
        Said::No(1, 1),
        Said::Nak(255, "unknown-style"),
        Said::Beat { up_s: 86400, mode: "RUN", fps10: 299, tracked: 2, style: "cartoon", faults: 0x101 },
        Said::Tracked(60, &markers),
        Said::Style("bilateral-cartoon"),
        Said::Fault(true, 8, 123_456),
    ] {
        let line = frame(0xab, &said);
        assert!(line.len() <= 96 && line.ends_with('\n'), "{line}");
        let (body, crc) = line[1..line.len() - 1].split_once('*').expect("a checksum");
        assert_eq!(format!("{:04X}", checksum(body.as_bytes())), crc);
        assert!(format!("AB {said}").starts_with(body), "{line}");
    }
    assert!(frame(0, &Said::Tracked(60, &markers)).starts_with("$00 TRK 60 500:99 501:99 502:99"));
    assert_eq!(
        frame(0, &Said::Beat { up_s: 7, mode: "RUN", fps10: 301, tracked: 1, style: "plain", faults: 1 }),
        framed("00 HB 7 RUN 301 1 plain 00000001")
    );
    assert_eq!(frame(1, &Said::Fault(false, 3, 9)), framed("01 FLT - 3 9"));
    assert_eq!(frame(0, &Said::Style("a$b")), framed("00 STYLE"), "a name cannot break the frame");
}

#[test]
fn lines_are_dropped_for_what_is_wrong_with_them() {
    let good = framed("07 BTN 2 U 5");
    let expect = |bytes: &[u8], count: usize| {
        let mut wire = Wire::default();
        let found = lines(&mut wire, &[bytes, good.as_bytes()].concat());
        assert_eq!(found.len(), count + 1, "{}", String::from_utf8_lossy(bytes));
        wire.dropped()
    };
    assert_eq!(expect(b"$01 BTN 1 D 48213*0C32\n", 0).bad_crc, 1);
    for bad in [
        "$01 BTN 1 D 48213\n",
        "$01 BTN 1 D 48213*0c31\n",
        "$*FFFF\n",
        "$01*1234\n",
        "$1 HI*0000\n",
        "$01 BTN 1 D 48213*0C31 \n",
        "$\n",
        "$01 BTN*1 D 48213*0C31\n",
    ] {
        assert_eq!(expect(bad.as_bytes(), 0).malformed, 1, "{bad}");
    }
    assert_eq!(expect(b"$01 BTN 1 D\x07 48213*0C31\n", 0).poisoned, 1);
    assert_eq!(expect(b"$01 BTN 1 D\xff 48213*0C31\n\n", 0).poisoned, 1);
    assert_eq!(expect(b"$01 BTN 1 D\r 48213*0C31\n", 0).poisoned, 1, "CR stands before LF");
    assert_eq!(expect(b"\x80\x81 noise \n", 0).poisoned, 1);
    // a `$` always starts a new frame
    assert_eq!(expect(b"$01 BTN 1 ", 0).cut, 1);
    assert_eq!(expect(b"text", 0).cut, 1);
    assert_eq!(expect(b"\xff\xff", 0).poisoned, 1);
    // 96 bytes with `$` and LF are good, 97 are not
    let long = |length: usize| framed(&format!("01 PING {}", "x".repeat(length - 8 - 7)));
    assert_eq!((long(96).len(), expect(long(96).as_bytes(), 1).too_long), (96, 0));
    assert_eq!((long(97).len(), expect(long(97).as_bytes(), 0).too_long), (97, 1));
    assert_eq!(expect(&[b'x'; 5000], 0).too_long, 1);
    // unknown verbs and what is too much are counted and ignored
    assert_eq!(expect(framed("01 DANCE 1").as_bytes(), 1).unknown, 1);
    assert_eq!(expect(framed("01 BTN 1 D 7 8 9").as_bytes(), 1).extra_args, 2);
    for bad in [
        "BTN 0 D 7",
        "BTN 33 D 7",
        "BTN 1 X 7",
        "BTN 1 D",
        "BTN 1 D -7",
        "BTN 1 D 4294967296",
        "BTN 1  D 7",
        "STATE 0 x 7",
        "STATE 100000000 7",
        "STATE",
        "BAT 3700 101 C 7",
        "STANDBY maybe",
        "SET color x",
        "HELLO 1",
        "ENC 1 +2 7 7",
    ] {
        assert_eq!(expect(framed(&format!("01 {bad}")).as_bytes(), 1).bad_args, 1, "{bad}");
    }
    assert_eq!(heard(&framed("01 BTN 1 D 7 8 9")).1, Some(Heard::Button { number: 1, down: true, at: 7 }));
    // comments are nothing, bare lines are console text, ended in any way
    expect(b"# $ is no frame here\n# a\r\n\n\r\n", 0);
    let text = lines(&mut Wire::default(), b"help\rstatus\r\n press 1 \n");
    assert_eq!(text, ["help", "status", "press 1"].map(|text| Line::Text(text.into())));
}

#[test]
fn a_state_has_as_many_positions_as_the_board_has_encoders() {
    let mut wire = Wire::default();
    let mut state = |body: &str| match lines(&mut wire, framed(body).as_bytes()).pop() {
        Some(Line::Message { heard: Some(Heard::State { mask, at }), .. }) => Some((mask, at)),
        _ => None,
    };
    assert_eq!(state("00 STATE 1F 118 -3 49000"), Some((0x1f, 49000)), "the last, as long as nobody said");
    assert_eq!(state("01 HELLO 1 5F3A01C2 1.4.0 3 1 0003"), None);
    assert_eq!(state("02 STATE A 118 49000 77"), Some((10, 49000)), "what follows is of a later version");
    assert_eq!(state("03 STATE A 118"), None);
}

// ---------------------------------------------------------------- presses

const ALL: Wanted = Wanted { long: true, double: true };

/// What button 1 does with these steps: `D5` edge down, `U5` edge up, `S5` state down, `R5` state up, `T5` time.
fn presses(wanted: Wanted, steps: &str) -> Vec<Press> {
    let (mut presses, mut out) = (Presses::new(&[wanted]), Vec::new());
    for step in steps.split_whitespace() {
        let at = step[1..].parse().expect("a time");
        match &step[..1] {
            "D" => presses.edge(1, true, at, &mut out),
            "U" => presses.edge(1, false, at, &mut out),
            "S" => presses.state(1, at, &mut out),
            "R" => presses.state(0, at, &mut out),
            "X" => presses.release(&mut out),
            _ => presses.tick(at, &mut out),
        }
    }
    out
}

#[test]
fn presses_are_short_long_or_double() {
    use Kind::{Double, Long, Short};
    let only = |long, double| Wanted { long, double };
    for (wanted, steps, kinds) in [
        // told at once where nothing else can follow
        (only(false, false), "D100 T104", vec![]),
        (only(false, false), "D100 T105", vec![Short]),
        (only(false, false), "D100 T105 U3000 R3000 D3100 U3200", vec![Short, Short]),
        (only(true, false), "D100 T1599", vec![]),
        (only(true, false), "D100 T1599 U1599", vec![Short]),
        (only(true, false), "D100 T1600 U1700", vec![Long]),
        (only(true, false), "D100 U1600", vec![Long]),
        (only(true, false), "D100 S1600", vec![Long]),
        (ALL, "D100 U200 T500", vec![]),
        (ALL, "D100 U200 D500 U600", vec![Double]),
        (ALL, "D100 U200 D501 U600 T1300", vec![Short, Short]),
        (ALL, "D100 U200 T851 D900 U950 T1700", vec![Short, Short]),
        (ALL, "D100 U200 D300 U400 D500 U600 T1300", vec![Double, Short]),
        (ALL, "D100 U200 D300 U1900", vec![Short, Long]),
        // noise: a pulse under 5 ms
        (only(true, false), "D100 U104 T9000", vec![]),
        (only(false, false), "D100 U104 T9000", vec![]),
        (only(true, false), "D100 U105", vec![Short]),
        // the clock wraps
        (only(true, false), "D4294967000 U1300", vec![Long]),
        (only(true, false), "D4294967200 U10 D4294967200", vec![Short]),
    ] {
        let expected: Vec<Press> = kinds.into_iter().map(|kind| Press::Done(1, kind)).collect();
        assert_eq!(presses(wanted, steps), expected, "{steps}");
    }
}

#[test]
fn every_press_counts_once_however_it_shows() {
    let long = Wanted { long: true, double: false };
    for (steps, count) in [
        ("R0 D5 S6 U90 R91", 1),
        ("R0 S6 U90 D5 R91", 1),
        ("R0 U90 D5", 1),
        ("R0 R91 U90 D5", 1),
        ("R0 R91 D5 U90", 1),
        ("R0 S6 R91", 1),
        ("R0 S88 U90", 1),
        ("R0 D5 D40 U90", 2),
        ("R0 D5 D40 U30 U90", 2),
        ("R0 D40 U30 D5 U90", 2),
        ("R0 S6 D40 D5 U30 U90", 2),
        ("R0 U30 U90", 2),
        ("R5 D5 S5 U90 R90", 1),
        ("R0 D5 U90 D5 U90 R91 D5", 1),
        // held before anyone listened, or while nobody could: no press
        ("S0 U50", 0),
        ("S0 R50 D60 U90", 1),
        ("U50", 0),
        ("R0 D5 S6 X0 S9000 U9100", 1),
        ("R0 D5 X0 U9100", 1),
        ("R0 D5 X0 D9000 U9100", 2),
        ("R0 X0 S9000 U9100", 1),
        // a board that began anew
        ("R99000 D99100 U99200 R5 D10 U90", 2),
        // sent again long after
        ("R0 D5 U90 D200 U290 D400 U490 D5 U90 D200", 3),
    ] {
        assert_eq!(presses(long, steps).len(), count, "{steps}: {:?}", presses(long, steps));
    }
}

#[test]
fn a_button_that_chatters_is_not_listened_to_for_5_s() {
    let mut steps = String::from("R0 ");
    for k in 0..40 {
        steps += &format!("D{} U{} ", 100 + k * 40, 120 + k * 40);
    }
    let out = presses(Wanted::default(), &steps);
    // the 21st edge is the 11th press's first, and not told
    let counted = |out: &[Press]| out.iter().filter(|press| matches!(press, Press::Done(..))).count();
    assert_eq!((counted(&out), out.last()), (10, Some(&Press::Muted(1, true))), "{out:?}");
    let out = presses(Wanted::default(), &(steps.clone() + "D5400 U5500 T5501 D5600 U5700"));
    assert_eq!(out[11..], [Press::Muted(1, false), Press::Done(1, Kind::Short)]);
    assert_eq!(
        counted(&presses(
            Wanted::default(),
            "R0 D100 U150 D200 U250 D300 U350 D400 U450 D500 U550 D600 U650"
        )),
        6
    );
}

// ---------------------------------------------------------------- the link

fn ms(value: u64) -> Duration {
    Duration::from_millis(value)
}

const STYLES: [&str; 2] = ["cartoon", "watercolor"];

fn link(config: &Config) -> Link {
    Link::new(config, STYLES.to_vec())
}

/// What the link says now, body by body, without numbers.
fn says(link: &mut Link) -> Vec<String> {
    let text = String::from_utf8(link.output().to_vec()).expect("ASCII");
    link.sent(text.len());
    let body = |line: &str| match line.strip_prefix('$') {
        Some(frame) => frame[3..].split('*').next().unwrap_or("").to_owned(),
        None => line.to_owned(),
    };
    text.lines().map(body).collect()
}

/// What is asked when these bodies arrive.
fn tell(link: &mut Link, bodies: &[&str], now: Duration) -> Vec<Ask> {
    let mut asks = Vec::new();
    for body in bodies {
        link.receive(framed(body).as_bytes(), now, &mut asks);
    }
    asks
}

const HELLO: &str = "00 HELLO 1 5F3A01C2 1.4.0 3 1 0003";

/// A link that is up at `now`, its first words said.
fn up(config: &Config, now: Duration) -> Link {
    let mut link = link(config);
    link.opened(now);
    assert!(tell(&mut link, &[HELLO, "01 STATE 0 0 1000"], now).is_empty() && link.is_up());
    link.tick(now, &mut Vec::new());
    says(&mut link);
    link
}

#[test]
fn the_handshake_and_its_times() {
    let mut link = link(&Config::default());
    assert!(link.wants_port(ms(0)));
    link.opened(ms(10));
    let mut said = Vec::new();
    for now in 10..2000 {
        link.tick(ms(now), &mut Vec::new());
        said.extend(says(&mut link).into_iter().map(|body| (now, body)));
    }
    let hi = |now| (now, "HI? 1 1".to_owned());
    assert_eq!(said, [hi(10), hi(510), hi(1010), hi(1510)]);
    assert!(
        tell(&mut link, &["05 BTN 1 D 7", "06 STATE 1 0 9"], ms(2000)).is_empty()
            && says(&mut link).is_empty()
    );
    assert!(tell(&mut link, &["00 HELLO 2 5F3A01C2 1.4.0 3 1 0003"], ms(2000)).is_empty());
    assert_eq!((link.is_up(), says(&mut link)), (false, vec!["NO 1 1".to_owned()]));
    tell(&mut link, &[HELLO], ms(2100));
    assert!(link.is_up());
    assert_eq!(says(&mut link), [format!("OK 1 {}", env!("CARGO_PKG_VERSION"))]);

    // silence: unchecked bytes are none
    for now in 2100..5100 {
        link.receive(b"$00 BTN 1 D 5*0000\n", ms(now), &mut Vec::new());
        link.tick(ms(now), &mut Vec::new());
        assert!(link.is_up(), "{now}");
    }
    link.tick(ms(5100), &mut Vec::new());
    assert!(!link.is_up());
    // back-off: 100 ms, then twice as long up to 2 s, and from the start after it was up
    let (mut now, mut waits) = (5100, Vec::new());
    for _ in 0..7 {
        let wait = (0..).find(|&wait| link.wants_port(ms(now + wait))).expect("opened again some time");
        waits.push(wait);
        now += wait;
        link.closed(ms(now));
    }
    assert_eq!(waits, [100, 200, 400, 800, 1600, 2000, 2000]);
    now += 2000;
    link.opened(ms(now));
    tell(&mut link, &[HELLO], ms(now));
    link.closed(ms(now));
    assert!(!link.wants_port(ms(now + 99)) && link.wants_port(ms(now + 100)));
}

#[test]
fn edges_are_acknowledged_and_repeats_dropped() {
    let mut link = up(&Config::default(), ms(0));
    let asks =
        tell(&mut link, &["10 BTN 2 D 1100", "10 BTN 2 D 1100", "11 BTN 2 U 1200", "10 BTN 2 D 1100"], ms(5));
    assert_eq!(asks, [Ask::Press(2, Kind::Short)]);
    assert_eq!(says(&mut link), ["ACK 10", "ACK 10", "ACK 11", "ACK 10"]);
    let asks = tell(
        &mut link,
        &[
            "12 SET style watercolor",
            "12 SET style watercolor",
            "13 SET style oil",
            "14 SET scene x",
            "15 SHOT",
            "16 STANDBY on",
            "17 PING x y z",
        ],
        ms(6),
    );
    assert_eq!(asks, [Ask::Style(1), Ask::Standby(true)]);
    assert_eq!(
        says(&mut link),
        [
            "ACK 12",
            "ACK 12",
            "NAK 13 unknown-style",
            "NAK 14 unknown-scene",
            "NAK 15 off",
            "ACK 16",
            "ACK 17"
        ]
    );
    let scenes = vec!["day".to_string(), "night".to_string()];
    let mut offering = Link::new(&Config::default(), STYLES.to_vec()).offering(scenes, true);
    offering.opened(ms(0));
    assert!(tell(&mut offering, &[HELLO], ms(0)).is_empty());
    says(&mut offering);
    let asks = tell(&mut offering, &["20 SET scene night", "21 SET scene noon", "22 SHOT", "22 SHOT"], ms(1));
    assert_eq!(asks, [Ask::Scene(1), Ask::Shot]);
    assert_eq!(says(&mut offering), ["ACK 20", "NAK 21 unknown-scene", "ACK 22", "ACK 22"]);
    // the board's clock goes on by itself until it says the time
    // what cannot be is not believed: a button the board has not, a time that is not now, unless it stays so
    let asks = tell(&mut link, &["30 BTN 4 D 1300", "31 BTN 3 D 9000", "32 BTN 3 D 4294960000"], ms(100));
    assert_eq!((asks, says(&mut link)), (vec![], vec![]));
    // an edge may be an old one that is sent again; states are always new
    let asks = tell(&mut link, &["33 BTN 1 D 5000", "34 STATE 1 0 5000", "33 BTN 1 D 5000"], ms(100));
    assert_eq!((asks, says(&mut link)), (vec![], vec![]));
    let mut asks = tell(&mut link, &["36 STATE 1 0 5000"], ms(100));
    link.tick(ms(1599), &mut asks);
    assert_eq!(asks, []);
    link.tick(ms(1600), &mut asks);
    assert_eq!(asks, [Ask::Press(1, Kind::Long)]);
    assert_eq!(link.held(), 1);
    link.closed(ms(1700));
    assert_eq!(link.held(), 0);
}

#[test]
fn the_visor_tells_how_it_is() {
    let mut link = up(&Config::default(), ms(0));
    let mut status =
        Status { mode: Mode::Degraded, fps10: 298, style: "cartoon", faults: 1, ..Status::default() };
    let mut said = Vec::new();
    for now in (0..3000).step_by(5) {
        // markers come and go all the time
        status.markers = [(7, 90), (3, (now / 5 % 100) as u8)].into_iter().collect();
        link.set_status(status);
        if now % 1000 == 0 {
            tell(&mut link, &[&format!("20 STATE 0 0 {}", 2000 + now)], ms(now));
        }
        link.tick(ms(now), &mut Vec::new());
        said.extend(says(&mut link));
    }
    let count = |verb: &str| said.iter().filter(|body| body.starts_with(verb)).count();
    assert_eq!((count("HB "), count("STYLE cartoon"), count("FLT + 0 ")), (2, 1, 1), "{said:?}");
    assert!((14..=15).contains(&count("TRK 2 7:90 3:")), "at most five a second: {said:?}");
    assert!(said.contains(&"HB 1 DEGRADED 298 2 cartoon 00000001".to_owned()), "{said:?}");
    link.set_status(Status { style: "watercolor", ..Status::default() });
    link.act(1, "style-next", Outcome::Ok, 91822);
    link.tick(ms(3010), &mut Vec::new());
    let said = says(&mut link);
    for body in ["ACT 1 style-next ok 91822", "FLT - 0 3010", "STYLE watercolor"] {
        assert!(said.contains(&body.to_owned()), "{said:?}");
    }
}

#[test]
fn the_console_only_looks_unless_it_may_more() {
    let typed = |console, text: &str| {
        let mut link = up(&Config { console, ..Config::default() }, ms(0));
        let mut asks = Vec::new();
        link.receive(text.as_bytes(), ms(1), &mut asks);
        (asks, says(&mut link))
    };
    for text in ["press 1\n", "style cartoon\r"] {
        let (asks, said) = typed(Console::Read, text);
        assert!(asks.is_empty() && said[0].starts_with("# only with console = \"full\""), "{said:?}");
        assert_eq!(typed(Console::Off, text), (vec![], vec![]));
    }
    assert_eq!(typed(Console::Full, "press 3\n").0, [Ask::Press(3, Kind::Short)]);
    assert_eq!(typed(Console::Full, "style cartoon\n").0, [Ask::Style(0)]);
    assert!(typed(Console::Full, "style oil\n").1.contains(&"# cartoon watercolor".to_owned()));
    for text in ["help\n", "status\n", "watch\n", "nonsense\n"] {
        let (asks, said) = typed(Console::Read, text);
        assert!(
            asks.is_empty() && !said.is_empty() && said.iter().all(|line| line.starts_with("# ")),
            "{said:?}"
        );
    }
    // also while no board is there
    let mut link = link(&Config::default());
    link.opened(ms(0));
    says(&mut link);
    link.receive(b"watch\r\n", ms(0), &mut Vec::new());
    assert_eq!(says(&mut link), ["# watching"]);
    link.tick(ms(1000), &mut Vec::new());
    assert!(says(&mut link).iter().any(|line| line.contains("board silent")));
}
