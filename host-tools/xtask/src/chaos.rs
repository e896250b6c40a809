//! Campaigns for what must never happen: kills, full disks, hostile devices, slow readers, a clock that is set.
//!
//! Each campaign is a test of `host-tools/inerter/tests/chaos` that runs only when it is asked for. It leaves one line with its
//! figures; a table stands at the end.

use crate::{
    process, tree,
    workspace::{Part, Workspace},
};
use anyhow::{Context, Result, bail};
use std::{fs, path::Path, process::Command};

#[derive(clap::Args, Clone, Debug)]
pub struct Options {
    /// One campaign; without it all of them, one after another
    pub campaign: Option<String>,
    /// How often each program is killed; other disturbances are as many, or a part of it
    #[arg(long, default_value_t = Self::USUAL.kills)]
    pub kills: u64,
    /// How many hosts come and go
    #[arg(long, default_value_t = Self::USUAL.cycles)]
    pub cycles: u64,
    /// What all draws come from
    #[arg(long, default_value_t = Self::USUAL.seed)]
    pub seed: u64,
}

impl Options {
    /// All campaigns at their usual size.
    pub const USUAL: Self = Self { campaign: None, kills: 100, cycles: 5_000, seed: 1 };
}

/// How a campaign ended.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Line {
    name: String,
    outcome: String,
    seconds: String,
    figures: String,
}

pub fn run(options: &Options) -> Result<()> {
    if !cfg!(target_os = "linux") {
        bail!("the campaigns read /proc: they run on Linux only");
    }
    let folder = Workspace::read(&tree::root())?.target.join("chaos");
    fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
    let report = folder.join("report.tsv");
    fs::write(&report, "").with_context(|| format!("cannot write {}", report.display()))?;
    let all = campaigns(&process::output(tests().args(["--list", "--format", "terse"]))?);
    let chosen: Vec<&String> =
        all.iter().filter(|test| options.campaign.as_ref().is_none_or(|name| name == short(test))).collect();
    if chosen.is_empty() {
        let names: Vec<&str> = all.iter().map(|test| short(test)).collect();
        bail!("no campaign of this name; there are: {}", names.join(", "));
    }
    println!("seed {}; each line also goes to {}", options.seed, report.display());
    for test in chosen {
        process::heading(short(test));
        let mut command = tests();
        command.args(["--exact", test, "--nocapture"]);
        for (variable, value) in [("SEED", options.seed), ("KILLS", options.kills), ("CYCLES", options.cycles)] {
            command.env(format!("INERTER_CHAOS_{variable}"), value.to_string());
        }
        let ended = process::run(command.env("INERTER_CHAOS_REPORT", &report));
        let told: Vec<Line> = lines(&read(&report)?).into_iter().filter(|line| line.name == short(test)).collect();
        let failed = told.iter().any(|line| line.outcome == "FAILED");
        // Neither silence nor a failure after the line passes.
        if told.len() != 1 || ended.is_err() && !failed {
            let line = format!("{}\tFAILED\t?\tended before it could say how\n", short(test));
            fs::write(&report, read(&report)? + &line).with_context(|| format!("cannot write {}", report.display()))?;
        }
    }
    let lines = lines(&read(&report)?);
    println!("\n{}", table(&lines));
    let failed: Vec<&str> =
        lines.iter().filter(|line| line.outcome == "FAILED").map(|line| line.name.as_str()).collect();
    if !failed.is_empty() {
        bail!("failed: {}", failed.join(", "));
    }
    Ok(())
}

/// The tests that are campaigns, without their arguments.
fn tests() -> Command {
    let mut command = Part::Main.all("test");
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

fn read(report: &Path) -> Result<String> {
    fs::read_to_string(report).with_context(|| format!("cannot read {}", report.display()))
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
