//! The steps that find settings from a motion, from a file or a device: skew and stiffness.

use std::{collections::BTreeMap, time::Duration};

use inerter_analysis::calibrate::refuse_saturated;
use inerter_core::Machine;
use inerter_data::{output, replay::Outcome, run::Run, settings::SettingsInputError};
use serde::Serialize;

use super::{
    super::{fit::replayed, print::print_machine_json, terminal},
    common::{SourceArgs, StepArgs, connect, listening_time},
    person::Person,
};
use crate::{
    Error,
    calibrate::{Heard, wizard},
};

/// What they take.
#[derive(clap::Args)]
pub struct MotionArgs {
    /// How long to measure on a device
    #[arg(long, value_name = "SECONDS", value_parser = listening_time, allow_negative_numbers = true, default_value = "20")]
    duration: Duration,
    #[command(flatten)]
    source: SourceArgs,
    #[command(flatten)]
    step: StepArgs,
}

/// What a motion showed.
pub struct Shown<J> {
    /// What it is, for a person and as the kind of the JSON object.
    pub what: &'static str,
    /// What was found, for a person.
    pub words: Vec<String>,
    /// The settings that follow.
    pub values: Vec<(&'static str, f64)>,
    /// Whether they are better than those in use.
    pub better: bool,
    /// What was found, for a program.
    pub json: J,
}

#[derive(Serialize)]
struct ShownJson<'a, J> {
    kind: &'static str,
    source: &'a str,
    #[serde(flatten)]
    found: &'a J,
    #[serde(flatten)]
    values: BTreeMap<&'static str, f64>,
    better: bool,
    written: bool,
}

/// Runs a motion through the estimator, reports the finding, and saves it on the device if requested and better.
pub fn run<J: Serialize>(
    args: &MotionArgs,
    shown: impl FnOnce(&Run, &Outcome) -> Result<Shown<J>, Error>,
) -> Result<(), Error> {
    let mut device = None;
    let run = match args.source.run()? {
        Some(run) => run,
        None => {
            let device = device.insert(connect(&args.step)?);
            Heard::listen(device, &mut Person::new(args.step.json), args.duration.as_secs_f64(), true)?.run
        }
    };
    let outcome = replayed(&run, "")?;
    refuse_saturated(&outcome, &run)?;
    let shown = shown(&run, &outcome)?;
    let mut settings = run.settings;
    let adopted = shown.values.iter().try_for_each(|(name, value)| settings.set_by_name(name, *value));
    adopted.and_then(|()| settings.validate()).map_err(|source| SettingsInputError::Refused { source })?;
    let written = args.step.write && shown.better;
    if let (Some(device), true) = (&mut device, written) {
        wizard::write(device, &settings)?;
    }
    report(&shown, &run.name, run.settings.machine, args.step.json, written)?;
    if device.is_some() && shown.better && !written && !args.step.json {
        terminal::say("nothing was changed; --write applies it and saves it");
    }
    Ok(())
}

fn report<J: Serialize>(
    shown: &Shown<J>,
    source: &str,
    machine: Machine,
    json: bool,
    written: bool,
) -> Result<(), Error> {
    let Shown { what, words, values, better, json: found } = shown;
    if json {
        let values = values.iter().copied().collect();
        let line = ShownJson { kind: what, source, found, values, better: *better, written };
        return print_machine_json(machine, &line);
    }
    for (number, words) in words.iter().enumerate() {
        output::line(if number == 0 { format!("{source}: {words}") } else { words.clone() })?;
    }
    let listed = |before: &str, equals: &str, between: &str| {
        let each = values.iter().map(|(name, value)| format!("{before}{name}{equals}{value:?}"));
        each.collect::<Vec<_>>().join(between)
    };
    Ok(output::line(match (better, written) {
        (false, _) => format!("nothing to change: this motion cannot improve on the {what} in use"),
        (true, true) => format!("saved on the device: {}", listed("", " = ", ", ")),
        (true, false) => format!("use it with: {}", listed("--set ", "=", " ")),
    })?)
}
