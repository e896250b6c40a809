//! The page of compared runs.

use inerter_analysis::compare::{Row, Verdict};
use inerter_core::{Machine, Settings};
use inerter_data::{
    limits::verdict,
    text::law_text,
    words::{duration_text, plural, utc},
};
use maud::{Markup, html as markup};

use super::{comparison::Comparison, figures::figures};
use crate::{
    figure::Figure,
    frame::{figure_section, framed, head},
    page::{Content, calibration_text, device_text, file_name, limits_table, notes_of, shown},
};

/// The whole page, and its figures.
pub fn html(comparison: &Comparison) -> (String, Vec<Figure>) {
    let figures = figures(comparison);
    let machine = comparison.machine();
    let main = markup! {
        (runs(comparison))
        (parameters(comparison, machine))
        @if !comparison.within.is_empty() { (limits(comparison, machine)) }
        @for figure in &figures { (figure_section(figure)) }
        (notes(comparison))
        (settings(comparison))
        (method())
    };
    let count = plural(comparison.runs.len() as u64, "run");
    let heading = match comparison.runs.as_slice() {
        [first, second] => format!("{} and {}", file_name(&first.run.name), file_name(&second.run.name)),
        _ => count.clone(),
    };
    let meta = markup! { (count) ", compared with the first" };
    (framed(&heading, "runs compared", &heading, &meta, &main), figures)
}

/// The list of runs.
fn runs(comparison: &Comparison) -> Markup {
    let columns = ["Run", "Length", "Recorded", "Device", "Calibration", "Law"].into_iter();
    let columns: Vec<&str> = columns.chain((!comparison.within.is_empty()).then_some("Limits")).collect();
    markup! {
        section #runs {
            h2 { "Runs" }
            table {
                (head(&columns, &[], &[]))
                tbody {
                    @for (number, content) in comparison.runs.iter().enumerate() {
                        tr {
                            th scope="row" { (number + 1) " " (content.run.name) }
                            td { (duration_text(content.duration_s)) }
                            td { (content.run.recorded_ns.map_or("not known".into(), utc)) }
                            td { (device_text(&content.run).unwrap_or_else(|| "not recorded".into())) }
                            td { (calibration_text(&content.run)) }
                            td { (law_text(&content.replayed.outcome.law)) }
                            @if let Some(within) = comparison.within.get(number) {
                                @let (word, class) = shown(verdict(within));
                                td class=(class) { (word) }
                            }
                        }
                    }
                }
            }
        }
    }
}

/// Each parameter of each run, and what differs.
fn parameters(comparison: &Comparison, machine: Machine) -> Markup {
    markup! {
        section #parameters {
            h2 { "What differs" }
            table {
                (head(&["Parameter", "Unit", "Run"], &["Value", "Minus the first"], &["Verdict"]))
                tbody { @for row in &comparison.rows { (of_parameter(comparison, machine, row)) } }
            }
            @for words in comparison.words() { p.small { (words) } }
        }
    }
}

fn of_parameter(comparison: &Comparison, machine: Machine, row: &Row) -> Markup {
    let field = row.field(machine);
    let (unit, factor) = row.shown_unit(machine);
    let first_doubt = row.runs.first().and_then(|run| run.doubt);
    markup! {
        @for (number, run) in row.runs.iter().enumerate() {
            @let class = match run.verdict { Some(Verdict::Differs) => "differs", Some(Verdict::Undecided) => "held", _ => "" };
            tr {
                th scope="row" {
                    @if number == 0 { (field.label) @if !field.symbol.is_empty() { " " i { (field.symbol) } } }
                }
                td { @if number == 0 { (unit) } }
                td { (number + 1) }
                td.number { (run.value_text(comparison.shown_rig(number), factor)) }
                @if let Some((difference, said)) = run.difference_text(factor) {
                    td.number { (difference) }
                    td class=(class) { (said) @if let Some(reason) = run.reason(first_doubt) { ": " (reason) } }
                } @else {
                    td {}
                    td { @if let Some(doubt) = run.doubt { (doubt) } }
                }
            }
        }
    }
}

/// The verdicts on limits of each run.
fn limits(comparison: &Comparison, machine: Machine) -> Markup {
    markup! {
        section #limits {
            h2 { "Limits" }
            @for (number, (content, within)) in comparison.runs.iter().zip(&comparison.within).enumerate() {
                @let (word, class) = shown(verdict(within));
                h3 { (number + 1) " " (file_name(&content.run.name)) ": " span class=(class) { (word) } }
                (limits_table(machine, &content.run.name, within))
            }
        }
    }
}

/// Notes on each run for a person.
fn notes(comparison: &Comparison) -> Markup {
    let of_run = |(number, content): (usize, &Content)| {
        notes_of(content).into_iter().map(move |note| (number + 1, note)).collect::<Vec<_>>()
    };
    let notes: Vec<(usize, String)> = comparison.runs.iter().enumerate().flat_map(of_run).collect();
    markup! {
        @if !notes.is_empty() {
            section #notes {
                h2 { "Notes" }
                ul { @for (number, note) in &notes { li { "Run " (number) ": " (note) } } }
            }
        }
    }
}

/// Settings that differ between the runs.
fn settings(comparison: &Comparison) -> Markup {
    let values: Vec<_> = comparison.sides.iter().map(|side| side.settings.values()).collect();
    let rows: Vec<_> = Settings::described()
        .enumerate()
        .map(|(place, (info, text))| {
            let of_runs: Vec<f64> = values.iter().filter_map(|values| values.get(place).copied()).collect();
            (info.name, text.unit, of_runs)
        })
        .filter(|(_, _, of_runs)| of_runs.iter().any(|value| Some(value) != of_runs.first()))
        .collect();
    markup! {
        section #settings {
            h2 { "Settings that differ" }
            @if rows.is_empty() {
                p { "The runs have the same settings." }
            } @else {
                table {
                    thead { tr {
                        th scope="col" { "Setting" } th scope="col" { "Unit" }
                        @for number in 1..=values.len() { th.number scope="col" { "Run " (number) } }
                    } }
                    tbody {
                        @for (name, unit, of_runs) in &rows {
                            tr {
                                th scope="row" { code { (name) } }
                                td { (unit) }
                                @for value in of_runs { td.number { (format!("{value:?}")) } }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn method() -> Markup {
    markup! {
        section #method {
            h2 { "How it was compared" }
            p {
                "The half width of a difference's 95 % interval is " i { "U" } " = " i { "k" } " √(" i { "u" } "1² + " i { "u" } "2²), after JCGM 100. "
                "On one rig the errors of force gain, lead and clock are the same in both runs and enter with their difference alone. "
                "A difference is significant where chance alone would hardly make one as large. The more differences are tested, the "
                "stricter each test (Holm's method): where nothing differs, one page in 20 still reports a difference."
            }
        }
    }
}
