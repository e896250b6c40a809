//! The program `inerter`: one file per command in `cmd`, the views of a live device in `monitor`, dialogues in
//! `calibrate`.
//!
//! The libraries beside this crate do a command's work; this crate asks, shows, and decides the exit code.

#![cfg_attr(not(feature = "lean"), allow(dead_code, reason = "a smaller program has the same command line"))]

mod calibrate;
mod cmd;
mod error;
mod exit;
mod feature;
#[cfg(test)]
mod hostile;
mod monitor;

use error::{Error, Shown, is_broken_pipe};

use std::{
    ffi::OsString,
    io::{self, IsTerminal, Write},
    path::PathBuf,
    process::ExitCode,
};

use clap::{CommandFactory, Parser};
use cmd::{Command, config};
use inerter_data::words::printable;
use inerter_flags::ConfigError;

/// Reads the effective inertance, friction and backlash of an inerter while it moves.
#[derive(Parser)]
#[command(name = "inerter", version, after_help = AFTER_HELP, max_term_width = 110)]
struct Cli {
    /// Read flags from a TOML file [default: inerter.toml in the current folder, if there is one]
    #[arg(long, value_name = "FILE.toml", global = true, help_heading = "Other")]
    config: Option<PathBuf>,
    #[command(subcommand)]
    command: Command,
}

const AFTER_HELP: &str = "\
Try it without hardware:
  inerter simulate -o run.mcap --duration 20    a recording of a simulated inerter
  inerter replay run.mcap                       the estimates from it
  inerter simulate --tcp 127.0.0.1:7878         a live simulated inerter; then, in another terminal:
  inerter monitor --connect 127.0.0.1:7878

Exit codes: 0 done, 1 other failure, 2 wrong command line, 3 input file, 4 settings or parameters,
5 device or probe not found or not opened, 6 device went away or refused, 7 wire version,
8 output not written, 9 the motion cannot identify what was asked, 10 a board failed its self-test
or a device its limits, 130 interrupted.";

fn main() -> ExitCode {
    let is_terminal = io::stderr().is_terminal();
    // Outside a terminal lines are not wrapped, so that they can be searched.
    let options = miette::MietteHandlerOpts::new()
        .unicode(is_terminal)
        .wrap_lines(is_terminal)
        .break_words(false)
        .without_cause_chain();
    let options = if is_terminal { options } else { options.color(false).width(10_000) };
    // Fails only if a hook is already set.
    miette::set_hook(Box::new(move |_| Box::new(options.clone().build()))).ok();
    match run() {
        Err(error) if !is_broken_pipe(&error) => {
            let code = exit::code(&error);
            // If standard error is closed, nobody reads it.
            let report = format!("{:?}", Error::new(Shown(error)));
            writeln!(io::stderr(), "{}", report.trim_end()).ok();
            ExitCode::from(code)
        }
        Ok(()) | Err(_) => ExitCode::from(exit::OK),
    }
}

fn run() -> Result<(), Error> {
    parse()?.command.run(Cli::command)?;
    Ok(inerter_data::output::flush()?)
}

/// The command line, with values from `inerter.toml` where nothing was typed.
fn parse() -> Result<Cli, ConfigError> {
    let typed: Vec<OsString> = std::env::args_os().collect();
    let words = match inerter_flags::file(&typed).filter(|_| !inerter_flags::is_about_the_program(&typed)) {
        Some(file) => config::apply(&Cli::command(), &file, &typed)?,
        None => typed,
    };
    Ok(Cli::try_parse_from(&words).unwrap_or_else(|error| refuse(&words, error)))
}

/// Prints clap's error or the requested help, and exits. Clap repeats the arguments, and a file name may hold any
/// characters, so the arguments are made printable and parsed again.
fn refuse(words: &[OsString], error: clap::Error) -> ! {
    let shown: Vec<String> = words.iter().map(|word| printable(&word.to_string_lossy()).into_owned()).collect();
    Cli::try_parse_from(shown).err().unwrap_or(error).exit()
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        super::Cli::command().debug_assert();
    }
}
