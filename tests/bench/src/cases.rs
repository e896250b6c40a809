//! Questions put to the methods besides speed: the regressors of each, made from simulated samples by one kernel.
//!
//! The simulated device has no structure mass here, so that no method has to correct for it; the sign of the velocity
//! is the true one, and sticking is known. So methods are compared on good regressors.

use crate::{
    kernels::Kernels,
    machine::{Noise, Update},
    methods::{Method, Tuning},
};
use inerter_plant::{Excitation, Flank, Inerter, Motion, Plant, Sample, Sensors, Simulation};
use std::{error::Error, f64::consts::TAU};

/// Samples per second.
pub const RATE_HZ: f64 = 1000.0;
/// Contact law: force \[N\] and its derivative \[N/s\] in their units, displacement in um.
pub const FORCE_UNIT_N: f64 = 1e3;
/// See [`FORCE_UNIT_N`].
pub const FORCE_RATE_UNIT_N_PER_S: f64 = 1e4;
/// Boxes of the kernels \[samples\]: for the contact, whose flanks are short, for motion, and for slow motion.
const CONTACT_BOX: usize = 2;
const MOTION_BOX: usize = 16;
const SLOW_BOX: usize = 64;
/// In slow motion one sample in this many gives an update.
pub const SLOW_STEP: usize = 4;
/// What is left out on either side of a flight \[samples\].
const CLEARANCE: usize = 4;
/// Correlation length after the motion kernel \[samples\]: 2.09 boxes.
pub const THIN: usize = 33;
/// Runs for the intervals, and for each other question.
pub const INTERVAL_SEEDS: u64 = 32;
/// See [`INTERVAL_SEEDS`].
pub const SEEDS: u64 = 4;
/// Length of a run \[s\].
pub const DURATION_S: f64 = 20.0;
/// Times at which a slow run is read \[s\].
pub const SLOW_S: [f64; 2] = [5.0, 80.0];
/// When the device changes \[s\], and by how much its inertance.
pub const CHANGE_S: f64 = 10.0;
/// See [`CHANGE_S`].
pub const CHANGE: f64 = 1.05;
/// Memories tried for the change \[s\].
pub const MEMORIES_S: [f64; 2] = [1.0, 30.0];
/// The inertance is recorded after every so many updates \[samples\].
pub const TRACK: usize = 10;
/// Backlash of the worn device \[m\].
pub const BACKLASH_M: f64 = 1e-4;
/// Offset of the force \[N\].
pub const OFFSET_N: f64 = 3.0;
/// Truth of the questions without a device: mt, cf, fc, offset; and 1/ks, -cs/ks^2, eps/2, c in the contact's units.
pub const WHITE_TRUTH: [f64; 4] = [300.0, 31.4, 50.0, 3.0];
/// See [`WHITE_TRUTH`].
pub const CLEAN_TRUTH: [f64; 4] = [476.0, -2.7, 50.0, 8.0];

/// What is asked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Question {
    /// The contact law without noise or flight: a method that cannot answer is driven wrongly.
    Clean,
    /// The contact law of the worn device with a terminal sensor.
    Contact {
        /// Motion of the plant.
        motion: &'static str,
        /// Flights left out.
        gated: bool,
    },
    /// Inertance and friction with white noise that no kernel has touched.
    White,
    /// Inertance and friction with their intervals.
    Interval {
        /// Motion of the plant.
        motion: &'static str,
        /// Only every [`THIN`]th update.
        thinned: bool,
    },
    /// The inertance through a change.
    Change {
        /// Memory \[s\].
        memory_s: f64,
    },
    /// Inertance at 0.053 Hz.
    Slow {
        /// Length of the run \[s\].
        duration_s: f64,
        /// Sticking left out.
        gated: bool,
    },
}

/// One run of one question.
pub struct Case {
    /// What is asked.
    pub question: Question,
    /// Input of a method.
    pub updates: Vec<Update>,
    /// Forgetting per update.
    pub forgetting: f64,
    /// Time of the first update \[s\].
    pub start_s: f64,
}

/// Result of a method.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// At the end.
    pub parameters: [f64; 4],
    /// Variances for a residual of unit variance.
    pub variances: Option<[f64; 4]>,
    /// The first parameter after every [`TRACK`]th update, if the question is a change.
    pub track: Vec<f64>,
}

