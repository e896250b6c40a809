//! `inerter diagnose`: what breaks the law of the estimator in a run.

use std::path::PathBuf;

use inerter_analysis::{
    calibrate::refuse_saturated,
    diagnose::{Cause, Diagnosis, Encoder, Kind, diagnose},
};
use inerter_core::{LawStatus, Machine, WarningKind};
use inerter_data::{
    causes::{self, warning_words},
    json::{LawJson, ParametersJson, machine_json_line},
    output,
    replay::{Outcome, replay_all},
    run::Run,
    series::Series,
    text::value_text,
    words::plural,
};
use inerter_wire::{EstimatorEvent, catalogue};
use serde::Serialize;

use super::{args::FileSettingsArgs, terminal::note};
use crate::Error;

/// Name what breaks the law of the estimator in a recording or a CSV file.
///
/// The law is F = mt a + cf v + fc sgn(v) + F0. Where force noise and encoder steps do not explain what it leaves over, a cause is
/// sought: friction that grows with the load, that repeats with the turns of the screw, falls with the speed, turns over a distance or
/// changes with time, a skew between force and position, an encoder error, friction by direction. Each is added to the law, the one that
/// explains most first, as long as it explains more than noise and steps ever do. The parameters are given again with all of them
/// included. Samples that no device can be blamed for are named as well: lost counts, a clipped or dead force, a wrong sign.
///
/// What repeats with the turns of the screw is sought at the usual counts per turn, and intervals hold all that are possible;
/// --counts-per-turn says what they are.
///
/// With --json one object: {"kind":"diagnosis","law":{..},"causes":[{"name":..}],"corrected":{..}}. docs/CLI.md describes it.
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
    match text.parse::<f64>() {
        Ok(counts) if counts.is_finite() && counts >= 4.0 => Ok(counts),
        _ => Err("a number of counts is needed, 4 or more, for example 4096".into()),
    }
}

/// A gate that samples failed, and how often.
type Gate = (WarningKind, u32);

pub fn run(args: &Args) -> Result<(), Error> {
    let run = inerter_data::open(&args.file, &args.settings.overrides()?)?;
    run.notes.iter().for_each(note);
    let (mut gates, mut since_s): (Vec<Gate>, _) = (Vec::new(), None);
    let outcome = replay_all(&run, |t_s, event| -> Result<(), Error> {
        match event {
            EstimatorEvent::Warned(warning) => match gates.iter_mut().find(|(kind, _)| *kind == warning.kind) {
                Some((_, times)) => *times += 1,
                None => gates.push((warning.kind, 1)),
            },
            EstimatorEvent::Changed(_) => since_s = Some(t_s),
            EstimatorEvent::Reversal(_) | EstimatorEvent::Estimate(_) => {}
        }
        Ok(())
    })?;
    let mut series = Series::of(&run);
    if let Some(since_s) = since_s {
        note(format!("the device changed at {since_s:.1} s: only the motion since is looked at"));
        series.cut_before(since_s);
    }
    let found = match diagnose(
        &series,
        &run.settings,
        &outcome.published(),
        Encoder { counts_per_turn: args.counts_per_turn, counts_per_line: args.counts_per_line },
    ) {
        Ok(found) => found,
        Err(error) => {
            refuse_saturated(&outcome, &run)?;
            return Err(error.into());
        }
    };
    if args.json { json(&run, &outcome, &gates, &found) } else { text(&run, &outcome, &gates, &found) }
}

/// A diagnosis in JSON.
#[derive(Serialize)]
struct DiagnosisJson {
    kind: &'static str,
    law: LawJson,
    causes: Vec<CauseJson>,
    corrected: Option<ParametersJson>,
}

/// A cause in JSON.
#[derive(Serialize)]
pub struct CauseJson {
    name: &'static str,
    value: f64,
    u95: Option<f64>,
    unit: &'static str,
    f: Option<f64>,
    period_m: Option<f64>,
    rival: Option<&'static str>,
}

impl CauseJson {
    /// One that was found.
    pub fn new(machine: Machine, cause: &Cause) -> Self {
        Self {
            name: cause.kind.name(),
            value: cause.value,
            u95: Some(cause.u95).filter(|u95| u95.is_finite()),
            unit: cause.unit(machine),
            f: Some(cause.f),
            period_m: cause.period_m,
            rival: cause.rival.map(Kind::name),
        }
    }
}

fn json(run: &Run, outcome: &Outcome, gates: &[Gate], found: &Diagnosis) -> Result<(), Error> {
    let machine = run.settings.machine;
    let gates = gates.iter().map(|(kind, times)| CauseJson {
        name: causes::Cause::Samples(*kind).name(),
        value: f64::from(*times),
        u95: None,
        unit: "times",
        f: None,
        period_m: None,
        rival: None,
    });
    let causes = found.causes.iter().map(|cause| CauseJson::new(machine, cause));
    let line = DiagnosisJson {
        kind: "diagnosis",
        law: outcome.law.into(),
        causes: gates.chain(causes).collect(),
        corrected: found.corrected.as_ref().map(ParametersJson::from),
    };
    Ok(output::line(machine_json_line(machine, &line))?)
}

fn text(run: &Run, outcome: &Outcome, gates: &[Gate], found: &Diagnosis) -> Result<(), Error> {
    let machine = run.settings.machine;
    output::line(match outcome.law.status {
        LawStatus::Holds if !found.causes.is_empty() => {
            "The law holds as far as the estimator sees. Near the reversals, or over the whole run, the samples show more:"
        }
        LawStatus::Holds => "The law holds: force noise and encoder steps explain what it leaves over.",
        LawStatus::Broken => "The law is broken: it leaves more over than force noise and encoder steps explain.",
        LawStatus::Unknown => "Whether the law holds is not known: too little was seen, or the flanks may part.",
    })?;
    for (kind, times) in gates {
        output::line(format!("- {}: {}", plural(u64::from(*times), "time"), warning_words(machine, *kind)))?;
    }
    for cause in &found.causes {
        output::line(format!("- {}", cause.sentence(machine)))?;
    }
    if found.causes.is_empty() {
        let more = if outcome.law.status == LawStatus::Broken { " that is known here" } else { "" };
        return Ok(output::line(format!("No cause{more} explains more than noise and steps could."))?);
    }
    if let Some(corrected) = &found.corrected {
        output::line("")?;
        output::line(format!("{:<20} {:<6} {:<22} with that included", "", "", "whole run"))?;
        let whole = catalogue::parameters(machine, &outcome.estimate.whole_run);
        for ((field, before), (_, after)) in whole.zip(catalogue::parameters(machine, corrected)) {
            let (before, after) = (value_text(&before), value_text(&after));
            output::line(format!("{:<20} {:<6} {before:<22} {after}", field.label, field.unit))?;
        }
    }
    Ok(())
}
