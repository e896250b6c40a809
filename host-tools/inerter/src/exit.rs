//! Exit codes, a public contract described in `docs/CLI.md`, and the code for each failure.

use inerter_analysis::{
    calibrate::CalibrateError, compare::CompareError, fit::FitError, identify::IdentifyError, plan::PlanError,
    skew::SkewError,
};
use inerter_data::{limits::LimitsError, recording::RecordingError};
use inerter_device::{DeviceError, flash::FlashError, update::UpdateError};
use inerter_flags::ConfigError;
use inerter_simulate::SimulateError;

use crate::{
    error::{Error, SelfTestError},
    monitor::MonitorError,
};

/// Everything requested was done.
pub const OK: u8 = 0;
/// A failure that none of the other codes describes.
pub const OTHER: u8 = 1;
/// The command line itself is wrong; clap ends the program with this one.
pub const USAGE: u8 = 2;
/// An input file is missing, damaged, or not what it should be.
pub const INPUT: u8 = 3;
/// A setting or parameter is unknown or has an invalid value.
pub const SETTINGS: u8 = 4;
/// The device cannot be found or opened.
pub const NO_DEVICE: u8 = 5;
/// The device vanished, fell silent or refused while in use.
pub const DEVICE_LOST: u8 = 6;
/// The device speaks another version of the wire format.
pub const WIRE_VERSION: u8 = 7;
/// The output cannot be written: disk full, no permission, file in the way.
pub const OUTPUT: u8 = 8;
/// The motion cannot identify what was asked for.
pub const NOT_SHOWN: u8 = 9;
/// The board did not pass its self-test, or a device is not shown to be within its limits.
pub const NOT_PASSED: u8 = 10;
/// Ctrl-C, by shell convention.
pub const INTERRUPTED: u8 = 130;

/// The exit code for this failure.
pub fn code(error: &Error) -> u8 {
    use Error::*;
    match error {
        Config(ConfigError::File { .. }) => INPUT,
        Config(
            ConfigError::Toml { .. }
            | ConfigError::Found { .. }
            | ConfigError::Unknown { .. }
            | ConfigError::Value { .. },
        ) => SETTINGS,
        Data(error) => data(error),
        Image(_) | NotAdded { .. } | NotReplayed { .. } | StoreDamage { .. } | WideCsv { .. } => INPUT,
        #[cfg(feature = "tables")]
        Store(error) => store(error),
        Doctor { .. } => NO_DEVICE,
        SelfTest(SelfTestError::CannotMeasure { .. }) => DEVICE_LOST,
        SelfTest(SelfTestError::Failed { .. }) => NOT_PASSED,
        SelfTest(SelfTestError::SameName { .. }) | Dialogue(_) | Error::StandardOutput | BuiltWithout { .. } => USAGE,
        Contact(_) => NOT_SHOWN,
        Fit(error) => fit(error),
        Backup(_) | Merge(_) => SETTINGS,
        LimitsFile(LimitsError::File { .. }) => INPUT,
        LimitsFile(LimitsError::Form { .. }) => SETTINGS,
        Limits { .. } | LimitsOfRuns { .. } | Error::NothingHeld => NOT_PASSED,
        Compare(CompareError::One) => USAGE,
        Compare(CompareError::Machine { .. }) => SETTINGS,
        Skew(error) => skew(error),
        #[cfg(feature = "reports")]
        Page(error) => match error {
            inerter_view::page::PageError::NotShown { .. } => NOT_SHOWN,
            inerter_view::page::PageError::Format { .. } => USAGE,
        },
        Device(error) => device(error),
        Simulate(error) => simulate(error),
        Calibrate(error) => calibrate(error),
        Identify(error) => match error {
            IdentifyError::TooShort { .. } => INPUT,
            IdentifyError::Stages { .. } => USAGE,
            IdentifyError::Terminal | IdentifyError::Diverged => NOT_SHOWN,
            IdentifyError::Fit(error) => fit(error),
            IdentifyError::Settings(_) => SETTINGS,
        },
        Plan(error) => plan(error),
        Monitor(error) => match error {
            MonitorError::NotLoopback { .. } | MonitorError::Exposed { .. } | MonitorError::Address { .. } => USAGE,
            MonitorError::Listen { .. } | MonitorError::Terminal { .. } => OUTPUT,
            MonitorError::Random { .. } => OTHER,
        },
        Update(error) => update(error),
        Flash(error) => flash(error),
    }
}

fn data(error: &inerter_data::Error) -> u8 {
    use inerter_data::Error::*;
    match error {
        Csv(_) => INPUT,
        Recording(error) => recording(error),
        Settings(_) => SETTINGS,
        Output(_) => OUTPUT,
        inerter_data::Error::Interrupted => INTERRUPTED,
    }
}

