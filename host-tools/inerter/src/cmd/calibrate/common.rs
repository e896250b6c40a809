//! What the steps share: where samples come from, and how a finding is reported and saved.

use std::{path::PathBuf, time::Duration};

use inerter_analysis::calibrate::{CalibrateError, Finding};
use inerter_core::Machine;
use inerter_data::{names::description, output, run::Run, settings::SettingsInputError};
use inerter_device::{Device, DeviceError};
use inerter_wire::Refusal;
use serde_json::{Value, json};

use super::{
    super::{
        args::{FileSettingsArgs, LinkArgs, opened, seconds},
        print::print_machine_json,
        terminal::{self, note},
    },
    person::Person,
};
use crate::{
    Error,
    calibrate::{
        dialogue::{Units, number},
        steps::Station,
        wizard,
    },
};

/// What every step at a device takes.
#[derive(clap::Args)]
pub struct StepArgs {
    /// Put the result in use on the device, and save it there
    #[arg(long)]
    pub write: bool,
    #[command(flatten)]
    pub link: LinkArgs,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

/// What a step takes that a recording can answer too.
#[derive(clap::Args)]
pub struct SourceArgs {
    /// Recording (.mcap) or CSV file [default: a device]
    #[arg(conflicts_with_all = ["write", "port", "connect", "serial"])]
    pub file: Option<PathBuf>,
    #[command(flatten)]
    pub settings: FileSettingsArgs,
}

impl SourceArgs {
    /// The recording, where one was given.
    pub fn run(&self) -> Result<Option<Run>, Error> {
        let overrides = self.settings.overrides()?;
        let Some(file) = &self.file else {
            if !overrides.is_empty() {
                note("settings given here apply to files only: the device's own are used");
            }
            return Ok(None);
        };
        opened(file, &overrides).map(Some)
    }
}

/// Parses a listening time that is short enough to keep all samples.
pub fn listening_time(text: &str) -> Result<Duration, String> {
    time_within(text, 3600.0)
}

/// Parses a time above zero and at most this long.
pub fn time_within(text: &str, most_s: f64) -> Result<Duration, String> {
    let duration = seconds(text)?;
    if duration.is_zero() || duration.as_secs_f64() > most_s {
        return Err(format!("the time must be greater than 0, and at most {most_s} s"));
    }
    Ok(duration)
}

/// Parses a number with one of these units or none that satisfies `makes_sense`; `problem` explains a rejection.
pub fn number_where(text: &str, units: Units, makes_sense: impl Fn(f64) -> bool, problem: &str) -> Result<f64, String> {
    let value = number(text, units).map_err(|error| error.to_string())?;
    if makes_sense(value) { Ok(value) } else { Err(problem.into()) }
}

/// Connects; rejects a device that cannot save what --write needs before anything is measured.
pub fn connect(args: &StepArgs) -> Result<Device, Error> {
    terminal::catch_interrupts();
    let device = args.link.device()?;
    if args.write && !device.keeps_settings() {
        let (name, what) = (device.name().to_string(), "to keep settings over a restart, as --write requires");
        return Err(DeviceError::Refused { name, what, refusal: Refusal::Unsupported }.into());
    }
    Ok(device)
}

/// Runs a step with a device, reports the finding, and saves it if requested.
pub fn at_device(args: &StepArgs, step: impl FnOnce(&mut Station) -> Result<Finding, Error>) -> Result<(), Error> {
    let mut device = connect(args)?;
    let mut person = Person::new(args.json);
    let settings = *device.settings();
    let may_ask = terminal::can_ask() && !args.json;
    let finding = step(&mut Station { device: &mut device, dialogue: &mut person, settings, may_ask })?;
    let is_of_use = finding.is_good() && finding.has_settings();
    let written = args.write && is_of_use;
    if written {
        let settings =
            finding.adopted_by(device.settings()).map_err(|source| SettingsInputError::Refused { source })?;
        wizard::write(&mut device, &settings)?;
    }
    report(&finding, device.name(), settings.machine, args.json, written)?;
    if is_of_use && !written && !args.json {
        terminal::say("nothing was changed; --write applies it and saves it");
    }
    Ok(())
}

/// Reports the finding; a bad finding is returned as an error.
pub fn report(finding: &Finding, source: &str, machine: Machine, json: bool, written: bool) -> Result<(), Error> {
    if json {
        let mut object = json!({ "kind": "calibration", "source": source });
        if let (Value::Object(object), Ok(Value::Object(found))) = (&mut object, serde_json::to_value(finding)) {
            object.extend(found);
            object.insert("accepted".into(), finding.is_good().into());
            object.insert("written".into(), written.into());
        }
        print_machine_json(machine, &object)?;
    } else {
        finding.text.iter().try_for_each(|text| output::line(description(machine, text)))?;
        for remark in &finding.remarks {
            let level = serde_json::to_value(remark.level).ok();
            let level = level.as_ref().and_then(Value::as_str).unwrap_or_default();
            output::line(format!("{level}: {}", description(machine, &remark.text)))?;
        }
        if finding.has_settings() && finding.is_good() {
            let set: Vec<String> = finding.values.iter().map(|(name, value)| format!("{name}={value}")).collect();
            let set = set.join(" ");
            output::line(if written {
                format!("saved on the device: {set}")
            } else {
                format!("inerter settings set {set}")
            })?;
        }
    }
    match finding.problems() {
        0 => Ok(()),
        problems => Err(CalibrateError::Unfit { problems }.into()),
    }
}
