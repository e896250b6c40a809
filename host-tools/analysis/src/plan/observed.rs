//! What a run shows of device and rig, so that another motion can be planned from it.

use std::{collections::VecDeque, f64::consts::TAU};

use inerter_core::constants::{QUARTILES, ROUNDING};
use inerter_core::{BacklashSize, Interval, Parameter, RawSample, Settings};
use inerter_data::replay::Outcome;
use inerter_plant::Inerter;

use super::{error::PlanError, expected::Expected, limits::Limits};

/// Time over which a speed is told \[s\]: half a box.
const SPEED_S: f64 = 0.008;
/// Fourth differences that are kept: when there are more, every second one goes.
const MOST_DIFFERENCES: usize = 4096;
/// Shortest and longest motion that is planned by a run \[s\].
const DURATION_S: (f64, f64) = (5.0, 60.0);
/// Own frequency of a contact whose stiffness is not known \[Hz\], and its damping ratio: hard enough to have no part
/// in the motion.
const RIGID: (f64, f64) = (100.0, 0.5);
/// Times that frequency from which on a contact is taken for such a one.
const HARDEST: f64 = 2.0;

/// How far, how fast and how hard a run went, taken sample by sample.
#[derive(Clone, Debug)]
pub struct Reach {
    settings: Settings,
    /// The latest samples: index, and counts that do not wrap.
    latest: VecDeque<(u32, i64)>,
    counts: Option<(i64, i64)>,
    greatest_step: i64,
    codes: Option<(i32, i32)>,
    /// The latest force codes, oldest first.
    forces: VecDeque<i32>,
    /// Magnitudes of fourth differences of the force, one every so many samples.
    differences: Vec<f64>,
    stride: u64,
    samples: u64,
}

impl Reach {
    /// Nothing yet.
    pub fn new(settings: &Settings) -> Self {
        Self {
            settings: *settings,
            latest: VecDeque::new(),
            counts: None,
            greatest_step: 0,
            codes: None,
            forces: VecDeque::new(),
            differences: Vec::new(),
            stride: 5,
            samples: 0,
        }
    }

    /// Takes the next sample.
    pub fn push(&mut self, sample: &RawSample) {
        let before = self.latest.back().copied();
        let count = before.map_or(i64::from(sample.position_count), |(_, count)| {
            // Counts wrap, and what is between two samples does not.
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

    /// Keeps a fourth difference of the force now and then: motion hardly has a part in it.
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
            let mut keeps = false;
            self.differences.retain(|_| {
                keeps = !keeps;
                keeps
            });
            self.stride *= 2;
        }
    }

    /// White noise of the force in a sample, rms \[N\].
    fn noise_n(&self) -> f64 {
        let mut differences = self.differences.clone();
        differences.sort_by(f64::total_cmp);
        let codes = differences.get(differences.len() / 4).map_or(0.0, |quartile| quartile / QUARTILES[0]);
        // Rounding is not what a rehearsal takes for noise.
        (codes * codes - ROUNDING).max(0.0).sqrt() * self.settings.newtons_per_code.abs()
    }

    fn spacing(&self) -> usize {
        (SPEED_S * self.settings.sample_rate_hz).round().max(1.0) as usize
    }

    /// Limits within which the run stayed, of a motion that lasts as long; the offset is no force on the device.
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

/// The least and the greatest so far, with one more.
fn wider<T: Copy + Ord>(range: Option<(T, T)>, value: T) -> (T, T) {
    range.map_or((value, value), |(least, greatest)| (least.min(value), greatest.max(value)))
}

/// The device that a run makes one expect, its rig's noise, and the limits within which it stayed.
pub fn observed(outcome: &Outcome, settings: &Settings, reach: &Reach) -> Result<(Expected, Limits), PlanError> {
    let found = &outcome.estimate.whole_run;
    let Interval { value: inertance_kg, u95 } = found.inertance_kg.fitted();
    if !(inertance_kg > 0.0 && u95 < inertance_kg) {
        return Err(PlanError::Run { why: "its inertance is not known" });
    }
    let inertance_kg = f64::from(inertance_kg);
    let size = |parameter: &Parameter| f64::from(parameter.fitted().value).max(0.0);
    // Less than its interval may as well be none.
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
    let device = with_contact(device, stiffness, Some(settings.contact_damping_n_s_per_m));
    let seconds = outcome.estimate.elapsed_samples as f64 / settings.sample_rate_hz;
    Ok((Expected { device, settings: *settings, force_noise_n: reach.noise_n() }, reach.limits(offset_n, seconds)))
}

/// With a contact of this stiffness \[N/m\] and damping \[N s/m\]. Where the stiffness is not known, or so great that
/// it only makes the simulation slow, with one that is hard enough to have no part in the motion.
pub fn with_contact(device: Inerter, stiffness_n_per_m: Option<f64>, damping_n_s_per_m: Option<f64>) -> Inerter {
    let (own_hz, ratio) = RIGID;
    let rate = TAU * own_hz;
    let hardest_n_per_m = device.inertance_kg * (HARDEST * rate).powi(2);
    match stiffness_n_per_m.filter(|stiffness| *stiffness <= hardest_n_per_m || device.backlash_m > 0.0) {
        Some(stiffness_n_per_m) => {
            Inerter { stiffness_n_per_m, contact_damping_n_s_per_m: damping_n_s_per_m.unwrap_or_default(), ..device }
        }
        None => Inerter {
            stiffness_n_per_m: device.inertance_kg * rate * rate,
            contact_damping_n_s_per_m: 2.0 * ratio * rate * device.inertance_kg,
            ..device
        },
    }
}
