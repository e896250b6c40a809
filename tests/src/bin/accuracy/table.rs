//! The table as Markdown, and what differs between two of them.

use std::fmt::Write;

/// Part by which a figure may differ from the committed one: mathematical libraries differ in the last digits of a
/// sine, which moves a few counts of a run.
const TOLERANCE: f64 = 0.02;
/// Standard errors under which a mean is taken for zero.
const SIGNIFICANT: f64 = 2.5;

/// One parameter of one motion.
pub struct Row {
    pub motion: &'static str,
    pub parameter: &'static str,
    pub bias: f64,
    pub sigma: f64,
    /// Greatest bias and sigma wanted.
    pub goal: Option<(f64, f64)>,
    /// Bound of Cramer and Rao.
    pub least_sigma: f64,
    /// The same with a kernel's length left out around each sticking.
    pub kept_sigma: f64,
    pub u95: f64,
    pub coverage: Option<f64>,
    pub whole_run_coverage: Option<f64>,
    /// Runs that ended with a value.
    pub given: usize,
    pub settling_s: Option<f64>,
    /// The inner is none where the value is not expected to settle.
    pub settling_goal_s: Option<Option<f64>>,
}

/// One rig.
pub struct Section {
    pub name: String,
    /// What must be known to read it.
    pub note: &'static str,
    pub rows: Vec<Row>,
}

impl Section {
    /// Whether it is one that must reach something.
    pub fn has_goals(&self) -> bool {
        self.rows.iter().any(|row| row.goal.is_some())
    }

    /// Cells whose intervals cover the truth less often than they must.
    pub fn under(&self, least: f64) -> Vec<String> {
        let short = |part: Option<f64>| part.is_some_and(|part| part < least);
        self.rows
            .iter()
            .filter(|row| short(row.coverage) || short(row.whole_run_coverage))
            .map(|row| {
                let [live, whole] = [row.coverage, row.whole_run_coverage].map(percent);
                format!(
                    "{}, {}, {}: covers {live} live, {whole} over the whole run, under {} %",
                    self.name,
                    row.motion,
                    row.parameter,
                    least * 100.0
                )
            })
            .collect()
    }
}

impl Row {
    fn bias_missed(&self) -> bool {
        self.goal.is_some_and(|(bias, _)| self.bias.abs() > bias)
    }

    fn sigma_missed(&self) -> bool {
        self.goal.is_some_and(|(_, sigma)| self.sigma > sigma)
    }

    fn settling_missed(&self) -> bool {
        match (self.settling_goal_s.flatten(), self.settling_s) {
            // Published ten times a second.
            (Some(goal), Some(time)) => time > goal + 0.1,
            (Some(_), None) => true,
            (None, _) => false,
        }
    }

    fn verdict(&self) -> String {
        let missed: Vec<&str> =
            [("bias", self.bias_missed()), ("sigma", self.sigma_missed()), ("time", self.settling_missed())]
                .into_iter()
                .filter_map(|(name, missed)| missed.then_some(name))
                .collect();
        match (self.goal, missed.as_slice()) {
            (None, _) => String::new(),
            (_, []) => "yes".into(),
            _ => format!("**{}**", missed.join(", ")),
        }
    }

    fn cells(&self) -> Vec<String> {
        let bias = if self.bias.is_finite() { format!("{:.*}", decimals(self.sigma), self.bias) } else { "-".into() };
        let time = |time: Option<f64>| time.map_or("never".into(), |time| format!("{time:.1}"));
        vec![
            self.motion.into(),
            self.parameter.into(),
            bias,
            significant(self.sigma),
            self.goal.map_or(String::new(), |(bias, sigma)| format!("{bias}, {sigma}")),
            self.verdict(),
            significant(self.least_sigma),
            significant(self.u95),
            percent(self.coverage),
            percent(self.whole_run_coverage),
            self.given.to_string(),
            time(self.settling_s),
            self.settling_goal_s.map_or(String::new(), |goal| goal.map_or("never".into(), |goal| goal.to_string())),
        ]
    }

