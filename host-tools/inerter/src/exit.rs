//! Exit codes, a public contract described in `docs/CLI.md`, and which one each failure ends with.

use inerter_analysis::{
    calibrate::CalibrateError, compare::CompareError, fit::FitError, identify::IdentifyError, plan::PlanError,
    skew::SkewError,
};
use inerter_data::{limits::LimitsError, recording::RecordingError};
use inerter_device::{DeviceError, flash::FlashError, update::UpdateError};
use inerter_flags::ConfigError;
use inerter_simulate::SimulateError;
use inerter_store::StoreError;
use inerter_view::page::PageError;

use crate::{
    error::{Error, SelfTestError},
    monitor::MonitorError,
};

/// All that was asked has been done.
pub const OK: u8 = 0;
/// Something that none of the other codes describes.
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
/// The board did not pass its self-test, or a device is not proven to be within its limits.
pub const NOT_PASSED: u8 = 10;
/// Ctrl-C, as shells count it.
pub const INTERRUPTED: u8 = 130;

/// The code that the program ends with after this failure.
pub fn code(error: &Error) -> u8 {
    match error {
        Error::Config(ConfigError::File { .. }) => INPUT,
        Error::Config(
            ConfigError::Toml { .. }
            | ConfigError::Found { .. }
            | ConfigError::Unknown { .. }
            | ConfigError::Value { .. },
        ) => SETTINGS,
        Error::Data(error) => data(error),
        Error::Image(_) | Error::NotAdded { .. } | Error::NotReplayed { .. } | Error::StoreDamage { .. } => INPUT,
        Error::Store(error) => store(error),
        Error::Doctor { .. } => NO_DEVICE,
        Error::SelfTest(SelfTestError::CannotMeasure { .. }) => DEVICE_LOST,
        Error::SelfTest(SelfTestError::Failed { .. }) => NOT_PASSED,
        Error::SelfTest(SelfTestError::SameName { .. }) | Error::Dialogue(_) | Error::StandardOutput => USAGE,
        Error::Backup(_) => SETTINGS,
        Error::Contact(_) => NOT_SHOWN,
        Error::Fit(error) => fit(error),
        Error::Merge(_) => SETTINGS,
        Error::LimitsFile(LimitsError::File { .. }) => INPUT,
        Error::LimitsFile(LimitsError::Form { .. }) => SETTINGS,
        Error::Limits { .. } | Error::LimitsOfRuns { .. } | Error::NothingHeld => NOT_PASSED,
        Error::Compare(CompareError::One) => USAGE,
        Error::Compare(CompareError::Machine { .. }) => SETTINGS,
        Error::Skew(error) => skew(error),
        Error::Page(PageError::NotShown { .. }) => NOT_SHOWN,
        Error::Page(PageError::Format { .. }) => USAGE,
        Error::Device(error) => device(error),
        Error::Simulate(error) => simulate(error),
        Error::Calibrate(error) => match error {
            CalibrateError::TooFewPoints { .. } | CalibrateError::Missing(..) => USAGE,
            CalibrateError::TooShort { .. }
            | CalibrateError::Saturated { .. }
            | CalibrateError::FullScale { .. }
            | CalibrateError::Unsteady { .. }
            | CalibrateError::Moving { .. }
            | CalibrateError::Unchanged { .. }
            | CalibrateError::BothWays { .. }
            | CalibrateError::Crooked { .. }
            | CalibrateError::Counts { .. }
            | CalibrateError::Ambiguous { .. }
            | CalibrateError::NoMotion
            | CalibrateError::Unfit { .. } => NOT_SHOWN,
        },
        Error::Identify(error) => match error {
            IdentifyError::TooShort { .. } => INPUT,
            IdentifyError::Stages { .. } => USAGE,
            IdentifyError::Terminal | IdentifyError::Diverged => NOT_SHOWN,
            IdentifyError::Fit(error) => fit(error),
            IdentifyError::Settings(_) => SETTINGS,
        },
        Error::Plan(error) => match error {
            PlanError::Unstated { .. } => USAGE,
            PlanError::Device(_)
            | PlanError::Motion(_)
            | PlanError::Wants(_)
            | PlanError::Settings(_)
            | PlanError::Limit { .. }
            | PlanError::Conflict { .. }
            | PlanError::Rate { .. } => SETTINGS,
            PlanError::Nothing { .. } | PlanError::Run { .. } | PlanError::Missed { .. } => NOT_SHOWN,
        },
        Error::Monitor(error) => match error {
            MonitorError::BuiltWithout { .. }
            | MonitorError::NotLoopback { .. }
            | MonitorError::Exposed { .. }
            | MonitorError::Address { .. } => USAGE,
            MonitorError::Listen { .. } | MonitorError::Terminal { .. } => OUTPUT,
            MonitorError::Random { .. } => OTHER,
        },
        Error::Update(error) => update(error),
        Error::Flash(error) => match error {
            FlashError::Program { .. } => DEVICE_LOST,
            FlashError::Chip { .. } => USAGE,
            FlashError::BuiltWithout
            | FlashError::NoProbe
            | FlashError::SeveralProbes { .. }
            | FlashError::NoSuchProbe { .. }
            | FlashError::Permission { .. }
            | FlashError::Open { .. }
            | FlashError::Attach { .. }
            | FlashError::OtherChip { .. }
            | FlashError::SmallFlash { .. }
            | FlashError::SingleBank
            | FlashError::NoStart => NO_DEVICE,
        },
    }
}

