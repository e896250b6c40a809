//! `inerter plan`: which motion would tell most, and what it would tell.

mod files;
mod result;
mod written;

use std::path::PathBuf;

use inerter_analysis::plan::{
    Expected, Limits, PlanError, Reach, design, interval_of, observed, predict, source_words, with_contact,
};
use inerter_core::{Machine, Settings, Source as Of};
use inerter_data::{
    export::Source,
    names::parameter,
    replay::replay_samples,
    settings::{Overrides, validate},
    wants::{self, Want},
    words::{duration_text, rounded_text},
};
use inerter_plant::{Excitation, Inerter, Sensors};
use inerter_simulate::SimulateError;
use inerter_wire::EstimatorEvent;

use super::{
    args::FileSettingsArgs,
    plant::{ExpectedArgs, preset},
    terminal::{self, Progress, note},
};
use crate::Error;
use files::FileArgs;
use result::Planned;

/// Length of a motion when nothing is said \[s\].
const DURATION_S: f64 = 20.0;
/// What to do where nothing says what to expect.
const EXPECTED: &str = "state inertance, viscous and Coulomb friction and the force's noise roughly, or give a recording of an earlier run; \
    `--preset paper` is the paper's device";

/// Design the motion that tells most of a device within a rig's limits, and predict what it will tell.
///
/// State roughly what you expect of the device (or give a recording of an earlier run, or --preset), the force's noise, and what the
/// rig can do: --stroke-m to either side, --speed-m-per-s, --force-n, --duration. The motion is made of tones and multisines
/// in a row, each as large as the limits allow on the simulated device, with a smooth lead-in and lead-out. Without --want it fills the
/// duration and is D-optimal; with --want "fc to 0.3 N, mt to 0.1 %" it is as short as what is wanted allows.
///
/// For each parameter it prints the U95 that will be stated, the same without what two runs on one rig share, the scatter from run to run, and
/// what the interval comes from most. --excite predicts a motion of yours instead. -o writes the motion as a CSV, --wav as a sound file
/// for a shaker controller; `inerter simulate --motion FILE.csv` tries it out. What is wanted and cannot be had ends with code 9, after
/// the best that can be is told and written.
///
/// The settings are those of the rig (scales, rate, what is uncertain of them): --settings, --set, as elsewhere; structure mass and stiffness are those
/// of the expected device. With --json one object: {"kind":"plan","parts":[..],"predicted":{..},"wants":[..]}. docs/CLI.md describes it.
#[derive(clap::Args)]
#[command(after_long_help = inerter_data::settings::help_table())]
pub struct Args {
    /// Recording (.mcap) or CSV file of an earlier run: what it tells is expected, and the limits it kept to hold where none are given
    file: Option<PathBuf>,
    /// What is wanted: parameters (mt, cf, fc, F0) and the half widths of their 95 % intervals, e.g. "fc to 0.3 N, mt to 0.1 %"
    #[arg(long, value_name = "WANTS", conflicts_with = "excite")]
    want: Vec<String>,
    /// Travel of the terminal to either side of its middle
    #[arg(long, value_name = "m", allow_negative_numbers = true, help_heading = "Limits")]
    stroke_m: Option<f64>,
    /// Speed of the terminal
    #[arg(long, value_name = "m/s", allow_negative_numbers = true, help_heading = "Limits")]
    speed_m_per_s: Option<f64>,
    /// Force on the load cell
    #[arg(long, value_name = "N", allow_negative_numbers = true, help_heading = "Limits")]
    force_n: Option<f64>,
    /// Length of the motion, with --want the longest [default: 20, or that of FILE]
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, help_heading = "Limits")]
    duration: Option<f64>,
    /// Lowest frequency [default: four periods within the duration]
    #[arg(long, value_name = "Hz", allow_negative_numbers = true, help_heading = "Limits")]
    lowest_hz: Option<f64>,
    /// Highest frequency [default: 16]
    #[arg(long, value_name = "Hz", allow_negative_numbers = true, help_heading = "Limits")]
    highest_hz: Option<f64>,
    /// Time in which each part comes up from rest, and goes down to it [default: 0.5, or a quarter of the lowest period]
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, help_heading = "Limits")]
    fade_s: Option<f64>,
    /// White noise of the force in one sample, rms
    #[arg(long, value_name = "N", allow_negative_numbers = true, help_heading = "Expected device")]
    force_noise_n: Option<f64>,
    /// Device to begin with: paper, worn, preloaded, presliding or stribeck
    #[arg(long, value_name = "NAME", conflicts_with = "file", help_heading = "Expected device")]
    preset: Option<String>,
    /// Predict what this motion tells instead of designing one, as in `inerter simulate --excite`
    #[arg(long, value_name = "MOTION")]
    excite: Option<String>,
    /// Seed of that motion, where it is a random one
    #[arg(long, value_name = "NUMBER", default_value_t = 1, requires = "excite")]
    seed: u64,
    #[command(flatten)]
    files: FileArgs,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    settings: FileSettingsArgs,
    #[command(flatten)]
    device: ExpectedArgs,
}