impl Case {
    fn new(question: Question, updates: Vec<Update>) -> Self {
        Self { question, updates, forgetting: 1.0, start_s: 0.0 }
    }

    /// Whether the course of the run matters, not only its end.
    pub fn is_tracked(&self) -> bool {
        matches!(self.question, Question::Change { .. })
    }

    /// What a method is told beforehand.
    pub fn tuning(&self) -> Tuning {
        Tuning::of(&self.updates, self.forgetting)
    }

    /// Runs a method through it.
    pub fn drive(&self, mut method: Box<dyn Method>) -> Outcome {
        let mut track = Vec::new();
        for (n, update) in self.updates.iter().enumerate() {
            method.update(update);
            if self.is_tracked() && n % TRACK == 0 {
                track.push(method.parameters()[0]);
            }
        }
        Outcome { parameters: method.parameters(), variances: method.variances(), track }
    }

    /// Half widths of the 95 % intervals that follow from a covariance: `1.96 sqrt(s^2 P_ii)`, `s^2` the variance of
    /// the residual.
    pub fn half_widths(&self, outcome: &Outcome) -> Option<[f64; 4]> {
        let variances = outcome.variances?;
        let squares: f64 = self.updates.iter().map(|update| update.left(outcome.parameters).powi(2)).sum();
        let variance = squares / (self.updates.len() as f64 - 4.0);
        Some(variances.map(|one| 1.96 * (one * variance).sqrt()))
    }
}

/// The device of the questions: the paper's without its structure mass.
pub fn device() -> Inerter {
    Inerter { structure_mass_kg: 0.0, ..Inerter::paper() }
}

/// The same after wear.
pub fn worn() -> Inerter {
    Inerter { backlash_m: BACKLASH_M, ..device() }
}

/// Instruments of a run.
pub fn sensors(seed: u64) -> Sensors {
    Sensors {
        sample_rate_hz: RATE_HZ,
        force_noise_n: 1.0,
        force_offset_n: OFFSET_N,
        encoder_phase_count: (seed as f64 * 0.618) % 1.0,
        terminal_noise_m: 1e-6,
        seed,
        ..Sensors::default()
    }
}

/// Samples of a device in motion, which becomes another device as `later` says.
pub fn record(
    device: Inerter,
    later: Vec<(f64, Inerter)>,
    motion: &str,
    seed: u64,
    duration_s: f64,
) -> Result<Vec<Sample>, Box<dyn Error>> {
    let plant = Plant::changing(device, later, Excitation::parse(motion, seed)?)?;
    Ok(Simulation::of(plant, sensors(seed))?.lasting(duration_s).collect())
}

/// The samples in which the inertance changes.
pub fn changing_record(seed: u64) -> Result<Vec<Sample>, Box<dyn Error>> {
    let after = Inerter { inertance_kg: CHANGE * device().inertance_kg, ..device() };
    record(device(), vec![(CHANGE_S, after)], "mid", seed, DURATION_S)
}

/// All cases, in a fixed order.
pub fn all() -> Result<Vec<Case>, Box<dyn Error>> {
    let mut cases = vec![Case::new(Question::Clean, clean())];
    for motion in ["mid", "random"] {
        for seed in 1..=SEEDS {
            let samples = record(worn(), Vec::new(), motion, seed, DURATION_S)?;
            for gated in [false, true] {
                cases.push(Case::new(Question::Contact { motion, gated }, contact_law(&samples, gated)));
            }
        }
    }
    for seed in 1..=INTERVAL_SEEDS {
        cases.push(Case::new(Question::White, white(seed)));
        for motion in ["random", "mid"] {
            let samples = record(device(), Vec::new(), motion, seed, DURATION_S)?;
            let updates = motion_law(&samples, MOTION_BOX, true);
            let thin = updates.iter().copied().step_by(THIN).collect();
            cases.push(Case::new(Question::Interval { motion, thinned: false }, updates));
            cases.push(Case::new(Question::Interval { motion, thinned: true }, thin));
        }
    }
    for seed in 1..=SEEDS {
        let updates = motion_law(&changing_record(seed)?, MOTION_BOX, false);
        let start_s = (Kernels::new(MOTION_BOX, RATE_HZ).span - 1) as f64 / RATE_HZ;
        for memory_s in MEMORIES_S {
            let forgetting = 1.0 - 1.0 / (memory_s * RATE_HZ);
            let updates = updates.clone();
            cases.push(Case { question: Question::Change { memory_s }, updates, forgetting, start_s });
        }
    }
    for seed in 1..=SEEDS {
        let samples = record(device(), Vec::new(), "slow", seed, SLOW_S[1])?;
        for duration_s in SLOW_S {
            let samples = &samples[..(duration_s * RATE_HZ) as usize];
            for gated in [false, true] {
                let updates = motion_law(samples, SLOW_BOX, gated).into_iter().step_by(SLOW_STEP).collect();
                cases.push(Case::new(Question::Slow { duration_s, gated }, updates));
            }
        }
    }
    Ok(cases)
}

