//! A whole run through the estimator, with additional results from its samples.

use std::cell::RefCell;

use inerter_core::{Machine, RawSample, Settings, WarningKind};
use inerter_data::{
    causes::{warning_name, warning_words},
    full_scale::Peaks,
    json::{EstimateJson, WarningJson, rounded_s},
    limits::{self, Verdict},
    names::parameter,
    replay::{Outcome, replay_samples},
    settings::SettingsInputError,
    uncertainty::{BudgetJson, UncertaintyJson},
};
use inerter_wire::EstimatorEvent;
use serde::Serialize;
use serde_json::{Map, Value, json};

use crate::{
    diagnose::{Cause, Judged, Kind, Latest, judged, suspected},
    fit::Products,
    plan::{Advice, Part, Reach, advice, duration_s},
    told::Told,
};

/// The results of a run.
#[derive(Clone, Debug)]
pub struct Replayed {
    settings: Settings,
    /// The result of the estimator alone, as the device would have reported it.
    pub outcome: Outcome,
    /// The parameters of the whole run, judged by the latest samples for a law that is only nearly true.
    pub judged: [Judged; 4],
    /// What violates the law in the latest samples.
    pub causes: Vec<Cause>,
    /// A motion that would have identified what this one could not.
    pub advice: Option<Advice>,
    warnings: Vec<WarningJson>,
    /// Faults of samples that the estimator had no time to detect.
    unseen: Vec<WarningKind>,
    /// A note if something exceeds the full-scale settings.
    beyond: Option<String>,
}

/// Runs samples through the estimator, the first of them at `start_s` \[s\]; `tell` gets everything that it reports,
/// with its time \[s\].
pub fn replayed<E: From<SettingsInputError>>(
    settings: &Settings,
    start_s: f64,
    samples: impl Iterator<Item = Result<RawSample, E>>,
    mut tell: impl FnMut(f64, &EstimatorEvent) -> Result<(), E>,
) -> Result<Replayed, E> {
    let (mut warnings, mut told) = (Vec::new(), Vec::new());
    let latest = RefCell::new(Latest::new(settings));
    let mut reach = Reach::new(settings);
    let samples = samples.inspect(|sample| {
        if let Ok(sample) = sample {
            latest.borrow_mut().push(*sample);
            reach.push(sample);
        }
    });
    let outcome = replay_samples(settings, start_s, samples, |t_s, event| {
        match event {
            EstimatorEvent::Changed(_) => latest.borrow_mut().forget(),
            EstimatorEvent::Warned(warning) => {
                latest.borrow_mut().warn(*warning);
                told.push(warning.kind);
            }
            EstimatorEvent::Reversal(_) | EstimatorEvent::Estimate(_) => {}
        }
        warnings.extend(warning(settings.machine, t_s, event));
        tell(t_s, event)
    })?;
    let gated = latest.into_inner().gated();
    Ok(Replayed {
        settings: *settings,
        causes: suspected(&gated, settings, &outcome.published()),
        judged: judged(&gated.series, settings, &outcome),
        advice: advice(&outcome, settings, &reach),
        beyond: Peaks::of(&gated.series).beyond(settings, &outcome.counters),
        unseen: gated.left_out.into_iter().filter(|kind| !told.contains(kind)).collect(),
        warnings,
        outcome,
    })
}

/// The fault of the samples, if the event reports one.
pub fn warning(machine: Machine, t_s: f64, event: &EstimatorEvent) -> Option<WarningJson> {
    match event {
        EstimatorEvent::Warned(warning) => Some(WarningJson::new(t_s, warning, machine)),
        _ => None,
    }
}

impl Replayed {
    /// Faults that only the last minute as a whole shows, each with its code.
    pub fn remarks(&self) -> impl Iterator<Item = (&'static str, String)> {
        let machine = self.settings.machine;
        let unseen = self.unseen.iter().map(move |kind| (warning_name(*kind), warning_words(machine, *kind)));
        let causes = self.causes.iter().map(move |cause| (cause.kind.name(), cause.sentence(machine)));
        unseen.chain(causes).chain(self.beyond.iter().map(|words| ("full_scale", words.clone())))
    }

