//! Whether a motion reveals a fault at all, from the plant's true values and independent of any search for causes.
//!
//! The force that a fault adds is known, and so are the regressors of the law. A least-squares fit gives the fraction
//! of its square that the law cannot explain while the screw moves. The columns then pass a filter that whitens force
//! noise and encoder steps together. The same fit then gives the size of the fault in standard deviations, for an
//! estimator that knows everything except that size.

use inerter_analysis::diagnose::Kind;
use inerter_core::constants::REST_WINDOW_S;
use inerter_plant::{Motion as Screw, Sensors, Truth};
use std::{f64::consts::TAU, iter::once};

use crate::{
    diagnose::{Case, WITHIN},
    grid::{Motion, Result, mean},
    updates::{fit, left},
};

/// Time after rest during which the filter still remembers it \[s\].
const MEMORY_S: f64 = 0.1;
/// Minimum fraction of the added force that the law must leave unexplained.
const LEAST_LEFT: f64 = 0.005;
/// Size in standard deviations that can be estimated to 10 % in 95 % of the runs.
const LEAST_SIGMAS: f64 = 19.6;

/// How well a motion reveals a fault.
#[derive(Clone, Copy, Debug)]
pub struct Told {
    /// Fraction of the square of the added force that the law leaves unexplained.
    pub left: f64,
    /// Its size in standard deviations of the best estimate.
    pub sigmas: f64,
}

impl Told {
    /// Whether its size can be estimated to 10 %.
    pub fn is_enough(&self) -> bool {
        self.left >= LEAST_LEFT && self.sigmas >= LEAST_SIGMAS
    }
}

impl Case {
    /// How well a motion reveals this fault, if the encoder's steps repeat this often.
    pub fn told_by(&self, motion: &Motion, seed: u64, repeats: f64) -> Result<Told> {
        let rate_hz = self.sensors.sample_rate_hz;
        let truths = self.truths(motion, seed)?;
        let means = |values: Vec<f64>| -> Vec<f64> {
            values.chunks(WITHIN).map(|within| mean(within.iter().copied())).collect()
        };
        let of = |value: fn(&Truth) -> f64| means(truths.iter().map(value).collect());
        let mut columns = [
            of(|truth| truth.a2_m_per_s2),
            of(|truth| truth.v2_m_per_s),
            of(|truth| truth.v2_m_per_s.signum()),
            of(|_| 1.0),
            means(self.adds(&truths, rate_hz * WITHIN as f64, motion.duration_s)),
        ];
        let stands = of(|truth| f64::from(u8::from(truth.motion == Screw::Stuck)));
        let (left, all) = left_over(&columns, &moving(&stands, REST_WINDOW_S * rate_hz));
        let step_n = self.device.inertance_kg * self.sensors.metres_per_count / 12_f64.sqrt() * repeats.sqrt();
        let alike_hz = (self.sensors.force_noise_n / step_n).sqrt() / TAU;
        columns.iter_mut().for_each(|column| whiten(column, alike_hz / rate_hz));
        let (told, _) = left_over(&columns, &moving(&stands, MEMORY_S * rate_hz));
        Ok(Told { left: left / all, sigmas: told.sqrt() / self.sensors.force_noise_n })
    }

    /// The force that the fault adds to the law \[N\].
    fn adds(&self, truths: &[Truth], rate_hz: f64, duration_s: f64) -> Vec<f64> {
        let device = &self.device;
        let cell_n = |truth: &Truth| truth.force_n + device.structure_mass_kg * truth.a1_m_per_s2;
        let each = |value: &dyn Fn(&Truth) -> f64| truths.iter().map(value).collect();
        match self.kind {
            Some(Kind::Skew) => {
                let late = (self.sensors.delay_s * rate_hz).round() as usize;
                let before = truths.iter().cycle().skip(truths.len() - late.min(truths.len()));
                truths.iter().zip(before).map(|(now, before)| cell_n(before) - cell_n(now)).collect()
            }
            Some(Kind::EncoderError) => {
                let Sensors { encoder_eccentricity_m, encoder_eccentricity_phase_rad: phase, lead_m, .. } =
                    self.sensors;
                let wobble = |truth: &Truth| encoder_eccentricity_m * (TAU * truth.x2_m / lead_m + phase).sin();
                let off: Vec<f64> = truths.iter().map(wobble).collect();
                let inner = off.windows(3).map(|off| {
                    let rate = (off[2] - off[0]) / 2.0 * rate_hz;
                    let second = (off[2] - 2.0 * off[1] + off[0]) * rate_hz * rate_hz;
                    let mass_kg = device.inertance_kg + device.structure_mass_kg;
                    -mass_kg * second - device.viscous_n_s_per_m * rate
                });
                once(0.0).chain(inner).chain([0.0]).collect()
            }
            Some(Kind::Stribeck | Kind::Presliding) => {
                each(&|truth| truth.friction_n - device.coulomb_n * truth.v2_m_per_s.signum())
            }
            Some(Kind::Direction) => {
                each(&|truth| device.viscous_asymmetry * device.viscous_n_s_per_m * truth.v2_m_per_s.abs())
            }
            _ => each(&|truth| {
                let time = truth.t_s / duration_s - 0.5;
                self.added.at_n(cell_n(truth), truth, time, self.sensors.lead_m) + self.added.drift_n * time
            }),
        }
    }
}

