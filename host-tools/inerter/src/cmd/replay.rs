//! `inerter replay`: runs a recording or CSV through the estimator.

use std::path::{Path, PathBuf};

use inerter_analysis::{
    diagnose::{assumptions, widened},
    results::{Replayed, replayed},
};
use inerter_core::Machine;
use inerter_data::{
    causes::warning_words,
    export::Source,
    json::{EstimateJson, EventJson, ReversalJson},
    limits::Judged,
    output,
    text::{self, change_words},
};
use inerter_wire::{EstimatorEvent, EventKind};

use super::{
    args::FileSettingsArgs,
    limits::{Held, LimitsArgs, heard, judged_line, prove},
    print::print_machine_json,
    shard::StoreArgs,
    tables,
    terminal::Progress,
};
use crate::Error;

/// Rows in the table for a person, by default.
const ROWS: f64 = 20.0;

/// Run the estimator over a recording or a CSV file.
///
/// The result is exactly what the device would have reported, to the bit. FILE is a recording (.mcap) or a CSV with the
/// columns t_s, encoder_count, force_n and, optionally, terminal_m, in any order, with a header; for a rotary machine
/// torque_n_m and terminal_rad. The sample rate comes from t_s; the estimator assumes nothing about missing samples. A
/// CSV needs --metres-per-count. Settings: those of the recording (for a CSV the defaults below), then --settings, then
/// --set, then --metres-per-count; later ones win.
///
/// With --json one object per line: {"kind":"estimate","t_s":..,"whole_run":{..},"inertance_kg":{"value":..,"u95":..,
/// "status":"ok"},..,"backlash_m":{..},..}, the last with "final":true; {"kind":"reversal",..} for each reversal of the
/// flanks and {"kind":"event","code":"changed",..} for each change of the device, "warned.clipped_force" and the like
/// for samples that no device could produce. If the residual of the law is larger than chance explains, the causes
/// found in the last minute are reported at the end, as by `inerter diagnose`. Parameters that the motion could not
/// identify are reported last, with a motion that would have, as by `inerter plan`. docs/CLI.md describes them.
///
/// With --store the runs of a store are replayed, or with --shard a part of them, and the results are kept there in a
/// batch: `inerter replay --store runs --shard 3/100` in the third of a hundred jobs. Runs that the batch already has
/// are not repeated. A run that fails is kept with its error, and the exit code is 3. docs/STORE.md describes batches.
///
/// With --limits each parameter that the file names passes if its 95 % interval lies within the limits, fails if it
/// lies beyond one, and is otherwise undecided (ISO 14253-1); the exit code is 10 unless all pass.
#[derive(clap::Args)]
#[command(after_long_help = inerter_data::settings::help_table())]
pub struct Args {
    /// Recording (.mcap) or CSV file
    #[arg(required_unless_present = "store", conflicts_with = "store")]
    file: Option<PathBuf>,
    #[command(flatten)]
    settings: FileSettingsArgs,
    /// Print JSON, one object per line
    #[arg(long)]
    json: bool,
    /// Print at most one row per this many seconds of the run; 0 prints every estimate [default: about 20 rows]
    #[arg(long, value_name = "SECONDS", conflicts_with = "json", value_parser = super::args::seconds, allow_negative_numbers = true)]
    every: Option<std::time::Duration>,
    #[command(flatten)]
    limits: LimitsArgs,
    /// Replace the files of --junit and --verdicts if they exist
    #[arg(long, help_heading = "Limits")]
    force: bool,
    #[command(flatten)]
    store: StoreArgs,
}

pub fn run(args: &Args) -> Result<(), Error> {
    match (&args.file, &args.store.store) {
        (Some(file), _) => replay(file, args),
        (None, Some(url)) => tables::replay(url, &args.store, &args.settings, args.json),
        // The command line requires one of them.
        (None, None) => Ok(()),
    }
}

