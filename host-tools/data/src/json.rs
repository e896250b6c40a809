//! Estimates, events and health as JSON, for programs.
//!
//! The JSON is a public contract, documented in `docs/CLI.md`: one object per line, keys and units as below, never a
//! NaN or an infinity. Unknown values are `null`.

use inerter_core::{
    Backlash, BacklashSize, Band, Counters, Detail, Interval, Law, Machine, Parameter, Parameters, Reversal, Settings,
    Status, Warning,
};
use inerter_wire::{
    Estimated, EventKind, Health,
    catalogue::{self, Field},
};
use serde::Serialize;
use serde_json::Value;

use crate::{
    causes::{warning_name, warning_words},
    names::Names,
    text::{changed_field, event_words, seen},
    words::{code, snake_case},
};

/// One parameter in JSON.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ParameterJson {
    /// Value in the unit of the key; `null` when not identifiable.
    pub value: Option<f32>,
    /// Half width of the 95 % interval; `null` if it is not finite.
    pub u95: Option<f32>,
    /// `ok`, `below_u95`, `held` or `not_identifiable`.
    pub status: &'static str,
}

impl From<Parameter> for ParameterJson {
    fn from(parameter: Parameter) -> Self {
        Self::of(&parameter, Shown::of_size(&parameter))
    }
}

impl ParameterJson {
    /// For an offset, where zero is as good a result as any.
    pub fn offset(parameter: Parameter) -> Self {
        Self::of(&parameter, Shown::of_offset(&parameter))
    }

    fn of(parameter: &Parameter, shown: Shown) -> Self {
        Self { value: parameter.value().and_then(finite), u95: finite(parameter.u95()), status: shown.word() }
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
            offset_n: ParameterJson::offset(parameters.offset_n),
        }
    }
}

/// An estimate in JSON: `{"kind":"estimate", ...}`.
#[derive(Clone, Debug, PartialEq, Serialize)]
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
    pub bank: String,
    pub residual_rms_n: Option<f32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub law: Option<LawJson>,
    pub updates: u32,
    #[serde(flatten)]
    pub detail: Option<DetailJson>,
    #[serde(flatten)]
    pub counters: Option<Counters>,
}

fn is_false(value: &bool) -> bool {
    !value
}

/// The number, if JSON can represent it.
pub(crate) fn finite(value: f32) -> Option<f32> {
    Some(value).filter(|value| value.is_finite())
}

impl EstimateJson {
    /// An estimate during the run, at time `t_s`; its detail is missing if an older firmware does not send it.
    pub fn live(t_s: f64, estimated: &Estimated, settings: &Settings) -> Self {
        let Estimated { estimate, law, detail } = estimated;
        Self {
            kind: "estimate",
            is_final: false,
            t_s: rounded_s(t_s),
            whole_run: (&estimate.whole_run).into(),
            recent: (&estimate.recent).into(),
            moving: estimate.moving,
            bank: code(&estimate.bank),
            residual_rms_n: finite(estimate.residual_rms_n),
            law: law.map(LawJson::from),
            updates: estimate.updates,
            detail: detail.as_ref().map(|detail| DetailJson::new(detail, settings)),
            counters: None,
        }
    }

    /// The last estimate of a run.
    pub fn last(t_s: f64, estimated: &Estimated, settings: &Settings, counters: Option<Counters>) -> Self {
        Self { is_final: true, counters, ..Self::live(t_s, estimated, settings) }
    }
}

/// Whether the law holds, in JSON.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[allow(missing_docs, reason = "documented in docs/CLI.md and in core")]
pub struct LawJson {
    pub status: String,
    pub ratio: Option<f32>,
    pub limit: Option<f32>,
}

impl From<Law> for LawJson {
    fn from(law: Law) -> Self {
        let (ratio, limit) = law.misfit.map(|misfit| (misfit.ratio, misfit.limit)).unzip();
        Self { status: code(&law.status), ratio, limit }
    }
}

/// A backlash in JSON.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[allow(missing_docs, reason = "documented in docs/CLI.md and where they are estimated")]
pub struct BacklashJson {
    pub value: Option<f32>,
    pub u95: Option<f32>,
    pub status: &'static str,
    pub reason: Option<String>,
    pub reversals: u32,
    pub route: String,
}

