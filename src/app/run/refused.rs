//! Settings that cannot be used at the start are said on the screen, to whoever wrote them on a card: for a moment where
//! the last good ones stand in, and until they are right where there are none.

use super::Scenes;
use super::screen::Screen;
use super::status::{Files, Reporter, Words};
use super::tally::Tally;
use crate::app::fault::Fault;
use crate::app::service::Service;
use crate::app::wishes::Wishes;
use crate::app::{Failed, one_line};
use crate::display::{Config, DisplayError, Scale, Slate};
use crate::frame::now;
use crate::pixels::Size;
use anyhow::Context;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// How long it is said where others stand in.
const MOMENT: Duration = Duration::from_secs(6);
/// How often the settings are read again where none do, a slate is drawn, and what stops the visor is looked at.
const AGAIN: Duration = Duration::from_secs(2);
const SLATE_EVERY: Duration = Duration::from_millis(250);
/// Letters a line at most.
const LINE: usize = 40;
const TITLE: &str = "SETTINGS REFUSED - S1";

/// Says it for a moment.
pub fn say(
    why: &str,
    screen: &mut Screen,
    service: &Service,
    tally: &Tally,
    stop: &AtomicBool,
) -> anyhow::Result<()> {
    let mut slate = Slate::new(screen.size());
    let end = now() + MOMENT;
    while !stop.load(Ordering::Relaxed) && !screen.closed() && now() < end {
        show(&mut slate, why, screen, service, tally)?;
        std::thread::park_timeout(SLATE_EVERY);
    }
    Ok(())
}

/// Says it until the settings can be used: those, or none where the visor is told to stop before.
pub fn wait(
    wishes: &Wishes,
    why: anyhow::Error,
    files: Files,
    service: &Service,
    stop: &AtomicBool,
) -> anyhow::Result<Option<Scenes>> {
    let mut why = one_line(&why);
    log::error!("{}: no settings to start with: {why}", Fault::Settings.code());
    let (tally, words) = (
        Arc::<Tally>::default(),
        Arc::new(Words::new(wishes.config.clone().unwrap_or_default(), Vec::new())),
    );
    tally.faults.raise(Fault::Settings);
    words.set_refused(Some(why.clone()));
    let _reporter = Reporter::start(files, tally.clone(), words.clone())
        .context(Failed("cannot start the thread that writes the status"))?;
    let config = wishes.shown_on(Config { scale: Scale::Fit, ..Config::default() });
    let mut screen = Screen::open(&config, Size::new(640, 480), true, tally.clone(), words.clone())?;
    let mut slate = Slate::new(screen.size());
    let mut due = now() + AGAIN;
    while !stop.load(Ordering::Relaxed) && !screen.closed() {
        show(&mut slate, &why, &mut screen, service, &tally)?;
        std::thread::park_timeout(SLATE_EVERY);
        if now() < due {
            continue;
        }
        match wishes.scenes() {
            Ok(scenes) => return Ok(Some(scenes)),
            Err(error) => {
                let before = std::mem::replace(&mut why, one_line(&error));
                if before != why {
                    words.set_refused(Some(why.clone()));
                }
            }
        }
        due = now() + AGAIN;
    }
    Ok(None)
}

/// One slate.
fn show(
    slate: &mut Slate,
    why: &str,
    screen: &mut Screen,
    service: &Service,
    tally: &Tally,
) -> Result<(), DisplayError> {
    let mut lines = vec![TITLE];
    lines.extend(wrapped(why));
    match screen.present(slate.draw(&lines))? {
        Some(_) => {
            service.shown();
            tally.slates.add(1);
        }
        None => service.alive(),
    }
    Ok(())
}

/// Lines of at most `LINE` letters, broken at spaces where there are any.
fn wrapped(text: &str) -> Vec<&str> {
    let mut lines = Vec::new();
    let mut rest = text.trim();
    while !rest.is_empty() {
        let longest = rest.char_indices().nth(LINE).map_or(rest.len(), |(end, _)| end);
        let end = match rest[..longest].rfind(char::is_whitespace) {
            Some(space) if longest < rest.len() => space,
            _ => longest,
        };
        lines.push(rest[..end].trim_end());
        rest = rest[end..].trim_start();
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_are_broken_into_lines() {
        let text = "visor.toml:12: unknown field `wrong`, expected one of `camera`, `model`, `style`";
        let lines = wrapped(text);
        assert!(lines.iter().all(|line| line.len() <= LINE), "{lines:?}");
        assert_eq!(lines.join(" "), text);
        assert_eq!(wrapped(&"\u{e4}".repeat(LINE + 1)).len(), 2);
        assert_eq!(wrapped("  ").len(), 0);
    }
}