/// Samples whose distance from rest exceeds this \[samples\].
fn moving(stands: &[f64], clearance: f64) -> Vec<bool> {
    let clearance = clearance.ceil() as usize;
    let mut moving = vec![true; stands.len()];
    for (at, _) in stands.iter().enumerate().filter(|(_, stands)| **stands > 0.0) {
        moving.iter_mut().skip(at.saturating_sub(clearance)).take(2 * clearance + 1).for_each(|moves| *moves = false);
    }
    // The filter starts without history.
    moving.iter_mut().take(clearance).for_each(|moves| *moves = false);
    moving
}

/// Sum of squares of the fifth column after a fit of the first four, and of the fifth column itself.
fn left_over(columns: &[Vec<f64>; 5], counts: &[bool]) -> (f64, f64) {
    let rows = || (0..counts.len()).filter(|row| counts[*row]).map(|row| columns.each_ref().map(|column| column[row]));
    let all = rows().map(|[.., added]| added * added).sum();
    let Some(values) = fit(rows(), 1e-12) else { return (0.0, all) };
    (rows().map(|row| left(&values, &row).powi(2)).sum(), all)
}

/// Second-order Butterworth low-pass with the gain `1 / sqrt(1 + (f / f0)^4)`. It has the same phase for all columns.
fn whiten(column: &mut [f64], alike: f64) {
    let w = (std::f64::consts::PI * alike).tan();
    let norm = 1.0 / (1.0 + std::f64::consts::SQRT_2 * w + w * w);
    let (b, a1, a2) = (w * w * norm, 2.0 * (w * w - 1.0) * norm, (1.0 - std::f64::consts::SQRT_2 * w + w * w) * norm);
    let (mut x, mut y) = ([0.0; 2], [0.0; 2]);
    for value in column {
        let now = b * (*value + 2.0 * x[0] + x[1]) - a1 * y[0] - a2 * y[1];
        (x, y) = ([*value, x[0]], [now, y[0]]);
        *value = now;
    }
}

#[cfg(test)]
mod tests {
    use crate::{
        diagnose::case,
        grid::{MOTIONS, motion},
    };

    /// Cases with a known answer: load-dependent friction in a slow tone, which is only friction; a late force in a
    /// fast tone, of which the law explains all but the harmonics; a drift of the offset; a force once per turn.
    #[test]
    fn a_motion_tells_what_it_tells() {
        let told = |fault: &str, name: &str| case(fault).told_by(motion(name), 1, 1.0).unwrap();
        assert!(told("friction of 4 % of the load", "slow").left < 1e-4);
        assert!(told("force 3 ms late", "fast").left < 1e-3);
        let drift = told("offset drifts by 5 N", "random");
        // A slope of 5 N over 20 s, in noise of 1 N at 1 kHz.
        let exact = 5.0 * (20_000.0_f64 / 12.0).sqrt();
        assert!(drift.left > 0.99 && (drift.sigmas / exact - 1.0).abs() < 0.05, "{drift:?} {exact}");
        assert!(told("ripple of 10 N", "two").is_enough() && !told("cf +-40 % by direction", "slow").is_enough());
        // Repeated encoder steps do not average out.
        let once = told("cf +-40 % by direction", "mid").sigmas;
        assert!(case("cf +-40 % by direction").told_by(&MOTIONS[1], 1, 32.0).unwrap().sigmas < 0.7 * once);
    }
}
