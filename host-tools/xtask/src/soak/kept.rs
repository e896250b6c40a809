//! Hours soaked so far, in portions after each of which a run can be stopped: docs/tables/soak.md.

use crate::{
    table::{self, Row},
    tree,
};
use anyhow::Result;

/// The committed table, from the root.
const TABLE: &str = "docs/tables/soak.md";
/// Longest portion \[h\].
const PORTION_H: f64 = 1.0;
/// Shortest portion \[h\]: shorter runs do not settle.
const LEAST_H: f64 = 0.05;

/// A portion that met all goals.
#[derive(Debug, PartialEq)]
struct Portion {
    /// Commit of the tree that was soaked.
    commit: String,
    hours: f64,
    /// Total of all recordings.
    samples: f64,
    lost: f64,
    /// Largest growth of any process \[%\], and difference between samples and clock \[s\].
    grown: f64,
    apart_s: f64,
}

impl Portion {
    fn of(commit: &str, hours: f64, rows: &[Row]) -> Self {
        let of = |what: &'static str| rows.iter().filter(move |row| row.name.contains(what)).map(|row| row.value);
        Self {
            commit: commit.to_owned(),
            hours,
            samples: rows.iter().filter(|row| row.name.ends_with(": samples")).map(|row| row.value).sum(),
            lost: of(" lost").sum(),
            grown: of(": grown").fold(f64::NEG_INFINITY, f64::max),
            apart_s: of(" apart").fold(0.0, f64::max),
        }
    }
}

/// All portions so far.
#[derive(Debug, PartialEq)]
pub struct Kept(Vec<Portion>);

impl Kept {
    /// Those in the table.
    pub fn read() -> Result<Self> {
        Ok(Self::parse(&tree::text_if_there(TABLE)?))
    }

    /// Length of the next portion \[h\] towards this many hours in total.
    pub fn next_h(&self, wanted_h: f64) -> Option<f64> {
        let left_h = wanted_h - self.hours();
        (left_h >= LEAST_H).then_some(left_h.min(PORTION_H))
    }

    /// Adds a portion with these figures, and writes the table.
    pub fn add(&mut self, commit: &str, hours: f64, rows: &[Row]) -> Result<()> {
        self.0.push(Portion::of(commit, hours, rows));
        tree::write(TABLE, self.markdown())
    }

    fn hours(&self) -> f64 {
        self.0.iter().map(|portion| portion.hours).sum()
    }

    fn parse(text: &str) -> Self {
        let portion = |line: &str| {
            let cells = table::cells(line);
            let [_, commit, figures @ .., _] = &cells[..] else { return None };
            let figures: Vec<f64> = figures.iter().filter_map(|figure| figure.parse().ok()).collect();
            let [hours, samples, lost, grown, apart_s] = figures[..] else { return None };
            Some(Portion { commit: (*commit).to_owned(), hours, samples, lost, grown, apart_s })
        };
        Self(text.lines().filter_map(portion).collect())
    }

    fn markdown(&self) -> String {
        let mut text = format!(
            "# Soaked so far\n\nWritten by `cargo xtask soak --hours H --keep`, which adds portions of {PORTION_H} h at most until H hours stand \
             here. All programs begin anew with each. *samples* and *lost* are of all recordings, frames among what is lost; *grown* is the \
             process that grew most after its first minute, *apart* how far samples and the host's clock were apart at most; *commit* is the \
             tree that was soaked; with `-dirty` it had changes besides.\n\n{:.2} hours in all.\n\n\
             | commit | hours | samples | lost | grown % | apart s |\n|---|--:|--:|--:|--:|--:|\n",
            self.hours()
        );
        for Portion { commit, hours, samples, lost, grown, apart_s } in &self.0 {
            text += &format!("| {commit} | {hours:.2} | {samples} | {lost} | {grown:.1} | {apart_s:.3} |\n");
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn portions_are_read_back_and_counted() {
        let portion = |commit: &str, hours| Portion {
            commit: commit.into(),
            hours,
            samples: 14_400_000.0,
            lost: 0.0,
            grown: -0.5,
            apart_s: 0.125,
        };
        let kept = Kept(vec![portion("ac2bb3a", 1.0), portion("ac2bb3a-dirty", 0.25)]);
        assert_eq!(Kept::parse(&kept.markdown()), kept);
        let next = |wanted_h| kept.next_h(wanted_h);
        assert_eq!([next(24.0), next(1.5), next(1.26), next(1.0)], [Some(1.0), Some(0.25), None, None]);
    }

    #[test]
    fn the_worst_figures_are_kept() {
        let row = |name: &str, value| Row::new(name, value, "");
        let rows = [
            row("monitor: grown after the first minute", 0.5),
            row("QEMU: grown after the first minute", 2.0),
            row("monitor.mcap: samples", 100.0),
            row("monitor.mcap: samples lost", 3.0),
            row("qemu.mcap: samples", 25.0),
            row("qemu.mcap: samples and the host's clock apart", 0.01),
        ];
        let Portion { samples, lost, grown, apart_s, .. } = Portion::of("ac2bb3a", 1.0, &rows);
        assert_eq!([samples, lost, grown, apart_s], [125.0, 3.0, 2.0, 0.01]);
    }
}
