//! The paper's device and rig, simulated, identified blindly, and the paper's figures drawn from it.
//!
//! Li, Liang and Wang, "Two-terminal manipulation of masses ... Part I", section 4: three tones, 0.053 Hz for the friction,
//! 3.2 Hz for the rest, 15.9 Hz to validate. Here as there the lower terminal is moved and the load cell hangs on the upper one; the
//! terminal's displacement is measured as well, and in place of tuning by eye stands [`mod@identify`] with its intervals.
//! Blind: of the device only the structure mass is told, which the paper has weighed.
//!
//! What is not the paper's: its Coulomb friction did not survive in the text at hand, 50 N is our choice; noise, encoder and sample
//! rate are those of our bench.

mod figures;
mod html;

use std::f64::consts::TAU;

use inerter_core::Parameter;
use inerter_plant::{Excitation, Parameters, Plant, Sensors, Simulation};

pub use figures::figures;
pub use html::{found_text, html, truth_text};

use crate::{
    Error,
    identify::{self, Options, Standing, identify},
    replay::{Outcome, replay},
    response::{self, Agreement, ModelParameters, Point},
    run::Run,
    series::Series,
    settings::Overrides,
    simulate::{Setup, SimulateError, bench_sensors, raw},
};

/// Band in which the paper calls the influence of what is not ideal insignificant \[rad/s\].
pub const PUBLISHED_BAND_RAD_PER_S: (f64, f64) = (0.1, 40.0);
/// How near the ideal mass must be to the complete model.
pub const WITHIN: Agreement = Agreement { decibels: 1.0, degrees: 5.0 };
/// Noise of the terminal's displacement, rms \[m\].
const TERMINAL_NOISE_M: f64 = 1e-6;
/// Seed of the first test; each further one takes the next.
const SEED: u64 = 2011;

/// One of the three tests.
#[derive(Clone, Debug)]
pub struct Test {
    /// Number of the paper's figure that shows it.
    pub figure: u32,
    /// What it is for.
    pub purpose: &'static str,
    /// Frequency \[Hz\].
    pub frequency_hz: f64,
    /// Amplitude of the terminal \[m\].
    pub amplitude_m: f64,
    /// Duration \[s\].
    pub duration_s: f64,
    /// What was recorded.
    pub run: Run,
    /// What the estimator made of it.
    pub outcome: Outcome,
    /// Force over the terminal's displacement at the tone.
    pub response: Option<Point>,
    /// `(time, measured, calculated)` \[s, N, N\].
    pub force: Vec<(f64, f64, f64)>,
}

impl Test {
    /// Root mean square of the difference \[N\], and the part of the measured force's that it is.
    pub fn residual(&self) -> (f64, f64) {
        let n = (self.force.len() as f64).max(1.0);
        let (left, all) = self.force.iter().fold((0.0, 0.0), |(left, all), (_, measured, law)| {
            (left + (measured - law).powi(2), all + measured.powi(2))
        });
        ((left / n).sqrt(), (left / all.max(1e-300)).sqrt())
    }
}

