//! What a run says of itself, and whether a value that is wrong is said to be doubtful.
//!
//! *Wrong*: a parameter of the whole run that is given (`ok`, `below_u95` or `held`) and whose interval does not hold the truth.
//!
//! *A word* about it is one that concerns this parameter. What concerns a parameter, by what `inerter replay` prints at the end:
//! - `law: broken`: all four, as it is this that widens or withholds each of them;
//! - a warning about the samples (`wrong_sign`, `clipped_force`, `count_slip`, `dead_force`): all four, where the defect is of the
//!   kind that the warning names; a warning of another name is none;
//! - a cause that is named unasked: the parameters that it moves (`reaches`), whatever the defect: a reader doubts these then;
//! - friction called `presliding` or `stribeck`: those that this moves;
//! - `moved_by`, with an interval by the samples that holds the truth, makes the value right in `replay`; where it does not hold it,
//!   the word counts where it names the defect;
//! - `assumes`: where it names the defect ([`Word::Assumed`], counted apart, as it is said of every run of such a motion).
//!
//! An error that the interval does not hold is expected in 5 % of clean values, too. So the clean runs are judged alike, and twice the
//! interval beside it, which chance does not reach.

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

/// What is said of a parameter that is wrong, from nothing to most.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Word {
    /// Nothing that concerns it.
    Silent,
    /// It rests on the absence of what is wrong, as in every run of this motion.
    Assumed,
    /// It is said to be doubtful.
    Told,
}

/// One parameter at the end of a run.
#[derive(Clone, Copy, Debug)]
pub struct Value {
    /// Distance of the value from the truth, in parts of the interval; none where no value is given.
    pub off: Option<f64>,
    /// What is said of it, were it wrong.
    pub word: Word,
}

/// The same as it is fitted, given or not.
#[derive(Clone, Copy, Debug)]
pub struct Fitted {
    /// Distance from the truth, in the parameter's unit.
    pub error: f64,
    /// Half width of the device's interval.
    pub u95: f64,
}

/// What is said of one run.
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
    /// Anything of the rest: warnings, causes, friction that is not Coulomb's.
    pub words: Vec<&'static str>,
    /// The plant that made it.
    pub from: From,
    /// Residual over what noise and steps explain, in parts of its limit; 0 where nothing is known of it.
    pub misfit: f64,
    /// The flanks are known to be closed, so that a misfit breaks the law.
    pub closed: bool,
}

/// A run is right, or wrong with or without a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// No value lies beyond its interval.
    Right,
    /// Some do, and there is a word about each.
    Told,
    /// Of some it is said only that they rest on what is not there.
    Assumed,
    /// Of at least one nothing is said.
    Silent,
}

/// Of three values, where one is wrong that lies so many intervals off.
pub fn verdict(values: &[Value; 3], intervals: f64) -> Verdict {
    let wrong = values.iter().filter(|value| value.off.is_some_and(|off| off > intervals));
    match wrong.map(|value| value.word).min() {
        None => Verdict::Right,
        Some(Word::Told) => Verdict::Told,
        Some(Word::Assumed) => Verdict::Assumed,
        Some(Word::Silent) => Verdict::Silent,
    }
}

/// Whether a cause moves mt, cf and fc: the theory's list (14) read by which regressor it is alike to.
fn reaches(cause: &str) -> [bool; 3] {
    match cause {
        // Friction in the end, and by its size a part of every force.
        "load_dependent" | "stribeck" => [false, true, true],
        "direction" | "drift" => [false, true, true],
        // A creeping screw is a spring, which is inertance.
        "presliding" => [true; 3],
        "skew" | "encoder_error" => [true, true, true],
        _ => [true; 3],
    }
}

/// Distance of a value from the truth; what is not a number is infinitely wrong.
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

/// Whether a defect does harm: it moves a parameter by more than twice the interval that the same run has without it.
pub fn is_harmful(said: &Said, clean: &Said) -> bool {
    said.fitted.iter().zip(&clean.fitted).any(|(said, clean)| said.error > 2.0 * clean.u95)
}

/// Runs a kind's defect, or nothing, through what `inerter replay` does.
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
