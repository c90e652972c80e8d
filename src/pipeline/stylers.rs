//! The styles a pipeline can draw in, built ahead, and the fade from one to the next.
//!
//! One style is in front. A switch is an intention: it takes hold between two frames, and over the fade's time both
//! styles are drawn and mixed. A switch during a fade waits until that is over, and of several the last counts, so
//! that the picture never jumps. Time is the frames' own: a clip that is drawn again fades the same way.

use crate::frame::Needs;
use crate::pixels::simd::Level;
use crate::render::Look;
use crate::style::{Config, StyleName, Styler};
use std::time::Duration;

/// Styles ready to draw.
pub(super) struct Stylers {
    level: Level,
    slots: Vec<Slot>,
    /// How many of the slots a visitor steps through.
    cycle: usize,
    front: usize,
    wanted: usize,
    leaving: Option<Leaving>,
    fade: Duration,
    last: Option<Duration>,
    /// Whether simpler forms of every style are built too, and how far the styles are simplified.
    governed: bool,
    quality: usize,
}

/// One style, the settings it was built from, and its simpler forms.
struct Slot {
    config: Config,
    stylers: Vec<Styler>,
}

/// The style that a fade comes from.
#[derive(Clone, Copy)]
struct Leaving {
    slot: usize,
    begun: Duration,
}

/// What one frame draws.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Turn {
    /// The style in front.
    pub front: usize,
    /// Its share of the picture, of 256.
    pub share: u16,
    /// The style that the rest of the picture is in.
    pub leaving: Option<usize>,
}

impl Stylers {
    /// The style that `config` names and those of its cycle; the cycle begins at the named one where it holds it.
    /// `governed`: with the simpler forms of each.
    pub fn new(config: &Config, level: Level, governed: bool) -> Self {
        let slot = |name: StyleName| Slot::new(&Config { name, ..config.clone() }, level, governed);
        let mut slots: Vec<Slot> = config.cycle.iter().map(|&name| slot(name)).collect();
        let front = config.cycle.iter().position(|&name| name == config.name).unwrap_or(slots.len());
        if front == slots.len() {
            slots.push(slot(config.name));
        }
        let fade = Duration::from_millis(config.fade_ms.into());
        let cycle = config.cycle.len();
        Self {
            level,
            slots,
            cycle,
            front,
            wanted: front,
            leaving: None,
            fade,
            last: None,
            governed,
            quality: 0,
        }
    }

    /// The style in front, or the one that will be.
    pub fn name(&self) -> StyleName {
        self.slots[self.wanted].config.name
    }

    /// Puts this style in front, without a fade; nothing happens where it is not built.
    pub fn begin_with(&mut self, name: StyleName) {
        if let Some(slot) = self.slots.iter().position(|slot| slot.config.name == name) {
            (self.front, self.wanted, self.leaving) = (slot, slot, None);
        }
    }

    /// Asks for the style `steps` further in the cycle, round and round; without a cycle nothing happens.
    pub fn step(&mut self, steps: isize) {
        if self.cycle > 0 {
            let from = if self.wanted < self.cycle { self.wanted as isize } else { -steps.signum().max(0) };
            self.wanted = (from + steps).rem_euclid(self.cycle as isize) as usize;
        }
    }

    /// Asks for the style that `config` names; the slot it is in, when it had to be built.
    pub fn switch(&mut self, config: &Config) -> Option<usize> {
        self.fade = Duration::from_millis(config.fade_ms.into());
        if let Some(known) = self.slots.iter().position(|slot| slot.config == *config) {
            self.wanted = known;
            return None;
        }
        let slot = Slot::new(config, self.level, self.governed);
        let in_use = |index: usize| {
            index < self.cycle
                || index == self.front
                || self.leaving.is_some_and(|leaving| leaving.slot == index)
        };
        self.wanted = (0..self.slots.len()).find(|&index| !in_use(index)).unwrap_or(self.slots.len());
        if self.wanted == self.slots.len() {
            self.slots.push(slot);
        } else {
            self.slots[self.wanted] = slot;
        }
        Some(self.wanted)
    }

    /// Whether two styles will be drawn in the next frame.
    pub fn is_fading(&self) -> bool {
        self.leaving.is_some() || (self.wanted != self.front && !self.fade.is_zero())
    }

    /// What the frame taken at `at` draws. Allocates nothing.
    pub fn turn(&mut self, at: Duration) -> Turn {
        let before = self.last.replace(at).filter(|&before| before <= at).unwrap_or(at);
        let fade = self.fade;
        let done = |leaving: Leaving| share(at.saturating_sub(leaving.begun), fade) == 256;
        if self.leaving.is_some_and(done) {
            self.leaving = None;
        }
        if self.leaving.is_none() && self.wanted != self.front {
            let leaving = Leaving { slot: self.front, begun: before };
            self.front = self.wanted;
            let front = self.front;
            self.get(front).restart();
            self.leaving = Some(leaving).filter(|&leaving| !done(leaving));
        }
        match &mut self.leaving {
            None => Turn { front: self.front, share: 256, leaving: None },
            Some(leaving) => {
                // a clip that begins again fades from there
                leaving.begun = leaving.begun.min(at);
                let share = share(at - leaving.begun, self.fade);
                Turn { front: self.front, share, leaving: Some(leaving.slot) }
            }
        }
    }

