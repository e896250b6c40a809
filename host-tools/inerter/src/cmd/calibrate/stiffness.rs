//! `inerter calibrate stiffness`: stiffness and damping of the contact, by the terminal's displacement sensor.

use std::time::Duration;

use inerter::{
    Error,
    contact::Contact,
    detail::BacklashJson,
    device::{Clock, Device, DeviceError},
    output,
    replay::replay,
    report::{ParameterJson, json_line, value_text},
    run::Run,
    settings::validate,
};
use inerter_core::{Backlash, Detail, Settings};
use inerter_wire::{Record, Refusal, Streams};
use serde::Serialize;

use super::{
    super::terminal::{self, note},
    CommonArgs,
};

/// Find stiffness and damping of the contact, with a terminal displacement sensor.
///
/// With them in the settings the backlash comes from the force alone, and the sensor may be taken off again. Shake the inerter
/// from 3 Hz up for 20 s, hard enough that the force presses on either flank by turns. A scale of the sensor that is 0.1 % off
/// the encoder's is 1.7 % of the stiffness at 3.2 Hz: calibrate it against the encoder first, and say in lead_u95 how well.
///
/// FILE is a recording (.mcap) or a CSV with a column terminal_m; without it a device is listened to for --duration. Its
/// estimator begins anew for that. --write puts stiffness_n_per_m, stiffness_u95_n_per_m and contact_damping_n_s_per_m in use
/// on the device and saves them, when they are better than those in use: when there is no stiffness, when it lies outside of
/// the interval, or when the interval is the smaller one. For a file they are printed as --set. With --json one object:
/// {"kind":"stiffness","stiffness_n_per_m":..,"stiffness_u95_n_per_m":..,"contact_damping_n_s_per_m":..,..}.
#[derive(clap::Args)]
#[command(after_long_help = inerter::settings::help_table())]
pub struct Args {
    #[command(flatten)]
    common: CommonArgs,
}

/// What was found, with the backlash beside it.
struct Found {
    contact: Contact,
    backlash: Backlash,
}

impl Found {
    fn of(detail: &Detail, settings: &Settings) -> Result<Self, Error> {
        Ok(Self { contact: Contact::of(detail, settings)?, backlash: detail.backlash })
    }

    fn adopted(&self, settings: &Settings) -> Result<Settings, Error> {
        let settings = self.contact.adopted_by(settings);
        validate(&settings)?;
        Ok(settings)
    }
}

pub fn run(Args { common: args }: &Args) -> Result<(), Error> {
    match &args.file {
        Some(file) => {
            let run = Run::open(file, &args.settings.overrides()?)?;
            run.notes.iter().for_each(note);
            let outcome = replay(&run, |_, _| Ok::<(), Error>(()))?;
            let found = Found::of(&outcome.detail, &run.settings)?;
            let settings = found.adopted(&run.settings)?;
            let better = found.contact.is_better_than(&run.settings);
            report(args, &file.display().to_string(), &found, &settings, better, false)
        }
        None => {
            if !args.settings.overrides()?.is_empty() {
                note("settings given here are for files: the device's own are used");
            }
            terminal::catch_interrupts();
            let mut device = Device::connect(&args.link.target(), Clock::new())?;
            let detail = listen(&mut device, args.duration)?;
            let found = Found::of(&detail, device.settings())?;
            let settings = found.adopted(device.settings())?;
            let better = found.contact.is_better_than(device.settings());
            if args.write && better {
                device.write_settings(&settings)?;
                device.save_settings()?;
            }
            report(args, device.name(), &found, &settings, better, args.write && better)
        }
    }
}

/// What a device says by the end of this time, its estimator having begun anew.
fn listen(device: &mut Device, duration: Duration) -> Result<Detail, Error> {
    let mut last = None;
    super::listen(device, Streams { estimates: true, ..Streams::NONE }, duration, |record| {
        if let Record::Detail(detail) = record {
            last = Some(*detail);
        }
        last.is_some()
    })?;
    last.ok_or_else(|| {
        let (name, what) = (device.name().to_string(), "to stream what it knows of the contact");
        DeviceError::Refused { name, what, refusal: Refusal::Unsupported }.into()
    })
}

/// A contact in JSON.
#[derive(Serialize)]
struct StiffnessJson<'a> {
    kind: &'static str,
    source: &'a str,
    found_stiffness_n_per_m: ParameterJson,
    found_contact_damping_n_s_per_m: ParameterJson,
    backlash_m: BacklashJson,
    stiffness_n_per_m: f64,
    stiffness_u95_n_per_m: f64,
    contact_damping_n_s_per_m: f64,
    better: bool,
    written: bool,
}

fn report(
    args: &CommonArgs,
    source: &str,
    found: &Found,
    settings: &Settings,
    better: bool,
    written: bool,
) -> Result<(), Error> {
    let Contact { stiffness, damping } = found.contact;
    let Settings { stiffness_n_per_m, stiffness_u95_n_per_m, contact_damping_n_s_per_m, .. } = *settings;
    if args.json {
        let line = StiffnessJson {
            kind: "stiffness",
            source,
            found_stiffness_n_per_m: stiffness.into(),
            found_contact_damping_n_s_per_m: damping.into(),
            backlash_m: found.backlash.into(),
            stiffness_n_per_m,
            stiffness_u95_n_per_m,
            contact_damping_n_s_per_m,
            better,
            written,
        };
        return Ok(output::line(json_line(&line))?);
    }
    output::line(format!(
        "{source}: contact stiffness {} N/m, contact damping {} N s/m",
        value_text(&stiffness),
        value_text(&damping)
    ))?;
    if !better {
        return Ok(output::line("nothing to change: the stiffness in use is known as well as this motion shows it")?);
    }
    let named = [
        ("stiffness_n_per_m", stiffness_n_per_m),
        ("stiffness_u95_n_per_m", stiffness_u95_n_per_m),
        ("contact_damping_n_s_per_m", contact_damping_n_s_per_m),
    ];
    if written {
        let saved = named.map(|(name, value)| format!("{name} = {value:?}")).join(", ");
        return Ok(output::line(format!("saved on the device: {saved}"))?);
    }
    let set = named.map(|(name, value)| format!("--set {name}={value:?}")).join(" ");
    output::line(format!("use it with: {set}"))?;
    if args.file.is_none() {
        terminal::say("nothing was changed; --write puts it in use and saves it");
    }
    Ok(())
}
