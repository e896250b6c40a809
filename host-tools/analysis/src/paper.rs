//! The paper's device identified blindly from its three tests.
//!
//! Li, Liang and Wang, "Two-terminal manipulation of masses ... Part I", section 4: three tones, 0.053 Hz for the
//! friction, 3.2 Hz for the rest, 15.9 Hz to validate. As in the paper, the lower terminal is moved and the load cell
//! is on the upper one; in addition the terminal's displacement is measured, and
//! [`identify`](mod@crate::identify) with its intervals replaces tuning by eye. Blind means that only the structure
//! mass of the device is given, which the paper weighed.
//!
//! Not from the paper: its Coulomb friction is missing from our copy of the text, 50 N is our choice; noise, encoder
//! and sample rate are those of our bench.

use std::f64::consts::TAU;

use inerter_core::Machine;
use inerter_plant::{Excitation, Inerter, Plant, Sensors, Simulation};

use crate::{
    identify::{Found, FoundStatus, IdentifyError, Options, Parameters, identify},
    response::{self, Agreement, Point},
};
use inerter_data::{limits::field, run::Run, series::Series};

/// Band in which the paper calls the nonideal effects insignificant \[rad/s\].
pub const PUBLISHED_BAND_RAD_PER_S: (f64, f64) = (0.1, 40.0);
/// Required agreement of the ideal mass with the complete model.
pub const WITHIN: Agreement = Agreement { decibels: 1.0, degrees: 5.0 };
/// Seed of the motions; a tone does not depend on it.
const SEED: u64 = 2011;
/// Origin of the paper's values that were adjusted by eye.
const TUNED: &str = "tuned at 3.2 Hz";
/// The first parameters of the model: index in [`PLANS`] of the test that shows each, the unit that it is shown in with
/// how many of it make one SI unit, and the origin of the paper's value.
const SHOWN: [(usize, (&str, f64), &str); 6] = [
    (1, ("kg", 1.0), "calculated from the flywheel"),
    (1, ("N s/m", 1.0), TUNED),
    (0, ("N", 1.0), "missing: 50 N is our choice"),
    (1, ("kN/m", 1e-3), TUNED),
    (1, ("N s/m", 1.0), TUNED),
    (1, ("µm", 1e6), TUNED),
];

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
    pub model: Parameters,
    /// Band in which the ideal mass is within [`WITHIN`] of the complete model \[rad/s\].
    pub band_rad_per_s: Option<(Option<f64>, Option<f64>)>,
    /// Agreement at the ends of the paper's band.
    pub at_published_ends: [Agreement; 2],
    /// Undamped natural frequency \[Hz\] and damping ratio of the inertance on the contact.
    pub resonance: (f64, f64),
}

/// Identifies the device from the recordings of the three tests, in the order of [`PLANS`], stage by stage as in the
/// paper; `progress` gets the completed fraction, from 0 to 1.
pub fn reproduce(runs: [Run; 3], mut progress: impl FnMut(f64)) -> Result<Reproduction, IdentifyError> {
    let device = Inerter::paper();
    progress(0.2);
    let found = identify(&runs, &Options { staged: true, ..Options::default() }, &mut |_| ())?;
    let truths: Parameters = Parameters::from(&device);
    let mut parameters: Vec<Recovered> = found
        .parameters
        .named()
        .into_iter()
        .zip(truths.named())
        .zip(SHOWN)
        .map(|(((name, found), (_, truth)), (place, shown, published))| {
            let named = field(Machine::Linear, name);
            Recovered {
                name,
                label: named.label,
                symbol: named.symbol,
                shown,
                value: found.value,
                u95: found.u95,
                truth: *truth,
                published,
                from: format!("{} Hz", PLANS[place].frequency_hz),
            }
        })
        .collect();
    let weighed = Found::known(device.structure_mass_kg, 0.0);
    let structure = &found.parameters.structure_mass_kg;
    let structure = if structure.status == FoundStatus::Given { &weighed } else { structure };
    parameters.push(Recovered {
        name: "structure_mass_kg",
        label: "Structure mass",
        symbol: "mr",
        shown: ("kg", 1.0),
        value: structure.value,
        u95: structure.u95,
        truth: device.structure_mass_kg,
        published: "weighed",
        from: "weighed, as in the paper".into(),
    });
    let values = found.model();
    let identified = Inerter {
        inertance_kg: values.inertance_kg,
        viscous_n_s_per_m: values.viscous_n_s_per_m,
        coulomb_n: values.coulomb_n,
        stiffness_n_per_m: values.stiffness_n_per_m,
        contact_damping_n_s_per_m: values.contact_damping_n_s_per_m,
        backlash_m: values.backlash_m.max(0.0),
        structure_mass_kg: structure.value.unwrap_or(0.0),
        ..device
    };
    let mut tests = Vec::new();
    for ((number, plan), run) in PLANS.into_iter().enumerate().zip(&runs) {
        let series = Series::of(run);
        let response = response::measured(&series).points.into_iter().next();
        tests.push(Test { plan, response, force: calculated(&plan, &series, &identified)? });
        progress(0.4 + 0.2 * (number + 1) as f64);
    }
    // The device alone: the structure mass belongs to the rig.
    let model = Parameters { structure_mass_kg: 0.0, ..Parameters::from(&identified) };
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
fn calculated(plan: &Plan, series: &Series, identified: &Inerter) -> Result<Vec<(f64, f64, f64)>, IdentifyError> {
    // Parameters that are impossible in the plant explain nothing.
    let impossible = |_| IdentifyError::Diverged;
    let excitation = Excitation::parse(&plan.motion(), SEED).map_err(impossible)?;
    let plant = Plant::new(*identified, excitation).map_err(impossible)?;
    let perfect = Sensors { newtons_per_code: 1e-3, ..Sensors::default() };
    let simulation = Simulation::of(plant, perfect).map_err(impossible)?;
    let measured = series.stretches.iter().flat_map(|stretch| stretch.force_n.iter());
    let both = measured
        .zip(simulation)
        .map(|(measured, sample)| (sample.t_s, *measured, f64::from(sample.force_code) * perfect.newtons_per_code));
    Ok(both.collect())
}
