//! `inerter diagnose`: what breaks the law of the estimator in a run.

use std::path::PathBuf;

use inerter_analysis::{
    calibrate::refuse_saturated,
    diagnose::{Cause, Diagnosis, Encoder, Kind, diagnose, is_reversed},
    fit::FitError,
};
use inerter_core::{LawStatus, Machine, Parameters, Warning, WarningKind};
use inerter_data::{
    causes::{self, warning_words},
    gated::Gated,
    json::{LawJson, ParametersJson, machine_json_line},
    output,
    replay::{Outcome, replay_all},
    run::Run,
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
/// changes with time or with the square of the velocity, a skew between force and position, an encoder error, friction by direction, a
/// spring, a position that gives way, a force that is not measured in proportion, a mass on the terminal that moves otherwise than the
/// screw. Each is added to the law, the one that explains most first, as long as it explains more than noise and steps ever do. The
/// parameters are given again with all of them included. Samples that no device can be blamed for are named as well: lost counts, a clipped or dead force, a wrong sign.
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

/// What a run shows, or why no cause could be sought in it.
type Found = Result<Diagnosis, Unsought>;

/// Why no cause could be sought beside what is wrong with the samples.
enum Unsought {
    /// The force pushes the wrong way.
    Reversed,
    /// What is left of the run is too little.
    Unfit(FitError),
}

impl Unsought {
    fn words(&self) -> String {
        match self {
            Self::Reversed => {
                "No other cause is sought, and no parameter is given, while the force pushes the wrong way.".into()
            }
            Self::Unfit(error) => {
                format!("No other cause is sought, and no parameter is given, in the samples that are left: {error}.")
            }
        }
    }
}

pub fn run(args: &Args) -> Result<(), Error> {
    let run = inerter_data::open(&args.file, &args.settings.overrides()?)?;
    run.notes.iter().for_each(note);
    let (mut told, mut since_s): (Vec<Warning>, _) = (Vec::new(), None);
    let outcome = replay_all(&run, |t_s, event| -> Result<(), Error> {
        match event {
            EstimatorEvent::Warned(warning) => told.push(*warning),
            EstimatorEvent::Changed(_) => since_s = Some(t_s),
            EstimatorEvent::Reversal(_) | EstimatorEvent::Estimate(_) => {}
        }
        Ok(())
    })?;
    let mut gated = Gated::of(&run, &told);
    let gates = gates(&told, &gated);
    if let Some(since_s) = since_s {
        note(format!("the device changed at {since_s:.1} s: only the motion since is looked at"));
        gated.series.cut_before(since_s);
    }
    let published = outcome.published();
    let encoder = Encoder { counts_per_turn: args.counts_per_turn, counts_per_line: args.counts_per_line };
    let found = match diagnose(&gated.series, &run.settings, &published, encoder) {
        _ if is_reversed(&published) => Err(Unsought::Reversed),
        Ok(found) => Ok(found),
        Err(error) if gates.is_empty() => {
            refuse_saturated(&outcome, &run)?;
            return Err(error.into());
        }
        Err(error) => Err(Unsought::Unfit(error)),
    };
    let corrected = corrected(&outcome, &gated, &found);
    if args.json {
        json(&run, &outcome, &gates, &found, corrected)
    } else {
        text(&run, &outcome, &gates, &gated, &found, corrected)
    }
}

/// What is wrong with samples, in the order of the list: what the estimator said, and what only the whole run shows.
fn gates(told: &[Warning], gated: &Gated) -> Vec<Gate> {
    let times = |kind: WarningKind| {
        let told = told.iter().filter(|warning| warning.kind == kind).count() as u32;
        told.max(u32::from(gated.left_out.contains(&kind)))
    };
    let all = causes::Cause::ALL.into_iter().filter_map(|cause| match cause {
        causes::Cause::Samples(kind) => Some((kind, times(kind))),
        causes::Cause::Law(_) => None,
    });
    all.filter(|(_, times)| *times > 0).collect()
}

/// The parameters with all that was found beside them. Where nothing breaks the law they are its own, without samples that tell
/// nothing of the device; nothing where these are not known, something else is left over, or the force pushes the wrong way.
fn corrected(outcome: &Outcome, gated: &Gated, found: &Found) -> Option<Parameters> {
    let found = found.as_ref().ok().filter(|_| gated.not_found.is_empty())?;
    if !found.causes.is_empty() {
        return found.corrected;
    }
    if gated.has_no_force() {
        // The estimator takes samples in until it sees what they are, and some beside those that it then leaves out.
        return found.corrected.filter(|_| found.is_explained());
    }
    let holds = outcome.law.misfit.is_some_and(|misfit| misfit.ratio <= misfit.limit);
    holds.then_some(outcome.estimate.whole_run)
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

fn json(
    run: &Run,
    outcome: &Outcome,
    gates: &[Gate],
    found: &Found,
    corrected: Option<Parameters>,
) -> Result<(), Error> {
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
    let causes = found.iter().flat_map(|found| &found.causes).map(|cause| CauseJson::new(machine, cause));
    let line = DiagnosisJson {
        kind: "diagnosis",
        law: outcome.law.into(),
        causes: gates.chain(causes).collect(),
        corrected: corrected.as_ref().map(ParametersJson::from),
    };
    Ok(output::line(machine_json_line(machine, &line))?)
}

fn text(
    run: &Run,
    outcome: &Outcome,
    gates: &[Gate],
    gated: &Gated,
    found: &Found,
    corrected: Option<Parameters>,
) -> Result<(), Error> {
    let machine = run.settings.machine;
    let causes: &[Cause] = found.as_ref().map_or(&[], |found| &found.causes);
    output::line(match outcome.law.status {
        LawStatus::Holds if !causes.is_empty() => {
            "The law holds as far as the estimator sees. Near the reversals, or over the whole run, the samples show more:"
        }
        LawStatus::Holds => "The law holds: force noise and encoder steps explain what it leaves over.",
        LawStatus::Broken => "The law is broken: it leaves more over than force noise and encoder steps explain.",
        LawStatus::Unknown => "Whether the law holds is not known: too little was seen, or the flanks may part.",
    })?;
    for (kind, times) in gates {
        output::line(format!("- {}: {}", plural(u64::from(*times), "time"), warning_words(machine, *kind)))?;
    }
    for cause in causes {
        output::line(format!("- {}", cause.sentence(machine)))?;
    }
    if let Err(unsought) = found {
        return Ok(output::line(unsought.words())?);
    }
    if causes.is_empty() {
        let more = if outcome.law.status == LawStatus::Broken { " that is known here" } else { "" };
        output::line(format!("No cause{more} explains more than noise and steps could."))?;
        return match &corrected {
            Some(corrected) if gated.has_no_force() => table(machine, outcome, "without these samples", corrected),
            _ => Ok(()),
        };
    }
    if let Some(corrected) = &corrected {
        table(machine, outcome, "with that included", corrected)?;
    } else if !gated.not_found.is_empty() {
        output::line("No parameters are given with that included: which samples were bad is not known.")?;
    }
    Ok(())
}

/// The parameters of the whole run by the estimator, and what they are otherwise.
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
