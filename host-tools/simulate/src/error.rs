//! Why a simulation cannot be set up or run.

use std::io;

use inerter_data::{output::OutputError, settings::SettingsInputError};
use inerter_plant::PlantError;
use miette::Diagnostic;

/// Why a simulation cannot be set up.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum SimulateError {
    /// Device, motion or instruments are invalid.
    #[error("the simulation cannot be set up: {source}")]
    #[diagnostic(code(inerter::simulate::setup), help("`inerter simulate --help` lists every parameter and motion"))]
    Setup {
        #[from]
        source: PlantError,
    },

    /// The settings have another sample rate than the instruments.
    #[error("the setting sample_rate_hz = {set_hz} contradicts the {rate_hz} Hz of the simulated instruments")]
    #[diagnostic(
        code(inerter::simulate::rate),
        help("leave one of them out: the settings' rate is that of the simulated instruments")
    )]
    Rate { set_hz: f64, rate_hz: f64 },

    /// A change of the device is written incorrectly.
    #[error("--change `{text}` is not NAME=VALUE")]
    #[diagnostic(
        code(inerter::simulate::change),
        help("name a parameter of the device and its new value, for example --change inertance_kg=150")
    )]
    Change { text: String },

    /// The pseudo-terminal or TCP port cannot be opened.
    #[error("{what} cannot be opened: {source}")]
    #[diagnostic(code(inerter::simulate::endpoint), help("choose another port number, or 0 for any free one"))]
    Endpoint { what: String, source: io::Error },

    /// The output's name does not determine a format.
    #[error("{path} has neither the ending .mcap nor .csv")]
    #[diagnostic(code(inerter::simulate::format), help("end the name with .mcap for a recording or with .csv"))]
    Format { path: String },

    /// There is no such command.
    #[error("unknown bench command `{line}`")]
    #[diagnostic(
        code(inerter::simulate::hand),
        help(
            "write `load NEWTONS`, `mass KG`, `move METRES`, `turn REVOLUTIONS` or `shake MOTION`, such as shake \
            random@20s"
        )
    )]
    Hand { line: String },

    /// The image was not found.
    #[error("the firmware image for QEMU was not found")]
    #[diagnostic(
        code(inerter::simulate::image),
        help(
            "build it in the source tree with `cargo xtask build-firmware`, or give it with --image FILE; without \
            --qemu no image is needed"
        )
    )]
    NoImage,

    /// QEMU cannot be started.
    #[error("qemu-system-arm cannot be started: {source}")]
    #[diagnostic(
        code(inerter::simulate::qemu),
        help("install it (Debian: sudo apt-get install qemu-system-arm); without --qemu it is not needed")
    )]
    NoQemu { source: io::Error },

    /// QEMU ended unexpectedly.
    #[error("QEMU ended unexpectedly ({status}): {message}")]
    #[diagnostic(
        code(inerter::simulate::qemu_ended),
        help("is the image built for `-M netduinoplus2`, and is the port free?")
    )]
    QemuEnded { status: String, message: String },

    /// Settings do not fit, or the file cannot be written.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Data(#[from] inerter_data::Error),
}

impl From<SettingsInputError> for SimulateError {
    fn from(error: SettingsInputError) -> Self {
        Self::Data(error.into())
    }
}

impl From<OutputError> for SimulateError {
    fn from(error: OutputError) -> Self {
        Self::Data(error.into())
    }
}
