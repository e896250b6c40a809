//! Failures of the program itself, and how any failure is shown.
//!
//! There is one enum per boundary, each beside its reader or writer; here are those that belong to no library. Every
//! message names the file, field, line, port or version, and its help says what to do next.

use std::{fmt::Display, io::ErrorKind, path::PathBuf};

use inerter_data::{
    output::OutputError,
    words::{plural, printable, shortened_to},
};
use miette::{Diagnostic, LabeledSpan, SourceCode};

/// Any failure, with help for a person.
pub use miette::Report as Error;

/// A failure of a command as a whole.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum Failure {
    /// The program was built without the requested feature.
    #[error("this `inerter` was built without its feature `{feature}`, which {needed_by} needs")]
    #[diagnostic(
        code(inerter::built_without),
        help(
            "build it with `cargo install --path host-tools/inerter`, or add `--features {feature}` to your own build command{instead}"
        )
    )]
    BuiltWithout {
        /// The feature.
        feature: &'static str,
        /// The command or option that needs it.
        needed_by: &'static str,
        /// What works without it; may be empty.
        instead: String,
    },
    /// This machine cannot use a device that is there.
    #[error("{} found", plural(*problems as u64, "problem"))]
    #[diagnostic(code(inerter::doctor), help("each is listed above with what to do"))]
    Doctor { problems: usize },
    /// Two results would both go to standard output.
    #[error("with --csv -, standard output carries the samples: --json and --estimates need a file")]
    #[diagnostic(code(inerter::standard_output), help("name a file: --csv run.csv"))]
    StandardOutput,
    /// Some recordings were not added.
    #[error("{failed} of {of} recordings were not added")]
    #[diagnostic(
        code(inerter::store::not_added),
        help("each is listed above with the reason; the others are in the store")
    )]
    NotAdded { failed: usize, of: usize },
    /// Some runs of a store were not replayed.
    #[error("{failed} of {of} runs could not be replayed")]
    #[diagnostic(
        code(inerter::store::not_replayed),
        help("the batch holds each of them with its error, and the others with their results")
    )]
    NotReplayed { failed: usize, of: usize },
    /// Files of a store have changed since they were written.
    #[error("{files} in the store {url} {} not as {} written", is_or_are(*files), if *files == 1 { "it was" } else { "they were" }, files = plural(*files as u64, "file"))]
    #[diagnostic(
        code(inerter::store::verify),
        help(
            "`inerter store verify {url} --repair` rebuilds the derived files from intact recordings; if a recording is damaged, remove the run and add it again from a copy"
        )
    )]
    StoreDamage { url: String, files: usize },
    /// Runs of a store have too many different columns for a CSV.
    #[error(
        "the selected runs of the store {url} have more than {most} different columns together: too many for a CSV"
    )]
    #[diagnostic(
        code(inerter::store::wide_csv),
        help(
            "`--json` prints each run with its own columns; `--device`, `--from`, `--to` or a condition of `inerter store query {url}` select fewer runs; nothing was printed"
        )
    )]
    WideCsv { url: String, most: usize },
    /// A device is not shown to be within its limits.
    #[error("{run} is not proven to be within its limits: {fail} of {of} fail, {undecided} undecided")]
    #[diagnostic(code(inerter::limits::verdict), help("{}", limits_help(run, wants)))]
    Limits {
        run: String,
        fail: usize,
        undecided: usize,
        of: usize,
        /// What would decide the limits that need a narrower interval.
        wants: String,
    },
    /// The same for several runs.
    #[error("{} of {of} runs {} not proven to be within the limits: {fail} beyond a limit, {undecided} undecided", fail + undecided, is_or_are(fail + undecided))]
    #[diagnostic(
        code(inerter::limits::verdict),
        help("{}", runs_help(*are_files))
    )]
    LimitsOfRuns {
        /// Runs in which at least one limit fails.
        fail: usize,
        undecided: usize,
        of: usize,
        /// Whether they are files, or runs of a store.
        are_files: bool,
    },
    /// Nothing was checked against limits.
    #[error("no run matches: nothing was checked against the limits")]
    #[diagnostic(code(inerter::limits::nothing), help("`inerter store ls STORE` lists the runs that there are"))]
    NothingHeld,
}

