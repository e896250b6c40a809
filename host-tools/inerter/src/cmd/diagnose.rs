//! `inerter diagnose`: what violates the estimator's law in a run.

use std::path::PathBuf;

use inerter_analysis::{
    diagnose::Encoder,
    results::{Diagnosed, diagnosed},
};
use inerter_core::{Machine, Parameters};
use inerter_data::{output, replay::Outcome, text::value_text};
use inerter_wire::catalogue;

use super::{
    args::{FileSettingsArgs, at_least},
    print::print_machine_json,
    terminal::note,
};
use crate::Error;

/// Identify what breaks the law of the estimator in a recording or a CSV file.
///
/// The law is F = mt a + cf v + fc sgn(v) + F0. If force noise and encoder steps do not explain its residual, the
/// command looks for a cause: friction that grows with the load, repeats with the turns of the screw, falls with the
/// speed, reverses gradually over a distance, or changes with time or with the square of the velocity; a skew between
/// force and position, an encoder error, friction that differs by direction, a spring, a position that yields to the
/// force, a nonlinear measurement of the force, or a mass on the terminal that moves differently from the screw. Each
/// is added to the law, the one that explains most first, as long as it explains more than noise and steps ever do. The
/// parameters are given again with all of them included. Samples that no device could produce are reported as well:
/// lost counts, a clipped or dead force, a wrong sign.
///
/// Effects that repeat with the turns of the screw are sought at the usual counts per turn, and intervals cover all
/// that are possible; --counts-per-turn gives the right one.
///
/// With --json one object: {"kind":"diagnosis","law":{..},"causes":[{"name":..}],"corrected":{..}}. docs/CLI.md
/// describes it.
#[derive(clap::Args)]
#[command(after_long_help = inerter_data::settings::help_table())]
pub struct Args {
    /// Recording (.mcap) or CSV file
    file: PathBuf,
    /// Encoder counts in a turn of the screw
    #[arg(long, value_name = "COUNTS", value_parser = counts)]
    counts_per_turn: Option<f64>,
    /// Encoder counts in a period of its lines [default: 4]
    #[arg(long, value_name = "COUNTS", value_parser = counts)]
    counts_per_line: Option<f64>,
    #[command(flatten)]
    settings: FileSettingsArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

fn counts(text: &str) -> Result<f64, String> {
    at_least(text, 4.0, "a number of counts is needed, 4 or more, for example 4096")
}

pub fn run(args: &Args) -> Result<(), Error> {
    let run = args.settings.open(&args.file)?;
    let encoder = Encoder { counts_per_turn: args.counts_per_turn, counts_per_line: args.counts_per_line };
    let changed = |since_s| note(format!("the device changed at {since_s:.1} s: only the motion since then is used"));
    let diagnosed = diagnosed::<Error>(&run, encoder, changed, drop)?;
    let machine = run.settings.machine;
    if args.json {
        return print_machine_json(machine, &diagnosed.json(machine));
    }
    text(machine, &diagnosed)
}

fn text(machine: Machine, diagnosed: &Diagnosed) -> Result<(), Error> {
    let Diagnosed { outcome, gated, found, corrected, .. } = diagnosed;
    diagnosed.words(machine).into_iter().try_for_each(output::line)?;
    match corrected {
        Some(corrected) if !diagnosed.causes().is_empty() => table(machine, outcome, "with that included", corrected),
        Some(corrected) if found.is_ok() && gated.has_no_force() => {
            table(machine, outcome, "without these samples", corrected)
        }
        _ => Ok(()),
    }
}

/// The estimator's parameters for the whole run, beside those of the corrected fit.
fn table(machine: Machine, outcome: &Outcome, otherwise: &str, corrected: &Parameters) -> Result<(), Error> {
    output::line("")?;
    output::line(format!("{:<20} {:<6} {:<22} {otherwise}", "", "", "whole run"))?;
    let whole = catalogue::parameters(machine, &outcome.estimate.whole_run);
    for ((field, before), (_, after)) in whole.zip(catalogue::parameters(machine, corrected)) {
        let (before, after) = (value_text(&before), value_text(&after));
        output::line(format!("{:<20} {:<6} {before:<22} {after}", field.label, field.unit))?;
    }
    Ok(())
}
