//! Finds what violates the law in a whole run, and the parameters with it included.

use std::cell::Cell;

use inerter_core::{LawStatus, Machine, Parameters, Warning, WarningKind};
use inerter_data::{
    causes::{WARNING_KINDS, warning_name, warning_words},
    gated::Gated,
    json::{LawJson, ParametersJson},
    replay::{Outcome, replay_all},
    run::Run,
    settings::SettingsInputError,
    words::plural,
};
use inerter_wire::EstimatorEvent;
use serde::Serialize;
use serde_json::{Value, json};

use crate::{
    calibrate::{CalibrateError, refuse_saturated},
    diagnose::{Cause, Diagnosis, Encoder, Kind, diagnose, is_reversed},
    fit::FitError,
};

/// The result for a run.
#[derive(Clone, Debug)]
pub struct Diagnosed {
    /// The result of the estimator alone.
    pub outcome: Outcome,
    /// Gates that samples failed, and how often, in the order of the list.
    pub gates: Vec<(WarningKind, u32)>,
    /// The samples without the wrong ones.
    pub gated: Gated,
    /// Causes, or why no search was possible.
    pub found: Result<Diagnosis, Unsought>,
    /// The parameters with everything found included, if known.
    pub corrected: Option<Parameters>,
}

/// Fraction of the work that the replay takes, and approximate fraction of the rest per pass over the run.
const OF_REPLAY: f64 = 0.15;
const OF_A_LOOK: f64 = 0.1;

/// Why no cause could be searched for, apart from faults of the samples.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Unsought {
    /// The force acts in the wrong direction.
    #[error("The search for other causes is skipped, and no parameter is given, because the force has the wrong sign.")]
    Reversed,
    /// Too little of the run is left.
    #[error("The remaining samples give no other cause and no parameter: {0}.")]
    Unfit(FitError),
}

/// Searches a whole run for what violates the law, or the part since the last change of the device: `changed` gets that
/// time \[s\] before the search. `told` gets the completed fraction, from 0 to 1.
pub fn diagnosed<E: From<SettingsInputError> + From<CalibrateError> + From<FitError>>(
    run: &Run,
    encoder: Encoder,
    changed: impl FnOnce(f64),
    told: impl Fn(f64),
) -> Result<Diagnosed, E> {
    let (mut warnings, mut since_s): (Vec<Warning>, _) = (Vec::new(), None);
    let length_s = run.duration_s().max(f64::MIN_POSITIVE);
    let outcome = replay_all(run, |t_s, event| -> Result<(), E> {
        match event {
            EstimatorEvent::Warned(warning) => warnings.push(*warning),
            EstimatorEvent::Changed(_) => since_s = Some(t_s),
            EstimatorEvent::Estimate(_) => told(OF_REPLAY * (t_s - run.start_s) / length_s),
            EstimatorEvent::Reversal(_) => {}
        }
        Ok(())
    })?;
    let mut gated = Gated::of(run, &warnings);
    let gates = gates(&warnings, &gated);
    if let Some(since_s) = since_s {
        changed(since_s);
        gated.series.cut_before(since_s);
    }
    let published = outcome.published();
    // The number of passes depends on what is found.
    let part = Cell::new(OF_REPLAY);
    let tick = || {
        part.set(part.get() + OF_A_LOOK * (1.0 - part.get()));
        told(part.get());
    };
    let found = match diagnose(&gated.series, &run.settings, &published, encoder, &tick) {
        _ if is_reversed(&published) => Err(Unsought::Reversed),
        Ok(found) => Ok(found),
        Err(error) if gates.is_empty() => {
            refuse_saturated(&outcome, run)?;
            return Err(error.into());
        }
        Err(error) => Err(Unsought::Unfit(error)),
    };
    let corrected = corrected(&outcome, &gated, &found);
    Ok(Diagnosed { outcome, gates, gated, found, corrected })
}

/// Faults of the samples, in the order of the list: those that the estimator reported, and those that only the whole
/// run shows.
fn gates(told: &[Warning], gated: &Gated) -> Vec<(WarningKind, u32)> {
    let times = |kind: WarningKind| {
        let told = told.iter().filter(|warning| warning.kind == kind).count() as u32;
        told.max(u32::from(gated.left_out.contains(&kind)))
    };
    WARNING_KINDS.into_iter().map(|kind| (kind, times(kind))).filter(|(_, times)| *times > 0).collect()
}

