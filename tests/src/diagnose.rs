//! Runs that break the law in one known way, and their diagnosis.

use crate::{
    coverage::stated_true,
    data::replayed,
    grid::{Error, Motion, calibrated, mean, raw, seeded, sensors, shaken},
};
use inerter_analysis::diagnose::{Cause, Diagnosis, Encoder, Judged, Kind, diagnose, judged, suspected};
use inerter_core::{Machine, Settings};
use inerter_data::{gated::Gated, replay::Outcome, run::Run, series::Series};
use inerter_plant::{Inerter, Motion as Screw, Sensors, Truth};
use std::f64::consts::TAU;

/// Number of instants within a sample over which the force is averaged, symmetric about its middle: no load cell
/// follows a step at once.
pub const WITHIN: usize = 15;

/// Forces besides the law. The terminal's motion is imposed, so they simply add to the measured force.
#[derive(Clone, Copy, Debug, Default)]
pub struct Added {
    /// Friction as a fraction of the force.
    pub load: f64,
    /// Amplitude of a force that varies once per turn \[N\].
    pub ripple_n: f64,
    /// Change of Coulomb friction over the run \[N\].
    pub warming_n: f64,
    /// Change of the offset over the run \[N\].
    pub drift_n: f64,
    /// A spring in parallel with the screw \[N/m\].
    pub spring_n_per_m: f64,
    /// Friction proportional to the square of the velocity \[N s2/m2\].
    pub quadratic: f64,
    /// Error of the measured force, proportional to its cube \[1/N2\].
    pub cube: f64,
}

impl Added {
    /// The force besides the law, except for the drift of the offset \[N\]. `time` is relative to the run, from -0.5 to
    /// 0.5.
    pub fn at_n(&self, force_n: f64, truth: &Truth, time: f64, lead_m: f64) -> f64 {
        let Self { load, ripple_n, warming_n, spring_n_per_m, quadratic, cube, .. } = *self;
        let sign = truth.v2_m_per_s.signum() * f64::from(u8::from(truth.motion != Screw::Stuck));
        load * force_n.abs() * sign / (1.0 - load * sign * force_n.signum())
            + ripple_n * (TAU * truth.x2_m / lead_m + 0.7).sin()
            + warming_n * time * sign
            + spring_n_per_m * truth.x2_m
            + quadratic * truth.v2_m_per_s * truth.v2_m_per_s.abs()
            + cube * force_n.powi(3)
    }
}

/// One way to break the law.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// Name of the fault.
    pub name: &'static str,
    /// The cause that must be named; `None` in a run without a fault.
    pub kind: Option<Kind>,
    /// Its size in the cause's unit.
    pub size: f64,
    /// The device.
    pub device: Inerter,
    /// The instruments.
    pub sensors: Sensors,
    /// Forces besides the law.
    pub added: Added,
    /// The settings describe a rotary machine of 2e-4 kg m^2, which gives the same samples.
    pub is_rotary: bool,
}

/// The reference device on the grid's first rig.
fn clean(name: &'static str) -> Case {
    let (device, sensors) = (Inerter::paper(), sensors());
    Case { name, kind: None, size: 0.0, device, sensors, added: Added::default(), is_rotary: false }
}

/// Cases with one fault each.
pub fn cases() -> Vec<Case> {
    let paper = Inerter::paper();
    // The added force does not deflect the contact. Without a structure mass it need not.
    let rigid = Inerter { structure_mass_kg: 0.0, ..paper };
    let added = |name, kind, size, added| Case { kind: Some(kind), size, added, device: rigid, ..clean(name) };
    let device = |name, kind, size, device| Case { kind: Some(kind), size, device, ..clean(name) };
    let late = |name, delay_s| Case {
        kind: Some(Kind::Skew),
        size: delay_s,
        sensors: Sensors { delay_s, ..sensors() },
        ..clean(name)
    };
    let none = Added::default();
    let stribeck = |mm_per_s: f64| Inerter { stribeck_velocity_m_per_s: mm_per_s * 1e-3, ..Inerter::stribeck() };
    let presliding = |um: f64| Inerter { presliding_m: um * 1e-6, ..paper };
    let rise = Inerter::stribeck().stribeck_ratio * paper.coulomb_n - paper.coulomb_n;
    let uneven = 0.4 * paper.viscous_n_s_per_m;
    vec![
        added("friction of 2 % of the load", Kind::LoadDependent, 0.02, Added { load: 0.02, ..none }),
        added("friction of 4 % of the load", Kind::LoadDependent, 0.04, Added { load: 0.04, ..none }),
        added("ripple of 3 N", Kind::PositionPeriodic, 3.0, Added { ripple_n: 3.0, ..none }),
        added("ripple of 10 N", Kind::PositionPeriodic, 10.0, Added { ripple_n: 10.0, ..none }),
        added("friction falls by 15 N", Kind::Drift, -15.0, Added { warming_n: -15.0, ..none }),
        added("offset drifts by 5 N", Kind::Drift, 5.0, Added { drift_n: 5.0, ..none }),
        late("force 1 ms late", 1e-3),
        late("force 3 ms late", 3e-3),
        Case {
            kind: Some(Kind::EncoderError),
            size: 10e-6,
            sensors: Sensors { encoder_eccentricity_m: 10e-6, ..sensors() },
            ..clean("eccentricity 10 um")
        },
        device("Stribeck 1.3, 5 mm/s", Kind::Stribeck, rise, stribeck(5.0)),
        device("Stribeck 1.3, 10 mm/s", Kind::Stribeck, rise, stribeck(10.0)),
        device("presliding 50 um", Kind::Presliding, 50e-6, presliding(50.0)),
        device("presliding 200 um", Kind::Presliding, 200e-6, presliding(200.0)),
        device("cf +-40 % by direction", Kind::Direction, uneven, Inerter { viscous_asymmetry: 0.4, ..paper }),
    ]
}

