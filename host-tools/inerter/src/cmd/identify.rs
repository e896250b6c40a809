//! `inerter identify`: the complete model of the device from one or more files.

use std::path::PathBuf;

use inerter_analysis::{
    identify::{Found, FoundStatus, Identified, Options, SegmentFit, identify},
    response::Beside,
    results::{IdentifyJson, responses},
};
use inerter_core::Machine;
use inerter_data::{
    json::ParameterJson,
    names::description,
    output,
    run::Run,
    words::{amount_text, interval_text, rounded_text},
};
use inerter_plant::Excitation;
use inerter_simulate::SimulateError;
use inerter_wire::catalogue;

use super::{
    args::{FileSettingsArgs, at_least},
    print::print_machine_json,
    terminal::{Progress, note},
};
use crate::Error;

/// Identify the complete model of a device from recordings or CSV files.
///
/// With the terminal's displacement (a sensor, or --excite) inertance, viscous and Coulomb friction, contact stiffness
/// and damping, backlash, structure mass, force offset and skew are fitted by simulation to encoder and force together.
/// Each gets a 95 % interval, or the reason why this motion cannot identify it. Without the displacement the law of the
/// estimator is fitted: inertance, friction and offset. In either case the law is also fitted to each segment
/// separately.
///
/// The structure mass is taken from the settings, within structure_mass_u95_kg and 5 %, and the skew within skew_u95_s;
/// --free mr and --free tau fit them to the data. Several files are one device, each with its own force offset. For
/// validation, the last 30 % of each file are predicted by a fit of the first 70 %, and what remains unexplained there
/// is reported.
///
/// The frequency response of force over displacement (H1 or steady tones, with coherence and interval) is measured as
/// well, and compared with that of the ideal inertance and of the fitted complete model.
///
/// --staged proceeds as Li, Liang and Wang did: the slowest file gives the Coulomb friction, the next ones the rest;
/// the fastest of three or more validates.
///
/// With --json one object: {"kind":"identify",..}. docs/CLI.md describes it.
#[derive(clap::Args)]
#[command(after_long_help = inerter_data::settings::help_table())]
pub struct Args {
    /// Recordings (.mcap) or CSV files of one device
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Take friction from the slowest file and the rest from the next ones; the fastest validates
    #[arg(long)]
    staged: bool,
    /// Length of the segments that are fitted separately [default: from one discontinuity to the next]
    #[arg(long, value_name = "SECONDS", value_parser = segment)]
    segments: Option<f64>,
    /// Fit this too, instead of taking it from the settings; may be repeated
    #[arg(long, value_name = "PARAMETER")]
    free: Vec<Free>,
    /// Motion of the terminal from time 0, instead of a sensor: as in `inerter simulate --excite`
    #[arg(long, value_name = "MOTION")]
    excite: Option<String>,
    /// Seed of that motion, if it is random
    #[arg(long, value_name = "NUMBER", default_value_t = 1, requires = "excite")]
    seed: u64,
    /// Print the measured frequency response of each file beside the ideal and the complete model; --json always has it
    #[arg(long)]
    response: bool,
    /// Skip the profiles of weakly determined parameters, which take longest
    #[arg(long)]
    no_profiles: bool,
    #[command(flatten)]
    settings: FileSettingsArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// What may be left to the data.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Free {
    /// Structure mass
    Mr,
    /// Skew
    Tau,
}

fn segment(text: &str) -> Result<f64, String> {
    at_least(text, 0.5, "a number of seconds is needed, 0.5 or more, for example 10")
}

