//! Why nothing can be identified.

use inerter_data::settings::SettingsInputError;
use miette::Diagnostic;

use crate::fit::FitError;

/// Why nothing can be identified.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum IdentifyError {
    /// No stretch is long enough.
    #[error(
        "{file} has no stretch of {needed_s:.0} s without a missing or a saturated sample: the longest is {longest_s:.1} s"
    )]
    #[diagnostic(
        code(inerter::identify::short),
        help("record at least a few seconds of motion, with the force within the load cell's range")
    )]
    TooShort { file: String, needed_s: f64, longest_s: f64 },

    /// Stages need files.
    #[error("--staged needs at least two files, one slow and one faster, and has {files}")]
    #[diagnostic(
        code(inerter::identify::stages),
        help(
            "give one file at low frequency for the friction and one at a higher frequency for the rest; a third, faster one validates"
        )
    )]
    Stages { files: usize },

    /// Stages need the terminal.
    #[error("--staged fits the complete model, which needs the terminal's displacement")]
    #[diagnostic(
        code(inerter::identify::terminal),
        help(
            "record with a terminal displacement sensor (--set terminal_sensor=1), or state the motion with --excite"
        )
    )]
    Terminal,

    /// The fit diverged.
    #[error("the complete model cannot be fitted: no parameters near the initial values explain the force")]
    #[diagnostic(
        code(inerter::identify::diverged),
        help(
            "check scales and directions of encoder, force and terminal (`inerter calibrate`), or begin with `inerter fit`"
        )
    )]
    Diverged,

    /// The estimator has nothing to begin with.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Fit(#[from] FitError),

    /// Settings of a file are invalid.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Settings(#[from] SettingsInputError),
}
