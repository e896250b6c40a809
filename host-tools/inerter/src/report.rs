//! Estimates for programs (JSON) and for people (text).
//!
//! The JSON is a public contract, written down in `docs/CLI.md`: one object a line, keys and units as below, never a NaN
//! or an infinity. What is not known is `null`.

use std::collections::BTreeMap;

use chrono::{DateTime, SecondsFormat};
use inerter_core::{Bank, Counters, Detail, Estimate, Interval, Parameter, Parameters, Settings, Status};
use inerter_wire::{EventKind, Health, ResetCause, catalogue};
use serde::Serialize;
use serde_json::Value;

use crate::{
    detail::{self, DetailJson, change_words, changed_field},
    replay::Outcome,
};

/// One parameter in JSON.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ParameterJson {
    /// Value in the unit of the key; `null` when not identifiable.
    pub value: Option<f32>,
    /// Half width of the 95 % interval; `null` when there is no finite one.
    pub u95: Option<f32>,
    /// `ok`, `held` or `not_identifiable`.
    pub status: &'static str,
}

impl From<Parameter> for ParameterJson {
    fn from(parameter: Parameter) -> Self {
        let value = parameter.value().filter(|value| value.is_finite());
        Self {
            value,
            u95: Some(parameter.u95()).filter(|u95| u95.is_finite()),
            status: status_word(value.map_or(Status::NotIdentifiable, |_| parameter.status())),
        }
    }
}

/// The four parameters in JSON.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[allow(missing_docs, reason = "documented where they are estimated")]
pub struct ParametersJson {
    pub inertance_kg: ParameterJson,
    pub viscous_n_s_per_m: ParameterJson,
    pub coulomb_n: ParameterJson,
    pub offset_n: ParameterJson,
}

impl From<&Parameters> for ParametersJson {
    fn from(parameters: &Parameters) -> Self {
        Self {
            inertance_kg: parameters.inertance_kg.into(),
            viscous_n_s_per_m: parameters.viscous_n_s_per_m.into(),
            coulomb_n: parameters.coulomb_n.into(),
            offset_n: parameters.offset_n.into(),
        }
    }
}

/// An estimate in JSON: `{"kind":"estimate", ...}`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[allow(missing_docs, reason = "documented in docs/CLI.md and where they are estimated")]
pub struct EstimateJson {
    pub kind: &'static str,
    #[serde(rename = "final", skip_serializing_if = "is_false")]
    pub is_final: bool,
    pub t_s: f64,
    pub whole_run: ParametersJson,
    #[serde(flatten)]
    pub recent: ParametersJson,
    pub moving: bool,
    pub bank: &'static str,
    pub residual_rms_n: Option<f32>,
    pub updates: u32,
    #[serde(flatten)]
    pub detail: Option<DetailJson>,
    #[serde(flatten)]
    pub counters: Option<CountersJson>,
}

/// Time from the first sample since the reset to the one of this estimate \[s\].
pub fn elapsed_s(estimate: &Estimate, rate_hz: f64) -> f64 {
    estimate.elapsed_samples.saturating_sub(1) as f64 / rate_hz
}

/// An event for a person.
pub fn event_words(kind: &EventKind) -> String {
    match kind {
        EventKind::Started => "the device has started".into(),
        EventKind::SourceEnded => "no more samples: the motion has ended".into(),
        EventKind::EstimatorReset => "the estimator begins anew".into(),
        EventKind::SettingsChanged => "the settings were changed".into(),
        EventKind::SourceChanged(source) => format!("samples now come from: {source:?}").to_lowercase(),
        EventKind::Fault(fault) => format!("fault: {fault}"),
        EventKind::Panicked(text) => format!("the firmware failed before this start: {text}; please report it"),
        EventKind::ResetBy(cause) => format!("the device was started by {cause}"),
        EventKind::Changed(change) => change_words(change),
    }
}

