//! The robustness sheet: one imperfection of rig or device at a time, the estimates, and the faults that the device
//! reports.

use crate::grid::{
    Column, Estimator, Result, calibrated, each, error, errors, mean, raw, seeded, sensors as rig, shaken, three, truth,
};
use inerter_core::{Published, Regime, Settings};
use inerter_plant::{Inerter, Sensors};
use std::{array::from_fn, ops::RangeInclusive};

/// Rate of the published estimates \[Hz\].
const PUBLISHED_HZ: f64 = 10.0;
/// Fraction of the peak force at which the converter saturates.
const CLIPPED: f64 = 0.8;
/// Ratio of the residual to that of the undisturbed row from which a person would take a closer look.
pub const LOUD: f64 = 2.0;

/// One imperfection.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// Name of the imperfection.
    pub name: &'static str,
    /// Motions to run it with.
    pub motions: &'static [&'static str],
    /// The device.
    pub device: Inerter,
    /// The instruments.
    pub sensors: Sensors,
    /// Whether the converter saturates below the force's peak.
    pub clipped: bool,
    /// Relative uncertainty of the force's gain that the settings state.
    pub force_gain_u95: f64,
}

const FASTER: &[&str] = &["random", "mid"];
const WITH_SLOW: &[&str] = &["random", "mid", "slow"];
const WITH_FAST: &[&str] = &["random", "mid", "slow", "fast"];

