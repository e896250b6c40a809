//! What a cold start costs: processor time of compiling from an empty folder, crates, and size of the program.

use crate::{
    process,
    table::{self, Row, Table},
    tokens, tree,
    workspace::{self, Part},
};
use anyhow::{Context, Result, ensure};
use std::{fs, path::Path, process::Command};

/// Allowed deviation of processor time: compilers differ, and the machine may have other work.
const TIME_TOLERANCE: f64 = 0.3;
/// Upper limit for the processor time of the demo \[min\].
const DEMO_GOAL_MIN: f64 = 6.0;

// No group of its own: it would have the name of the flattened one's.
#[derive(clap::Args)]
#[group(skip)]
pub struct Options {
    #[command(flatten)]
    table: table::Options,
    /// Count the Rust tokens of each crate instead, which compiles nothing, and compare them with nothing
    #[arg(long)]
    tokens: bool,
}

/// The program as a user installs it: name, features, and upper limit for its size \[MB\].
const INSTALLED: [(&str, &[&str], f64); 3] = [
    ("program of a release", &["--all-features"], 30.0),
    ("program, `cargo install`", &[], 30.0),
    ("program, `--no-default-features`", &["--no-default-features"], 15.0),
];

/// Measures each product and compares with the committed table, or writes it.
pub fn run(options: &Options) -> Result<()> {
    if options.tokens {
        return tokens::run(options.table.update);
    }
    ensure!(cfg!(unix), "the processor time of what cargo starts is counted on Unix only");
    let folder = workspace::target()?.join("cost");
    let mut rows = Vec::new();
    for (name, features, most_mb) in INSTALLED {
        let mut build = process::cargo();
        build.args(["build", "--locked", "--release", "--package", "inerter"]).args(features);
        rows.push(minutes(&format!("{name}: compiling"), &folder, &mut build)?);
        let row = crates(&format!("{name}: crates"), LINKED, &[&["--package", "inerter"], features].concat())?;
        rows.push(match rows.get(1) {
            Some(first) if features.contains(&"--no-default-features") => row.at_most(first.value / 2.0),
            _ => row,
        });
        let path = folder.join(format!("release/inerter{}", std::env::consts::EXE_SUFFIX));
        let bytes = fs::metadata(&path).with_context(|| format!("no program at {}", path.display()))?.len();
        let size = (bytes as f64 / 1e5).round() / 10.0;
        rows.push(Row::new(format!("{name}: size"), size, "MB").at_most(most_mb));
    }
    let some = ["--package", "inerter", "--no-default-features", "--features", "reports,screen,tables"];
    let row = crates("program without just `probe` and `bridges`: crates", LINKED, &some)?;
    let without_two = row.value;
    rows.push(row);
    let wheel = ["build", "--locked", "--release", "--package", "inerter-python"];
    rows.push(minutes("Python package: compiling", &folder, process::cargo().args(wheel))?);
    rows.push(crates("Python package: crates", LINKED, &["--package", "inerter-python"])?);
    let demo = ["run", "--locked", "--package", "xtask", "--", "demo"];
    rows.push(minutes("demo, compiled and run", &folder, process::cargo().args(demo))?.at_most(DEMO_GOAL_MIN));
    rows.push(crates("demo: crates on the host", LINKED, &["--package", "xtask", "--package", "inerter-demo"])?);
    rows.push(minutes("tests of the main workspace: compiling", &folder, Part::Main.all("test").arg("--no-run"))?);
    let all = [&["--workspace"], Part::Main.features()].concat();
    rows.push(crates("tests of the main workspace: crates", "normal,build,dev", &all)?);
    tree::remove(&folder)?;
    let table = Table {
        name: "cost",
        title: "What a cold start costs",
        about: format!(
            "Each product is compiled from an empty folder, without downloads and without what cargo keeps for\n\
             the next time (`CARGO_INCREMENTAL=0`). The processor time is that of all processors together; for\n\
             the demo it includes running it. The crates are those that are compiled for the product, ours\n\
             included. The size is that of the program as built. `cargo xtask test` prints the processor time of\n\
             each of its steps.\n\n\
             The goal for the program with `--no-default-features` is half the crates of the program of a\n\
             release. Besides `probe` and `bridges` it also leaves out `reports`, `screen` and `tables`. Without\n\
             just `probe` and `bridges`, the program has {without_two} crates (a row of its own)."
        ),
        rows,
        repeats: false,
    };
    table.settle(&options.table)
}

/// Processor time of a cargo command in an empty folder.
fn minutes(name: &str, folder: &Path, command: &mut Command) -> Result<Row> {
    tree::remove(folder)?;
    let before = process::spent();
    process::run(command.env("CARGO_TARGET_DIR", folder).env("CARGO_INCREMENTAL", "0"))?;
    let seconds = (process::spent() - before).as_secs_f64();
    println!("{name}: {:.1} min of processor time", seconds / 60.0);
    Ok(Row::new(name, (seconds / 6.0).round() / 10.0, "min of processor time").within(TIME_TOLERANCE))
}

/// Dependency edges that are compiled for a program.
const LINKED: &str = "normal,build";

/// How many packages are compiled, by name and version.
fn crates(name: &str, edges: &str, arguments: &[&str]) -> Result<Row> {
    Ok(Row::new(name, workspace::packages(&tree::root(), edges, arguments)?.len() as f64, ""))
}