pub fn run(args: &Args) -> Result<(), Error> {
    args.files.check()?;
    terminal::tidy_at_interrupts();
    let overrides = args.settings.overrides()?;
    let (expected, known) = match &args.file {
        Some(_) => by_run(args, &overrides)?,
        None => (stated(args, &overrides)?, Limits::default()),
    };
    let limits = limits(args, known);
    let machine = expected.settings.machine;
    let [mt, cf, fc, offset] = expected.law();
    let values = [mt - expected.settings.structure_mass_kg, cf, fc, offset];
    let wanted = args.want.join(", ");
    let wants = if args.want.is_empty() { Vec::new() } else { wants::parse(&wanted, machine, values)? };
    let planned = match &args.excite {
        Some(text) => given(args, &expected, limits, text)?,
        None => {
            let mut progress = Progress::new("planning", 1000);
            let plan = design(&expected, limits, &wants, |part| progress.set((1e3 * part) as u64));
            progress.done();
            Planned::of(plan?)
        }
    };
    let written = args.files.write(&planned, &expected)?;
    planned.remarks(&expected).iter().for_each(note);
    if args.json {
        planned.json(&expected, &written)?
    } else {
        planned.text(&expected, &written)?
    }
    match planned.missed() {
        Some(missed) => Err(missed_error(&planned, &missed, machine).into()),
        None => Ok(()),
    }
}

/// The device that is stated, on the rig that the settings state.
fn stated(args: &Args, overrides: &Overrides) -> Result<Expected, Error> {
    let mut device = match &args.preset {
        Some(name) => preset(name)?,
        None => {
            let flags = [
                ("inertance_kg", "--inertance-kg"),
                ("viscous_n_s_per_m", "--viscous-n-s-per-m"),
                ("coulomb_n", "--coulomb-n"),
            ];
            if let Some((_, missing)) = flags.into_iter().find(|(name, _)| args.device.get(name).is_none()) {
                return Err(PlanError::Unstated { missing, help: EXPECTED }.into());
            }
            Inerter { structure_mass_kg: 0.0, ..Inerter::paper() }
        }
    };
    args.device.put(&mut device, &mut Sensors::default())?;
    let mut settings = Settings::default();
    overrides.apply(&mut settings)?;
    // What is set of the device's surroundings and not said by a flag is what is expected; the other way round it is known.
    let is_stated = |name: &str| args.preset.is_some() || args.device.get(name).is_some();
    if args.device.get("structure_mass_kg").is_none() && overrides.get("structure_mass_kg").is_some() {
        device.structure_mass_kg = settings.structure_mass_kg;
    }
    let set = |name: &str| overrides.get(name).filter(|value| args.device.get(name).is_none() && *value > 0.0);
    let stiffness = set("stiffness_n_per_m").or(is_stated("stiffness_n_per_m").then_some(device.stiffness_n_per_m));
    let damping =
        overrides.get("contact_damping_n_s_per_m").filter(|_| args.device.get("contact_damping_n_s_per_m").is_none());
    device = with_contact(device, stiffness, Some(damping.unwrap_or(device.contact_damping_n_s_per_m)));
    if overrides.get("structure_mass_kg").is_none() {
        settings.structure_mass_kg = device.structure_mass_kg;
    }
    if let Some(stiffness) = stiffness.filter(|_| overrides.get("stiffness_n_per_m").is_none()) {
        settings.stiffness_n_per_m = stiffness;
    }
    if stiffness.is_some() && damping.is_none() {
        settings.contact_damping_n_s_per_m = device.contact_damping_n_s_per_m;
    }
    validate(&settings)?;
    let missing = PlanError::Unstated { missing: "--force-noise-n", help: EXPECTED };
    let force_noise_n = args.force_noise_n.ok_or(missing)?;
    Ok(Expected { device, settings, force_noise_n })
}