#[cfg(feature = "tables")]
fn store(error: &inerter_store::StoreError) -> u8 {
    use inerter_store::StoreError::{self, *};
    match error {
        Data(error) => data(error),
        Access { action, .. } if ["written", "removed"].contains(action) => OUTPUT,
        Foreign { .. } => OUTPUT,
        OtherBatch { .. } | Address { .. } | Batch { .. } | Ambiguous { .. } | Condition { .. } => USAGE,
        StoreError::None { .. }
        | Newer { .. }
        | Access { .. }
        | Damaged { .. }
        | NoRun { .. }
        | NoRecording { .. }
        | Changed { .. }
        | LongRow { .. }
        | LongTexts { .. } => INPUT,
    }
}

fn recording(error: &RecordingError) -> u8 {
    use RecordingError::*;
    match error {
        ForeignVersion { .. } => WIRE_VERSION,
        Read { .. }
        | WrongKind { .. }
        | NoChannel { .. }
        | Compressed { .. }
        | NoSamples { .. }
        | NoSettings { .. }
        | EmptyRange { .. }
        | OtherDevice { .. }
        | OtherSetting { .. }
        | Overlap { .. } => INPUT,
    }
}

fn fit(error: &FitError) -> u8 {
    match error {
        FitError::Torn => DEVICE_LOST,
        FitError::TooShort { .. } | FitError::Motion => NOT_SHOWN,
    }
}

fn skew(error: &SkewError) -> u8 {
    use SkewError::*;
    match error {
        Fit(error) => fit(error),
        Settings(_) => SETTINGS,
        SingleTone { .. } | TooNoisy { .. } | Beyond { .. } | Backwards { .. } => NOT_SHOWN,
    }
}

fn device(error: &DeviceError) -> u8 {
    use DeviceError::*;
    match error {
        NoneFound { .. }
        | SeveralFound { .. }
        | Missing { .. }
        | Permission { .. }
        | Busy { .. }
        | Open { .. }
        | Connect { .. }
        | TurnedAway { .. } => NO_DEVICE,
        Silent { .. } | NoReply { .. } | Flood { .. } | Vanished { .. } | Refused { .. } => DEVICE_LOST,
        WireVersion { .. } => WIRE_VERSION,
        // With its path: a bare name would become a catch-all binding if the variant were renamed.
        DeviceError::Interrupted => INTERRUPTED,
    }
}

fn simulate(error: &SimulateError) -> u8 {
    use SimulateError::*;
    match error {
        Setup { .. } | Rate { .. } | Change { .. } | Hand { .. } => SETTINGS,
        Format { .. } => USAGE,
        Endpoint { .. } | NoImage | NoQemu { .. } | QemuEnded { .. } => NO_DEVICE,
        Data(error) => data(error),
    }
}

fn update(error: &UpdateError) -> u8 {
    use UpdateError::*;
    match error {
        NoDevice { .. } | Several { .. } | Usb { .. } | Permission { .. } | Open { .. } | OtherChip { .. } => NO_DEVICE,
        CannotEnter { .. }
        | CannotAsk { .. }
        | DidNotAppear { .. }
        | SingleBank { .. }
        | SmallFlash { .. }
        | Lost { .. }
        | Refused { .. }
        | Stuck { .. }
        | Verify { .. }
        | NotBack { .. }
        | StaysInDfu { .. }
        | OtherVersion { .. } => DEVICE_LOST,
        OtherBoard { .. } => INPUT,
        UpdateError::Interrupted => INTERRUPTED,
        Device(error) => device(error),
    }
}

fn calibrate(error: &CalibrateError) -> u8 {
    use CalibrateError::*;
    match error {
        TooFewPoints { .. } | Missing(..) => USAGE,
        TooShort { .. }
        | Saturated { .. }
        | FullScale { .. }
        | Unsteady { .. }
        | Moving { .. }
        | Unchanged { .. }
        | BothWays { .. }
        | Crooked { .. }
        | Counts { .. }
        | Ambiguous { .. }
        | NoMotion
        | Unfit { .. } => NOT_SHOWN,
    }
}

fn plan(error: &PlanError) -> u8 {
    use PlanError::*;
    match error {
        Unstated { .. } => USAGE,
        Device(_) | Motion(_) | Wants(_) | Settings(_) | Limit { .. } | Conflict { .. } | Rate { .. } => SETTINGS,
        Nothing { .. } | Run { .. } | Missed { .. } => NOT_SHOWN,
    }
}

fn flash(error: &FlashError) -> u8 {
    use FlashError::*;
    match error {
        Program { .. } => DEVICE_LOST,
        Chip { .. } => USAGE,
        BuiltWithout
        | NoProbe
        | SeveralProbes { .. }
        | NoSuchProbe { .. }
        | Permission { .. }
        | Open { .. }
        | Attach { .. }
        | OtherChip { .. }
        | SmallFlash { .. }
        | SingleBank
        | NoStart => NO_DEVICE,
    }
}
