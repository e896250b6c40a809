//! Verdicts on limits as JUnit XML.

use inerter_core::Machine;
use inerter_data::{
    limits::{Judged, Verdict},
    words::printable,
};
use quick_junit::{NonSuccessKind, Report, TestCase, TestCaseStatus, TestSuite};

use crate::Error;

/// In the form that CI servers read: a suite for each run, by name, with its verdicts.
pub fn junit<'a>(runs: impl Iterator<Item = (&'a str, Machine, &'a [Judged])>) -> Result<String, Error> {
    let mut report = Report::new("inerter");
    report.add_test_suites(runs.map(|(run, machine, judged)| suite(&printable(run), machine, judged)));
    // It writes to memory.
    Ok(report.to_string().unwrap_or_default())
}

/// A case for each limit of a run.
fn suite(run: &str, machine: Machine, judged: &[Judged]) -> TestSuite {
    let mut suite = TestSuite::new(run);
    for judged in judged {
        let not = |kind| {
            let mut status = TestCaseStatus::non_success(kind);
            status.set_message(judged.words(machine));
            status
        };
        let status = match judged.verdict {
            Verdict::Pass => TestCaseStatus::success(),
            Verdict::Fail => not(NonSuccessKind::Failure),
            Verdict::Undecided => not(NonSuccessKind::Error),
        };
        let mut case = TestCase::new(judged.name(machine), status);
        case.set_classname(run);
        suite.add_test_case(case);
    }
    suite
}
