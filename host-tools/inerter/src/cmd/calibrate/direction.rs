//! `inerter calibrate direction`: whether force and position have the same positive direction.

use std::time::Duration;

use inerter_analysis::calibrate::direction::Known;

use super::common::{SourceArgs, StepArgs, at_device, listening_time, report};
use crate::{Error, calibrate::steps::direction_of};

/// Check that a positive force accelerates to the positive side.
///
/// Move the terminal back and forth by a few millimetres, several times a second, while the command measures. A
/// negative inertance shows that force and position have opposite signs; then the sign of one scale is changed: that of
/// newtons_per_code, or with --trust force that of metres_per_count. --write saves it. FILE is a recording (.mcap) or
/// CSV of such a motion. With --json one object:
/// {"kind":"calibration","step":"direction","measured":{"inertance_kg":..},"values":{..},..}.
#[derive(clap::Args)]
pub struct Args {
    /// Which of the two is known to have the right sign
    #[arg(long, value_name = "WHICH", default_value = "position")]
    trust: Trust,
    /// How long to measure
    #[arg(long, value_name = "SECONDS", value_parser = listening_time, allow_negative_numbers = true, default_value = "8")]
    duration: Duration,
    #[command(flatten)]
    source: SourceArgs,
    #[command(flatten)]
    step: StepArgs,
}

#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Trust {
    /// The force was calibrated by loads in a known direction
    Force,
    /// The position was calibrated along a gauge
    Position,
}

pub fn run(args: &Args) -> Result<(), Error> {
    let known = Known { force: args.trust == Trust::Force, position: args.trust == Trust::Position };
    match args.source.run()? {
        Some(run) => report(&direction_of(&run, known)?, &run.name, run.settings.machine, args.step.json, false),
        None => at_device(&args.step, |rig| rig.direction(args.duration.as_secs_f64(), known)),
    }
}
