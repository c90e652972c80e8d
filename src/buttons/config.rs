//! The buttons' settings: the `[serial]` table of the visor file.

use super::Wanted;
use serde::Deserialize;
use std::path::PathBuf;

/// Settings of the serial line.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// The device, such as `"/dev/ttyACM0"`; left out, no buttons are listened to.
    pub port: Option<PathBuf>,
    /// Bits a second, 1200 to 1000000.
    pub baud: u32,
    /// What a technician may type on the line: `"off"`, `"read"` (the default) or `"full"` (press buttons, change the
    /// style).
    pub console: Console,
    /// What presses mean, a table a button. Without any: button 1 next style (long: standby), button 2 previous style,
    /// button 3 freeze.
    pub button: Vec<ButtonConfig>,
}

/// What presses of one button mean. What is left out means nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ButtonConfig {
    /// Which button, 1 to 32.
    pub number: u8,
    /// A short press.
    #[serde(default)]
    pub short: Option<Action>,
    /// Held for 1.5 s.
    #[serde(default)]
    pub long: Option<Action>,
    /// Twice within 300 ms. With this a short press is told only once no second can follow.
    #[serde(default)]
    pub double: Option<Action>,
}

impl ButtonConfig {
    fn opens_menu(&self) -> bool {
        [self.short, self.long, self.double].contains(&Some(Action::Menu))
    }
}

/// What a press may do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Action {
    /// The next style of `style.cycle`.
    StyleNext,
    /// The style before.
    StylePrevious,
    /// The picture stands still, or goes on.
    Freeze,
    /// The screen goes dark, or comes back.
    Standby,
    /// The next of `scenes`.
    SceneNext,
    /// The picture is kept, where `[snapshot]` says so.
    Snapshot,
    /// A list of styles and scenes: while it is open, short presses of this button step through it, a long one chooses.
    Menu,
}

impl Action {
    /// As in the settings and on the wire.
    pub fn name(self) -> &'static str {
        match self {
            Action::StyleNext => "style-next",
            Action::StylePrevious => "style-previous",
            Action::Freeze => "freeze",
            Action::Standby => "standby",
            Action::SceneNext => "scene-next",
            Action::Snapshot => "snapshot",
            Action::Menu => "menu",
        }
    }
}

/// What a technician may type.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Console {
    /// Nothing is answered.
    Off,
    /// What only looks: help, status, watch.
    #[default]
    Read,
    /// Also press and style.
    Full,
}

impl Default for Config {
    fn default() -> Self {
        let button = |number, short, long| ButtonConfig { number, short: Some(short), long, double: None };
        Self {
            port: None,
            baud: 115_200,
            console: Console::default(),
            button: vec![
                button(1, Action::StyleNext, Some(Action::Standby)),
                button(2, Action::StylePrevious, None),
                button(3, Action::Freeze, None),
            ],
        }
    }
}

impl Config {
    /// Whether everything is within its range; else the key and what is wrong with it.
    pub fn check(&self) -> Result<(), (&'static str, String)> {
        if !(1200..=1_000_000).contains(&self.baud) {
            return Err(("baud", format!("serial.baud = {}: 1200 to 1000000", self.baud)));
        }
        for (k, button) in self.button.iter().enumerate() {
            let number = button.number;
            if !(1..=32).contains(&number) {
                return Err(("number", format!("serial.button.number = {number}: 1 to 32")));
            }
            if self.button[..k].iter().any(|other| other.number == number) {
                return Err(("serial.button", format!("button {number} has two tables: give it one")));
            }
        }
        Ok(())
    }

    /// The kinds of presses that mean something, button by button from 1: what opens the menu chooses from it.
    pub fn wanted(&self) -> Vec<Wanted> {
        let mut wanted = vec![Wanted::default(); 32];
        for button in &self.button {
            if let Some(wanted) = wanted.get_mut(usize::from(button.number).wrapping_sub(1)) {
                let long = button.long.is_some() || button.opens_menu();
                *wanted = Wanted { long, double: button.double.is_some() };
            }
        }
        wanted
    }

    /// Whether presses of a button choose while the menu is open.
    pub fn chooses(&self, button: u8) -> bool {
        self.button.iter().any(|own| own.number == button && own.opens_menu())
    }

    /// The press that is meant while the menu is closed: one held down is only told from a short one for the menu where
    /// it means nothing of its own.
    pub fn meant(&self, button: u8, kind: super::Kind) -> super::Kind {
        match kind {
            super::Kind::Long if self.chooses(button) && self.action(button, kind).is_none() => {
                super::Kind::Short
            }
            kind => kind,
        }
    }

    /// What a press of a button means, if anything.
    pub fn action(&self, button: u8, kind: super::Kind) -> Option<Action> {
        let own = self.button.iter().find(|own| own.number == button)?;
        match kind {
            super::Kind::Short => own.short,
            super::Kind::Long => own.long,
            super::Kind::Double => own.double,
        }
    }
}
