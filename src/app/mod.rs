//! The top floor: what was typed becomes what is done. One file a subcommand.
//!
//! Exit codes: 0 done; 1 the work failed; 2 bad usage or input. Errors are one line on stderr that names the
//! thing and what to do.

pub mod bench;
mod calibrate;
mod check;
pub mod config;
mod demo;
mod detect;
mod doctor;
mod draw;
mod fault;
mod logging;
mod machine;
mod manual;
mod menu;
mod plan;
mod presses;
mod probe;
mod progress;
mod render;
mod report;
mod run;
mod service;
mod sheet;
mod stylize;
mod wishes;

use crate::camera::CameraError;
use crate::display::DisplayError;
use crate::pixels::picture::PictureError;
use clap::{Parser, Subcommand};
use std::fmt::Display;
use std::io::{ErrorKind, Write};
use std::process::ExitCode;

/// Turns an ARM board, a camera and a small display into a stylised-reality visor.
#[derive(Parser)]
#[command(name = "vernissage", version = report::VERSION)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(Subcommand)]
enum Command {
    Demo(demo::Args),
    Run(run::Args),
    Render(render::Args),
    Stylize(stylize::Args),
    Detect(detect::Args),
    Draw(draw::Args),
    Plan(plan::Args),
    Bench(bench::Args),
    Sheet(sheet::Args),
    Calibrate(calibrate::Args),
    Check(check::Args),
    Probe(probe::Args),
    Doctor(doctor::Args),
    Completions(manual::Completions),
    Manual(manual::Manual),
}

/// Marks an error as a failure of the work (exit 1), not of what was asked for (exit 2). Attach it with
/// `.context(Failed("what was being done"))`.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct Failed(pub &'static str);

/// Parses the command line, runs the command, prints the error if there is one.
pub fn main() -> ExitCode {
    logging::start();
    let command = Cli::parse().command.unwrap_or(Command::Demo(demo::Args::default()));
    let done = match command {
        Command::Demo(args) => demo::run(args),
        Command::Run(args) => run::run(args),
        Command::Render(args) => render::run(args),
        Command::Stylize(args) => stylize::run(args),
        Command::Detect(args) => detect::run(args),
        Command::Draw(args) => draw::run(args),
        Command::Plan(args) => plan::run(args),
        Command::Bench(args) => bench::run(args),
        Command::Sheet(args) => sheet::run(args),
        Command::Calibrate(args) => calibrate::run(args),
        Command::Check(args) => check::run(args),
        Command::Probe(args) => probe::run(args),
        Command::Doctor(args) => doctor::run(args),
        Command::Completions(args) => manual::completions(args),
        Command::Manual(_) => manual::manual(),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        // `vernissage detect .. | head -1`: whoever read has what they wanted
        Err(error) if error.downcast_ref::<ReaderGone>().is_some() => ExitCode::SUCCESS,
        Err(error) => {
            logging::line(format_args!("vernissage: {}", one_line(&error)));
            ExitCode::from(if is_failure(&error) { 1 } else { 2 })
        }
    }
}

/// Whether the work failed, rather than what was asked for: marked so, or something could not be written.
fn is_failure(error: &anyhow::Error) -> bool {
    error.downcast_ref::<Failed>().is_some()
        || error.chain().any(|cause| {
            matches!(cause.downcast_ref(), Some(PictureError::Write { .. }))
                || matches!(
                    cause.downcast_ref(),
                    Some(DisplayError::Write { .. } | DisplayError::ReaderGone { .. })
                )
                || matches!(cause.downcast_ref(), Some(CameraError::Write { .. }))
        })
}

/// The error and its causes in one line; a cause that the text before it already tells is not told again.
pub(crate) fn one_line(error: &anyhow::Error) -> String {
    let mut line = String::new();
    for cause in error.chain() {
        let text = cause.to_string();
        if line.is_empty() {
            line = text;
        } else if !line.contains(&text) {
            line = format!("{line}: {text}");
        }
    }
    line.lines().map(str::trim).collect::<Vec<_>>().join(" ")
}

/// Nobody reads stdout any longer.
#[derive(Debug, thiserror::Error)]
#[error("the reader of stdout has gone")]
struct ReaderGone;

/// Prints a line on stdout. `println!` would panic where stdout is closed or full.
pub(crate) fn say(line: impl Display) -> anyhow::Result<()> {
    writeln!(std::io::stdout(), "{line}").map_err(|error| match error.kind() {
        ErrorKind::BrokenPipe => ReaderGone.into(),
        _ => anyhow::Error::new(error).context(Failed("cannot write to stdout")),
    })
}

/// A pool of `threads` workers: everything a command computes runs inside it.
pub(crate) fn pool(threads: usize) -> anyhow::Result<rayon::ThreadPool> {
    anyhow::ensure!((1..=64).contains(&threads), "--threads {threads}: give a number from 1 to 64");
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|e| anyhow::anyhow!(e).context(Failed("cannot start worker threads")))
}