    /// By how much the goals are missed, and what the figures say about why.
    fn misses(&self, seeds: u64) -> Vec<String> {
        let mut lines = Vec::new();
        let Some((bias_goal, sigma_goal)) = self.goal else { return lines };
        if self.bias_missed() {
            let errors = self.bias.abs() / (self.sigma / (seeds as f64).sqrt());
            let word = if errors < SIGNIFICANT {
                format!("{errors:.1} standard errors of its mean over {seeds} runs: not told from none")
            } else {
                let part = self.bias.abs() / self.u95;
                format!(
                    "systematic ({errors:.0} standard errors), {:.0} % of the interval that is reported",
                    part * 100.0
                )
            };
            lines.push(format!("bias {} against {bias_goal}: {word}", significant(self.bias)));
        }
        if self.sigma_missed() {
            let known = 100.0 / (2.0 * (seeds as f64 - 1.0)).sqrt();
            let [sigma, least, kept] = [self.sigma, self.least_sigma, self.kept_sigma].map(significant);
            let over = (self.sigma / sigma_goal - 1.0) * 100.0;
            let unreachable = if self.least_sigma > sigma_goal { ", above the goal itself" } else { "" };
            lines.push(format!(
                "sigma {sigma} against {sigma_goal}, over by {over:.1} %, itself known to {known:.0} %. The least that this \
                 noise allows is {least}{unreachable}; {kept} where a kernel's length around each sticking is left out"
            ));
        }
        if self.settling_missed() {
            let goal = self.settling_goal_s.flatten().unwrap_or(0.0);
            let given = self.given;
            lines.push(match self.settling_s {
                Some(time) => format!("settled after {time:.1} s against {goal} s"),
                None if given == 0 => {
                    format!("no value, rightly: its interval is wider than half of it; goal {goal} s")
                }
                None => format!("a value in {given} of {seeds} runs, never settled; goal {goal} s"),
            });
        }
        lines
    }
}

/// The whole document.
pub fn markdown(sections: &[Section], seeds: u64) -> String {
    let mut text = format!(
        "# Accuracy

What the estimator says of the simulated device against what is true: the paper's device with 50 N of Coulomb friction,
encoder steps of 2.44 um, white force noise of 1 or 5 N rms in each sample, a force offset of 3 N, skew, structure mass
and contact known; {seeds} runs of 20 s in each cell, 80 s for `slow`. The motions are those of
`inerter simulate --excite`: `slow` 0.053 Hz 15.1 mm, `mid` 3.2 Hz 4.16 mm, `fast` 15.9 Hz 0.806 mm, `multi` and `random`
0.5 to 15 Hz at 20 mm/s rms, `two` 0.8 Hz 8 mm with 6.4 Hz 0.8 mm.

Written by `cargo xtask accuracy --update`; `cargo xtask accuracy`, part of `cargo xtask test`, measures anew and fails
where a figure left the table by more than {} %, either way, or where fewer than 95 % of the published values lie within
their interval of the truth.

- *bias*, *sigma*: mean and standard deviation of the error at the end of the run, from the sums of the whole run;
  *goal*: greatest bias and sigma wanted, set for 1 kHz and 1 N.
- *least*: the smallest sigma that any unbiased estimator can have with this noise, knowing the motion exactly
  (Cramer and Rao), over all samples in which the screw truly slips. For `slow` without the first second and the 13 Hz
  ringing after each breakaway, which the slow kernels do not pass.
- *U95*: mean half width of the reported interval. *live*, *whole*: part of all published values, ten a second, whose
  interval covers the truth, with a memory of 4 s and over the whole run. *runs*: how many ended with a value.
- *settled*: median time until the live value stays within 0.3 kg (0.1 %), 5 N s/m or 1 N.
",
        TOLERANCE * 100.0
    );
    for section in sections {
        // Writing to a String cannot fail.
        let _ = write!(
            text,
            "\n## {}\n\n{}| motion | parameter | bias | sigma | goal | reached | least | U95 | live | whole | runs | settled s | goal s |\n\
             |---|---|--:|--:|---|---|--:|--:|--:|--:|--:|--:|--:|\n",
            section.name, section.note
        );
        for row in &section.rows {
            let _ = writeln!(text, "| {} |", row.cells().join(" | "));
        }
    }
    text.push_str("\n## Goals that are missed\n\n");
    let mut met = true;
    for section in sections {
        for row in &section.rows {
            for miss in row.misses(seeds) {
                met = false;
                let _ = writeln!(text, "- {}, {}, {}: {miss}.", section.name, row.motion, row.parameter);
            }
        }
    }
    if met {
        text.push_str("None.\n");
    }
    text
}

/// Decimals that show three digits of `value`.
fn decimals(value: f64) -> usize {
    if value == 0.0 || !value.is_finite() {
        return 0;
    }
    (2.0 - value.abs().log10().floor()).clamp(0.0, 9.0) as usize
}

fn significant(value: f64) -> String {
    if value.is_finite() { format!("{value:.*}", decimals(value)) } else { "-".into() }
}

fn percent(part: Option<f64>) -> String {
    part.map_or("-".into(), |part| format!("{:.1}", part * 100.0))
}

