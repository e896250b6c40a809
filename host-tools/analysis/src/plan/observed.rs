//! What a run shows about device and rig, for planning another motion.

use std::{collections::VecDeque, f64::consts::TAU};

use inerter_core::constants::{QUARTILES, ROUNDING};
use inerter_core::{BacklashSize, Interval, Parameter, RawSample, Settings};
use inerter_data::replay::Outcome;
use inerter_plant::Inerter;

use super::{error::PlanError, expected::Expected, limits::Limits};

/// Time over which a speed is measured \[s\]: half a box.
const SPEED_S: f64 = 0.008;
/// Maximum number of fourth differences: when full, every second one is removed.
const MOST_DIFFERENCES: usize = 4096;
/// Shortest and longest motion that is planned from a run \[s\].
const DURATION_S: (f64, f64) = (5.0, 60.0);
/// Natural frequency of a contact whose stiffness is unknown \[Hz\], and its damping ratio: stiff enough not to affect
/// the motion.
const RIGID: (f64, f64) = (100.0, 0.5);
/// Multiple of that frequency above which a contact is replaced by such a one.
const HARDEST: f64 = 2.0;

/// Peaks of displacement, speed and force in a run, sample by sample.
#[derive(Clone, Debug, Default)]
pub struct Reach {
    settings: Settings,
    /// The latest samples: index, and unwrapped count.
    latest: VecDeque<(u32, i64)>,
    counts: Option<(i64, i64)>,
    greatest_step: i64,
    codes: Option<(i32, i32)>,
    /// The latest force codes, oldest first.
    forces: VecDeque<i32>,
    /// Magnitudes of fourth differences of the force, thinned out.
    differences: Vec<f64>,
    stride: u64,
    samples: u64,
}

impl Reach {
    /// Empty, for these settings.
    pub fn new(settings: &Settings) -> Self {
        Self { settings: *settings, stride: 5, ..Self::default() }
    }

    /// Adds the next sample.
    pub fn push(&mut self, sample: &RawSample) {
        let before = self.latest.back().copied();
        let count = before.map_or(i64::from(sample.position_count), |(_, count)| {
            // Counts wrap, but the difference between two samples does not.
            count + i64::from(sample.position_count.wrapping_sub(count as i32))
        });
        if before.is_some_and(|(index, _)| sample.index != index.wrapping_add(1)) {
            self.latest.clear();
            self.forces.clear();
        }
        self.push_force(sample.force_code);
        self.latest.push_back((sample.index, count));
        if self.latest.len() > self.spacing() {
            let first = self.latest.pop_front();
            self.greatest_step = self.greatest_step.max(first.map_or(0, |(_, first)| (count - first).abs()));
        }
        self.counts = Some(wider(self.counts, count));
        self.codes = Some(wider(self.codes, sample.force_code));
    }

    /// Stores a fourth difference of the force now and then: motion hardly affects it.
    fn push_force(&mut self, code: i32) {
        self.forces.push_back(code);
        if self.forces.len() > 5 {
            self.forces.pop_front();
        }
        self.samples += 1;
        if self.forces.len() < 5 || !self.samples.is_multiple_of(self.stride) {
            return;
        }
        let weights = [1.0, -4.0, 6.0, -4.0, 1.0];
        let difference: f64 = self.forces.iter().zip(weights).map(|(code, weight)| f64::from(*code) * weight).sum();
        self.differences.push(difference.abs());
        if self.differences.len() >= MOST_DIFFERENCES {
            self.differences = self.differences.iter().copied().step_by(2).collect();
            self.stride *= 2;
        }
    }

    /// White noise of the force in a sample, rms \[N\].
    fn noise_n(&self) -> f64 {
        let mut differences = self.differences.clone();
        differences.sort_by(f64::total_cmp);
        let codes = differences.get(differences.len() / 4).map_or(0.0, |quartile| quartile / QUARTILES[0]);
        // A rehearsal adds rounding itself.
        (codes * codes - ROUNDING).max(0.0).sqrt() * self.settings.newtons_per_code.abs()
    }

    fn spacing(&self) -> usize {
        (SPEED_S * self.settings.sample_rate_hz).round().max(1.0) as usize
    }

