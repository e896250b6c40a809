//! `cargo xtask diagnose`: how often the cause that breaks the law is named first with the right size, and how often a
//! wrong cause is named.

use inerter_analysis::diagnose::{Cause, Diagnosis, Kind, LIMIT};
use inerter_tests::{
    data::replayed,
    diagnose::{Case, cases, clean_cases, parting},
    grid::{MOTIONS, Motion, Result, each, error, mean, three, truth},
    identified::Told,
    sheet::{self, Asked, Measured, significant},
};
use std::{array::from_fn, ops::RangeInclusive};

/// Runs that determined the thresholds; no other runs were inspected before that.
const SETTING: RangeInclusive<u64> = 1..=4;
/// Runs per fault and motion that count.
const SEEDS: RangeInclusive<u64> = 61..=64;
/// Maximum relative error of a size.
const RIGHT: f64 = 0.1;
/// Backlash whose impacts may look like a cause \[m\].
const BACKLASHES_M: [f64; 4] = [50e-6, 100e-6, 300e-6, 1e-3];

/// Results of the runs of one fault and motion.
#[derive(Clone, Copy, Default)]
struct Tally {
    runs: u32,
    /// Runs in which the fault is named first.
    first: u32,
    /// Of these, those whose size is right.
    sized: u32,
    /// Of `first`, those whose interval holds the size.
    within: u32,
    /// Of `first`, those in which inertance, viscous and Coulomb friction lie within their intervals, with the causes
    /// included.
    corrected: [u32; 3],
    /// Runs in which another cause is named first.
    other: u32,
    /// Runs in which nothing is named.
    nothing: u32,
    /// Largest F statistic, relative to its threshold.
    strongest: f64,
}

impl Tally {
    fn of(case: &Case, found: &Diagnosis) -> Self {
        let first = found.causes.first().filter(|cause| Some(cause.kind) == case.kind);
        let off = first.map_or(f64::INFINITY, |cause| (cause.value - case.size).abs());
        let if_first = |is: bool| u32::from(first.is_some() && is);
        Self {
            runs: 1,
            first: if_first(true),
            sized: if_first(off <= RIGHT * case.size.abs()),
            within: u32::from(first.is_some_and(|cause| off <= cause.u95)),
            corrected: within_intervals(case, found).map(if_first),
            other: u32::from(first.is_none() && !found.causes.is_empty()),
            nothing: u32::from(found.causes.is_empty()),
            strongest: found.causes.iter().map(|cause| cause.f / LIMIT).fold(found.greatest_left, f64::max),
        }
    }

    fn add(self, other: Self) -> Self {
        Self {
            runs: self.runs + other.runs,
            first: self.first + other.first,
            sized: self.sized + other.sized,
            within: self.within + other.within,
            corrected: from_fn(|i| self.corrected[i] + other.corrected[i]),
            other: self.other + other.other,
            nothing: self.nothing + other.nothing,
            strongest: self.strongest.max(other.strongest),
        }
    }

    /// Number of runs, and percentages: named first, named first with the right size, another cause first.
    fn line(&self) -> String {
        let parts = [self.first, self.sized, self.other];
        let [first, sized, other] = parts.map(|part| format!("{:.1}", percent(part, self.runs)));
        format!("{} | {first} | {sized} | {other}", self.runs)
    }
}

/// Which of inertance, viscous and Coulomb friction lie within their intervals, with the causes included.
fn within_intervals(case: &Case, found: &Diagnosis) -> [bool; 3] {
    let Some(corrected) = found.corrected else { return [false; 3] };
    let (found, truth) = (three(&corrected), truth(&case.device));
    from_fn(|i| {
        let (error, u95) = error(found[i].fitted(), truth[i]);
        error.abs() <= u95
    })
}

fn percent(part: u32, of: u32) -> f64 {
    100.0 * f64::from(part) / f64::from(of.max(1))
}

fn tally(case: &Case, motion: &Motion, seeds: RangeInclusive<u64>) -> Result<Tally> {
    let runs = each(seeds, |seed| Ok(Tally::of(case, &case.diagnosed(motion, seed)?)))?;
    Ok(runs.into_iter().fold(Tally::default(), Tally::add))
}

/// How well the motion reveals a fault, averaged over the seeds.
fn told(case: &Case, motion: &Motion) -> Result<Told> {
    let all = each(SEEDS, |seed| {
        let outcome = replayed(&case.recorded(motion, seed, true)?)?;
        case.told_by(motion, seed, f64::from(outcome.motion.repeats))
    })?;
    Ok(Told { left: mean(all.iter().map(|told| told.left)), sigmas: mean(all.iter().map(|told| told.sigmas)) })
}

