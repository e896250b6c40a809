//! The robustness sheet as Markdown.

use inerter_tests::coverage;
use inerter_tests::grid::{Column, NAMES};
use inerter_tests::robustness::{Cell, LOUD};
use inerter_tests::sheet::{TOLERANCE, line, list, mean, percent, significant};

/// One case with one motion.
pub struct Row {
    pub case: &'static str,
    pub motion: &'static str,
    pub cell: Cell,
}

impl Row {
    fn flags(&self, i: usize, seeds: u64) -> String {
        let mut flags = self.cell.flags.clone();
        if 2 * self.cell.last[i].given <= seeds as usize {
            flags.push("not identifiable");
        }
        if flags.is_empty() { "-".into() } else { flags.join(", ") }
    }

    fn is_wrong(&self, i: usize, seeds: u64) -> bool {
        self.cell.coverage[i].is_some_and(|part| coverage::is_low(part, seeds))
    }

    fn cells(&self, i: usize, seeds: u64) -> Vec<String> {
        let cell = &self.cell;
        let Column { bias, sigma, u95, given, .. } = cell.last[i];
        let coverage = percent(cell.coverage[i]);
        vec![
            self.case.into(),
            self.motion.into(),
            NAMES[i].into(),
            mean(bias, sigma.max(0.01 * bias.abs())),
            significant(sigma),
            // A single run has no scatter beside which its interval would tell something.
            if given < 2 { "-".into() } else { significant(u95) },
            if self.is_wrong(i, seeds) { format!("**{coverage}**") } else { coverage },
            given.to_string(),
            significant(cell.residual_n),
            self.flags(i, seeds),
        ]
    }
}

/// The whole document.
pub fn markdown(rows: &[Row], seeds: u64) -> String {
    let mut text = format!(
        "# Robustness

What one imperfection of rig or device at a time does to the estimates: the device, rig and motions of
[accuracy](accuracy.md) (1 kHz, 1 N, 2.44 um per count), {seeds} runs of 20 s in each row, 80 s for `slow`.
The settings do not state the imperfection. *fc* is the sliding friction, the mean of both directions.

Written by `cargo xtask robustness --update`; `cargo xtask robustness` measures anew and fails where a figure left the
table by more than {} %, either way, or where another flag shows.

- *bias*, *sigma*, *U95*: mean error, its standard deviation and the mean interval of the whole run's values at its end.
- *covered*: part of all published values, live and whole run, ten a second, whose interval covers the truth; bold where that is less than
  95 % beyond chance. Until a second of motion has been seen, nothing is known of how friction behaves.
- *runs*: how many ended with a value. *residual*: rms of what the law leaves open \\[N\\].
- *flagged by*: what the device itself says in at least half of the runs: its counters of discontinuities and saturated samples,
  what it makes of friction, a parameter that is not identifiable; *residual* where that is {LOUD} times that of the
  first rows.

| wrong | motion | parameter | bias | sigma | U95 | covered | runs | residual | flagged by |
|---|---|---|--:|--:|--:|--:|--:|--:|---|
",
        TOLERANCE * 100.0
    );
    for row in rows {
        for i in 0..NAMES.len() {
            text += &line(row.cells(i, seeds));
        }
    }
    let mut wrong = Vec::new();
    for row in rows {
        for i in (0..NAMES.len()).filter(|i| row.is_wrong(*i, seeds) && row.flags(*i, seeds) == "-") {
            let Column { bias, u95, .. } = row.cell.last[i];
            let [bias, u95] = [bias, u95].map(significant);
            wrong.push(format!("{}, {}, {}: {bias} with an interval of {u95}", row.case, row.motion, NAMES[i]));
        }
    }
    text + "\n## Wrong and not flagged\n\n" + &list(&wrong)
}

#[cfg(test)]
mod tests {
    use super::*;
    use inerter_tests::sheet;

    fn differences(committed: &str, now: &str) -> Vec<String> {
        sheet::differences(committed, now, 3)
    }

    fn row(bias: f64, coverage: f64, flags: &[&'static str]) -> Row {
        let cell = Cell {
            last: [Column { bias, sigma: 0.02, u95: 0.09, given: 8, ..Column::default() }; 3],
            coverage: [Some(coverage), Some(1.0), None],
            residual_n: 0.39,
            flags: flags.to_vec(),
        };
        Row { case: "gain 1 %", motion: "mid", cell }
    }

    #[test]
    fn a_figure_or_a_flag_that_moves_is_named() {
        let table = |bias, flags: &[&'static str]| markdown(&[row(bias, 1.0, flags)], 8);
        assert!(differences(&table(0.5, &["discontinuities"]), &table(0.505, &["discontinuities"])).is_empty());
        let found = differences(&table(0.5, &["discontinuities"]), &table(0.6, &["discontinuities"]));
        assert_eq!(found[0], "gain 1 %, mid, mt kg: bias 0.6000, the table says 0.5000");
        assert_eq!(differences(&table(0.5, &["discontinuities"]), &table(0.5, &[])).len(), 3);
        assert_eq!(differences(&table(0.5, &[]), "").len(), 3);
        assert_eq!(differences("", &table(0.5, &[])).len(), 3);
    }

    #[test]
    fn what_is_wrong_without_a_flag_is_listed() {
        let text = markdown(&[row(0.5, 0.2, &[])], 8);
        assert!(
            text.contains("| **20.0** |") && text.contains("- gain 1 %, mid, mt kg: 0.500 with an interval of 0.0900.")
        );
        assert!(markdown(&[row(0.5, 0.2, &["discontinuities"])], 8).contains("None."));
        assert!(markdown(&[row(0.0, 1.0, &[])], 8).contains("None."));
    }
}
