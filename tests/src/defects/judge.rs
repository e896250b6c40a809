//! What a run reports, and whether a wrong value is said to be doubtful.
//!
//! *Wrong*: a parameter of the whole run that is given (`ok`, `below_u95` or `held`) and whose interval does not
//! contain the truth.
//!
//! *A word* about it: a statement that concerns this parameter. Of what `inerter replay` prints at the end, these
//! concern a parameter:
//! - `law: broken`: all four, as this widens or withholds each of them;
//! - a warning about the samples (`wrong_sign`, `clipped_force`, `count_slip`, `dead_force`): all four, if the defect
//!   is of the kind that the warning names; another warning does not count;
//! - a cause that is named unasked: the parameters that it moves (`reaches`), whatever the defect, as a reader then
//!   doubts these;
//! - friction called `presliding` or `stribeck`: those that this moves;
//! - `moved_by`: if its interval by the samples contains the truth, the value is right in `replay`; if not, the word
//!   counts if it names the defect;
//! - `assumes`: if it names the defect ([`Word::Assumed`], counted separately, as it is said of every run of such a
//!   motion).
//!
//! Of clean values, too, 5 % are expected to lie outside their interval. So clean runs are judged in the same way, and
//! beside the interval also twice the interval, which chance does not reach.

use super::{
    kinds::Kind,
    made::{From, Made, make},
    scene::Range,
};
use crate::grid::Error;
use inerter_analysis::diagnose::{Judged, Kind as Cause, Latest, judged, suspected};
use inerter_core::{LawStatus, Parameter, Regime, Status};
use inerter_data::{
    causes::Cause as Suspect,
    replay::{Outcome, replay_samples},
    settings::SettingsInputError,
};
use inerter_wire::EstimatorEvent;

/// What is said of a wrong parameter, from nothing to most.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Word {
    /// Nothing that concerns it.
    Silent,
    /// It rests on the absence of the fault, as in every run of this motion.
    Assumed,
    /// It is said to be doubtful.
    Told,
}

/// One parameter at the end of a run.
#[derive(Clone, Copy, Debug)]
pub struct Value {
    /// Distance of the value from the truth, relative to the interval; none if no value is given.
    pub off: Option<f64>,
    /// What is said of it, if it were wrong.
    pub word: Word,
}

/// The same as fitted, whether given or not.
#[derive(Clone, Copy, Debug)]
pub struct Fitted {
    /// Distance from the truth, in the parameter's unit.
    pub error: f64,
    /// Half width of the device's interval.
    pub u95: f64,
}

/// Results of one run.
#[derive(Clone, Debug)]
pub struct Said {
    /// By the device: its own intervals, law, warnings and friction.
    pub device: [Value; 3],
    /// By `inerter replay`, which has the samples as well.
    pub replay: [Value; 3],
    /// As they are fitted.
    pub fitted: [Fitted; 3],
    /// The law is called broken.
    pub broken: bool,
    /// All other words: warnings, causes, friction that is not Coulomb's.
    pub words: Vec<&'static str>,
    /// The plant that made it.
    pub from: From,
    /// Residual over what noise and steps explain, relative to its limit; 0 if it is not known.
    pub misfit: f64,
    /// The flanks are known to be closed, so a misfit breaks the law.
    pub closed: bool,
}

/// A run is right, or wrong with or without a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// No value is outside its interval.
    Right,
    /// Some are, and there is a word about each.
    Told,
    /// Some are only said to rest on the absence of the fault.
    Assumed,
    /// Nothing is said of at least one.
    Silent,
}

/// The verdict on three values; one that is off by more than so many intervals is wrong.
pub fn verdict(values: &[Value; 3], intervals: f64) -> Verdict {
    let wrong = values.iter().filter(|value| value.off.is_some_and(|off| off > intervals));
    match wrong.map(|value| value.word).min() {
        None => Verdict::Right,
        Some(Word::Told) => Verdict::Told,
        Some(Word::Assumed) => Verdict::Assumed,
        Some(Word::Silent) => Verdict::Silent,
    }
}

