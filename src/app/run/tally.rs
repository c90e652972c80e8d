//! What happened so far, as numbers that the frame loop stores and others read: nothing here locks, waits or allocates
//! after the start.

use crate::app::fault::Faults;
use crate::camera::Stats;
use crate::pipeline::{Stage, Timings};
use crate::style::StyleName;
use clap::ValueEnum;
use std::sync::atomic::{AtomicU8, AtomicU32, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Durations kept for percentiles: over a minute at 30 a second.
const KEPT: usize = 2048;

/// A number that one thread stores and any reads.
#[derive(Debug, Default)]
pub struct Number(AtomicU64);

impl Number {
    /// Adds to it.
    pub fn add(&self, more: u64) {
        self.0.fetch_add(more, Ordering::Relaxed);
    }

    /// Replaces it.
    pub fn set(&self, value: u64) {
        self.0.store(value, Ordering::Relaxed);
    }

    /// Reads it.
    pub fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// The last `KEPT` durations, in microseconds.
#[derive(Debug)]
pub struct Ring {
    values: Box<[AtomicU32]>,
    count: Number,
}

impl Default for Ring {
    fn default() -> Self {
        Self { values: (0..KEPT).map(|_| AtomicU32::new(0)).collect(), count: Number::default() }
    }
}

impl Ring {
    /// Adds a duration, the oldest goes.
    pub fn push(&self, value: Duration) {
        let micros = u32::try_from(value.as_micros()).unwrap_or(u32::MAX);
        self.values[self.count.get() as usize % KEPT].store(micros, Ordering::Relaxed);
        self.count.add(1);
    }

    /// The values below which these shares (0..1) of the kept ones lie, nearest rank; zeros when there are none.
    /// Allocates: for those who read.
    pub fn percentiles<const N: usize>(&self, shares: [f64; N]) -> [Duration; N] {
        let kept = (self.count.get() as usize).min(KEPT);
        let mut sorted: Vec<u32> = self.values[..kept].iter().map(|v| v.load(Ordering::Relaxed)).collect();
        sorted.sort_unstable();
        shares.map(|share| {
            let rank = (share.clamp(0.0, 1.0) * kept as f64).ceil() as usize;
            Duration::from_micros(sorted.get(rank.max(1) - 1).copied().unwrap_or(0).into())
        })
    }
}

/// How the camera stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum CameraState {
    /// Being opened, or opened and without a picture yet.
    #[default]
    Open = 0,
    /// Pictures come.
    Run = 1,
    /// It left.
    Lost = 2,
}

impl CameraState {
    /// As in the status file.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Open => "open",
            Self::Run => "run",
            Self::Lost => "lost",
        }
    }
}

/// The camera's side, stored by its thread.
#[derive(Debug, Default)]
pub struct Eye {
    state: AtomicU8,
    /// Streams stopped and started again.
    pub restarted: Number,
    /// Devices closed and opened again.
    pub reopened: Number,
    counts: [Number; 8],
    /// What the streams before this one counted.
    before: [Number; 8],
}

impl Eye {
    /// How it stands.
    pub fn state(&self) -> CameraState {
        match self.state.load(Ordering::Relaxed) {
            0 => CameraState::Open,
            1 => CameraState::Run,
            _ => CameraState::Lost,
        }
    }

    /// It now stands so.
    pub fn set_state(&self, state: CameraState) {
        self.state.store(state as u8, Ordering::Relaxed);
    }

    /// What the stream that runs has counted.
    pub fn count(&self, stats: &Stats) {
        for ((to, before), now) in self.counts.iter().zip(&self.before).zip(numbers(stats)) {
            to.set(before.get() + now);
        }
    }

    /// The next stream counts from 0.
    pub fn anew(&self) {
        for (before, now) in self.before.iter().zip(&self.counts) {
            before.set(now.get());
        }
    }

    /// What became of the camera's pictures since the start.
    pub fn stats(&self) -> Stats {
        let [received, delivered, missed, stale, damaged, short, undecodable, disordered] =
            self.counts.each_ref().map(Number::get);
        Stats { received, delivered, missed, stale, damaged, short, undecodable, disordered }
    }
}

fn numbers(stats: &Stats) -> [u64; 8] {
    let Stats { received, delivered, missed, stale, damaged, short, undecodable, disordered } = *stats;
    [received, delivered, missed, stale, damaged, short, undecodable, disordered]
}

