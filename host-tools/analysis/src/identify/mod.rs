//! Identification of the device from recordings: the law of the estimator by segment, and the complete model.
//!
//! - `linear`: the estimator's exact sums fitted again, by segment and direction.
//! - `complete`: `mt cf fc ks cs eps mr F0 tau` by simulation, if the terminal's displacement is known: measured
//!   (`condition`) or stated. Encoder and force are both predicted from it and weighted according to their noise
//!   (`spectrum`); `model` simulates, `uncertainty` computes the intervals.
//!
//! Method and limits: docs/THEORY.md, 13.

mod complete;
mod condition;
mod error;
mod linear;
mod model;
mod parameters;
mod prepared;
mod result;
mod spectrum;
mod stages;
mod uncertainty;
mod whiteness;

use inerter_core::constants::{FAST_BOX_S, STRUCTURE_MODEL_U95};
use inerter_core::{BacklashSize, Interval, Parameter, Regime, Settings};
use inerter_plant::Excitation;

use complete::{Fitted, State, Task, counting, judged, prediction};
use condition::Smooth;
pub use error::IdentifyError;
use inerter_data::{
    run::Run,
    series::{Series, Stretch},
};
use linear::Linear;
pub use parameters::Parameters;
use parameters::{Name, SHARED};
use prepared::Prepared;
pub use result::{
    Correlation, Found, FoundParameters, FoundStatus, Identified, Model, SegmentFit, SegmentParameters, Validation,
    Whiteness,
};
use stages::Stages;
use uncertainty::Errors;
use whiteness::whiteness;

use crate::{
    fit::{Beside, FitError, Products, directions},
    law::mean,
};

/// Shortest stretch that the complete model is fitted to \[s\].
const SHORTEST_S: f64 = 2.0;
/// Maximum samples that it is fitted to, which bounds time and memory.
const MOST_SAMPLES: usize = 400_000;
/// Fraction of each file that is fitted if the rest is used for validation.
const FITTED: f64 = 0.7;
/// Band around the device's natural frequency in which the terminal's motion is kept whatever its size.
const OWN_BAND: f64 = 2.0;
/// Band for the second derivative of the encoder's displacement, about that of the estimator's kernels \[Hz\].
const LAW_HZ: f64 = 30.0;
/// Ratio of residual to noise above which another start is tried.
const SUSPICIOUS: f64 = 1.1;
/// Ratio of residual to noise above which the model is doubtful.
const DOUBTFUL: f64 = 1.5;

/// What to identify.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// As in the paper: the slowest file gives the friction, the next one the rest, the last one validates.
    pub staged: bool,
    /// Length of the segments of the linear fits \[s\]; if `None`, from discontinuity to discontinuity.
    pub segment_s: Option<f64>,
    /// Fit the structure mass, regardless of the settings.
    pub free_structure_mass: bool,
    /// Fit the skew, regardless of the settings.
    pub free_skew: bool,
    /// The motion of the terminal from time 0, instead of a sensor.
    pub excite: Option<Excitation>,
    /// Skip the profiles of weakly determined parameters.
    pub no_profiles: bool,
}

