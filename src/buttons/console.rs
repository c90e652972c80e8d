//! What a technician types on the line, and the `#` lines that answer.

use super::{Console, Mode, Status};

/// A line of console text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Command<'a> {
    Help,
    Status,
    Watch,
    Press(u8),
    Style(&'a str),
}

impl<'a> Command<'a> {
    /// What was typed; else why it will not be done.
    pub fn parse(text: &'a str, console: Console) -> Result<Self, &'static str> {
        let mut words = text.split_ascii_whitespace();
        let command = match (words.next(), words.next(), words.next()) {
            (Some("help"), None, _) => Self::Help,
            (Some("status"), None, _) => Self::Status,
            (Some("watch"), None, _) => Self::Watch,
            (Some("press"), Some(number), None) => match number.parse() {
                Ok(number @ 1..=32) => Self::Press(number),
                _ => return Err("press which button? 1 to 32"),
            },
            (Some("style"), Some(name), None) => Self::Style(name),
            _ => return Err("not understood; type help"),
        };
        let writes = matches!(command, Self::Press(_) | Self::Style(_));
        if writes && console != Console::Full {
            return Err("only with console = \"full\" in [serial] of the visor file");
        }
        Ok(command)
    }
}

/// The lines that `help` is answered with.
pub(super) const HELP: [&str; 4] = [
    "status: how things stand now",
    "watch: the same every second, and every press; again to end it",
    "press N, style NAME: only with console = \"full\"",
    "VBP/1 frames begin with $",
];

/// How things stand, in one line of at most 90 bytes.
pub(super) fn status(status: &Status, up_s: u64, link: &str) -> String {
    let Status { mode, fps10, style, faults, .. } = status;
    let (count, mode) = (status.markers.len(), Mode::name(*mode));
    let line = format!(
        "{mode} {style} {}.{} fps, {count} markers, faults {faults:08X}, up {up_s} s, board {link}",
        fps10 / 10,
        fps10 % 10
    );
    line.chars().take(90).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn writing_needs_the_full_console() {
        let full = |text| Command::parse(text, Console::Full);
        assert_eq!(full(" help "), Ok(Command::Help));
        assert_eq!(full("press 3"), Ok(Command::Press(3)));
        assert_eq!(full("style cartoon"), Ok(Command::Style("cartoon")));
        for wrong in
            ["press", "press 0", "press 33", "press one", "press 1 2", "style", "rm -rf /", "help me", ""]
        {
            assert!(full(wrong).is_err(), "{wrong}");
        }
        for writing in ["press 1", "style cartoon"] {
            assert!(Command::parse(writing, Console::Read).expect_err("refused").contains("full"));
        }
        assert_eq!(Command::parse("watch", Console::Read), Ok(Command::Watch));
    }
}
