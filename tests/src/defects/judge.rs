//! The reports of a run, and whether a wrong value is reported as doubtful.
//!
//! *Wrong*: a whole-run parameter that is given (`ok`, `below_u95` or `held`) and whose interval does not contain the
//! true value.
//!
//! *A word* about it: a statement that concerns this parameter. Of the output of `inerter replay`, these statements
//! concern a parameter:
//! - `law: broken`: all four, because it widens or withholds each of them;
//! - a warning about the samples (`wrong_sign`, `clipped_force`, `count_slip`, `dead_force`): all four, if the defect
//!   is of the kind that the warning names; another warning does not count;
//! - a cause reported without being asked for: the parameters that it moves (`reaches`), whatever the defect, because a
//!   reader then doubts these;
//! - friction reported as `presliding` or `stribeck`: the parameters that this regime moves;
//! - `moved_by`: if the interval with its share contains the true value, the value is right in `replay`; otherwise the
//!   word counts if it names the defect;
//! - `assumes`: if it names the defect ([`Verdict::Assumed`], counted separately, because every run of such a motion
//!   reports it).
//!
//! Even in clean runs, 5 % of the values are expected to lie outside their interval. Clean runs are therefore judged in
//! the same way, and both are also judged at twice the interval, which chance does not reach.

use super::{kinds::Kind, made::make, scene::Range};
use crate::grid::Error;
use inerter_analysis::diagnose::{Judged, Kind as Cause, Latest, judged, suspected};
use inerter_core::{LawStatus, Parameter, Regime, Status};
use inerter_data::{causes::warning_name, replay::replay_samples, settings::SettingsInputError};
use inerter_wire::EstimatorEvent;

/// One parameter at the end of a run.
#[derive(Clone, Copy, Debug)]
pub struct Value {
    /// Distance of the value from the true value, relative to the interval; `None` if no value is given.
    pub off: Option<f64>,
    /// The verdict on it in case it is wrong.
    pub word: Verdict,
}

/// The fitted value of a parameter, whether given or not.
#[derive(Clone, Copy, Debug)]
pub struct Fitted {
    /// Distance from the true value, in the parameter's unit.
    pub error: f64,
    /// Half width of the device's interval.
    pub u95: f64,
}

/// Results of one run.
#[derive(Clone, Debug)]
pub struct Said {
    /// From the device: its intervals, law and friction, and the warnings. A fault of the samples that only `replay`
    /// finds counts as a warning here too.
    pub device: [Value; 3],
    /// From `inerter replay`, which also has the samples.
    pub replay: [Value; 3],
    /// The fitted values.
    pub fitted: [Fitted; 3],
    /// Whether the law is reported as broken.
    pub broken: bool,
    /// All other words: warnings, causes, and a friction regime other than Coulomb.
    pub words: Vec<&'static str>,
    /// Whether the second plant made it.
    pub by_second: bool,
    /// Residual over what noise and steps explain, relative to its limit; 0 if unknown.
    pub misfit: f64,
    /// The flanks are known to stay closed, so a misfit breaks the law.
    pub closed: bool,
}

/// Verdict on a run or a value: right, or wrong with or without a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// No value lies outside its interval.
    Right,
    /// Some values do, and the report calls each of them doubtful.
    Told,
    /// At least one is mentioned only as an assumption, as in every run of this motion.
    Assumed,
    /// The report says nothing about at least one.
    Silent,
}

/// The verdict on three values. A value is wrong if it is off by more than `intervals` intervals.
pub fn verdict(values: &[Value; 3], intervals: f64) -> Verdict {
    let wrong = values.iter().filter(|value| value.off.is_some_and(|off| off > intervals));
    wrong.map(|value| value.word).max().unwrap_or(Verdict::Right)
}

/// Which of mt, cf and fc a cause moves: from the list in the theory (14), by the regressor that it resembles.
fn reaches(cause: &str) -> [bool; 3] {
    // These act like friction. Presliding does not: a creeping screw is a spring, which resembles inertance.
    let is_friction = ["load_dependent", "stribeck", "direction", "drift"].contains(&cause);
    [!is_friction, true, true]
}

