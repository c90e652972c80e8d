//! A camera's controls: which settings go to which control, in which order. Pure; `v4l2` carries it out.
//!
//! Automatic modes go first: a driver refuses, or forgets, an exposure that is set while the automatic one is on.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;

/// Numbers of `linux/v4l2-controls.h`.
pub(super) const AUTOGAIN: u32 = 0x0098_0912;
pub(super) const GAIN: u32 = 0x0098_0913;
pub(super) const AUTO_WHITE_BALANCE: u32 = 0x0098_090c;
pub(super) const WHITE_BALANCE: u32 = 0x0098_091a;
pub(super) const EXPOSURE_AUTO: u32 = 0x009a_0901;
pub(super) const EXPOSURE: u32 = 0x009a_0902;
/// `V4L2_EXPOSURE_MANUAL`.
const MANUAL: i64 = 1;

/// What a camera tells of a control.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Control {
    /// Its number.
    pub id: u32,
    /// Its name as `v4l2-ctl` writes it: lower case, `_` for all else.
    pub name: String,
    /// Least value.
    pub min: i64,
    /// Largest value.
    pub max: i64,
    /// From one value to the next, at least 1.
    pub step: i64,
}

/// A name as `v4l2-ctl` writes it: `Exposure Time, Absolute` → `exposure_time_absolute`.
pub(super) fn plain_name(name: &str) -> String {
    let words = name.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    words.map(str::to_ascii_lowercase).collect::<Vec<_>>().join("_")
}

/// How bright pictures are to be.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Exposure {
    /// As the camera likes.
    #[default]
    Auto,
    /// As the camera likes for a while, then as it is: styles do not pump with the light.
    Lock,
    /// Fixed, in the camera's units (`camera.exposure_value`).
    Fixed,
}

/// A value for a control.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Setting {
    pub id: u32,
    pub name: String,
    pub value: i64,
}

/// What to set, in order, and what cannot be set and why. Values beyond a control's range are brought into it.
pub(super) fn settings(wanted: &BTreeMap<String, i64>, known: &[Control]) -> (Vec<Setting>, Vec<String>) {
    let (mut list, mut wrong) = (Vec::new(), Vec::new());
    for (name, &value) in wanted {
        let Some(control) = known.iter().find(|control| control.name == *name) else {
            let nearest = known.iter().min_by_key(|control| strsim::levenshtein(&control.name, name));
            wrong.push(match nearest {
                Some(control) => format!("no control {name}; did you mean {}?", control.name),
                None => format!("no control {name}: the camera has none"),
            });
            continue;
        };
        let (low, high) = (control.min, control.max.max(control.min));
        let fitted = low + (value.clamp(low, high) - low) / control.step.max(1) * control.step.max(1);
        if fitted != value {
            wrong.push(format!("{name} = {value}: the camera takes {low} to {high}; {fitted} is used"));
        }
        list.push(Setting { id: control.id, name: name.clone(), value: fitted });
    }
    list.sort_by_key(|setting| !is_mode(setting.id, &setting.name));
    (list, wrong)
}

fn is_mode(id: u32, name: &str) -> bool {
    [AUTOGAIN, AUTO_WHITE_BALANCE, EXPOSURE_AUTO].contains(&id) || name.contains("auto")
}

/// The switches from automatic to fixed: the mode's control, its fixed value, and the control that then counts.
pub(super) const LOCKS: [(u32, i64, u32); 3] =
    [(EXPOSURE_AUTO, MANUAL, EXPOSURE), (AUTOGAIN, 0, GAIN), (AUTO_WHITE_BALANCE, 0, WHITE_BALANCE)];

/// What to set for a fixed exposure.
pub(super) fn fixed(value: i64, known: &[Control]) -> Vec<Setting> {
    let name = |id: u32| known.iter().find(|control| control.id == id).map(|control| control.name.clone());
    let setting = |(id, value)| Some(Setting { id, name: name(id)?, value });
    [(EXPOSURE_AUTO, MANUAL), (EXPOSURE, value)].into_iter().filter_map(setting).collect()
}

/// When the automatic exposure is to be locked: so long after the stream's first picture, once.
#[derive(Clone, Copy, Debug)]
pub(super) struct LockClock {
    after: Duration,
    first: Option<Duration>,
    done: bool,
}

impl LockClock {
    pub(super) fn new(after: Duration) -> Self {
        Self { after, first: None, done: false }
    }

    /// A picture came at `now`; whether it is time.
    pub(super) fn strikes(&mut self, now: Duration) -> bool {
        let first = *self.first.get_or_insert(now);
        let time = !self.done && now.saturating_sub(first) >= self.after;
        self.done |= time;
        time
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn known() -> Vec<Control> {
        let control = |id, name: &str, min, max, step| Control { id, name: name.into(), min, max, step };
        vec![
            control(0x0098_0900, "brightness", 0, 255, 1),
            control(AUTO_WHITE_BALANCE, "white_balance_automatic", 0, 1, 1),
            control(WHITE_BALANCE, "white_balance_temperature", 2800, 6500, 10),
            control(EXPOSURE_AUTO, "auto_exposure", 0, 3, 1),
            control(EXPOSURE, "exposure_time_absolute", 3, 2047, 1),
        ]
    }

    #[test]
    fn modes_go_first_and_values_are_brought_into_range() {
        let wanted =
            [("exposure_time_absolute", 5000), ("auto_exposure", 1), ("brightness", 128), ("contrats", 1)];
        let wanted = wanted.map(|(name, value)| (name.to_owned(), value)).into();
        let (list, wrong) = settings(&wanted, &known());
        let order: Vec<_> = list.iter().map(|s| (s.name.as_str(), s.value)).collect();
        assert_eq!(order, [("auto_exposure", 1), ("brightness", 128), ("exposure_time_absolute", 2047)]);
        assert_eq!(wrong.len(), 2, "{wrong:?}");
        assert!(wrong[0].starts_with("no control contrats; did you mean"), "{wrong:?}");
        assert!(wrong[1].contains("takes 3 to 2047; 2047 is used"), "{wrong:?}");
        let (list, _) = settings(&[("white_balance_temperature".to_owned(), 4007)].into(), &known());
        assert_eq!(list[0].value, 4000, "steps of ten");
        let (list, wrong) = settings(&wanted_one("x"), &[]);
        assert!(list.is_empty() && wrong[0].contains("has none"));
    }

    fn wanted_one(name: &str) -> BTreeMap<String, i64> {
        [(name.to_owned(), 1)].into()
    }

    #[test]
    fn a_fixed_exposure_turns_the_automatic_one_off_first() {
        let order: Vec<_> = fixed(300, &known()).iter().map(|s| (s.id, s.value)).collect();
        assert_eq!(order, [(EXPOSURE_AUTO, MANUAL), (EXPOSURE, 300)]);
        assert!(fixed(300, &known()[..1]).is_empty(), "a camera without");
    }

    #[test]
    fn the_lock_strikes_once() {
        let s = Duration::from_secs;
        let mut clock = LockClock::new(s(3));
        let struck: Vec<bool> = [10, 11, 13, 14, 20].map(|at| clock.strikes(s(at))).into();
        assert_eq!(struck, [false, false, true, false, false]);
    }

    #[test]
    fn names_are_those_of_v4l2_ctl() {
        assert_eq!(plain_name("Exposure Time, Absolute"), "exposure_time_absolute");
        assert_eq!(plain_name("White Balance, Automatic"), "white_balance_automatic");
        assert_eq!(plain_name(" Gain "), "gain");
    }
}
