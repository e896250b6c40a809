//! The expected device, and a simulation of what the estimator would see in a motion on this rig.

use inerter_core::{Bank, RawSample, Settings};
use inerter_data::replay::{Outcome, Replay};
use inerter_plant::{Excitation, Inerter, Sample, Sensors, Simulation};

use super::{error::PlanError, peaks::Peaks, speeds::Speeds};
use crate::fit::Products;

/// The golden ratio's fractional part: phases at multiples of it fill a count evenly.
pub(super) const GOLDEN: f64 = 0.618_033_988_749_895;

/// An expected device, on a rig with known settings and noise.
#[derive(Clone, Copy, Debug)]
pub struct Expected {
    /// The device.
    pub device: Inerter,
    /// Settings of the estimator: scales, rate and their uncertainties.
    pub settings: Settings,
    /// White noise of the force in one sample, rms \[N\].
    pub force_noise_n: f64,
}

/// The result of a simulation.
#[derive(Clone, Debug)]
pub(super) struct Seen {
    /// Its sums, of the fast and of the slow bank.
    pub products: [Products; 2],
    /// The same by speed, if requested.
    pub speeds: [Speeds; 2],
    /// The estimator's outcome.
    pub outcome: Outcome,
    /// Peaks of displacement, speed and force.
    pub peaks: Peaks,
}

impl Expected {
    /// The law's parameters: inertance with the structure \[kg\], viscous friction \[N s/m\], Coulomb friction and
    /// offset \[N\].
    pub fn law(&self) -> [f64; 4] {
        let Inerter { inertance_kg, viscous_n_s_per_m, coulomb_n, constant_force_n, .. } = self.device;
        [inertance_kg + self.settings.structure_mass_kg, viscous_n_s_per_m, coulomb_n, 0.0 - constant_force_n]
    }

    /// The same for the device alone: the inertance without the structure.
    pub(super) fn own(&self) -> [f64; 4] {
        let [mt, cf, fc, offset] = self.law();
        [mt - self.settings.structure_mass_kg, cf, fc, offset]
    }

    /// The rig's instruments with their noise; each seed gives other noise and another encoder phase.
    pub fn sensors(&self, seed: u64) -> Sensors {
        let reading = self.at_once().settings;
        Sensors {
            sample_rate_hz: reading.sample_rate_hz,
            oversampling: self.settings.oversampling,
            metres_per_count: reading.metres_per_count,
            encoder_phase_count: (seed as f64 * GOLDEN).fract(),
            newtons_per_code: reading.newtons_per_code,
            force_zero_code: reading.force_zero_code,
            force_min_code: reading.force_min_code,
            force_max_code: reading.force_max_code,
            force_noise_n: self.force_noise_n,
            delay_s: reading.skew_s,
            metres_per_terminal_code: reading.metres_per_terminal_code,
            seed,
            ..Sensors::default()
        }
    }

    /// The same with one reading per sample, which differs from many readings only by their rounding.
    fn at_once(&self) -> Self {
        let Settings { oversampling, .. } = self.settings;
        let code = |code: f64| (code / oversampling).trunc();
        let settings = Settings {
            oversampling: 1.0,
            newtons_per_code: self.settings.newtons_per_code * oversampling,
            force_zero_code: code(self.settings.force_zero_code),
            force_min_code: code(self.settings.force_min_code),
            force_max_code: code(self.settings.force_max_code),
            ..self.settings
        };
        Self { settings, ..*self }
    }

    /// The same for a quick simulation, which takes one reading per sample.
    pub(super) fn quick(&self) -> Self {
        if self.settings.oversampling > 1.0 { self.at_once() } else { *self }
    }

    /// Simulates the motion of the expected device for this long \[s\] and runs it through the estimator; the seed is
    /// that of the noise, and of the encoder's phase within a count. With a time \[s\] the sums count from then on, and
    /// are also kept by speed.
    pub(super) fn see(
        &self,
        motion: &Excitation,
        duration_s: f64,
        seed: u64,
        from_s: Option<f64>,
    ) -> Result<Seen, PlanError> {
        let simulation = Simulation::new(self.device, motion.clone(), self.sensors(seed))?;
        let mut replay = Replay::new(&self.settings, 0.0)?;
        let (mut before, mut peaks, mut speeds) = (None, Peaks::default(), [Speeds::default(), Speeds::default()]);
        let mut last = [None; 2];
        for sample in simulation.lasting(duration_s) {
            if before.is_none() && sample.t_s >= from_s.unwrap_or(0.0) {
                before = Some(products(&replay));
            }
            peaks.take(&sample.truth, self.device.structure_mass_kg);
            replay.step(&raw(&sample)).for_each(drop);
            if from_s.is_some() && before.is_some() {
                for ((last, now), speeds) in last.iter_mut().zip(products(&replay)).zip(&mut speeds) {
                    let update = now.zip(*last).map(|(now, last): (Products, Products)| now.since(&last));
                    update.filter(|update| update.updates() == 1.0).iter().for_each(|update| speeds.push(update));
                    *last = now;
                }
            }
        }
        let after = products(&replay);
        let since = |bank: usize| {
            let (after, before) = (after[bank]?, before?[bank]);
            Some(before.map_or(after, |before| after.since(&before)))
        };
        let [Some(fast), Some(slow)] = [since(0), since(1)] else {
            return Err(PlanError::Nothing { why: "the motion is too short".into() });
        };
        Ok(Seen { products: [fast, slow], speeds, outcome: replay.outcome(), peaks })
    }
}

/// The current sums of both banks, the fast one first.
fn products(replay: &Replay) -> [Option<Products>; 2] {
    [Bank::Fast, Bank::Slow].map(|bank| {
        let (sums, more) = replay.sums(bank);
        Products::of(&sums, &more).ok()
    })
}

/// The sample as a board hands it over.
fn raw(sample: &Sample) -> RawSample {
    RawSample {
        index: sample.index,
        position_count: sample.position_count,
        force_code: sample.force_code,
        terminal_code: sample.terminal_code,
    }
}
