//! Degrade, don't die: steps along the quality levels of a style so that a frame's cost keeps to a budget.
//!
//! Pure: what a frame cost and when come in, the level for the next frames goes out. The moving median decides, so a
//! spike does nothing. A step down is taken at once, and what the step saved is remembered; a step back up only when
//! the median, times what it saved, leaves room, and after a pause that doubles when such a step had to be taken back:
//! no pumping. Nothing is allocated.

use serde::Deserialize;
use std::time::Duration;

/// Levels there may be, the full one included.
pub const LEVELS: usize = 3;
/// Costs that the median is taken of: not quite a second's. None is taken of fewer.
const WINDOW: usize = 25;
/// The share of the budget that a better level may be expected to cost.
const ROOM: f64 = 0.85;
/// The pause before a step up: the least, and the most.
const CALM: [Duration; 2] = [Duration::from_secs(3), Duration::from_secs(300)];
/// A step up that is taken back within this time was a mistake.
const TRIAL: Duration = Duration::from_secs(30);

/// The `[governor]` table: without it the picture is never simplified.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// What a frame may cost from camera picture to canvas, ms, 1 to 1000.
    pub budget_ms: f64,
}

impl Config {
    /// Whether everything is within its range; else what is wrong.
    pub fn check(&self) -> Result<(), String> {
        let good = (1.0..=1000.0).contains(&self.budget_ms);
        good.then_some(()).ok_or(format!("governor.budget_ms = {}: give 1 to 1000", self.budget_ms))
    }
}

/// Watches what frames cost.
#[derive(Clone, Debug)]
pub struct Governor {
    budget: Duration,
    level: usize,
    costs: [Duration; WINDOW],
    count: usize,
    /// The median before each step down, over the one after it.
    saved: [f64; LEVELS],
    /// The median before the last step down, until the one after it is known.
    before: Option<Duration>,
    /// When the level changed last, and when it last went up.
    changed: Duration,
    rose: Option<Duration>,
    calm: Duration,
}

impl Governor {
    /// At the best level.
    pub fn new(config: &Config) -> Self {
        Self {
            budget: Duration::from_secs_f64(config.budget_ms.clamp(1.0, 1000.0) / 1e3),
            level: 0,
            costs: [Duration::ZERO; WINDOW],
            count: 0,
            saved: [1.0; LEVELS],
            before: None,
            changed: Duration::ZERO,
            rose: None,
            calm: CALM[0],
        }
    }

    /// The level: 0 is the best.
    pub fn level(&self) -> usize {
        self.level
    }

    /// Whether the budget is overrun although nothing can be simplified any more. `levels`: how many there are.
    pub fn is_beaten(&self, levels: usize) -> bool {
        self.level + 1 >= levels && self.median().is_some_and(|median| median > self.budget)
    }

    /// Another style: what was learned about the last one does not count.
    pub fn forget(&mut self, now: Duration) {
        (self.count, self.before, self.saved) = (0, None, [1.0; LEVELS]);
        (self.changed, self.rose, self.calm) = (now, None, CALM[0]);
    }

    /// A frame at `now` cost this much; `levels`: how many the style has (1 to [`LEVELS`]). The new level, when it
    /// changes.
    pub fn observe(&mut self, cost: Duration, levels: usize, now: Duration) -> Option<usize> {
        self.costs[self.count % WINDOW] = cost;
        self.count += 1;
        if self.level >= levels.max(1) {
            return Some(self.step(levels.max(1) - 1, now));
        }
        let median = self.median()?;
        if let Some(before) = self.before.take() {
            self.saved[self.level] = (before.as_secs_f64() / median.as_secs_f64().max(1e-9)).clamp(1.0, 16.0);
        }
        if median > self.budget {
            if self.level + 1 >= levels {
                return None;
            }
            if self.rose.take().is_some_and(|rose| now.saturating_sub(rose) < TRIAL) {
                self.calm = (self.calm * 2).min(CALM[1]);
            }
            self.before = Some(median);
            return Some(self.step(self.level + 1, now));
        }
        if self.rose.is_some_and(|rose| now.saturating_sub(rose) >= TRIAL) {
            (self.rose, self.calm) = (None, CALM[0]);
        }
        let rested = now.saturating_sub(self.changed) >= self.calm;
        let better = median.as_secs_f64() * self.saved[self.level];
        if self.level > 0 && rested && better <= ROOM * self.budget.as_secs_f64() {
            self.rose = Some(now);
            return Some(self.step(self.level - 1, now));
        }
        None
    }

    fn step(&mut self, level: usize, now: Duration) -> usize {
        (self.level, self.changed, self.count) = (level, now, 0);
        level
    }

