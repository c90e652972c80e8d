//! How long each stage of a frame took, and the percentiles of many frames.

use std::time::{Duration, Instant};

/// The stages of a frame, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Waiting for, fetching and converting the camera picture.
    Camera,
    /// Finding markers and their poses.
    Track,
    /// Drawing the models.
    Render,
    /// Compositing and filtering.
    Style,
    /// Handing the canvas to the display.
    Show,
}

impl Stage {
    /// Every stage, in order.
    pub const ALL: [Stage; 5] = [Stage::Camera, Stage::Track, Stage::Render, Stage::Style, Stage::Show];

    /// Its name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Stage::Camera => "camera",
            Stage::Track => "track",
            Stage::Render => "render",
            Stage::Style => "style",
            Stage::Show => "show",
        }
    }
}

/// Times of one frame, one entry a stage; a skipped stage took zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Timings([Duration; 5]);

impl Timings {
    /// Runs `work` and books its time on `stage`.
    pub fn measure<T>(&mut self, stage: Stage, work: impl FnOnce() -> T) -> T {
        let start = Instant::now();
        let result = work();
        self.0[stage as usize] += start.elapsed();
        result
    }

    /// Books time that was measured elsewhere on `stage`.
    pub fn add(&mut self, stage: Stage, time: Duration) {
        self.0[stage as usize] += time;
    }

    /// Time spent in `stage`.
    pub fn of(&self, stage: Stage) -> Duration {
        self.0[stage as usize]
    }

    /// Track, render and style: what the frame cost between camera and display.
    pub fn frame(&self) -> Duration {
        self.of(Stage::Track) + self.of(Stage::Render) + self.of(Stage::Style)
    }
}

/// Durations gathered over a run; holds at most its capacity, the oldest are overwritten.
#[derive(Clone, Debug)]
pub struct Record {
    values: Vec<Duration>,
    capacity: usize,
    count: usize,
}

impl Record {
    /// Room for `capacity` values, allocated now.
    pub fn new(capacity: usize) -> Self {
        let capacity = capacity.max(1);
        Self { values: Vec::with_capacity(capacity), capacity, count: 0 }
    }

    /// Adds a value; never allocates.
    pub fn push(&mut self, value: Duration) {
        if self.values.len() < self.capacity {
            self.values.push(value);
        } else {
            self.values[self.count % self.capacity] = value;
        }
        self.count += 1;
    }

    /// How many values were pushed.
    pub fn count(&self) -> usize {
        self.count
    }

    /// The value below which `share` (0..1) of the kept values lie, nearest rank; zero when empty.
    /// Allocates a sorted copy: not for the frame loop.
    pub fn percentile(&self, share: f64) -> Duration {
        let mut sorted = self.values.clone();
        sorted.sort_unstable();
        let rank = (share.clamp(0.0, 1.0) * sorted.len() as f64).ceil() as usize;
        sorted.get(rank.max(1) - 1).copied().unwrap_or_default()
    }

    /// The smallest kept value; zero when empty.
    pub fn min(&self) -> Duration {
        self.values.iter().copied().min().unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_nearest_rank() {
        let mut record = Record::new(100);
        assert_eq!(record.percentile(0.5), Duration::ZERO);
        for ms in (1..=100).rev() {
            record.push(Duration::from_millis(ms));
        }
        assert_eq!(record.percentile(0.5), Duration::from_millis(50));
        assert_eq!(record.percentile(0.99), Duration::from_millis(99));
        assert_eq!(record.percentile(1.0), Duration::from_millis(100));
        assert_eq!(record.min(), Duration::from_millis(1));
    }

    #[test]
    fn a_full_record_forgets_the_oldest() {
        let mut record = Record::new(3);
        for ms in 1..=5 {
            record.push(Duration::from_millis(ms));
        }
        assert_eq!((record.min(), record.count()), (Duration::from_millis(3), 5));
    }
}
