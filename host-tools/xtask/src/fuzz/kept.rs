//! Totals of all fuzzing runs that were kept: docs/tables/fuzz.md.

use crate::{table, tree};
use anyhow::Result;
use std::collections::BTreeMap;

/// The committed table, from the root.
const TABLE: &str = "docs/tables/fuzz.md";

/// Of one run, or of all runs of a target: inputs, samples if the target counts them, seconds, edges after half of the
/// last run and at its end, and runs that ended with a finding.
pub type Figures = [Option<u64>; 6];

/// Those of the last run alone; the others are added up.
const LAST: [usize; 2] = [3, 4];

/// Targets by name, each with the commit of the tree in the last run.
#[derive(Debug, Default, PartialEq)]
struct Kept(BTreeMap<String, (Figures, String)>);

/// Adds a run to the table.
pub fn add(target: &str, run: Figures, commit: &str) -> Result<()> {
    // Read each time: another target may be fuzzed at the same time.
    let mut kept = Kept::parse(&tree::text_if_there(TABLE)?);
    kept.add(target, run, commit);
    tree::write(TABLE, kept.markdown())
}

impl Kept {
    fn add(&mut self, target: &str, run: Figures, commit: &str) {
        let (totals, last) = self.0.entry(target.to_owned()).or_default();
        *last = commit.to_owned();
        for (place, (total, run)) in totals.iter_mut().zip(run).enumerate() {
            let sum = [*total, run].into_iter().flatten().reduce(|one, other| one + other);
            *total = if LAST.contains(&place) { run } else { sum };
        }
    }

    fn parse(text: &str) -> Self {
        let row = |line: &str| {
            let [target, figures @ .., commit] = table::cells::<8>(line)?;
            let figures: Figures = figures.map(|figure| figure.parse().ok());
            figures[0].is_some().then(|| (target.to_owned(), (figures, commit.to_owned())))
        };
        Self(text.lines().filter_map(row).collect())
    }

    fn markdown(&self) -> String {
        let mut text = format!(
            "# Fuzzed so far\n\nWritten by `cargo xtask fuzz --keep`, which adds each run to the row of its target. *edges* are those of the \
             last run, after half of its time and at its end, in a row *our crates* (`--ours`) those of our crates alone; *findings* counts the runs that ended with one; *commit* is the tree of the \
             last run; with `-dirty` it had changes besides.\n\n{} inputs in all.\n\n\
             | target | inputs | samples | time s | edges at half time | at the end | findings | commit |\n\
             |---|--:|--:|--:|--:|--:|--:|---|\n",
            self.0.values().filter_map(|(figures, _)| figures[0]).sum::<u64>()
        );
        for (target, (figures, commit)) in &self.0 {
            let figures = figures.map(|figure| figure.map_or("-".to_owned(), |figure| figure.to_string()));
            text += &format!("| {target} | {} | {commit} |\n", figures.join(" | "));
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_added_and_read_back() {
        let run =
            |samples, findings: u64| [Some(1000), samples, Some(30), Some(70), Some(80 + findings), Some(findings)];
        let mut kept = Kept::default();
        kept.add("wire", run(None, 0), "ac2bb3a");
        kept.add("estimator", run(Some(5), 0), "ac2bb3a");
        kept.add("estimator", run(Some(6), 1), "476dd4a-dirty");
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
