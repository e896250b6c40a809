//! What a cold start costs: processor time from an empty folder, crates, and size of the program, for each product.

use crate::{
    firmware::Image,
    process,
    table::{Row, Table},
    toolchain::Toolchain,
    tree,
    workspace::{Part, Workspace},
};
use anyhow::{Context, Result};
use std::{collections::BTreeSet, fs, path::Path, process::Command};

#[derive(clap::Args, Clone, Debug, Default)]
pub struct Options {
    /// Write the table instead of printing it
    #[arg(long)]
    update: bool,
}

/// What somebody builds.
struct Product {
    name: &'static str,
    /// Of `cargo build`, and of `cargo tree`.
    arguments: &'static [&'static str],
    /// The program that it makes, below the target folder.
    program: Option<&'static str>,
    /// Greatest size wished for \[MB\].
    most_mb: Option<f64>,
}

const INSTALLED: &str = "release/inerter";

const PRODUCTS: [Product; 4] = [
    Product {
        name: "program, as `cargo install` makes it",
        arguments: &["--release", "--package", "inerter"],
        program: Some(INSTALLED),
        most_mb: Some(30.0),
    },
    Product {
        name: "program without probe and bridges",
        arguments: &["--release", "--package", "inerter", "--no-default-features"],
        program: Some(INSTALLED),
        most_mb: Some(15.0),
    },
    Product {
        name: "Python package",
        arguments: &["--release", "--package", "inerter-python"],
        program: None,
        most_mb: None,
    },
    Product {
        name: "demo",
        arguments: &["--package", "xtask", "--package", "inerter-demo"],
        program: None,
        most_mb: None,
    },
];

/// Measures each product and prints or writes the table.
pub fn run(options: &Options) -> Result<()> {
    let folder = Workspace::read(&tree::root())?.target.join("cost");
    let mut rows = Vec::new();
    for product in &PRODUCTS {
        let spent = from_nothing(&folder, process::cargo().arg("build").args(product.arguments))?;
        rows.push(minutes(product.name, spent));
        rows.push(Row::new(&format!("{}: crates", product.name), crates(product.arguments)? as f64, ""));
        let Some(program) = product.program else { continue };
        let path = folder.join(format!("{program}{}", std::env::consts::EXE_SUFFIX));
        let bytes = fs::metadata(&path).with_context(|| format!("no program at {}", path.display()))?.len();
        let size = Row::new(&format!("{}: size", product.name), (bytes as f64 / 1e5).round() / 10.0, "MB");
        rows.push(product.most_mb.map_or(size.clone(), |most| size.at_most(most)));
    }
    let mut image = Toolchain::find().context("no compiler for the firmware")?.cargo("build");
    rows.push(minutes("demo: firmware", from_nothing(&folder, image.args(Image::Qemu.arguments()))?));
    rows.push(minutes("tests", from_nothing(&folder, Part::Main.all("test").arg("--no-run"))?));
    fs::remove_dir_all(&folder).with_context(|| format!("cannot remove {}", folder.display()))?;
    let table = Table {
        name: "cost",
        title: "What a cold start costs",
        about: "Processor time of compiling each product from an empty folder, all processors together, without downloads; crates that are \
                compiled for it, ours included; size of the program as built. `cargo xtask test` prints the processor time of each of its steps."
            .into(),
        rows,
        repeats: false,
    };
    table.print();
    if options.update { table.write() } else { Ok(()) }
}

fn minutes(name: &str, seconds: f64) -> Row {
    Row::new(&format!("{name}: compiling"), (seconds / 6.0).round() / 10.0, "min of processor")
}

/// Processor time of a command of cargo's that finds nothing built \[s\].
fn from_nothing(folder: &Path, command: &mut Command) -> Result<f64> {
    if folder.exists() {
        fs::remove_dir_all(folder).with_context(|| format!("cannot empty {}", folder.display()))?;
    }
    let before = process::spent();
    process::run(command.arg("--locked").env("CARGO_TARGET_DIR", folder).env("CARGO_INCREMENTAL", "0"))?;
    Ok((process::spent() - before).as_secs_f64())
}

/// How many packages are compiled, by name and version.
fn crates(arguments: &[&str]) -> Result<usize> {
    let mut tree = process::cargo();
    tree.args(["tree", "--locked", "--edges", "normal,build", "--prefix", "none", "--format", "{p}"]);
    tree.args(arguments.iter().filter(|argument| **argument != "--release"));
    Ok(distinct(&process::output(&mut tree)?))
}

/// Lines of `cargo tree`, each package once.
fn distinct(tree: &str) -> usize {
    let names = tree.lines().map(|line| line.trim_end_matches(" (*)")).filter(|line| !line.is_empty());
    names.collect::<BTreeSet<_>>().len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_package_counts_once() {
        assert_eq!(
            distinct("a v1.0.0\nb v1.0.0 (proc-macro)\na v1.0.0 (*)\na v2.0.0\n\nb v1.0.0 (proc-macro) (*)\n"),
            3
        );
    }
}
