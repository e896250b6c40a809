//! The verdicts of a run on limits, on a page.

use inerter_core::Machine;
use inerter_data::{
    limits::{Judged, Verdict, field, verdict},
    words::interval_text,
};
use maud::{Markup, html as markup};

use crate::frame::head;

/// A verdict as the page shows it, and its CSS class.
pub(crate) const fn shown(verdict: Verdict) -> (&'static str, &'static str) {
    match verdict {
        Verdict::Pass => ("pass", "ok"),
        Verdict::Undecided => ("undecided", "held"),
        Verdict::Fail => ("fail", "none"),
    }
}

/// The section on a run's limits.
pub(super) fn within_limits(machine: Machine, run: &str, all: &[Judged]) -> Markup {
    let (word, class) = shown(verdict(all));
    markup! {
        section #limits {
            h2 { "Limits: " span class=(class) { (word) } }
            (limits_table(machine, run, all))
        }
    }
}

/// A table of a run's limits, and an explanation.
pub(crate) fn limits_table(machine: Machine, run: &str, all: &[Judged]) -> Markup {
    let wants: Vec<String> = all.iter().filter_map(|judged| judged.want(machine)).collect();
    markup! {
        (table(machine, all))
        p.small {
            "By ISO 14253-1: a parameter passes where its whole 95 % interval lies within the limits, fails where it lies beyond one, and is "
            "undecided otherwise. The interval is that of `inerter replay`, which may be wider than the device's own."
            @if !wants.is_empty() {
                " This designs a motion that would decide: "
                code { "inerter plan " (run) " --want \"" (wants.join(", ")) "\"" }
            }
        }
    }
}

/// A row for each limit.
fn table(machine: Machine, all: &[Judged]) -> Markup {
    let limit = |number: Option<f64>| number.map(|number| number.to_string()).unwrap_or_default();
    markup! {
        table {
            (head(&["Parameter", "Unit"], &["At least", "At most", "Measured"], &["Verdict"]))
            tbody {
                @for judged in all {
                    @let field = field(machine, judged.parameter);
                    @let (word, class) = shown(judged.verdict);
                    tr {
                        th scope="row" { (field.label) }
                        td { (field.unit) }
                        td.number { (limit(judged.min)) }
                        td.number { (limit(judged.max)) }
                        td.number { (measured(judged)) }
                        td { span class=(class) { (word) } @if let Some(reason) = judged.reason { ": " (reason) } }
                    }
                }
            }
        }
    }
}

fn measured(judged: &Judged) -> String {
    match (judged.value, judged.u95) {
        (Some(value), Some(u95)) => interval_text(value.into(), u95.into()),
        _ => "not identifiable".into(),
    }
}