fn replay(file: &Path, args: &Args) -> Result<(), Error> {
    let settings = args.settings.settings.settings.as_deref();
    args.limits.check([file].into_iter().chain(settings), [], args.force)?;
    let run = args.settings.source(file)?;
    let machine = run.settings.machine;
    let limits = args.limits.read(machine)?;
    let mut progress = Progress::new("replaying", run.extent.samples);
    let every_s = args.every.map_or(run.duration_s() / ROWS, |every| every.as_secs_f64());
    let half_s = 0.5 / run.settings.publish_rate_hz;
    let (mut next_s, mut taken, mut header) = (run.start_s + every_s, 0u64, true);
    let replayed = replayed(
        &run.settings,
        run.start_s,
        run.samples()?.map(|sample| sample.map_err(Error::from)),
        |t_s, event| -> Result<(), Error> {
            let EstimatorEvent::Estimate(estimated) = event else {
                return heard(tell(machine, t_s, event, args.json, &mut header), limits.is_some());
            };
            taken += 1;
            progress.set((taken as f64 * run.settings.sample_rate_hz / run.settings.publish_rate_hz) as u64);
            let said = if args.json {
                print_machine_json(machine, &EstimateJson::live(t_s, estimated, &run.settings))
            } else if t_s + half_s >= next_s {
                while every_s > 0.0 && next_s <= t_s + half_s {
                    next_s += every_s;
                }
                head(machine, &mut header).and_then(|()| Ok(output::line(text::row(t_s, estimated))?))
            } else {
                Ok(())
            };
            heard(said, limits.is_some())
        },
    )?;
    progress.done();
    let within = limits.map(|limits| replayed.told().within(&limits));
    let Some(judged) = &within else { return say(args, &run, &replayed, header, None) };
    let held = [Held { run: file.display().to_string(), is_file: true, machine, judged }];
    args.limits.write(args.force, &held)?;
    let said = heard(say(args, &run, &replayed, header, Some(judged)), true);
    prove(&held).and(said)
}

/// Prints the result of the whole run, and the verdicts on its limits (`within`).
fn say(args: &Args, run: &Source, replayed: &Replayed, header: bool, within: Option<&[Judged]>) -> Result<(), Error> {
    let machine = run.settings.machine;
    if args.json {
        return print_machine_json(machine, &replayed.json(within));
    }
    if !header {
        output::line("")?;
    }
    let Replayed { outcome, judged, causes, advice, .. } = replayed;
    output::lines(text::table(&outcome.estimated(), &run.settings, run.truth.as_ref()).trim_end())?;
    output::line(text::counts_line(&run.settings, run.duration_s(), outcome))?;
    widened(machine, &outcome.estimate.whole_run, judged).map_or(Ok(()), output::line)?;
    assumptions(machine, judged, causes).map_or(Ok(()), output::line)?;
    replayed.remarks().map(|(_, words)| words).try_for_each(output::line)?;
    advice.iter().map(|advice| advice.sentence(machine)).try_for_each(output::line)?;
    Ok(within.into_iter().flatten().map(|judged| judged_line(machine, judged)).try_for_each(output::line)?)
}

/// Events other than estimates: all of them in JSON; for a person only the changes, and the scatter of the reversals as
/// an interval.
pub fn tell(machine: Machine, t_s: f64, event: &EstimatorEvent, json: bool, header: &mut bool) -> Result<(), Error> {
    let (index, kind, words) = match event {
        EstimatorEvent::Reversal(reversal) if json => {
            return print_machine_json(machine, &ReversalJson::new(Some(t_s), reversal));
        }
        EstimatorEvent::Changed(change) => (change.index, EventKind::Changed(*change), change_words(machine, change)),
        EstimatorEvent::Warned(warning) => {
            (warning.index, EventKind::Warned(*warning), warning_words(machine, warning.kind))
        }
        EstimatorEvent::Reversal(_) | EstimatorEvent::Estimate(..) => return Ok(()),
    };
    if json {
        return print_machine_json(machine, &EventJson::new(Some(t_s), index, &kind, machine));
    }
    head(machine, header)?;
    Ok(output::line(format!("{t_s:>9.2}  {words}"))?)
}

/// Prints the header row, once.
fn head(machine: Machine, header: &mut bool) -> Result<(), Error> {
    if std::mem::take(header) {
        output::line(text::row_header(machine))?;
    }
    Ok(())
}