/// An event for a program: `started`, `fault.newer_settings`, `reset_by.watchdog`; only what follows `panicked` is left
/// to the words.
pub fn event_code(kind: &EventKind) -> String {
    match serde_json::to_value(kind) {
        Ok(Value::String(name)) => snake_case(&name),
        Ok(Value::Object(object)) => {
            let code = |(name, value): (&String, &Value)| match (kind, value) {
                (EventKind::Panicked(_), _) => snake_case(name),
                (_, Value::String(value)) => format!("{}.{}", snake_case(name), snake_case(value)),
                _ => snake_case(name),
            };
            object.iter().next().map(code).unwrap_or_default()
        }
        _ => String::new(),
    }
}

/// An event in JSON: `{"kind":"event", ...}`.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[allow(missing_docs, reason = "documented in docs/CLI.md")]
pub struct EventJson {
    pub kind: &'static str,
    pub t_s: Option<f64>,
    pub index: u32,
    pub code: String,
    pub event: String,
    #[serde(flatten)]
    pub change: Option<ChangeJson>,
}

/// What an event of a changed device has besides.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[allow(missing_docs, reason = "documented in docs/CLI.md")]
pub struct ChangeJson {
    pub parameter: &'static str,
    pub before: Option<f32>,
    pub after: Option<f32>,
}

impl EventJson {
    /// An event; `t_s` is its time, where that is known.
    pub fn new(t_s: Option<f64>, index: u32, kind: &EventKind) -> Self {
        let finite = |value: f32| Some(value).filter(|value| value.is_finite());
        let change = match kind {
            EventKind::Changed(change) => Some(ChangeJson {
                parameter: changed_field(change).path,
                before: finite(change.before),
                after: finite(change.after),
            }),
            _ => None,
        };
        let (code, event) = (event_code(kind), event_words(kind));
        Self { kind: "event", t_s: t_s.map(rounded_s), index, code, event, change }
    }
}

/// A time to the nanosecond: more digits would be noise of the arithmetic.
pub fn rounded_s(t_s: f64) -> f64 {
    (t_s * 1e9).round() / 1e9
}

fn snake_case(name: &str) -> String {
    let mut text = String::new();
    for letter in name.chars() {
        if letter.is_uppercase() && !text.is_empty() {
            text.push('_');
        }
        text.extend(letter.to_lowercase());
    }
    text
}

/// Whether an event tells of something wrong that somebody who records wants to know.
pub fn is_trouble(kind: &EventKind) -> bool {
    match kind {
        EventKind::Fault(_) | EventKind::Panicked(_) | EventKind::Changed(_) => true,
        EventKind::ResetBy(cause) => match cause {
            ResetCause::PowerOn | ResetCause::Pin | ResetCause::Software | ResetCause::OptionBytes => false,
            ResetCause::Watchdog
            | ResetCause::WindowWatchdog
            | ResetCause::LowPower
            | ResetCause::Panic
            | ResetCause::Unknown => true,
        },
        EventKind::Started
        | EventKind::SourceEnded
        | EventKind::EstimatorReset
        | EventKind::SettingsChanged
        | EventKind::SourceChanged(_) => false,
    }
}

/// Counts that the final estimate carries.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[allow(missing_docs, reason = "documented in core")]
pub struct CountersJson {
    pub samples: u64,
    pub gaps: u32,
    pub lost_samples: u64,
    pub saturated: u32,
}

fn is_false(value: &bool) -> bool {
    !value
}

impl EstimateJson {
    /// An estimate on the way, at time `t_s`; what goes with it is missing where an older firmware does not send it.
    pub fn live(t_s: f64, estimate: &Estimate, detail: Option<&Detail>, settings: &Settings) -> Self {
        Self {
            kind: "estimate",
            is_final: false,
            t_s: rounded_s(t_s),
            whole_run: (&estimate.whole_run).into(),
            recent: (&estimate.recent).into(),
            moving: estimate.moving,
            bank: bank_word(estimate.bank),
            residual_rms_n: Some(estimate.residual_rms_n).filter(|value| value.is_finite()),
            updates: estimate.updates,
            detail: detail.map(|detail| DetailJson::new(detail, settings)),
            counters: None,
        }
    }