fn data(error: &inerter_data::Error) -> u8 {
    match error {
        inerter_data::Error::Csv(_) => INPUT,
        inerter_data::Error::Recording(error) => recording(error),
        inerter_data::Error::Settings(_) => SETTINGS,
        inerter_data::Error::Output(_) => OUTPUT,
        inerter_data::Error::Interrupted => INTERRUPTED,
    }
}

fn store(error: &StoreError) -> u8 {
    match error {
        StoreError::Data(error) => data(error),
        StoreError::Access { action, .. } if ["written", "removed"].contains(action) => OUTPUT,
        StoreError::Foreign { .. } => OUTPUT,
        StoreError::OtherBatch { .. }
        | StoreError::Address { .. }
        | StoreError::Batch { .. }
        | StoreError::Ambiguous { .. }
        | StoreError::Condition { .. } => USAGE,
        StoreError::None { .. }
        | StoreError::Newer { .. }
        | StoreError::Access { .. }
        | StoreError::Damaged { .. }
        | StoreError::NoRun { .. }
        | StoreError::NoRecording { .. }
        | StoreError::Changed { .. } => INPUT,
    }
}

fn recording(error: &RecordingError) -> u8 {
    match error {
        RecordingError::ForeignVersion { .. } => WIRE_VERSION,
        RecordingError::Read { .. }
        | RecordingError::WrongKind { .. }
        | RecordingError::NoChannel { .. }
        | RecordingError::Compressed { .. }
        | RecordingError::NoSamples { .. }
        | RecordingError::NoSettings { .. }
        | RecordingError::EmptyRange { .. }
        | RecordingError::OtherDevice { .. }
        | RecordingError::OtherSetting { .. }
        | RecordingError::Overlap { .. } => INPUT,
    }
}

fn fit(error: &FitError) -> u8 {
    match error {
        FitError::Torn => DEVICE_LOST,
        FitError::TooShort { .. } | FitError::Motion => NOT_SHOWN,
    }
}

fn skew(error: &SkewError) -> u8 {
    match error {
        SkewError::Fit(error) => fit(error),
        SkewError::Settings(_) => SETTINGS,
        SkewError::SingleTone { .. }
        | SkewError::TooNoisy { .. }
        | SkewError::Beyond { .. }
        | SkewError::Backwards { .. } => NOT_SHOWN,
    }
}

fn device(error: &DeviceError) -> u8 {
    match error {
        DeviceError::NoneFound { .. }
        | DeviceError::SeveralFound { .. }
        | DeviceError::Missing { .. }
        | DeviceError::Permission { .. }
        | DeviceError::Busy { .. }
        | DeviceError::Open { .. }
        | DeviceError::Connect { .. }
        | DeviceError::TurnedAway { .. } => NO_DEVICE,
        DeviceError::Silent { .. }
        | DeviceError::NoReply { .. }
        | DeviceError::Flood { .. }
        | DeviceError::Vanished { .. }
        | DeviceError::Refused { .. } => DEVICE_LOST,
        DeviceError::WireVersion { .. } => WIRE_VERSION,
        DeviceError::Interrupted => INTERRUPTED,
    }
}

fn simulate(error: &SimulateError) -> u8 {
    match error {
        SimulateError::Setup { .. }
        | SimulateError::Rate { .. }
        | SimulateError::Change { .. }
        | SimulateError::Hand { .. } => SETTINGS,
        SimulateError::Format { .. } => USAGE,
        SimulateError::Endpoint { .. }
        | SimulateError::NoImage
        | SimulateError::NoQemu { .. }
        | SimulateError::QemuEnded { .. } => NO_DEVICE,
        SimulateError::Data(error) => data(error),
    }
}

fn update(error: &UpdateError) -> u8 {
    match error {
        UpdateError::NoDevice { .. }
        | UpdateError::Several { .. }
        | UpdateError::Usb { .. }
        | UpdateError::Permission { .. }
        | UpdateError::Open { .. }
        | UpdateError::OtherChip { .. } => NO_DEVICE,
        UpdateError::CannotEnter { .. }
        | UpdateError::CannotAsk { .. }
        | UpdateError::DidNotAppear { .. }
        | UpdateError::SingleBank { .. }
        | UpdateError::SmallFlash { .. }
        | UpdateError::Lost { .. }
        | UpdateError::Refused { .. }
        | UpdateError::Stuck { .. }
        | UpdateError::Verify { .. }
        | UpdateError::NotBack { .. }
        | UpdateError::StaysInDfu { .. }
        | UpdateError::OtherVersion { .. } => DEVICE_LOST,
        UpdateError::OtherBoard { .. } => INPUT,
        UpdateError::Interrupted => INTERRUPTED,
        UpdateError::Device(error) => device(error),
    }
}
