//! How fast the Python package replays, compared with the program and numpy (`docs/tables/rates.md`), and what many
//! runs cost (`docs/tables/scale.md`).

use crate::{process, python, table::Options, tree, wheel, workspace};
use anyhow::{Result, ensure};
use std::{path::PathBuf, process::Command};

/// The script's imports besides the package.
const IMPORTS: &str = "numpy, pyarrow";
const REQUIREMENTS: &str = "tests/python/files-requirements.txt";
/// Length of the runs.
const DURATION_S: &str = "600";

/// Runs of `scale`, by default.
const RUNS: u32 = 10_000;
/// The import of its script besides the package.
const CLUSTER: &str = "distributed";

#[derive(clap::Args)]
pub struct ScaleOptions {
    /// Number of runs
    #[arg(long, value_name = "N", default_value_t = RUNS, value_parser = clap::value_parser!(u32).range(2..))]
    runs: u32,
    /// Write the table instead of printing it
    #[arg(long)]
    update: bool,
}

/// Program and package as they are released.
struct Released {
    folder: PathBuf,
    python: PathBuf,
    program: PathBuf,
}

/// Makes them; `folder` is below `target`.
fn released(folder: &str, imports: &str, requirements: &str) -> Result<Released> {
    let folder = workspace::folder(folder)?;
    let python = python::environment(&folder.join("environment"), imports, requirements, false)?;
    python::install(&python, &wheel::released()?)?;
    let build = ["build", "--release", "--locked", "--package", "inerter", "--no-default-features"];
    process::run(process::cargo().args(build).args(["--features", "lean"]))?;
    Ok(Released { folder, python, program: workspace::program("inerter", "release")? })
}

/// Prints a table, or writes it.
fn settle(name: &str, table: String, update: bool) -> Result<()> {
    print!("{table}");
    if update { tree::write(format!("docs/tables/{name}.md"), table) } else { Ok(()) }
}

/// What storing and replaying many runs costs, on one worker and on two.
pub fn scale(options: &ScaleOptions) -> Result<()> {
    let Released { folder, python, program } = released("scale", CLUSTER, "host-tools/python/tests/requirements.txt")?;
    let (store, runs) = (folder.join(options.runs.to_string()), options.runs.to_string());
    let table = process::output(python::script(&python, "scale.py").args([&program, &store]).arg(&runs))?;
    settle("scale", table, options.update)
}

/// Measures the rates, and prints or writes the table; fails if it misses its goal.
pub fn run(options: &Options) -> Result<()> {
    let Released { folder, python, program } = released("rates", IMPORTS, REQUIREMENTS)?;
    let mut paths = Vec::new();
    for seed in ["1", "2"] {
        let path = folder.join(format!("{seed}.mcap"));
        process::run(
            Command::new(&program)
                .args(["simulate", "--duration", DURATION_S, "--excite", "random", "--seed", seed, "--force"])
                // numpy does not correct for the motion of a structure mass.
                .args(["--structure-mass-kg", "0", "-o"])
                .arg(&path),
        )?;
        paths.push(path);
    }
    let table = process::output(python::script(&python, "rates.py").arg(&program).args(&paths))?;
    let is_missed = table.contains("**missed**");
    settle("rates", table, options.update)?;
    ensure!(
        !is_missed,
        "the package replays more slowly than its goal; repeat it on an idle machine, or find what became slower"
    );
    Ok(())
}
