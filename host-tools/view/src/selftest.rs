//! The page of a board's self-test: one file to send to others.

use inerter_data::{
    selftest::{Check, SelfTest, Skew, Verdict},
    words::utc,
};
use maud::{Markup, html as markup};

use crate::frame::{framed, head};

/// The whole page.
pub fn html(test: &SelfTest) -> String {
    let hello = &test.hello;
    let failed = test.failed();
    let meta = markup! { (utc(test.begun_ns)) " · " (hello.firmware) ", commit " (hello.git) " · at " (test.port) };
    let main = markup! {
        section #result {
            h2 { "Result" }
            p {
                @if failed.is_empty() { span.ok { "Passed" } } @else { span.none { "Failed" } }
                ": " (test.summary()) "."
            }
            @if let Some(Skew { skew_s, skew_u95_s }) = test.skew {
                p {
                    "Delay of the force behind the position, of the board alone (skew_s): "
                    (format!("{:.2} µs ± {:.2} µs", skew_s * 1e6, skew_u95_s * 1e6)) "."
                }
            }
        }
        (checks(&test.checks))
        (figures(test))
    };
    let title = format!("self-test of {}", hello.serial);
    let heading = format!("{}, serial {}", hello.board, hello.serial);
    framed(&title, "self-test of a board", &heading, &meta, &main)
}

fn checks(checks: &[Check]) -> Markup {
    markup! {
        section #checks {
            h2 { "Checks" }
            table {
                (head(&["Check", "Verdict", "Found", "Expected", "Unit", "Cause or reason"], &[], &[]))
                tbody { @for check in checks { (row(check)) } }
            }
        }
    }
}

fn row(check: &Check) -> Markup {
    let class = match check.verdict {
        Verdict::Pass => "ok",
        Verdict::Fail => "none",
        Verdict::Skipped => "held",
    };
    markup! {
        tr {
            th scope="row" { (check.label) }
            td class=(class) { (check.verdict.word()) }
            td { (check.found.as_deref().unwrap_or_default()) }
            td { (check.expected) }
            td { (check.unit) }
            td { (check.reason.as_deref().unwrap_or_default()) }
        }
    }
}

fn figures(test: &SelfTest) -> Markup {
    markup! {
        section #figures {
            h2 { "Measurements by the board itself" }
            table {
                (head(&["Quantity"], &["Value"], &["Unit"]))
                tbody {
                    @for (field, value) in test.figures() {
                        tr {
                            @match field {
                                Ok(field) => { th scope="row" { (field.label) } td.number { (value) } td { (field.unit) } }
                                Err(number) => { th scope="row" { "quantity " (number) } td.number { (value) } td {} }
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
    use inerter_wire::{Capabilities, ClockSource, Hello, Measure, Measured, Quantity, WIRE_VERSION};

    use super::*;

    #[test]
    fn the_page_tells_what_failed_and_why_and_nothing_in_it_is_markup() {
        let hello = Hello {
            wire_version: WIRE_VERSION,
            firmware: Hello::text("<script>"),
            git: Hello::text("0123abcd"),
            board: Hello::text("nucleo-g474re"),
            serial: Hello::text("1"),
            sample_rate_hz: 1000.0,
            clock: ClockSource::Crystal,
            capabilities: Capabilities::NONE,
        };
        let mut measured = Measured::new(Measure::Chip);
        measured.push(Quantity::FlashKb, 128);
        let few = Check::range("flash", "Flash", "KB", 512.0..=f64::INFINITY, Some(128.0), |_| "too <little>");
        let skipped = Check::skipped("dfu", "Update mode", "not over USB");
        let checks = vec![few, skipped];
        let skew = Some(Skew { skew_s: -6.25e-7, skew_u95_s: 1.5e-7 });
        let test = SelfTest { hello, port: "p".into(), begun_ns: 0, checks, measured: vec![measured], skew };
        let page = html(&test);
        for wanted in [
            "too &lt;little&gt;",
            "&lt;script&gt;",
            "at least 512",
            "not over USB",
            ">128<",
            "Failed",
            "(skew_s): -0.62 µs ± 0.15 µs.",
        ] {
            assert!(page.contains(wanted), "{wanted}");
        }
        assert!(!page.contains("<script"));
    }
}
