//! The page itself: one file that loads nothing, with light and dark schemes and a print layout.

use inerter_analysis::diagnose::{assumptions, widened};
use inerter_core::{Budget, ContactBudgets, LawStatus, Machine, Regime, Settings, Source};
use inerter_data::{
    calibration::Calibration,
    causes,
    json::Shown,
    limits,
    names::description,
    replay::Outcome,
    run::Run,
    text::{self, value_text},
    uncertainty::{parts, source_word},
    words::{self, duration_text, plural, rounded_text, utc},
};
use inerter_wire::{
    Hello, WIRE_VERSION,
    catalogue::{self, Field, Group, fields},
};
use maud::{Markup, html as markup};

use super::{Content, Kind, PageError, figures, limits::within_limits};
use crate::{
    figure::Figure,
    frame::{drawn, framed, head},
};

/// The whole page, and its figures; `within` holds the verdicts on limits.
pub fn html(content: &Content, within: &[limits::Judged]) -> (String, Vec<Figure>) {
    let machine = content.run.settings.machine;
    let all: Vec<(Kind, Result<Figure, PageError>)> =
        Kind::ALL.into_iter().map(|kind| (kind, figures::figure(content, kind))).collect();
    let name = file_name(&content.run.name);
    let main = markup! {
        (results(content))
        @if !within.is_empty() { (within_limits(machine, &content.run.name, within)) }
        (notes(content))
        (budgets(content))
        @for (kind, figure) in &all { (section(machine, *kind, figure)) }
        (conditions(content))
        (settings(&content.run.settings))
        (versions(content.run.hello.as_ref()))
        (method(machine))
    };
    let page = framed(&name, "report of a run", &name, &meta(content), &main);
    (page, all.into_iter().filter_map(|(_, figure)| figure.ok()).collect())
}

/// The last part of a file's name.
pub(crate) fn file_name(name: &str) -> String {
    std::path::Path::new(name).file_name().map_or_else(|| name.into(), |name| name.to_string_lossy().into_owned())
}

fn meta(content: &Content) -> Markup {
    markup! {
        (device_text(&content.run).unwrap_or_else(|| "device not recorded".into())) " · "
        (duration_text(content.duration_s)) " at " (content.run.settings.sample_rate_hz) " Hz"
        @if let Some(truth) = &content.run.truth {
            " · simulated"
            @if let Some(excite) = truth.get("excite") { ", motion " code { (excite) } }
        }
    }
}

/// A cell's text and its class.
fn status(shown: Shown, law: LawStatus) -> (&'static str, &'static str) {
    match shown {
        Shown::Ok => ("ok", "ok"),
        Shown::BelowU95 => ("smaller than its interval: there may be none", "held"),
        Shown::Held => ("held: at rest at the end", "held"),
        Shown::NotIdentifiable if law == LawStatus::Broken => ("the law is broken", "none"),
        Shown::NotIdentifiable => ("this motion cannot identify it", "none"),
    }
}

fn digits(value: f64) -> String {
    let rounded = (value * 1e9).round() / 1e9;
    format!("{rounded}").replace('-', "\u{2212}")
}

