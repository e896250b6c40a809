//! Totals of all fuzzing runs that were kept: docs/tables/fuzz.md.

use crate::{table, tree};
use anyhow::Result;
use std::collections::BTreeMap;

/// The committed table, from the root.
const TABLE: &str = "docs/tables/fuzz.md";

/// Figures of one run, or of all runs of a target.
#[derive(Debug, Default, PartialEq)]
pub struct Figures {
    pub inputs: u64,
    /// Processed by the target, if it counts them.
    pub samples: Option<u64>,
    pub seconds: u64,
    /// After half of the last run and at its end.
    pub edges: [u64; 2],
    /// Runs that ended with a finding.
    pub findings: u64,
    /// Commit of the tree in the last run.
    pub commit: String,
}

/// Targets by name.
#[derive(Debug, Default, PartialEq)]
struct Kept(BTreeMap<String, Figures>);

/// Adds a run to the table.
pub fn add(target: &str, run: Figures) -> Result<()> {
    // Read each time: another target may be fuzzed at the same time.
    let mut kept = Kept::parse(&tree::text_if_there(TABLE)?);
    kept.add(target, run);
    tree::write(TABLE, kept.markdown())
}

impl Kept {
    fn add(&mut self, target: &str, run: Figures) {
        let total = self.0.entry(target.to_owned()).or_default();
        *total = Figures {
            inputs: total.inputs + run.inputs,
            samples: run.samples.map(|samples| samples + total.samples.unwrap_or(0)).or(total.samples),
            seconds: total.seconds + run.seconds,
            findings: total.findings + run.findings,
            ..run
        };
    }

    fn parse(text: &str) -> Self {
        let row = |line: &str| {
            let [target, inputs, samples, seconds, half, end, findings, commit] = table::cells::<8>(line)?;
            let number = |cell: &str| cell.parse::<u64>().ok();
            let figures = Figures {
                inputs: number(inputs)?,
                samples: number(samples),
                seconds: number(seconds)?,
                edges: [number(half)?, number(end)?],
                findings: number(findings)?,
                commit: commit.to_owned(),
            };
            Some((target.to_owned(), figures))
        };
        Self(text.lines().filter_map(row).collect())
    }

    fn markdown(&self) -> String {
        let mut text = format!(
            "# Fuzzed so far\n\n\
             Written by `cargo xtask fuzz --keep`, which adds each run to the row of its target. *samples* are\n\
             those that the target processed, if it counts them. *edges* are those that the last run had found\n\
             after half of its time and at its end. A row with *our crates* is of runs with `--ours`, and counts\n\
             the edges of our crates alone. *findings* is the number of runs that ended with one. *commit* is the\n\
             tree of the last run; `-dirty` means that it also had uncommitted changes.\n\n{} inputs in all.\n\n\
             | target | inputs | samples | time s | edges at half time | at the end | findings | commit |\n\
             |---|--:|--:|--:|--:|--:|--:|---|\n",
            self.0.values().map(|figures| figures.inputs).sum::<u64>()
        );
        for (target, Figures { inputs, samples, seconds, edges: [half, end], findings, commit }) in &self.0 {
            let samples = samples.map_or("-".to_owned(), |samples| samples.to_string());
            text +=
                &format!("| {target} | {inputs} | {samples} | {seconds} | {half} | {end} | {findings} | {commit} |\n");
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_added_and_read_back() {
        let run = |samples, findings, commit: &str| Figures {
            inputs: 1000,
            samples,
            seconds: 30,
            edges: [70, 80 + findings],
            findings,
            commit: commit.to_owned(),
        };
        let mut kept = Kept::default();
        kept.add("wire", run(None, 0, "ac2bb3a"));
        kept.add("estimator", run(Some(5), 0, "ac2bb3a"));
        kept.add("estimator", run(Some(6), 1, "476dd4a-dirty"));
        let text = kept.markdown();
        for row in [
            "3000 inputs in all",
            "| wire | 1000 | - | 30 | 70 | 80 | 0 | ac2bb3a |",
            "| estimator | 2000 | 11 | 60 | 70 | 81 | 1 | 476dd4a-dirty |",
        ] {
            assert!(text.contains(row), "{row} in {text}");
        }
        assert_eq!(Kept::parse(&text), kept);
    }

    #[test]
    fn the_committed_table_is_as_it_is_written() {
        let text = tree::text(TABLE).unwrap();
        assert_eq!(Kept::parse(&text).markdown(), text);
    }
}
