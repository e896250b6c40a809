//! What goes with an estimate (backlash, contact, friction, band, changes) for programs and for people.

use inerter_core::{
    Backlash, BacklashSize, Band, Change, Changed, Contact, Detail, Interval, Reason, Regime, Reversal, Route, Settings,
};
use inerter_wire::catalogue::{self, Field, Group};
use serde::Serialize;

use crate::report::{ParameterJson, interval_text, plural, rounded_s, value_text};

/// A backlash in JSON.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[allow(missing_docs, reason = "documented in docs/CLI.md and where they are estimated")]
pub struct BacklashJson {
    pub value: Option<f32>,
    pub u95: Option<f32>,
    pub status: &'static str,
    pub reason: Option<&'static str>,
    pub reversals: u32,
    pub route: &'static str,
}

impl From<Backlash> for BacklashJson {
    fn from(backlash: Backlash) -> Self {
        let (status, reason) = match backlash.size {
            BacklashSize::Ok(_) => ("ok", None),
            BacklashSize::BelowU95(_) => ("below_u95", None),
            BacklashSize::NotIdentifiable(reason) => ("not_identifiable", Some(reason_code(reason))),
        };
        let known = backlash.known();
        Self {
            value: known.map(|known| known.value).filter(|value| value.is_finite()),
            u95: known.map(|known| known.u95).filter(|u95| u95.is_finite()),
            status,
            reason,
            reversals: backlash.reversals,
            route: route_code(backlash.route),
        }
    }
}

/// How friction behaves, in JSON.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[allow(missing_docs, reason = "documented in docs/CLI.md and where they are estimated")]
pub struct FrictionJson {
    pub reversal_ratio: Option<f32>,
    pub conduct: &'static str,
}

/// What goes with an estimate, in JSON.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[allow(missing_docs, reason = "documented in docs/CLI.md and where they are estimated")]
pub struct DetailJson {
    pub backlash_m: BacklashJson,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stiffness_n_per_m: Option<ParameterJson>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub contact_damping_n_s_per_m: Option<ParameterJson>,
    pub band_hz: Option<[f32; 2]>,
    pub contact: &'static str,
    pub friction: FrictionJson,
    pub changes: u32,
}

impl DetailJson {
    /// Stiffness and damping are there when the settings know of a terminal displacement sensor.
    pub fn new(detail: &Detail, settings: &Settings) -> Self {
        let measured = |parameter| Some(parameter).filter(|_| settings.terminal_sensor).map(ParameterJson::from);
        let Detail { band, backlash, contact, stiffness_n_per_m, contact_damping_n_s_per_m, friction, .. } = *detail;
        Self {
            backlash_m: backlash.into(),
            stiffness_n_per_m: measured(stiffness_n_per_m),
            contact_damping_n_s_per_m: measured(contact_damping_n_s_per_m),
            band_hz: seen(band).map(|Band { low_hz, high_hz }| [low_hz, high_hz]),
            contact: contact_code(contact),
            friction: FrictionJson {
                reversal_ratio: friction.reversal_ratio.filter(|ratio| ratio.is_finite()),
                conduct: regime_code(friction.regime),
            },
            changes: detail.changes,
        }
    }
}

/// A reversal in JSON: `{"kind":"gap", ...}`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[allow(missing_docs, reason = "documented in docs/CLI.md and in core")]
pub struct ReversalJson {
    pub kind: &'static str,
    pub t_s: Option<f64>,
    pub index: u32,
    pub value_m: Option<f32>,
    pub error_m: Option<f32>,
    pub route: &'static str,
    pub rising: bool,
}

impl ReversalJson {
    /// A reversal; `t_s` is the time of the middle of its flight, where that is known.
    pub fn new(t_s: Option<f64>, reversal: &Reversal) -> Self {
        Self {
            kind: "gap",
            t_s: t_s.map(rounded_s),
            index: reversal.index,
            value_m: Some(reversal.value_m).filter(|value| value.is_finite()),
            error_m: Some(reversal.error_m).filter(|error| error.is_finite()),
            route: route_code(reversal.route),
            rising: reversal.rising,
        }
    }
}

/// The field of the parameter that changed.
pub fn changed_field(change: &Change) -> &'static Field {
    let path = match change.parameter {
        Changed::Inertance => "inertance_kg",
        Changed::Viscous => "viscous_n_s_per_m",
        Changed::Coulomb => "coulomb_n",
        Changed::Offset => "offset_n",
    };
    catalogue::find(Group::Parameter, path).unwrap_or(&catalogue::FIELDS[0])
}

/// A change for a person.
pub fn change_words(change: &Change) -> String {
    let Field { label, unit, .. } = changed_field(change);
    let digits =
        |value: f32| format!("{:.4}", f64::from(value)).trim_end_matches('0').trim_end_matches('.').to_string();
    let (before, after) = (digits(change.before), digits(change.after));
    format!(
        "the device has changed: {} from {before} to {after} {unit}; the estimator begins anew",
        label.to_lowercase()
    )
}