/// The case of this name.
///
/// # Panics
/// If there is none.
pub fn case(name: &str) -> Case {
    cases().into_iter().find(|case| case.name == name).expect("a case")
}

/// Other faults of the reference device, without a structure mass.
pub fn others() -> [Case; 3] {
    let none = Added::default();
    let device = Inerter { structure_mass_kg: 0.0, ..Inerter::paper() };
    let added = |name, kind, size, added| Case { kind: Some(kind), size, added, device, ..clean(name) };
    [
        added("a spring", Kind::Spring, 5e3, Added { spring_n_per_m: 5e3, ..none }),
        added("friction by the square", Kind::QuadraticFriction, 400.0, Added { quadratic: 400.0, ..none }),
        // Its size is reported relative to the greatest force of the run.
        added("a cell that saturates", Kind::ForceNonlinear, f64::NAN, Added { cube: -3e-10, ..none }),
    ]
}

/// The clean case, with another noise and rate.
pub fn clean_case(force_noise_n: f64, sample_rate_hz: f64) -> Case {
    Case { sensors: Sensors { force_noise_n, sample_rate_hz, ..sensors() }, ..clean("nothing") }
}

/// Noises \[N\] and sample rates \[Hz\] of runs without a fault, and lengths of a count \[m\].
const NOISES_AND_RATES: [(f64, f64); 6] =
    [(0.2, 1000.0), (1.0, 1000.0), (5.0, 1000.0), (20.0, 1000.0), (1.0, 2000.0), (1.0, 4000.0)];
const COUNTS_M: [f64; 4] = [0.5e-6, 5e-6, 10e-6, 20e-6];

/// Runs without a fault: several noises, rates and encoders, a lighter device, a preloaded one, and a rotary one.
pub fn clean_cases() -> Vec<Case> {
    let case = clean("nothing");
    let noises = NOISES_AND_RATES.map(|(noise_n, rate_hz)| clean_case(noise_n, rate_hz));
    let counts =
        COUNTS_M.map(|metres_per_count| Case { sensors: Sensors { metres_per_count, ..case.sensors }, ..case });
    let light = Inerter { inertance_kg: 95.0, viscous_n_s_per_m: 200.0, coulomb_n: 20.0, ..Inerter::paper() };
    let devices = [light, Inerter::preloaded()].map(|device| Case { device, ..case });
    let rotary = Case { is_rotary: true, ..case };
    noises.into_iter().chain(counts).chain(devices).chain([rotary]).collect()
}

/// The clean case with this backlash \[m\]: its flanks separate.
pub fn parting(backlash_m: f64) -> Case {
    Case { device: Inerter { backlash_m, ..Inerter::paper() }, ..clean("flanks that part") }
}

/// Radians of the rotary machine per metre of a linear one, and its moment of inertia \[kg m^2\].
const RADIANS_PER_M: f64 = 100.0;
const INERTIA: f64 = 2e-4;