/// Identifies one device from one or more runs. `progress` gets the completed fraction, 0 to 1.
pub fn identify(runs: &[Run], options: &Options, progress: &mut dyn FnMut(f64)) -> Result<Identified, IdentifyError> {
    let mut lines = Vec::new();
    for (number, run) in runs.iter().enumerate() {
        lines.push(linear::linear(run, options.segment_s, FITTED)?);
        progress(0.2 * (number + 1) as f64 / runs.len() as f64);
    }
    if runs.is_empty() {
        return Err(FitError::TooShort { observations: 0.0 }.into());
    }
    // Without motion there is nothing to simulate either.
    if let Some(error) = lines.iter().map(|line| line.whole.as_ref().err()).min_by_key(Option::is_some).flatten() {
        return Err((*error).into());
    }
    let start = start(runs, &lines);
    let mut notes = notes(runs, &lines);
    let (with, without): (Vec<&Run>, Vec<&Run>) =
        runs.iter().partition(|run| options.excite.is_some() || run.settings.terminal_sensor);
    let found = if with.is_empty() {
        if options.staged {
            return Err(IdentifyError::Terminal);
        }
        linear_only(runs, &lines)?
    } else {
        let words = "no terminal displacement, so it is in the linear fits only";
        notes.extend(without.into_iter().map(|run| format!("{}: {words}", run.name)));
        let stretches = prepared(&with, MOST_SAMPLES / runs.len(), options, &start, &mut notes)?;
        let mut share = 0.2;
        let mut tick = || {
            share += (0.95 - share) * 0.12;
            progress(share);
        };
        let task = task(runs, options);
        let start = if start.stiffness_n_per_m > 0.0 { start } else { scanned(&stretches, &start) };
        let stages = if options.staged {
            stages::fit(&first_settings(runs), &stretches, &task, &start, &mut tick)?
        } else {
            let state = State::new(&stretches, &start);
            let fitted = complete::fit(&stretches, &task, &state, false, &mut tick).ok_or(IdentifyError::Diverged)?;
            let fitted = elsewhere(&stretches, &task, fitted, &mut tick);
            let validation = validated(&stretches, &task, &fitted.state, &mut tick);
            Stages { fitted, task, stretches, validation }
        };
        let found = complete_result(runs, &stages, options, &mut notes, &mut tick)?;
        progress(1.0);
        Identified { start: Some(start), ..found }
    };
    let segments = lines.into_iter().map(|line| line.segments).collect();
    Ok(Identified { segments, notes, ..found })
}

/// What the load cell would read, one number per sample of all stretches in sequence.
///
/// It is simulated from the terminal's displacement if that is measured and the stiffness is known; otherwise computed
/// by the law from the encoder's displacement.
pub fn predicted(parameters: &Parameters, series: &Series) -> Vec<f64> {
    let mut force = Vec::with_capacity(series.len());
    for stretch in &series.stretches {
        let simulated = (!stretch.terminal_m.is_empty() && parameters.stiffness_n_per_m > 0.0).then(|| {
            let least_hz = OWN_BAND * parameters.own_hz();
            let smooth = Smooth::of(&stretch.terminal_m, series.period_s, least_hz, f64::INFINITY);
            let stretches = [Prepared::new(0, stretch, smooth, series.period_s, &Settings::default())];
            prediction(&State::new(&stretches, parameters), 0, &stretches[0]).1
        });
        force.extend(simulated.unwrap_or_else(|| by_law(parameters, stretch, series.period_s)));
    }
    force
}

fn by_law(parameters: &Parameters, stretch: &Stretch, period_s: f64) -> Vec<f64> {
    let p = parameters;
    let force = |[_, v, a]: &model::Node| {
        let dry = if *v == 0.0 { 0.0 } else { p.coulomb_n * v.signum() };
        (p.inertance_kg + p.structure_mass_kg) * a + p.viscous_n_s_per_m * v + dry + p.offset_n
    };
    Smooth::of(&stretch.position_m, period_s, 0.0, LAW_HZ).nodes.iter().map(force).collect()
}

/// Notes on the runs for a person.
fn notes(runs: &[Run], lines: &[Linear]) -> Vec<String> {
    let mut notes = Vec::new();
    for (run, line) in runs.iter().zip(lines) {
        let of_friction = match line.outcome.detail.friction.regime {
            Regime::Presliding => Some("friction reverses gradually over a distance; in the model it jumps"),
            Regime::Stribeck => Some("friction is greater near rest; in the model it does not depend on the speed"),
            Regime::Unknown | Regime::Coulomb => None,
        };
        let of_change = (line.outcome.detail.changes > 0)
            .then_some("the device changed during the run; `inerter replay` says when: identify the parts separately");
        notes.extend([of_friction, of_change].into_iter().flatten().map(|note| format!("{}: {note}", run.name)));
    }
    notes
}