impl From<Backlash> for BacklashJson {
    fn from(backlash: Backlash) -> Self {
        let known = backlash.known().filter(|known| known.value.is_finite());
        let (status, reason) = match backlash.size {
            BacklashSize::NotIdentifiable(reason) => ("not_identifiable", Some(code(&reason))),
            _ if known.is_none() => ("not_identifiable", None),
            BacklashSize::Ok(_) => ("ok", None),
            BacklashSize::BelowU95(_) => ("below_u95", None),
        };
        Self {
            value: known.map(|known| known.value),
            u95: known.and_then(|known| finite(known.u95)),
            status,
            reason,
            reversals: backlash.reversals,
            route: code(&backlash.route),
        }
    }
}

/// How friction behaves, in JSON.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[allow(missing_docs, reason = "documented in docs/CLI.md and where they are estimated")]
pub struct FrictionJson {
    pub reversal_ratio: Option<f32>,
    pub regime: String,
}

/// The detail of an estimate, in JSON.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[allow(missing_docs, reason = "documented in docs/CLI.md and where they are estimated")]
pub struct DetailJson {
    pub backlash_m: BacklashJson,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stiffness_n_per_m: Option<ParameterJson>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub contact_damping_n_s_per_m: Option<ParameterJson>,
    pub band_hz: Option<[f32; 2]>,
    pub contact: String,
    pub friction: FrictionJson,
    pub changes: u32,
}

impl DetailJson {
    /// Stiffness and damping are present if the settings include a terminal displacement sensor.
    pub fn new(detail: &Detail, settings: &Settings) -> Self {
        let measured = |parameter| Some(parameter).filter(|_| settings.terminal_sensor).map(ParameterJson::from);
        let Detail { band, backlash, contact, stiffness_n_per_m, contact_damping_n_s_per_m, friction, .. } = *detail;
        Self {
            backlash_m: backlash.into(),
            stiffness_n_per_m: measured(stiffness_n_per_m),
            contact_damping_n_s_per_m: measured(contact_damping_n_s_per_m),
            band_hz: seen(band).map(|Band { low_hz, high_hz }| [low_hz, high_hz]),
            contact: code(&contact),
            friction: FrictionJson {
                reversal_ratio: friction.reversal_ratio.and_then(finite),
                regime: code(&friction.regime),
            },
            changes: detail.changes,
        }
    }
}

/// A reversal in JSON: `{"kind":"reversal", ...}`.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[allow(missing_docs, reason = "documented in docs/CLI.md and in core")]
pub struct ReversalJson {
    pub kind: &'static str,
    pub t_s: Option<f64>,
    pub index: u32,
    pub value_m: Option<f32>,
    pub error_m: Option<f32>,
    pub route: String,
    pub rising: bool,
}

