//! Every way in which the program can fail, and the exit code that each one ends with.
//!
//! One enum per boundary, each beside its reader or writer; this one only joins them. Every message names the
//! file, field, line, port or version, and its help says what to do next.

use miette::Diagnostic;

use crate::{
    backup::BackupError, calibrate::CalibrateError, contact::ContactError, csv::CsvError, device::DeviceError,
    fit::FitError, flash::FlashError, identify::IdentifyError, image::ImageError, monitor::MonitorError,
    output::OutputError, page::PageError, recording::RecordingError, settings::SettingsInputError,
    simulate::SimulateError, update::UpdateError,
};

/// Exit codes, a public contract described in `docs/CLI.md`.
pub mod exit {
    /// All that was asked has been done.
    pub const OK: u8 = 0;
    /// Something that none of the other codes describes.
    pub const OTHER: u8 = 1;
    /// The command line itself is wrong; clap ends the program with this one.
    pub const USAGE: u8 = 2;
    /// An input file is missing, damaged, or not what it should be.
    pub const INPUT: u8 = 3;
    /// A setting or parameter is unknown or has a value that cannot be.
    pub const SETTINGS: u8 = 4;
    /// The device cannot be found or opened.
    pub const NO_DEVICE: u8 = 5;
    /// The device vanished, fell silent or refused while in use.
    pub const DEVICE_LOST: u8 = 6;
    /// The device speaks another version of the wire format.
    pub const WIRE_VERSION: u8 = 7;
    /// The output cannot be written: disk full, no permission, file in the way.
    pub const OUTPUT: u8 = 8;
    /// The motion cannot show what was asked for.
    pub const NOT_SHOWN: u8 = 9;
    /// Ctrl-C, as shells count it.
    pub const INTERRUPTED: u8 = 130;
}

/// Any failure of the library, with help for a person.
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
    #[error("{} found", crate::report::plural(*problems as u64, "problem"))]
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

impl Error {
    /// The code that the program ends with, one of [`exit`].
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Csv(_) => exit::INPUT,
            Self::Recording(RecordingError::ForeignVersion { .. }) => exit::WIRE_VERSION,
            Self::Recording(_) => exit::INPUT,
            Self::Settings(SettingsInputError::Unconfirmed) => exit::USAGE,
            Self::Settings(_) => exit::SETTINGS,
            Self::Device(error) => error.exit_code(),
            Self::Output(error) => error.exit_code(),
            Self::Interrupted => exit::INTERRUPTED,
            Self::Doctor { .. } => exit::NO_DEVICE,
            Self::Simulate(error) => error.exit_code(),
            Self::Fit(error) => error.exit_code(),
            Self::Contact(error) => error.exit_code(),
            Self::Calibrate(error) => error.exit_code(),
            Self::Backup(error) => error.exit_code(),
            Self::Page(error) => error.exit_code(),
            Self::Identify(error) => error.exit_code(),
            Self::Image(error) => error.exit_code(),
            Self::Monitor(error) => error.exit_code(),
            Self::Update(error) => error.exit_code(),
            Self::Flash(error) => error.exit_code(),
        }
    }

    /// True when whoever read our output has gone away, which is no fault: `inerter replay run.csv | head`.
    pub fn is_broken_pipe(&self) -> bool {
        matches!(self, Self::Output(OutputError::Write { source, .. }) if source.kind() == std::io::ErrorKind::BrokenPipe)
    }
}