/// What an earlier run makes one expect, and the limits that it kept to.
fn by_run(args: &Args, overrides: &Overrides) -> Result<(Expected, Limits), Error> {
    let path = args.file.as_deref().unwrap_or_else(|| std::path::Path::new(""));
    let run = Source::open(path, overrides, |_| ())?;
    run.notes.iter().for_each(note);
    let mut reach = Reach::new(&run.settings);
    let samples = run.samples()?.map(|sample| sample.map_err(Error::from));
    let samples = samples.inspect(|sample| sample.iter().for_each(|sample| reach.push(sample)));
    let outcome = replay_samples(&run.settings, run.start_s, samples, |_, _: &EstimatorEvent| Ok::<_, Error>(()))?;
    let (mut expected, limits) = observed(&outcome, &run.settings, &reach)?;
    args.device.put(&mut expected.device, &mut Sensors::default())?;
    expected.force_noise_n = args.force_noise_n.unwrap_or(expected.force_noise_n);
    Ok((expected, limits))
}

/// The limits that are given, over those that are known.
fn limits(args: &Args, known: Limits) -> Limits {
    Limits {
        stroke_m: args.stroke_m.unwrap_or(known.stroke_m),
        speed_m_per_s: args.speed_m_per_s.unwrap_or(known.speed_m_per_s),
        force_n: args.force_n.unwrap_or(known.force_n),
        duration_s: args.duration.unwrap_or(if args.file.is_some() { known.duration_s } else { DURATION_S }),
        lowest_hz: args.lowest_hz.unwrap_or(known.lowest_hz),
        highest_hz: args.highest_hz.unwrap_or(known.highest_hz),
        fade_s: args.fade_s.unwrap_or(known.fade_s),
        ..known
    }
}

/// What a motion that is given will tell.
fn given(args: &Args, expected: &Expected, limits: Limits, text: &str) -> Result<Planned, Error> {
    let motion = Excitation::parse(text, args.seed).map_err(SimulateError::from)?;
    let own_s = Some(motion.duration_s()).filter(|own_s| own_s.is_finite());
    let duration_s = args.duration.or(own_s).unwrap_or(DURATION_S);
    // The stroke need not be stated where nothing is made to fit it.
    let stroke_m = if limits.stroke_m.is_finite() { limits.stroke_m } else { 1e3 };
    let checked = Limits { stroke_m, duration_s, ..limits }.checked(expected)?;
    let prediction = predict(expected, &motion.clone().lasting(duration_s), duration_s)?;
    Ok(Planned::given(text, motion.lasting(duration_s), duration_s, prediction, checked, limits))
}

/// What of what is wanted cannot be had, and why.
fn missed_error(planned: &Planned, missed: &[Want], machine: Machine) -> PlanError {
    let of = |want: &Want| {
        let reached = planned.reached(want);
        let wanted = interval_of(machine, want.place, want.u95);
        let symbol = parameter(machine, want.place).symbol;
        match planned.enough_s(want) {
            _ if !reached.is_finite() => format!("{wanted}: no value at all"),
            Some(seconds) => format!(
                "{wanted}: ± {} is the best within {}, about {} would do",
                rounded_text(reached, reached),
                duration_text(planned.duration_s()),
                duration_text(seconds)
            ),
            None => format!("{wanted}: no time is enough, as what does not average out is ± {} of {symbol}", {
                let floor = planned.floor(want);
                rounded_text(floor, floor)
            }),
        }
    };
    let all: Vec<String> = missed.iter().map(of).collect();
    let first = missed.first().and_then(|want| planned.most(want)).unwrap_or(Of::Noise);
    PlanError::Missed {
        what: format!("not within reach: {}", all.join("; ")),
        help: format!("most of it is {}", source_words(machine, first)),
    }
}
