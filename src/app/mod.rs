//! The top floor: what was typed becomes what is done. One file a subcommand.
//!
//! Exit codes: 0 done; 1 the work failed; 2 bad usage or input. Errors are one line on stderr that names the
//! thing and what to do.

mod bench;
pub mod config;
mod demo;
mod detect;
mod draw;
mod logging;
mod plan;
mod progress;
mod render;
mod report;
mod run;
mod stylize;

use clap::{Parser, Subcommand};
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
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("vernissage: {error:#}");
            ExitCode::from(if error.downcast_ref::<Failed>().is_some() { 1 } else { 2 })
        }
    }
}

/// A pool of `threads` workers: everything a command computes runs inside it.
pub(crate) fn pool(threads: usize) -> anyhow::Result<rayon::ThreadPool> {
    anyhow::ensure!((1..=64).contains(&threads), "--threads {threads}: give a number from 1 to 64");
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|e| anyhow::anyhow!(e).context(Failed("cannot start worker threads")))
}
