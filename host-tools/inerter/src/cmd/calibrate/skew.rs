//! `inerter calibrate skew`: the delay of the force behind the position.

use std::time::Duration;

use inerter::{
    Error,
    device::{Clock, Device, DeviceError},
    fit::{Products, Skew, skew},
    output,
    report::{ParameterJson, json_line, rounded_s, value_text},
    run::Run,
    settings::validate,
};
use inerter_core::{Backlash, Bank, Settings, Sums};
use inerter_wire::{Event, EventKind, Record, Refusal, Streams};
use serde::Serialize;

use super::{
    super::{
        fit::replayed,
        terminal::{self, note},
    },
    CommonArgs,
};

/// Find the delay of the force behind the position.
///
/// Shake the inerter with several frequencies at once (two tones or a random motion, up to 10 Hz or more) for 20 s: in a
/// single tone a delay and viscous friction are one, and the command says so instead of a number. A delay is a false damper of
/// mt w^2 tau: 3 N s/m per microsecond at 15.9 Hz for 300 kg.
///
/// FILE is a recording (.mcap) or a CSV; without it a device is listened to for --duration. Its estimator begins anew for
/// that. --write puts skew_s and skew_u95_s in use on the device and saves them, when they are better than those in use:
/// when a delay is left beyond its interval, or the interval is the smaller one. For a file they are printed as --set.
/// With --json one object: {"kind":"skew","left_s":..,"skew_s":..,"skew_u95_s":..,..}.
#[derive(clap::Args)]
#[command(after_long_help = inerter::settings::help_table())]
pub struct Args {
    #[command(flatten)]
    common: CommonArgs,
}

pub fn run(Args { common: args }: &Args) -> Result<(), Error> {
    match &args.file {
        Some(file) => {
            let run = Run::open(file, &args.settings.overrides()?)?;
            run.notes.iter().for_each(note);
            let outcome = replayed(&run)?;
            let (sums, more) = &outcome.fast;
            let found = skew(&Products::of(sums, more)?, &run.settings, &outcome.detail.backlash)?;
            let settings = adopted(&run.settings, &found)?;
            let better = found.is_better_than(&run.settings);
            report(args, &file.display().to_string(), &found, &settings, better, false)
        }
        None => {
            if !args.settings.overrides()?.is_empty() {
                note("settings given here are for files: the device's own are used");
            }
            terminal::catch_interrupts();
            let mut device = Device::connect(&args.link.target(), Clock::new())?;
            let found = listen(&mut device, args.duration)?;
            let settings = adopted(device.settings(), &found)?;
            let better = found.is_better_than(device.settings());
            if args.write && better {
                device.write_settings(&settings)?;
                device.save_settings()?;
            }
            report(args, device.name(), &found, &settings, better, args.write && better)
        }
    }
}

/// The settings with what was found.
fn adopted(settings: &Settings, found: &Skew) -> Result<Settings, Error> {
    // To the nanosecond: more digits would be noise.
    let (skew_s, skew_u95_s) = (rounded_s(settings.skew_s + found.left_s), rounded_s(found.u95_s));
    let settings = Settings { skew_s, skew_u95_s, ..*settings };
    validate(&settings)?;
    Ok(settings)
}

/// What a device has summed up by the end of this time, its estimator having begun anew.
fn listen(device: &mut Device, duration: Duration) -> Result<Skew, Error> {
    let (mut sums, mut found, mut backlash): (Option<Sums>, _, _) = (None, None, Backlash::default());
    let streams = Streams { estimates: true, sums: true, ..Streams::NONE };
    super::listen(device, streams, duration, |record| {
        match record {
            Record::Sums(now) if now.bank == Bank::Fast => sums = Some(*now),
            Record::MoreSums(more) if more.bank == Bank::Fast => {
                found = sums.take().and_then(|sums| Products::of(&sums, more).ok()).or(found);
            }
            Record::Detail(detail) => backlash = detail.backlash,
            Record::Event(Event { kind: EventKind::Changed(_), .. }) => {
                note("the device has changed: only the motion since is used");
            }
            _ => {}
        }
        found.is_some()
    })?;
    let refused = || {
        let (name, what) = (device.name().to_string(), "to stream its sums with the force rate");
        DeviceError::Refused { name, what, refusal: Refusal::Unsupported }
    };
    let products = found.ok_or_else(refused)?;
    Ok(skew(&products, device.settings(), &backlash)?)
}

/// A skew in JSON.
#[derive(Serialize)]
struct SkewJson<'a> {
    kind: &'static str,
    source: &'a str,
    left_s: f64,
    u95_s: f64,
    viscous_before_n_s_per_m: ParameterJson,
    viscous_after_n_s_per_m: ParameterJson,
    skew_s: f64,
    skew_u95_s: f64,
    better: bool,
    written: bool,
}

fn report(
    args: &CommonArgs,
    source: &str,
    found: &Skew,
    settings: &Settings,
    better: bool,
    written: bool,
) -> Result<(), Error> {
    let (skew_s, skew_u95_s) = (settings.skew_s, settings.skew_u95_s);
    if args.json {
        let line = SkewJson {
            kind: "skew",
            source,
            left_s: rounded_s(found.left_s),
            u95_s: skew_u95_s,
            viscous_before_n_s_per_m: found.viscous_before.into(),
            viscous_after_n_s_per_m: found.viscous_after.into(),
            skew_s,
            skew_u95_s,
            better,
            written,
        };
        return Ok(output::line(json_line(&line))?);
    }
    let microseconds = |seconds: f64| seconds * 1e6;
    output::line(format!(
        "{source}: the force is late by another {:.1} ± {:.1} us",
        microseconds(found.left_s),
        microseconds(found.u95_s)
    ))?;
    output::line(format!(
        "viscous friction: {} N s/m as it is, {} N s/m without that delay",
        value_text(&found.viscous_before),
        value_text(&found.viscous_after)
    ))?;
    if !better {
        return Ok(output::line("nothing to change: the skew in use is known as well as this motion shows it")?);
    }
    if written {
        return Ok(output::line(format!("saved on the device: skew_s = {skew_s:?}, skew_u95_s = {skew_u95_s:?}"))?);
    }
    output::line(format!("use it with: --set skew_s={skew_s:?} --set skew_u95_s={skew_u95_s:?}"))?;
    if args.file.is_none() {
        terminal::say("nothing was changed; --write puts it in use and saves it");
    }
    Ok(())
}