    /// The median of the last costs, once there are enough.
    fn median(&self) -> Option<Duration> {
        if self.count < WINDOW {
            return None;
        }
        let mut sorted = self.costs;
        sorted.sort_unstable();
        Some(sorted[WINDOW / 2])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pixels::SplitMix64;

    /// What the levels cost on a machine that is as fast as it should be, ms.
    const COSTS: [f64; LEVELS] = [20.0, 13.0, 8.0];

    /// Thirty frames a second for `seconds`, `load(t)` times as slow; the levels in order of their time, and how many
    /// frames were over a budget of 25 ms.
    fn run(seconds: f64, mut load: impl FnMut(f64) -> f64) -> (Vec<(f64, usize)>, usize) {
        let mut governor = Governor::new(&Config { budget_ms: 25.0 });
        let (mut steps, mut over) = (Vec::new(), 0);
        for frame in 0..(30.0 * seconds) as u32 {
            let at = f64::from(frame) / 30.0;
            let cost = COSTS[governor.level()] * load(at);
            over += usize::from(cost > 25.0);
            let now = Duration::from_secs_f64(at);
            if let Some(level) = governor.observe(Duration::from_secs_f64(cost / 1e3), LEVELS, now) {
                steps.push((at, level));
            }
        }
        (steps, over)
    }

    #[test]
    fn within_the_budget_nothing_happens() {
        assert_eq!(run(600.0, |_| 1.2), (vec![], 0));
    }

    #[test]
    fn spikes_are_borne() {
        let mut random = SplitMix64::new(7);
        // every tenth frame takes five times as long; a pause of a fifth of a second now and then
        let (steps, _) = run(600.0, |t| match (random.next_u64() % 10, t % 20.0) {
            (0, _) => 5.0,
            (_, rest) if rest < 0.2 => 8.0,
            _ => 1.0,
        });
        assert_eq!(steps, []);
    }

    #[test]
    fn overload_is_met_within_two_seconds_and_left_when_it_is_over() {
        let (steps, over) = run(120.0, |t| if (10.0..60.0).contains(&t) { 2.0 } else { 1.0 });
        let levels: Vec<usize> = steps.iter().map(|step| step.1).collect();
        assert_eq!(levels, [1, 2, 1, 0], "{steps:?}");
        assert!(steps[0].0 < 10.6 && steps[1].0 < 11.6 && over < 45, "{steps:?}, {over} frames over");
        assert!((60.0..70.0).contains(&steps[3].0), "{steps:?}");
    }

    #[test]
    fn slow_heat_is_followed_by_one_step_each() {
        // three times as slow within ten minutes, and back within ten
        let (steps, over) = run(1300.0, |t| 1.0 + 2.0 * (t.min(1200.0 - t.min(1200.0)) / 600.0).max(0.0));
        let levels: Vec<usize> = steps.iter().map(|step| step.1).collect();
        assert_eq!(levels, [1, 2, 1, 0], "{steps:?}");
        assert!(over < 40, "{over} frames over the budget");
    }

    #[test]
    fn a_load_at_the_edge_does_not_pump() {
        let mut random = SplitMix64::new(3);
        // a tenth of noise about just too much for the best level
        let noisy = move |_: f64| 1.25 * (0.95 + 0.1 * (random.next_u64() % 1000) as f64 / 1000.0);
        let (steps, _) = run(3600.0, noisy);
        assert!(steps.len() <= 2, "{steps:?}");
        // a load that comes and goes every ten seconds: ever fewer steps, not one each
        let (steps, _) = run(3600.0, |t| if t % 20.0 < 10.0 { 1.0 } else { 1.5 });
        assert!(steps.len() <= 40, "{} steps in an hour", steps.len());
    }

    #[test]
    fn at_the_last_level_it_is_beaten_and_says_so() {
        let mut governor = Governor::new(&Config { budget_ms: 5.0 });
        let slow = Duration::from_millis(9);
        for frame in 0..90 {
            governor.observe(slow, LEVELS, Duration::from_millis(33 * frame));
        }
        assert!(governor.level() == LEVELS - 1 && governor.is_beaten(LEVELS));
        // a style with fewer levels: back to what it has
        assert_eq!(governor.observe(slow, 1, Duration::from_secs(3)), Some(0));
        (0..30).for_each(|_| assert_eq!(governor.observe(slow, 1, Duration::from_secs(4)), None));
        assert!(governor.is_beaten(1));
        assert!(
            Config { budget_ms: f64::NAN }.check().is_err() && Config { budget_ms: 33.0 }.check().is_ok()
        );
    }
}
