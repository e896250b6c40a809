//! The tables of what each method can and cannot report.

use crate::{
    answers::{Answers, Heard, Instrument, heard_settling_s, settling_s},
    cases::{
        BACKLASH_M, CHANGE, CHANGE_S, Case, DURATION_S, FORCE_UNIT_N, INTERVAL_SEEDS, MEMORIES_S, Outcome, Question,
        RATE_HZ, SEEDS, SLOW_S, SLOW_STEP, THIN, TRACK, WHITE_TRUTH, device,
    },
};
use inerter_core::{Backlash, BacklashSize, Changed, Interval, Reason, Route};
use std::borrow::Borrow;

/// One line of a table.
fn line<S: Borrow<str>>(cells: &[S]) -> String {
    format!("| {} |\n", cells.join(" | "))
}

/// The cases with what every method answered.
pub struct Report<'a> {
    /// Cases.
    pub cases: &'a [Case],
    /// Results, ours first.
    pub answers: &'a [Answers],
    /// The instrument's results.
    pub instrument: &'a Instrument,
}

const INTRODUCTION: &str = "
## What each method can and cannot report

Each method gets the same regressors of the simulated device, which one kernel computes in f64, and
starts with the variance above. `RlsParallel` appears twice: with its defaults, and tuned for most
of what follows. The crate does not keep its covariance symmetric. For our update alone only values
are listed; intervals, gates and statuses are those of the instrument.
";

const INSTRUMENT: &str = "ours: the whole instrument from raw samples (`Active`)";

