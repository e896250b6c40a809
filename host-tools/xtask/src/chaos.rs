//! Campaigns of disturbances: kills, full disks, hostile devices, slow readers, a changed clock.
//!
//! Each campaign is a test of `host-tools/inerter/tests/chaos` that runs only on request. It leaves one line with its
//! figures; a table is printed at the end. With `--keep` each line also goes into `docs/tables/chaos.md`, and what is
//! already there is not run again. So a long campaign of many seeds can be stopped at any time and continues where it
//! stopped.

use crate::{
    commit::{UNKNOWN, commit},
    process, table, tree,
    workspace::{self, Part},
};
use anyhow::{Context, Result, ensure};
use std::{collections::BTreeMap, path::Path, process::Command};

#[derive(clap::Args)]
pub struct Options {
    /// One campaign; by default all of them, one after another
    campaign: Option<String>,
    /// How often each program is killed; other disturbances happen as often, or a fraction of that
    #[arg(long, default_value_t = 100)]
    kills: u64,
    /// How many hosts connect and disconnect
    #[arg(long, default_value_t = 5_000)]
    cycles: u64,
    /// Seed of all random draws
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Number of seeds, run one after another
    #[arg(long, value_name = "N", default_value_t = 1)]
    seeds: u64,
    /// Write what passed into docs/tables/chaos.md, and skip what is already there
    #[arg(long)]
    keep: bool,
    /// Disturb the program as released instead of a debug build: slow writers run 3 to 30 times faster
    #[arg(long)]
    release: bool,
}

/// How a campaign ended.
#[derive(Clone)]
struct Line {
    name: String,
    outcome: String,
    seconds: String,
    figures: String,
}

pub fn run(options: &Options) -> Result<()> {
    ensure!(cfg!(target_os = "linux"), "the campaigns read /proc: they run on Linux only");
    let report = workspace::folder("chaos")?.join("report.tsv");
    tree::write(&report, "")?;
    let all = campaigns(&process::output(tests(options.release).args(["--list", "--format", "terse"]))?);
    let chosen: Vec<&String> =
        all.iter().filter(|test| options.campaign.as_ref().is_none_or(|name| name == short(test))).collect();
    let names: Vec<&str> = all.iter().map(|test| short(test)).collect();
    ensure!(!chosen.is_empty(), "no campaign of this name; there are: {}", names.join(", "));
    println!("each line also goes to {}", report.display());
    let mut kept = Kept::parse(&tree::text_if_there(TABLE)?);
    // Taken before the table is written, which would count as a difference.
    let commit = commit();
    for seed in options.seed..options.seed.saturating_add(options.seeds) {
        for test in &chosen {
            let key = Key { name: short(test).to_owned(), seed, kills: options.kills, cycles: options.cycles };
            if options.keep && kept.rows.contains_key(&key) {
                println!("{} with seed {seed} is already in {TABLE}", key.name);
                continue;
            }
            process::heading(&format!("{}, seed {seed}", key.name));
            let line = campaign(test, &key, options.release, &report)?;
            if options.keep && line.outcome == "passed" {
                let figures = line.figures + if options.release { "; release build" } else { "" };
                kept.rows.insert(key, Row { commit: commit.clone(), seconds: line.seconds, figures });
                tree::write(TABLE, kept.markdown())?;
            }
        }
    }
    let lines = lines(&tree::text(&report)?);
    println!("\n{}", table(&lines));
    let failed: Vec<&str> =
        lines.iter().filter(|line| line.outcome == "FAILED").map(|line| line.name.as_str()).collect();
    ensure!(failed.is_empty(), "failed: {}", failed.join(", "));
    Ok(())
}

/// Runs one, and returns its line.
fn campaign(test: &str, key: &Key, release: bool, report: &Path) -> Result<Line> {
    let before = lines(&tree::text(report)?).len();
    let mut command = tests(release);
    command.args(["--exact", test, "--nocapture"]);
    for (variable, value) in [("SEED", key.seed), ("KILLS", key.kills), ("CYCLES", key.cycles)] {
        command.env(format!("INERTER_CHAOS_{variable}"), value.to_string());
    }
    let ended = process::run(command.env("INERTER_CHAOS_REPORT", report));
    let told = lines(&tree::text(report)?).into_iter().skip(before);
    let told: Vec<Line> = told.filter(|line| line.name == key.name).collect();
    // A missing line does not pass, nor does a failure after the line.
    match &told[..] {
        [line] if ended.is_ok() || line.outcome == "FAILED" => Ok(line.clone()),
        _ => {
            let line = format!("{}\tFAILED\t?\tended before it reported\n", key.name);
            tree::write(report, tree::text(report)? + &line)?;
            lines(&line).pop().context("a line")
        }
    }
}

/// The committed table, from the root.
const TABLE: &str = "docs/tables/chaos.md";

/// What identifies a run.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Key {
    name: String,
    seed: u64,
    kills: u64,
    cycles: u64,
}

/// Result of a campaign that passed.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Row {
    /// Commit of the tree that was tested.
    commit: String,
    seconds: String,
    figures: String,
}

