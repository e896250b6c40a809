//! What is left of a skew once one is undone, with its interval, which is made of
//! - the scatter of what the stretches of the run say, as short as the kernel and as long as a twentieth of the run; what comes
//!   again with the motion does not scatter, and counts as often as it comes;
//! - the encoder's steps, which take from the inertance and so shift the skew (docs/THEORY.md, 6);
//! - friction: all that moves the skew when friction of a shape is taken in, and what too little to be taken in moves it by
//!   beyond chance;
//! - what neither noise and steps nor friction explain;
//! - the sampling.

use inerter_core::{MOST_REPEATS, Settings, constants};
use inerter_data::{replay::Outcome, series::Series};
use statrs::distribution::{ContinuousCDF, StudentsT};

use super::{
    friction::{reach, taken},
    rows::{Friction, Rows},
    squares::{Squares, dot},
};
use crate::{
    calibrate::together,
    fit::FitError,
    law::{LEAST_OBSERVATIONS, Law, mean},
};

/// Part of what neither noise and steps nor friction explain that may be alike to the force's rate: 0.17 is seen with
/// impacts of a worn screw.
const ALIKE: f64 = 0.2;
/// Part of a sample period by which signs and kernels may be off, and the skew by them: 2 us at 500 Hz.
const SAMPLING: f64 = 1e-3;
/// Stretches of a run by which slow changes are seen, and observations of the shortest ones.
const LONG_STRETCHES: usize = 20;
const SHORT_OBSERVATIONS: f64 = 3.0;
/// Part of what the others leave of the acceleration that may be the encoder's steps.
const MOST_STEPS: f64 = 0.5;

/// What is left with a skew undone.
#[derive(Clone, Copy, Debug)]
pub(super) struct Round {
    /// Delay that is left \[s\].
    pub left_s: f64,
    /// Half width of its 95 % interval \[s\].
    pub u95_s: f64,
    /// Part of the square of the force's rate that all else leaves over.
    pub left: f64,
    /// Part of that which is noise.
    pub noise: f64,
    /// What is left unexplained \[N\].
    pub residual_rms_n: f64,
    /// Force without its mean \[N\].
    pub force_rms_n: f64,
    /// Frequency of the force, weighted by its square \[rad/s\].
    pub frequency: f64,
}

impl Round {
    /// Of a run that the estimator took with these settings.
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
        // Friction may turn too early or too late.
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
        // Square of what all else leaves over of the force's rate, of which a cubic B-spline passes 2/3 of noise in its
        // box's rate, where it passes 151/315 of the noise itself.
        let alone = squares.inverse[(place, place)].recip();
        let box_s = rows.box_s();
        let noise = count * residual_square * (2.0 / 3.0) / constants::BOXES_VARIANCE / box_s.powi(2) / alone;

        // What the steps take of the inertance, as noise in a regressor does, is given back by half, or by what sums
        // keep of it.
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
        // Noise in the rate takes from what it says.
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

/// Half width of the 95 % interval of a sum, by the scatter of its stretches of so many parts.
fn half_width(parts: &[f64], length: usize) -> f64 {
    let sums: Vec<f64> = parts.chunks(length).map(|stretch| stretch.iter().sum()).collect();
    let count = sums.len() as f64;
    let mean = mean(&sums);
    let square = sums.iter().map(|sum| (sum - mean).powi(2)).sum::<f64>() * count / (count - 1.0);
    let student = StudentsT::new(0.0, 1.0, count - 1.0).map_or(f64::INFINITY, |student| student.inverse_cdf(0.975));
    student * square.sqrt()
}
