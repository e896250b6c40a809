//! Every way in which the program can fail.
//!
//! One enum per boundary, each beside its reader or writer; this one only joins them. Every message names the
//! file, field, line, port or version, and its help says what to do next.

use inerter_analysis::{calibrate::CalibrateError, contact::ContactError, fit::FitError, identify::IdentifyError};
use inerter_data::{
    backup::BackupError, csv::CsvError, output::OutputError, recording::RecordingError, settings::SettingsInputError,
    words::plural,
};
use inerter_device::{DeviceError, flash::FlashError, image::ImageError, update::UpdateError};
use inerter_simulate::SimulateError;
use inerter_view::page::PageError;
use miette::Diagnostic;

use crate::monitor::MonitorError;

/// Any failure, with help for a person.
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
    /// A setting is unknown, or its value cannot be.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Settings(#[from] SettingsInputError),
    /// The device cannot be reached, or what it says cannot be used.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Device(#[from] DeviceError),
    /// Something cannot be written.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Output(#[from] OutputError),
    /// The user pressed Ctrl-C where the work could not be finished early.
    #[error("interrupted")]
    #[diagnostic(code(inerter::interrupted), help("nothing was left half done; start again when you like"))]
    Interrupted,
    /// This machine cannot use a device that is there.
    #[error("{} found", plural(*problems as u64, "problem"))]
    #[diagnostic(code(inerter::doctor), help("each one says above what to do"))]
    Doctor {
        /// How many.
        problems: usize,
    },
    /// A simulation cannot be set up.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Simulate(#[from] SimulateError),
    /// A fit has nothing to say.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Fit(#[from] FitError),
    /// There is no stiffness to be had.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Contact(#[from] ContactError),
    /// Samples, loads or displacements give no calibration.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Calibrate(#[from] CalibrateError),
    /// A backup is of another device.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Backup(#[from] BackupError),
    /// A figure cannot be had.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Page(#[from] PageError),
    /// Nothing can be identified.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Identify(#[from] IdentifyError),
    /// A file is no firmware for the board.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Image(#[from] ImageError),
    /// The monitor cannot show something where it was asked to.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Monitor(#[from] MonitorError),
    /// An update over USB failed.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Update(#[from] UpdateError),
    /// Programming through a probe failed.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Flash(#[from] FlashError),
}

impl From<CsvError> for Error {
    fn from(error: CsvError) -> Self {
        Self::Csv(Box::new(error))
    }
}

impl From<inerter_data::Error> for Error {
    fn from(error: inerter_data::Error) -> Self {
        use inerter_data::Error;
        match error {
            Error::Csv(error) => Self::Csv(error),
            Error::Recording(error) => Self::Recording(error),
            Error::Settings(error) => Self::Settings(error),
            Error::Output(error) => Self::Output(error),
            Error::Interrupted => Self::Interrupted,
        }
    }
}

impl Error {
    /// True when whoever read our output has gone away, which is no fault: `inerter replay run.csv | head`.
    pub fn is_broken_pipe(&self) -> bool {
        matches!(self, Self::Output(OutputError::Write { source, .. }) if source.kind() == std::io::ErrorKind::BrokenPipe)
    }
}
