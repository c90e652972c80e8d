//! Log lines on stderr; under a service manager with the priority it understands in front.
//!
//! error = a bug; warn = odd hardware or settings; info = what a technician wants to know; debug = the rest.

use log::{Level, LevelFilter, Log, Metadata, Record};
use std::io::Write;

struct Stderr {
    /// Whether stderr goes to the journal.
    journal: bool,
}

/// Starts logging at info, or at the level that `VERNISSAGE_LOG` names (off, error, warn, info, debug, trace).
pub fn start() {
    let wanted = std::env::var("VERNISSAGE_LOG").ok().and_then(|name| name.parse().ok());
    let logger = Stderr { journal: std::env::var_os("JOURNAL_STREAM").is_some() };
    // a second start (tests in one process) keeps the first logger
    if log::set_boxed_logger(Box::new(logger)).is_ok() {
        log::set_max_level(wanted.unwrap_or(LevelFilter::Info));
    }
}

/// A line on stderr, if anyone takes it: the journal may restart under a visor that runs for months, and
/// `eprintln!` would panic.
pub fn line(text: std::fmt::Arguments<'_>) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

impl Log for Stderr {
    fn enabled(&self, metadata: &Metadata<'_>) -> bool {
        metadata.target().starts_with(env!("CARGO_PKG_NAME"))
    }

    fn log(&self, record: &Record<'_>) {
        if !self.enabled(record.metadata()) {
            return;
        }
        if self.journal {
            let priority = match record.level() {
                Level::Error => 3,
                Level::Warn => 4,
                Level::Info => 6,
                Level::Debug | Level::Trace => 7,
            };
            line(format_args!("<{priority}>{}", record.args()));
        } else {
            let level = record.level().as_str().to_lowercase();
            line(format_args!("vernissage: {level}: {}", record.args()));
        }
    }

    fn flush(&self) {}
}
