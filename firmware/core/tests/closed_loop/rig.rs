//! Simulated devices and instruments, the settings that describe them, and the estimator's results for them.

use inerter_core::{
    Active, Change, Counters, Estimate, Interval, Parameter, Parameters, Published, RawSample, Reversal, Settings,
    State, Status, Warning,
};
use inerter_plant::{Excitation, Inerter, Plant, Sample, Sensors, Simulation};

/// Motions of the grid, with the length of a run \[s\].
pub const MOTIONS: [(&str, f64); 6] =
    [("slow", 80.0), ("mid", 20.0), ("fast", 20.0), ("multi", 20.0), ("random", 20.0), ("two", 20.0)];

/// The usual instruments: 1 kHz, 1 N of noise.
pub fn instruments(seed: u64) -> Sensors {
    Sensors {
        force_noise_n: 1.0,
        force_offset_n: 3.0,
        encoder_phase_count: (seed as f64 * 0.618) % 1.0,
        terminal_noise_m: 1e-6,
        seed,
        ..Sensors::default()
    }
}

/// Settings of a device that was calibrated without error.
pub fn calibrated(device: &Inerter, sensors: &Sensors) -> Settings {
    let conversions = sensors.oversampling;
    let Settings { force_min_code, force_max_code, .. } = Settings::default();
    Settings {
        sample_rate_hz: sensors.sample_rate_hz,
        metres_per_count: sensors.metres_per_count,
        oversampling: conversions,
        newtons_per_code: sensors.newtons_per_sample_code(),
        force_zero_code: sensors.force_zero_code * conversions,
        force_min_code: (sensors.force_min_code * conversions).max(force_min_code),
        force_max_code: (sensors.force_max_code * conversions).min(force_max_code),
        metres_per_terminal_code: sensors.metres_per_terminal_code,
        structure_mass_kg: device.structure_mass_kg,
        stiffness_n_per_m: device.stiffness_n_per_m,
        contact_damping_n_s_per_m: device.contact_damping_n_s_per_m,
        skew_s: sensors.delay_s,
        ..Settings::default()
    }
}

/// The same settings, stated to be exact.
pub fn exact(settings: Settings) -> Settings {
    Settings {
        force_gain_u95: 0.0,
        lead_u95: 0.0,
        timebase_u95: 0.0,
        skew_u95_s: 0.0,
        structure_mass_u95_kg: 0.0,
        // A value of 0 would mean 1 %.
        stiffness_u95_n_per_m: 1e-6 * settings.stiffness_n_per_m,
        ..settings
    }
}

/// The sample as a board delivers it.
pub fn raw(sample: &Sample) -> RawSample {
    RawSample {
        index: sample.index,
        position_count: sample.position_count,
        force_code: sample.force_code,
        terminal_code: sample.terminal_code,
    }
}

/// Samples of a device that moves for this long.
pub fn shaken(device: &Inerter, motion: &str, duration_s: f64, sensors: &Sensors) -> Vec<RawSample> {
    changing(device, Vec::new(), motion, duration_s, sensors)
}

/// The same, with a device that changes into others at these times \[s\].
pub fn changing(
    device: &Inerter,
    later: Vec<(f64, Inerter)>,
    motion: &str,
    duration_s: f64,
    sensors: &Sensors,
) -> Vec<RawSample> {
    let excitation = Excitation::parse(motion, sensors.seed).unwrap();
    let plant = Plant::changing(*device, later, excitation).unwrap();
    Simulation::of(plant, *sensors).unwrap().lasting(duration_s).map(|sample| raw(&sample)).collect()
}

/// All results of an estimator.
pub struct Heard {
    pub active: Active,
    pub state: Box<State>,
    pub published: Vec<Published>,
    pub reversals: Vec<Reversal>,
    pub warnings: Vec<Warning>,
    pub changes: Vec<Change>,
    /// Published at the end.
    pub last: Published,
}

impl Heard {
    pub fn counters(&self) -> Counters {
        self.state.counters()
    }
}

/// Runs the samples through an estimator with these settings.
pub fn listen<'a>(settings: &Settings, samples: impl IntoIterator<Item = &'a RawSample>) -> Heard {
    let active = settings.validate().unwrap();
    let state = Box::new(State::new(&active));
    listen_on(active, state, samples)
}

/// The same with a state that may have processed samples before.
pub fn listen_on<'a>(active: Active, mut state: Box<State>, samples: impl IntoIterator<Item = &'a RawSample>) -> Heard {
    let (mut published, mut reversals, mut warnings, mut changes) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for sample in samples {
        let output = active.step(&mut state, sample);
        published.extend(output.published);
        reversals.extend(output.reversal);
        warnings.extend(output.warning);
        changes.extend(output.change);
    }
    let last = active.publish(&state);
    published.iter().chain([&last]).for_each(|published| is_sane(&published.estimate));
    Heard { active, state, published, reversals, warnings, changes, last }
}

/// Neither values nor intervals are NaN.
pub fn is_sane(estimate: &Estimate) {
    for parameter in four(&estimate.recent).into_iter().chain(four(&estimate.whole_run)) {
        assert!(!parameter.fitted().value.is_nan() && !parameter.u95().is_nan(), "{parameter:?}");
        if let Some(Interval { value, u95 }) = parameter.known() {
            assert!(value.is_finite() && u95.is_finite() && u95 >= 0.0, "{parameter:?}");
        }
    }
    assert!(!estimate.residual_rms_n.is_nan());
}

/// The parameters in the order of the law.
pub fn four(parameters: &Parameters) -> [Parameter; 4] {
    let Parameters { inertance_kg, viscous_n_s_per_m, coulomb_n, offset_n } = *parameters;
    [inertance_kg, viscous_n_s_per_m, coulomb_n, offset_n]
}

/// Their statuses in the same order.
pub fn statuses(parameters: &Parameters) -> [Status; 4] {
    four(parameters).map(|parameter| parameter.status())
}

/// Inertance, viscous and Coulomb friction.
pub fn three(parameters: &Parameters) -> [Parameter; 3] {
    let [inertance, viscous, coulomb, _] = four(parameters);
    [inertance, viscous, coulomb]
}

/// The true values of the device, in the same order.
pub fn truth(device: &Inerter) -> [f64; 3] {
    [device.inertance_kg, device.viscous_n_s_per_m, device.coulomb_n]
}

/// Error of a parameter that has a value, relative to the half width of its interval.
pub fn off(parameter: Parameter, truth: f64) -> f64 {
    let Interval { value, u95 } = parameter.known().unwrap_or_else(|| panic!("{truth} is not identified"));
    (f64::from(value) - truth) / f64::from(u95)
}

/// Asserts that a number agrees with the wanted one to within this fraction of it.
#[track_caller]
pub fn is_near(found: f64, wanted: f64, part: f64, what: &str) {
    assert!((found - wanted).abs() <= part * wanted.abs(), "{what}: {found} for {wanted}");
}
