//! `inerter calibrate load-cell`: faults of the force channel.

use std::time::Duration;

use inerter_analysis::calibrate::load_cell::diagnose;

use super::common::{SourceArgs, StepArgs, at_device, listening_time, report};
use crate::Error;

/// Check the force channel of a device at rest: rate, noise, drift, saturation, mains.
///
/// Keep the device still, without load, and with all drives on as in normal use. Each fault is reported with a remedy,
/// and the exit code is then 9: samples lost or at another rate, a code at its limit or that never changes, noise over
/// 0.2 % of the range, noise below one step of the converter, mains over five times the noise, a zero that drifts or is
/// far from the middle. Changes nothing. FILE is a recording (.mcap) or CSV of a device at rest. With --json one
/// object:
/// {"kind":"calibration","step":"load_cell","measured":{"noise_n":..,"mains_n":..},"remarks":[..],"accepted":..}.
#[derive(clap::Args)]
pub struct Args {
    /// How long to measure, at least 4 s
    #[arg(long, value_name = "SECONDS", value_parser = listening_time, allow_negative_numbers = true, default_value = "10")]
    duration: Duration,
    #[command(flatten)]
    source: SourceArgs,
    #[command(flatten)]
    step: StepArgs,
}

pub fn run(args: &Args) -> Result<(), Error> {
    match args.source.run()? {
        Some(run) => report(&diagnose(&run, None)?, &run.name, run.settings.machine, args.step.json, false),
        None => at_device(&args.step, |rig| rig.load_cell(args.duration.as_secs_f64())),
    }
}
