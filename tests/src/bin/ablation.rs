//! Runs this build of the estimator on a set of cases and prints the results, for `cargo xtask ablation`.
//!
//! It uses only core and plant, so it builds quickly with a core from which one part was removed. It prints one line
//! per cell and parameter: group, cell, parameter, rms error, mean half width, runs with a value, runs whose value is
//! silently off by more than twice its interval, runs whose interval does not contain the true value, runs whose law is
//! reported as broken, runs in which the fault is named, runs.

use inerter_core::{Interval, LawStatus, RawSample, Regime, Settings, State};
use inerter_plant::{Excitation, Inerter, Plant, PlantError, Sensors, Simulation};
use std::process::ExitCode;

/// First seed. No table uses these seeds.
const FIRST: u64 = 9001;
const SEEDS: u64 = 3;

/// How the samples are changed after the converter.
#[derive(Clone, Copy)]
enum Done {
    Nothing,
    /// The count jumps by a hundred every 3.1 s.
    Slips,
    /// The force is constant in the second half of the run.
    Dead,
    /// The force is clipped at this fraction of its peak after the first 2 s.
    Clipped(f64),
    Inverted,
    /// This much is lost every 2.3 s \[s\].
    Gaps(f64),
    /// The run ends after this time \[s\].
    Ends(f64),
    /// The settings state no contact.
    Unstated,
}

/// Runs that share a device, a rig and a fault.
struct Case {
    group: &'static str,
    name: &'static str,
    motions: &'static [&'static str],
    device: Inerter,
    sensors: Sensors,
    done: Done,
    /// The device in the second half of the run, if it changes.
    later: Option<Inerter>,
}

/// The grid's rig.
fn rig() -> Sensors {
    Sensors { force_noise_n: 1.0, force_offset_n: 3.0, ..Sensors::default() }
}

fn cases() -> Vec<Case> {
    const ALL: &[&str] = &["slow", "mid", "fast", "multi", "random", "two"];
    const TWO: &[&str] = &["mid", "random"];
    const MORE: &[&str] = &["mid", "fast", "multi", "random"];
    // Friction holds the screw for all or nearly all of the motion.
    const CREEPS: &[&str] = &["sine:2Hz:0.05mm", "sine:4Hz:0.05mm", "sine:2Hz:0.2mm"];
    let paper = Inerter::paper();
    let case = |group, name, motions| Case {
        group,
        name,
        motions,
        device: paper,
        sensors: rig(),
        done: Done::Nothing,
        later: None,
    };
    let device = |group, name, motions, device| Case { device, ..case(group, name, motions) };
    let rigged = |name, motions, sensors| Case { sensors, ..case("rig", name, motions) };
    let done = |name, motions, done| Case { done, ..case("samples", name, motions) };
    let light = Inerter { inertance_kg: 95.0, viscous_n_s_per_m: 80.0, coulomb_n: 12.0, ..paper };
    let rests = &["mid@5s;hold@5s;mid@5s;hold@5s;mid@5s;hold@5s", "two@5s;hold@5s;two@5s;hold@5s;two@5s"];
    vec![
        case("clean", "reference", ALL),
        device("clean", "95 kg", TWO, light),
        device("clean", "150 N of friction", &["mid", "random", "two"], Inerter::preloaded()),
        case("clean", "with rests", rests),
        device("clean", "no Coulomb friction", TWO, Inerter { coulomb_n: 0.0, ..paper }),
        done("1 s", MORE, Done::Ends(1.0)),
        rigged("20 um", &["slow", "mid", "random", "two"], Sensors { metres_per_count: 20e-6, ..rig() }),
        rigged("40 um", ALL, Sensors { metres_per_count: 40e-6, ..rig() }),
        rigged("sums of 16 readings", MORE, Sensors { oversampling: 16.0, newtons_per_code: 0.032, ..rig() }),
        rigged("no noise", TWO, Sensors { force_noise_n: 0.0, ..rig() }),
        rigged("1 nm and no noise", TWO, Sensors { force_noise_n: 0.0, metres_per_count: 1e-9, ..rig() }),
        rigged("20 N of noise", TWO, Sensors { force_noise_n: 20.0, ..rig() }),
        rigged("force 3.3 ms late, stated", MORE, Sensors { delay_s: 3.3e-3, ..rig() }),
        rigged("eccentric by 10 um", MORE, Sensors { encoder_eccentricity_m: 10e-6, ..rig() }),
        rigged("knock of 200 N", TWO, Sensors { knock_n: 200.0, ..rig() }),
        rigged("1 % lost", TWO, Sensors { lost_probability: 0.01, ..rig() }),
        device("friction", "presliding 20 um", MORE, Inerter { presliding_m: 20e-6, ..paper }),
        device("friction", "presliding 100 um", MORE, Inerter { presliding_m: 100e-6, ..paper }),
        device("friction", "Stribeck 5 mm/s", MORE, Inerter { stribeck_velocity_m_per_s: 5e-3, ..Inerter::stribeck() }),
        device(
            "friction",
            "falls with the velocity",
            MORE,
            Inerter { stribeck_velocity_m_per_s: 50e-3, viscous_n_s_per_m: 5.0, ..Inerter::stribeck() },
        ),
        device("friction", "creeps", CREEPS, Inerter { presliding_m: 100e-6, ..Inerter::preloaded() }),
        device("friction", "uneven by 40 %", TWO, Inerter { coulomb_asymmetry: 0.4, viscous_asymmetry: 0.4, ..paper }),
        done("slipped counts", TWO, Done::Slips),
        done("dead force", TWO, Done::Dead),
        done("clipped at 80 %", &["mid", "fast"], Done::Clipped(0.8)),
        done("inverted", TWO, Done::Inverted),
        done("gaps of 200 ms", TWO, Done::Gaps(0.2)),
        device("contact", "backlash 0.1 mm", MORE, Inerter::worn()),
        Case {
            sensors: Sensors { metres_per_count: 20e-6, ..rig() },
            ..device("contact", "20 um, backlash 0.1 mm", MORE, Inerter::worn())
        },
        Case {
            done: Done::Unstated,
            ..device("contact", "contact not stated, backlash 0.1 mm", MORE, Inerter::worn())
        },
        device("contact", "backlash 0.3 mm", MORE, Inerter { backlash_m: 3e-4, ..paper }),
        device("contact", "structure of 10 kg", MORE, Inerter { structure_mass_kg: 10.0, ..paper }),
        device(
            "contact",
            "structure of 10 kg, backlash 0.1 mm",
            MORE,
            Inerter { structure_mass_kg: 10.0, ..Inerter::worn() },
        ),
        Case {
            later: Some(Inerter { inertance_kg: 200.0, ..paper }),
            ..case("change", "inertance falls by a third", &["mid", "random"])
        },
        Case {
            later: Some(Inerter { coulomb_n: 80.0, ..paper }),
            ..case("change", "friction grows by 60 %", &["mid", "random"])
        },
    ]
}

