//! Buttons on a line that loses, breaks and invents bytes, between the link and a model of a board that shares no code
//! with it; and the same where the visor at times does nothing for seconds and hears all of it late.
//!
//! `VERNISSAGE_SOAK=1` makes a million presses instead of a twentieth.

#[path = "common/button_board.rs"]
mod button_board;

use button_board::{Pace, Player, spoil};
use std::collections::VecDeque;
use std::time::Duration;
use vernissage::buttons::{Ask, ButtonConfig, Config, Kind, Link};
use vernissage::pixels::SplitMix64;

fn ms(value: u64) -> Duration {
    Duration::from_millis(value)
}

/// Presses `count` times over a bad line; `button` decides what kinds are told apart. Where `starved`, the visor does
/// nothing for 1 to 10 s now and then, and hears all of it at once after that. Returns what was counted, and the books.
fn hammer(count: u64, button: impl Fn(u8) -> ButtonConfig, starved: bool, seed: u64) -> ([u64; 3], Player) {
    let mut rng = SplitMix64::new(seed);
    let config = Config { button: (1..=3).map(button).collect(), ..Config::default() };
    let mut link = Link::new(&config, Vec::new());
    let mut player = Player::new(Pace { hold: 35..=400, rest: 80..=900 });
    let (mut to_visor, mut to_board) = (VecDeque::new(), VecDeque::new());
    let mut counted = [0; 3];
    let (mut now, mut plugged, mut open) = (0_u64, true, false);
    let unplug_every = (count * 250 / 100).max(20_000);
    let mut unplug_at = unplug_every;
    let mut asks = Vec::new();
    let mut awake = 0;
    // what the visor hears may be so old, ms, besides what the line makes of it
    let late = if starved { 11_000 } else { 0 };
    while player.made < count || !player.rests(now, 12_000 + late) {
        now += 1;
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
        player.play(now, !quiet && player.made < count && link.is_up(), &mut rng, &mut to_visor);
        if asleep {
            player.board.turn(now, &[], &mut to_visor);
            continue;
        }
        if open {
            let received = spoil(&mut to_visor, &mut rng);
            player.delivered(&received, link.is_up());
            link.receive(&received, ms(now), &mut asks);
            let mut answer: VecDeque<u8> = link.output().iter().copied().collect();
            link.sent(answer.len());
            to_board.append(&mut answer);
            let received = spoil(&mut to_board, &mut rng);
            player.board.turn(now, &received, &mut to_visor);
        }
        link.tick(ms(now), &mut asks);
        for ask in asks.drain(..) {
            if let Ask::Press(button, kind) = ask {
                counted[usize::from(button) - 1] += if kind == Kind::Double { 2 } else { 1 };
            } else {
                panic!("nobody asked for {ask:?}");
            }
        }
        // long enough ago for every repeat
        player.settle(now, 3000 + late);
    }
    let known = player.known.iter().sum::<u64>();
    assert_eq!(known + player.hidden, player.made, "the test's own books");
    (counted, player)
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
    for (counted, Player { known, hidden, forged, .. }) in runs {
        println!("{counted:?} presses counted, {hidden} never got through, {forged} frames forged by noise");
        // one broken frame in 65536 has a good checksum: such a lie may cost or invent a press, nothing else may
        let off: u64 = counted.iter().zip(known).map(|(counted, known)| counted.abs_diff(known)).sum();
        assert!(off <= forged, "{counted:?} of {known:?}, {forged} forged");
        assert!(hidden * 100_000 <= part, "{hidden} presses of {part} never got through at all");
    }
}
