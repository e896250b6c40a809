//! `inerter calibrate encoder`: the scale of the position.

use super::{
    common::{StepArgs, at_device, number_where},
    force::part,
};
use crate::{
    Error,
    calibrate::{
        dialogue::{METRES, PLAIN, Units, number},
        steps::EncoderPlan,
    },
    error::DialogueError,
};

/// Find counts per revolution, metres per count and the direction of the encoder.
///
/// --revolutions 10: turn the screw by hand from a mark back to that mark, in the positive direction; the counts must
/// be near those of a commercial encoder, or of --lines. --displacement 0 --displacement 0.010 --displacement 0: move
/// along a dial gauge or gauge blocks, with positive values in the positive direction; return to the first value.
/// Without a gauge, --lead gives the lead of the data sheet, and the turn gives its direction. The command prompts for
/// each and waits for Enter; a script answers with a line.
///
/// --write saves metres_per_count, negative if the encoder counts down in the positive direction, and lead_u95. With
/// --json the last line is one object:
/// {"kind":"calibration","step":"encoder","values":{"metres_per_count":..},"measured":{..},..}.
#[derive(clap::Args)]
pub struct Args {
    /// Revolutions to turn by hand; negative turns in the negative direction
    #[arg(long, value_name = "NUMBER", value_parser = turns, allow_hyphen_values = true)]
    revolutions: Option<f64>,
    /// Lines per revolution from the encoder's label; each line is four counts
    #[arg(long, value_name = "NUMBER", value_parser = |text: &str| positive(text, PLAIN))]
    lines: Option<f64>,
    /// Lead of the screw from its data sheet
    #[arg(long, value_name = "METRES", value_parser = |text: &str| positive(text, METRES))]
    lead: Option<f64>,
    /// Relative 95 % uncertainty of that lead
    #[arg(long, value_name = "PART", value_parser = part, default_value = "0.001")]
    lead_u95: f64,
    /// Reading of the gauge to move to; repeated, in this order
    #[arg(long, value_name = "METRES", value_parser = length, allow_hyphen_values = true)]
    displacement: Vec<f64>,
    /// 95 % uncertainty of the gauge
    #[arg(long, value_name = "METRES", value_parser = length, default_value = "1e-5")]
    gauge_u95: f64,
    #[command(flatten)]
    step: StepArgs,
}

fn length(text: &str) -> Result<f64, DialogueError> {
    number(text, METRES)
}

fn positive(text: &str, units: Units) -> Result<f64, String> {
    number_where(text, units, |value| value > 0.0, "it must be greater than 0")
}

fn turns(text: &str) -> Result<f64, String> {
    number_where(text, PLAIN, |turns| turns.abs() >= 0.5, "half a revolution at least")
}

pub fn run(args: &Args) -> Result<(), Error> {
    let plan = EncoderPlan {
        revolutions: args.revolutions,
        lines: args.lines,
        lead_m: args.lead,
        lead_u95: args.lead_u95,
        displacements_m: args.displacement.clone(),
        gauge_u95_m: args.gauge_u95.abs(),
    };
    plan.check()?;
    at_device(&args.step, |rig| rig.encoder(&plan))
}
