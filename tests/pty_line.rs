//! Buttons on many bad lines at once, each a pseudo terminal that the product's own port opens and a model of a board on
//! its other end: bytes are lost, broken and invented on the way, and every line is unplugged once and comes back as
//! another terminal.
//!
//! Everything runs in real time, but nothing is judged by it: a machine that starves a port for seconds makes presses
//! late, not more or fewer. `VERNISSAGE_SOAK=1` makes a million presses instead of a twentieth.

#[path = "common/button_board.rs"]
mod button_board;
#[path = "common/folder.rs"]
mod folder;

use button_board::{Pace, Player, spoil};
use folder::Folder;
use rustix::fs::{Mode, OFlags};
use serialport::{SerialPort, TTYPort};
use std::collections::VecDeque;
use std::io::{ErrorKind, Read, Write};
use std::os::fd::OwnedFd;
use std::path::PathBuf;
use std::time::{Duration, Instant};
use vernissage::buttons::Action::StyleNext;
use vernissage::buttons::{Ask, ButtonConfig, Config, Port};
use vernissage::pixels::SplitMix64;

/// Lines side by side; each is unplugged once.
const LINES: u64 = 64;
/// Nobody presses for so long before an unplugging, ms; it waits until all that was said is heard and entered.
const QUIET: u64 = 4000;
/// What was said of a press is heard by then, ms, or the line was down.
const LATE: u64 = 3000;
/// A line rests after so many turns without anything to enter or to hear.
const RESTED: u64 = 100;

/// One line: a visor's port, a board, and what is between them.
struct Line {
    /// What the visor opens.
    link: PathBuf,
    port: Port,
    player: Player,
    rng: SplitMix64,
    /// The board's end of the terminal, and the visor's: one that nobody has open reads as hung up.
    plug: Option<(TTYPort, OwnedFd)>,
    /// Said, and not yet on the line; on the line, and not yet taken by the terminal.
    to_visor: VecDeque<u8>,
    on_the_line: Vec<u8>,
    unplug_at: u64,
    plug_at: u64,
    /// So many turns there has been nothing that could still count.
    rested: u64,
    counted: [u64; 3],
}

impl Line {
    fn new(folder: &Folder, number: u64, unplug_at: u64) -> Self {
        let link = folder.0.join(format!("line-{number}"));
        let plain = |number| ButtonConfig { number, short: Some(StyleNext), long: None, double: None };
        let button = (1..=3).map(plain).collect();
        let config = Config { port: Some(link.clone()), button, ..Config::default() };
        let port = Port::start(&config, Vec::new(), Vec::new(), false).expect("a thread");
        Self {
            link,
            port: port.expect("a port is named"),
            player: Player::new(Pace { hold: 30..=60, rest: 80..=160 }),
            rng: SplitMix64::new(number),
            plug: None,
            to_visor: VecDeque::new(),
            on_the_line: Vec::new(),
            unplug_at,
            plug_at: 0,
            rested: 0,
            counted: [0; 3],
        }
    }

    fn plug(&mut self) {
        let (mut board, visor) = TTYPort::pair().expect("a pseudo terminal");
        board.set_timeout(Duration::ZERO).expect("a setting");
        let name = visor.name().expect("a name");
        // not by the library, which would lock it
        let end =
            rustix::fs::open(&name, OFlags::RDWR | OFlags::NOCTTY, Mode::empty()).expect("an open terminal");
        let new = self.link.with_extension("new");
        std::os::unix::fs::symlink(name, &new).expect("its own folder");
        std::fs::rename(&new, &self.link).expect("its own folder");
        self.plug = Some((board, end));
    }

    /// Whether the visor heard all that was said, and the board knows.
    fn is_drained(&self) -> bool {
        let waits =
            |(_, end): &(TTYPort, OwnedFd)| rustix::io::ioctl_fionread(end).expect("an open terminal");
        self.to_visor.is_empty() && self.on_the_line.is_empty() && self.plug.as_ref().map_or(0, waits) == 0
    }

    /// Whether all is pressed and entered, and the line was unplugged.
    fn is_done(&self, presses: u64) -> bool {
        self.player.made >= presses && self.unplug_at == 0 && self.plug.is_some() && self.rested >= RESTED
    }