/// The common settings: those of the first run.
fn first_settings(runs: &[Run]) -> Settings {
    runs.first().map(|run| run.settings).unwrap_or_default()
}

/// Stretches that the complete model is fitted to, with room for so many samples of each run.
fn prepared(
    runs: &[&Run],
    room: usize,
    options: &Options,
    start: &Parameters,
    notes: &mut Vec<String>,
) -> Result<Vec<Prepared>, IdentifyError> {
    let mut stretches = Vec::new();
    let mut left_out = 0;
    for (number, run) in runs.iter().enumerate() {
        let series = Series::of(run);
        let (mut samples, needed) = (0, (SHORTEST_S / series.period_s) as usize);
        let length = |stretch: &Stretch| stretch.force_n.len();
        let longest = series.stretches.iter().map(length).max().unwrap_or(0);
        if longest < needed {
            return Err(IdentifyError::TooShort {
                file: run.name.clone(),
                needed_s: SHORTEST_S,
                longest_s: longest as f64 * series.period_s,
            });
        }
        for stretch in series.stretches.iter().filter(|stretch| length(stretch) >= needed) {
            let taken = length(stretch).min(room.saturating_sub(samples));
            left_out += length(stretch) - taken;
            if taken < needed {
                continue;
            }
            samples += taken;
            let cut = |column: &[f64]| column.iter().copied().take(taken).collect::<Vec<f64>>();
            let stretch = Stretch {
                start_s: stretch.start_s,
                position_m: cut(&stretch.position_m),
                force_n: cut(&stretch.force_n),
                terminal_m: cut(&stretch.terminal_m),
            };
            let smooth = match &options.excite {
                Some(excitation) => Smooth::stated(excitation, stretch.start_s, series.period_s, taken),
                None => Smooth::of(&stretch.terminal_m, series.period_s, OWN_BAND * start.own_hz(), f64::INFINITY),
            };
            stretches.push(Prepared::new(number, &stretch, smooth, series.period_s, &run.settings));
        }
    }
    if left_out > 0 {
        notes
            .push(format!("the complete model is fitted to the first {MOST_SAMPLES} samples; {left_out} are left out"));
    }
    Ok(stretches)
}

/// Prior knowledge of the structure mass from the settings: value and standard deviation \[kg\]; `None` if there is
/// none.
pub fn known_structure_mass_kg(settings: &Settings) -> Option<(f64, f64)> {
    let mass = settings.structure_mass_kg;
    let deviation = settings.structure_mass_u95_kg.hypot(STRUCTURE_MODEL_U95 * mass) / 2.0;
    (deviation > 0.0).then_some((mass, deviation))
}

/// Prior knowledge of the skew from the settings: value and standard deviation \[s\].
pub fn known_skew_s(settings: &Settings) -> (f64, f64) {
    (settings.skew_s, settings.skew_u95_s.max(1e-7) / 2.0)
}

/// The fitted parameters and the prior knowledge.
fn task(runs: &[Run], options: &Options) -> Task {
    let settings = first_settings(runs);
    let mass = known_structure_mass_kg(&settings).filter(|_| !options.free_structure_mass);
    let skew = (!options.free_skew).then(|| known_skew_s(&settings));
    Task { free: [true; SHARED.len()], ..Task::default() }
        .with(Name::Structure, options.free_structure_mass || mass.is_some(), mass)
        .with(Name::Skew, true, skew)
}