    /// The last estimate of a run.
    pub fn last(
        t_s: f64,
        estimate: &Estimate,
        detail: Option<&Detail>,
        settings: &Settings,
        counters: Option<Counters>,
    ) -> Self {
        let counters = counters.map(|counters| CountersJson {
            samples: counters.samples,
            gaps: counters.discontinuities,
            lost_samples: counters.lost_samples,
            saturated: counters.saturated,
        });
        Self { is_final: true, counters, ..Self::live(t_s, estimate, detail, settings) }
    }
}

/// One line of JSON.
pub fn json_line(value: &impl Serialize) -> String {
    // Maps with text keys and plain numbers only: there is nothing that could fail.
    serde_json::to_string(value).unwrap_or_default()
}

/// The device's health in JSON, keys from the catalogue, `null` where the device does not know.
pub fn health_json(health: &Health) -> serde_json::Value {
    let mut object = serde_json::Map::from_iter([("kind".to_string(), "health".into())]);
    for (field, value) in catalogue::health(health) {
        let value = match value {
            Some(value) if value.fract() == 0.0 && value.abs() < 9e15 => (value as i64).into(),
            Some(value) => value.into(),
            None => serde_json::Value::Null,
        };
        object.insert(field.path.into(), value);
    }
    object.into()
}

/// `ok`, `held` or `not_identifiable`.
pub fn status_word(status: Status) -> &'static str {
    match status {
        Status::Ok => "ok",
        Status::Held => "held",
        Status::NotIdentifiable => "not_identifiable",
    }
}

/// `fast` or `slow`.
pub fn bank_word(bank: Bank) -> &'static str {
    match bank {
        Bank::Fast => "fast",
        Bank::Slow => "slow",
    }
}

/// Value and interval to the digits that the interval bears: `95.11 ± 0.48`.
pub fn value_text(parameter: &Parameter) -> String {
    let Some(Interval { value, u95 }) = parameter.known().filter(|known| known.value.is_finite()) else {
        return "not identifiable".into();
    };
    let held = if parameter.status() == Status::Held { " (held)" } else { "" };
    interval_text(value.into(), u95.into()) + held
}

/// A value with its interval, both with the digits that the interval bears.
pub fn interval_text(value: f64, u95: f64) -> String {
    if !(u95.is_finite() && u95 > 0.0) {
        return format!("{value:.4}");
    }
    format!("{} ± {}", rounded_text(value, u95), rounded_text(u95, u95))
}

/// A number with the digits that an interval bears, which is above 0: two of its own.
pub fn rounded_text(value: f64, u95: f64) -> String {
    let digits = (1.0 - u95.log10().floor()).min(9.0);
    let unit = 10f64.powf(-digits);
    let decimals = digits.max(0.0) as usize;
    // What is left of the point is rounded too.
    let value = if unit > 1.0 { (value / unit).round() * unit } else { value };
    format!("{value:.decimals$}")
}

/// A table of all parameters: recent memory, whole run, and, of a simulated device, the truth; below it a line on how the
/// device behaves.
pub fn table(
    estimate: &Estimate,
    detail: Option<&Detail>,
    settings: &Settings,
    truth: Option<&BTreeMap<String, String>>,
) -> String {
    let recent = catalogue::parameters(&estimate.recent);
    let whole = catalogue::parameters(&estimate.whole_run);
    let head = if truth.is_some() { "truth" } else { "" };
    let mut text =
        format!("{:<20} {:<6} {:<22} {:<22} {head}", "", "", format!("last {} s", settings.memory_s), "whole run");
    text.truncate(text.trim_end().len());
    for ((field, recent), (_, whole)) in recent.zip(whole) {
        // The plant knows the offset as the load cell's.
        let name = if field.path == "offset_n" { "force_offset_n" } else { field.path };
        let truth = truth.map(|truth| true_text(truth, name, 1.0)).unwrap_or_default();
        let (recent, whole) = (value_text(&recent), value_text(&whole));
        let line = format!("{:<20} {:<6} {recent:<22} {whole:<22} {truth}", field.label, field.unit);
        text += &format!("\n{}", line.trim_end());
    }
    let Some(detail) = detail else { return text };
    for (label, unit, value, name, factor) in detail::rows(detail, settings) {
        let truth = truth.map(|truth| true_text(truth, name, factor)).unwrap_or_default();
        let line = format!("{label:<20} {unit:<6} {:<22} {value:<22} {truth}", "");
        text += &format!("\n{}", line.trim_end());
    }
    format!("{text}\n\n{}", detail::line(detail))
}

