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
/// Shortest run \[h\]: shorter ones do not settle.
pub const LEAST_H: f64 = 0.05;

/// All portions so far: their hours, and their rows.
#[derive(Debug, Default, PartialEq)]
pub struct Kept {
    hours: f64,
    rows: String,
}

impl Kept {
    /// Those in the table.
    pub fn read() -> Result<Self> {
        Ok(Self::parse(&tree::text_if_there(TABLE)?))
    }

    /// Length of the next portion \[h\] towards this many hours in total.
    pub fn next_h(&self, wanted_h: f64) -> Option<f64> {
        let left_h = wanted_h - self.hours;
        (left_h >= LEAST_H).then_some(left_h.min(PORTION_H))
    }

    /// Adds a portion that met all goals with these figures, and writes the table.
    pub fn add(&mut self, commit: &str, hours: f64, figures: &[Row]) -> Result<()> {
        self.hours += hours;
        self.rows += &row(commit, hours, figures);
        tree::write(TABLE, self.markdown())
    }

    fn parse(text: &str) -> Self {
        let mut kept = Self::default();
        for line in text.lines() {
            if let Some([_, hours, ..]) = table::cells::<6>(line)
                && let Ok(hours) = hours.parse::<f64>()
            {
                kept.hours += hours;
                kept.rows += &format!("{line}\n");
            }
        }
        kept
    }

    fn markdown(&self) -> String {
        let Self { hours, rows } = self;
        format!(
            "# Soaked so far\n\n\
             Written by `cargo xtask soak --hours H --keep`, which adds portions of at most {PORTION_H} h until\n\
             the hours in this table reach H. All programs restart with each portion. *samples* and *lost* are\n\
             totals over all recordings; *lost* counts samples and frames. *grown* is the largest growth of any\n\
             process after its first minute. *apart* is the largest difference between the samples and the host's\n\
             clock, without the twin, which may be slower than a board. *commit* is the tree that was tested;\n\
             `-dirty` means that it also had uncommitted changes.\n\n{hours:.2} hours in all.\n\n\
             | commit | hours | samples | lost | grown % | apart s |\n|---|--:|--:|--:|--:|--:|\n{rows}"
        )
    }
}

/// A portion: the totals of all recordings, the largest growth of any process \[%\], and the largest difference between
/// samples and clock \[s\].
fn row(commit: &str, hours: f64, figures: &[Row]) -> String {
    let of = |what: &'static str| figures.iter().filter(move |row| row.name.contains(what)).map(|row| row.value);
    let samples: f64 = figures.iter().filter(|row| row.name.ends_with(": samples")).map(|row| row.value).sum();
    let lost: f64 = of(" lost").sum();
    let grown = of(": grown").fold(f64::NEG_INFINITY, f64::max);
    let apart_s = of("host's clock apart").fold(0.0, f64::max);
    format!("| {commit} | {hours:.2} | {samples} | {lost} | {grown:.1} | {apart_s:.3} |\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn portions_are_read_back_and_counted() {
        let rows = "| ac2bb3a | 1.00 | 14400000 | 0 | -0.5 | 0.125 |\n\
                    | ac2bb3a-dirty | 0.25 | 3600000 | 0 | 0.1 | 0.016 |\n";
        let kept = Kept { hours: 1.25, rows: rows.to_owned() };
        assert_eq!(Kept::parse(&kept.markdown()), kept);
        let next = |wanted_h| kept.next_h(wanted_h);
        assert_eq!([next(24.0), next(1.5), next(1.26), next(1.0)], [Some(1.0), Some(0.25), None, None]);
    }

    #[test]
    fn the_worst_figures_are_kept() {
        let figure = |name: &str, value| Row::new(name, value, "");
        let figures = [
            figure("monitor: grown after the first minute", 0.5),
            figure("QEMU: grown after the first minute", 2.0),
            figure("monitor.mcap: samples", 100.0),
            figure("monitor.mcap: samples lost", 3.0),
            figure("qemu.mcap: samples", 25.0),
            figure("qemu.mcap: samples and the host's clock apart", 0.01),
        ];
        assert_eq!(row("ac2bb3a", 1.0, &figures), "| ac2bb3a | 1.00 | 125 | 3 | 2.0 | 0.010 |\n");
    }
}
