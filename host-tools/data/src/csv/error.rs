//! Why a CSV file cannot be used: always the line, the column and what to do.

use std::{path::PathBuf, sync::Arc};

use miette::{Diagnostic, SourceSpan};

use super::excerpt::Excerpt;

/// A CSV file that cannot be used.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum CsvError {
    /// The file cannot be opened or read.
    #[error("{path} cannot be read: {source}", path = path.display())]
    #[diagnostic(code(inerter::input::read), help("check the name and that you may read the file"))]
    Read { path: PathBuf, source: std::io::Error },

    /// Nothing in the file, or only comments.
    #[error("{file} is empty")]
    #[diagnostic(
        code(inerter::input::empty),
        help("a CSV has a header line `{header}` and one line per sample; was the recording stopped at once?")
    )]
    Empty { file: String, header: &'static str },

    /// Not a text file at all.
    #[error("{file} is neither a recording nor a CSV file: it looks like {kind}")]
    #[diagnostic(code(inerter::input::kind), help("{advice}"))]
    WrongKind { file: String, kind: &'static str, advice: &'static str },

    /// The line is too long for samples.
    #[error("{file}, line {line}: the line is longer than {longest} bytes")]
    #[diagnostic(
        code(inerter::csv::long),
        help("a CSV has one line per sample, with some numbers each; is this another kind of file?")
    )]
    LongLine { file: String, line: usize, longest: usize },

    /// The first line holds numbers instead of names.
    #[error("{text}: the header is missing: the first line holds numbers")]
    #[diagnostic(code(inerter::csv::header), help("put the column names above the numbers: {header}"))]
    NoHeader {
        header: &'static str,
        #[source_code]
        text: Arc<Excerpt>,
        #[label("names are expected here")]
        at: SourceSpan,
    },

    /// A column is missing.
    #[error("{text}: the column `{column}` is missing")]
    #[diagnostic(code(inerter::csv::column), help("{advice}"))]
    MissingColumn {
        column: &'static str,
        advice: String,
        #[source_code]
        text: Arc<Excerpt>,
        #[label("these are the columns")]
        at: SourceSpan,
    },

    /// A column occurs twice.
    #[error("{text}: the column `{column}` appears twice")]
    #[diagnostic(code(inerter::csv::twice), help("rename one of them: it is unclear which is meant"))]
    DuplicateColumn {
        column: &'static str,
        #[source_code]
        text: Arc<Excerpt>,
        #[label("the second one")]
        at: SourceSpan,
    },

    /// The columns belong to both kinds of machine.
    #[error("{text}: the column `{column}` does not go with `{other}`")]
    #[diagnostic(
        code(inerter::csv::machine),
        help("a linear machine has force_n and terminal_m, a rotary one torque_n_m and terminal_rad")
    )]
    MixedMachines {
        column: &'static str,
        other: &'static str,
        #[source_code]
        text: Arc<Excerpt>,
        #[label("this column")]
        at: SourceSpan,
    },

    /// The columns belong to one kind of machine, and the settings state the other.
    #[error("{file}: the column `{column}` contradicts the setting machine = {set}")]
    #[diagnostic(
        code(inerter::csv::machine),
        help("leave the setting `machine` out, or name the columns to match it: {force} and {terminal}")
    )]
    Machine { file: String, column: &'static str, set: u8, force: &'static str, terminal: &'static str },

    /// A line ends before its last needed column.
    #[error("{text}: the line ends before the column `{column}`")]
    #[diagnostic(
        code(inerter::csv::short),
        help("to leave a sample out, leave out its whole line, never a part of it")
    )]
    Short {
        column: &'static str,
        #[source_code]
        text: Arc<Excerpt>,
        #[label("this line")]
        at: SourceSpan,
    },

    /// A cell does not hold a valid number.
    #[error("{text}, column {column}: {what}")]
    #[diagnostic(code(inerter::csv::number), help("{advice}"))]
    Cell {
        column: &'static str,
        what: String,
        advice: &'static str,
        #[source_code]
        text: Arc<Excerpt>,
        #[label("here")]
        at: SourceSpan,
    },

    /// Time does not advance.
    #[error("{text}, column t_s: time {} from {previous} to {time}", if time < previous { "goes backwards" } else { "stands still" })]
    #[diagnostic(code(inerter::csv::time), help("{}", time_help(*previous, *time)))]
    Time {
        previous: f64,
        time: f64,
        #[source_code]
        text: Arc<Excerpt>,
        #[label("not later than the line before")]
        at: SourceSpan,
    },

    /// Too few samples to find the rate.
    #[error("{file} holds {samples} sample{}: at least 8 are needed to find the sample rate", if *samples == 1 { "" } else { "s" })]
    #[diagnostic(code(inerter::csv::few), help("give a longer recording"))]
    TooFew { file: String, samples: usize },

    /// The sample instants have no common spacing.
    #[error(
        "{file}, column t_s: the samples are not evenly spaced: {percent:.0} % of the intervals are more than 20 % off multiples of {median_s:.6} s"
    )]
    #[diagnostic(
        code(inerter::csv::irregular),
        help(
            "the estimator needs a fixed sample rate: export with the device's own time, or resample to an even spacing"
        )
    )]
    Irregular { file: String, percent: f64, median_s: f64 },

    /// More samples are missing than a 32-bit sample counter can distinguish from a restart.
    #[error("{file}, column t_s: a gap of {gap_s:.3e} s, while the samples are {median_s:.6} s apart")]
    #[diagnostic(code(inerter::csv::gap), help("check the times there; a file with two recordings must be split"))]
    Gap { file: String, gap_s: f64, median_s: f64 },

    /// A motion is not given at every point in time.
    #[error("{file}, column t_s: the points of a motion are not evenly spaced, or some are missing")]
    #[diagnostic(
        code(inerter::csv::uneven),
        help("write the displacement at every point, at one rate from the first to the last")
    )]
    Uneven { file: String },

    /// The rate lies outside what can be processed.
    #[error("{file}, column t_s: {} samples per second is outside {min_hz} to {max_hz}", rounded(*rate_hz))]
    #[diagnostic(code(inerter::csv::rate), help("check that t_s is in seconds"))]
    Rate { file: String, rate_hz: f64, min_hz: f64, max_hz: f64 },

    /// The setting `sample_rate_hz` contradicts the file.
    #[error("sample_rate_hz was set to {set_hz}, but t_s in {file} says {} Hz", rounded(*rate_hz))]
    #[diagnostic(
        code(inerter::csv::rate_conflict),
        help("leave sample_rate_hz out: the rate comes from t_s; the timebase enters the inertance squared")
    )]
    RateConflict { file: String, set_hz: f64, rate_hz: f64 },

    /// The encoder's scale was not given.
    #[error("{file} holds encoder counts, but not the displacement of one count")]
    #[diagnostic(
        code(inerter::csv::metres_per_count),
        help(
            "add --metres-per-count METRES: the lead divided by the counts per revolution, e.g. 0.005 m / 2048 = 2.44140625e-6"
        )
    )]
    MetresPerCount { file: String },

    /// A count or code does not fit.
    #[error("{file}, line {line}, column {column}: {value} does not fit at {scale}")]
    #[diagnostic(code(inerter::csv::range), help("{advice}"))]
    DoesNotFit { file: String, line: usize, column: &'static str, value: f64, scale: String, advice: &'static str },
}

/// A rate rounded to the micro-hertz.
fn rounded(rate_hz: f64) -> f64 {
    (rate_hz * 1e6).round() / 1e6
}

fn time_help(previous: f64, time: f64) -> &'static str {
    if time < previous {
        "were two recordings put together? Split the file there, or sort its lines by t_s"
    } else {
        "write t_s with more decimals, so that every sample has its own time"
    }
}