    /// What happens at `now`.
    fn turn(&mut self, now: u64, wanted: bool) {
        let quiet = now + QUIET >= self.unplug_at && self.unplug_at > 0;
        self.rested = if self.player.is_settled() && self.is_drained() { self.rested + 1 } else { 0 };
        if self.plug.is_none() && now >= self.plug_at {
            self.plug();
        } else if quiet && now >= self.unplug_at && self.rested >= RESTED {
            // its name goes first: the terminal's number may soon be another line's
            std::fs::remove_file(&self.link).expect("its own folder");
            self.plug = None;
            (self.unplug_at, self.plug_at) = (0, now + self.rng.int(100, 3000) as u64);
            self.rested = 0;
        }
        let up = self.port.is_up();
        self.player.play(now, wanted && !quiet && up, &mut self.rng, &mut self.to_visor);
        if let Some((board, _)) = &mut self.plug {
            let broken = spoil(&mut self.to_visor, &mut self.rng);
            self.player.delivered(&broken, up);
            self.on_the_line.extend(broken);
            if !self.on_the_line.is_empty() {
                match board.write(&self.on_the_line) {
                    Ok(count) => drop(self.on_the_line.drain(..count)),
                    Err(error) => assert_eq!(error.kind(), ErrorKind::TimedOut, "{error}"),
                }
            }
            let mut bytes = [0; 1024];
            let count = match board.read(&mut bytes) {
                Ok(count) => count,
                Err(error) if error.kind() == ErrorKind::TimedOut => 0,
                Err(error) => panic!("the board's end: {error}"),
            };
            let broken = spoil(&mut bytes[..count].iter().copied().collect(), &mut self.rng);
            self.player.board.turn(now, &broken, &mut self.to_visor);
        } else {
            self.to_visor.clear();
            self.on_the_line.clear();
        }
        // a visor that was silent for long, or a board that was: what was pressed meanwhile may count or not
        if !self.player.board.linked || !self.port.is_up() {
            self.player.doubt();
        }
        for ask in self.port.asked() {
            match ask {
                Ask::Press(button, _) => self.counted[usize::from(button) - 1] += 1,
                ask => panic!("nobody asked for {ask:?}"),
            }
        }
        self.player.settle(now, LATE);
    }
}

#[test]
fn no_press_is_lost_and_none_invented_on_pseudo_terminals() {
    let all = std::env::var_os("VERNISSAGE_SOAK").is_some();
    let each = if all { 1_000_000 } else { 50_000_u64 }.div_ceil(LINES);
    let folder = Folder::new("pty-line");
    let mut lines: Vec<Line> = (0..LINES)
        // somewhere in the middle: a press takes about 60 ms
        .map(|number| Line::new(&folder, number, 8000 + each * 60 * (number + 1) / (2 * LINES)))
        .collect();
    let start = Instant::now();
    while lines.iter().any(|line| !line.is_done(each)) {
        let now = start.elapsed().as_millis() as u64;
        for line in lines.iter_mut().filter(|line| !line.is_done(each)) {
            line.turn(now, line.player.made < each);
        }
        // the boards' own time goes on
        std::thread::sleep(Duration::from_millis(4));
    }
    let mut sums = [0; 6];
    for Line { counted, player, .. } in &lines {
        let Player { known, hidden, doubtful, forged, unheard, made, .. } = player;
        // whether the port listened at that moment is not known to the last millisecond
        let forged = &(forged + unheard);
        assert_eq!(known.iter().sum::<u64>() + hidden + doubtful, *made, "the test's own books");
        // one broken frame in 65536 has a good checksum: such a lie may cost or invent a press, nothing else may
        let more: u64 =
            counted.iter().zip(known).map(|(counted, known)| counted.saturating_sub(*known)).sum();
        let fewer: u64 =
            counted.iter().zip(known).map(|(counted, known)| known.saturating_sub(*counted)).sum();
        assert!(fewer <= *forged, "lost: {counted:?} of {known:?}, {forged} forged");
        assert!(more <= forged + doubtful, "{counted:?} of {known:?}, {doubtful} doubtful, {forged} forged");
        let all = [*made, counted.iter().sum(), known.iter().sum(), *hidden, *doubtful, *forged];
        sums.iter_mut().zip(all).for_each(|(sum, value)| *sum += value);
    }
    let [made, counted, known, hidden, doubtful, forged] = sums;
    println!(
        "{made} presses on {LINES} lines, {LINES} unplugged, in {:.0} s: {counted} counted, {known} known, \
         {hidden} never got through, {doubtful} while a line was down, {forged} frames forged by noise",
        start.elapsed().as_secs_f64()
    );
    assert!(hidden * 100_000 <= made.max(100_000), "{hidden} presses of {made} never got through at all");
}
