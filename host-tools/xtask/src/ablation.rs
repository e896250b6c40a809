//! What each part of the estimator contributes: core without that part, compared with core itself, on the same runs.
//!
//! The copies of core are in target/ablation. A small test program that uses nothing else is built with them, so the
//! firmware's source needs no switch and the image no extra instruction. [`host`] does the same for the host's
//! computations.

mod heuristics;
mod host;

use crate::{
    copy::{self, Edit},
    process, tree, workspace,
};
use anyhow::{Context, Result, bail, ensure};
use heuristics::{HEURISTICS, contributes, settle};
use std::{path::Path, process::Command};

/// Fraction of the interval that is added to both errors before their ratio is taken: three seeds resolve no less.
const FLOOR: f64 = 0.1;
/// A part matters if the error of one cell grows by the first factor, or that of all cells together by the second.
const WORSE: (f64, f64) = (1.25, 1.02);

/// Up to this many more values outside their intervals may be chance.
const BY_CHANCE: i64 = 1;

/// One cell and parameter of the program's output.
struct Cell {
    name: String,
    rms: f64,
    u95: f64,
    silent: u32,
    outside: u32,
    given: u32,
    broken: u32,
    named: u32,
}

type Cells = Vec<Cell>;

#[derive(clap::Args)]
pub struct Options {
    /// Write the table instead of comparing with it
    #[arg(long)]
    update: bool,
    /// Take parts out of what the host computes from a run instead, against docs/tables/ablation-host.md
    #[arg(long)]
    host: bool,
}

/// Builds and runs everything, then writes or compares the table.
pub fn run(options: &Options) -> Result<()> {
    if options.host {
        return host::run(options.update);
    }
    let folder = workspace::target()?.join("ablation");
    let table = ("ablation", "cargo xtask ablation", HEAD);
    settle(table, HEURISTICS, options.update, |edits| measured(&folder, edits), line)
}

/// The program's output with this core.
fn measured(folder: &Path, edits: &[Edit]) -> Result<Cells> {
    copy::tree(&folder.join("tree"), &["firmware/core", "host-tools/plant", "tests/needs"])?;
    copy::edit(&folder.join("tree/firmware/core/src"), edits)?;
    copy::written(&folder.join("program/src/main.rs"), &tree::read("tests/src/bin/ablation.rs")?)?;
    copy::written(&folder.join("program/Cargo.toml"), PROGRAM.as_bytes())?;
    copy::written(&folder.join("Cargo.toml"), workspace(&tree::text("Cargo.toml")?)?.as_bytes())?;
    tree::write(folder.join("Cargo.lock"), tree::read("Cargo.lock")?)?;
    let build = ["build", "--release", "--quiet", "--package", "ablation", "--target-dir", "target"];
    process::run(process::cargo().current_dir(folder).env("RUSTFLAGS", "-A warnings").args(build))?;
    cells(&process::output(&mut Command::new(folder.join("target/release/ablation")))?)
}

/// Manifest of the program.
const PROGRAM: &str = "[package]\nname = \"ablation\"\nversion = \"0.0.0\"\nedition = \"2024\"\npublish = false\n\n\
                       [dependencies]\ninerter-core = { path = \"../tree/firmware/core\" }\ninerter-plant = { path = \"../tree/host-tools/plant\" }\n";

/// Manifest of a workspace of core, plant and the program, with what they inherit from ours.
fn workspace(ours: &str) -> Result<String> {
    let (_, inherited) = ours.split_once("[workspace.package]").context("no [workspace.package] in Cargo.toml")?;
    let inherited = inherited.replace("path = \"", "path = \"tree/");
    Ok(format!(
        "[workspace]\nresolver = \"2\"\nmembers = [\"tree/firmware/core\", \"tree/host-tools/plant\", \"program\"]\n\n[workspace.package]{inherited}"
    ))
}

fn cells(output: &str) -> Result<Cells> {
    let each = output.lines().map(|line| {
        let fields: Vec<&str> = line.split('\t').collect();
        let [group, cell, parameter, rms, u95, given, silent, outside, broken, named, _runs] = fields[..] else {
            bail!("`{line}` is not a line of output");
        };
        let count = |field: &str| field.parse::<u32>();
        // Each run is reported once per parameter.
        let once = |groups: &[&str]| u32::from(groups.contains(&group) && parameter == "mt");
        let (broken, named) = (count(broken)? * once(&["clean"]), count(named)? * once(&["friction", "samples"]));
        Ok(Cell {
            name: format!("{cell}, {parameter}"),
            rms: rms.parse()?,
            u95: u95.parse()?,
            silent: count(silent)?,
            outside: count(outside)?,
            given: count(given)?,
            broken,
            named,
        })
    });
    each.collect()
}