fn results(content: &Content) -> Markup {
    let Outcome { estimate, law, detail, .. } = &content.replayed.outcome;
    let settings = &content.run.settings;
    let simulated = content.run.truth.is_some();
    let truth = |name: &str, factor: f64| {
        let first = content.first_truth(name).map(|value| digits(value * factor)).unwrap_or_default();
        let later = content.later_truth(name).map(|(_, value)| format!(", then {}", digits(value * factor)));
        first + &later.unwrap_or_default()
    };
    let machine = settings.machine;
    let pairs = catalogue::parameters(machine, &estimate.recent)
        .zip(catalogue::parameters(machine, &estimate.whole_run))
        .zip(fields(Machine::Linear, Group::Parameter));
    let last = format!("Last {} s", settings.memory_s);
    let columns: Vec<&str> = [last.as_str(), "Whole run"].into_iter().chain(simulated.then_some("Truth")).collect();
    markup! {
        section #results {
            h2 { "Parameters of the device" }
            table {
                (head(&["Parameter", "Unit"], &columns, &["Status"]))
                tbody {
                    @for (((field, recent), (_, whole)), linear) in pairs {
                        @let (word, class) = status(Shown::of(field, &recent), law.status);
                        tr {
                            th scope="row" { (field.label) @if !field.symbol.is_empty() { " " i { (field.symbol) } } }
                            td { (field.unit) }
                            td.number { (value_text(&recent)) }
                            td.number { (value_text(&whole)) }
                            @if simulated {
                                td.number { (truth(if linear.path == "offset_n" { "force_offset_n" } else { linear.path }, 1.0)) }
                            }
                            td class=(class) { (word) }
                        }
                    }
                    @for (label, unit, value, name, factor) in text::rows(detail, settings) {
                        tr {
                            th scope="row" { (label) }
                            td { (unit) }
                            td {}
                            td.number { (value) }
                            @if simulated { td.number { (truth(name, factor)) } }
                            @if value.contains('±') { td.ok { "ok" } } @else { td.none { "not identifiable" } }
                        }
                    }
                }
            }
            p.small {
                "Values with the half width of their 95 % interval. Where the motion cannot identify a parameter there is no number."
            }
        }
    }
}

/// The components of the whole run's intervals.
fn budgets(content: &Content) -> Markup {
    let machine = content.run.settings.machine;
    let judged = &content.replayed.judged;
    let ContactBudgets { backlash_m, stiffness_n_per_m, damping_n_s_per_m } = content.replayed.outcome.budgets.contact;
    let of_backlash = catalogue::find(machine, Group::Detail, "backlash_m").into_iter();
    let of_backlash = of_backlash.map(|field| (field.label, catalogue::unit(machine, "µm"), 1e6));
    let in_si = |field: &'static Field| (field.label, field.unit, 1.0);
    let of_contact = of_backlash.chain(catalogue::contact_fields(machine).map(in_si));
    let rows: Vec<((&str, &str, f32), Budget)> = fields(machine, Group::Parameter)
        .map(in_si)
        .zip(judged.iter().map(|one| Some(one.budget)))
        .chain(of_contact.zip([backlash_m, stiffness_n_per_m, damping_n_s_per_m]))
        .filter_map(|(field, budget)| Some((field, budget?)))
        .filter(|(_, budget)| budget.u95().is_finite())
        .collect();
    let has_part = |source: &Source| rows.iter().any(|(_, budget)| parts(budget).any(|(other, _)| other == *source));
    let sources: Vec<Source> = Source::ALL.into_iter().filter(has_part).collect();
    let columns: Vec<&str> = sources.iter().map(|source| source_word(*source)).chain(["all", "on one rig"]).collect();
    let part = |budget: &Budget, source: Source, factor: f32| {
        parts(budget).find(|(other, _)| *other == source).map(|(_, u95)| two_digits(factor * u95)).unwrap_or_default()
    };
    markup! {
        section #budget {
            h2 { "Sources of the intervals" }
            table {
                (head(&["Parameter", "Unit"], &columns, &[]))
                tbody {
                    @for ((label, unit, factor), budget) in &rows {
                        tr {
                            th scope="row" { (label) }
                            td { (unit) }
                            @for source in &sources { td.number { (part(budget, *source, *factor)) } }
                            td.number { (two_digits(factor * budget.u95())) }
                            td.number { (two_digits(factor * budget.same_rig_u95())) }
                        }
                    }
                }
            }
            p.small {
                "Parts of the 95 % interval of the whole run; their squares add up to its square. Noise is the scatter of this run. Gain, lead, timebase, "
                "skew, structure and stiffness have the uncertainties that the settings state. Model is the possible error of the law, estimated from the samples of the last minute"
                "; the device detects only part of it, so its own interval may be narrower. "
                "Two runs on one rig may be compared by the last column, which leaves out what they share: gain, lead and timebase."
            }
            @if let Some(words) = widened(machine, &content.replayed.outcome.estimate.whole_run, judged) {
                p.small { (words) }
            }
            @if let Some(words) = assumptions(machine, judged, &content.replayed.causes) {
                p.small { (words) }
            }
        }
    }
}