/// The starting point: the estimator's results, each parameter from the file that determines it best.
fn start(runs: &[Run], lines: &[Linear]) -> Parameters {
    let best = |of: &dyn Fn(&Linear) -> Option<Interval>| -> Option<f64> {
        let known = lines.iter().filter_map(of).filter(|known| known.value.is_finite());
        known.min_by(|a, b| (a.u95 / a.value.abs()).total_cmp(&(b.u95 / b.value.abs()))).map(|p| f64::from(p.value))
    };
    let settings = first_settings(runs);
    let set = |value: f64| Some(value).filter(|value| *value > 0.0);
    let backlash =
        lines.iter().filter_map(|line| line.outcome.detail.backlash.known()).min_by(|a, b| a.u95.total_cmp(&b.u95));
    let inertance = best(&|line| line.outcome.estimate.whole_run.inertance_kg.known())
        .filter(|mass| *mass > 0.0)
        .or_else(|| runs.iter().find_map(rough_inertance_kg))
        .unwrap_or(1.0);
    let stiffness =
        best(&|line| line.outcome.detail.stiffness_n_per_m.usable()).or_else(|| set(settings.stiffness_n_per_m));
    let stiffness = stiffness.filter(|stiffness| *stiffness > 0.0).unwrap_or(0.0);
    let damping = best(&|line| line.outcome.detail.contact_damping_n_s_per_m.usable()).filter(|damping| *damping > 0.0);
    Parameters {
        inertance_kg: inertance,
        viscous_n_s_per_m: best(&|line| line.outcome.estimate.whole_run.viscous_n_s_per_m.known()).unwrap_or(0.0),
        coulomb_n: best(&|line| line.outcome.estimate.whole_run.coulomb_n.known()).unwrap_or(0.0).max(0.0),
        stiffness_n_per_m: stiffness,
        contact_damping_n_s_per_m: damping
            .or_else(|| set(settings.contact_damping_n_s_per_m))
            .unwrap_or_else(|| light_damping(stiffness, inertance)),
        backlash_m: backlash.map_or(0.0, |known| f64::from(known.value)).max(0.0),
        structure_mass_kg: settings.structure_mass_kg,
        offset_n: best(&|line| line.outcome.estimate.whole_run.offset_n.known()).unwrap_or(0.0),
        skew_s: settings.skew_s,
    }
}

/// A twentieth of critical damping.
fn light_damping(stiffness: f64, inertance: f64) -> f64 {
    0.1 * (stiffness * inertance).sqrt()
}

/// RMS force over RMS acceleration.
fn rough_inertance_kg(run: &Run) -> Option<f64> {
    let series = Series::of(run);
    let stretch = series.stretches.iter().max_by_key(|stretch| stretch.force_n.len())?;
    let rms = |values: &mut dyn Iterator<Item = f64>| values.map(|x| x * x).sum::<f64>().sqrt();
    let nodes = Smooth::of(&stretch.position_m, series.period_s, 0.0, LAW_HZ).nodes;
    let ratio = rms(&mut stretch.force_n.iter().copied()) / rms(&mut nodes.iter().map(|[_, _, a]| *a));
    ratio.is_finite().then_some(ratio).filter(|ratio| *ratio > 0.0)
}

/// A starting stiffness if none is known: the best of four per decade.
fn scanned(stretches: &[Prepared], start: &Parameters) -> Parameters {
    let left = |device: &Parameters| -> f64 {
        let state = State::new(stretches, device);
        let one = |(number, prepared): (usize, &Prepared)| {
            let (_, force) = prediction(&state, number, prepared);
            prepared.force.iter().zip(&force).map(|(a, b)| (a - b).powi(2)).sum::<f64>()
        };
        stretches.iter().enumerate().map(one).sum()
    };
    let devices = (16..=40).map(|quarter| {
        let stiffness = 10f64.powf(f64::from(quarter) / 4.0);
        let damping = light_damping(stiffness, start.inertance_kg);
        Parameters { stiffness_n_per_m: stiffness, contact_damping_n_s_per_m: damping, ..*start }
    });
    devices.min_by(|a, b| left(a).total_cmp(&left(b))).unwrap_or(*start)
}