/// Runs that passed, as in the table.
#[derive(Debug, Default, PartialEq, Eq)]
struct Kept {
    rows: BTreeMap<Key, Row>,
}

impl Kept {
    fn parse(text: &str) -> Self {
        let row = |line: &str| {
            let cells = table::cells(line);
            let [_, name, seed, kills, cycles, rest @ .., _] = &cells[..] else { return None };
            let [Ok(seed), Ok(kills), Ok(cycles)] = [*seed, *kills, *cycles].map(str::parse) else { return None };
            let (commit, seconds, figures) = match *rest {
                [commit, seconds, figures] => (commit, seconds, figures),
                // A row from an earlier version of this program, which recorded no commit.
                [seconds, figures] => (UNKNOWN, seconds, figures),
                _ => return None,
            };
            let [name, commit, seconds, figures] = [*name, commit, seconds, figures].map(str::to_owned);
            Some((Key { name, seed, kills, cycles }, Row { commit, seconds, figures }))
        };
        Self { rows: text.lines().filter_map(row).collect() }
    }

    fn markdown(&self) -> String {
        let mut text = "# Campaigns that passed\n\nWritten by `cargo xtask chaos --keep`, which skips the campaigns in this table. To repeat one, \
                        delete its row. *kills* and *cycles* are the sizes that were asked for, *commit* is the tree that was tried; with \
                        `-dirty` it had changes besides.\n\n\
                        | campaign | seed | kills | cycles | commit | time s | figures |\n|---|--:|--:|--:|---|--:|---|\n"
            .to_owned();
        for (Key { name, seed, kills, cycles }, Row { commit, seconds, figures }) in &self.rows {
            text.push_str(&format!(
                "| {name} | {seed} | {kills} | {cycles} | {commit} | {seconds} | {} |\n",
                figures.replace('|', "/")
            ));
        }
        text
    }
}

/// The tests that are campaigns, without their arguments.
fn tests(release: bool) -> Command {
    let mut command = Part::Main.all("test");
    command.args(release.then_some("--release"));
    command.args(["--quiet", "--test", "chaos", "--", "--ignored", "--test-threads", "1"]);
    command
}

/// Names in a list of tests.
fn campaigns(list: &str) -> Vec<String> {
    list.lines().filter_map(|line| line.strip_suffix(": test")).map(str::to_owned).collect()
}

/// The name without its module.
fn short(test: &str) -> &str {
    test.rsplit("::").next().unwrap_or(test)
}

fn lines(report: &str) -> Vec<Line> {
    let line = |text: &str| {
        let mut parts = text.splitn(4, '\t').map(str::to_owned);
        Some(Line { name: parts.next()?, outcome: parts.next()?, seconds: parts.next()?, figures: parts.next()? })
    };
    report.lines().filter_map(line).collect()
}

fn table(lines: &[Line]) -> String {
    let row =
        |Line { name, outcome, seconds, figures }: &Line| format!("{outcome:<7} {name:<26} {seconds:>5} s  {figures}");
    lines.iter().map(row).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_is_read_back() {
        let key = |name: &str, seed| Key { name: name.into(), seed, kills: 100, cycles: 5000 };
        let row =
            |commit: &str, figures: &str| Row { commit: commit.into(), seconds: "41".into(), figures: figures.into() };
        let rows = [
            (key("kills", 1), row("ac2bb3a", "255 kills; none lost")),
            (key("kills", 2), row("ac2bb3a-dirty", "254 kills")),
            (key("unruly", 1), row(UNKNOWN, "61 behaviours; most: kB 26604 (record at Noise), ms 350")),
        ];
        let kept = Kept { rows: rows.into() };
        assert_eq!(Kept::parse(&kept.markdown()), kept);
    }

    #[test]
    fn a_row_without_a_commit_is_kept() {
        let old = "| campaign | seed | kills | cycles | time s | figures |\n|---|--:|--:|--:|--:|---|\n\
                   | kills | 7 | 100 | 5000 | 41 | 255 kills |\n| half a row | 7 |\n";
        let kept = Kept::parse(old);
        let key = Key { name: "kills".into(), seed: 7, kills: 100, cycles: 5000 };
        let row = Row { commit: UNKNOWN.into(), seconds: "41".into(), figures: "255 kills".into() };
        assert_eq!(kept.rows, [(key, row)].into());
        assert_eq!(Kept::parse(&kept.markdown()), kept);
    }

    #[test]
    fn campaigns_are_found_and_told_in_a_table() {
        let all = campaigns("kills::kills: test\ndisks::full_disks: test\n\n2 tests, 0 benchmarks\n");
        assert_eq!(all.iter().map(|test| short(test)).collect::<Vec<_>>(), ["kills", "full_disks"]);
        let lines = lines(
            "kills\tpassed\t41\t255 kills\nfull_disks\tFAILED\t3\tagain: cargo xtask chaos full_disks\nhalf a li",
        );
        assert_eq!(lines.len(), 2);
        let table = table(&lines);
        assert!(table.contains("passed  kills ") && table.contains("FAILED  full_disks "), "{table}");
    }
}