/// `x1 - x2 = F/ks - (cs/ks^2) F' + chi eps/2 + c`, exactly.
fn clean() -> Vec<Update> {
    (0..4000)
        .map(|n| {
            let t_s = f64::from(n) / RATE_HZ;
            let tones = [(800.0, TAU * 3.2), (300.0, TAU * 7.3)];
            let force_n: f64 = tones.iter().map(|(newton, w)| newton * (w * t_s).sin()).sum();
            let rate: f64 = tones.iter().map(|(newton, w)| newton * w * (w * t_s).cos()).sum();
            exact([force_n / FORCE_UNIT_N, rate / FORCE_RATE_UNIT_N_PER_S, force_n.signum(), 1.0], CLEAN_TRUTH, 0.0)
        })
        .collect()
}

/// The law of inertance and friction with noise of 1 N in each update, independent of all others.
fn white(seed: u64) -> Vec<Update> {
    let mut noise = Noise(0x9e37_79b9_7f4a_7c15_u64.wrapping_mul(2 * seed + 1));
    // A generator whose seed has few ones needs some steps first.
    (0..20).for_each(|_| _ = noise.next());
    (0..2000)
        .map(|n| {
            let t_s = f64::from(n) / RATE_HZ;
            let tones = [(2e-3, TAU * 3.2), (1e-3, TAU * 6.7)];
            let v: f64 = tones.iter().map(|(metre, w)| metre * w * (w * t_s).cos()).sum();
            let a: f64 = tones.iter().map(|(metre, w)| -metre * w * w * (w * t_s).sin()).sum();
            exact([a, v, v.signum(), 1.0], WHITE_TRUTH, noise.normal())
        })
        .collect()
}

fn exact(phi: [f64; 4], truth: [f64; 4], noise: f64) -> Update {
    let target = phi.iter().zip(truth).map(|(x, y)| x * y).sum::<f64>() + noise;
    Update { phi, target, moving: true }
}

/// Regressors `[F, F', s, 1]` and `x1 - x2` of a record; with the gate only where no kernel reaches within
/// [`CLEARANCE`] of a flight.
fn contact_law(samples: &[Sample], gated: bool) -> Vec<Update> {
    let sensors = sensors(0);
    let kernels = Kernels::new(CONTACT_BOX, RATE_HZ);
    // The offset is tared before the run.
    let forces = forces_n(samples);
    let apart_um: Vec<f64> = positions_m(samples)
        .iter()
        .zip(samples)
        .map(|(x2_m, sample)| 1e6 * (f64::from(sample.terminal_code) * sensors.metres_per_terminal_code - x2_m))
        .collect();
    // The sign of the force identifies the flank that it presses on.
    let signs: Vec<f64> = forces.iter().map(|force| force.signum()).collect();
    let flanks: Vec<Flank> = samples.iter().map(|sample| sample.truth.contact).collect();
    let reach = kernels.span / 2 + CLEARANCE;
    (0..=samples.len() - kernels.span)
        .filter(|start| {
            let middle = start + kernels.span / 2;
            let around = &flanks[middle.saturating_sub(reach)..(middle + reach + 1).min(flanks.len())];
            // A flight may be shorter than a sample: then the flank changes between two.
            !gated || around.iter().all(|flank| *flank != Flank::Flight && *flank == flanks[middle])
        })
        .map(|start| Update {
            phi: [
                kernels.value.pass(&forces, start) / FORCE_UNIT_N,
                kernels.slope.pass(&forces, start) / FORCE_RATE_UNIT_N_PER_S,
                kernels.value.pass(&signs, start),
                1.0,
            ],
            target: kernels.value.pass(&apart_um, start),
            moving: true,
        })
        .collect()
}

