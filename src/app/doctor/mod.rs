//! `vernissage doctor`: what is wrong, why, and what to do.
//!
//! `facts` looks at the machine, `diagnose` draws the conclusions: a pure function, tested as a table.

mod diagnose;
mod facts;

use super::{Failed, say};
use diagnose::{Finding, Weight, diagnose};
use std::path::PathBuf;

/// Finds what keeps the visor from running, and says what to do about it.
///
/// Looks at cameras (missing, no right, held by another program, too much for USB), the screen (no card, nothing plugged
/// in, another program drawing on it), the serial port, the state folder, clock and heat, and at the visor file if one is
/// given. As root it sees which programs of other users hold a device. Exit code 0 where nothing keeps it from running,
/// else 1.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  vernissage doctor\n  sudo vernissage doctor /etc/vernissage/visor.toml")]
pub struct Args {
    /// Visor file
    #[arg(value_name = "FILE")]
    config: Option<PathBuf>,
    /// Print each finding as a JSON object
    #[arg(long)]
    json: bool,
}

pub fn run(args: Args) -> anyhow::Result<()> {
    let facts = facts::collect(args.config.as_deref());
    let findings = diagnose(&facts);
    for Finding { weight, what, evidence, todo } in &findings {
        if args.json {
            let weight = weight.name();
            say(serde_json::json!({ "weight": weight, "what": what, "evidence": evidence, "do": todo }))?;
        } else {
            say(format_args!("{:<6} {what}\n       seen: {evidence}", weight.name()))?;
            if !todo.is_empty() {
                say(format_args!("       do:   {todo}"))?;
            }
        }
    }
    let wrong = findings.iter().filter(|finding| finding.weight == Weight::Wrong).count();
    match wrong {
        0 => Ok(()),
        1 => Err(anyhow::anyhow!("1 thing keeps the visor from running").context(Failed("doctor"))),
        _ => Err(anyhow::anyhow!("{wrong} things keep the visor from running").context(Failed("doctor"))),
    }
}