impl ReversalJson {
    /// A reversal; `t_s` is the time at the middle of its flight, if known.
    pub fn new(t_s: Option<f64>, reversal: &Reversal) -> Self {
        Self {
            kind: "reversal",
            t_s: t_s.map(rounded_s),
            index: reversal.index,
            value_m: finite(reversal.value_m),
            error_m: finite(reversal.error_m),
            route: code(&reversal.route),
            rising: reversal.rising,
        }
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

/// Additional keys of an event about a changed device.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[allow(missing_docs, reason = "documented in docs/CLI.md")]
pub struct ChangeJson {
    pub parameter: &'static str,
    pub before: Option<f32>,
    pub after: Option<f32>,
}

impl EventJson {
    /// A cause that this program found in the samples up to `index`, by its name and in words.
    pub fn cause(t_s: f64, index: u32, name: &str, words: String) -> Self {
        let (t_s, code) = (Some(rounded_s(t_s)), format!("cause.{name}"));
        Self { kind: "event", t_s, index, code, event: words, change: None }
    }

    /// An event; `t_s` is its time, if known.
    pub fn new(t_s: Option<f64>, index: u32, kind: &EventKind, machine: Machine) -> Self {
        let change = match kind {
            EventKind::Changed(change) => Some(ChangeJson {
                parameter: changed_field(machine, change).path,
                before: finite(change.before),
                after: finite(change.after),
            }),
            _ => None,
        };
        let (code, event) = (event_code(kind), event_words(machine, kind));
        Self { kind: "event", t_s: t_s.map(rounded_s), index, code, event, change }
    }
}

/// A warning of a run in JSON, an entry of `warnings`.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[allow(missing_docs, reason = "documented in docs/CLI.md")]
pub struct WarningJson {
    pub code: &'static str,
    pub t_s: f64,
    pub text: String,
}

impl WarningJson {
    /// A warning at this time of the run \[s\].
    pub fn new(t_s: f64, warning: &Warning, machine: Machine) -> Self {
        Self { code: warning_name(warning.kind), t_s: rounded_s(t_s), text: warning_words(machine, warning.kind) }
    }
}

/// An event's code for programs: `started`, `fault.newer_settings`, `reset_by.watchdog`; the text after `panicked` is
/// only in the words.
pub fn event_code(kind: &EventKind) -> String {
    if let EventKind::Warned(warning) = kind {
        return format!("warned.{}", warning_name(warning.kind));
    }
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

/// A time rounded to the nanosecond: more digits would be arithmetic noise.
pub fn rounded_s(t_s: f64) -> f64 {
    (t_s * 1e9).round() / 1e9
}

/// One line of JSON with the key names of this machine.
pub fn machine_json_line(machine: Machine, value: &impl Serialize) -> String {
    String::from_utf8(machine_json(machine, value)).unwrap_or_default()
}

/// JSON with the key names of this machine.
pub fn machine_json(machine: Machine, value: &impl Serialize) -> Vec<u8> {
    let mut out = Vec::new();
    // Only maps with text keys and plain numbers: serialisation cannot fail.
    value.serialize(&mut serde_json::Serializer::with_formatter(&mut out, Names::new(machine))).unwrap_or_default();
    out
}

/// One line of JSON.
pub fn json_line(value: &impl Serialize) -> String {
    // Only maps with text keys and plain numbers: serialisation cannot fail.
    serde_json::to_string(value).unwrap_or_default()
}

/// The device's health in JSON, with the catalogue's keys; `null` for values the device does not know.
pub fn health_json(health: &Health) -> Value {
    let mut object = serde_json::Map::from_iter([("kind".to_string(), "health".into())]);
    for (field, value) in catalogue::health(health) {
        let value = match value {
            Some(value) if value.fract() == 0.0 && value.abs() < 9e15 => (value as i64).into(),
            Some(value) => value.into(),
            None => Value::Null,
        };
        object.insert(field.path.into(), value);
    }
    object.into()
}

/// A parameter's status as displayed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shown {
    /// Value and interval are valid.
    Ok,
    /// The same, but the value is smaller than its interval: it may be zero.
    BelowU95,
    /// The device is at rest, and the last value is held.
    Held,
    /// There is no value.
    NotIdentifiable,
}

impl Shown {
    /// The status of a parameter of the catalogue.
    pub fn of(field: &Field, parameter: &Parameter) -> Self {
        if field.path.starts_with("offset_") { Self::of_offset(parameter) } else { Self::of_size(parameter) }
    }

    /// The status of a magnitude: a value within its interval of zero is `BelowU95`.
    pub fn of_size(parameter: &Parameter) -> Self {
        match (Self::of_offset(parameter), parameter.fitted()) {
            (Self::Ok, Interval { value, u95 }) if value.abs() <= u95 => Self::BelowU95,
            (shown, _) => shown,
        }
    }

    /// The status of an offset, which may be zero. A device may report `Ok` for a value that is not a number.
    pub fn of_offset(parameter: &Parameter) -> Self {
        match (parameter.value(), parameter.status()) {
            (Some(value), Status::Ok) if value.is_finite() => Self::Ok,
            (Some(value), Status::Held) if value.is_finite() => Self::Held,
            _ => Self::NotIdentifiable,
        }
    }

    /// `ok`, `below_u95`, `held` or `not_identifiable`.
    pub fn word(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::BelowU95 => "below_u95",
            Self::Held => "held",
            Self::NotIdentifiable => "not_identifiable",
        }
    }
}

#[cfg(test)]
#[path = "json_tests.rs"]
mod tests;
