//! The remaining skew after a correction, with its interval. The components of the interval are
//! - the scatter between the stretches of the run, from the length of the kernel to a twentieth of the run; errors that
//!   repeat with the motion do not scatter, and count as often as they occur;
//! - the encoder's steps, which attenuate the inertance and so shift the skew (docs/THEORY.md, 6);
//! - friction: every shift of the skew when further friction is included, and the shift beyond chance by friction too
//!   small to be included;
//! - the residual that neither noise and steps nor friction explain;
//! - the sampling.

use inerter_core::{MOST_REPEATS, Settings, constants};
use inerter_data::{replay::Outcome, series::Series};
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::{
    friction::{reach, taken},
    rows::{Friction, Rows},
};
use crate::{
    calibrate::together,
    fit::FitError,
    law::{LEAST_OBSERVATIONS, Law, Squares, dot, mean},
};

/// Fraction of the residual that neither noise and steps nor friction explain that may correlate with the force's rate:
/// 0.17 was seen with impacts of a worn screw.
const ALIKE: f64 = 0.2;
/// Possible error of signs and kernels, and so of the skew, as a fraction of a sample period: 2 us at 500 Hz.
const SAMPLING: f64 = 1e-3;
/// Number of stretches of a run that show slow changes, and observations of the shortest ones.
const LONG_STRETCHES: usize = 20;
const SHORT_OBSERVATIONS: f64 = 3.0;
/// Maximum fraction of encoder steps in what the others leave of the acceleration.
const MOST_STEPS: f64 = 0.5;

/// The remainder after a correction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Round {
    /// Remaining delay \[s\].
    pub left_s: f64,
    /// Half width of its 95 % interval \[s\].
    pub u95_s: f64,
    /// Fraction of the square of the force's rate that the other terms leave.
    pub left: f64,
    /// Fraction of that which is noise.
    pub noise: f64,
    /// RMS residual \[N\].
    pub residual_rms_n: f64,
    /// Force without its mean \[N\].
    pub force_rms_n: f64,
    /// RMS frequency of the force, weighted by its power \[rad/s\].
    pub frequency: f64,
}

impl Round {
    /// For a run that the estimator processed with these settings.
    pub fn of(outcome: &Outcome, series: &Series, settings: &Settings) -> Result<Self, FitError> {
        let aligned = series.aligned(settings);
        let law = Law::of_run(&outcome.estimate.whole_run, settings);
        let rows = Rows::of(&aligned, settings, outcome.estimate.bank, law, 0);
        let observations = rows.observations();
        if observations < LEAST_OBSERVATIONS {
            return Err(FitError::TooShort { observations });
        }
        let late = rows.late();
        let place = rows.base.len();
        let known: Vec<Vec<f64>> = rows.base.iter().cloned().chain([late.clone()]).collect();
        let frictions = taken(&rows, &known).ok_or(FitError::Motion)?;
        let beside = |more: Vec<Vec<f64>>| {
            Squares::of(&rows.force, known.iter().cloned().chain(more).collect()).ok_or(FitError::Motion)
        };
        let columns = |of: &dyn Fn(&Friction) -> bool| -> Vec<Vec<f64>> {
            frictions.iter().filter(|friction| of(friction)).map(|friction| rows.friction(*friction)).collect()
        };
        // Friction may reverse too early or too late.
        let turn = rows.turn();
        let squares = beside(columns(&|_| true).into_iter().chain(turn.clone()).collect())?;
        let shape_s = if frictions.iter().any(Friction::is_shaped) {
            let without = beside(columns(&|friction| !friction.is_shaped()).into_iter().chain(turn).collect())?;
            squares.values[place] - without.values[place]
        } else {
            0.0
        };

        let count = rows.force.len() as f64;
        let (inertance_kg, residual_square) = (squares.values[0], squares.square());
        // Square of what the other terms leave of the force's rate. A cubic B-spline passes 2/3 of the noise in its
        // box's rate, and 151/315 of the noise itself.
        let alone = squares.inverse[(place, place)].recip();
        let box_s = rows.box_s();
        let noise = count * residual_square * (2.0 / 3.0) / constants::BOXES_VARIANCE / box_s.powi(2) / alone;

        // The attenuation of the inertance by the steps, as by any noise in a regressor, is corrected by half, or by
        // the part that sums retain.
        let kept = settings.oversampling.recip();
        let steps_square = settings.metres_per_count.powi(2) / 12.0 * (8.0 / 3.0) * series.period_s / box_s.powi(5);
        let taken_of = |i: usize| squares.inverse[(i, 0)] * steps_square * count;
        if taken_of(0) > MOST_STEPS {
            return Err(FitError::Motion);
        }
        let by_steps_s = inertance_kg * taken_of(place) / (1.0 - taken_of(0));

        let explained_square = outcome.law.misfit.map_or(residual_square, |misfit| {
            f64::from(outcome.estimate.residual_rms_n).powi(2) * f64::from(misfit.limit / misfit.ratio).powi(2)
        });
        let unexplained = (1.0 - explained_square / residual_square).max(0.0);
        let alike_s = ALIKE * (unexplained * residual_square * count / alone).sqrt();
        let steps = (inertance_kg.powi(2) * steps_square * kept / residual_square).min(1.0);
        let repeats = f64::from(outcome.motion.repeats);
        let again = 1.0 + steps * (repeats.min(MOST_REPEATS.into()) - 1.0) + unexplained * (repeats - 1.0);

        let weights = squares.weights(place);
        let says: Vec<f64> = weights.iter().zip(&squares.residual).map(|(weight, left)| weight * left).collect();
        let short = (SHORT_OBSERVATIONS * rows.per_observation).ceil() as usize;
        let long = says.len().div_ceil(LONG_STRETCHES).max(short);
        // Noise in the rate attenuates its coefficient.
        let told = (1.0 - noise).max(0.5);
        let scatter_s = (half_width(&says, short) * again.sqrt()).max(half_width(&says, long)) / told;
        let reach_s = reach(&rows, &squares, place, &frictions, again);

        let parts = [scatter_s, 0.5 * by_steps_s, shape_s, reach_s, alike_s, SAMPLING * series.period_s];
        let mean_n = mean(&rows.force);
        let force_rms_n = (dot(&rows.force, &rows.force) / count - mean_n * mean_n).max(0.0).sqrt();
        let rate_square = dot(&late, &late) / count;
        Ok(Self {
            left_s: squares.values[place] + by_steps_s * 0.5 * (1.0 + kept),
            u95_s: together(parts),
            left: alone / count / rate_square * (1.0 - noise),
            noise,
            residual_rms_n: residual_square.sqrt(),
            force_rms_n,
            frequency: rate_square.sqrt() / force_rms_n,
        })
    }
}

/// Half width of the 95 % interval of a sum, from the scatter of its stretches of `length` parts.
fn half_width(parts: &[f64], length: usize) -> f64 {
    let sums: Vec<f64> = parts.chunks(length).map(|stretch| stretch.iter().sum()).collect();
    let count = sums.len() as f64;
    let mean = mean(&sums);
    let square = sums.iter().map(|sum| (sum - mean).powi(2)).sum::<f64>() * count / (count - 1.0);
    let student = StudentsT::new(0.0, 1.0, count - 1.0).map_or(f64::INFINITY, |student| student.inverse_cdf(0.975));
    student * square.sqrt()
}
