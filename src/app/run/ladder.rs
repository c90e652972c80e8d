//! What to do about a camera that falters: grab on, restart its stream, open it again, rest. Pure: what happened and
//! the time come in, the next act goes out; `watch` does it.
//!
//! A stream that is silent for three pictures' time (250 ms at least) is stopped and started; silent still, the device
//! is closed and opened; from then on the two take turns, each given twice the time of the one before, up to 8 s. The
//! stream stays open meanwhile: the first picture that comes is taken. A device that failed or left is opened at once,
//! then again after a pause that doubles. Half a second of pictures makes all forgotten: troubles that follow each other
//! are no reason to rest.

use std::time::Duration;

/// Silence never counts before this.
const LEAST: Duration = Duration::from_millis(250);
/// What a stream just started is given for its first picture: at first, and at most.
const FIRST: Duration = Duration::from_secs(2);
const FIRST_MOST: Duration = Duration::from_secs(8);
/// Pauses between attempts to open: the first; the longest for a device that is not there (a look costs little), and
/// for one that is there and fails.
const PAUSE: Duration = Duration::from_millis(50);
const PAUSE_GONE: Duration = Duration::from_millis(150);
const PAUSE_MOST: Duration = Duration::from_secs(1);
/// A stream that gave pictures so long is well.
const WELL: Duration = Duration::from_millis(500);

/// Why the camera failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Not there.
    Gone,
    /// Another program has it.
    Busy,
    /// It is there and fails.
    Faulty,
    /// Its signal changed: another format is to be agreed on.
    Changed,
}

/// What came of the last act.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heard {
    /// A picture.
    Picture,
    /// None in the time given.
    Silence,
    /// The stream runs, again or for the first time.
    Started,
    /// The act failed.
    Failed(Cause),
    /// The rest is over.
    Rested,
}

/// What to do next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Act {
    /// Wait so long for a picture.
    Grab(Duration),
    /// Stop the stream and start it.
    Restart,
    /// Close the device and open it.
    Open,
    /// Close the device and wait.
    Rest(Duration),
}

/// Where the camera stands.
#[derive(Clone, Copy, Debug)]
pub struct Ladder {
    patience: Duration,
    /// When the stream was started, and whether it gave a picture since.
    started: Duration,
    seen: bool,
    /// Silences since all was well.
    silences: u32,
    /// Failures since all was well.
    failures: u32,
}

impl Ladder {
    /// For pictures that are `interval` apart. The stream is taken to have been started at `now`.
    pub fn new(interval: Duration, now: Duration) -> Self {
        let patience = (3 * interval).max(LEAST);
        Self { patience, started: now, seen: false, silences: 0, failures: 0 }
    }

    /// Pictures are so far apart from now on.
    pub fn set_interval(&mut self, interval: Duration) {
        self.patience = (3 * interval).max(LEAST);
    }

    /// How long the next picture may take.
    fn patience(&self) -> Duration {
        match self.seen {
            true => self.patience,
            false => {
                (FIRST * (1 << self.silences.min(8).saturating_sub(1))).min(FIRST_MOST).max(self.patience)
            }
        }
    }

