//! Suggests a motion that would have identified what a run could not.

use inerter_core::{Interval, Machine, Parameter, Settings};
use inerter_data::{
    names::parameter,
    replay::Outcome,
    words::{duration_text, listed},
};

use crate::{
    diagnose::{is_reversed, is_suspect},
    fit::each,
};

use super::{
    design::{Sketch, sketch},
    observed::{Reach, observed},
    words::{interval_of, limits_text, part_text},
};

/// Another motion must reduce a run's interval to this fraction to be suggested.
const WORTH_IT: f64 = 0.7;

/// What a run could not identify, and a motion that would have.
#[derive(Clone, Debug)]
pub struct Advice {
    /// Indices in `[mt, cf, fc]` of parameters that were not identifiable or smaller than their interval.
    pub lacking: Vec<usize>,
    /// The motion, within the limits that the run itself kept to; `None` if the run says too little about the device.
    pub motion: Option<Sketch>,
    /// Those of the lacking parameters that it would identify clearly better.
    pub told: Vec<usize>,
}

/// Advice for what a run could not identify; `None` if it identified everything, or if more than chance violates the
/// law: a plan assumes the law, so no motion would help.
pub fn advice(outcome: &Outcome, settings: &Settings, reach: &Reach) -> Option<Advice> {
    let found = each(&outcome.estimate.whole_run);
    let lacks = |parameter: &Parameter| parameter.known().is_none_or(|Interval { value, u95 }| value.abs() < u95);
    let lacking: Vec<usize> = (0..3).filter(|place| lacks(&found[*place])).collect();
    let is_lawful = !is_suspect(&outcome.law) && !is_reversed(&outcome.published());
    if lacking.is_empty() || !is_lawful {
        return None;
    }
    let motion = observed(outcome, settings, reach).and_then(|(expected, limits)| sketch(&expected, limits)).ok();
    let is_told = |place: &usize| {
        let before = f64::from(found[*place].u95());
        motion.as_ref().is_some_and(|sketch| sketch.u95[*place] < WORTH_IT * before)
    };
    let told = lacking.iter().copied().filter(is_told).collect();
    Some(Advice { lacking, motion, told })
}

impl Advice {
    /// One or two sentences for a person.
    pub fn sentence(&self, machine: Machine) -> String {
        let symbols: Vec<String> =
            self.lacking.iter().map(|place| parameter(machine, *place).symbol.to_string()).collect();
        let beginning = format!("This motion cannot identify {}.", listed(&symbols));
        let Some(sketch) = &self.motion else {
            return format!(
                "{beginning} It does not describe the device well enough to plan another from it: state what you expect (`inerter plan --help`)"
            );
        };
        let reach = limits_text(machine, &sketch.limits);
        let time = duration_text(sketch.limits.duration_s);
        let of = |places: &[usize]| {
            let each = places.iter().map(|place| {
                let u95 = sketch.u95[*place];
                if u95.is_finite() {
                    interval_of(machine, *place, u95)
                } else {
                    format!("{} not at all", parameter(machine, *place).symbol)
                }
            });
            listed(&each.collect::<Vec<_>>())
        };
        if self.told.is_empty() {
            return format!(
                "{beginning} No motion within the same {reach} can in {time}; the best found gives {}. Allow a longer stroke, a higher \
                 speed, a larger force or more time: `inerter plan`",
                of(&self.lacking)
            );
        }
        let parts: Vec<String> = sketch
            .parts
            .iter()
            .map(|part| format!("{} of {}", duration_text(part.duration_s), part_text(machine, part)))
            .collect();
        format!(
            "{beginning} Within the same {reach}, this motion of {time} would give {}: {}. `inerter plan` with this file designs and writes such a motion",
            of(&self.told),
            parts.join(", then ")
        )
    }
}
