//! The accuracy table as Markdown, and its missed goals.

use super::backlash;
use inerter_tests::coverage;
use inerter_tests::grid::{Cell, Column};
use inerter_tests::sheet::{TOLERANCE, line, mean, percent, significant};
use std::fmt::Write;

/// Standard errors within which a mean counts as zero.
const SIGNIFICANT: f64 = 2.5;

/// One parameter of one motion.
pub struct Row {
    pub motion: &'static str,
    pub parameter: &'static str,
    pub cell: Cell,
    /// Goals for bias and sigma.
    pub goal: Option<(f64, f64)>,
    /// Cramer-Rao bound.
    pub least_sigma: f64,
    /// The Cramer-Rao bound with the encoder's steps as additional noise.
    pub least_with_steps: f64,
    /// Goal for sigma as a multiple of the Cramer-Rao bound.
    pub ratio_goal: Option<f64>,
    /// Cramer-Rao bound without the samples within a kernel's length of a sticking.
    pub kept_sigma: f64,
    /// The inner value is `None` if the parameter is not expected to settle.
    pub settling_goal_s: Option<Option<f64>>,
}

/// One rig.
pub struct Section {
    pub name: String,
    /// Note for the reader.
    pub note: &'static str,
    pub rows: Vec<Row>,
}

impl Section {
    /// Whether it has goals.
    pub fn has_goals(&self) -> bool {
        self.rows.iter().any(|row| row.goal.is_some())
    }

    /// Cells whose intervals cover the true value in significantly less than 95 % of that many runs.
    pub fn under(&self, seeds: u64) -> Vec<String> {
        let short = |part: Option<f64>| part.is_some_and(|part| coverage::is_low(part, seeds));
        self.rows
            .iter()
            .map(|row| (row, [row.cell.coverage, row.cell.whole_run_coverage]))
            .filter(|(_, parts)| parts.iter().copied().any(short))
            .map(|(row, parts)| {
                let [live, whole] = parts.map(percent);
                format!(
                    "{}, {}, {}: covers {live} live, {whole} over the whole run, less than 95 %",
                    self.name, row.motion, row.parameter
                )
            })
            .collect()
    }
}

impl Row {
    fn bias_missed(&self) -> bool {
        self.goal.is_some_and(|(bias, _)| self.cell.last.bias.abs() > bias)
    }

    fn sigma_missed(&self) -> bool {
        self.goal.is_some_and(|(_, sigma)| self.cell.last.sigma > sigma)
    }