/// A row of the table: errors relative to those of the whole estimator, over all cells, the worst cell and its factor,
/// the intervals, and the counts with the part and without it.
fn line(name: &str, whole: &Cells, without: &Cells, test: Option<&str>) -> Result<String> {
    let same = whole.iter().map(|cell| &cell.name).eq(without.iter().map(|cell| &cell.name));
    ensure!(same, "the runs are not the same");
    let (mut logarithms, mut widths, mut count) = (0.0, 0.0, 0.0);
    let (mut worst, mut most) = ("-".to_owned(), 1.0);
    for (before, after) in whole.iter().zip(without) {
        let floor = FLOOR * before.u95;
        let factor = (after.rms + floor) / (before.rms + floor);
        let width = after.u95 / before.u95;
        let is_given = [before, after].iter().all(|cell| cell.given > 0);
        if !(is_given && factor.is_finite() && width.is_finite() && factor > 0.0 && width > 0.0) {
            continue;
        }
        logarithms += factor.ln();
        widths += width.ln();
        count += 1.0;
        if factor > most {
            (worst, most) = (format!("{factor:.2} ({})", before.name), factor);
        }
    }
    let [error, u95] = [logarithms, widths].map(|sum| f64::exp(sum / f64::max(count, 1.0)));
    let sums = |count: fn(&Cell) -> u32| [whole, without].map(|cells| cells.iter().map(count).sum::<u32>());
    // In the order of the table.
    let counts = [
        sums(|cell| cell.silent),
        sums(|cell| cell.outside),
        sums(|cell| cell.given),
        sums(|cell| cell.broken),
        sums(|cell| cell.named),
    ];
    let more = counts.map(|[before, after]| i64::from(after) - i64::from(before));
    let [silent, outside, given, broken, named] = more;
    let all = [
        (most >= WORSE.0 || error >= WORSE.1, "accuracy"),
        (silent > 0 || outside > BY_CHANCE, "honesty"),
        (u95 >= WORSE.1, "sharpness"),
        (given < 0, "values"),
        (broken > 0, "clean runs not called broken"),
        (named < 0, "names"),
    ];
    // What gets worse without it.
    let lost: Vec<_> = all.into_iter().filter_map(|(is_lost, what)| is_lost.then_some(what)).collect();
    let counts = counts.map(|[before, after]| format!("{before} to {after}")).join(" | ");
    Ok(format!("| {name} | {error:.2} | {worst} | {u95:.2} | {counts} | {} |", contributes(&lost, test)))
}

const HEAD: &str = "# Ablation

Written by `cargo xtask ablation --update`. Each row compares the estimator without one part with
the complete estimator, on the same runs: clean runs, other rigs, other friction, wrong samples,
contacts and changes of the device (`tests/src/bin/ablation.rs`), with three seeds that no other
table uses. For each row a copy of core is edited and built
(`host-tools/xtask/src/ablation/heuristics.rs`); the firmware's source has no switch. The number
before a part is its section in [THEORY](../THEORY.md). A cell is one case, motion and parameter.
Where a column has two figures, the first is with the part, the second without it.

- *error*: the rms error without the part over that with it, after a tenth of the interval is added
  to both; the geometric mean over all cells with a value. *worst*: the largest of these ratios,
  with its cell.
- *U95*: the same ratio for the half widths of the intervals, with nothing added.
- *silent*: values that are off by more than twice their interval although nothing is reported that
  makes them doubtful. *outside*: values whose interval does not contain the true value, reported or
  not. *given*: values that are given.
- *broken*: clean runs whose law is reported as broken. *named*: runs with other friction or wrong
  samples in which this is reported.
- *contributes*: what gets worse without the part. *accuracy*: larger errors. *honesty*: more silent
  errors, or more values outside their intervals. *sharpness*: wider intervals. *values*: fewer are
  given. *names*: fewer faults are reported. *clean runs not called broken*: more of them are. Small
  changes of *error*, *U95* and *outside* may be chance and do not count (`WORSE` and `BY_CHANCE` in
  `host-tools/xtask/src/ablation.rs`). *nothing in these runs*: the part may be superfluous, or
  these runs lack the case that it is for.

| without this part | error | worst | U95 | silent | outside | given | broken | named | contributes |
|---|--:|---|--:|--:|--:|--:|--:|--:|---|
";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_text_is_found_once() {
        let tests = ["tests/tests", "firmware/core/src", "firmware/core/tests/closed_loop"];
        heuristics::must_be_found(HEURISTICS, "firmware/core/src", &tests);
    }

    #[test]
    fn what_is_lost_is_named() {
        let line = |rms: f64, u95: f64, given: u32, silent: u32, broken: u32| {
            format!("clean\treference, mid\tmt\t{rms}\t{u95}\t{given}\t{silent}\t{silent}\t{broken}\t0\t3\n")
        };
        let whole = cells(&line(0.5, 1.0, 3, 0, 0)).unwrap();
        let told = |other: String| super::line("x", &whole, &cells(&other).unwrap(), None).unwrap();
        let same = told(line(0.5, 1.0, 3, 0, 0));
        let nothing =
            "| x | 1.00 | - | 1.00 | 0 to 0 | 0 to 0 | 3 to 3 | 0 to 0 | 0 to 0 | **nothing in these runs** |";
        assert_eq!(same, nothing);
        let worse = told(line(1.1, 1.5, 2, 1, 2));
        let lost = "| accuracy, honesty, sharpness, values, clean runs not called broken |";
        assert!(worse.contains("2.00 (reference, mid, mt)") && worse.ends_with(lost), "{worse}");
        assert!(cells("a\tb\n").is_err());
    }

    #[test]
    fn the_workspace_holds_core_and_plant() {
        let ours = tree::text("Cargo.toml").unwrap();
        let theirs = workspace(&ours).unwrap();
        assert!(theirs.contains("path = \"tree/firmware/core\"") && theirs.contains("heapless"));
    }
}
