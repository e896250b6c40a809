//! The steps that find settings from a motion, from a file or a device: skew and stiffness.

use std::{collections::BTreeMap, time::Duration};

use inerter_analysis::{calibrate::refuse_saturated, contact::ContactLaw, skew};
use inerter_core::Machine;
use inerter_data::{
    json::{BacklashJson, ParameterJson, rounded_s},
    names::unit,
    output,
    replay::Outcome,
    run::Run,
    settings::SettingsInputError,
    text::value_text,
};
use serde::Serialize;

use super::{
    super::{fit::replayed, print::print_machine_json, terminal},
    common::{SourceArgs, StepArgs, connect, listening_time},
    person::Person,
};
use crate::{
    Error,
    calibrate::{Heard, steps::skew_words, wizard},
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

/// A skew in JSON.
#[derive(Serialize)]
pub struct SkewJson {
    left_s: f64,
    u95_s: f64,
    viscous_before_n_s_per_m: ParameterJson,
    viscous_after_n_s_per_m: ParameterJson,
    force_rms_n: f64,
    residual_before_rms_n: f64,
    residual_after_rms_n: f64,
}

/// The delay of the force relative to the position.
pub fn skew(run: &Run, outcome: &Outcome) -> Result<Shown<SkewJson>, Error> {
    let found = skew::skew(run, outcome)?;
    // To the nanosecond: more digits would be noise.
    let (skew_s, skew_u95_s) = (rounded_s(found.skew_s), rounded_s(found.u95_s));
    Ok(Shown {
        what: "skew",
        words: skew_words(&found, run.settings.machine).to_vec(),
        values: vec![("skew_s", skew_s), ("skew_u95_s", skew_u95_s)],
        better: found.is_better_than(&run.settings),
        json: SkewJson {
            left_s: rounded_s(found.left_s),
            u95_s: skew_u95_s,
            viscous_before_n_s_per_m: found.viscous_before.into(),
            viscous_after_n_s_per_m: found.viscous_after.into(),
            force_rms_n: found.force_rms_n,
            residual_before_rms_n: found.residual_rms_n[0],
            residual_after_rms_n: found.residual_rms_n[1],
        },
    })
}

/// A contact in JSON.
#[derive(Serialize)]
pub struct StiffnessJson {
    found_stiffness_n_per_m: ParameterJson,
    found_contact_damping_n_s_per_m: ParameterJson,
    backlash_m: BacklashJson,
}

/// Stiffness and damping of the contact, from the displacement sensor of the terminal.
pub fn stiffness(run: &Run, outcome: &Outcome) -> Result<Shown<StiffnessJson>, Error> {
    let contact = ContactLaw::of(&outcome.detail, &run.settings)?;
    let ContactLaw { stiffness, damping } = contact;
    let settings = contact.adopted_by(&run.settings);
    Ok(Shown {
        what: "stiffness",
        words: vec![format!(
            "contact stiffness {} {}, contact damping {} {}",
            value_text(&stiffness),
            unit(run.settings.machine, "N/m"),
            value_text(&damping),
            unit(run.settings.machine, "N s/m")
        )],
        values: vec![
            ("stiffness_n_per_m", settings.stiffness_n_per_m),
            ("stiffness_u95_n_per_m", settings.stiffness_u95_n_per_m),
            ("contact_damping_n_s_per_m", settings.contact_damping_n_s_per_m),
        ],
        better: contact.is_better_than(&run.settings),
        json: StiffnessJson {
            found_stiffness_n_per_m: stiffness.into(),
            found_contact_damping_n_s_per_m: damping.into(),
            backlash_m: outcome.detail.backlash.into(),
        },
    })
}