fn case(name: &'static str, motions: &'static [&'static str]) -> Case {
    Case { name, motions, device: Inerter::paper(), sensors: rig(), clipped: false, force_gain_u95: 0.0 }
}

/// The rows of the sheet. The first one is undisturbed.
pub fn cases() -> Vec<Case> {
    let sensors = |name, motions, sensors| Case { sensors, ..case(name, motions) };
    let device = |name, motions, device| Case { device, ..case(name, motions) };
    let paper = Inerter::paper();
    let presliding = |um: f64| Inerter { presliding_m: um * 1e-6, ..paper };
    let stribeck = |mm_per_s: f64| Inerter { stribeck_velocity_m_per_s: mm_per_s * 1e-3, ..Inerter::stribeck() };
    let gain = Sensors { force_gain: 1.01, ..rig() };
    let uneven = Inerter { coulomb_asymmetry: 0.4, viscous_asymmetry: 0.4, ..paper };
    vec![
        case("nothing", WITH_FAST),
        sensors("force noise 0.1 N", FASTER, Sensors { force_noise_n: 0.1, ..rig() }),
        sensors("force noise 5 N", WITH_SLOW, Sensors { force_noise_n: 5.0, ..rig() }),
        sensors("force noise 20 N", FASTER, Sensors { force_noise_n: 20.0, ..rig() }),
        sensors("encoder 0.05 um", FASTER, Sensors { metres_per_count: 0.05e-6, ..rig() }),
        sensors("encoder 0.5 um", FASTER, Sensors { metres_per_count: 0.5e-6, ..rig() }),
        sensors("encoder 20 um", WITH_SLOW, Sensors { metres_per_count: 20e-6, ..rig() }),
        sensors("eccentricity 10 um", FASTER, Sensors { encoder_eccentricity_m: 10e-6, ..rig() }),
        sensors("drift 0.05 N/s", WITH_SLOW, Sensors { force_drift_n_per_s: 0.05, ..rig() }),
        sensors("gain 1 %, not stated", FASTER, gain),
        Case { force_gain_u95: 0.012, ..sensors("gain 1 %, stated as 1.2 %", FASTER, gain) },
        sensors("1 % of samples lost", FASTER, Sensors { lost_probability: 0.01, ..rig() }),
        Case { clipped: true, ..case("force clipped at 80 %", FASTER) },
        sensors("pickup 5 N, 50 Hz", WITH_SLOW, Sensors { pickup_n: 5.0, ..rig() }),
        sensors("knock 200 N, 4 ms", WITH_SLOW, Sensors { knock_n: 200.0, ..rig() }),
        device("friction uneven by 40 %", WITH_SLOW, uneven),
        device("weight of 200 N", FASTER, Inerter { constant_force_n: -200.0, ..paper }),
        device("backlash 0.1 mm", FASTER, Inerter::worn()),
        device("the same, flanks only push", FASTER, Inerter { unilateral: 1.0, ..Inerter::worn() }),
        device("presliding 20 um", WITH_FAST, presliding(20.0)),
        device("presliding 50 um", WITH_FAST, presliding(50.0)),
        device("presliding 200 um", WITH_FAST, presliding(200.0)),
        device("Stribeck 1.3, 2 mm/s", WITH_FAST, stribeck(2.0)),
        device("Stribeck 1.3, 5 mm/s", WITH_FAST, stribeck(5.0)),
        device("Stribeck 1.3, 10 mm/s", WITH_FAST, stribeck(10.0)),
    ]
}

/// Length of a run \[s\].
fn duration_s(motion: &str) -> f64 {
    if motion == "slow" { 80.0 } else { 20.0 }
}

/// What the device itself can report.
const FLAGS: [&str; 5] = ["discontinuities", "saturated", "presliding", "Stribeck", "friction unknown"];

/// One run.
struct Run {
    /// Errors and half widths of inertance, viscous and Coulomb friction at the end, if given.
    last: [Option<(f64, f64)>; 3],
    /// The same of all published values with status ok.
    published: [Vec<(f64, f64)>; 3],
    /// Which of the flags the device raises.
    flags: [bool; FLAGS.len()],
    /// Residual at the end \[N\].
    residual_n: f64,
}

impl Case {
    /// The instruments of one run.
    fn sensors(&self, motion: &str, seed: u64) -> Result<Sensors> {
        let sensors = seeded(self.sensors, seed);
        if !self.clipped {
            return Ok(sensors);
        }
        let whole = shaken(&self.device, motion, sensors)?.lasting(duration_s(motion));
        let peak = whole.map(|sample| sample.force_code.unsigned_abs()).max().unwrap_or(0);
        let limit = (CLIPPED * f64::from(peak)).round();
        Ok(Sensors { force_min_code: -limit, force_max_code: limit, ..sensors })
    }

    /// Simulates the device and records its estimates, with settings that ignore the imperfection.
    fn run(&self, motion: &str, seed: u64) -> Result<Run> {
        let sensors = self.sensors(motion, seed)?;
        let mut estimator = Estimator::new(&Settings {
            force_gain_u95: self.force_gain_u95,
            lead_u95: 0.0,
            timebase_u95: 0.0,
            publish_rate_hz: PUBLISHED_HZ,
            ..calibrated(&self.device, &sensors)
        })?;
        let truth = truth(&self.device);
        let mut published: [Vec<_>; 3] = Default::default();
        for sample in shaken(&self.device, motion, sensors)?.lasting(duration_s(motion)) {
            let Some(estimate) = estimator.step(&raw(&sample)).estimate() else { continue };
            for parameters in [&estimate.recent, &estimate.whole_run] {
                for (i, found) in three(parameters).into_iter().enumerate() {
                    published[i].extend(found.ok().map(|found| error(found, truth[i])));
                }
            }
        }
        let Published { estimate: last, detail, .. } = estimator.publish();
        let (counters, regime) = (estimator.state.counters(), detail.friction.regime);
        Ok(Run {
            last: errors(&last.whole_run, &self.device),
            published,
            flags: [
                counters.discontinuities > 0,
                counters.saturated > 0,
                regime == Regime::Presliding,
                regime == Regime::Stribeck,
                regime == Regime::Unknown,
            ],
            residual_n: f64::from(last.residual_rms_n),
        })
    }

    /// Statistics over these seeds; `usual_n` is the residual of the undisturbed rig with this motion \[N\].
    pub fn cell(&self, motion: &str, seeds: RangeInclusive<u64>, usual_n: Option<f64>) -> Result<Cell> {
        let runs = each(seeds, |seed| self.run(motion, seed))?;
        let residual_n = mean(runs.iter().map(|run| run.residual_n));
        let is_raised = |i: &usize| 2 * runs.iter().filter(|run| run.flags[*i]).count() >= runs.len();
        let mut flags: Vec<_> = (0..FLAGS.len()).filter(is_raised).map(|i| FLAGS[i]).collect();
        if usual_n.is_some_and(|usual_n| residual_n > LOUD * usual_n) {
            flags.push("residual");
        }
        Ok(Cell {
            last: from_fn(|i| Column::of(runs.iter().filter_map(|run| run.last[i]))),
            coverage: from_fn(|i| Column::of(runs.iter().flat_map(|run| run.published[i].iter().copied())).coverage()),
            residual_n,
            flags,
        })
    }
}

/// Statistics of one case with one motion over its seeds.
#[derive(Clone, Debug)]
pub struct Cell {
    /// Errors of the final values.
    pub last: [Column; 3],
    /// Fraction of all published values whose interval covers the true value; `None` if none was published.
    pub coverage: [Option<f64>; 3],
    /// Mean residual \[N\].
    pub residual_n: f64,
    /// Faults that the device itself reports in at least half of the runs.
    pub flags: Vec<&'static str>,
}
