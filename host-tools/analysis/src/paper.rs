//! The paper's device identified blindly from its three tests.
//!
//! Li, Liang and Wang, "Two-terminal manipulation of masses ... Part I", section 4: three tones, 0.053 Hz for the
//! friction, 3.2 Hz for the rest, 15.9 Hz to validate. As in the paper, the lower terminal is moved and the load cell
//! is on the upper one; in addition the terminal's displacement is measured, and [`mod@identify`] with its intervals
//! replaces tuning by eye. Blind means that only the structure mass of the device is given, which the paper weighed.
//!
//! Not from the paper: its Coulomb friction is missing from our copy of the text, 50 N is our choice; noise, encoder
//! and sample rate are those of our bench.

use std::f64::consts::TAU;

use inerter_core::{Interval, Machine};
use inerter_plant::{Excitation, Inerter, Plant, Sensors, Simulation};

use crate::{
    identify::{self, FoundStatus, IdentifyError, Options, identify},
    response::{self, Agreement, ModelParameters, Point},
};
use inerter_data::{
    limits::field,
    replay::{Outcome, replay},
    run::Run,
    series::Series,
};

/// Band in which the paper calls the nonideal effects insignificant \[rad/s\].
pub const PUBLISHED_BAND_RAD_PER_S: (f64, f64) = (0.1, 40.0);
/// Required agreement of the ideal mass with the complete model.
pub const WITHIN: Agreement = Agreement { decibels: 1.0, degrees: 5.0 };
/// Seed of the motions; a tone does not depend on it.
const SEED: u64 = 2011;

/// A test as the paper describes it.
#[derive(Clone, Copy, Debug)]
pub struct Plan {
    /// Number of the paper's figure that shows it.
    pub figure: u32,
    /// Its purpose.
    pub purpose: &'static str,
    /// Frequency \[Hz\].
    pub frequency_hz: f64,
    /// Amplitude of the terminal \[m\].
    pub amplitude_m: f64,
    /// Duration \[s\].
    pub duration_s: f64,
}

/// The three tests in the paper's order.
pub const PLANS: [Plan; 3] = [
    Plan { figure: 8, purpose: "friction", frequency_hz: 0.053, amplitude_m: 15.1e-3, duration_s: 120.0 },
    Plan {
        figure: 9,
        purpose: "inertance, viscous friction and contact",
        frequency_hz: 3.2,
        amplitude_m: 4.16e-3,
        duration_s: 20.0,
    },
    Plan { figure: 10, purpose: "validation", frequency_hz: 15.9, amplitude_m: 0.806e-3, duration_s: 20.0 },
];

impl Plan {
    /// The motion in the plant's syntax.
    pub fn motion(&self) -> String {
        format!("sine:{}Hz:{}m", self.frequency_hz, self.amplitude_m)
    }
}

/// One of the three tests.
#[derive(Clone, Debug)]
pub struct Test {
    /// Its plan.
    pub plan: Plan,
    /// The recording.
    pub run: Run,
    /// The result of the estimator.
    pub outcome: Outcome,
    /// Force over the terminal's displacement at the tone's frequency.
    pub response: Option<Point>,
    /// `(time, measured, calculated)` \[s, N, N\].
    pub force: Vec<(f64, f64, f64)>,
}

impl Test {
    /// RMS of the difference \[N\], and its ratio to the RMS of the measured force.
    pub fn residual(&self) -> (f64, f64) {
        let n = (self.force.len() as f64).max(1.0);
        let (left, all) = self.force.iter().fold((0.0, 0.0), |(left, all), (_, measured, law)| {
            (left + (measured - law).powi(2), all + measured.powi(2))
        });
        ((left / n).sqrt(), (left / all.max(1e-300)).sqrt())
    }
}