/// A self-test that did not pass.
#[derive(Debug, PartialEq, thiserror::Error, Diagnostic)]
pub enum SelfTestError {
    /// The device cannot be measured, or its firmware is too old.
    #[error("{name} ({firmware}) cannot measure itself")]
    #[diagnostic(
        code(inerter::selftest::unsupported),
        help("update the firmware of a board with `inerter update`; a simulated device has nothing to measure")
    )]
    CannotMeasure {
        /// Port or address.
        name: String,
        /// Its firmware.
        firmware: String,
    },

    /// Two results would share a file.
    #[error("the page {page} and its JSON file {json} would be one file", page = page.display(), json = json.display())]
    #[diagnostic(code(inerter::selftest::same_name), help("give the page another ending, such as .html"))]
    SameName {
        page: PathBuf,
        /// The JSON file beside it.
        json: PathBuf,
    },

    /// The board is not as it should be.
    #[error("the board did not pass: {failed}")]
    #[diagnostic(
        code(inerter::selftest::failed),
        help("each line above that says FAIL names the likely cause; `-o PAGE.html` writes a report to pass on")
    )]
    Failed {
        /// The checks that failed.
        failed: String,
    },
}

/// A question that is not answered.
#[derive(Debug, PartialEq, thiserror::Error, Diagnostic)]
pub enum DialogueError {
    /// An answer that is not one of the accepted ones.
    #[error("`{text}` is not a number {known}")]
    #[diagnostic(code(inerter::calibrate::answer), help("write for example 4.998 or 4,998"))]
    Answer {
        text: String,
        /// The accepted answers.
        known: String,
    },

    /// Nobody answers the question.
    #[error("no answer: standard input ended before the calibration")]
    #[diagnostic(
        code(inerter::calibrate::nobody),
        help("run it in a terminal, or give a line for each question; nothing was changed on the device")
    )]
    Nobody,

    /// There is no terminal to ask on.
    #[error("the wizard asks questions, but this is not a terminal")]
    #[diagnostic(
        code(inerter::calibrate::no_terminal),
        help(
            "`inerter calibrate --help` lists the steps, each a command for scripts; nothing was changed on the device"
        )
    )]
    NoTerminal,

    /// Nobody is there to confirm.
    #[error("erasing settings needs confirmation, but this is not a terminal")]
    #[diagnostic(code(inerter::settings::unconfirmed), help("add --yes; nothing was changed"))]
    Unconfirmed,

    /// The same, for removing runs.
    #[error("removing runs needs confirmation, but this is not a terminal")]
    #[diagnostic(code(inerter::store::unconfirmed), help("add --yes; nothing was removed"))]
    UnconfirmedRemoval,
}

/// Maximum length of a message, in characters: it may repeat a name of any length from a file.
const MOST_LETTERS: usize = 2000;

/// A failure made safe for a terminal: its text may quote files and devices.
#[derive(Debug, thiserror::Error)]
#[error("{}", shown(&.0.to_string()))]
pub struct Shown(pub Error);

fn shown(text: &str) -> String {
    printable(&shortened_to(MOST_LETTERS, text)).into_owned()
}

impl Diagnostic for Shown {
    fn code<'a>(&'a self) -> Option<Box<dyn Display + 'a>> {
        self.0.code()
    }

    fn help<'a>(&'a self) -> Option<Box<dyn Display + 'a>> {
        self.0.help().map(|help| Box::new(shown(&help.to_string())) as Box<dyn Display>)
    }

    fn source_code(&self) -> Option<&dyn SourceCode> {
        self.0.source_code()
    }

    fn labels(&self) -> Option<Box<dyn Iterator<Item = LabeledSpan> + '_>> {
        self.0.labels()
    }
}

/// True if the reader of our output has gone away, which is not a fault: `inerter replay run.csv | head`.
pub fn is_broken_pipe(error: &Error) -> bool {
    let output = match error.downcast_ref() {
        Some(inerter_data::Error::Output(output)) => Some(output),
        _ => error.downcast_ref(),
    };
    matches!(output, Some(OutputError::Write { source, .. }) if source.kind() == ErrorKind::BrokenPipe)
}

fn is_or_are(count: usize) -> &'static str {
    if count == 1 { "is" } else { "are" }
}

/// What to do about runs that are not shown to be within limits.
fn runs_help(are_files: bool) -> &'static str {
    if are_files {
        "`inerter replay FILE --limits ..` says what is wrong with one run, and which motion would decide"
    } else {
        "`inerter store get STORE RUN -o run.mcap`, then `inerter replay run.mcap --limits ..` says what is wrong, and which \
         motion would decide"
    }
}

/// What to do about a device that is not shown to be within its limits.
fn limits_help(run: &str, wants: &str) -> String {
    if wants.is_empty() {
        return format!(
            "`inerter diagnose {run}` says what breaks the law, `inerter plan {run}` designs a more informative motion"
        );
    }
    format!("to design a motion that would decide: `inerter plan {run} --want \"{wants}\"`")
}