/// Distance of a value from the true range; infinite for NaN.
fn distance(parameter: &Parameter, (low, high): Range) -> f64 {
    let value = f64::from(parameter.fitted().value);
    if value.is_nan() { f64::INFINITY } else { (low - value).max(value - high).max(0.0) }
}

fn off(parameter: &Parameter, u95: f64, truth: Range) -> Option<f64> {
    if parameter.status() == Status::NotIdentifiable {
        return None;
    }
    let distance = distance(parameter, truth);
    Some(if distance == 0.0 { 0.0 } else { distance / u95 })
}

/// Whether a defect does harm: with it, a fitted value is off the true value by more than twice the interval of the
/// clean run.
pub fn is_harmful(said: &Said, clean: &Said) -> bool {
    said.fitted.iter().zip(&clean.fitted).any(|(said, clean)| said.error > 2.0 * clean.u95)
}

/// Runs a kind of defect, or a clean run, through the steps of `inerter replay`.
pub fn run(kind: Option<&Kind>, motion: usize, seed: u64) -> Result<Said, Error> {
    let (scene, all) = make(kind, motion, seed)?;
    let (settings, truth) = (&scene.settings, &scene.truth);
    let mut latest = Latest::new(settings);
    let mut warnings = Vec::new();
    let mut changed = false;
    let samples = all.iter().copied().map(Ok::<_, SettingsInputError>);
    let mut since = 0;
    let outcome = replay_samples(settings, 0.0, samples, |_, event| {
        match event {
            EstimatorEvent::Warned(warning) => {
                warnings.push(warning_name(warning.kind));
                latest.warn(*warning);
            }
            EstimatorEvent::Changed(change) => {
                changed = true;
                since = all.partition_point(|sample| sample.index <= change.index);
            }
            EstimatorEvent::Reversal(_) | EstimatorEvent::Estimate(_) => {}
        }
        Ok(())
    })?;
    all.iter().skip(since).for_each(|sample| latest.push(*sample));
    let gated = latest.gated();
    let causes = suspected(&gated, settings, &outcome.published());
    let causes: Vec<&'static str> = causes.iter().map(|cause| cause.kind.name()).collect();
    let judged = judged(&gated.series, settings, &outcome);
    warnings.extend(gated.left_out.iter().map(|kind| warning_name(*kind)));
    warnings.sort_unstable();
    warnings.dedup();
    let names = kind.map_or(&[][..], |kind| kind.names);
    let broken = outcome.law.status == LawStatus::Broken;
    let regime = match outcome.detail.friction.regime {
        Regime::Presliding => Some("presliding"),
        Regime::Stribeck => Some("stribeck"),
        Regime::Unknown | Regime::Coulomb => None,
    };
    let warned = warnings.iter().any(|warning| names.contains(warning));
    let by_device = |i: usize| broken || warned || regime.is_some_and(|regime| reaches(regime)[i]);
    let is_named = |cause: Cause| names.contains(&cause.name());
    let parameters = crate::grid::three(&outcome.estimate.whole_run);
    let value = |i: usize, u95: f32, word| Value { off: off(&parameters[i], f64::from(u95), truth[i]), word };
    let device = std::array::from_fn(|i| {
        value(i, parameters[i].u95(), if by_device(i) { Verdict::Told } else { Verdict::Silent })
    });
    let replay = std::array::from_fn(|i| {
        let Judged { budget, moved_by, assumes } = &judged[i];
        let told = by_device(i) || causes.iter().any(|cause| reaches(cause)[i]) || moved_by.is_some_and(is_named);
        let word = if told {
            Verdict::Told
        } else if assumes.iter().any(|cause| is_named(*cause)) {
            Verdict::Assumed
        } else {
            Verdict::Silent
        };
        value(i, budget.u95(), word)
    });
    let fitted = std::array::from_fn(|i| Fitted {
        error: distance(&parameters[i], truth[i]),
        u95: f64::from(parameters[i].u95()),
    });
    let words = warnings.into_iter().chain(causes).chain(regime).chain(changed.then_some("changed"));
    let misfit = outcome.law.misfit;
    Ok(Said {
        device,
        replay,
        fitted,
        broken,
        words: words.collect(),
        by_second: scene.by_second,
        misfit: misfit.map_or(0.0, |misfit| f64::from(misfit.ratio / misfit.limit)),
        closed: !outcome.detail.contact.may_part(),
    })
}