/// A backlash for a person, in micrometres: `50.1 ± 1.2`, or why there is none.
pub fn backlash_text(backlash: &Backlash) -> String {
    let text = |Interval { value, u95 }: Interval| interval_text(f64::from(value) * 1e6, f64::from(u95) * 1e6);
    match backlash.size {
        BacklashSize::Ok(interval) => text(interval),
        BacklashSize::BelowU95(interval) => format!("{} (maybe none)", text(interval)),
        BacklashSize::NotIdentifiable(reason) => reason_words(reason).into(),
    }
}

/// One line on everything that is not a parameter.
pub fn line(detail: &Detail) -> String {
    let mut parts = Vec::new();
    if let Some(Band { low_hz, high_hz }) = seen(detail.band) {
        let band = if high_hz < 1.05 * low_hz {
            format!("at {:.*} Hz", decimals(low_hz), low_hz)
        } else {
            format!("from {:.*} to {:.*} Hz", decimals(low_hz), low_hz, decimals(high_hz), high_hz)
        };
        parts.push(format!("inertance seen {band}"));
    }
    if detail.backlash.reversals > 0 {
        let by = match detail.backlash.route {
            Route::Force => "the force alone",
            Route::Terminal => "the terminal's sensor",
        };
        parts.push(format!("{} by {by}", plural(detail.backlash.reversals.into(), "reversal")));
    }
    parts.push(format!("contact: {}", contact_words(detail.contact)));
    parts.push(format!("friction: {}", regime_words(detail.friction.regime)));
    if detail.changes > 0 {
        parts.push(format!("the device has changed {}", plural(detail.changes.into(), "time")));
    }
    parts.join("; ")
}

/// What a row says beside its numbers: only what is not as it should be.
pub fn remarks(detail: &Detail) -> impl Iterator<Item = &'static str> {
    let contact =
        matches!(detail.contact, Contact::OneSided | Contact::Bouncing).then(|| contact_words(detail.contact));
    let friction = matches!(detail.friction.regime, Regime::Presliding | Regime::Stribeck);
    [contact, friction.then(|| regime_words(detail.friction.regime))].into_iter().flatten()
}

/// Rows of a table: label, unit, value, and the name of the truth with the factor to that unit.
pub fn rows(detail: &Detail, settings: &Settings) -> Vec<(&'static str, &'static str, String, &'static str, f64)> {
    let label = catalogue::find(Group::Detail, "backlash_m").map_or("", |field| field.label);
    let mut rows = vec![(label, "µm", backlash_text(&detail.backlash), "backlash_m", 1e6)];
    if settings.terminal_sensor {
        rows.extend(
            catalogue::contact(detail)
                .map(|(field, parameter)| (field.label, field.unit, value_text(&parameter), field.path, 1.0)),
        );
    }
    rows
}

fn seen(band: Band) -> Option<Band> {
    Some(band).filter(|band| band.low_hz > 0.0 && band.high_hz.is_finite())
}

/// Three digits of a frequency.
fn decimals(hertz: f32) -> usize {
    (2.0 - hertz.log10().floor()).clamp(0.0, 6.0) as usize
}

fn reason_code(reason: Reason) -> &'static str {
    match reason {
        Reason::ForceNeverReverses => "force_never_reverses",
        Reason::TooFewReversals => "too_few_reversals",
        Reason::FlankTooShort => "flank_too_short",
        Reason::StiffnessUnknown => "stiffness_unknown",
        Reason::Scattered => "scattered",
    }
}

fn reason_words(reason: Reason) -> &'static str {
    match reason {
        Reason::ForceNeverReverses => "force never reverses",
        Reason::TooFewReversals => "too few reversals",
        Reason::FlankTooShort => "flanks too short",
        Reason::StiffnessUnknown => "stiffness unknown",
        Reason::Scattered => "reversals disagree",
    }
}

fn route_code(route: Route) -> &'static str {
    match route {
        Route::Force => "force",
        Route::Terminal => "terminal",
    }
}

fn contact_code(contact: Contact) -> &'static str {
    match contact {
        Contact::Unknown => "unknown",
        Contact::OneSided => "one_sided",
        Contact::Closed => "closed",
        Contact::Backlash => "gap",
        Contact::Bouncing => "bouncing",
    }
}

/// How the flanks behave, for a person.
pub fn contact_words(contact: Contact) -> &'static str {
    match contact {
        Contact::Unknown => "not seen yet",
        Contact::OneSided => "one flank carries it all",
        Contact::Closed => "no gap seen",
        Contact::Backlash => "a gap at each reversal",
        Contact::Bouncing => "the flanks bounce",
    }
}

fn regime_code(regime: Regime) -> &'static str {
    match regime {
        Regime::Unknown => "unknown",
        Regime::Coulomb => "coulomb",
        Regime::Presliding => "presliding",
        Regime::Stribeck => "stribeck",
    }
}

/// How friction behaves, for a person.
pub fn regime_words(regime: Regime) -> &'static str {
    match regime {
        Regime::Unknown => "not seen yet",
        Regime::Coulomb => "Coulomb's",
        Regime::Presliding => "creeps before it slips (presliding)",
        Regime::Stribeck => "greater near rest (Stribeck)",
    }
}

#[cfg(test)]
#[path = "detail_tests.rs"]
mod tests;