/// The parameters with everything found included. If nothing violates the law they are the law's own, without samples
/// that carry no information about the device; `None` if these are unknown, if another residual remains, or if the
/// force acts in the wrong direction.
fn corrected(outcome: &Outcome, gated: &Gated, found: &Result<Diagnosis, Unsought>) -> Option<Parameters> {
    let found = found.as_ref().ok().filter(|_| gated.not_found.is_empty())?;
    if !found.causes.is_empty() {
        return found.corrected;
    }
    if gated.has_no_force() {
        // The estimator uses samples until it detects a fault, and then also leaves out some good ones.
        return found.corrected.filter(|_| found.is_explained());
    }
    let misfit = outcome.law.misfit?;
    (misfit.ratio <= misfit.limit).then_some(outcome.estimate.whole_run)
}

impl Diagnosed {
    /// The causes, in descending order of importance.
    pub fn causes(&self) -> &[Cause] {
        self.found.as_ref().map_or(&[], |found| &found.causes)
    }

    /// For a person: whether the law holds, what violates it and what to do about it, one line each.
    pub fn words(&self, machine: Machine) -> Vec<String> {
        let causes = self.causes();
        let law = match self.outcome.law.status {
            LawStatus::Holds if !causes.is_empty() => {
                "The law holds as far as the estimator can tell. The samples show further effects, near the reversals or over the whole run:"
            }
            LawStatus::Holds => "The law holds: force noise and encoder steps explain the residual.",
            LawStatus::Broken => "The law is broken: the residual is more than force noise and encoder steps explain.",
            LawStatus::Unknown => {
                "Whether the law holds is unknown: there was too little motion, or the flanks may separate."
            }
        };
        let mut words = vec![law.to_string()];
        words.extend(self.gates.iter().map(|(kind, times)| {
            format!("- {}: {}", plural(u64::from(*times), "time"), warning_words(machine, *kind))
        }));
        words.extend(causes.iter().map(|cause| format!("- {}", cause.sentence(machine))));
        match &self.found {
            Err(unsought) => words.push(unsought.to_string()),
            Ok(_) if causes.is_empty() => {
                let more = if self.outcome.law.status == LawStatus::Broken { " known to this program" } else { "" };
                words.push(format!("No cause{more} explains more than noise and steps could."));
            }
            Ok(_) if self.corrected.is_none() && !self.gated.not_found.is_empty() => {
                words.push("No corrected parameters are given: which samples were bad is unknown.".to_string())
            }
            Ok(_) => {}
        }
        words
    }

    /// For a program.
    pub fn json(&self, machine: Machine) -> DiagnosisJson {
        let gates = self.gates.iter().map(gate_json);
        let causes = self.causes().iter().map(|cause| cause_json(machine, cause));
        DiagnosisJson {
            kind: "diagnosis",
            law: self.outcome.law.into(),
            causes: gates.chain(causes).collect(),
            corrected: self.corrected.as_ref().map(ParametersJson::from),
        }
    }
}

/// A diagnosis in JSON.
#[derive(Clone, Debug, Serialize)]
pub struct DiagnosisJson {
    kind: &'static str,
    law: LawJson,
    causes: Vec<Value>,
    corrected: Option<ParametersJson>,
}

/// A gate that samples failed in JSON, and how often.
fn gate_json((kind, times): &(WarningKind, u32)) -> Value {
    json!({
        "name": warning_name(*kind), "value": f64::from(*times), "u95": null, "unit": "times", "f": null,
        "period_m": null, "rival": null,
    })
}

/// A cause that was found in JSON, which has null for a half width that is infinite.
fn cause_json(machine: Machine, cause: &Cause) -> Value {
    json!({
        "name": cause.kind.name(), "value": cause.value, "u95": cause.u95, "unit": cause.unit(machine), "f": cause.f,
        "period_m": cause.period_m, "rival": cause.rival.map(Kind::name),
    })
}