impl Report<'_> {
    /// All tables.
    pub fn markdown(&self) -> String {
        [INTRODUCTION.to_owned(), self.terminal(), self.force_alone(), self.intervals(), self.change(), self.slow()]
            .concat()
    }

    fn terminal(&self) -> String {
        let mut text = format!(
            "
### Backlash with a terminal sensor

`x1 - x2 = F/ks - (cs/ks^2) F' + chi eps/2 + c` is fitted for four unknowns. The device has {:.0} um
of backlash and a ks of 2.1e6 N/m. The runs have {DURATION_S} s at 1 kHz, 1 N of noise, encoder
steps of 2.44 um and 1 um of noise at the terminal; there is no forgetting. Each cell has the errors
of eps and ks, each the worst of {SEEDS} runs, and in brackets the mean half width of the 95 %
interval of eps. *all samples*: as a user has them. *gated*: behind an ideal gate that removes every
flight and 4 ms on either side. The instrument has a gate of its own. The law is of first order in
`w cs/ks`, which costs 0.2 % of ks at 13 Hz.

| method | mid, all samples | mid, gated | random, all samples | random, gated |
|---|---|---|---|---|
",
            1e6 * BACKLASH_M
        );
        let ours = |motion| {
            let runs = self.instrument.contact.iter().filter(|(of, backlash, ..)| *of == motion && *backlash > 0.0);
            let details: Vec<_> = runs.map(|(_, _, sensed, _)| sensed.detail).collect();
            let refused = details.iter().find_map(|detail| match detail.backlash.size {
                BacklashSize::NotIdentifiable(reason) => Some(words(reason).to_owned()),
                _ if detail.backlash.route != Route::Terminal => Some("by the force alone".into()),
                _ => None,
            });
            refused.unwrap_or_else(|| {
                errors(details.iter().map(|detail| {
                    let stiffness = detail.stiffness_n_per_m.value().map_or(f64::NAN, f64::from);
                    let backlash = detail.backlash.known().unwrap_or_default();
                    (f64::from(backlash.value), Some(f64::from(backlash.u95)), stiffness)
                }))
            })
        };
        text += &line(&[INSTRUMENT, "-", &ours("mid"), "-", &ours("random")]);
        for answer in self.answers {
            let mut cells = vec![answer.name.clone()];
            for motion in ["mid", "random"] {
                for gated in [false, true] {
                    let outcomes = answer.to(self.cases, Question::Contact { motion, gated });
                    cells.push(errors(outcomes.iter().map(|(case, outcome)| {
                        let [stiff, _, half_backlash, _] = outcome.parameters;
                        let width = case.half_widths(outcome).map(|widths| 2e-6 * widths[2]);
                        (2e-6 * half_backlash, width, 1e6 * FORCE_UNIT_N / stiff)
                    })));
                }
            }
            text += &row(&cells);
        }
        text
    }

    fn force_alone(&self) -> String {
        let mut text = format!(
            "
### Backlash from the force alone

The same runs without the terminal sensor, and those of the device without backlash; ks is a
setting. A filter takes one regressor vector `phi` per sample for a fixed list of unknowns. Without
x1 the backlash is only a step in an unknown polynomial, a new one at each reversal, so no `phi`
describes it. Each cell has value and interval of the worst of {SEEDS} runs.

| method | mid, 100 um | mid, no backlash | random, 100 um | random, no backlash |
|---|---|---|---|---|
"
        );
        let mut cells = vec![INSTRUMENT.to_owned()];
        for motion in ["mid", "random"] {
            for backlash_m in [BACKLASH_M, 0.0] {
                let runs = self
                    .instrument
                    .contact
                    .iter()
                    .filter(|(of, backlash, ..)| *of == motion && *backlash == backlash_m);
                let worst = runs.map(|(_, _, _, heard)| heard.detail.backlash).max_by(|a, b| {
                    let error = |backlash: &Backlash| {
                        backlash.known().map_or(f64::INFINITY, |known| (f64::from(known.value) - backlash_m).abs())
                    };
                    error(a).total_cmp(&error(b))
                });
                cells.push(worst.as_ref().map_or("-".into(), backlash));
            }
        }
        text += &line(&cells);
        text + &line(&["all other methods", "no such unknown", "", "no such unknown", ""])
    }

    fn intervals(&self) -> String {
        let mut text = format!(
            "
### Coverage of the intervals

Each cell has the percentages of {INTERVAL_SEEDS} runs of {DURATION_S} s whose 95 % interval
contains the true value, for mt, cf and fc. The interval of a covariance is `1.96 sqrt(s^2 P_ii)`
with the residual's variance `s^2`.

- *white*: the law with independent noise, to show that the formula is used as intended.
- *every*: an update at each sample, as users run them, although the kernel correlates the noise of
  neighbouring samples.
- *thinned*: one update in {THIN}, the length of that correlation, for users who know it.
- *width*: the mean half width in `random` over 1.96 times the rms error: 1 is ideal, below 1 too
  narrow, above 1 too wide.
- *P < 0*: the covariance has lost its positive diagonal.

The rivals are given the true sign of the velocity and an ideal gate for sticking; the instrument
finds both itself. Its interval includes a systematic part, 5 % of fc, which this device does not
need. So the interval of a thinned covariance is narrower.

| method | white | random, every | width | mid, every | random, thinned | width | mid, thinned |
|---|---|---|---|---|---|---|---|
"
        );
        let truth = [device().inertance_kg, device().viscous_n_s_per_m, device().coulomb_n];
        let ours = |motion| {
            let runs = self.instrument.interval.iter().filter(|(of, _)| *of == motion);
            let runs = runs.map(|(_, heard)| {
                let recent = heard.last.recent;
                [recent.inertance_kg, recent.viscous_n_s_per_m, recent.coulomb_n]
                    .map(|one| (one.value().map_or(f64::NAN, f64::from), f64::from(one.u95())))
            });
            coverage(&runs.collect::<Vec<_>>(), truth)
        };
        let ([random, random_width], [mid, _]) = (ours("random"), ours("mid"));
        text += &line(&[INSTRUMENT, "-", &random, &random_width, &mid, "-", "-", "-"]);
        for answer in self.answers {
            let cell = |question, truth| {
                let runs: Option<Vec<_>> = answer
                    .to(self.cases, question)
                    .into_iter()
                    .map(|(case, outcome)| {
                        let widths = case.half_widths(outcome)?;
                        Some(std::array::from_fn(|i| (outcome.parameters[i], widths[i])))
                    })
                    .collect();
                match runs {
                    Some(runs) if runs.is_empty() => ["".into(), "".into()],
                    Some(runs) => coverage(&runs, truth),
                    None => ["none".into(), "none".into()],
                }
            };
            let [white, _] = cell(Question::White, [WHITE_TRUTH[0], WHITE_TRUTH[1], WHITE_TRUTH[2]]);
            let [random, width] = cell(Question::Interval { motion: "random", thinned: false }, truth);
            let [mid, _] = cell(Question::Interval { motion: "mid", thinned: false }, truth);
            let [random_thin, width_thin] = cell(Question::Interval { motion: "random", thinned: true }, truth);
            let [mid_thin, _] = cell(Question::Interval { motion: "mid", thinned: true }, truth);
            text += &row(&[answer.name.clone(), white, random, width, mid, random_thin, width_thin, mid_thin]);
        }
        text
    }

    fn change(&self) -> String {
        let mut text = format!(
            "
### A change of the device

mt grows by {:.0} % after {CHANGE_S} s at 3.2 Hz. Each cell has the time until the estimate stays
within 1 % of the new value, the longest of {SEEDS} runs: with the forgetting of the first table (a
memory of 1 s), and with a memory of 30 s, our default. An estimate with a short memory follows the
change by itself; with a long memory the change must be detected.

| method | memory 1 s | memory 30 s | change reported |
|---|--:|--:|---|
",
            100.0 * (CHANGE - 1.0)
        );
        let longest = |times: Vec<Option<f64>>| {
            let all: Option<Vec<f64>> = times.into_iter().collect();
            all.map_or("not in 10 s".into(), |all| match all.into_iter().reduce(f64::max) {
                Some(longest) => format!("{longest:.2} s"),
                None => String::new(),
            })
        };
        let ours = MEMORIES_S.map(|memory_s| {
            let runs = self.instrument.change.iter().filter(|(of, _)| *of == memory_s);
            longest(runs.map(|(_, heard)| heard_settling_s(heard)).collect())
        });
        let announced: Vec<_> = self.instrument.change.iter().filter_map(|(_, heard)| heard.change).collect();
        let latest = announced.iter().fold(0.0_f64, |latest, (t_s, _)| latest.max(t_s - CHANGE_S));
        let right = announced.iter().all(|(t_s, change)| *t_s > CHANGE_S && change.parameter == Changed::Inertance);
        let announcement = match (announced.len(), right) {
            (0, _) => "no".into(),
            (found, true) => {
                format!("inertance, {found} of {} runs, {latest:.2} s after", self.instrument.change.len())
            }
            (_, false) => "wrongly".into(),
        };
        let [short, long] = ours;
        text += &line(&[INSTRUMENT, &short, &long, &announcement]);
        for answer in self.answers {
            let [short, long] = MEMORIES_S.map(|memory_s| {
                let outcomes = answer.to(self.cases, Question::Change { memory_s });
                longest(outcomes.into_iter().map(|(case, outcome)| track_settling_s(case, outcome)).collect())
            });
            text += &row(&[answer.name.clone(), short, long, "no".into()]);
        }
        text
    }

    fn slow(&self) -> String {
        let truth = device().inertance_kg;
        let [short_s, long_s] = SLOW_S;
        let mut text = format!(
            "
### Inertance at 0.053 Hz

`slow` moves a device of {truth:.2} kg. Its acceleration is at most 1.7 mm/s^2 after the start, and
the screw sticks at every reversal. Each cell has the rms error, the mean half width of the 95 %
interval, and the number of the {SEEDS} runs whose interval contains the true value. An update comes
every {SLOW_STEP} ms. *all*: all samples, as a user has them. *gated*: behind an ideal gate that
removes all sticking. *no value*: the motion cannot separate the unknowns.

| method | {short_s} s, all | {short_s} s, gated | {long_s} s, all | {long_s} s, gated | reports a status |
|---|---|---|---|---|---|
"
        );
        let verdict = |runs: &[(f64, Option<f64>)]| {
            if runs.is_empty() {
                return String::new();
            }
            let count = runs.len() as f64;
            let rms = (runs.iter().map(|(value, _)| (value - truth).powi(2)).sum::<f64>() / count).sqrt();
            if rms.is_nan() {
                return "no value".into();
            }
            let Some(widths) = runs.iter().map(|(_, width)| *width).collect::<Option<Vec<f64>>>() else {
                return format!("{} kg", figure(rms));
            };
            let held = runs.iter().zip(&widths).filter(|((value, _), width)| (value - truth).abs() <= **width).count();
            format!(
                "{} kg, +- {} kg, {held} of {}",
                figure(rms),
                figure(widths.iter().sum::<f64>() / count),
                runs.len()
            )
        };
        let [short, long] = SLOW_S.map(|end_s| {
            let last = |heard: &Heard| heard.published.iter().rfind(|(t_s, _)| *t_s < end_s).map(|(_, last)| *last);
            let ours = self.instrument.slow.iter().filter_map(last).map(|last| last.recent.inertance_kg);
            let known: Vec<_> = ours
                .filter_map(|one| one.known())
                .map(|one| (f64::from(one.value), Some(f64::from(one.u95))))
                .collect();
            match SEEDS as usize - known.len() {
                0 => verdict(&known),
                unknown => format!("not identifiable in {unknown} of {SEEDS}"),
            }
        });
        text += &line(&[INSTRUMENT, "-", &short, "-", &long, "yes"]);
        for answer in self.answers {
            let mut cells = vec![answer.name.clone()];
            for duration_s in SLOW_S {
                for gated in [false, true] {
                    let outcomes = answer.to(self.cases, Question::Slow { duration_s, gated });
                    let width = |case: &Case, outcome| Some(case.half_widths(outcome)?[0]);
                    let runs: Vec<_> =
                        outcomes.iter().map(|(case, one)| (one.parameters[0], width(case, one))).collect();
                    cells.push(verdict(&runs));
                }
            }
            cells.push("no".into());
            text += &row(&cells);
        }
        text
    }
}

