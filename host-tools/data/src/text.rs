//! Estimates, their details and events as text and tables, for people.

use std::collections::BTreeMap;

use inerter_core::{
    Backlash, BacklashSize, Band, Change, Contact, Detail, Estimate, Interval, Law, LawStatus, Machine, Misfit,
    Parameter, Reason, Regime, Route, Settings, Status,
};
use inerter_wire::{
    Estimated, EventKind, Reading, ResetCause,
    catalogue::{self, Field, Group},
};

use crate::{
    causes::warning_words,
    names::{description, parameter},
    replay::Outcome,
    words::{amount_text, code, duration_text, interval_text, plural},
};

/// Value and interval to the digits that the interval justifies: `95.11 ± 0.48`.
pub fn value_text(parameter: &Parameter) -> String {
    let Some(Interval { value, u95 }) = parameter.known().filter(|known| known.value.is_finite()) else {
        return "not identifiable".into();
    };
    let held = if parameter.status() == Status::Held { " (held)" } else { "" };
    interval_text(value.into(), u95.into()) + held
}

/// A backlash for a person, in micrometres: `50.1 ± 1.2`, or why there is none.
pub fn backlash_text(backlash: &Backlash) -> String {
    let text = |Interval { value, u95 }: Interval| interval_text(f64::from(value) * 1e6, f64::from(u95) * 1e6);
    match backlash.size {
        BacklashSize::Ok(interval) | BacklashSize::BelowU95(interval) if !interval.value.is_finite() => {
            "not identifiable".into()
        }
        BacklashSize::Ok(interval) => text(interval),
        BacklashSize::BelowU95(interval) => format!("{} (maybe none)", text(interval)),
        BacklashSize::NotIdentifiable(reason) => reason_words(reason).into(),
    }
}

/// A table of all parameters: recent memory, whole run and, for a simulated device, the true values; below it a line on
/// friction and contact.
pub fn table(estimated: &Estimated, settings: &Settings, truth: Option<&BTreeMap<String, String>>) -> String {
    let Estimated { estimate, detail, .. } = estimated;
    let machine = settings.machine;
    let recent = catalogue::parameters(machine, &estimate.recent);
    let whole = catalogue::parameters(machine, &estimate.whole_run);
    let head = if truth.is_some() { "truth" } else { "" };
    let mut lines = vec![table_line("", "", &format!("last {} s", settings.memory_s), "whole run", head)];
    let linear = catalogue::fields(Machine::Linear, Group::Parameter);
    for (((field, recent), (_, whole)), linear) in recent.zip(whole).zip(linear) {
        // In the plant, the offset belongs to the load cell.
        let name = if linear.path == "offset_n" { "force_offset_n" } else { linear.path };
        let (recent, whole) = (value_text(&recent), value_text(&whole));
        lines.push(table_line(field.label, field.unit, &recent, &whole, &true_text(truth, name, 1.0)));
    }
    if let Some(detail) = detail {
        for (label, unit, value, name, factor) in rows(detail, settings) {
            lines.push(table_line(label, unit, "", &value, &true_text(truth, name, factor)));
        }
        lines.extend([String::new(), line(machine, estimated)]);
    }
    lines.join("\n")
}

fn table_line(label: &str, unit: &str, recent: &str, whole: &str, truth: &str) -> String {
    format!("{label:<20} {unit:<6} {recent:<22} {whole:<22} {truth}").trim_end().into()
}

/// The true value, converted by `factor` to the unit shown; both values if the device was changed during the run.
fn true_text(truth: Option<&BTreeMap<String, String>>, name: &str, factor: f64) -> String {
    // Nine digits: more would be arithmetic noise.
    let digits = |value: f64| {
        format!("{:.8e}", value * factor).parse().map_or_else(|_| String::new(), |value: f64| format!("{value:?}"))
    };
    let number = |name: &str| truth?.get(name)?.parse().ok().map(digits);
    match (number(name), number(&format!("changed_{name}"))) {
        (Some(first), Some(changed)) => format!("{first}, then {changed}"),
        (first, _) => first.unwrap_or_default(),
    }
}

/// One line on what the estimator used and left out.
pub fn counts_line(settings: &Settings, duration_s: f64, outcome: &Outcome) -> String {
    let counters = outcome.counters;
    let lost = match (counters.discontinuities, counters.lost_samples) {
        (0, _) => "none lost".to_string(),
        (places, lost) => format!("{lost} lost in {}", plural(places.into(), "place")),
    };
    let saturated = match counters.saturated {
        0 => "none saturated".to_string(),
        count => format!("{count} saturated"),
    };
    format!(
        "{} at {} Hz in {}, {lost}, {saturated}; residual {}",
        plural(counters.samples, "sample"),
        settings.sample_rate_hz,
        duration_text(duration_s),
        residual_text(settings.machine, &outcome.estimate)
    )
}