fn two_digits(u95: f32) -> String {
    rounded_text(u95.into(), u95.into())
}

/// Notes on a run for a person.
pub(crate) fn notes_of(content: &Content) -> Vec<String> {
    let machine = content.run.settings.machine;
    let changes =
        content.changes.iter().map(|(t_s, change)| format!("At {t_s:.2} s {}.", text::change_words(machine, change)));
    let warnings = content
        .warnings
        .iter()
        .map(|(t_s, warning)| format!("At {t_s:.2} s {}.", causes::warning_words(machine, warning.kind)));
    let unseen =
        content.unseen.iter().map(|kind| format!("Over the whole run {}.", causes::warning_words(machine, *kind)));
    let is_told = |code: &str| content.unseen.iter().any(|kind| causes::warning_name(*kind) == code);
    let is_of_law = |code: &str| content.replayed.causes.iter().any(|cause| cause.kind.name() == code);
    let remarks =
        content.replayed.remarks().filter(|(code, _)| !is_told(code)).map(|(code, words)| match is_of_law(code) {
            true => format!("The law does not hold: {words}."),
            false => format!("In the last minute {words}."),
        });
    let advice = content.replayed.advice.iter().map(|advice| advice.sentence(machine));
    let friction = matches!(content.replayed.outcome.detail.friction.regime, Regime::Presliding | Regime::Stribeck)
        .then(|| "Friction near rest does not follow the law; the intervals are wider because of that.".to_string());
    let contact = (content.run.settings.stiffness_n_per_m == 0.0 && !content.run.settings.terminal_sensor).then(|| {
        let why = "The contact stiffness is not set: without it the force alone cannot identify backlash";
        format!("{} (setting stiffness_n_per_m).", description(machine, why))
    });
    let of_run = content.run.notes.iter().cloned();
    of_run
        .chain(changes)
        .chain(warnings)
        .chain(unseen)
        .chain(remarks)
        .chain(friction)
        .chain(contact)
        .chain(advice)
        .collect()
}

fn notes(content: &Content) -> Markup {
    let all = notes_of(content);
    markup! {
        section #notes {
            h2 { "Notes" }
            @if all.is_empty() {
                p { "Nothing unusual: nothing was lost, damaged or repaired, and the device did not change." }
            } @else {
                ul { @for note in &all { li { (note) } } }
            }
        }
    }
}

fn section(machine: Machine, kind: Kind, figure: &Result<Figure, PageError>) -> Markup {
    markup! {
        section id=(kind.name()) {
            h2 { (description(machine, kind.heading())) }
            @match figure {
                Ok(figure) => { (drawn(figure)) },
                Err(PageError::NotShown { reason, .. }) => p.absent { "Not shown: " (reason) "." },
                Err(PageError::Format { .. }) => {},
            }
        }
    }
}

fn conditions(content: &Content) -> Markup {
    let Outcome { estimate, law, detail, counters, .. } = &content.replayed.outcome;
    let settings = &content.run.settings;
    let band =
        (detail.band.low_hz > 0.0).then(|| format!("{:.3} to {:.3} Hz", detail.band.low_hz, detail.band.high_hz));
    let reversal = detail
        .friction
        .reversal_ratio
        .map(|ratio| format!(", {ratio:.2} of the Coulomb step seen at reversals"))
        .unwrap_or_default();
    let lost = match (counters.discontinuities, counters.lost_samples) {
        (0, _) => "none".to_string(),
        (places, lost) => format!("{} in {}", plural(lost, "sample"), plural(places.into(), "place")),
    };
    let residual = content
        .residual()
        .map_or_else(|| "nothing moved".to_string(), |(rms_n, _)| text::force_text(settings.machine, rms_n) + " rms");
    let seen_at = description(settings.machine, "Inertance observed at");
    let recorded = content.run.recorded_ns.map(|time_ns| ("Recorded", utc(time_ns)));
    let rows = [
        ("Duration", duration_text(content.duration_s)),
        ("Sample rate", format!("{} Hz", settings.sample_rate_hz)),
        ("Samples", counters.samples.to_string()),
        ("Lost samples", lost),
        ("Saturated samples", counters.saturated.to_string()),
        (&seen_at, band.unwrap_or_else(|| "nothing moved".into())),
        ("Contact", text::contact_words(detail.contact).into()),
        ("Friction", format!("{}{reversal}", text::regime_words(detail.friction.regime))),
        ("Changes of the device", detail.changes.to_string()),
        ("Residual of the law", residual),
        ("Law", text::law_text(law)),
        ("Calibration of the rig", calibration_text(&content.run)),
        ("Kernel bank", words::code(&estimate.bank)),
        ("Updates", estimate.updates.to_string()),
        ("Reversals for the backlash", detail.backlash.reversals.to_string()),
    ];
    markup! {
        section #conditions {
            h2 { "Conditions" }
            (pairs(&recorded.into_iter().chain(rows).collect::<Vec<_>>()))
        }
    }
}

