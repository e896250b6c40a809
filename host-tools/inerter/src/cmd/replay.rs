//! `inerter replay`: a recording or CSV through the estimator.

use std::{cell::RefCell, path::PathBuf};

use inerter_analysis::{
    diagnose::{Judged, Latest, assumptions, judged, suspected, widened},
    fit::Products,
    plan::{Advice, Reach, advice, duration_s},
};
use inerter_core::Machine;
use inerter_data::{
    causes::{Cause as Suspect, warning_words},
    export::Source,
    full_scale::Peaks,
    json::{EstimateJson, EventJson, ReversalJson, WarningJson, machine_json_line, rounded_s},
    names::parameter,
    output,
    replay::{Outcome, replay_samples},
    text::{self, change_words},
    uncertainty::{BudgetJson, UncertaintyJson},
};
use inerter_wire::{EstimatorEvent, EventKind};
use serde::Serialize;
use serde_json::{Map, Value, json};

use super::{
    args::FileSettingsArgs,
    plan::part_json,
    terminal::{Progress, note},
};
use crate::Error;

/// Rows of the table that a person sees when nothing else is asked for.
const ROWS: f64 = 20.0;

/// Run the estimator over a recording or a CSV file.
///
/// The result is what the device itself would have said, to the bit.
/// FILE is a recording (.mcap) or a CSV with the columns t_s, encoder_count, force_n and, optionally, terminal_m, in any
/// order, with a header; of a rotary machine torque_n_m and terminal_rad. The sample rate comes from t_s; the estimator assumes nothing about missing samples. A CSV needs
/// --metres-per-count. Settings: those of the recording (for a CSV the defaults below), then --settings, then --set,
/// then --metres-per-count; later ones win.
///
/// With --json one object a line: {"kind":"estimate","t_s":..,"whole_run":{..},"inertance_kg":{"value":..,"u95":..,
/// "status":"ok"},..,"backlash_m":{..},..}, the last with "final":true; {"kind":"reversal",..} for each reversal of the flanks
/// and {"kind":"event","code":"changed",..} for each change of the device, "warned.clipped_force" and its like for samples that no
/// device can be blamed for. Where the law leaves more over than chance would, what is found in the last minute is told at the end,
/// as by `inerter diagnose`. What the motion could not show is told last, with one that would have, as by `inerter plan`. docs/CLI.md
/// describes them.
#[derive(clap::Args)]
#[command(after_long_help = inerter_data::settings::help_table())]
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
    let mut reading = Progress::through("reading", &args.file);
    let run = Source::open(&args.file, &args.settings.overrides()?, |offset| reading.set(offset))?;
    reading.done();
    run.notes.iter().for_each(note);
    let mut progress = Progress::new("replaying", run.extent.samples);
    let every_s = args.every.map_or(run.duration_s() / ROWS, |every| every.as_secs_f64());
    let half_s = 0.5 / run.settings.publish_rate_hz;
    let (mut next_s, mut taken, mut header) = (run.start_s + every_s, 0u64, true);
    let (mut warnings, mut told) = (Vec::new(), Vec::new());
    let latest = RefCell::new(Latest::new(&run.settings));
    let mut reach = Reach::new(&run.settings);
    let outcome = replay_samples(
        &run.settings,
        run.start_s,
        run.samples()?.map(|sample| sample.map_err(Error::from)).inspect(|sample| {
            sample.iter().for_each(|sample| {
                latest.borrow_mut().push(*sample);
                reach.push(sample);
            });
        }),
        |t_s, event: &EstimatorEvent| -> Result<(), Error> {
            let EstimatorEvent::Estimate(estimated) = event else {
                match event {
                    EstimatorEvent::Changed(_) => latest.borrow_mut().forget(),
                    EstimatorEvent::Warned(warning) => {
                        latest.borrow_mut().warn(*warning);
                        told.push(warning.kind);
                    }
                    EstimatorEvent::Reversal(_) | EstimatorEvent::Estimate(_) => {}
                }
                warnings.extend(warning(run.settings.machine, t_s, event));
                return tell(run.settings.machine, t_s, event, args.json, &mut header);
            };
            taken += 1;
            progress.set((taken as f64 * run.settings.sample_rate_hz / run.settings.publish_rate_hz) as u64);
            if args.json {
                output::line(machine_json_line(
                    run.settings.machine,
                    &EstimateJson::live(t_s, estimated, &run.settings),
                ))?;
            } else if t_s + half_s >= next_s {
                head(run.settings.machine, &mut header)?;
                output::line(text::row(t_s, estimated))?;
                while every_s > 0.0 && next_s <= t_s + half_s {
                    next_s += every_s;
                }
            }
            Ok(())
        },
    )?;
    progress.done();
    let estimated = outcome.estimated();
    let gated = latest.into_inner().gated();
    let found = suspected(&gated, &run.settings, &outcome.published());
    let judged = judged(&gated.series, &run.settings, &outcome);
    let beyond = Peaks::of(&gated.series).beyond(&run.settings, &outcome.counters).map(|words| ("full_scale", words));
    let advice = advice(&outcome, &run.settings, &reach);
    // What the estimator had no time to see.
    let unseen = gated.left_out.iter().filter(|kind| !told.contains(kind));
    let unseen = unseen.map(|kind| (Suspect::Samples(*kind).name(), warning_words(run.settings.machine, *kind)));
    let causes = found.iter().map(|cause| (cause.kind.name(), cause.sentence(run.settings.machine)));
    let causes = unseen.chain(causes).chain(beyond);
    if args.json {
        warnings.extend(causes.map(|(code, text)| WarningJson { code, t_s: rounded_s(outcome.t_s), text }));
        let last = EstimateJson::last(outcome.t_s, &estimated, &run.settings, Some(outcome.counters));
        return Ok(output::line(machine_json_line(
            run.settings.machine,
            &LastJson {
                last,
                uncertainty: Some(uncertainty(&outcome, judged)),
                warnings,
                advice: advice.as_ref().map(|advice| AdviceJson::new(advice, run.settings.machine)),
            },
        ))?);
    }
    if !header {
        output::line("")?;
    }
    output::lines(text::table(&estimated, &run.settings, run.truth.as_ref()).trim_end())?;
    output::line(text::counts_line(&run.settings, run.duration_s(), &outcome))?;
    widened(run.settings.machine, &outcome.estimate.whole_run, &judged).map_or(Ok(()), output::line)?;
    assumptions(run.settings.machine, &judged, &found).map_or(Ok(()), output::line)?;
    causes.map(|(_, words)| words).try_for_each(output::line)?;
    Ok(advice.iter().map(|advice| advice.sentence(run.settings.machine)).try_for_each(output::line)?)
}