/// Regressors `[a, v, s, 1]` and the force of a record; with the gate only where no sticking is under the kernel.
fn motion_law(samples: &[Sample], length: usize, gated: bool) -> Vec<Update> {
    let kernels = Kernels::new(length, RATE_HZ);
    let positions = positions_m(samples);
    let forces: Vec<f64> = forces_n(samples).iter().map(|force| force + OFFSET_N).collect();
    let signs = signs(samples);
    (0..=samples.len() - kernels.span)
        .filter(|start| {
            !gated || samples[*start..start + kernels.span].iter().all(|sample| sample.truth.motion != Motion::Stuck)
        })
        .map(|start| Update {
            phi: [
                kernels.curvature.pass(&positions, start),
                kernels.slope.pass(&positions, start),
                kernels.average.pass(&signs, start),
                1.0,
            ],
            target: kernels.value.pass(&forces, start),
            moving: true,
        })
        .collect()
}

/// The true sign of the velocity, averaged over each sample.
fn signs(samples: &[Sample]) -> Vec<f64> {
    let sign = |v: f64| if v == 0.0 { 0.0 } else { v.signum() };
    // Averages over the halves of the time between two samples. The acceleration jumps where the velocity turns; the
    // moment of that follows from the first sample.
    let halves: Vec<[f64; 2]> = samples
        .windows(2)
        .map(|pair| {
            let [from, to] = [&pair[0].truth, &pair[1].truth];
            let turns = from.v2_m_per_s * to.v2_m_per_s < 0.0;
            let turn = if turns { (-from.v2_m_per_s / from.a2_m_per_s2 * RATE_HZ).clamp(0.0, 1.0) } else { 0.5 };
            let [before, after] = [sign(from.v2_m_per_s), sign(to.v2_m_per_s)];
            let mean = |part: f64| before * part + after * (1.0 - part);
            [mean((2.0 * turn).min(1.0)), mean((2.0 * turn - 1.0).max(0.0))]
        })
        .collect();
    let inner = halves.windows(2).map(|pair| 0.5 * (pair[0][1] + pair[1][0]));
    let ends = |halves: Option<&[f64; 2]>, place: usize| halves.map_or(0.0, |halves| halves[place]);
    std::iter::once(ends(halves.first(), 0)).chain(inner).chain([ends(halves.last(), 1)]).collect()
}

fn positions_m(samples: &[Sample]) -> Vec<f64> {
    let scale = sensors(0).metres_per_sample_count();
    samples.iter().map(|sample| f64::from(sample.position_count) * scale).collect()
}

/// Without the offset.
fn forces_n(samples: &[Sample]) -> Vec<f64> {
    let scale = sensors(0).newtons_per_sample_code();
    samples.iter().map(|sample| f64::from(sample.force_code) * scale - OFFSET_N).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without noise, and with a fine encoder, the regressors obey the law within a thirtieth of the noise.
    #[test]
    fn regressors_obey_the_law() {
        let fine = Sensors { metres_per_count: 1e-8, force_noise_n: 0.0, ..sensors(1) };
        for motion in ["mid", "random"] {
            let plant = Plant::new(device(), Excitation::parse(motion, 1).unwrap()).unwrap();
            let samples: Vec<Sample> = Simulation::of(plant, fine).unwrap().lasting(5.0).collect();
            // Read by the scale of the coarse encoder.
            let scale = fine.metres_per_count / sensors(0).metres_per_count;
            let device = Inerter { inertance_kg: scale * device().inertance_kg, ..device() };
            let updates = motion_law(&samples, MOTION_BOX, true);
            let law = [device.inertance_kg, scale * device.viscous_n_s_per_m, device.coulomb_n, OFFSET_N];
            let squares: f64 = updates.iter().map(|update| update.left(law).powi(2)).sum();
            let rms = (squares / updates.len() as f64).sqrt();
            assert!(updates.len() > 4500 && rms < 0.03, "{motion}: {rms} N, {}", updates.len());
        }
    }
}