/// The device that recorded a run, if known.
pub(crate) fn device_text(run: &Run) -> Option<String> {
    run.hello.as_ref().map(|hello| format!("{}, serial {}", hello.board, hello.serial))
}

/// When and how the rig was calibrated, if known.
pub(crate) fn calibration_text(run: &Run) -> String {
    run.calibration.as_ref().map_or_else(|| "not stated".into(), Calibration::words)
}

fn pairs(rows: &[(&str, String)]) -> Markup {
    markup! {
        table.pairs { tbody {
            @for (name, value) in rows { tr { th scope="row" { (name) } td { (value) } } }
        } }
    }
}

fn settings(settings: &Settings) -> Markup {
    let changed: Vec<_> =
        Settings::described().zip(settings.values()).filter(|((info, _), value)| info.default != *value).collect();
    markup! {
        section #settings {
            h2 { "Settings that are not the default" }
            @if changed.is_empty() {
                p { "All settings are the defaults." }
            } @else {
                table {
                    (head(&["Setting"], &["Value", "Default"], &["Unit", "Meaning"]))
                    tbody {
                        @for ((info, text), value) in &changed {
                            tr {
                                th scope="row" { code { (info.name) } }
                                td.number { (format!("{value:?}")) }
                                td.number { (format!("{:?}", info.default)) }
                                td { (text.unit) }
                                td { (text.help) }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn versions(hello: Option<&Hello>) -> Markup {
    let mut rows = match hello {
        Some(hello) => {
            let git = if hello.git.is_empty() { String::new() } else { format!(", commit {}", hello.git) };
            vec![
                ("Firmware", format!("{}{git}", hello.firmware)),
                ("Board", hello.board.to_string()),
                ("Serial number", hello.serial.to_string()),
                ("Sample clock", format!("{:?}", hello.clock).to_lowercase()),
                ("Wire version of the device", hello.wire_version.to_string()),
            ]
        }
        None => vec![("Device", "not recorded in this file".into())],
    };
    rows.push(("This program", format!("inerter {}, wire version {WIRE_VERSION}", env!("CARGO_PKG_VERSION"))));
    markup! {
        section #versions {
            h2 { "Versions" }
            (pairs(&rows))
        }
    }
}

fn method(machine: Machine) -> Markup {
    let words = |linear| description(machine, linear);
    markup! {
        section #method {
            h2 { "Method" }
            p {
                (words("Force and displacement pass the same smoothing kernel; recursive least squares find "))
                i { "mt" } ", " i { "cf" } ", " i { "fc" } " and " i { "F0" } " of "
                i { "F = mt a + cf v + fc sgn(v) + F0" } ", in contact and out of it; samples at rest are left out. "
                "The estimates are those of the device, to the bit. An interval is "
                i { "U95" } " = " i { "k" } " √(" i { "u" } "a² + Σ " i { "u" } "i²) after JCGM 100, with Student's factor "
                i { "k" } " by the degrees of freedom of all parts together (Welch and Satterthwaite)."
            }
        }
    }
}
