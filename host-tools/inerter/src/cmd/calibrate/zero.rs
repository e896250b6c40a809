//! `inerter calibrate zero`: the code at zero force.

use std::time::Duration;

use inerter_analysis::calibrate::rest;

use super::common::{SourceArgs, StepArgs, at_device, listening_time, report};
use crate::Error;

/// Find the force code at no force, with its uncertainty.
///
/// The device must be still, without load: the command waits for that, up to 20 s longer than --duration. The value is
/// the mean over --duration; its interval comes from the scatter of fifteen parts of that time, so drift and mains
/// widen it. `settings tare` does the same in one second, without an interval. --write saves force_zero_code. FILE is a
/// recording (.mcap) or CSV. With --json one object:
/// {"kind":"calibration","step":"zero","values":{"force_zero_code":..},"u95":{..},..}.
#[derive(clap::Args)]
pub struct Args {
    /// How long the force must be at rest
    #[arg(long, value_name = "SECONDS", value_parser = listening_time, allow_negative_numbers = true, default_value = "5")]
    duration: Duration,
    #[command(flatten)]
    source: SourceArgs,
    #[command(flatten)]
    step: StepArgs,
}

pub fn run(args: &Args) -> Result<(), Error> {
    let seconds = args.duration.as_secs_f64();
    match args.source.run()? {
        Some(run) => {
            let level = rest::level(&run.samples, &run.settings, seconds, "")?;
            report(&rest::zero(&level, &run.settings), &run.name, run.settings.machine, args.step.json, false)
        }
        None => at_device(&args.step, |rig| rig.zero(seconds)),
    }
}
