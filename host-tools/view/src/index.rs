//! The page that lists pages of simulated runs, with the true values beside the results.

use maud::{Markup, html as markup};

use crate::frame::{framed, head};

/// A run with its page.
#[derive(Clone, Debug, PartialEq)]
pub struct Listed {
    /// Its description.
    pub title: String,
    /// File name of its page, beside this one.
    pub page: String,
    /// Its parameters.
    pub parameters: Vec<Found>,
}

/// A parameter of a simulated run, as texts.
#[derive(Clone, Debug, PartialEq)]
pub struct Found {
    /// Its name and unit.
    pub label: String,
    /// Value and interval, or that there is none.
    pub value: String,
    /// The true value.
    pub truth: String,
    /// Whether the interval contains the true value; `None` if there is no interval.
    pub holds: Option<bool>,
}

/// The whole page: a heading, a line below it, and a table with a link for each run.
pub fn html(heading: &str, meta: &str, runs: &[Listed]) -> String {
    let main = markup! { @for run in runs { (section(run)) } };
    framed(heading, "runs", heading, &markup! { (meta) }, &main)
}

fn section(run: &Listed) -> Markup {
    markup! {
        section {
            h2 { a href=(run.page) { (run.title) } }
            table {
                (head(&["Parameter"], &["Measured, 95 % interval", "True value"], &["Interval"]))
                tbody {
                    @for found in &run.parameters {
                        tr {
                            th scope="row" { (found.label) }
                            td.number { (found.value) }
                            td.number { (found.truth) }
                            @match found.holds {
                                Some(true) => td.ok { "covers the true value" },
                                Some(false) => td.differs { "misses the true value" },
                                None => td.none { "none" },
                            }
                        }
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_run_has_its_link_and_its_verdicts() {
        let found = |value: &str, holds| Found {
            label: "Coulomb friction, N".into(),
            value: value.into(),
            truth: "50".into(),
            holds,
        };
        let run =
            |title: &str, page: &str, found| Listed { title: title.into(), page: page.into(), parameters: vec![found] };
        let runs = [
            run("slow <1 Hz", "slow.html", found("50.0 ± 0.3", Some(true))),
            run("mid", "mid.html", found("40.0 ± 0.3", Some(false))),
            run("still", "still.html", found("-", None)),
        ];
        let page = html("Five runs", "by the firmware", &runs);
        for part in [
            "<a href=\"slow.html\">slow &lt;1 Hz</a>",
            "50.0 ± 0.3",
            "<td class=\"ok\">covers the true value</td>",
            "<td class=\"differs\">misses the true value</td>",
            "<td class=\"none\">none</td>",
        ] {
            assert!(page.contains(part), "{part}: {page}");
        }
        assert!(!page.contains("http"), "{page}");
    }
}