/// Everything of a run.
#[derive(Debug)]
pub struct Tally {
    /// When it began.
    pub started: Instant,
    /// What is wrong.
    pub faults: Faults,
    /// The camera.
    pub eye: Eye,
    /// Pictures shown.
    pub shown: Number,
    /// Slates shown.
    pub slates: Number,
    /// Shown pictures with a marker in them.
    pub tracked: Number,
    /// Gaps in the sequence of what was shown.
    pub missing: Number,
    /// Pictures shown after a later one.
    pub backwards: Number,
    /// Pictures that a newer one replaced before they were drawn.
    pub replaced: Number,
    /// Markers in the newest picture.
    pub markers: Number,
    /// Which of the scenes is shown.
    pub scene: Number,
    /// Settings taken since the start.
    pub settings: Number,
    /// How far the picture is simplified, 0 = not at all.
    pub quality: Number,
    /// How often that changed.
    pub quality_steps: Number,
    /// Snapshots written.
    pub snapshots: Number,
    /// Flips whose end was never told.
    pub lost_flips: Number,
    /// Screens opened again.
    pub screens: Number,
    /// 1 while the screen is dark by wish.
    pub standby: Number,
    style: AtomicU8,
    last: Number,
    stages: [Ring; 5],
    latency: Ring,
}

impl Default for Tally {
    fn default() -> Self {
        Self {
            started: Instant::now(),
            faults: Faults::default(),
            eye: Eye::default(),
            shown: Number::default(),
            slates: Number::default(),
            tracked: Number::default(),
            missing: Number::default(),
            backwards: Number::default(),
            replaced: Number::default(),
            markers: Number::default(),
            scene: Number::default(),
            settings: Number::default(),
            quality: Number::default(),
            quality_steps: Number::default(),
            snapshots: Number::default(),
            lost_flips: Number::default(),
            screens: Number::default(),
            standby: Number::default(),
            style: AtomicU8::new(0),
            last: Number::default(),
            stages: Default::default(),
            latency: Ring::default(),
        }
    }
}

impl Tally {
    /// The picture numbered `sequence`, with so many markers in it, has been shown; its stages took so long.
    pub fn picture(&self, sequence: u64, markers: usize, timings: &Timings) {
        if self.shown.get() > 0 {
            let last = self.last.get();
            self.missing.add(sequence.saturating_sub(last + 1));
            self.backwards.add(u64::from(sequence <= last));
        }
        self.last.set(sequence);
        self.markers.set(markers as u64);
        self.tracked.add(u64::from(markers > 0));
        for stage in Stage::ALL {
            self.stages[stage as usize].push(timings.of(stage));
        }
        self.shown.add(1);
    }

    /// So long a picture took from the camera's stamp to the screen.
    pub fn lasted(&self, latency: Duration) {
        self.latency.push(latency);
    }

    /// Capture to shown.
    pub fn latency(&self) -> &Ring {
        &self.latency
    }

    /// What a stage took.
    pub fn stage(&self, stage: Stage) -> &Ring {
        &self.stages[stage as usize]
    }

    /// The style in front.
    pub fn style(&self) -> StyleName {
        let styles = StyleName::value_variants();
        styles.get(usize::from(self.style.load(Ordering::Relaxed))).copied().unwrap_or_default()
    }

    /// Says which style is in front.
    pub fn set_style(&self, style: StyleName) {
        self.style.store(style as u8, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ring_keeps_the_newest_and_ranks_them() {
        let ring = Ring::default();
        assert_eq!(ring.percentiles([0.5, 0.99]), [Duration::ZERO; 2]);
        for ms in (1..=100).rev() {
            ring.push(Duration::from_millis(ms));
        }
        assert_eq!(ring.percentiles([0.5, 0.99, 1.0]), [50, 99, 100].map(Duration::from_millis));
        (0..KEPT).for_each(|_| ring.push(Duration::from_micros(7)));
        assert_eq!(ring.percentiles([0.0, 1.0]), [Duration::from_micros(7); 2]);
    }

    #[test]
    fn gaps_and_disorder_are_counted_once() {
        let tally = Tally::default();
        for sequence in [5, 6, 9, 9, 8, 10] {
            tally.picture(sequence, usize::from(sequence == 6), &Timings::default());
        }
        assert_eq!((tally.shown.get(), tally.missing.get(), tally.backwards.get()), (6, 3, 2));
        assert_eq!((tally.tracked.get(), tally.markers.get()), (1, 0));
    }

    #[test]
    fn a_cameras_counts_go_on_when_it_is_opened_again() {
        let eye = Eye::default();
        eye.count(&Stats { received: 5, short: 1, ..Stats::default() });
        eye.anew();
        assert_eq!(eye.stats().received, 5);
        eye.count(&Stats { received: 2, damaged: 1, ..Stats::default() });
        assert_eq!(eye.stats(), Stats { received: 7, short: 1, damaged: 1, ..Stats::default() });
    }

    #[test]
    fn every_style_has_its_number() {
        let tally = Tally::default();
        for &style in StyleName::value_variants() {
            tally.set_style(style);
            assert_eq!(tally.style(), style);
        }
    }
}