/// The unexplained force, for a person: `1.82 N rms`.
pub fn residual_text(machine: Machine, estimate: &Estimate) -> String {
    if !estimate.residual_rms_n.is_finite() {
        return "unknown".into();
    }
    force_text(machine, estimate.residual_rms_n.into()) + " rms"
}

/// A force with its unit, for a person: `1.82 N`, `0.00031 N m`.
pub fn force_text(machine: Machine, force_n: f64) -> String {
    format!("{} {}", amount_text(force_n, 2), catalogue::unit(machine, "N"))
}

/// The header of the lines of [`row`]. The residual is relative to what noise and steps explain: about 1 if the law
/// holds.
pub fn row_header(machine: Machine) -> String {
    let mut text = format!("{:>9}", "t [s]");
    for field in catalogue::fields(machine, Group::Parameter) {
        text += &format!("  {:<24}", format!("{} [{}]", field.label, field.unit));
    }
    let backlash = format!("Backlash [{}]", catalogue::unit(machine, "µm"));
    text + &format!("  {backlash:<22}  Residual")
}

/// One line per estimate: the recent memory, and the backlash so far.
pub fn row(t_s: f64, estimated: &Estimated) -> String {
    let Estimated { estimate, detail, .. } = estimated;
    let mut text = format!("{t_s:>9.2}");
    for (_, parameter) in catalogue::parameters(Machine::Linear, &estimate.recent) {
        text += &format!("  {:<24}", value_text(&parameter));
    }
    text += &format!("  {:<22}", detail.as_ref().map(|detail| backlash_text(&detail.backlash)).unwrap_or_default());
    let rest = Some("at rest").filter(|_| !estimate.moving);
    let remarks: Vec<&str> = rest.into_iter().chain(remarks(estimated)).collect();
    let misfit = estimated.law.and_then(|law| law.misfit);
    let ratio = misfit.map(|Misfit { ratio, .. }| format!("{ratio:.2}")).unwrap_or_default();
    text += &format!("  {ratio:<8}  {}", remarks.join(", "));
    text.trim_end().into()
}

/// Time from the first sample since the reset to the one of this estimate \[s\].
pub fn elapsed_s(estimate: &Estimate, rate_hz: f64) -> f64 {
    estimate.elapsed_samples.saturating_sub(1) as f64 / rate_hz
}

/// The note if a device has other settings than this program knows.
pub fn settings_note(reading: &Reading) -> Option<String> {
    let some = |count: usize, thing| (count > 0).then(|| plural(count as u64, thing));
    let newer = [some(reading.unknown, "setting"), some(reading.impossible, "value")];
    let newer = newer.into_iter().flatten().reduce(|settings, values| format!("{settings} and {values}"));
    let newer = newer.map(|what| format!("the firmware is newer than this program: {what} unknown here, left out"));
    let older = some(reading.missing, "setting");
    let older =
        older.map(|what| format!("the firmware is older than this program: {what} missing, set to the defaults"));
    newer.into_iter().chain(older).reduce(|newer, older| format!("{newer}; {older}"))
}

/// An event for a person.
pub fn event_words(machine: Machine, kind: &EventKind) -> String {
    use EventKind::{Changed, Fault, Panicked, ResetBy, SourceChanged, Warned};
    match kind {
        EventKind::Started => "the device has started".into(),
        EventKind::SourceEnded => "no more samples: the motion has ended".into(),
        EventKind::EstimatorReset => "the estimator restarts".into(),
        EventKind::SettingsChanged => "the settings were changed".into(),
        SourceChanged(source) => format!("samples now come from: {source:?}").to_lowercase(),
        Fault(fault) => format!("fault: {fault}"),
        Panicked(text) => format!("the firmware failed before this start: {text}; please report it"),
        ResetBy(cause) => format!("the device was started by {cause}"),
        Changed(change) => change_words(machine, change),
        Warned(warning) => warning_words(machine, warning.kind),
    }
}

/// Whether an event reports a fault that matters to a recording.
pub fn is_trouble(kind: &EventKind) -> bool {
    match kind {
        EventKind::Fault(_) | EventKind::Panicked(_) | EventKind::Changed(_) | EventKind::Warned(_) => true,
        // A cause that is new here is trouble until somebody says that it is not.
        EventKind::ResetBy(cause) => {
            !matches!(cause, ResetCause::PowerOn | ResetCause::Pin | ResetCause::Software | ResetCause::OptionBytes)
        }
        EventKind::Started
        | EventKind::SourceEnded
        | EventKind::EstimatorReset
        | EventKind::SettingsChanged
        | EventKind::SourceChanged(_) => false,
    }
}

/// The field of the parameter that changed.
pub fn changed_field(machine: Machine, change: &Change) -> &'static Field {
    // `Changed` and the catalogue list the parameters in the same order.
    parameter(machine, change.parameter as usize)
}

