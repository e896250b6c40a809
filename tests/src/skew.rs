//! Machines of any size with a delayed force, and the measured delay.

use crate::{
    data::replayed,
    grid::{Result, raw},
};
use inerter_analysis::skew::{Skew, SkewError, skew};
use inerter_data::{replay::Outcome, run::Run, settings::Overrides};
use inerter_plant::{Inerter, Sensors};
use inerter_simulate::{Setup, bench_sensors};
use rand_chacha::{
    ChaCha8Rng,
    rand_core::{RngCore, SeedableRng},
};
use std::f64::consts::TAU;

/// Length of a run \[s\].
const DURATION_S: f64 = 20.0;
/// Ratio of the peaks of velocity and acceleration to their rms, with margin.
const PEAKS: f64 = 12.0;

/// Kinds of friction and contact. A kind listed twice is drawn twice as often.
const DEVICES: [&str; 7] =
    ["Coulomb", "Coulomb", "presliding", "Stribeck", "friction by direction", "servo", "backlash"];
/// Kinds of motion.
const MOTIONS: [&str; 5] = ["random", "multi", "two", "moves", "chirp"];

/// One machine with one motion; its settings do not state the delay.
pub struct Case {
    /// Kind of friction or contact.
    pub device: &'static str,
    /// Kind of motion.
    pub motion: &'static str,
    /// Device, motion and instruments.
    pub setup: Setup,
}

/// Result for one case.
pub struct Found {
    /// The estimator's result without the skew.
    pub before: Outcome,
    /// The skew.
    pub skew: Result<Skew, SkewError>,
    /// The estimator's result with the measured skew and its interval applied.
    pub after: Option<Outcome>,
}

impl Case {
    /// Delay of the force \[s\].
    pub fn delay_s(&self) -> f64 {
        self.setup.sensors.delay_s
    }

    /// Simulates the machine and determines the skew.
    pub fn found(&self) -> Result<Found> {
        let samples = self.setup.samples()?.map(|sample| raw(&sample)).collect();
        let mut run = Run { settings: self.setup.settings, samples, ..Run::default() };
        let before = replayed(&run)?;
        let skew = skew(&run, &before);
        let after = match &skew {
            Ok(found) => {
                (run.settings.skew_s, run.settings.skew_u95_s) = (found.skew_s, found.u95_s);
                Some(replayed(&run)?)
            }
            Err(_) => None,
        };
        Ok(Found { before, skew, after })
    }
}

/// A device and its instruments with a motion. The settings are true except for the skew.
pub fn case(
    (device, parameters): (&'static str, Inerter),
    sensors: Sensors,
    (motion, text): (&'static str, &str),
    overrides: &Overrides,
) -> Result<Case> {
    let mut setup = Setup::new(parameters, sensors, text, Some(DURATION_S), overrides)?;
    setup.settings.skew_s = 0.0;
    Ok(Case { device, motion, setup })
}

/// The axis of a servo motor: 2e-4 kg m^2 and torques below 0.1 N m at 1 kHz with 20 bits per turn; friction is greater
/// at low speed, has a presliding distance of 0.2 mrad, and differs by direction.
pub fn servo_axis(text: &str, delay_s: f64, seed: u64) -> Result<Case> {
    let parameters = Inerter {
        inertance_kg: 2e-4,
        viscous_n_s_per_m: 1e-4,
        coulomb_n: 0.02,
        stiffness_n_per_m: 500.0,
        contact_damping_n_s_per_m: 0.03,
        structure_mass_kg: 0.0,
        coulomb_asymmetry: 0.1,
        viscous_asymmetry: 0.2,
        stribeck_ratio: 1.15,
        stribeck_velocity_m_per_s: 0.5,
        presliding_m: 2e-4,
        ..Inerter::paper()
    };
    let sensors = Sensors {
        metres_per_count: TAU / f64::from(1 << 20),
        lead_m: TAU,
        newtons_per_code: 1e-5,
        force_noise_n: 5e-4,
        delay_s,
        seed,
        ..bench_sensors()
    };
    let mut overrides = Overrides::default();
    for (name, value) in
        [("machine", 1.0), ("full_scale_velocity_m_per_s", 100.0), ("full_scale_acceleration_m_per_s2", 1e4)]
    {
        overrides.set(name, value, "the axis")?;
    }
    case(("servo", parameters), sensors, ("moves", text), &overrides)
}

/// A source of random numbers.
pub(crate) struct Draw(ChaCha8Rng);

impl Draw {
    pub(crate) fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed))
    }

    pub(crate) fn unit(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Log-uniform.
    fn magnitude(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.unit())
    }

    fn of<T: Copy>(&mut self, all: &[T]) -> T {
        all[(self.0.next_u32() as usize) % all.len()]
    }
}

/// A motion with typical values of its stroke \[m\], velocity \[m/s\] and acceleration \[m/s^2\].
struct Shaken {
    kind: &'static str,
    text: String,
    stroke_m: f64,
    velocity: f64,
    acceleration: f64,
    highest_hz: f64,
}

