//! `inerter fit`: friction by direction, from the exact sums of a run.

use std::path::PathBuf;

use inerter_analysis::{
    calibrate::refuse_saturated,
    fit::{Beside, Directions, Products, directions},
};
use inerter_core::{Machine, Parameter};
use inerter_data::{
    causes::warning_words,
    json::bank_word,
    json::{ParameterJson, ParametersJson, machine_json_line},
    names::description,
    output,
    replay::{Outcome, replay_all},
    run::Run,
    text::{self, value_text},
    words::amount_text,
};
use inerter_wire::{EstimatorEvent, catalogue};
use serde::Serialize;

use super::{args::FileSettingsArgs, terminal::note};
use crate::Error;

/// Fit a recording or a CSV file again, with friction that may differ by direction.
///
/// The run goes through the estimator, whose exact sums are fitted twice: with friction alike in both directions, and with
/// one viscous and one Coulomb friction for each. Positive is where the encoder counts up (down, when metres_per_count is
/// negative). A constant force cannot be told from a Coulomb friction that differs by direction: without --offset-n only
/// fc+ - fc- + 2 F0 is given. After a change of the device only the motion since is fitted.
///
/// With --json one object: {"kind":"fit","symmetric":{..},"by_direction":{..}}. docs/CLI.md describes it.
#[derive(clap::Args)]
#[command(after_long_help = inerter_data::settings::help_table())]
pub struct Args {
    /// Recording (.mcap) or CSV file
    file: PathBuf,
    /// The force offset F0, where it is known: 0 after a tare without load
    #[arg(long, value_name = "N", allow_hyphen_values = true)]
    offset_n: Option<f64>,
    #[command(flatten)]
    settings: FileSettingsArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<(), Error> {
    let run = inerter_data::open(&args.file, &args.settings.overrides()?)?;
    run.notes.iter().for_each(note);
    let outcome = replayed(&run)?;
    let (sums, more) = outcome.sums();
    let fit = Products::of(sums, more)
        .and_then(|products| directions(&products, &run.settings, &Beside::of(&outcome), args.offset_n));
    let fit = match fit {
        Ok(fit) => fit,
        Err(error) => {
            refuse_saturated(&outcome, &run)?;
            return Err(error.into());
        }
    };
    if args.json { json(args, run.settings.machine, &outcome, &fit) } else { text(args, &run, &outcome, &fit) }
}

/// Takes the run through the estimator and says where its sums began anew.
pub fn replayed(run: &Run) -> Result<Outcome, Error> {
    replay_all(run, |t_s, event| {
        match event {
            EstimatorEvent::Changed(_) => {
                note(format!("the device changed at {t_s:.1} s: only the motion since is fitted"));
            }
            EstimatorEvent::Warned(warning) => {
                note(format!("at {t_s:.1} s {}", warning_words(run.settings.machine, warning.kind)))
            }
            EstimatorEvent::Reversal(_) | EstimatorEvent::Estimate(_) => {}
        }
        Ok(())
    })
}

/// A fit in JSON.
#[derive(Serialize)]
struct FitJson {
    kind: &'static str,
    file: String,
    bank: &'static str,
    updates: u32,
    symmetric: ParametersJson,
    symmetric_residual_rms_n: f64,
    by_direction: DirectionsJson,
    residual_rms_n: f64,
}

#[derive(Serialize)]
struct DirectionsJson {
    inertance_kg: ParameterJson,
    viscous_positive_n_s_per_m: ParameterJson,
    viscous_negative_n_s_per_m: ParameterJson,
    coulomb_n: ParameterJson,
    coulomb_positive_n: Option<ParameterJson>,
    coulomb_negative_n: Option<ParameterJson>,
    offset_n: Option<f64>,
    difference_and_twice_offset_n: ParameterJson,
}

fn json(args: &Args, machine: Machine, outcome: &Outcome, fit: &Directions) -> Result<(), Error> {
    let [viscous_positive, viscous_negative] = fit.viscous_n_s_per_m;
    let coulomb = fit.coulomb_by_direction_n;
    let by_direction = DirectionsJson {
        inertance_kg: fit.inertance_kg.into(),
        viscous_positive_n_s_per_m: viscous_positive.into(),
        viscous_negative_n_s_per_m: viscous_negative.into(),
        coulomb_n: fit.coulomb_n.into(),
        coulomb_positive_n: coulomb.map(|[positive, _]| positive.into()),
        coulomb_negative_n: coulomb.map(|[_, negative]| negative.into()),
        offset_n: args.offset_n,
        difference_and_twice_offset_n: ParameterJson::offset(fit.difference_n),
    };
    let line = FitJson {
        kind: "fit",
        file: args.file.display().to_string(),
        bank: bank_word(outcome.estimate.bank),
        updates: outcome.sums().0.updates,
        symmetric: (&fit.symmetric).into(),
        symmetric_residual_rms_n: fit.symmetric_residual_rms_n,
        by_direction,
        residual_rms_n: fit.residual_rms_n,
    };
    Ok(output::line(machine_json_line(machine, &line))?)
}

fn text(args: &Args, run: &Run, outcome: &Outcome, fit: &Directions) -> Result<(), Error> {
    let line = |label: &str, unit: &str, cells: [String; 3]| {
        let [alike, positive, negative] = cells;
        let line = format!("{label:<20} {unit:<6} {alike:<22} {positive:<22} {negative}");
        output::line(line.trim_end())
    };
    let cell = |parameter: &Parameter| value_text(parameter);
    line("", "", ["alike".into(), "positive".into(), "negative".into()])?;
    let offset = args.offset_n.map_or_else(|| "unknown".to_string(), |offset_n| format!("{offset_n} (given)"));
    let [viscous_positive, viscous_negative] = &fit.viscous_n_s_per_m;
    let coulomb = match &fit.coulomb_by_direction_n {
        Some([positive, negative]) => [cell(positive), cell(negative)],
        None => [format!("mean {}", cell(&fit.coulomb_n)), String::new()],
    };
    let [coulomb_positive, coulomb_negative] = coulomb;
    let by_direction = [
        [cell(&fit.inertance_kg), String::new()],
        [cell(viscous_positive), cell(viscous_negative)],
        [coulomb_positive, coulomb_negative],
        [offset, String::new()],
    ];
    for ((field, alike), [positive, negative]) in
        catalogue::parameters(run.settings.machine, &fit.symmetric).zip(by_direction)
    {
        line(field.label, field.unit, [cell(&alike), positive, negative])?;
    }
    let residual = |rms_n: f64| amount_text(rms_n, 3);
    let unit = catalogue::unit(run.settings.machine, "N");
    line("Residual, rms", unit, [residual(fit.symmetric_residual_rms_n), residual(fit.residual_rms_n), String::new()])?;
    output::line("")?;
    if args.offset_n.is_none() {
        output::lines(format!(
            "fc+ - fc- + 2 F0 is {} {unit}: a {} offset cannot be told from a Coulomb friction that differs by direction;\n\
             give the offset with --offset-n (0 after a tare without load) to tell fc+ and fc- apart",
            cell(&fit.difference_n),
            description(run.settings.machine, "force")
        ))?;
    }
    Ok(output::line(text::counts_line(&run.settings, run.duration_s(), outcome))?)
}