pub fn run(args: &Args) -> Result<(), Error> {
    let overrides = args.settings.overrides()?;
    let runs = args.files.iter().map(|file| inerter_data::open(file, &overrides)).collect::<Result<Vec<_>, _>>()?;
    runs.iter().flat_map(|run| &run.notes).for_each(note);
    let excite = args.excite.as_deref().map(|text| Excitation::parse(text, args.seed));
    let options = Options {
        staged: args.staged,
        segment_s: args.segments,
        free_structure_mass: args.free.contains(&Free::Mr),
        free_skew: args.free.contains(&Free::Tau),
        excite: excite.transpose().map_err(SimulateError::from)?,
        no_profiles: args.no_profiles,
    };
    let mut bar = Progress::new("identifying", 1000);
    let found = identify(&runs, &options, &mut |done| bar.set_part(done));
    bar.done();
    let found = found?;
    if args.json {
        let files: Vec<String> = args.files.iter().map(|file| file.display().to_string()).collect();
        let line = IdentifyJson::new(files, &runs, &found);
        return print_machine_json(machine(&runs), &line);
    }
    found.notes.iter().for_each(note);
    text(args, &runs, &found)?;
    if args.response {
        for (run, response) in runs.iter().zip(responses(&runs, &found)) {
            response_text(&run.name, run.settings.machine, &response)?;
        }
    }
    Ok(())
}

fn response_text(name: &str, machine: Machine, response: &Beside) -> Result<(), Error> {
    output::line("")?;
    if response.points.is_empty() {
        return Ok(output::line(format!("{name}: too short, or with too little motion, for a frequency response"))?);
    }
    let quotient = description(machine, "force over the displacement");
    output::line(format!("{name}: {quotient} of the {}, by {}", response.input, response.method))?;
    let unit = catalogue::unit(machine, "N/m");
    let [measured, ideal, complete] = ["measured", "ideal", "complete"].map(|name| format!("{name} {unit}"));
    output::line(format!("      Hz   {measured:<20} degrees        coherence  {ideal}  degrees  {complete}  degrees"))?;
    for row in &response.points {
        output::line(format!(
            "{:>8.3}   {:<9.4e} ± {:>4.1} %   {:>6.1} ± {:<5.1} {:>8.4}  {:>10.4e}  {:>6.1}   {:>10.4e}  {:>6.1}",
            row.frequency_hz,
            row.measured.magnitude_n_per_m,
            100.0 * row.magnitude_u95,
            row.measured.phase_deg,
            row.phase_u95_deg,
            row.coherence,
            row.ideal.magnitude_n_per_m,
            row.ideal.phase_deg,
            row.complete.magnitude_n_per_m,
            row.complete.phase_deg,
        ))?;
    }
    Ok(())
}

/// Label, unit and the name among the simulator's true values, in the order of the parameters.
const LABELS: [(&str, &str, &str); 9] = [
    ("Effective inertance", "kg", "inertance_kg"),
    ("Viscous friction", "N s/m", "viscous_n_s_per_m"),
    ("Coulomb friction", "N", "coulomb_n"),
    ("Contact stiffness", "N/m", "stiffness_n_per_m"),
    ("Contact damping", "N s/m", "contact_damping_n_s_per_m"),
    ("Backlash", "µm", "backlash_m"),
    ("Structure mass", "kg", "structure_mass_kg"),
    ("Force offset", "N", "force_offset_n"),
    ("Skew", "µs", "delay_s"),
];

/// The machine kind of the runs.
fn machine(runs: &[Run]) -> Machine {
    runs.first().map_or(Machine::Linear, |run| run.settings.machine)
}