/// Tallies of all faults, and of those that the motion reveals well enough. Writes a row for each fault and motion.
fn faults(text: &mut String) -> Result<[Tally; 2]> {
    let (mut all, mut told_enough) = (Tally::default(), Tally::default());
    for case in cases() {
        for motion in &MOTIONS {
            let of_these = tally(&case, motion, SEEDS)?;
            let told = told(&case, motion)?;
            let [left, sigmas] = [100.0 * told.left, told.sigmas].map(significant);
            let is_enough = if told.is_enough() { "yes" } else { "no" };
            let counts = [of_these.first, of_these.sized, of_these.other, of_these.nothing];
            let counts = counts.map(|count| count.to_string());
            *text += &sheet::row(&[case.name, motion.name, &left, &sigmas, is_enough], counts);
            all = all.add(of_these);
            if told.is_enough() {
                told_enough = told_enough.add(of_these);
            }
        }
        eprintln!("{}", case.name);
    }
    Ok([all, told_enough])
}

fn without_a_fault(seeds: &RangeInclusive<u64>) -> Result<Tally> {
    let mut clean = Tally::default();
    for case in clean_cases() {
        for motion in &MOTIONS {
            clean = clean.add(tally(&case, motion, seeds.clone())?);
        }
    }
    Ok(clean)
}

/// Number of runs whose flanks separate, and of those in which a wrong cause is named without being asked for.
fn with_flanks_that_part() -> Result<[usize; 2]> {
    let [mut runs, mut told] = [0; 2];
    for backlash_m in BACKLASHES_M {
        for motion in &MOTIONS {
            for with_stiffness in [true, false] {
                let causes = each(SEEDS, |seed| parting(backlash_m).told(motion, seed, with_stiffness))?;
                runs += causes.len();
                // The device has a structure mass, so naming that is not wrong.
                let is_wrong = |causes: &&Vec<Cause>| causes.iter().any(|cause| cause.kind != Kind::Structure);
                told += causes.iter().filter(is_wrong).count();
            }
        }
    }
    Ok([runs, told])
}

pub fn measure(_: Asked) -> Measured {
    let mut text = format!(
        "# Causes

`cargo xtask diagnose --update` writes this table. Each run breaks the law of the reference device
in one way, at 1 kHz with 1 N of noise, with seeds {} to {} of each motion. `inerter diagnose` gets
no information about the fault.

- *first*: runs in which its cause is named before any other. *sized*: those of them in which its
  size is also right to {:.0} %.
- *other*: runs in which another cause is named first. *none*: runs in which no cause is named.

The table also states how much of the fault the motion can show. This is computed from the plant's
true values, independently of any method (`tests/src/identified.rs`).

- *left*: the fraction of the mean square of the force added by the fault that the law's four
  regressors cannot explain, where the screw moves.
- *sigma*: the size of the fault in standard deviations of an estimate that knows everything else.
  The force's noise and the encoder's steps limit it. In a motion that repeats, the steps repeat
  too.
- *enough*: at least 0.5 % are left, and the size can be estimated to 10 % in 95 % of the runs
  (19.6 sigma).

| fault | motion | left % | sigma | enough | first | sized | other | none |
|---|---|--:|--:|---|--:|--:|--:|--:|
",
        SEEDS.start(),
        SEEDS.end(),
        100.0 * RIGHT
    );
    let [all, told_enough] = faults(&mut text)?;
    let [mt, cf, fc] = all.corrected.map(|held| percent(held, all.first));
    let (setting, clean) = (without_a_fault(&SETTING)?, without_a_fault(&SEEDS)?);
    let false_alarms = clean.other;
    let [parting_runs, parting_told] = with_flanks_that_part()?;
    text += &format!(
        "
| runs | number | named first % | and right size % | another first % |
|---|--:|--:|--:|--:|
| all | {} |
| where the motion shows enough | {} |

The goal is that in 85 % of the runs the cause is named first and its size is right. If any cause is
named, the first one is right in {:.0} % of the runs. In these runs its interval contains the size in
{:.0} %. The intervals of inertance, viscous and Coulomb friction, fitted with the causes included,
contain the true values in {mt:.0}, {cf:.0} and {fc:.0} %.

Of {} runs without a fault, {false_alarms} have a cause named. They have noise of 0.2 to 20 N, sample rates
of 1 to 4 kHz, counts of 0.5 to 20 um, a device of 95 kg, a preloaded one, and a rotary one of
2e-4 kg m2. The greatest F statistic is {:.2} of its threshold. With the seeds that set the
threshold, it is {:.2} (seeds {} to {}).

Of {parting_runs} runs whose flanks separate, with a backlash of 0.05 to 1 mm and the stiffness stated or not,
{parting_told} have a wrong cause named without being asked for (by `replay`, `report` and `monitor`).
",
        all.line(),
        told_enough.line(),
        percent(all.first, all.first + all.other),
        percent(all.within, all.first),
        clean.runs,
        clean.strongest,
        setting.strongest,
        SETTING.start(),
        SETTING.end(),
    );
    Ok((text, false_alarms == 0))
}