/// A line, unless the method has no result of its own.
fn row(cells: &[String]) -> String {
    if cells[1].is_empty() { String::new() } else { line(cells) }
}

fn track_settling_s(case: &Case, outcome: &Outcome) -> Option<f64> {
    let time_s = |n: usize| case.start_s + (n * TRACK) as f64 / RATE_HZ;
    settling_s((0..outcome.track.len()).map(|n| (time_s(n), outcome.track[n])))
}

/// Worst errors of backlash and stiffness, by backlash, its half width, and stiffness.
fn errors(values: impl Iterator<Item = (f64, Option<f64>, f64)>) -> String {
    let (mut backlash_um, mut stiffness, mut widths) = (0.0_f64, 0.0_f64, Vec::new());
    let worse = |now: f64, so_far: f64| if now.abs() > so_far.abs() || now.is_nan() { now } else { so_far };
    for (backlash_m, width_m, stiffness_n_per_m) in values {
        backlash_um = worse(1e6 * (backlash_m - BACKLASH_M), backlash_um);
        stiffness = worse(100.0 * (stiffness_n_per_m / device().stiffness_n_per_m - 1.0), stiffness);
        widths.push(width_m.map(|width_m| 1e6 * width_m));
    }
    if widths.is_empty() {
        return String::new();
    }
    let count = widths.len() as f64;
    let width = match widths.into_iter().sum::<Option<f64>>() {
        Some(sum) => format!("+- {}", figure(sum / count)),
        None => "none".into(),
    };
    format!("{backlash_um:+.2} ({width}) um, {stiffness:+.3} %")
}