    fn settling_missed(&self) -> bool {
        match (self.settling_goal_s.flatten(), self.cell.settling_s) {
            // Allow for the publication interval of 0.1 s.
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
        let Cell { last: Column { bias, sigma, u95, given, .. }, coverage, whole_run_coverage, settling_s } = self.cell;
        vec![
            self.motion.into(),
            self.parameter.into(),
            mean(bias, sigma),
            significant(sigma),
            self.goal.map_or(String::new(), |(bias, sigma)| format!("{bias}, {sigma}")),
            self.verdict(),
            significant(self.least_sigma),
            significant(sigma / self.least_sigma),
            significant(sigma / self.least_with_steps),
            significant(u95),
            percent(coverage),
            percent(whole_run_coverage),
            given.to_string(),
            settling_s.map_or("never".into(), |time| format!("{time:.1}")),
            self.settling_goal_s.map_or(String::new(), |goal| goal.map_or("never".into(), |goal| goal.to_string())),
        ]
    }

    /// Describes by how much the goals are missed, and what the figures show about the reason.
    fn misses(&self, seeds: u64) -> Vec<String> {
        let mut lines = Vec::new();
        let Some((bias_goal, sigma_goal)) = self.goal else { return lines };
        let Column { bias, sigma, u95, given, .. } = self.cell.last;
        if self.bias_missed() {
            let errors = bias.abs() / (sigma / (seeds as f64).sqrt());
            let word = if errors < SIGNIFICANT {
                format!("{errors:.1} standard errors of its mean over {seeds} runs: not told from none")
            } else {
                let part = bias.abs() / u95;
                format!(
                    "systematic ({errors:.0} standard errors), {:.0} % of the interval that is reported",
                    part * 100.0
                )
            };
            lines.push(format!("bias {} against {bias_goal}: {word}", significant(bias)));
        }
        if self.sigma_missed() {
            let known = 100.0 / (2.0 * (seeds as f64 - 1.0)).sqrt();
            let over = (sigma / sigma_goal - 1.0) * 100.0;
            let [sigma, least, kept] = [sigma, self.least_sigma, self.kept_sigma].map(significant);
            let unreachable = if self.least_sigma > sigma_goal { ", above the goal itself" } else { "" };
            lines.push(format!(
                "sigma {sigma} against {sigma_goal}, over by {over:.1} %, itself known to {known:.0} %. The least that this \
                 noise allows is {least}{unreachable}; {kept} where a kernel's length around each sticking is left out"
            ));
        }
        if let Some(goal) = self.ratio_goal.filter(|goal| sigma > goal * self.least_sigma) {
            let [ratio, with_steps] = [self.least_sigma, self.least_with_steps].map(|least| significant(sigma / least));
            lines.push(format!(
                "sigma {ratio} times what the force's noise allows, against {goal}; {with_steps} times what it allows with the \
                 encoder's steps"
            ));
        }
        if self.settling_missed() {
            let goal = self.settling_goal_s.flatten().unwrap_or(0.0);
            lines.push(match self.cell.settling_s {
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

/// Introduction to the backlash tables.
const BACKLASH: &str = "
## Backlash

The same device with a backlash of 0 to 200 um between its flanks, in um. By the force alone the contact stiffness is known to
0.1 %; the terminal's sensor has steps of 0.1 um and 1 um of noise, and needs no stiffness. *given*: runs that
ended with a value, `ok` or `below_u95`; *wrong*: those of them whose interval misses the truth. *ks*, *cs*: errors of contact
stiffness and damping with the sensor, in %.
";

/// The whole document.
pub fn markdown(sections: &[Section], backlash: &[backlash::Section], seeds: u64) -> String {
    let mut text = format!(
        "# Accuracy

What the estimator says of the simulated device against what is true: the paper's device with 50 N of Coulomb friction,
encoder steps of 2.44 um, white force noise of 1 or 5 N rms in each sample, a force offset of 3 N, skew, structure mass
and contact known; {seeds} runs of 20 s in each cell, 80 s for `slow`. The motions are those of
`inerter simulate --excite`: `slow` 0.053 Hz 15.1 mm, `mid` 3.2 Hz 4.16 mm, `fast` 15.9 Hz 0.806 mm, `multi` and `random`
0.5 to 15 Hz at 20 mm/s rms, `two` 0.8 Hz 8 mm with 6.4 Hz 0.8 mm.

Written by `cargo xtask accuracy --update`. `cargo xtask accuracy`, part of `cargo xtask test --full`, measures anew and fails
where a figure left the table by more than {} %, either way, or where, beyond chance (1 in 10 000), fewer than 95 % of the
published values lie within their interval of the truth; `--short`, part of `cargo xtask test`, does so on the first rig.

- *bias*, *sigma*: mean and standard deviation of the error at the end of the run, from the sums of the whole run;
  *goal*: greatest bias and sigma wanted, set for 1 kHz and 1 N.
- *least*: the smallest sigma that any unbiased estimator can have with this noise, knowing the motion exactly
  (Cramer and Rao), over all samples in which the screw truly slips. For `slow` without the first second and the 13 Hz
  ringing after each breakaway, which the slow kernels do not pass. *ratio*: sigma over that; wanted is 1.5 for `fast` and
  `random`, 2.5 for the others, at 1 kHz and 1 N. *with steps*: sigma over the same bound with the encoder's steps as white noise beside the
  force's; the steps are not noise, so a ratio below 1 does not beat a true bound.
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
            "\n## {}\n\n{}| motion | parameter | bias | sigma | goal | reached | least | ratio | with steps | U95 | live | whole | runs | settled s | goal s |\n\
             |---|---|--:|--:|---|---|--:|--:|--:|--:|--:|--:|--:|--:|--:|\n",
            section.name, section.note
        );
        for row in &section.rows {
            text += &line(row.cells());
        }
    }
    text += BACKLASH;
    text.extend(backlash.iter().map(|section| section.text.as_str()));
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
    for miss in backlash.iter().flat_map(|section| &section.misses) {
        met = false;
        let _ = writeln!(text, "- {miss}.");
    }
    if met {
        text.push_str("None.\n");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn section(bias: f64, sigma: f64) -> Section {
        let row = Row {
            motion: "slow",
            parameter: "mt kg",
            cell: Cell {
                last: Column { bias, sigma, u95: 12.3, given: 32, wrong: 0 },
                coverage: Some(0.991),
                whole_run_coverage: None,
                settling_s: None,
            },
            goal: Some((1.5, 3.0)),
            least_sigma: 2.99,
            kept_sigma: 3.28,
            least_with_steps: 3.0,
            ratio_goal: Some(2.5),
            settling_goal_s: Some(None),
        };
        Section { name: "1 kHz, 1 N".into(), note: "", rows: vec![row] }
    }

    #[test]
    fn what_is_missed_is_said_with_its_reason() {
        let text = markdown(&[section(0.1, 3.46)], &[], 32);
        assert!(text.contains("| **sigma** |"), "{text}");
        assert!(text.contains("sigma 3.46 against 3, over by 15.3 %, itself known to 13 %"), "{text}");
        assert!(markdown(&[section(0.1, 2.0)], &[], 32).contains("None."));
    }

    #[test]
    fn coverage_under_the_least_is_named() {
        assert!(section(0.0, 1.0).under(32).is_empty());
        let mut low = section(0.0, 1.0);
        low.rows[0].cell.coverage = Some(0.85);
        assert_eq!(low.under(32).len(), 1);
        // With a single run it may be chance.
        assert!(low.under(1).is_empty());
    }
}
