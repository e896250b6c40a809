//! Arguments that several commands share.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use inerter_data::{
    calibration::Calibration,
    export::Source,
    output::{self, OutputError},
    run::Run,
    settings::{self, Overrides, SettingsInputError},
    text::settings_note,
};
use inerter_device::{Clock, DEFAULT_BAUD, Device, Target, live::Live};
use inerter_wire::Streams;

use super::terminal::{Progress, interrupted, note};
use crate::{Error, monitor::address::exposed};

/// Settings that override those of the run.
#[derive(clap::Args)]
pub struct SettingsArgs {
    /// Set one setting; may be repeated, the last one wins
    #[arg(long, value_name = "KEY=VALUE", help_heading = "Settings")]
    pub set: Vec<String>,
    /// Read settings from a TOML file with lines `key = value`; --set wins over it
    #[arg(long, value_name = "FILE.toml", help_heading = "Settings")]
    pub settings: Option<PathBuf>,
}

impl SettingsArgs {
    pub fn overrides(&self) -> Result<Overrides, SettingsInputError> {
        Overrides::from_inputs(self.settings.as_deref(), &self.set)
    }
}

/// Settings of a file that may be a CSV.
#[derive(clap::Args)]
pub struct FileSettingsArgs {
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// Displacement per encoder count: lead / counts per revolution. A CSV needs it; wins over --set
    #[arg(long, value_name = "METRES", allow_hyphen_values = true, help_heading = "Settings")]
    pub metres_per_count: Option<f64>,
}

impl FileSettingsArgs {
    pub fn overrides(&self) -> Result<Overrides, SettingsInputError> {
        let mut overrides = self.settings.overrides()?;
        if let Some(value) = self.metres_per_count {
            overrides.set("metres_per_count", value, "--metres-per-count")?;
        }
        Ok(overrides)
    }

    /// Opens the run of a file and prints its notes.
    pub fn open(&self, file: &Path) -> Result<Run, Error> {
        opened(file, &self.overrides()?)
    }

    /// The same, with samples that are read on demand.
    pub fn source(&self, file: &Path) -> Result<Source, Error> {
        let mut bar = Progress::through("reading", file);
        let source = Source::open(file, &self.overrides()?, |offset| bar.set(offset))?;
        bar.done();
        source.notes.iter().for_each(note);
        Ok(source)
    }
}

/// Reads a run and prints its notes.
pub fn opened(file: &Path, overrides: &Overrides) -> Result<Run, Error> {
    let run = inerter_data::open(file, overrides)?;
    run.notes.iter().for_each(note);
    Ok(run)
}

/// Which device.
#[derive(clap::Args)]
pub struct LinkArgs {
    /// Serial port of the device [default: the only inerter that is plugged in]
    #[arg(long, value_name = "PORT", conflicts_with_all = ["connect", "serial"], help_heading = "Device")]
    pub port: Option<String>,
    /// Connect to a device at a TCP address, e.g. a simulated one
    #[arg(long, value_name = "HOST:PORT", conflicts_with = "serial", help_heading = "Device")]
    pub connect: Option<String>,
    /// Serial number of the device, when several are plugged in
    #[arg(long, value_name = "NUMBER", help_heading = "Device")]
    pub serial: Option<String>,
    /// Bits per second of a real UART; USB ignores it
    #[arg(long, value_name = "RATE", default_value_t = DEFAULT_BAUD, help_heading = "Device")]
    pub baud: u32,
}

impl LinkArgs {
    /// Whether a device was named.
    pub fn is_given(&self) -> bool {
        self.port.is_some() || self.connect.is_some() || self.serial.is_some()
    }

    pub fn device(&self) -> Result<Device, Error> {
        let device = Device::connect(&self.target(), Clock::new(), interrupted)?;
        tell(&device);
        Ok(device)
    }

    /// Connects with these streams on; if the device goes away, waits up to `wait` for it.
    pub fn live(&self, streams: Streams, wait: Duration) -> Result<Live, Error> {
        let live = Live::connect(self.target(), streams, wait, interrupted)?;
        live.device().into_iter().for_each(tell);
        if live.looks_on() {
            note("another program controls this device: this one only watches, and its requests are refused");
        }
        Ok(live)
    }

    pub fn target(&self) -> Target {
        match (&self.port, &self.connect) {
            (Some(port), _) => Target::Port { port: port.clone(), baud: self.baud },
            (None, Some(address)) => Target::Tcp { address: address.clone() },
            (None, None) => Target::Usb { serial: self.serial.clone() },
        }
    }
}

/// Warns if the device has settings that this program does not know.
fn tell(device: &Device) {
    settings_note(device.reading()).iter().for_each(note);
}

/// Warns if other machines can connect.
pub fn note_exposed(address: &str) {
    if exposed(address).is_some() {
        note(format!("any machine that reaches {address} can connect: no password is required"));
    }
}

/// A recording that is to be written.
#[derive(clap::Args)]
pub struct OutputArgs {
    /// File to write (.mcap)
    #[arg(short, long, value_name = "FILE.mcap")]
    output: PathBuf,
    /// Replace the file if it exists
    #[arg(long)]
    pub force: bool,
}

impl OutputArgs {
    /// The file, or an error if it exists and may not be replaced.
    pub fn path(&self) -> Result<&Path, OutputError> {
        if !self.force {
            output::refuse_existing(&self.output)?;
        }
        Ok(&self.output)
    }

    /// Its name for a person.
    pub fn display(&self) -> std::path::Display<'_> {
        self.output.display()
    }
}

/// The calibration of the rig about to be recorded, from a settings file; prints a note if it has expired.
pub fn calibration(file: Option<&Path>) -> Result<Option<Calibration>, SettingsInputError> {
    let Some(path) = file else { return Ok(None) };
    let calibration = settings::calibration(path)?;
    calibration.trouble(Some(Clock::new().now_ns())).iter().for_each(note);
    Ok(Some(calibration))
}

/// A part of a file.
#[derive(clap::Args)]
pub struct RangeArgs {
    /// Begin this many seconds after the first sample
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    pub from: Option<Duration>,
    /// End this many seconds after the first sample; a sample at exactly this time is left out
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    pub to: Option<Duration>,
}

impl RangeArgs {
    /// Time since the first sample \[s\].
    pub fn range_s(&self) -> std::ops::Range<f64> {
        self.from.map_or(0.0, |from| from.as_secs_f64())..self.to.map_or(f64::INFINITY, |to| to.as_secs_f64())
    }
}

/// How long.
#[derive(clap::Args)]
pub struct TimeArgs {
    /// Stop after this many seconds [default: at Ctrl-C]
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true)]
    pub duration: Option<Duration>,
    /// If the device goes away, wait this many seconds for it to come back
    #[arg(long, value_name = "SECONDS", value_parser = seconds, allow_negative_numbers = true, default_value = "10")]
    pub wait: Duration,
}

/// Parses a number that is at least `least`; `wanted` says in the error what is required.
pub fn at_least(text: &str, least: f64, wanted: &str) -> Result<f64, String> {
    text.parse().ok().filter(|value: &f64| value.is_finite() && *value >= least).ok_or_else(|| wanted.into())
}

/// Parses a plausible time in seconds.
pub fn seconds(text: &str) -> Result<Duration, String> {
    let value: f64 = text.parse().map_err(|_| "a number of seconds is needed, for example 20".to_string())?;
    Duration::try_from_secs_f64(value).map_err(|_| "the time must be 0 or more, and finite".to_string())
}