/// Rows of the second table that are not those of the first within the tolerance.
pub fn differences(committed: &str, now: &str) -> Vec<String> {
    let (committed, now) = (rows(committed), rows(now));
    let mut differences = Vec::new();
    for (name, cells) in &now {
        let Some((_, before)) = committed.iter().find(|(other, _)| other == name) else {
            differences.push(format!("{name}: not in the table"));
            continue;
        };
        for (column, (cell, before_cell)) in cells.iter().zip(before).enumerate() {
            // A bias is as uncertain as its sigma, in the next column, says.
            let beside = if column == 0 { before.get(1).map_or(0.0, |cell| number(cell).0) } else { 0.0 };
            if !same(before_cell, cell, beside) {
                let column = COLUMNS.get(column).unwrap_or(&"");
                differences.push(format!("{name}: {column} {cell}, the table says {before_cell}"));
            }
        }
    }
    for (name, _) in &committed {
        if !now.iter().any(|(other, _)| other == name) {
            differences.push(format!("{name}: in the table, no longer measured"));
        }
    }
    differences
}

/// Columns behind motion and parameter.
const COLUMNS: [&str; 11] =
    ["bias", "sigma", "goal", "reached", "least", "U95", "live", "whole", "runs", "settled s", "goal s"];

/// The rows, by section, motion and parameter.
fn rows(markdown: &str) -> Vec<(String, Vec<String>)> {
    let mut section = "";
    let mut rows = Vec::new();
    for line in markdown.lines() {
        section = line.strip_prefix("## ").unwrap_or(section);
        let Some(line) = line.strip_prefix('|').and_then(|line| line.strip_suffix('|')) else { continue };
        let cells: Vec<String> = line.split('|').map(|cell| cell.trim().to_owned()).collect();
        if let [motion, parameter, rest @ ..] = cells.as_slice()
            && motion != "motion"
            && !motion.starts_with('-')
        {
            rows.push((format!("{section}, {motion}, {parameter}"), rest.to_vec()));
        }
    }
    rows
}

/// A cell's number, not a number where it is none, and the value of its last digit.
fn number(cell: &str) -> (f64, f64) {
    let decimals = cell.split_once('.').map_or(0, |(_, behind)| behind.len());
    (cell.parse().unwrap_or(f64::NAN), 10_f64.powi(-(decimals as i32)))
}

fn same(before: &str, now: &str, beside: f64) -> bool {
    let ((a, digit_a), (b, digit_b)) = (number(before), number(now));
    if a.is_nan() || b.is_nan() {
        return before == now;
    }
    // Both may have been rounded the other way.
    (a - b).abs() <= TOLERANCE * a.abs().max(beside) + digit_a.max(digit_b)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn section(bias: f64, sigma: f64) -> Section {
        let row = Row {
            motion: "slow",
            parameter: "mt kg",
            bias,
            sigma,
            goal: Some((1.5, 3.0)),
            least_sigma: 2.99,
            kept_sigma: 3.28,
            u95: 12.3,
            coverage: Some(0.991),
            whole_run_coverage: None,
            given: 32,
            settling_s: None,
            settling_goal_s: Some(None),
        };
        Section { name: "1 kHz, 1 N".into(), note: "", rows: vec![row] }
    }

    #[test]
    fn a_figure_that_moves_is_named() {
        let table = |bias, sigma| markdown(&[section(bias, sigma)], 32);
        assert!(differences(&table(0.1, 2.5), &table(0.12, 2.53)).is_empty());
        let found = differences(&table(0.1, 2.5), &table(0.1, 2.6));
        assert_eq!(found, ["1 kHz, 1 N, slow, mt kg: sigma 2.60, the table says 2.50"]);
        assert_eq!(differences(&table(0.1, 2.5), &table(0.1, 2.4)).len(), 1);
        assert_eq!(differences(&table(0.1, 2.5), "").len(), 1);
        assert_eq!(differences("", &table(0.1, 2.5)).len(), 1);
    }

    #[test]
    fn what_is_missed_is_said_with_its_reason() {
        let text = markdown(&[section(0.1, 3.46)], 32);
        assert!(text.contains("| **sigma** |"), "{text}");
        assert!(text.contains("sigma 3.46 against 3, over by 15.3 %, itself known to 13 %"), "{text}");
        assert!(markdown(&[section(0.1, 2.0)], 32).contains("None."));
    }

    #[test]
    fn coverage_under_the_least_is_named() {
        assert!(section(0.0, 1.0).under(0.95).is_empty());
        assert_eq!(section(0.0, 1.0).under(0.995).len(), 1);
    }
}
