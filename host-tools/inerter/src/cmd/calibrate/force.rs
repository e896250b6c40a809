//! `inerter calibrate force`: the force scale from known loads.

use std::{path::PathBuf, time::Duration};

use inerter_analysis::calibrate::{
    CalibrateError,
    force::{Gravity, Load, force},
    rest,
};

use super::{
    super::{
        args::{FileSettingsArgs, opened},
        terminal::note,
    },
    common::{StepArgs, at_device, listening_time, number_where, report},
};
use crate::{
    Error,
    calibrate::dialogue::{DEGREES, KILOGRAMS, NEWTONS, PLAIN, Units, number},
};

/// Find the force scale by known masses or forces, in both directions.
///
/// Give the loads in the order in which they will be applied, for example --mass 0 --mass 5 --mass 10 --mass 5 --mass 0
/// --mass -5 --mass -10 --mass 0. Loading and unloading shows the hysteresis, both signs show whether pushing and
/// pulling agree, the last 0 shows the return to zero. For each load the command prompts, waits for Enter, and then
/// until the force has been at rest for --duration. A script answers each prompt with a line; with --json prompts are
/// objects {"kind":"prompt",..} on standard output.
///
/// --write saves newtons_per_code, force_zero_code and force_gain_u95, which covers scatter, nonlinearity, hysteresis,
/// return to zero and the uncertainty of the loads. Loads that do not lie on a line are refused (the one that fits
/// worst is named), and so is a code that moves the same way for both directions. To use recordings, give one for each
/// load: --mass 5=five.mcap. With --json the last line is one object:
/// {"kind":"calibration","step":"force","values":{"newtons_per_code":..},"u95":{..},..}.
#[derive(clap::Args)]
pub struct Args {
    /// A mass that hangs on the cell; negative in the other direction; FILE is a recording of it
    #[arg(long, value_name = "KG[=FILE]", value_parser = |text: &str| load(text, KILOGRAMS), allow_hyphen_values = true, required_unless_present = "force")]
    mass: Vec<Recorded>,
    /// A force on the cell, instead of masses
    #[arg(long, value_name = "NEWTONS[=FILE]", value_parser = |text: &str| load(text, NEWTONS), allow_hyphen_values = true, conflicts_with = "mass")]
    force: Vec<Recorded>,
    /// Local gravity [m/s^2] [default: 9.80665, which is off by up to 0.27 %]
    #[arg(long, value_name = "VALUE", value_parser = |text: &str| within(text, PLAIN, 9.7, 9.9), conflicts_with = "latitude")]
    gravity: Option<f64>,
    /// Latitude of the place, from which local gravity is computed
    #[arg(long, value_name = "DEGREES", value_parser = |text: &str| within(text, DEGREES, -90.0, 90.0), allow_negative_numbers = true)]
    latitude: Option<f64>,
    /// Relative 95 % uncertainty of the loads
    #[arg(long, value_name = "PART", value_parser = part, default_value = "0.001")]
    loads_u95: f64,
    /// How long the force must be at rest with each load
    #[arg(long, value_name = "SECONDS", value_parser = listening_time, allow_negative_numbers = true, default_value = "3")]
    duration: Duration,
    #[command(flatten)]
    step: StepArgs,
    #[command(flatten)]
    settings: FileSettingsArgs,
}

/// A load as given.
#[derive(Clone, Debug)]
struct Recorded {
    size: f64,
    file: Option<PathBuf>,
}

fn load(text: &str, units: Units) -> Result<Recorded, String> {
    let (size, file) = text.split_once('=').map_or((text, None), |(size, file)| (size, Some(file.into())));
    Ok(Recorded { size: number(size, units).map_err(|error| error.to_string())?, file })
}

/// Parses a number between these limits.
pub fn within(text: &str, units: Units, least: f64, most: f64) -> Result<f64, String> {
    let problem = format!("it must lie between {least} and {most}");
    number_where(text, units, |value| (least..=most).contains(&value), &problem)
}

/// Parses a fraction of the whole.
pub fn part(text: &str) -> Result<f64, String> {
    within(text, PLAIN, 0.0, 1.0)
}

pub fn run(args: &Args) -> Result<(), Error> {
    let gravity = match (args.gravity, args.latitude) {
        (Some(value), _) => Gravity::given(value),
        (None, Some(degrees)) => Gravity::at_latitude(degrees),
        (None, None) => Gravity::ANYWHERE,
    };
    let (given, masses) = if args.force.is_empty() { (&args.mass, true) } else { (&args.force, false) };
    let loads: Vec<Load> = given
        .iter()
        .map(|each| if masses { Load::mass(each.size, &gravity) } else { Load::force(each.size) })
        .collect();
    let loads_u95 = if masses { args.loads_u95.hypot(gravity.u95) } else { args.loads_u95 };
    if masses && gravity == Gravity::ANYWHERE {
        note("gravity is taken as 9.80665 m/s^2, 0.27 % uncertain: --latitude or --gravity improves on it");
    }
    let seconds = args.duration.as_secs_f64();
    let files: Vec<&PathBuf> = given.iter().filter_map(|each| each.file.as_ref()).collect();
    if files.is_empty() {
        return at_device(&args.step, |rig| rig.force(&loads, loads_u95, seconds));
    }
    if files.len() < given.len() || args.step.write {
        let missing = CalibrateError::Missing(
            "a recording of each load (without --write)",
            "either all loads are recorded, as in --mass 0=zero.mcap --mass 5=five.mcap, or all are applied at a device",
        );
        return Err(missing.into());
    }
    let overrides = args.settings.overrides()?;
    let (mut readings, mut settings) = (Vec::new(), None);
    for (load, file) in loads.into_iter().zip(files) {
        let run = opened(file, &overrides)?;
        let at = format!(" in {}", file.display());
        let level = rest::level(&run.samples, &run.settings, seconds, &at)?;
        settings.get_or_insert(run.settings);
        readings.push((load, level));
    }
    let settings = settings.unwrap_or_default();
    let finding = force(&readings, loads_u95, &settings)?;
    report(&finding, "recordings", settings.machine, args.step.json, false)
}