fn text(args: &Args, runs: &[Run], found: &Identified) -> Result<(), Error> {
    let machine = machine(runs);
    let [newton, metre] = ["N", "µm"].map(|unit| catalogue::unit(machine, unit));
    let truth = runs.first().and_then(|run| run.truth.as_ref());
    for ((label, unit, name), (_, parameter)) in LABELS.into_iter().zip(found.parameters.named()) {
        let micro = if unit.starts_with('µ') { 1e6 } else { 1.0 };
        let true_value = truth.and_then(|truth| truth.get(name)).and_then(|value| value.parse::<f64>().ok());
        let truth = true_value.map_or(String::new(), |value| format!("truth {}", rounded(value * micro)));
        let (label, unit) = (description(machine, label), catalogue::unit(machine, unit));
        let line = format!("{label:<20} {unit:<6} {:<26} {truth}", cell(parameter, micro));
        output::line(line.trim_end())?;
        if let Some(reason) = &parameter.reason {
            output::line(format!("{:28}{}", "", description(machine, reason)))?;
        }
        if let (Some(ends), Some(u95)) = (parameter.profile, parameter.u95.filter(|u95| *u95 > 0.0)) {
            let [low, high] = ends.map(|end| rounded_text(end * micro, u95 * micro));
            output::line(format!("{:28}by its profile {low} to {high}", ""))?;
        }
    }
    output::line("")?;
    output::line(format!("{:<20} {:<6} {}", "Residual, rms", newton, amount_text(found.residual_rms_n, 3)))?;
    if let Some(metres) = found.residual_rms_m {
        output::line(format!("{:<20} {:<6} {}", "of the encoder", metre, amount_text(metres * 1e6, 3)))?;
    }
    if let Some(ratio) = found.residual_over_noise {
        output::line(format!("{:<27} {ratio:.2} times what the sensors' noise explains", "Residual"))?;
    }
    if let Some(white) = &found.whiteness {
        let verdict = if white.p > 0.01 { "white" } else { "not white" };
        output::line(format!(
            "{:<27} {verdict}: Ljung-Box {:.1} over {} delays, p = {:.2e}",
            "Residual", white.statistic, white.lags, white.p
        ))?;
    }
    if let Some(validation) = &found.validation {
        let what = match validation.fitted {
            0.0 => "the last file, which was not fitted".to_string(),
            fitted => format!("the last {:.0} %, fitted to the rest", 100.0 * (1.0 - fitted)),
        };
        output::line(format!(
            "{:<27} {} {newton} unexplained, {:.4} % explained, on {what}",
            "Validation",
            amount_text(validation.residual_rms_n, 3),
            100.0 * validation.explained
        ))?;
    }
    for (file, segments) in args.files.iter().zip(&found.segments) {
        if segments.len() > 1 || args.segments.is_some() {
            output::line("")?;
            output::line(format!("{}, by segment", file.display()))?;
            let [from, to, plus, minus] = ["from s", "to s", "cf+", "cf-"];
            let columns = [("mt", "kg"), ("cf", "N s/m"), ("fc", "N"), ("residual", "N")];
            let [mt, cf, fc, residual] =
                columns.map(|(name, unit)| format!("{name} {}", catalogue::unit(machine, unit)));
            output::line(format!("{from:>8} {to:>8} {mt:<16} {cf:<16} {fc:<16} {plus:<16} {minus:<16} {residual}"))?;
            segments.iter().try_for_each(segment_line)?;
        }
    }
    Ok(())
}

fn segment_line(segment: &SegmentFit) -> Result<(), Error> {
    let times = format!("{:>8.2} {:>8.2}", segment.from_s, segment.to_s);
    let Some(fit) = &segment.fit else {
        return Ok(output::line(format!("{times} {}", segment.reason.as_deref().unwrap_or("no fit")))?);
    };
    let cell = |parameter: &ParameterJson| match (parameter.value, parameter.u95) {
        (Some(value), Some(u95)) => interval_text(value.into(), u95.into()),
        _ => "-".into(),
    };
    let [mt, cf, fc, plus, minus] = [
        &fit.inertance_kg,
        &fit.viscous_n_s_per_m,
        &fit.coulomb_n,
        &fit.viscous_positive_n_s_per_m,
        &fit.viscous_negative_n_s_per_m,
    ]
    .map(cell);
    Ok(output::line(format!(
        "{times} {mt:<16} {cf:<16} {fc:<16} {plus:<16} {minus:<16} {}",
        amount_text(fit.residual_rms_n, 3)
    ))?)
}

fn cell(parameter: &Found, micro: f64) -> String {
    let (Some(value), Some(u95)) = (parameter.value, parameter.u95) else { return "not identifiable".into() };
    let text = interval_text(value * micro, u95 * micro);
    match parameter.status {
        FoundStatus::Given => format!("{text} (given)"),
        FoundStatus::BelowU95 => format!("{text} (may be none)"),
        FoundStatus::Ok | FoundStatus::NotIdentifiable => text,
    }
}

/// Removes binary rounding residue.
fn rounded(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}