    /// The style in this slot.
    pub fn get(&mut self, slot: usize) -> &mut Styler {
        let quality = self.quality;
        let Slot { stylers, .. } = &mut self.slots[slot];
        let last = stylers.len() - 1;
        &mut stylers[quality.min(last)]
    }

    /// How many forms the style in front has: 1 unless governed.
    pub fn forms(&self) -> usize {
        self.slots[self.front].stylers.len()
    }

    /// Takes the forms that are so much simpler from the next frame on, each as far as it goes. Allocates nothing.
    pub fn set_quality(&mut self, quality: usize) {
        self.quality = quality;
        let front = self.front;
        self.get(front).restart();
    }

    /// How far the style in front is simplified.
    pub fn quality(&self) -> usize {
        self.quality.min(self.forms() - 1)
    }

    fn form(&self, slot: usize) -> &Styler {
        let stylers = &self.slots[slot].stylers;
        &stylers[self.quality.min(stylers.len() - 1)]
    }

    /// Every form of the style in this slot.
    pub fn all(&mut self, slot: usize) -> &mut [Styler] {
        &mut self.slots[slot].stylers
    }

    /// How many slots there are.
    pub fn len(&self) -> usize {
        self.slots.len()
    }

    /// What the style in this slot wants of the renderer.
    pub fn look(&self, slot: usize) -> Look {
        self.form(slot).look()
    }

    /// What the styles of the next frame want of the renderer together.
    pub fn needs(&self) -> Needs {
        let mut needs = self.look(self.front).needs.and(self.look(self.wanted).needs);
        if let Some(leaving) = self.leaving {
            needs = needs.and(self.look(leaving.slot).needs);
        }
        needs
    }

    /// Whether one of the styles of the next frame changes the picture itself.
    pub fn filters(&self) -> bool {
        let filters = |slot: usize| self.form(slot).filters();
        filters(self.front) || filters(self.wanted) || self.leaving.is_some_and(|l| filters(l.slot))
    }
}

impl Slot {
    fn new(config: &Config, level: Level, governed: bool) -> Self {
        let simpler = if governed { config.simpler() } else { Vec::new() };
        let forms = std::iter::once(config).chain(&simpler);
        Self { config: config.clone(), stylers: forms.map(|form| Styler::new(form, level)).collect() }
    }
}

/// How much of the fade has passed, of 256.
fn share(passed: Duration, fade: Duration) -> u16 {
    if passed >= fade { 256 } else { (passed.as_nanos() * 256 / fade.as_nanos()) as u16 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pixels::simd;

    fn frame(number: u64) -> Duration {
        Duration::from_millis(40 * number)
    }

    fn config(name: StyleName, cycle: &[StyleName]) -> Config {
        Config { name, fade_ms: 100, cycle: cycle.into(), ..Config::default() }
    }

    #[test]
    fn a_fade_takes_its_time_and_a_switch_within_waits() {
        let mut stylers = Stylers::new(&config(StyleName::Plain, &[]), simd::best(), false);
        assert_eq!(stylers.turn(frame(0)), Turn { front: 0, share: 256, leaving: None });
        assert_eq!(stylers.switch(&config(StyleName::Cartoon, &[])), Some(1));
        assert!(stylers.is_fading());
        assert_eq!(stylers.turn(frame(1)), Turn { front: 1, share: 102, leaving: Some(0) });
        assert_eq!(stylers.switch(&config(StyleName::Watercolor, &[])), Some(2));
        assert_eq!(stylers.switch(&config(StyleName::Illustrative, &[])), Some(2), "of two the last counts");
        assert_eq!(stylers.turn(frame(2)), Turn { front: 1, share: 204, leaving: Some(0) });
        assert_eq!(stylers.turn(frame(3)), Turn { front: 2, share: 102, leaving: Some(1) });
        assert_eq!(stylers.turn(frame(5)), Turn { front: 2, share: 256, leaving: None });
        assert_eq!(stylers.name(), StyleName::Illustrative);
        assert_eq!(stylers.switch(&config(StyleName::Cartoon, &[])), None, "still built");
        assert!(stylers.turn(frame(0)).share < 256, "a clip that begins again");
        assert_eq!(stylers.turn(frame(4)).leaving, None);
    }

    #[test]
    fn visitors_step_round_the_cycle() {
        let cycle = [StyleName::Cartoon, StyleName::Watercolor, StyleName::Illustrative];
        let mut stylers = Stylers::new(&config(StyleName::Watercolor, &cycle), simd::best(), false);
        let mut seen = Vec::new();
        for _ in 0..4 {
            seen.push(stylers.name());
            stylers.step(1);
        }
        assert_eq!(seen, [cycle[1], cycle[2], cycle[0], cycle[1]]);
        stylers.step(-3);
        assert_eq!(stylers.name(), cycle[2]);
        for (steps, lands) in [(1, cycle[0]), (-1, cycle[2])] {
            let mut outside = Stylers::new(&config(StyleName::Plain, &cycle), simd::best(), false);
            assert_eq!(outside.name(), StyleName::Plain);
            outside.step(steps);
            assert_eq!(outside.name(), lands, "from outside the cycle to its near end");
        }
        let mut alone = Stylers::new(&config(StyleName::Plain, &[]), simd::best(), false);
        alone.step(1);
        assert_eq!((alone.name(), alone.is_fading()), (StyleName::Plain, false));
    }
}
