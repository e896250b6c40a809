//! Programs that measure longer than a test may.

use crate::{
    process,
    table::Options,
    tree,
    workspace::{self, Part},
};
use anyhow::Result;
use std::{ffi::OsStr, process::Command};

/// Compare with the committed table, or write it; measuring all of it takes long.
#[derive(clap::Args)]
pub struct LongOptions {
    /// Measure only the first rig, with the device that is not worn
    #[arg(long, conflicts_with = "update")]
    pub short: bool,
    #[command(flatten)]
    pub table: Options,
}

/// Arguments passed on to the program.
#[derive(clap::Args)]
pub struct Arguments {
    /// Arguments of the program itself
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    pub arguments: Vec<String>,
}

/// Runs the program that measures the table of this name in docs/tables and compares or writes it.
pub fn table(name: &str, options: &Options) -> Result<()> {
    tested(name, options.update.then_some("--update"))
}

/// The same for a table whose first rig can be measured alone.
pub fn long_table(name: &str, options: &LongOptions) -> Result<()> {
    if options.short { tested(name, ["--short"]) } else { table(name, &options.table) }
}

/// Runs a program with arguments of its own, built for speed.
pub fn with_arguments(name: &str, arguments: &Arguments) -> Result<()> {
    program(Part::Main, "measure", [name].into_iter().chain(arguments.arguments.iter().map(String::as_str)))
}

/// Runs one of them as built for the tests: optimised too, but with overflow checks.
pub fn tested(name: &str, arguments: impl IntoIterator<Item: AsRef<OsStr>>) -> Result<()> {
    let measure = workspace::tested(Part::Main, "measure")?;
    process::run(Command::new(measure).arg(name).args(arguments).current_dir(tree::root()))
}

/// Runs one of them built for speed, without overflow checks.
pub fn program(part: Part, name: &str, arguments: impl IntoIterator<Item: AsRef<OsStr>>) -> Result<()> {
    let run = ["run", "--release", "--quiet"];
    process::run(part.cargo().args(run).args(part.features()).args(["--bin", name, "--"]).args(arguments))
}
