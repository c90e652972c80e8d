//! Buttons on a line that is late, or that is opened again while a board goes on: what was counted once is not counted
//! again, and what comes late is not taken for broken. A board that began anew is listened to from the start.

use std::time::Duration;
use vernissage::buttons::{Ask, Config, Kind, Link, checksum};

const HELLO: &str = "00 HELLO 1 5F3A01C2 1.4.0 3 1 0003";

fn ms(value: u64) -> Duration {
    Duration::from_millis(value)
}

/// What is asked when these bodies arrive, all at once.
fn tell(link: &mut Link, bodies: &[&str], now: u64) -> Vec<Ask> {
    let mut asks = Vec::new();
    let line = |body: &&str| format!("${body}*{:04X}\n", checksum(body.as_bytes()));
    let bytes: String = bodies.iter().map(line).collect();
    link.receive(bytes.as_bytes(), ms(now), &mut asks);
    link.tick(ms(now), &mut asks);
    link.tick(ms(now + 10), &mut asks);
    asks
}

/// A link that is up since 0 of our clock and 1000 of the board's.
fn up() -> Link {
    let mut link = Link::new(&Config::default(), Vec::new());
    link.opened(ms(0));
    assert!(tell(&mut link, &[HELLO, "01 STATE 0 0 1000"], 0).is_empty() && link.is_up());
    link
}

/// The port ends at `now`, and is open again with a greeted board 110 ms later.
fn again(link: &mut Link, hello: &str, now: u64) -> Vec<Ask> {
    link.closed(ms(now));
    link.opened(ms(now + 100));
    tell(link, &[hello], now + 110)
}

const PRESS: [Ask; 1] = [Ask::Press(2, Kind::Short)];

#[test]
fn an_edge_sent_again_after_another_answer_to_a_greeting_is_no_new_press() {
    // counted by the edge itself, by the state after a lost edge, and by the edge up of a press that is over
    let hello = "15 HELLO 1 5F3A01C2 1.4.0 3 1 0003";
    for (before, after) in [
        (&["10 BTN 2 D 1100"][..], &["10 BTN 2 D 1100", "16 STATE 2 0 1200"][..]),
        (&["11 STATE 2 0 1100"], &["10 BTN 2 D 1100", "16 STATE 2 0 1200"]),
        (&["10 BTN 2 D 1100", "13 STATE 0 0 1150"], &["12 BTN 2 U 1150", "16 STATE 0 0 1200"]),
        (&["11 STATE 2 0 1100", "13 STATE 0 0 1150"], &["10 BTN 2 D 1100", "12 BTN 2 U 1150"]),
    ] {
        let mut link = up();
        assert_eq!(tell(&mut link, before, 150), PRESS);
        assert_eq!(tell(&mut link, &[hello], 160), []);
        assert_eq!(tell(&mut link, after, 260), [], "{before:?}");
        assert_eq!(
            tell(&mut link, &["20 STATE 0 0 1900", "21 BTN 2 D 2000"], 1050),
            PRESS,
            "the next one counts"
        );

        let mut link = up();
        assert_eq!(tell(&mut link, before, 150), PRESS);
        assert_eq!(again(&mut link, hello, 160), []);
        assert_eq!(tell(&mut link, after, 280), [], "{before:?} and the port opened again");
        assert_eq!(
            tell(&mut link, &["20 STATE 0 0 1900", "21 BTN 2 D 2000"], 1050),
            PRESS,
            "the next one counts"
        );
    }
}

#[test]
fn what_comes_seconds_late_all_at_once_counts_once() {
    let mut link = up();
    assert_eq!(tell(&mut link, &["10 STATE 0 0 2000"], 1000), []);
    // nothing is heard for 9 s; then presses on their way since 1 s, 4 s and 8 s after that, with what was sent again
    let late = [
        "11 BTN 2 D 3000",
        "13 BTN 2 U 3040",
        "14 STATE 0 0 3040",
        "15 STATE 0 0 4040",
        "16 BTN 2 D 6000",
        "18 BTN 2 U 6040",
        "19 STATE 0 0 6040",
        "17 STATE 0 0 8040",
        "1A BTN 2 D 10000",
        "1B BTN 2 U 10040",
        "1A BTN 2 D 10000",
        "1C STATE 0 0 10990",
    ];
    assert_eq!(tell(&mut link, &late, 10_000), [PRESS; 3].concat());
    assert_eq!(tell(&mut link, &["1D STATE 0 0 11990", "1E BTN 2 D 12000"], 11_000), PRESS);
}

#[test]
fn a_board_that_began_anew_is_listened_to_at_once() {
    // its clock and numbers begin again; a button held all the while is not pressed again
    for hello_lost in [false, true] {
        let mut link = up();
        assert_eq!(tell(&mut link, &["10 BTN 2 D 31000"], 30_000), PRESS);
        if hello_lost {
            assert_eq!(again(&mut link, HELLO, 30_100), []);
        } else {
            assert_eq!(tell(&mut link, &[HELLO], 30_100), []);
        }
        assert_eq!(tell(&mut link, &["01 STATE 2 0 300"], 30_400), []);
        assert_eq!(tell(&mut link, &["02 BTN 2 U 400", "03 BTN 2 D 500"], 30_600), PRESS);
    }
    // without a greeting two states are needed: one may be a broken frame, and edges may be old ones
    let mut link = up();
    assert_eq!(tell(&mut link, &["10 STATE 0 0 31000"], 30_000), []);
    assert_eq!(tell(&mut link, &["11 BTN 2 D 300", "12 STATE 2 0 300", "11 BTN 2 D 300"], 30_100), []);
    assert_eq!(tell(&mut link, &["11 BTN 2 D 300", "13 STATE 2 0 350"], 30_200), PRESS);
}

/// A board that was held up for seconds goes on where it was: it says the time it is, and sends again what is old.
#[test]
fn edges_of_long_ago_are_no_news() {
    for hello in [None, Some("15 HELLO 1 5F3A01C2 1.4.0 3 1 0003")] {
        let mut link = up();
        assert_eq!(tell(&mut link, &["10 BTN 2 D 1100", "12 BTN 2 U 1150"], 150), PRESS);
        assert_eq!(tell(&mut link, &["14 STATE 0 0 1200"], 200), []);
        let mut bodies: Vec<String> = hello.map(Into::into).into_iter().collect();
        bodies.push("16 STATE 0 0 21000".into());
        // more messages than are remembered
        bodies.extend((0..20).map(|k| format!("{:02X} STATE 0 0 {}", 32 + k, 21_010 + k)));
        for _ in 0..4 {
            bodies.extend(["10 BTN 2 D 1100", "12 BTN 2 U 1150", "0E BTN 2 D 1000"].map(Into::into));
        }
        let bodies: Vec<&str> = bodies.iter().map(String::as_str).collect();
        assert_eq!(tell(&mut link, &bodies, 20_000), [], "{hello:?}");
        assert_eq!(tell(&mut link, &["50 BTN 2 D 21100", "51 BTN 2 U 21200"], 20_200), PRESS, "{hello:?}");
    }
}
