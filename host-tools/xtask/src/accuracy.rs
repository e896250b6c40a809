//! Programs of `inerter-tests` that take longer than a test may.

use crate::process;
use anyhow::Result;

/// Compare with the committed table, or write it.
#[derive(clap::Args, Clone, Copy, Debug, Default)]
pub struct Options {
    /// Write docs/tables/accuracy.md instead of comparing with it
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

/// The grid of motions and seeds; the program itself compares and writes.
pub fn run(options: &Options) -> Result<()> {
    program("accuracy", if options.update { &["--update"] } else { &[] })
}

/// Fixed point beside f64 over a long run.
pub fn long_run(arguments: &Arguments) -> Result<()> {
    program("longrun", &arguments.arguments.iter().map(String::as_str).collect::<Vec<_>>())
}

/// Runs one of the programs of `inerter-tests`, optimised.
pub fn program(name: &str, arguments: &[&str]) -> Result<()> {
    let mut command = process::cargo();
    command.args(["run", "--release", "--quiet", "--package", "inerter-tests", "--bin", name, "--"]).args(arguments);
    process::run(&mut command)
}
