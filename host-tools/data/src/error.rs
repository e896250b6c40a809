//! Everything that may fail between a file and a run.

use miette::Diagnostic;

use crate::{csv::CsvError, output::OutputError, recording::RecordingError, settings::SettingsInputError};

/// A file that cannot be used or written, or settings that do not fit it.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum Error {
    /// A CSV file cannot be used.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Csv(#[from] Box<CsvError>),
    /// A recording cannot be used.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Recording(#[from] RecordingError),
    /// A setting is unknown, or its value is invalid.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Settings(#[from] SettingsInputError),
    /// Something cannot be written.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Output(#[from] OutputError),
    /// The caller cancelled work that cannot be finished early.
    #[error("interrupted")]
    #[diagnostic(code(inerter::interrupted), help("no unfinished output remains; run the command again"))]
    Interrupted,
}

impl From<CsvError> for Error {
    fn from(error: CsvError) -> Self {
        Self::Csv(Box::new(error))
    }
}
