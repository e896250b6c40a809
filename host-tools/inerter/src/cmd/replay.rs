//! `inerter replay`: a recording or CSV through the estimator.

use std::path::PathBuf;

use inerter::{
    Error, output,
    replay::replay,
    report::{self, EstimateJson, json_line},
    run::Run,
};

use super::{
    args::FileSettingsArgs,
    terminal::{Progress, note},
};

/// Rows of the table that a person sees when nothing else is asked for.
const ROWS: f64 = 20.0;

/// Run the estimator over a recording or a CSV file.
///
/// The result is what the device itself would have said, to the bit.
/// FILE is a recording (.mcap) or a CSV with the columns t_s, encoder_count, force_n and, optionally, terminal_m, in any
/// order, with a header. The sample rate comes from t_s; missing samples are treated as gaps. A CSV needs
/// --metres-per-count. Settings: those of the recording (for a CSV the defaults below), then --settings, then --set,
/// then --metres-per-count; later ones win.
///
/// With --json one object a line: {"kind":"estimate","t_s":..,"whole_run":{..},"inertance_kg":{"value":..,"u95":..,
/// "status":"ok"},..}, the last with "final":true. docs/CLI.md describes it.
#[derive(clap::Args)]
#[command(after_long_help = inerter::settings::help_table())]
pub struct Args {
    /// Recording (.mcap) or CSV file
    file: PathBuf,
    #[command(flatten)]
    settings: FileSettingsArgs,
    /// Print JSON, one object a line
    #[arg(long)]
    json: bool,
    /// Print a row at most every so many seconds of the run; 0 prints every estimate, without --every about 20 rows
    #[arg(long, value_name = "SECONDS", conflicts_with = "json", value_parser = super::args::seconds, allow_negative_numbers = true)]
    every: Option<std::time::Duration>,
}

pub fn run(args: &Args) -> Result<(), Error> {
    let run = Run::open(&args.file, &args.settings.overrides()?)?;
    run.notes.iter().for_each(note);
    let mut progress = Progress::new("replaying", run.samples.len() as u64);
    let every_s = args.every.map_or(run.duration_s() / ROWS, |every| every.as_secs_f64());
    let half_s = 0.5 / run.settings.publish_rate_hz;
    let (mut next_s, mut taken, mut header) = (run.start_s + every_s, 0u64, true);
    let outcome = replay(&run, |t_s, estimate| -> Result<(), Error> {
        taken += 1;
        progress.set((taken as f64 * run.settings.sample_rate_hz / run.settings.publish_rate_hz) as u64);
        if args.json {
            output::line(json_line(&EstimateJson::live(t_s, estimate)))?;
        } else if t_s + half_s >= next_s {
            if std::mem::take(&mut header) {
                output::line(report::row_header())?;
            }
            output::line(report::row(t_s, estimate))?;
            while every_s > 0.0 && next_s <= t_s + half_s {
                next_s += every_s;
            }
        }
        Ok(())
    })?;
    progress.done();
    if args.json {
        return Ok(output::line(json_line(&EstimateJson::last(
            outcome.t_s,
            &outcome.estimate,
            Some(outcome.counters),
        )))?);
    }
    if !header {
        output::line("")?;
    }
    output::line(report::table(&outcome.estimate, run.settings.memory_s, run.truth.as_ref()).trim_end())?;
    output::line("")?;
    Ok(output::line(report::counts_line(&run, &outcome))?)
}