/// The best of several fits that start with other values of the contact damping, if the residual is too large: impacts
/// create false minima along it.
fn elsewhere(stretches: &[Prepared], task: &Task, fitted: Fitted, tick: &mut dyn FnMut()) -> Fitted {
    if fitted.over_noise() < SUSPICIOUS || fitted.state.parameters.backlash_m <= 0.0 {
        return fitted;
    }
    let mut best = fitted;
    let found = best.state.clone();
    for factor in [0.8, 1.25] {
        let mut state = found.clone();
        state.parameters.contact_damping_n_s_per_m *= factor;
        if let Some(other) = complete::fit(stretches, task, &state, false, tick)
            && other.cost < best.cost
        {
            best = other;
        }
    }
    best
}

/// Fits the first part, and judges the rest.
fn validated(stretches: &[Prepared], task: &Task, best: &State, tick: &mut dyn FnMut()) -> Option<Validation> {
    let parts: Vec<Prepared> = stretches.iter().map(|s| s.until((FITTED * s.force.len() as f64) as usize)).collect();
    let fitted = complete::fit(&parts, task, best, true, tick)?;
    judged(stretches, &fitted.state, FITTED)
}

/// The result if only encoder and force are known.
fn linear_only(runs: &[Run], lines: &[Linear]) -> Result<Identified, IdentifyError> {
    let settings = first_settings(runs);
    let wholes = lines.iter().map(|line| line.whole).collect::<Result<Vec<Products>, _>>()?;
    let whole = wholes.into_iter().reduce(|before, products| products.and(&before));
    let Some((whole, first)) = whole.zip(lines.first()) else {
        return Err(FitError::TooShort { observations: 0.0 }.into());
    };
    let law = directions(&whole, &settings, &Beside::of(&first.outcome), None)?.symmetric;
    let found = |parameter: Parameter, symbol: &str| match parameter.known() {
        None => Found::unknown(format!("this motion hardly depends on {symbol}")),
        Some(Interval { value, u95 }) => Found::known(value.into(), u95.into()),
    };
    let no_terminal = || Found::unknown("needs the terminal's displacement, or a stated motion (--excite)");
    let sizes = lines.iter().map(|line| line.outcome.detail.backlash);
    let known = sizes.filter_map(|backlash| Some((backlash.size, backlash.known()?.u95)));
    let narrowest = known.min_by(|(_, a), (_, b)| a.total_cmp(b));
    let backlash = match narrowest.map(|(size, _)| size) {
        Some(BacklashSize::Ok(Interval { value, u95 })) => Found::known(value.into(), u95.into()),
        Some(BacklashSize::BelowU95(Interval { value, u95 })) => {
            Found { status: FoundStatus::BelowU95, ..Found::known(value.into(), u95.into()) }
        }
        _ if settings.stiffness_n_per_m == 0.0 => {
            Found::unknown("needs the terminal's displacement, or the stiffness (--set stiffness_n_per_m=..)")
        }
        _ => Found::unknown("too few reversals of the flanks to identify it"),
    };
    let given = |value: f64, u95: f64| Found { status: FoundStatus::Given, ..Found::known(value, u95) };
    let correlation = whole.correlation().ok().map(|matrix| Correlation {
        names: vec!["inertance_kg", "viscous_n_s_per_m", "coulomb_n", "offset_n"],
        matrix: matrix.into_iter().map(Vec::from).collect(),
    });
    let splits: Vec<_> = lines.iter().filter_map(|line| line.split.as_ref()).collect();
    let validation = match splits.as_slice() {
        [(later, earlier)] => later.judging(earlier).ok(),
        _ => None,
    };
    let parameters = FoundParameters {
        inertance_kg: found(law.inertance_kg, "inertance").bounded(),
        viscous_n_s_per_m: found(law.viscous_n_s_per_m, "viscous friction").bounded(),
        coulomb_n: found(law.coulomb_n, "Coulomb friction").bounded(),
        stiffness_n_per_m: no_terminal(),
        contact_damping_n_s_per_m: no_terminal(),
        backlash_m: backlash,
        structure_mass_kg: given(settings.structure_mass_kg, settings.structure_mass_u95_kg),
        offset_n: found(law.offset_n, "the offset"),
        skew_s: given(settings.skew_s, settings.skew_u95_s),
    };
    let identified = Identified {
        model: Model::Linear,
        parameters,
        offsets_n: vec![law.offset_n.value().map(f64::from)],
        correlation,
        residual_rms_n: whole.judging(&whole)?.0,
        validation: validation.map(|(residual_rms_n, explained)| Validation {
            fitted: FITTED,
            residual_rms_n,
            explained,
        }),
        ..Identified::default()
    };
    let residual = law_residual(&identified.model(), &runs[0]);
    Ok(Identified { whiteness: whiteness(&residual), ..identified })
}