/// What is true, `factor` bringing it to the unit shown; of a device that was changed on the way both values.
fn true_text(truth: &BTreeMap<String, String>, name: &str, factor: f64) -> String {
    let digits = |value: f64| format!("{:?}", (value * factor * 1e9).round() / 1e9);
    let number = |name: &str| truth.get(name)?.parse().ok().map(digits);
    match (number(name), number(&format!("changed_{name}"))) {
        (Some(first), Some(changed)) => format!("{first}, then {changed}"),
        (first, _) => first.unwrap_or_default(),
    }
}

/// One line on what the estimator took and left out.
pub fn counts_line(settings: &Settings, duration_s: f64, outcome: &Outcome) -> String {
    let counters = outcome.counters;
    let gaps = match (counters.discontinuities, counters.lost_samples) {
        (0, _) => "no gaps".to_string(),
        (gaps, lost) => format!("{} of {}", plural(gaps.into(), "gap"), plural(lost, "sample")),
    };
    let saturated = match counters.saturated {
        0 => "none saturated".to_string(),
        count => format!("{count} saturated"),
    };
    format!(
        "{} at {} Hz in {}, {gaps}, {saturated}; residual {:.2} N rms",
        plural(counters.samples, "sample"),
        settings.sample_rate_hz,
        duration_text(duration_s),
        outcome.estimate.residual_rms_n
    )
}

/// Heads the lines of [`row`].
pub fn row_header() -> String {
    let mut text = format!("{:>9}", "t [s]");
    for field in catalogue::fields(catalogue::Group::Parameter) {
        text += &format!("  {:<24}", format!("{} [{}]", field.label, field.unit));
    }
    text + "  Backlash [µm]"
}

/// One line per estimate: the recent memory, and the backlash so far.
pub fn row(t_s: f64, estimate: &Estimate, detail: Option<&Detail>) -> String {
    let mut text = format!("{t_s:>9.2}");
    for (_, parameter) in catalogue::parameters(&estimate.recent) {
        text += &format!("  {:<24}", value_text(&parameter));
    }
    text += &format!("  {:<22}", detail.map(|detail| detail::backlash_text(&detail.backlash)).unwrap_or_default());
    let rest = Some("at rest").filter(|_| !estimate.moving);
    let remarks: Vec<&str> = rest.into_iter().chain(detail.into_iter().flat_map(detail::remarks)).collect();
    text += &format!("  {}", remarks.join(", "));
    text.trim_end().into()
}

/// Number of things with the right ending.
pub fn plural(count: u64, thing: &str) -> String {
    format!("{count} {thing}{}", if count == 1 { "" } else { "s" })
}

/// `12.3 s`, `4 min 5 s`.
pub fn duration_text(seconds: f64) -> String {
    if seconds < 120.0 {
        format!("{seconds:.1} s")
    } else {
        format!("{:.0} min {:.0} s", (seconds / 60.0).floor(), seconds % 60.0)
    }
}

/// A host time \[ns since 1970\] for a person.
pub fn utc(time_ns: u64) -> String {
    let time = DateTime::from_timestamp_nanos(time_ns.min(i64::MAX as u64) as i64);
    time.to_rfc3339_opts(SecondsFormat::Millis, true)
}

#[cfg(test)]
#[path = "report_tests.rs"]
mod tests;