fn motion(draw: &mut Draw) -> Shaken {
    let (kind, highest_hz, velocity) = (draw.of(&MOTIONS), draw.magnitude(3.0, 25.0), draw.magnitude(5e-3, 30.0));
    let lowest_hz = highest_hz / draw.between(5.0, 30.0);
    let (text, stroke_m, acceleration) = match kind {
        "two" => {
            let low_hz = highest_hz * draw.between(0.1, 0.4);
            let [slow, fast] = [velocity / (TAU * low_hz), 0.7 * velocity / (TAU * highest_hz)];
            let text = format!("tones:{low_hz:.3}Hz:{slow:.9}m,{highest_hz:.3}Hz:{fast:.9}m");
            (text, slow, 2.8 * highest_hz * velocity)
        }
        "moves" => {
            let ramp_s = draw.between(0.02, 0.15);
            let (stroke, acceleration) = (velocity * draw.between(1.2, 4.0) * ramp_s, velocity / ramp_s);
            let rest_s = draw.between(0.0, 0.3);
            let text = format!("moves:{stroke:.9}m:{velocity:.6}m/s:{acceleration:.6}m/s2:{rest_s:.3}s");
            (text, stroke, 0.6 * acceleration)
        }
        "chirp" => {
            let text = format!("chirp:{lowest_hz:.3}-{highest_hz:.3}Hz:{velocity:.6}m/s:20s");
            (text, velocity / highest_hz, 3.0 * highest_hz * velocity)
        }
        _ => {
            let text = format!("{kind}:{lowest_hz:.3}-{highest_hz:.3}Hz:{velocity:.6}m/s");
            (text, 1.5 * velocity / highest_hz, 3.6 * highest_hz * velocity)
        }
    };
    Shaken { kind, text, stroke_m, velocity, acceleration, highest_hz }
}

/// A machine of 3 mg m^2 to 500 kg with a motion of its own, noise of 0.02 to 5 % of its force, and 300 to 300 000
/// counts per stroke, at 500 Hz to 4 kHz, with the force up to 5 ms late or early.
pub fn drawn(seed: u64) -> Result<Case> {
    let mut draw = Draw::new(seed);
    let shaken = motion(&mut draw);
    let Shaken { stroke_m, velocity, acceleration, .. } = shaken;
    let kind = draw.of(&DEVICES);
    let inertance_kg = draw.magnitude(3e-6, 500.0);
    let inertial_n = inertance_kg * acceleration;
    let coulomb_n = inertial_n * draw.magnitude(0.01, 1.5);
    let own = TAU * draw.magnitude(2.0, 30.0) * shaken.highest_hz;
    let is = |kinds: &[&str]| kinds.contains(&kind);
    let parameters = Inerter {
        inertance_kg,
        coulomb_n,
        viscous_n_s_per_m: inertial_n / velocity * draw.magnitude(1e-3, 0.3),
        stiffness_n_per_m: inertance_kg * own * own,
        contact_damping_n_s_per_m: 2.0 * draw.between(0.02, 0.3) * inertance_kg * own,
        structure_mass_kg: if draw.unit() < 0.3 { 0.01 * inertance_kg } else { 0.0 },
        presliding_m: if is(&["presliding", "servo"]) { stroke_m * draw.magnitude(3e-4, 0.02) } else { 0.0 },
        stribeck_ratio: if is(&["Stribeck", "servo"]) { draw.between(1.1, 1.6) } else { 1.0 },
        stribeck_velocity_m_per_s: velocity * draw.magnitude(0.02, 0.3),
        coulomb_asymmetry: if is(&["friction by direction", "servo"]) { draw.between(-0.3, 0.3) } else { 0.0 },
        viscous_asymmetry: if is(&["friction by direction", "servo"]) { draw.between(-0.3, 0.3) } else { 0.0 },
        backlash_m: if is(&["backlash"]) { stroke_m * draw.magnitude(1e-4, 1e-2) } else { 0.0 },
        ..Inerter::paper()
    };
    let sample_rate_hz: f64 = draw.of(&[500.0, 1000.0, 1000.0, 2000.0, 4000.0]);
    let noise_n = inertial_n.hypot(coulomb_n) * draw.magnitude(2e-4, 0.05) * (sample_rate_hz / 1000.0).sqrt();
    // The plant's own limit.
    let noise_n = noise_n.min(1e4);
    let sensors = Sensors {
        sample_rate_hz,
        metres_per_count: stroke_m / draw.magnitude(300.0, 3e5),
        encoder_phase_count: draw.unit(),
        newtons_per_code: (noise_n * draw.magnitude(0.01, 1.0)).min(1e3),
        force_noise_n: noise_n,
        force_offset_n: coulomb_n * draw.between(-0.5, 0.5),
        delay_s: draw.between(-5e-3, 5e-3),
        seed,
        ..bench_sensors()
    };
    let mut overrides = Overrides::default();
    overrides.set("full_scale_velocity_m_per_s", (PEAKS * velocity).max(1e-3), "the motion")?;
    overrides.set("full_scale_acceleration_m_per_s2", (PEAKS * acceleration).max(1e-2), "the motion")?;
    case((kind, parameters), sensors, (shaken.kind, &shaken.text), &overrides)
}
