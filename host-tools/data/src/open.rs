//! A run from a file of any supported kind.

use std::path::Path;

use crate::{
    csv::{self, CsvError},
    error::Error,
    recording,
    run::Run,
    settings::Overrides,
};

/// Reads a recording or a CSV file, distinguished by their first bytes; `overrides` take precedence over the settings
/// of a recording or the defaults.
pub fn open(path: &Path, overrides: &Overrides) -> Result<Run, Error> {
    if is_recording(path)? { recording::read_run(path, overrides) } else { csv::to_run(csv::read(path)?, overrides) }
}

/// Whether a file is a recording, and not a CSV.
pub(crate) fn is_recording(path: &Path) -> Result<bool, CsvError> {
    recording::is_recording(path).map_err(|source| CsvError::Read { path: path.into(), source })
}
