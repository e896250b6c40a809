//! Predictions for motions, and the results of simulated runs.

use crate::{
    coverage::stated_true,
    grid::{Result, calibrated, each, errors, raw, seeded},
};
use inerter_analysis::plan::{Expected, Limits, Peaks};
use inerter_core::{Machine, Settings};
use inerter_data::{csv::motion, replay::Replay};
use inerter_plant::{Excitation, Inerter, Sensors, Simulation};

/// Maximum relative difference between a result and its prediction.
pub const WITHIN: f64 = 0.3;
/// Number of bisections when a motion is scaled to the limits.
const HALVINGS: u32 = 12;

/// A device on a rig that is perfect except for noise and encoder steps, with settings that state this.
#[derive(Clone, Copy, Debug)]
pub struct Bench {
    /// Name in the table.
    pub name: &'static str,
    /// The device.
    pub device: Inerter,
    /// The instruments; each run has its own noise and phase within a count.
    pub sensors: Sensors,
    /// Factor on the settings' full scales of velocity and acceleration.
    pub full_scale: f64,
    /// Kind of machine, for its units.
    pub machine: Machine,
}

/// Results of the runs of one motion for one parameter.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reached {
    /// Mean stated standard uncertainty from scatter.
    pub u_a: f64,
    /// Mean half width of the 95 % interval.
    pub u95: f64,
    /// Root mean square of the error.
    pub scatter: f64,
    /// Runs with a value.
    pub given: usize,
    /// Runs among these whose interval contains the true value.
    pub covered: usize,
}

impl Bench {
    /// The input of the plan: the true values.
    pub fn expected(&self) -> Expected {
        let settings = stated_true(calibrated(&self.device, &self.sensors));
        let settings = Settings {
            machine: self.machine,
            full_scale_velocity_m_per_s: self.full_scale * settings.full_scale_velocity_m_per_s,
            full_scale_acceleration_m_per_s2: self.full_scale * settings.full_scale_acceleration_m_per_s2,
            ..settings
        };
        Expected { device: self.device, settings, force_noise_n: self.sensors.force_noise_n }
    }

    /// Results for inertance, viscous and Coulomb friction over runs with seeds from `first` on.
    pub fn reached(&self, motion: &Excitation, duration_s: f64, first: u64, seeds: u64) -> Result<[Reached; 3]> {
        let settings = self.expected().settings;
        let runs = each(first..first + seeds, |seed| {
            let sensors = seeded(Sensors { force_offset_n: 0.02 * self.device.coulomb_n, ..self.sensors }, seed);
            let mut replay = Replay::new(&settings, 0.0)?;
            for sample in Simulation::new(self.device, motion.clone(), sensors)?.lasting(duration_s) {
                replay.step(&raw(&sample)).for_each(drop);
            }
            Ok(replay.outcome())
        })?;
        Ok(std::array::from_fn(|place| {
            let mut found = Reached::default();
            for run in &runs {
                let Some((error, u95)) = errors(&run.estimate.whole_run, &self.device)[place] else { continue };
                found.given += 1;
                found.covered += usize::from(error.abs() <= u95);
                found.u95 += u95;
                found.u_a += f64::from(run.budgets.whole_run[place].standard_error());
                found.scatter += error * error;
            }
            let count = found.given as f64;
            let scatter = (found.scatter / count).sqrt();
            Reached { u_a: found.u_a / count, u95: found.u95 / count, scatter, ..found }
        }))
    }

    /// A motion as large as the limits allow.
    pub fn enlarged(&self, motion: &Excitation, limits: &Limits) -> Result<Excitation> {
        let limits = limits.checked(&self.expected())?;
        let is_within = |factor: f64| -> Result<bool> {
            Ok(limits.room(&self.peaks(&motion.clone().scaled(factor), limits.duration_s)?) >= 1.0)
        };
        let (mut low, mut high) = (0.0, 1.0);
        while is_within(high)? && high < 1e3 {
            (low, high) = (high, 2.0 * high);
        }
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if is_within(middle)? { low = middle } else { high = middle }
        }
        Ok(motion.clone().scaled(low))
    }

    /// The motion's demands on the rig.
    pub fn peaks(&self, motion: &Excitation, duration_s: f64) -> Result<Peaks> {
        let mut peaks = Peaks::default();
        for sample in Simulation::new(self.device, motion.clone(), self.sensors)?.lasting(duration_s) {
            let truth = sample.truth;
            let force_n = truth.force_n + self.device.structure_mass_kg * truth.a1_m_per_s2;
            for (peak, value) in [
                (&mut peaks.stroke_m, truth.x1_m),
                (&mut peaks.speed_m_per_s, truth.v1_m_per_s),
                (&mut peaks.force_n, force_n),
            ] {
                *peak = peak.max(value.abs());
            }
        }
        Ok(peaks)
    }
}

/// A motion as a shaker receives it: written to a CSV at this rate and read again.
pub fn as_written(planned: &Excitation, rate_hz: f64) -> Result<Excitation> {
    let count = (planned.duration_s() * rate_hz).ceil() as u64;
    let points = (0..=count).map(|k| {
        let t_s = k as f64 / rate_hz;
        let at = planned.at(t_s);
        motion::Point { t_s, terminal_m: at.x_m, velocity_m_per_s: at.v_m_per_s, acceleration_m_per_s2: at.a_m_per_s2 }
    });
    let text = motion::text(Machine::Linear, &[], points);
    let read = motion::parse("the planned motion", text.as_bytes())?;
    Ok(Excitation::table(read.period_s, &read.terminal_m)?)
}