/// One parameter: found, and as the paper has it.
#[derive(Clone, Debug)]
pub struct Recovered {
    /// Name with unit, as in JSON.
    pub name: &'static str,
    /// For a person.
    pub label: &'static str,
    /// Symbol in formulas.
    pub symbol: &'static str,
    /// Unit that it is shown in, and how many of it one SI unit is.
    pub shown: (&'static str, f64),
    /// What was found, SI; `None` where the tests do not show it.
    pub value: Option<f64>,
    /// Half width of its 95 % interval, SI.
    pub u95: Option<f64>,
    /// Value of the simulated device, SI, which is the paper's unless `published` says otherwise.
    pub truth: f64,
    /// How the paper comes by its value.
    pub published: &'static str,
    /// Test that it comes from here.
    pub from: String,
}

impl Recovered {
    /// Whether the interval covers the truth; `None` where nothing was found.
    pub fn covers(&self) -> Option<bool> {
        Some((self.value? - self.truth).abs() <= self.u95?)
    }
}

/// Everything that the reproduction came to.
#[derive(Clone, Debug)]
pub struct Reproduction {
    /// The tests in the paper's order.
    pub tests: Vec<Test>,
    /// The parameters.
    pub parameters: Vec<Recovered>,
    /// The complete model with what was found.
    pub model: ModelParameters,
    /// Band in which the ideal mass is within [`WITHIN`] of the complete model \[rad/s\].
    pub band_rad_per_s: Option<(Option<f64>, Option<f64>)>,
    /// How far it is off at the ends of the paper's band.
    pub at_published_ends: [Agreement; 2],
    /// Undamped natural frequency \[Hz\] and damping ratio of the inertance on the contact.
    pub resonance: (f64, f64),
}

/// Runs everything; `progress` is handed the part that is done.
pub fn reproduce(mut progress: impl FnMut(f64)) -> Result<Reproduction, Error> {
    let device = Parameters::paper();
    let mut tests = Vec::new();
    let planned = [
        (8, "friction", 0.053, 15.1e-3, 120.0),
        (9, "inertance, viscous friction and contact", 3.2, 4.16e-3, 20.0),
        (10, "validation", 15.9, 0.806e-3, 20.0),
    ];
    for (number, (figure, purpose, frequency_hz, amplitude_m, duration_s)) in planned.into_iter().enumerate() {
        let run = recorded(&device, number as u64, frequency_hz, amplitude_m, duration_s)?;
        let outcome = replay(&run, |_, _| -> Result<(), Error> { Ok(()) })?;
        let response = response::measured(&Series::of(&run)).points.into_iter().next();
        tests.push(Test {
            figure,
            purpose,
            frequency_hz,
            amplitude_m,
            duration_s,
            run,
            outcome,
            response,
            force: Vec::new(),
        });
        progress((number + 1) as f64 / 5.0);
    }
    let parameters = identified(&tests, by_estimator(&tests, &device))?;
    let found = |name: &str| parameters.iter().find(|one| one.name == name).and_then(|one| one.value).unwrap_or(0.0);
    let identified = Parameters {
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
        progress((number + 4) as f64 / 6.0);
    }
    // The device's own: the structure mass is the rig's.
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

fn motion(frequency_hz: f64, amplitude_m: f64) -> String {
    format!("sine:{frequency_hz}Hz:{amplitude_m}m")
}

/// One test as the rig records it, with settings that know the instruments and the weighed structure mass, and nothing else.
fn recorded(
    device: &Parameters,
    number: u64,
    frequency_hz: f64,
    amplitude_m: f64,
    duration_s: f64,
) -> Result<Run, Error> {
    let sensors = Sensors { terminal_noise_m: TERMINAL_NOISE_M, seed: SEED + number, ..bench_sensors() };
    let mut blind = Overrides::default();
    for (name, value) in [("stiffness_n_per_m", 0.0), ("contact_damping_n_s_per_m", 0.0), ("terminal_sensor", 1.0)] {
        blind.set(name, value, "the reproduction")?;
    }
    let setup = Setup::new(*device, sensors, &motion(frequency_hz, amplitude_m), Some(duration_s), &blind)?;
    let samples = setup.samples()?.map(|sample| raw(&sample)).collect();
    let name = format!("test at {frequency_hz} Hz");
    Ok(Run { name, settings: setup.settings, samples, ..Run::default() })
}

/// The measured force beside that of a device with the values found, under the same motion and without noise.
fn calculated(test: &Test, identified: &Parameters) -> Result<Vec<(f64, f64, f64)>, Error> {
    let excitation =
        Excitation::parse(&motion(test.frequency_hz, test.amplitude_m), SEED).map_err(SimulateError::from)?;
    let plant = Plant::new(*identified, excitation).map_err(SimulateError::from)?;
    let perfect = Sensors { newtons_per_code: 1e-3, ..Sensors::default() };
    let simulation = Simulation::of(plant, perfect).map_err(SimulateError::from)?;
    let series = Series::of(&test.run);
    let measured = series.stretches.iter().flat_map(|stretch| stretch.force_n.iter());
    let both = measured.zip(simulation);
    Ok(both
        .map(|(measured, sample)| (sample.t_s, *measured, f64::from(sample.force_code) * perfect.newtons_per_code))
        .collect())
}

/// The complete model fitted to the three tests, stage by stage as in the paper, in place of what the instrument alone says.
fn identified(tests: &[Test], by_estimator: Vec<Recovered>) -> Result<Vec<Recovered>, Error> {
    let runs: Vec<Run> = tests.iter().map(|test| test.run.clone()).collect();
    let found = identify(&runs, &Options { staged: true, ..Options::default() }, &mut |_| ())?;
    let complete = found.parameters.named();
    let recovered = |one: Recovered| match complete.iter().find(|(name, _)| *name == one.name) {
        // The structure mass is weighed.
        Some((_, found)) if found.status != Standing::Given => Recovered { value: found.value, u95: found.u95, ..one },
        _ => one,
    };
    Ok(by_estimator.into_iter().map(recovered).collect())
}

/// What the instrument itself says after each test, stage by stage as in the paper.
fn by_estimator(tests: &[Test], device: &Parameters) -> Vec<Recovered> {
    let from = |figure: u32| tests.iter().find(|test| test.figure == figure);
    let parameter = |figure: u32, of: fn(&Outcome) -> Parameter| {
        let known = from(figure).and_then(|test| of(&test.outcome).known());
        (known.map(|found| f64::from(found.value)), known.map(|found| f64::from(found.u95)), source(from(figure)))
    };
    let known = from(9).and_then(|test| test.outcome.detail.backlash.known());
    let backlash =
        (known.map(|known| f64::from(known.value)), known.map(|known| f64::from(known.u95)), source(from(9)));
    let weighed = (Some(device.structure_mass_kg), Some(0.0), "weighed, as in the paper".to_string());
    let one = |name, label, symbol, shown, truth, published, (value, u95, from): (Option<f64>, Option<f64>, String)| {
        Recovered { name, label, symbol, shown, value, u95, truth, published, from }
    };
    vec![
        one(
            "inertance_kg",
            "Effective inertance",
            "mt",
            ("kg", 1.0),
            device.inertance_kg,
            "calculated from the flywheel",
            parameter(9, |outcome| outcome.estimate.whole_run.inertance_kg),
        ),
        one(
            "viscous_n_s_per_m",
            "Viscous friction",
            "cf",
            ("N s/m", 1.0),
            device.viscous_n_s_per_m,
            "tuned at 3.2 Hz",
            parameter(9, |outcome| outcome.estimate.whole_run.viscous_n_s_per_m),
        ),
        one(
            "coulomb_n",
            "Coulomb friction",
            "fc",
            ("N", 1.0),
            device.coulomb_n,
            "did not survive: 50 N is our choice",
            parameter(8, |outcome| outcome.estimate.whole_run.coulomb_n),
        ),
        one(
            "stiffness_n_per_m",
            "Contact stiffness",
            "ks",
            ("kN/m", 1e-3),
            device.stiffness_n_per_m,
            "tuned at 3.2 Hz",
            parameter(9, |outcome| outcome.detail.stiffness_n_per_m),
        ),
        one(
            "contact_damping_n_s_per_m",
            "Contact damping",
            "cs",
            ("N s/m", 1.0),
            device.contact_damping_n_s_per_m,
            "tuned at 3.2 Hz",
            parameter(9, |outcome| outcome.detail.contact_damping_n_s_per_m),
        ),
        one("backlash_m", "Backlash", "eps", ("µm", 1e6), device.backlash_m, "tuned at 3.2 Hz", backlash),
        one("structure_mass_kg", "Structure mass", "mr", ("kg", 1.0), device.structure_mass_kg, "weighed", weighed),
    ]
}

fn source(test: Option<&Test>) -> String {
    test.map(|test| format!("{} Hz", test.frequency_hz)).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_paper_is_reproduced_and_its_band_is_not() {
        let mut parts = Vec::new();
        let paper = reproduce(|part| parts.push(part)).unwrap();
        assert_eq!(parts.last(), Some(&1.0));
        for one in &paper.parameters {
            println!("{} {:?} ± {:?}, {}", one.name, one.value, one.u95, one.truth);
            assert_eq!(one.covers(), Some(true), "{one:?}");
        }
        for test in &paper.tests {
            let (rms_n, part) = test.residual();
            println!("{} Hz: {rms_n} N, {part}", test.frequency_hz);
            assert!((0.5..40.0).contains(&rms_n) && part < 0.05, "{} Hz: {rms_n} N, {part}", test.frequency_hz);
        }
        let (low, high) = paper.band_rad_per_s.unwrap();
        let (low, high) = (low.unwrap(), high.unwrap());
        assert!((0.9..1.5).contains(&low) && (27.0..29.0).contains(&high), "{low} {high}");
        let [slow, fast] = paper.at_published_ends;
        assert!(slow.degrees.abs() > 30.0 && fast.decibels > 2.0, "{slow:?} {fast:?}");
        let drawn = figures(&paper);
        assert_eq!(
            drawn.iter().map(|figure| figure.name).collect::<Vec<_>>(),
            ["figure-8", "figure-9", "figure-10", "figure-11"]
        );
        let page = html(&paper, &drawn);
        assert!(!page.contains("NaN") && !page.contains("http://") || page.contains("http://www.w3.org/2000/svg"));
        assert!(page.contains("0.1 to 40 rad/s") && page.contains("50 N is our choice"));
    }
}
