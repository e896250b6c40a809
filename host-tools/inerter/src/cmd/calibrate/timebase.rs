//! `inerter calibrate timebase`: the device's clock against this computer's.

use std::time::Duration;

use super::{
    common::{StepArgs, at_device, time_within},
    force::within,
};
use crate::{Error, calibrate::dialogue::PPM};

/// Compare the device's sample clock with this computer's clock.
///
/// Longer is better, on an otherwise idle computer: the scatter of the arrivals over that time is reported as part of
/// the uncertainty. This computer's clock is the limit: its crystal is good to 50 ppm; if NTP or PTP has disciplined it
/// for hours, --host-clock-ppm 1 may be right. The rate is not corrected: timebase_u95 becomes the sum of the deviation
/// and its uncertainty, never less than that of this computer. --write saves it if that is smaller than the value in
/// use, or if the comparison contradicts that value. The relative uncertainty of inertance is twice as large. With
/// --json one object:
/// {"kind":"calibration","step":"timebase","measured":{"deviation_ppm":..},"values":{"timebase_u95":..},..}.
#[derive(clap::Args)]
pub struct Args {
    /// How long to compare arrivals
    #[arg(long, value_name = "SECONDS", value_parser = |text: &str| time_within(text, 86_400.0), allow_negative_numbers = true, default_value = "60")]
    duration: Duration,
    /// Accuracy of this computer's clock
    #[arg(long, value_name = "PPM", value_parser = |text: &str| within(text, PPM, 1e-3, 1e4), default_value = "50")]
    host_clock_ppm: f64,
    #[command(flatten)]
    step: StepArgs,
}

pub fn run(args: &Args) -> Result<(), Error> {
    at_device(&args.step, |rig| rig.timebase(args.duration.as_secs_f64(), args.host_clock_ppm))
}
