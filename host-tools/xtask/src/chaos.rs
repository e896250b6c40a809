//! Campaigns of disturbances: kills, full disks, hostile devices, slow readers, a changed clock.
//!
//! Each campaign is a test of `host-tools/inerter/tests/chaos` that runs only on request. It leaves one line with its
//! figures; a table is printed at the end. With `--keep` each line also goes into `docs/tables/chaos.md`, and what is
//! already there is not run again. So a long campaign of many seeds can be stopped at any time and continues where it
//! stopped.

use crate::{
    commit::commit,
    process, table, tree,
    workspace::{self, Part},
};
use anyhow::{Result, ensure};
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
    let commit = commit();
    for seed in options.seed..options.seed.saturating_add(options.seeds) {
        for test in &chosen {
            let key = Key { name: short(test).to_owned(), seed, kills: options.kills, cycles: options.cycles };
            if options.keep && kept.0.contains_key(&key) {
                println!("{} with seed {seed} is already in {TABLE}", key.name);
                continue;
            }
            process::heading(&format!("{}, seed {seed}", key.name));
            let passed = campaign(test, &key, options.release, &report)?;
            if options.keep
                && let Some([seconds, figures]) = passed
            {
                let build = if options.release { "; release build" } else { "" };
                kept.add(key, &commit, &seconds, &(figures + build));
                tree::write(TABLE, kept.markdown())?;
            }
        }
    }
    let report = tree::text(&report)?;
    let lines = lines(&report);
    println!("\n{}", table(&lines));
    let failed: Vec<&str> = lines.iter().filter(|line| line[1] == "FAILED").map(|line| line[0]).collect();
    ensure!(failed.is_empty(), "failed: {}", failed.join(", "));
    Ok(())
}

/// Runs one; returns its time and its figures if it passed.
fn campaign(test: &str, key: &Key, release: bool, report: &Path) -> Result<Option<[String; 2]>> {
    let before = lines(&tree::text(report)?).len();
    let mut command = tests(release);
    command.args(["--exact", test, "--nocapture"]);
    for (variable, value) in [("SEED", key.seed), ("KILLS", key.kills), ("CYCLES", key.cycles)] {
        command.env(format!("INERTER_CHAOS_{variable}"), value.to_string());
    }
    let ended = process::run(command.env("INERTER_CHAOS_REPORT", report));
    let text = tree::text(report)?;
    let told = lines(&text).into_iter().skip(before).filter(|line| line[0] == key.name);
    match told.collect::<Vec<_>>()[..] {
        [[_, "passed", seconds, figures]] if ended.is_ok() => return Ok(Some([seconds, figures].map(str::to_owned))),
        [[_, outcome, ..]] if ended.is_ok() || outcome == "FAILED" => {}
        // A missing line does not pass, nor does a failure after the line.
        _ => tree::write(report, format!("{text}{}\tFAILED\t?\tended before it reported\n", key.name))?,
    }
    Ok(None)
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

/// Rows of the campaigns that passed, as in the table.
#[derive(Debug, Default, PartialEq, Eq)]
struct Kept(BTreeMap<Key, String>);

impl Kept {
    fn add(&mut self, key: Key, commit: &str, seconds: &str, figures: &str) {
        let Key { name, seed, kills, cycles } = &key;
        let figures = figures.replace('|', "/");
        let row = format!("| {name} | {seed} | {kills} | {cycles} | {commit} | {seconds} | {figures} |\n");
        self.0.insert(key, row);
    }

    fn parse(text: &str) -> Self {
        let row = |line: &str| {
            let [name, seed, kills, cycles, ..] = table::cells::<7>(line)?;
            let [Ok(seed), Ok(kills), Ok(cycles)] = [seed, kills, cycles].map(str::parse) else { return None };
            Some((Key { name: name.to_owned(), seed, kills, cycles }, format!("{line}\n")))
        };
        Self(text.lines().filter_map(row).collect())
    }

    fn markdown(&self) -> String {
        let head = "# Campaigns that passed\n\n\
                    Written by `cargo xtask chaos --keep`, which skips the campaigns in this table. To repeat one,\n\
                    delete its row. *kills* and *cycles* are the options of the run. *commit* is the tree that was\n\
                    tested; `-dirty` means that it also had uncommitted changes.\n\n\
                    | campaign | seed | kills | cycles | commit | time s | figures |\n|---|--:|--:|--:|---|--:|---|\n";
        std::iter::once(head).chain(self.0.values().map(String::as_str)).collect()
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

/// Name, outcome, seconds and figures of each campaign in a report.
fn lines(report: &str) -> Vec<[&str; 4]> {
    report.lines().filter_map(|line| line.splitn(4, '\t').collect::<Vec<_>>().try_into().ok()).collect()
}

fn table(lines: &[[&str; 4]]) -> String {
    let row =
        |[name, outcome, seconds, figures]: &[&str; 4]| format!("{outcome:<7} {name:<26} {seconds:>5} s  {figures}");
    lines.iter().map(row).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_is_read_back() {
        let mut kept = Kept::default();
        for (name, seed, commit, figures) in [
            ("kills", 10, "ac2bb3a-dirty", "254 kills"),
            ("kills", 9, "ac2bb3a", "255 kills | none lost"),
            ("unruly", 1, "unknown", "61 behaviours; most: kB 26604 (record at Noise), ms 350"),
        ] {
            kept.add(Key { name: name.into(), seed, kills: 100, cycles: 5000 }, commit, "41", figures);
        }
        let text = kept.markdown();
        assert!(text.contains("|\n| kills | 9 | 100 | 5000 | ac2bb3a | 41 | 255 kills / none lost |\n| kills | 10 |"));
        assert_eq!(Kept::parse(&text), kept);
    }

    #[test]
    fn the_committed_table_is_as_it_is_written() {
        let text = tree::text(TABLE).unwrap();
        assert_eq!(Kept::parse(&text).markdown(), text);
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