/// One parameter at the end of a run: error, half width, and whether the run says nothing that makes it doubtful.
#[derive(Clone, Copy)]
struct Found {
    error: f64,
    u95: f64,
    unreported: bool,
}

impl Found {
    fn is_off_by(&self, intervals: f64) -> bool {
        self.error.abs() > intervals * self.u95
    }
}

/// Results of one run: mt, cf, fc, backlash, if given.
struct Said {
    found: [Option<Found>; 4],
    broken: bool,
    /// A warning names a fault of the samples, or the friction is reported as another regime than Coulomb.
    named: bool,
}

fn main() -> ExitCode {
    match cases().iter().try_for_each(show) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn show(case: &Case) -> Result<(), PlantError> {
    for motion in case.motions {
        let runs: Vec<Said> = (FIRST..FIRST + SEEDS).map(|seed| run(case, motion, seed)).collect::<Result<_, _>>()?;
        let [broken, named] =
            [|said: &&Said| said.broken, |said: &&Said| said.named].map(|is| runs.iter().filter(is).count());
        for (i, parameter) in ["mt", "cf", "fc", "backlash"].into_iter().enumerate() {
            let given: Vec<Found> = runs.iter().filter_map(|said| said.found[i]).collect();
            let count = given.len() as f64;
            let rms = (given.iter().map(|found| found.error.powi(2)).sum::<f64>() / count).sqrt();
            let u95 = given.iter().map(|found| found.u95).sum::<f64>() / count;
            let outside = given.iter().filter(|found| found.is_off_by(1.0)).count();
            let silent = given.iter().filter(|found| found.unreported && found.is_off_by(2.0)).count();
            let motion = motion.split('@').next().unwrap_or(motion);
            println!(
                "{}\t{}, {motion}\t{parameter}\t{rms}\t{u95}\t{}\t{silent}\t{outside}\t{broken}\t{named}\t{}",
                case.group,
                case.name,
                given.len(),
                runs.len()
            );
        }
    }
    Ok(())
}

/// Settings that state this device and rig exactly, without uncertainty.
fn settings(device: &Inerter, sensors: &Sensors) -> Settings {
    Settings {
        sample_rate_hz: sensors.sample_rate_hz,
        metres_per_count: sensors.metres_per_count,
        oversampling: sensors.oversampling,
        newtons_per_code: sensors.newtons_per_sample_code(),
        structure_mass_kg: device.structure_mass_kg,
        structure_mass_u95_kg: 0.0,
        stiffness_n_per_m: device.stiffness_n_per_m,
        stiffness_u95_n_per_m: 1e-6 * device.stiffness_n_per_m,
        contact_damping_n_s_per_m: device.contact_damping_n_s_per_m,
        skew_s: sensors.delay_s,
        skew_u95_s: 0.0,
        force_gain_u95: 0.0,
        lead_u95: 0.0,
        timebase_u95: 0.0,
        ..Settings::default()
    }
}

fn samples(case: &Case, motion: &str, seed: u64) -> Result<Vec<RawSample>, PlantError> {
    let sensors = Sensors { encoder_phase_count: (seed as f64 * 0.618) % 1.0, seed, ..case.sensors };
    let mut simulation = Simulation::new(case.device, Excitation::parse(motion, seed)?, sensors)?;
    let duration_s = if motion == "slow" {
        60.0
    } else if motion.contains("hold") {
        25.0
    } else {
        15.0
    };
    let count = (duration_s * sensors.sample_rate_hz) as usize;
    let raw = |sample: inerter_plant::Sample| RawSample {
        index: sample.index,
        position_count: sample.position_count,
        force_code: sample.force_code,
        terminal_code: 0,
    };
    let mut samples: Vec<RawSample> = simulation.by_ref().take(count).map(raw).collect();
    if let Some(later) = case.later {
        let stood = samples.last().map_or(0, |sample| sample.position_count);
        simulation.replace(Plant::new(later, Excitation::parse(motion, seed)?)?);
        samples.extend(simulation.take(count).map(|sample| {
            let sample = raw(sample);
            RawSample { position_count: sample.position_count + stood, ..sample }
        }));
    }
    let rate = sensors.sample_rate_hz;
    // Skip the transient after the start from rest.
    let steady = samples.iter().skip((2.0 * rate) as usize);
    let greatest = steady.map(|sample| sample.force_code.unsigned_abs()).max().unwrap_or(0);
    match case.done {
        Done::Nothing | Done::Unstated => {}
        Done::Slips => samples.iter_mut().enumerate().for_each(|(n, sample)| {
            sample.position_count += 100 * (n as f64 / rate / 3.1) as i32;
        }),
        Done::Dead => {
            let half = samples.len() / 2;
            let held = samples.get(half).map_or(0, |sample| sample.force_code);
            samples.iter_mut().skip(half).for_each(|sample| sample.force_code = held);
        }
        Done::Clipped(part) => {
            let most = (part * f64::from(greatest)) as i32;
            samples.iter_mut().for_each(|sample| sample.force_code = sample.force_code.clamp(-most, most));
        }
        Done::Inverted => samples.iter_mut().for_each(|sample| sample.force_code = -sample.force_code),
        Done::Ends(after_s) => samples.truncate((after_s * rate) as usize),
        Done::Gaps(length_s) => samples.retain(|sample| f64::from(sample.index) / rate % 2.3 > length_s),
    }
    Ok(samples)
}

fn run(case: &Case, motion: &str, seed: u64) -> Result<Said, PlantError> {
    let samples = samples(case, motion, seed)?;
    let mut settings = settings(&case.device, &case.sensors);
    if matches!(case.done, Done::Unstated) {
        (settings.stiffness_n_per_m, settings.contact_damping_n_s_per_m) = (0.0, 0.0);
    }
    let active = settings.validate().expect("a rig within the settings' ranges");
    let mut state = Box::new(State::new(&active));
    let mut warned = false;
    for sample in &samples {
        warned |= active.step(&mut state, sample).warning.is_some();
    }
    let published = active.publish(&state);
    let whole = published.estimate.whole_run;
    let device = case.later.unwrap_or(case.device);
    let broken = published.law.status == LawStatus::Broken;
    let friction = matches!(published.detail.friction.regime, Regime::Presliding | Regime::Stribeck);
    let found = |found: Option<Interval>, truth: f64, told: bool| {
        let Interval { value, u95 } = found?;
        Some(Found { error: f64::from(value) - truth, u95: u95.into(), unreported: !told })
    };
    let doubted = broken || warned;
    let found = [
        found(whole.inertance_kg.known(), device.inertance_kg, doubted),
        found(whole.viscous_n_s_per_m.known(), device.viscous_n_s_per_m, doubted || friction),
        found(whole.coulomb_n.known(), device.coulomb_n, doubted || friction),
        found(published.detail.backlash.known(), device.backlash_m, false),
    ];
    Ok(Said { found, broken, named: warned || friction })
}
