//! `inerter completions` and `inerter man`: what a shell and a manual reader want to know.

use std::path::PathBuf;

use clap::Command;
use clap_complete::Shell;
use inerter_data::output;

use super::terminal::say;
use crate::Error;

/// Print what a shell needs to complete this program's command lines.
///
/// For example: inerter completions bash > ~/.local/share/bash-completion/completions/inerter
#[derive(clap::Args)]
pub struct Args {
    /// Which shell
    shell: Shell,
}

/// Write the manual pages, one for each command.
///
/// For example: inerter man -o ~/.local/share/man/man1, then: man inerter-record
#[derive(clap::Args)]
pub struct ManArgs {
    /// Folder to write them to; it is made when it does not exist
    #[arg(short, long, value_name = "FOLDER")]
    output: PathBuf,
}

pub fn run(args: &Args, mut command: Command) -> Result<(), Error> {
    let mut text = Vec::new();
    clap_complete::generate(args.shell, &mut command, "inerter", &mut text);
    Ok(output::text(String::from_utf8_lossy(&text))?)
}

pub fn man(args: &ManArgs, command: Command) -> Result<(), Error> {
    let failed = |source| output::OutputError::Create { path: args.output.clone(), source };
    std::fs::create_dir_all(&args.output).map_err(failed)?;
    // Pages that name each other need the whole tree built first.
    clap_mangen::generate_to(command, &args.output).map_err(failed)?;
    say(format!("manual pages written to {}", args.output.display()));
    Ok(())
}
