//! Programs of `inerter-tests` that take longer than a test may.

use crate::process;
use anyhow::Result;

/// Compare with the committed table, or write it.
#[derive(clap::Args, Clone, Copy, Debug, Default)]
pub struct Options {
    /// Write the table instead of comparing with it
    #[arg(long)]
    pub update: bool,
}

/// What is handed on to the program.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct Arguments {
    /// Arguments of the program itself
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    pub arguments: Vec<String>,
}

/// A program that measures a table, and itself compares or writes it: the one of this name in docs/tables.
pub fn table(name: &str, options: &Options) -> Result<()> {
    start(&[], name, if options.update { &["--update"] } else { &[] })
}

/// A program that takes arguments of its own.
pub fn with_arguments(name: &str, arguments: &Arguments) -> Result<()> {
    program(name, &arguments.arguments.iter().map(String::as_str).collect::<Vec<_>>())
}

/// Runs one of the programs of `inerter-tests`, for speed: built for it, without checks of overflow.
pub fn program(name: &str, arguments: &[&str]) -> Result<()> {
    start(&["--release"], name, arguments)
}

/// Runs one of them; the profile of the tests, optimised as well, is there already when they run.
fn start(profile: &[&str], name: &str, arguments: &[&str]) -> Result<()> {
    let mut command = process::cargo();
    command.arg("run").args(profile).args(["--quiet", "--package", "inerter-tests", "--bin", name, "--"]);
    process::run(command.args(arguments))
}
