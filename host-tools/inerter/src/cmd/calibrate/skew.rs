//! `inerter calibrate skew`: the delay of the force relative to the position.

use inerter_analysis::skew::skew;
use inerter_data::{
    json::{ParameterJson, rounded_s},
    replay::Outcome,
    run::Run,
};
use serde::Serialize;

use super::motion::{self, MotionArgs, Shown};
use crate::{Error, calibrate::steps::skew_words};

/// Find the delay of the force behind the position.
///
/// Move the machine for 20 s with several frequencies at once (two tones or a random motion, up to the highest
/// frequency that the machine reaches) or from point to point: in a single tone a delay and viscous friction are
/// indistinguishable, and the command says so instead of giving a number. Delays of up to 5 ms either way are found, on
/// machines of any size. A delay acts as a false damper of mt w^2 tau: 3 N s/m per microsecond at 15.9 Hz for 300 kg.
///
/// FILE is a recording (.mcap) or a CSV; without it the command measures on a device for --duration. --write puts
/// skew_s and skew_u95_s in use on the device and saves them if they are better than those in use: if the remaining
/// delay exceeds its interval, or if its interval is the smaller one. For a file they are printed as --set. With --json
/// one object:
/// {"kind":"skew","left_s":..,"skew_s":..,"skew_u95_s":..,..}.
#[derive(clap::Args)]
#[command(after_long_help = inerter_data::settings::help_table())]
pub struct Args {
    #[command(flatten)]
    motion: MotionArgs,
}

pub fn run(args: &Args) -> Result<(), Error> {
    motion::run(&args.motion, shown)
}

/// A skew in JSON.
#[derive(Serialize)]
struct SkewJson {
    left_s: f64,
    u95_s: f64,
    viscous_before_n_s_per_m: ParameterJson,
    viscous_after_n_s_per_m: ParameterJson,
    force_rms_n: f64,
    residual_before_rms_n: f64,
    residual_after_rms_n: f64,
}

fn shown(run: &Run, outcome: &Outcome) -> Result<Shown<SkewJson>, Error> {
    let found = skew(run, outcome)?;
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