    /// The limits that the run kept to, for a motion of the same length; the offset is not a force on the device.
    fn limits(&self, offset_n: f64, seconds: f64) -> Limits {
        let Settings { metres_per_count, oversampling, newtons_per_code, force_zero_code, sample_rate_hz, .. } =
            self.settings;
        let metres = |counts: i64| counts as f64 * metres_per_count.abs() / oversampling;
        let (least, greatest) = self.counts.unwrap_or_default();
        let newtons = |code: i32| ((f64::from(code) - force_zero_code) * newtons_per_code - offset_n).abs();
        let (low, high) = self.codes.unwrap_or_default();
        Limits {
            stroke_m: 0.5 * metres(greatest - least),
            speed_m_per_s: metres(self.greatest_step) * sample_rate_hz / self.spacing() as f64,
            force_n: newtons(low).max(newtons(high)),
            duration_s: seconds.clamp(DURATION_S.0, DURATION_S.1),
            ..Limits::default()
        }
    }
}

/// The range extended by one value.
fn wider<T: Copy + Ord>(range: Option<(T, T)>, value: T) -> (T, T) {
    range.map_or((value, value), |(least, greatest)| (least.min(value), greatest.max(value)))
}

/// The device to expect from a run, its rig's noise, and the limits that the run kept to.
pub fn observed(outcome: &Outcome, settings: &Settings, reach: &Reach) -> Result<(Expected, Limits), PlanError> {
    let found = &outcome.estimate.whole_run;
    let Interval { value: inertance_kg, u95 } = found.inertance_kg.fitted();
    if !(inertance_kg > 0.0 && u95 < inertance_kg) {
        return Err(PlanError::Run);
    }
    let inertance_kg = f64::from(inertance_kg);
    let size = |parameter: &Parameter| f64::from(parameter.fitted().value).max(0.0);
    // A value smaller than its interval may be zero.
    let viscous = Some(&found.viscous_n_s_per_m).filter(|viscous| viscous.fitted().u95 < viscous.fitted().value);
    let offset_n = f64::from(found.offset_n.fitted().value);
    let backlash_m = match outcome.detail.backlash.size {
        BacklashSize::Ok(found) => f64::from(found.value).max(0.0),
        BacklashSize::BelowU95(_) | BacklashSize::NotIdentifiable(_) => 0.0,
    };
    let device = Inerter {
        inertance_kg,
        viscous_n_s_per_m: viscous.map_or(0.0, size),
        coulomb_n: size(&found.coulomb_n),
        backlash_m,
        structure_mass_kg: settings.structure_mass_kg,
        ..Inerter::paper()
    };
    let seen = outcome.detail.stiffness_n_per_m.usable().map(|found| f64::from(found.value));
    let stiffness = Some(settings.stiffness_n_per_m).filter(|stiffness| *stiffness > 0.0).or(seen);
    let device = with_contact(device, stiffness, settings.contact_damping_n_s_per_m);
    let seconds = outcome.estimate.elapsed_samples as f64 / settings.sample_rate_hz;
    Ok((Expected { device, settings: *settings, force_noise_n: reach.noise_n() }, reach.limits(offset_n, seconds)))
}

/// With a contact of this stiffness \[N/m\] and damping \[N s/m\]. If the stiffness is unknown, or so large that it
/// only slows the simulation, with one that is stiff enough not to affect the motion.
pub fn with_contact(device: Inerter, stiffness_n_per_m: Option<f64>, damping_n_s_per_m: f64) -> Inerter {
    let (own_hz, ratio) = RIGID;
    let rate = TAU * own_hz;
    let hardest_n_per_m = device.inertance_kg * (HARDEST * rate).powi(2);
    let known = stiffness_n_per_m.filter(|stiffness| *stiffness <= hardest_n_per_m || device.backlash_m > 0.0);
    let rigid = || (device.inertance_kg * rate * rate, 2.0 * ratio * rate * device.inertance_kg);
    let (stiffness_n_per_m, contact_damping_n_s_per_m) =
        known.map_or_else(rigid, |stiffness| (stiffness, damping_n_s_per_m));
    Inerter { stiffness_n_per_m, contact_damping_n_s_per_m, ..device }
}