/// A change for a person.
pub fn change_words(machine: Machine, change: &Change) -> String {
    let Field { label, unit, .. } = changed_field(machine, change);
    let digits = |value: f32| {
        let text = amount_text(value.into(), 4);
        // The zeros of an exponent must stay.
        if text.contains('e') { text } else { text.trim_end_matches('0').trim_end_matches('.').to_string() }
    };
    let (before, after) = (digits(change.before), digits(change.after));
    format!("the device has changed: {} from {before} to {after} {unit}; the estimator restarts", label.to_lowercase())
}

/// Whether the law holds, for a person: `holds (the residual is 1.0 times what noise and steps explain)`.
pub fn law_text(law: &Law) -> String {
    let word = code(&law.status);
    match law.misfit {
        Some(Misfit { ratio, .. }) => {
            format!("{word} (the residual is {ratio:.1} times what noise and steps explain)")
        }
        None => word,
    }
}

/// One line on everything that is not a parameter; empty if a device sends only the parameters.
pub fn line(machine: Machine, estimated: &Estimated) -> String {
    let mut parts = estimated.detail.as_ref().map(detail_parts).unwrap_or_default();
    parts.extend(estimated.law.map(|law| format!("law: {}", law_text(&law))));
    description(machine, &parts.join("; "))
}

fn detail_parts(detail: &Detail) -> Vec<String> {
    let mut parts = Vec::new();
    if let Some(Band { low_hz, high_hz }) = seen(detail.band) {
        let band = if high_hz < 1.05 * low_hz {
            format!("at {:.*} Hz", decimals(low_hz), low_hz)
        } else {
            format!("from {:.*} to {:.*} Hz", decimals(low_hz), low_hz, decimals(high_hz), high_hz)
        };
        parts.push(format!("inertance observed {band}"));
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
    parts
}

/// Remarks on a row besides its numbers: only about problems.
pub fn remarks(estimated: &Estimated) -> impl Iterator<Item = &'static str> {
    let of_detail = |detail: Detail| {
        let contact =
            matches!(detail.contact, Contact::OneSided | Contact::Bouncing).then(|| contact_words(detail.contact));
        let friction = matches!(detail.friction.regime, Regime::Presliding | Regime::Stribeck);
        [contact, friction.then(|| regime_words(detail.friction.regime))]
    };
    let law = estimated.law.filter(|law| law.status == LawStatus::Broken).map(|_| "law broken");
    estimated.detail.map(of_detail).into_iter().flatten().chain([law]).flatten()
}

/// Rows of a table: label, unit, value, and the name of the true value with the factor to that unit.
pub fn rows(detail: &Detail, settings: &Settings) -> Vec<(&'static str, &'static str, String, &'static str, f64)> {
    let label = catalogue::find(settings.machine, Group::Detail, "backlash_m").map_or("", |field| field.label);
    let mut rows =
        vec![(label, catalogue::unit(settings.machine, "µm"), backlash_text(&detail.backlash), "backlash_m", 1e6)];
    if settings.terminal_sensor {
        rows.extend(
            catalogue::contact(settings.machine, detail).zip(catalogue::contact_fields(Machine::Linear)).map(
                |((field, parameter), linear)| (field.label, field.unit, value_text(&parameter), linear.path, 1.0),
            ),
        );
    }
    rows
}

pub(crate) fn seen(band: Band) -> Option<Band> {
    Some(band).filter(|band| band.low_hz > 0.0 && band.high_hz.is_finite())
}

/// Decimals that give a frequency three digits.
fn decimals(hertz: f32) -> usize {
    (2.0 - hertz.log10().floor()).clamp(0.0, 6.0) as usize
}

/// Why there is no backlash, for a person.
fn reason_words(reason: Reason) -> &'static str {
    match reason {
        Reason::ForceNeverReverses => "load never reverses",
        Reason::TooFewReversals => "too few reversals",
        Reason::FlankTooShort => "flanks too short",
        Reason::StiffnessUnknown => "stiffness unknown",
        Reason::Scattered => "reversals disagree",
    }
}

/// How the flanks behave, for a person.
pub fn contact_words(contact: Contact) -> &'static str {
    match contact {
        Contact::Unknown => "not seen yet",
        Contact::OneSided => "one flank carries all the force",
        Contact::Closed => "no backlash seen",
        Contact::Backlash => "backlash at each reversal",
        Contact::Bouncing => "the flanks bounce",
    }
}

/// How friction behaves, for a person.
pub fn regime_words(regime: Regime) -> &'static str {
    match regime {
        Regime::Unknown => "not seen yet",
        Regime::Coulomb => "Coulomb",
        Regime::Presliding => "creeps before it slips (presliding)",
        Regime::Stribeck => "greater near rest (Stribeck)",
    }
}

#[cfg(test)]
#[path = "text_tests.rs"]
mod tests;
