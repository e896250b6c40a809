//! `inerter calibrate stiffness`: stiffness and damping of the contact, from the terminal's displacement sensor.

use inerter_analysis::contact::ContactLaw;
use inerter_data::{
    json::{BacklashJson, ParameterJson},
    names::unit,
    replay::Outcome,
    run::Run,
    text::value_text,
};
use serde::Serialize;

use super::motion::{self, MotionArgs, Shown};
use crate::Error;

/// Find stiffness and damping of the contact, with a terminal displacement sensor.
///
/// With these two settings the backlash follows from the force alone, and the sensor may be removed again. Shake the
/// inerter from 3 Hz up for 20 s, hard enough that the force presses on both flanks in turn. If the sensor's scale is
/// 0.1 % off the encoder's, the stiffness is 1.7 % off at 3.2 Hz: calibrate it against the encoder first, and state in
/// lead_u95 how well.
///
/// FILE is a recording (.mcap) or a CSV with a column terminal_m; without it the command measures on a device for
/// --duration. --write puts stiffness_n_per_m, stiffness_u95_n_per_m and contact_damping_n_s_per_m in use on the device
/// and saves them if they are better than those in use: if no stiffness is set, if the one set lies outside the
/// interval, or if the new interval is the smaller one. For a file they are printed as --set. With --json one object:
/// {"kind":"stiffness","stiffness_n_per_m":..,"stiffness_u95_n_per_m":..,"contact_damping_n_s_per_m":..,..}.
#[derive(clap::Args)]
#[command(after_long_help = inerter_data::settings::help_table())]
pub struct Args {
    #[command(flatten)]
    motion: MotionArgs,
}

pub fn run(args: &Args) -> Result<(), Error> {
    motion::run(&args.motion, shown)
}

/// A contact in JSON.
#[derive(Serialize)]
struct StiffnessJson {
    found_stiffness_n_per_m: ParameterJson,
    found_contact_damping_n_s_per_m: ParameterJson,
    backlash_m: BacklashJson,
}

fn shown(run: &Run, outcome: &Outcome) -> Result<Shown<StiffnessJson>, Error> {
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
