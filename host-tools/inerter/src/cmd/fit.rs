//! `inerter fit`: friction by direction, from the exact sums of one run or of several together.

use std::path::PathBuf;

use inerter_analysis::{calibrate::refuse_saturated, fit::Directions, merge::Runs, results::FitJson};
use inerter_data::{
    causes::warning_words,
    names::description,
    output,
    replay::{Outcome, replay_all},
    run::Run,
    text::{self, value_text},
    words::{amount_text, plural},
};
use inerter_wire::{EstimatorEvent, catalogue};

use super::{args::FileSettingsArgs, print::print_machine_json, terminal::note};
use crate::Error;

/// Refit recordings or CSV files, with friction that may differ by direction.
///
/// Each run goes through the estimator, whose exact sums are fitted twice: with the same friction in both directions,
/// and with one viscous and one Coulomb friction for each. Positive is the direction in which the encoder counts up
/// (down if metres_per_count is negative). A constant force cannot be distinguished from a Coulomb friction that
/// differs by direction: without --offset-n only fc+ - fc- + 2 F0 is given. If the device changed, only the motion
/// since then is fitted.
///
/// Several runs of one device are fitted together: their sums are added, which gives the same result in any order, and
/// a run that is given twice counts once. Their settings must be the same, except the tare and those of the terminal's
/// sensor.
///
/// With --json one object: {"kind":"fit","symmetric":{..},"by_direction":{..}}. docs/CLI.md describes it.
#[derive(clap::Args)]
#[command(after_long_help = inerter_data::settings::help_table())]
pub struct Args {
    /// Recordings (.mcap) or CSV files of one device
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// The force offset F0, if known: 0 after a tare without load
    #[arg(long, value_name = "N", allow_hyphen_values = true)]
    offset_n: Option<f64>,
    #[command(flatten)]
    settings: FileSettingsArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<(), Error> {
    let overrides = args.settings.overrides()?;
    let (mut all, mut first, mut saturated) = (None::<Runs>, None, None);
    for file in &args.files {
        let run = inerter_data::open(file, &overrides)?;
        let about = if args.files.len() > 1 { format!("{}: ", file.display()) } else { String::new() };
        run.notes.iter().for_each(|words| note(format!("{about}{words}")));
        let outcome = replayed(&run, &about)?;
        let runs = Runs::of(&file.display().to_string(), &run.settings, &outcome);
        let before = all.as_ref().map_or(0, Runs::count);
        let together = match all.take() {
            None => runs,
            Some(others) => others.and(runs)?,
        };
        if together.count() == before {
            note(format!("{about}this run was given twice, and counts once"));
        }
        all = Some(together);
        saturated = saturated.or_else(|| refuse_saturated(&outcome, &run).err());
        first.get_or_insert((run, outcome));
    }
    // At least one, as the command line requires.
    let (Some(runs), Some((run, outcome))) = (all, first) else { return Ok(()) };
    let merged = match runs.merged(args.offset_n) {
        Ok(merged) => merged,
        Err(error) => return Err(saturated.map_or_else(|| error.into(), Error::from)),
    };
    if args.json {
        return print_machine_json(run.settings.machine, &FitJson::new(&merged, args.offset_n));
    }
    text(args, &run, &merged.fit)?;
    match merged.names.as_slice() {
        [_] => output::line(text::counts_line(&run.settings, run.duration_s(), &outcome))?,
        names => output::line(format!("{} together", plural(names.len() as u64, "run")))?,
    }
    Ok(merged.remarks(&run.settings).into_iter().try_for_each(output::line)?)
}

/// Runs the run through the estimator and reports where its sums were restarted; `about` precedes each message.
pub fn replayed(run: &Run, about: &str) -> Result<Outcome, Error> {
    replay_all(run, |t_s, event| {
        match event {
            EstimatorEvent::Changed(_) => {
                note(format!("{about}the device changed at {t_s:.1} s: only the motion since then is fitted"));
            }
            EstimatorEvent::Warned(warning) => {
                note(format!("{about}at {t_s:.1} s {}", warning_words(run.settings.machine, warning.kind)))
            }
            EstimatorEvent::Reversal(_) | EstimatorEvent::Estimate(_) => {}
        }
        Ok(())
    })
}

fn text(args: &Args, run: &Run, fit: &Directions) -> Result<(), Error> {
    let line = |label: &str, unit: &str, cells: [String; 3]| {
        let [alike, positive, negative] = cells;
        let line = format!("{label:<20} {unit:<6} {alike:<22} {positive:<22} {negative}");
        output::line(line.trim_end())
    };
    line("", "", ["alike".into(), "positive".into(), "negative".into()])?;
    let offset = args.offset_n.map_or_else(|| "unknown".to_string(), |offset_n| format!("{offset_n} (given)"));
    let [viscous_positive, viscous_negative] = &fit.viscous_n_s_per_m;
    let coulomb = match &fit.coulomb_by_direction_n {
        Some([positive, negative]) => [value_text(positive), value_text(negative)],
        None => [format!("mean {}", value_text(&fit.coulomb_n)), String::new()],
    };
    let [coulomb_positive, coulomb_negative] = coulomb;
    let by_direction = [
        [value_text(&fit.inertance_kg), String::new()],
        [value_text(viscous_positive), value_text(viscous_negative)],
        [coulomb_positive, coulomb_negative],
        [offset, String::new()],
    ];
    for ((field, alike), [positive, negative]) in
        catalogue::parameters(run.settings.machine, &fit.symmetric).zip(by_direction)
    {
        line(field.label, field.unit, [value_text(&alike), positive, negative])?;
    }
    let residual = |rms_n: f64| amount_text(rms_n, 3);
    let unit = catalogue::unit(run.settings.machine, "N");
    line("Residual, rms", unit, [residual(fit.symmetric_residual_rms_n), residual(fit.residual_rms_n), String::new()])?;
    output::line("")?;
    if args.offset_n.is_none() {
        output::lines(format!(
            "fc+ - fc- + 2 F0 is {} {unit}: a {} offset cannot be distinguished from a Coulomb friction that differs by direction;\n\
             give the offset with --offset-n (0 after a tare without load) to separate fc+ and fc-",
            value_text(&fit.difference_n),
            description(run.settings.machine, "force")
        ))?;
    }
    Ok(())
}