    /// The parameters that the whole run identifies.
    pub fn told(&self) -> Told {
        Told::new(&self.outcome, &self.judged, self.wrong_samples() > 0)
    }

    /// How often samples were faulty: each time that the estimator reported it, plus each kind that only the last
    /// minute as a whole shows.
    pub fn wrong_samples(&self) -> usize {
        self.warnings.len() + self.unseen.len()
    }

    /// The last line of the run; `within` has its verdicts on limits, if there are any.
    pub fn json(&self, within: Option<&[limits::Judged]>) -> LastJson {
        let Outcome { t_s, counters, .. } = self.outcome;
        let remarks = self.remarks().map(|(code, text)| WarningJson { code, t_s: rounded_s(t_s), text });
        LastJson {
            last: EstimateJson::last(t_s, &self.outcome.estimated(), &self.settings, Some(counters)),
            uncertainty: Some(self.uncertainty()),
            warnings: self.warnings.iter().cloned().chain(remarks).collect(),
            advice: self.advice.as_ref().map(|advice| advice_json(advice, self.settings.machine)),
            limits: within.map(LimitsJson::new),
        }
    }

    /// The components of the whole run's intervals.
    fn uncertainty(&self) -> UncertaintyJson {
        let (sums, more) = self.outcome.sums();
        let correlation = Products::of(sums, more).and_then(|products| products.correlation()).ok();
        let budgets = self.judged.each_ref().map(|Judged { budget, moved_by, assumes }| {
            BudgetJson::new(budget, moved_by.map(Kind::name), assumes.iter().map(|kind| kind.name()).collect())
        });
        UncertaintyJson::new(budgets, &self.outcome.budgets.contact, correlation)
    }
}

/// The last line of a run.
#[derive(Clone, Debug, Serialize)]
pub struct LastJson {
    /// The last estimate.
    #[serde(flatten)]
    pub last: EstimateJson,
    /// The uncertainty of the whole run, if it was computed here.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uncertainty: Option<UncertaintyJson>,
    /// Faults of samples or violations of the law.
    pub warnings: Vec<WarningJson>,
    /// A motion that would have identified what this one could not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub advice: Option<Value>,
    /// Its verdicts on limits, if there are any.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limits: Option<LimitsJson>,
}

/// The verdicts of a run on limits.
#[derive(Clone, Debug, Serialize)]
pub struct LimitsJson {
    verdict: Verdict,
    parameters: Vec<limits::Judged>,
}

impl LimitsJson {
    /// From the verdicts on all limits.
    pub fn new(all: &[limits::Judged]) -> Self {
        Self { verdict: limits::verdict(all), parameters: all.to_vec() }
    }
}

/// Advice in JSON: names of the parameters that a run could not identify, of those that the motion would identify
/// clearly better, and the predicted intervals, as half widths.
fn advice_json(advice: &Advice, machine: Machine) -> Value {
    let names = |places: &[usize]| places.iter().map(|place| name(*place)).collect::<Vec<_>>();
    let sketch = advice.motion.as_ref();
    // Null if it is infinite.
    let u95 = |(place, u95): (usize, &f64)| (name(place).to_string(), json!({ "u95": u95 }));
    json!({
        "lacking": names(&advice.lacking),
        "told": names(&advice.told),
        "duration_s": sketch.map(|sketch| duration_s(&sketch.parts)),
        "parts": sketch.iter().flat_map(|sketch| &sketch.parts).map(Part::json).collect::<Vec<_>>(),
        "predicted": sketch.iter().flat_map(|sketch| sketch.u95.iter().enumerate()).map(u95).collect::<Map<_, _>>(),
        "text": advice.sentence(machine),
    })
}

/// Name of a parameter of the law.
fn name(place: usize) -> &'static str {
    parameter(Machine::Linear, place).path
}
