//! Limits that a device is checked against, and the files that hold the verdicts.

use std::path::{Path, PathBuf};

use inerter_core::Machine;
use inerter_data::{
    limits::{Judged, Limits, LimitsError, Verdict, verdict},
    output,
    words::csv_text,
};

use super::{print::csv_line, reports::junit, terminal::tidy_at_interrupts};
use crate::{
    Error,
    error::{Failure, is_broken_pipe},
    feature::Feature,
};

/// The limits that a device is checked against.
#[derive(clap::Args)]
pub struct LimitsArgs {
    /// Check the parameters against limits: TOML with a table for each, such as `[coulomb_n]`, and `min` or `max` below
    /// it
    #[arg(long, value_name = "FILE.toml", help_heading = "Limits")]
    limits: Option<PathBuf>,
    /// Write the verdicts as JUnit XML; undecided ones are errors there
    #[arg(long, value_name = "FILE.xml", requires = "limits", help_heading = "Limits")]
    junit: Option<PathBuf>,
    /// Write the verdicts as CSV
    #[arg(long, value_name = "FILE.csv", requires = "limits", help_heading = "Limits")]
    verdicts: Option<PathBuf>,
}

/// A run and the verdicts on its limits.
pub struct Held<'a> {
    /// Its name: a file, or the run's name in a store.
    pub run: String,
    /// Whether it is a file.
    pub is_file: bool,
    /// Its machine kind.
    pub machine: Machine,
    /// The verdict on each limit.
    pub judged: &'a [Judged],
}

impl LimitsArgs {
    /// Rejects output files that already exist, before any work is done: the command's own (`written`) and these. Files
    /// in `read` are never overwritten. Ctrl-C leaves none half written.
    pub fn check<'a>(
        &'a self,
        read: impl IntoIterator<Item = &'a Path>,
        written: impl IntoIterator<Item = &'a Path>,
        force: bool,
    ) -> Result<(), Error> {
        Feature::REPORTS.check("--junit", self.junit.is_some(), "--verdicts writes the same as CSV")?;
        tidy_at_interrupts();
        let own = self.junit.iter().chain(&self.verdicts).map(PathBuf::as_path);
        let all: Vec<&Path> = written.into_iter().chain(own).collect();
        output::refuse_inputs(&all, read.into_iter().chain(self.limits.as_deref()))?;
        for (number, path) in all.iter().enumerate() {
            output::refuse_inputs(&[*path], all.iter().skip(number + 1).copied())?;
        }
        let mut files = all.into_iter().filter(|_| !force);
        Ok(files.try_for_each(output::refuse_existing)?)
    }

    /// Whether any were given.
    pub const fn are_given(&self) -> bool {
        self.limits.is_some()
    }

    /// The limits, if any were given.
    pub fn read(&self, machine: Machine) -> Result<Option<Limits>, LimitsError> {
        self.limits.as_deref().map(|path| Limits::read(path, machine)).transpose()
    }

    /// Writes the files.
    pub fn write(&self, force: bool, runs: &[Held]) -> Result<(), Error> {
        if let Some(path) = &self.junit {
            output::write(path, force, junit(runs.iter().map(|held| (held.run.as_str(), held.machine, held.judged)))?)?;
        }
        if let Some(path) = &self.verdicts {
            output::write(path, force, csv(runs))?;
        }
        Ok(())
    }
}

/// Fails unless every run passes every limit.
pub fn prove(runs: &[Held]) -> Result<(), Error> {
    let count = |held: &Held, wanted: Verdict| held.judged.iter().filter(|judged| judged.verdict == wanted).count();
    let unproven: Vec<&Held> = runs.iter().filter(|held| verdict(held.judged) != Verdict::Pass).collect();
    let runs_with = |wanted: Verdict| unproven.iter().filter(|held| verdict(held.judged) == wanted).count();
    let failure = match unproven.as_slice() {
        [] => return Ok(()),
        [held] if runs.len() == 1 && held.is_file => Failure::Limits {
            run: held.run.clone(),
            fail: count(held, Verdict::Fail),
            undecided: count(held, Verdict::Undecided),
            of: held.judged.len(),
            wants: held.judged.iter().filter_map(|judged| judged.want(held.machine)).collect::<Vec<_>>().join(", "),
        },
        _ => Failure::LimitsOfRuns {
            fail: runs_with(Verdict::Fail),
            undecided: runs_with(Verdict::Undecided),
            of: runs.len(),
            are_files: unproven.iter().all(|held| held.is_file),
        },
    };
    Err(failure.into())
}

/// The result of writing output; if `goes_on`, a closed reader is no reason to stop.
pub fn heard(said: Result<(), Error>, goes_on: bool) -> Result<(), Error> {
    match said {
        Err(error) if goes_on && is_broken_pipe(&error) => Ok(()),
        said => said,
    }
}

/// One line about a limit.
pub fn judged_line(machine: Machine, judged: &Judged) -> String {
    format!("{:<9}  {}", judged.verdict, judged.words(machine))
}

/// A row for each parameter of each run.
fn csv(runs: &[Held]) -> String {
    fn number(number: Option<impl ToString>) -> String {
        number.map(|number| number.to_string()).unwrap_or_default()
    }
    let text = |text: &str| csv_text(text).into_owned();
    let head =
        ["run", "parameter", "value", "u95", "min", "max", "verdict", "needed_u95", "reason"].map(str::to_string);
    let all = runs.iter().flat_map(|held| held.judged.iter().map(move |judged| (held, judged)));
    let rows = all.map(|(held, judged)| {
        [
            text(&held.run),
            text(judged.name(held.machine)),
            number(judged.value),
            number(judged.u95),
            number(judged.min),
            number(judged.max),
            text(&judged.verdict.to_string().to_lowercase()),
            number(judged.needed_u95),
            text(judged.reason.unwrap_or_default()),
        ]
    });
    std::iter::once(head).chain(rows).map(csv_line).collect()
}