/// How many intervals contain the truth, and how wide they are; by runs, then parameters: value and half width.
fn coverage(runs: &[[(f64, f64); 3]], truth: [f64; 3]) -> [String; 2] {
    let count = runs.len() as f64;
    let (mut held, mut widths) = (Vec::new(), Vec::new());
    for (i, truth) in truth.into_iter().enumerate() {
        let covered = runs.iter().filter(|run| (run[i].0 - truth).abs() <= run[i].1).count();
        held.push(format!("{:.0}", 100.0 * covered as f64 / count));
        let rms = (runs.iter().map(|run| (run[i].0 - truth).powi(2)).sum::<f64>() / count).sqrt();
        let width = runs.iter().map(|run| run[i].1).sum::<f64>() / count / (1.96 * rms);
        widths.push(figure(width));
    }
    [format!("{} %", held.join(", ")), widths.join(", ")]
}

/// Three digits or so; a width that is the root of a negative variance is named.
fn figure(value: f64) -> String {
    match value.abs() {
        size if size.is_nan() => "P < 0".into(),
        size if size < 10.0 => format!("{value:.2}"),
        _ => format!("{value:.1}"),
    }
}

fn backlash(backlash: &Backlash) -> String {
    let text = |Interval { value, u95 }: Interval| format!("{:.2} +- {:.2} um", 1e6 * value, 1e6 * u95);
    match backlash.size {
        BacklashSize::NotIdentifiable(reason) => words(reason).into(),
        BacklashSize::BelowU95(interval) => format!("{}, smaller than its interval", text(interval)),
        BacklashSize::Ok(interval) => text(interval),
    }
}

fn words(reason: Reason) -> &'static str {
    match reason {
        Reason::ForceNeverReverses => "not identifiable: the force never reverses",
        Reason::TooFewReversals => "not identifiable: too few reversals",
        Reason::FlankTooShort => "not identifiable: the flanks are too short",
        Reason::StiffnessUnknown => "not identifiable: the stiffness is unknown",
        Reason::Scattered => "not identifiable: the reversals contradict each other",
    }
}
