//! Limits that a device is held against, and the files that say what came of it.

use std::path::{Path, PathBuf};

use inerter_core::Machine;
use inerter_data::{
    limits::{Judged, Limits, LimitsError, Verdict, verdict},
    output::{self, OutputError},
    words::printable,
};
use quick_junit::{NonSuccessKind, Report, TestCase, TestCaseStatus, TestSuite};

use super::terminal::tidy_at_interrupts;
use crate::Error;

/// What a device is held against.
#[derive(clap::Args)]
pub struct LimitsArgs {
    /// Hold the parameters against limits: TOML with a table for each, such as `[coulomb_n]`, and `min` or `max` below it
    #[arg(long, value_name = "FILE.toml", help_heading = "Limits")]
    limits: Option<PathBuf>,
    /// Write what is said of the limits as JUnit XML; what is undecided is an error there
    #[arg(long, value_name = "FILE.xml", requires = "limits", help_heading = "Limits")]
    junit: Option<PathBuf>,
    /// Write it as CSV
    #[arg(long, value_name = "FILE.csv", requires = "limits", help_heading = "Limits")]
    verdicts: Option<PathBuf>,
    /// Replace these files where they are there
    #[arg(long, help_heading = "Limits")]
    force: bool,
}

impl LimitsArgs {
    /// Refuses files that are in the way, before any work is done; `run` is not to be written over. Ctrl-C leaves none half written.
    pub fn check(&self, run: &Path) -> Result<&Self, Error> {
        tidy_at_interrupts();
        let read = self.limits.as_deref().into_iter().chain([run]);
        for path in self.junit.iter().chain(&self.verdicts) {
            let twice = self.junit == self.verdicts;
            if twice || read.clone().any(|read| read == path) {
                return Err(OutputError::Exists { path: path.clone() }.into());
            }
        }
        let mut files = self.junit.iter().chain(&self.verdicts).filter(|_| !self.force);
        files.try_for_each(|path| output::refuse_existing(path))?;
        Ok(self)
    }

    /// The limits, where there are any.
    pub fn read(&self, machine: Machine) -> Result<Option<Limits>, LimitsError> {
        self.limits.as_deref().map(|path| Limits::read(path, machine)).transpose()
    }

    /// Writes the files.
    pub fn write(&self, run: &Path, machine: Machine, all: &[Judged]) -> Result<(), Error> {
        if let Some(path) = &self.junit {
            output::write(path, self.force, junit(run, machine, all))?;
        }
        if let Some(path) = &self.verdicts {
            output::write(path, self.force, csv(run, machine, all))?;
        }
        Ok(())
    }

    /// Fails unless all pass.
    pub fn verdict(&self, run: &Path, machine: Machine, all: &[Judged]) -> Result<(), Error> {
        if verdict(all) == Verdict::Pass {
            return Ok(());
        }
        let count = |wanted: Verdict| all.iter().filter(|judged| judged.verdict == wanted).count();
        Err(Error::Limits {
            run: run.display().to_string(),
            fail: count(Verdict::Fail),
            undecided: count(Verdict::Undecided),
            of: all.len(),
            wants: all.iter().filter_map(|judged| judged.want(machine)).collect::<Vec<_>>().join(", "),
        })
    }
}

/// As servers of continuous integration read it.
fn junit(run: &Path, machine: Machine, all: &[Judged]) -> String {
    let run = run.display().to_string();
    let run = printable(&run);
    let mut suite = TestSuite::new(run.as_ref());
    for judged in all {
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
        case.set_classname(run.as_ref());
        suite.add_test_case(case);
    }
    let mut report = Report::new("inerter");
    report.add_test_suite(suite);
    // It is written to memory.
    report.to_string().unwrap_or_default()
}

/// A row for each parameter.
fn csv(run: &Path, machine: Machine, all: &[Judged]) -> Vec<u8> {
    let mut table = csv::Writer::from_writer(Vec::new());
    let limit = |number: Option<f64>| number.map(|number| number.to_string()).unwrap_or_default();
    let number = |number: Option<f32>| number.map(|number| number.to_string()).unwrap_or_default();
    let head =
        ["run", "parameter", "value", "u95", "min", "max", "verdict", "needed_u95", "reason"].map(str::to_string);
    let rows = all.iter().map(|judged| {
        [
            printable(&run.display().to_string()).into_owned(),
            judged.name(machine).into(),
            number(judged.value),
            number(judged.u95),
            limit(judged.min),
            limit(judged.max),
            judged.verdict.to_string().to_lowercase(),
            number(judged.needed_u95),
            judged.reason.unwrap_or_default().into(),
        ]
    });
    for row in std::iter::once(head).chain(rows) {
        // It is written to memory, and each row has as many cells.
        let _ = table.write_record(row);
    }
    table.into_inner().unwrap_or_default()
}