    /// The next act.
    pub fn next(&mut self, heard: Heard, now: Duration) -> Act {
        match heard {
            Heard::Picture => {
                self.seen = true;
                if now >= self.started + WELL {
                    (self.silences, self.failures) = (0, 0);
                }
                Act::Grab(self.patience())
            }
            Heard::Silence => {
                self.silences += 1;
                if self.silences % 2 == 1 { Act::Restart } else { Act::Open }
            }
            Heard::Started => {
                (self.started, self.seen) = (now, false);
                Act::Grab(self.patience())
            }
            Heard::Rested => Act::Open,
            // a driver that tells of a change at every start must not keep us busy
            Heard::Failed(Cause::Changed) if self.seen => Act::Open,
            Heard::Failed(cause) => {
                let most = if cause == Cause::Gone { PAUSE_GONE } else { PAUSE_MOST };
                self.failures += 1;
                match self.failures {
                    1 => Act::Open,
                    n => Act::Rest((PAUSE * (1 << (n - 2).min(8))).min(most)),
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pixels::SplitMix64;

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn what_follows_what() {
        use Heard::{Failed, Picture, Rested, Silence, Started};
        let grab = |time: u64| Act::Grab(ms(time));
        let rest = |time: u64| Act::Rest(ms(time));
        let (gone, faulty) = (Failed(Cause::Gone), Failed(Cause::Faulty));
        // at the time in ms, what is heard, what is done
        let table: [&[(u64, Heard, Act)]; 6] = [
            // silence: restart, open, restart .. each with more time
            &[
                (33, Picture, grab(250)),
                (283, Silence, Act::Restart),
                (285, Started, grab(2000)),
                (2285, Silence, Act::Open),
                (2290, Started, grab(4000)),
                (6290, Silence, Act::Restart),
                (6291, Started, grab(8000)),
                (14291, Silence, Act::Open),
                (14300, Started, grab(8000)),
                (15000, Picture, grab(250)),
                (15250, Silence, Act::Restart),
            ],
            // pictures for half a second: forgotten
            &[
                (10, Picture, grab(250)),
                (260, Silence, Act::Restart),
                (270, Started, grab(2000)),
                (300, Picture, grab(250)),
                (770, Picture, grab(250)),
                (1020, Silence, Act::Restart),
                (1030, Started, grab(2000)),
                (1060, Picture, grab(250)),
                (1529, Picture, grab(250)),
                (1779, Silence, Act::Open),
            ],
            // gone: looked for often
            &[
                (0, gone, Act::Open),
                (0, gone, rest(50)),
                (50, Rested, Act::Open),
                (50, gone, rest(100)),
                (150, Rested, Act::Open),
                (150, gone, rest(150)),
                (300, Rested, Act::Open),
                (300, gone, rest(150)),
                (450, Rested, Act::Open),
                (470, Started, grab(2000)),
            ],
            // there, and failing: with longer pauses
            &[
                (0, faulty, Act::Open),
                (1, faulty, rest(50)),
                (51, faulty, rest(100)),
                (151, faulty, rest(200)),
                (351, faulty, rest(400)),
                (751, faulty, rest(800)),
                (1551, faulty, rest(1000)),
                (2551, Failed(Cause::Busy), rest(1000)),
                (3551, gone, rest(150)),
            ],
            // one failure a second is opened at once, every time
            &[
                (10, Picture, grab(250)),
                (20, gone, Act::Open),
                (30, Started, grab(2000)),
                (100, Picture, grab(250)),
                (530, Picture, grab(250)),
                (1000, gone, Act::Open),
                (1010, Started, grab(2000)),
                (1100, Picture, grab(250)),
                (1510, Picture, grab(250)),
                (2000, faulty, Act::Open),
            ],
            // another signal is no failure
            &[
                (10, Picture, grab(250)),
                (20, Failed(Cause::Changed), Act::Open),
                (30, Started, grab(2000)),
                (40, Failed(Cause::Changed), Act::Open),
                (50, Started, grab(2000)),
                (60, Failed(Cause::Changed), rest(50)),
                (110, Rested, Act::Open),
                (120, Started, grab(2000)),
                (130, Picture, grab(250)),
                (140, Failed(Cause::Changed), Act::Open),
            ],
        ];
        for steps in table {
            let mut ladder = Ladder::new(ms(33), Duration::ZERO);
            for (step, &(at, heard, act)) in steps.iter().enumerate() {
                assert_eq!(ladder.next(heard, ms(at)), act, "step {step} of {steps:?}");
            }
        }
        let mut slow = Ladder::new(ms(200), Duration::ZERO);
        assert_eq!(slow.next(Picture, ms(200)), grab(600), "three pictures' time");
    }

    /// How a simulated device is for a while.
    #[derive(Clone, Copy, Debug, PartialEq)]
    enum Device {
        Well,
        Silent,
        /// A stream started before is silent, one started now runs.
        Hung,
        Away,
        Failing,
        Taken,
    }

    /// A driver that falters at random: after each time the picture is back soon, the work while it is away is bounded.
    #[test]
    fn a_camera_that_falters_at_random_always_comes_back() {
        let all = std::env::var_os("VERNISSAGE_SOAK").is_some();
        let rounds = if all { 20_000 } else { 1_000 };
        let mut random = SplitMix64::new(2006);
        let mut now = Duration::ZERO;
        let mut ladder = Ladder::new(ms(33), now);
        let mut act = Act::Grab(ms(2000));
        // the stream: when it was started, while it is open
        let mut stream = Some(now);
        let (mut worst, mut acts, mut counts) = ([Duration::ZERO; 6], 0_u64, [0_u64; 6]);
        for _ in 0..rounds {
            let kinds =
                [Device::Well, Device::Silent, Device::Hung, Device::Away, Device::Failing, Device::Taken];
            let trouble = kinds[1 + (random.next_u64() % 5) as usize];
            counts[trouble as usize] += 1;
            let lasts = ms([5, 200, 1000, 5000, 20_000][(random.next_u64() % 5) as usize]);
            let (began, well) = (now, ms(random.next_u64() % 5000));
            let until = began + lasts;
            let mut back = None;
            let (mut before, mut pictures) = (acts, 0_u64);
            while back.is_none_or(|back: Duration| now < back + well) {
                let device = if now < until { trouble } else { Device::Well };
                acts += 1;
                let works = |device: Device| matches!(device, Device::Well | Device::Silent | Device::Hung);
                let heard = match act {
                    Act::Rest(time) => {
                        (stream, now) = (None, now + time);
                        Heard::Rested
                    }
                    Act::Open | Act::Restart => {
                        now += ms(if act == Act::Open { 10 } else { 3 });
                        let cause = match device {
                            Device::Away => Cause::Gone,
                            Device::Taken => Cause::Busy,
                            _ => Cause::Faulty,
                        };
                        stream = works(device).then_some(now);
                        if works(device) { Heard::Started } else { Heard::Failed(cause) }
                    }
                    Act::Grab(time) => match (device, stream) {
                        (_, None) => panic!("nothing is open"),
                        (Device::Away | Device::Failing | Device::Taken, _) => {
                            Heard::Failed(if device == Device::Away { Cause::Gone } else { Cause::Faulty })
                        }
                        (Device::Hung | Device::Silent, Some(started))
                            if device == Device::Silent || started < began =>
                        {
                            // the picture that ends the silence is not slept through
                            let silent = time.min((until + ms(33)).saturating_sub(now).max(ms(1)));
                            now += silent;
                            if silent < time { Heard::Picture } else { Heard::Silence }
                        }
                        _ => {
                            now += ms(33);
                            Heard::Picture
                        }
                    },
                };
                if heard == Heard::Picture && now >= until && back.is_none() {
                    back = Some(now);
                    let late = now - until;
                    worst[trouble as usize] = worst[trouble as usize].max(late);
                    // while the device was away: at most one act in 40 ms, opened or rested
                    let most = 8 + 2 * (lasts + late).as_millis() as u64 / 40 + pictures;
                    assert!(acts - before <= most, "{} acts in {:?} of {trouble:?}", acts - before, lasts);
                    (before, pictures) = (acts, 0);
                }
                pictures += u64::from(heard == Heard::Picture);
                act = ladder.next(heard, now);
            }
        }
        eprintln!("{rounds} troubles {counts:?}, {acts} acts; latest picture after each kind: {worst:?}");
        assert!(counts[1..].iter().all(|&count| count > rounds / 10), "{counts:?}");
        assert!(worst[Device::Away as usize] <= ms(300), "{worst:?}");
        assert!(worst[Device::Silent as usize] <= ms(300), "{worst:?}");
        assert!(
            worst[Device::Failing as usize] <= ms(1300) && worst[Device::Taken as usize] <= ms(1300),
            "{worst:?}"
        );
    }
}