/// Whether a cause moves mt, cf and fc: from the theory's list (14), by the regressor that it resembles.
fn reaches(cause: &str) -> [bool; 3] {
    match cause {
        // Friction in the end, and because of its size a part of every force.
        "load_dependent" | "stribeck" => [false, true, true],
        "direction" | "drift" => [false, true, true],
        // A creeping screw is a spring, and so looks like inertance.
        "presliding" => [true; 3],
        "skew" | "encoder_error" => [true, true, true],
        _ => [true; 3],
    }
}

/// Distance of a value from the truth; NaN is infinitely wrong.
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

/// Whether a defect does harm: it moves a parameter by more than twice the interval of the same run without it.
pub fn is_harmful(said: &Said, clean: &Said) -> bool {
    said.fitted.iter().zip(&clean.fitted).any(|(said, clean)| said.error > 2.0 * clean.u95)
}

/// Runs a kind's defect, or none, through what `inerter replay` does.
pub fn run(kind: Option<&Kind>, motion: usize, seed: u64) -> Result<Said, Error> {
    let Made { run, truth, from } = make(kind, motion, seed)?;
    let mut latest = Latest::new(&run.settings);
    let mut warnings = Vec::new();
    let mut changed = false;
    let samples = run.samples.iter().copied().map(Ok::<_, SettingsInputError>);
    let mut since = 0;
    let outcome = replay_samples(&run.settings, run.start_s, samples, |_, event| {
        match event {
            EstimatorEvent::Warned(warning) => {
                warnings.push(Suspect::Samples(warning.kind).name());
                latest.warn(*warning);
            }
            EstimatorEvent::Changed(change) => {
                changed = true;
                since = run.samples.partition_point(|sample| sample.index <= change.index);
            }
            EstimatorEvent::Reversal(_) | EstimatorEvent::Estimate(_) => {}
        }
        Ok(())
    })?;
    run.samples.iter().skip(since).for_each(|sample| latest.push(*sample));
    let gated = latest.gated();
    let causes = suspected(&gated, &run.settings, &outcome.published());
    let judged = judged(&gated.series, &run.settings, &outcome);
    warnings.extend(gated.left_out.iter().map(|kind| Suspect::Samples(*kind).name()));
    warnings.sort_unstable();
    warnings.dedup();
    let causes: Vec<&'static str> = causes.iter().map(|cause| cause.kind.name()).collect();
    let said = said(kind, &outcome, &judged, &warnings, &causes, changed, &truth);
    Ok(Said { from, ..said })
}

fn said(
    kind: Option<&Kind>,
    outcome: &Outcome,
    judged: &[Judged; 4],
    warnings: &[&'static str],
    causes: &[&'static str],
    changed: bool,
    truth: &[Range; 3],
) -> Said {
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
    let device = std::array::from_fn(|i| Value {
        off: off(&parameters[i], f64::from(parameters[i].u95()), truth[i]),
        word: if by_device(i) { Word::Told } else { Word::Silent },
    });
    let replay = std::array::from_fn(|i| {
        let told =
            by_device(i) || causes.iter().any(|cause| reaches(cause)[i]) || judged[i].moved_by.is_some_and(is_named);
        let assumed = judged[i].assumes.iter().any(|cause| is_named(*cause));
        Value {
            off: off(&parameters[i], f64::from(judged[i].budget.u95()), truth[i]),
            word: match (told, assumed) {
                (true, _) => Word::Told,
                (false, true) => Word::Assumed,
                (false, false) => Word::Silent,
            },
        }
    });
    let fitted = std::array::from_fn(|i| Fitted {
        error: distance(&parameters[i], truth[i]),
        u95: f64::from(parameters[i].u95()),
    });
    let words = warnings.iter().chain(causes).copied().chain(regime).chain(changed.then_some("changed"));
    let misfit = outcome.law.misfit;
    Said {
        device,
        replay,
        fitted,
        broken,
        words: words.collect(),
        from: From::First,
        misfit: misfit.map_or(0.0, |misfit| f64::from(misfit.ratio / misfit.limit)),
        closed: !outcome.detail.contact.may_part(),
    }
}
