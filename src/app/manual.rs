//! `vernissage completions` and `vernissage manual`: the command line told to shells and to `man`.

use super::{Cli, Failed};
use anyhow::Context;
use clap::CommandFactory;
use clap_complete::Shell;
use std::io::Write;

/// Prints the completions of a shell.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  vernissage completions bash > /etc/bash_completion.d/vernissage\n  \
    vernissage completions fish > ~/.config/fish/completions/vernissage.fish")]
pub struct Completions {
    /// The shell
    #[arg(value_enum, value_name = "SHELL")]
    shell: Shell,
}

/// Prints the manual page.
///
/// One page: the commands, each with its options and examples.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  vernissage manual > /usr/share/man/man1/vernissage.1\n  \
    vernissage manual | man -l -")]
pub struct Manual {}

pub fn completions(args: Completions) -> anyhow::Result<()> {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "vernissage", &mut text);
    print(&text)
}

pub fn manual() -> anyhow::Result<()> {
    let mut text = Vec::new();
    let mut command = Cli::command();
    // gives the parts their full names
    command.build();
    let page = clap_mangen::Man::new(command.clone());
    let write = "cannot write the manual";
    page.render_title(&mut text).context(Failed(write))?;
    page.render_name_section(&mut text).context(Failed(write))?;
    page.render_synopsis_section(&mut text).context(Failed(write))?;
    page.render_description_section(&mut text).context(Failed(write))?;
    for sub in command.get_subcommands().filter(|sub| sub.get_name() != "help") {
        let page = clap_mangen::Man::new(sub.clone());
        writeln!(text, ".SH VERNISSAGE {}", sub.get_name().to_uppercase())?;
        let mut part = Vec::new();
        page.render_synopsis_section(&mut part).context(Failed(write))?;
        page.render_description_section(&mut part).context(Failed(write))?;
        page.render_options_section(&mut part).context(Failed(write))?;
        page.render_extra_section(&mut part).context(Failed(write))?;
        // sections within the command's own
        text.extend(String::from_utf8_lossy(&part).replace("\n.SH ", "\n.SS ").trim_start().bytes());
        text.push(b'\n');
    }
    text.extend(EXIT.bytes());
    print(&text)
}

const EXIT: &str = ".SH \"EXIT STATUS\"\n0 done; 1 the work failed; 2 bad usage or input.\n\
    .SH ENVIRONMENT\nVERNISSAGE_LOG: off, error, warn, info (as it is), debug or trace.\n";

/// Text on stdout as it is.
fn print(text: &[u8]) -> anyhow::Result<()> {
    super::say(String::from_utf8_lossy(text).trim_end())
}
