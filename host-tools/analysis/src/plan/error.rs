//! Why no motion can be planned, always with advice.

use inerter_data::{settings::SettingsInputError, wants::WantError};
use inerter_plant::PlantError;
use miette::Diagnostic;

/// Why no motion can be planned.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum PlanError {
    /// The expected device or its motion is invalid.
    #[error("the expected device cannot be simulated: {0}")]
    #[diagnostic(code(inerter::plan::device), help("`inerter plan --help` lists every parameter of the device"))]
    Device(#[from] PlantError),

    /// The given motion is invalid.
    #[error("the motion cannot be used: {0}")]
    #[diagnostic(code(inerter::plan::motion), help("`inerter simulate --help` lists every motion"))]
    Motion(PlantError),

    /// The wanted intervals cannot be parsed.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Wants(#[from] WantError),

    /// The settings are invalid.
    #[error(transparent)]
    #[diagnostic(transparent)]
    Settings(#[from] SettingsInputError),

    /// The expected device, or the limits of the rig, are not stated.
    #[error("{missing} is missing: a plan needs the expected device and the limits of the rig")]
    #[diagnostic(code(inerter::plan::unstated), help("{help}"))]
    Unstated { missing: &'static str, help: &'static str },

    /// The rate of a file to write is invalid.
    #[error("--rate-hz: {rate_hz} {problem}")]
    #[diagnostic(
        code(inerter::plan::rate),
        help("give 100 to 192000 Hz, for a WAV a whole number; the default is the setting sample_rate_hz")
    )]
    Rate { rate_hz: f64, problem: &'static str },

    /// A limit is invalid.
    #[error("{name}: {value} is not {wanted}")]
    #[diagnostic(code(inerter::plan::limit), help("{help}"))]
    Limit { name: &'static str, value: f64, wanted: &'static str, help: &'static str },

    /// Two limits exclude each other.
    #[error("{one} and {other} contradict each other: {why}")]
    #[diagnostic(code(inerter::plan::conflict), help("{help}"))]
    Conflict { one: &'static str, other: &'static str, why: String, help: &'static str },

    /// No motion within the limits identifies anything.
    #[error("no motion within these limits identifies inertance and friction: {why}")]
    #[diagnostic(
        code(inerter::plan::nothing),
        help("allow a longer stroke, a higher speed or frequency, or a larger force")
    )]
    Nothing { why: String },

    /// A run says too little about the device to plan another one.
    #[error("this run does not describe the device well enough to plan from it: its inertance is not known")]
    #[diagnostic(
        code(inerter::plan::run),
        help("state the expected device: --inertance-kg, --viscous-n-s-per-m and --coulomb-n")
    )]
    Run,

    /// The wanted intervals are out of reach.
    #[error("{what}")]
    #[diagnostic(code(inerter::plan::missed), help("{help}"))]
    Missed { what: String, help: String },
}