/// The last line of a run.
#[derive(Serialize)]
pub struct LastJson {
    #[serde(flatten)]
    pub last: EstimateJson,
    /// Of the whole run, where it was computed here.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub uncertainty: Option<UncertaintyJson>,
    pub warnings: Vec<WarningJson>,
    /// Which motion would have shown what this one could not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub advice: Option<AdviceJson>,
}

/// What to do about what a run could not show.
#[derive(Serialize)]
pub struct AdviceJson {
    /// Names of what it could not show.
    lacking: Vec<&'static str>,
    /// Names of those that the motion would tell clearly better.
    told: Vec<&'static str>,
    duration_s: Option<f64>,
    parts: Vec<Value>,
    /// What the motion would tell each to, as half widths.
    predicted: Map<String, Value>,
    text: String,
}

impl AdviceJson {
    fn new(advice: &Advice, machine: Machine) -> Self {
        let name = |place: &usize| parameter(Machine::Linear, *place).path;
        let sketch = advice.motion.as_ref().map(|(sketch, _)| sketch);
        let u95 = |(place, u95): (usize, &f64)| {
            let known = Some(*u95).filter(|u95| u95.is_finite());
            (name(&place).to_string(), json!({ "u95": known }))
        };
        Self {
            lacking: advice.lacking.iter().map(name).collect(),
            told: advice.told.iter().map(name).collect(),
            duration_s: sketch.map(|sketch| duration_s(&sketch.parts)),
            parts: sketch.iter().flat_map(|sketch| &sketch.parts).map(part_json).collect(),
            predicted: sketch.iter().flat_map(|sketch| sketch.u95.iter().enumerate()).map(u95).collect(),
            text: advice.sentence(machine),
        }
    }
}

/// What the intervals of the whole run are made of.
fn uncertainty(outcome: &Outcome, judged: [Judged; 4]) -> UncertaintyJson {
    let (sums, more) = outcome.sums();
    let correlation = Products::of(sums, more).and_then(|products| products.correlation()).ok();
    let budgets = judged.map(|Judged { budget, moved_by, assumes }| {
        let assumes = assumes.into_iter().map(|kind| kind.name()).collect();
        BudgetJson::new(&budget, moved_by.map(|kind| kind.name()), assumes)
    });
    UncertaintyJson::new(budgets, &outcome.budgets.contact, correlation)
}

/// What is wrong with the samples, where the event says it.
pub fn warning(machine: Machine, t_s: f64, event: &EstimatorEvent) -> Option<WarningJson> {
    match event {
        EstimatorEvent::Warned(warning) => Some(WarningJson::new(t_s, warning, machine)),
        _ => None,
    }
}

/// What is no estimate: every one in JSON; a person sees the changes, and the scatter of the reversals as an interval.
pub fn tell(machine: Machine, t_s: f64, event: &EstimatorEvent, json: bool, header: &mut bool) -> Result<(), Error> {
    match event {
        EstimatorEvent::Reversal(reversal) if json => {
            output::line(machine_json_line(machine, &ReversalJson::new(Some(t_s), reversal)))?
        }
        EstimatorEvent::Changed(change) if json => {
            output::line(machine_json_line(
                machine,
                &EventJson::new(Some(t_s), change.index, &EventKind::Changed(*change), machine),
            ))?;
        }
        EstimatorEvent::Changed(change) => {
            head(machine, header)?;
            output::line(format!("{t_s:>9.2}  {}", change_words(machine, change)))?;
        }
        EstimatorEvent::Warned(warning) if json => {
            output::line(machine_json_line(
                machine,
                &EventJson::new(Some(t_s), warning.index, &EventKind::Warned(*warning), machine),
            ))?;
        }
        EstimatorEvent::Warned(warning) => {
            head(machine, header)?;
            output::line(format!("{t_s:>9.2}  {}", warning_words(machine, warning.kind)))?;
        }
        EstimatorEvent::Reversal(_) | EstimatorEvent::Estimate(..) => {}
    }
    Ok(())
}

/// Heads the rows, once.
fn head(machine: Machine, header: &mut bool) -> Result<(), Error> {
    if std::mem::take(header) {
        output::line(text::row_header(machine))?;
    }
    Ok(())
}