/// The residual of the law as means over 16 ms, which are independent if it is noise.
fn law_residual(parameters: &Parameters, run: &Run) -> Vec<f64> {
    let series = Series::of(run);
    let force = predicted(parameters, &series);
    let measured = series.stretches.iter().flat_map(|stretch| &stretch.force_n);
    let left: Vec<f64> = measured.zip(&force).map(|(measured, predicted)| measured - predicted).collect();
    let length = ((FAST_BOX_S / series.period_s) as usize).max(1);
    left.chunks(length).map(mean).collect()
}

/// The result of the complete model.
fn complete_result(
    runs: &[Run],
    stages: &Stages,
    options: &Options,
    notes: &mut Vec<String>,
    tick: &mut dyn FnMut(),
) -> Result<Identified, IdentifyError> {
    let Stages { fitted, task, stretches, validation } = stages;
    let settings = first_settings(runs);
    let errors = Errors::of(fitted, stretches, &settings).ok_or(IdentifyError::Diverged)?;
    let mut found = SHARED.map(|name| errors.judged(name, task));
    if !options.no_profiles {
        for name in errors.weak() {
            found[name as usize].profile = errors.profile(name, task);
            tick();
        }
    }
    let offset_n = fitted.state.parameters.offset_n;
    let offset_u95 = errors.offset_u95(0, settings.force_gain_u95, offset_n).unwrap_or(f64::NAN);
    let ratio = fitted.over_noise();
    if ratio > DOUBTFUL {
        notes.push(format!(
            "the model's residual is {ratio:.1} times what the sensors' noise explains: the device or the rig has something that \
             the model lacks"
        ));
    }
    if !fitted.converged {
        notes.push("the fit did not converge: the values are the best that were found".into());
    }
    if task.known_of(Name::Structure).is_none() && !options.free_structure_mass {
        notes.push(
            "the structure mass is taken as 0: state it (--set structure_mass_kg=..) or fit it (--free mr)".into(),
        );
    }
    let rms = |of_force: bool| {
        let left = |(number, prepared): (usize, &Prepared)| -> Vec<f64> {
            let (position, force) = prediction(&fitted.state, number, prepared);
            let range = counting(prepared);
            let (measured, predicted) =
                if of_force { (&prepared.force, force) } else { (&prepared.position, position) };
            measured.iter().zip(&predicted).take(range.end).skip(range.start).map(|(a, b)| a - b).collect()
        };
        let all: Vec<f64> = stretches.iter().enumerate().flat_map(left).collect();
        (all.iter().map(|x| x * x).sum::<f64>() / all.len().max(1) as f64).sqrt()
    };
    let mut parameters = FoundParameters { offset_n: Found::known(offset_n, offset_u95), ..Default::default() };
    for (name, found) in SHARED.into_iter().zip(found) {
        *name.slot(&mut parameters) = found;
    }
    Ok(Identified {
        model: Model::Complete,
        parameters,
        offsets_n: fitted.state.offsets.iter().copied().map(Some).collect(),
        correlation: Some(errors.correlation()),
        residual_rms_n: rms(true),
        residual_rms_m: Some(rms(false)),
        residual_over_noise: Some(ratio),
        whiteness: whiteness(&fitted.white),
        validation: *validation,
        ..Identified::default()
    })
}