/// The settings that describe a linear machine of this inertance as a rotary one.
fn rotary(linear: Settings, inertance_kg: f64) -> Settings {
    let torque = INERTIA / inertance_kg * RADIANS_PER_M;
    let stiff = torque / RADIANS_PER_M;
    Settings {
        machine: Machine::Rotary,
        metres_per_count: linear.metres_per_count * RADIANS_PER_M,
        newtons_per_code: linear.newtons_per_code * torque,
        structure_mass_kg: linear.structure_mass_kg * stiff,
        stiffness_n_per_m: linear.stiffness_n_per_m * stiff,
        contact_damping_n_s_per_m: linear.contact_damping_n_s_per_m * stiff,
        ..linear
    }
}

/// The output of `inerter replay` for a run.
pub struct Replayed {
    /// The estimator's result.
    pub outcome: Outcome,
    /// Causes named without being asked for.
    pub causes: Vec<Cause>,
    /// The parameters with the intervals derived from the samples.
    pub judged: [Judged; 4],
}

impl Replayed {
    /// Replays any run.
    pub fn of(run: &Run) -> Result<Self, Error> {
        let outcome = replayed(run)?;
        let gated = Gated::of(run, &[]);
        let causes = suspected(&gated, &run.settings, &outcome.published());
        let judged = judged(&gated.series, &run.settings, &outcome);
        Ok(Self { outcome, causes, judged })
    }
}

impl Case {
    /// One run through the estimator and the tests for causes.
    pub fn diagnosed(&self, motion: &Motion, seed: u64) -> Result<Diagnosis, Error> {
        let run = self.recorded(motion, seed, true)?;
        let outcome = replayed(&run)?;
        Ok(diagnose(&Series::of(&run), &run.settings, &outcome.published(), Encoder::default(), &|| {})?)
    }

    /// Causes named without being asked for in one run, with the contact's stiffness stated or not.
    pub fn told(&self, motion: &Motion, seed: u64, with_stiffness: bool) -> Result<Vec<Cause>, Error> {
        let run = self.recorded(motion, seed, with_stiffness)?;
        Ok(suspected(&Gated::of(&run, &[]), &run.settings, &replayed(&run)?.published()))
    }

    /// The estimator's result for one run.
    pub fn estimated(&self, motion: &Motion, seed: u64) -> Result<Outcome, Error> {
        Ok(replayed(&self.recorded(motion, seed, true)?)?)
    }

    /// One run, with the causes named without being asked for and the parameters judged by the samples.
    pub fn replayed(&self, motion: &Motion, seed: u64) -> Result<Replayed, Error> {
        Replayed::of(&self.recorded(motion, seed, true)?)
    }

    /// The plant's true states, [`WITHIN`] times per sample.
    pub fn truths(&self, motion: &Motion, seed: u64) -> Result<Vec<Truth>, Error> {
        let sample_rate_hz = self.sensors.sample_rate_hz * WITHIN as f64;
        let sensors = Sensors { sample_rate_hz, delay_s: 0.0, seed, ..self.sensors };
        let simulation = shaken(&self.device, motion.name, sensors)?;
        Ok(simulation.lasting(motion.duration_s).map(|sample| sample.truth).collect())
    }

    /// The recording of one run, with the contact's stiffness stated or not.
    pub fn recorded(&self, motion: &Motion, seed: u64, with_stiffness: bool) -> Result<Run, Error> {
        let force_drift_n_per_s = self.added.drift_n / motion.duration_s;
        let sensors = seeded(Sensors { force_drift_n_per_s, ..self.sensors }, seed);
        let calibrated = calibrated(&self.device, &sensors);
        let stated = f64::from(u8::from(with_stiffness));
        let settings = Settings {
            stiffness_n_per_m: stated * calibrated.stiffness_n_per_m,
            contact_damping_n_s_per_m: stated * calibrated.contact_damping_n_s_per_m,
            skew_s: 0.0,
            ..stated_true(calibrated)
        };
        let simulation = shaken(&self.device, motion.name, sensors)?;
        let code_n = settings.newtons_per_code;
        let truths = self.truths(motion, seed)?;
        let mut samples = Vec::new();
        for (n, sample) in simulation.lasting(motion.duration_s).enumerate() {
            let mut raw = raw(&sample);
            let force_n = f64::from(raw.force_code) * code_n - sensors.force_offset_n;
            let time = sample.truth.t_s / motion.duration_s - 0.5;
            let first = (n * WITHIN).saturating_sub(WITHIN / 2);
            let around = truths.iter().skip(first).take(WITHIN);
            let added_n = mean(around.map(|truth| self.added.at_n(force_n, truth, time, sensors.lead_m)));
            raw.force_code += (added_n / code_n).round() as i32;
            samples.push(raw);
        }
        let settings = if self.is_rotary { rotary(settings, self.device.inertance_kg) } else { settings };
        Ok(Run { settings, samples, ..Run::default() })
    }
}
