//! What a visitor may choose from the menu: the styles of the visor, its scenes, and the way back.

use crate::buttons::Kind;
use crate::display::{Menu, Seen};
use crate::pixels::Rgb;
use crate::style::{self, StyleName};
use clap::ValueEnum;
use std::time::Duration;

/// What a line of the menu means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Choice {
    /// Another style, or the one that is shown.
    Style(StyleName),
    /// The scene with this number.
    Scene(usize),
    /// As it is.
    Back,
}

/// The menu and its meaning.
pub struct Choices {
    menu: Menu,
    all: Vec<Choice>,
    scenes: Vec<String>,
}

impl Choices {
    /// The styles of `style.cycle`, or all where it names none; the scenes, where there is more than one.
    pub fn new(style: &style::Config, scenes: Vec<String>) -> Self {
        let mut choices = Self { menu: Menu::default(), all: Vec::new(), scenes };
        choices.set_style(style);
        choices
    }

    /// Other settings. Closes the menu.
    pub fn set_style(&mut self, style: &style::Config) {
        let all = StyleName::value_variants();
        let styles = if style.cycle.is_empty() { all } else { &style.cycle };
        let scenes = if self.scenes.len() > 1 { &self.scenes[..] } else { &[] };
        self.all = styles.iter().copied().map(Choice::Style).collect();
        self.all.extend((0..scenes.len()).map(Choice::Scene));
        self.all.push(Choice::Back);
        let mut lines: Vec<String> = styles.iter().map(|style| style.name().into()).collect();
        lines.extend(scenes.iter().map(|name| format!("scene {name}")));
        lines.push("back".into());
        self.menu.set_lines(lines);
    }

    /// Opens the menu at `time`, at the style that is shown.
    pub fn open(&mut self, time: Duration, style: StyleName, scene: usize) {
        let now = [Choice::Style(style), Choice::Scene(scene)];
        self.menu.open(time, |line| now.contains(&self.all[line]));
    }

    /// Whether it is open at `time`.
    pub fn is_open(&mut self, time: Duration) -> bool {
        self.menu.chosen(time).is_some()
    }

    /// A press at `time` while it is open: a short one steps, a long one chooses and closes, a double one closes.
    pub fn pressed(&mut self, kind: Kind, time: Duration) -> Option<Choice> {
        let chosen = self.menu.chosen(time);
        match kind {
            Kind::Short => {
                self.menu.step(time);
                return None;
            }
            Kind::Long | Kind::Double => self.menu.close(),
        }
        chosen.filter(|_| kind == Kind::Long).and_then(|line| self.all.get(line).copied())
    }

    /// Closes it.
    pub fn close(&mut self) {
        self.menu.close();
    }

    /// The picture as it is to be shown at `time` on a screen that shows this part of it.
    pub fn over<'a>(&'a mut self, picture: &'a Rgb, seen: Seen, time: Duration) -> &'a Rgb {
        self.menu.over(picture, seen, time)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_steps_long_chooses_double_leaves() {
        let cycle = vec![StyleName::Plain, StyleName::Cartoon];
        let style = style::Config { cycle, ..style::Config::default() };
        let at = Duration::from_secs;
        let mut menu = Choices::new(&style, vec!["day".into(), "night".into()]);
        let all = [
            Choice::Style(StyleName::Plain),
            Choice::Style(StyleName::Cartoon),
            Choice::Scene(0),
            Choice::Scene(1),
            Choice::Back,
        ];
        for steps in 0..2 * all.len() {
            menu.open(at(1), StyleName::Cartoon, 0);
            for _ in 0..steps {
                assert_eq!(menu.pressed(Kind::Short, at(2)), None);
            }
            assert_eq!(menu.pressed(Kind::Long, at(3)), Some(all[(1 + steps) % all.len()]));
            assert!(!menu.is_open(at(3)));
        }
        menu.open(at(1), StyleName::Cartoon, 0);
        assert_eq!((menu.pressed(Kind::Double, at(2)), menu.is_open(at(2))), (None, false));
        menu.open(at(1), StyleName::Cartoon, 0);
        assert_eq!(menu.pressed(Kind::Long, at(60)), None, "it has closed by itself");
        // one scene is no choice; without a cycle all styles are
        let mut menu = Choices::new(&style::Config::default(), vec!["visor".into()]);
        assert_eq!(menu.all.len(), StyleName::value_variants().len() + 1);
        menu.open(at(1), StyleName::Watercolor, 0);
        assert_eq!(menu.pressed(Kind::Long, at(1)), Some(Choice::Style(StyleName::Watercolor)));
    }
}