/// One parameter: as found, and in the paper.
#[derive(Clone, Debug)]
pub struct Recovered {
    /// Name with unit, as in JSON.
    pub name: &'static str,
    /// Label for a person.
    pub label: &'static str,
    /// Symbol in formulas.
    pub symbol: &'static str,
    /// Unit that it is shown in, and how many of it make one SI unit.
    pub shown: (&'static str, f64),
    /// The value found, SI; `None` if the tests do not identify it.
    pub value: Option<f64>,
    /// Half width of its 95 % interval, SI.
    pub u95: Option<f64>,
    /// Value of the simulated device, SI, which is the paper's unless `published` says otherwise.
    pub truth: f64,
    /// The origin of the paper's value.
    pub published: &'static str,
    /// The test that the value found here comes from.
    pub from: String,
}

impl Recovered {
    /// Whether the interval contains the true value; `None` if nothing was found.
    pub fn covers(&self) -> Option<bool> {
        Some((self.value? - self.truth).abs() <= self.u95?)
    }
}

/// The complete result of the reproduction.
#[derive(Clone, Debug)]
pub struct Reproduction {
    /// The tests in the paper's order.
    pub tests: Vec<Test>,
    /// The parameters.
    pub parameters: Vec<Recovered>,
    /// The complete model with the values found.
    pub model: ModelParameters,
    /// Band in which the ideal mass is within [`WITHIN`] of the complete model \[rad/s\].
    pub band_rad_per_s: Option<(Option<f64>, Option<f64>)>,
    /// Agreement at the ends of the paper's band.
    pub at_published_ends: [Agreement; 2],
    /// Undamped natural frequency \[Hz\] and damping ratio of the inertance on the contact.
    pub resonance: (f64, f64),
}

/// Identifies the device from the recordings of the three tests, in the order of [`PLANS`]; `progress` gets the
/// completed fraction, from 0 to 1.
pub fn reproduce(runs: [Run; 3], mut progress: impl FnMut(f64)) -> Result<Reproduction, IdentifyError> {
    let device = Inerter::paper();
    let mut tests = Vec::new();
    for (plan, run) in PLANS.into_iter().zip(runs) {
        let outcome = replay(&run, |_, _| -> Result<(), IdentifyError> { Ok(()) })?;
        let response = response::measured(&Series::of(&run)).points.into_iter().next();
        tests.push(Test { plan, run, outcome, response, force: Vec::new() });
    }
    progress(0.2);
    let parameters = identified(&tests, by_estimator(&tests, &device))?;
    let found = |name: &str| parameters.iter().find(|one| one.name == name).and_then(|one| one.value).unwrap_or(0.0);
    let identified = Inerter {
        inertance_kg: found("inertance_kg"),
        viscous_n_s_per_m: found("viscous_n_s_per_m"),
        coulomb_n: found("coulomb_n"),
        stiffness_n_per_m: found("stiffness_n_per_m"),
        contact_damping_n_s_per_m: found("contact_damping_n_s_per_m"),
        backlash_m: found("backlash_m").max(0.0),
        structure_mass_kg: found("structure_mass_kg"),
        ..device
    };
    for (number, test) in tests.iter_mut().enumerate() {
        test.force = calculated(test, &identified)?;
        progress(0.4 + 0.2 * (number + 1) as f64);
    }
    // The device alone: the structure mass belongs to the rig.
    let model =
        ModelParameters { structure_mass_kg: 0.0, ..ModelParameters::from(&identify::Parameters::from(&identified)) };
    let band = response::ideal_band(&model, WITHIN);
    let turning = |end: Option<f64>| end.map(|hertz| hertz * TAU);
    let (low, high) = PUBLISHED_BAND_RAD_PER_S;
    let natural = (model.stiffness_n_per_m / model.inertance_kg).sqrt();
    let damping = (model.contact_damping_n_s_per_m + model.viscous_n_s_per_m) / (2.0 * model.inertance_kg * natural);
    progress(1.0);
    Ok(Reproduction {
        tests,
        parameters,
        model,
        band_rad_per_s: band.map(|(low, high)| (turning(low), turning(high))),
        at_published_ends: [low, high].map(|end| Agreement::at(&model, end / TAU)),
        resonance: (natural / TAU, damping),
    })
}

/// The measured force, and that of a device with the values found, with the same motion and without noise.
fn calculated(test: &Test, identified: &Inerter) -> Result<Vec<(f64, f64, f64)>, IdentifyError> {
    // Parameters that are impossible in the plant explain nothing.
    let impossible = |_| IdentifyError::Diverged;
    let excitation = Excitation::parse(&test.plan.motion(), SEED).map_err(impossible)?;
    let plant = Plant::new(*identified, excitation).map_err(impossible)?;
    let perfect = Sensors { newtons_per_code: 1e-3, ..Sensors::default() };
    let simulation = Simulation::of(plant, perfect).map_err(impossible)?;
    let series = Series::of(&test.run);
    let measured = series.stretches.iter().flat_map(|stretch| stretch.force_n.iter());
    let both = measured
        .zip(simulation)
        .map(|(measured, sample)| (sample.t_s, *measured, f64::from(sample.force_code) * perfect.newtons_per_code));
    Ok(both.collect())
}

/// The complete model fitted to the three tests, stage by stage as in the paper, instead of the instrument's own
/// results.
fn identified(tests: &[Test], by_estimator: Vec<Recovered>) -> Result<Vec<Recovered>, IdentifyError> {
    let runs: Vec<Run> = tests.iter().map(|test| test.run.clone()).collect();
    let found = identify(&runs, &Options { staged: true, ..Options::default() }, &mut |_| ())?;
    let complete = found.parameters.named();
    let recovered = |one: Recovered| match complete.iter().find(|(name, _)| *name == one.name) {
        // The structure mass is weighed.
        Some((_, found)) if found.status != FoundStatus::Given => {
            Recovered { value: found.value, u95: found.u95, ..one }
        }
        _ => one,
    };
    Ok(by_estimator.into_iter().map(recovered).collect())
}

/// The instrument's own results after each test, stage by stage as in the paper.
fn by_estimator(tests: &[Test], device: &Inerter) -> Vec<Recovered> {
    let one = |name: &'static str, figure: u32, shown, truth, published, of: fn(&Outcome) -> Option<Interval>| {
        let named = field(Machine::Linear, name);
        let test = tests.iter().find(|test| test.plan.figure == figure);
        let known = test.and_then(|test| of(&test.outcome));
        Recovered {
            name,
            label: named.label,
            symbol: named.symbol,
            shown,
            value: known.map(|found| f64::from(found.value)),
            u95: known.map(|found| f64::from(found.u95)),
            truth,
            published,
            from: test.map(|test| format!("{} Hz", test.plan.frequency_hz)).unwrap_or_default(),
        }
    };
    let tuned = "tuned at 3.2 Hz";
    vec![
        one("inertance_kg", 9, ("kg", 1.0), device.inertance_kg, "calculated from the flywheel", |outcome| {
            outcome.estimate.whole_run.inertance_kg.known()
        }),
        one("viscous_n_s_per_m", 9, ("N s/m", 1.0), device.viscous_n_s_per_m, tuned, |outcome| {
            outcome.estimate.whole_run.viscous_n_s_per_m.known()
        }),
        one("coulomb_n", 8, ("N", 1.0), device.coulomb_n, "missing: 50 N is our choice", |outcome| {
            outcome.estimate.whole_run.coulomb_n.known()
        }),
        one("stiffness_n_per_m", 9, ("kN/m", 1e-3), device.stiffness_n_per_m, tuned, |outcome| {
            outcome.detail.stiffness_n_per_m.known()
        }),
        one("contact_damping_n_s_per_m", 9, ("N s/m", 1.0), device.contact_damping_n_s_per_m, tuned, |outcome| {
            outcome.detail.contact_damping_n_s_per_m.known()
        }),
        one("backlash_m", 9, ("µm", 1e6), device.backlash_m, tuned, |outcome| outcome.detail.backlash.known()),
        Recovered {
            name: "structure_mass_kg",
            label: "Structure mass",
            symbol: "mr",
            shown: ("kg", 1.0),
            value: Some(device.structure_mass_kg),
            u95: Some(0.0),
            truth: device.structure_mass_kg,
            published: "weighed",
            from: "weighed, as in the paper".into(),
        },
    ]
}
