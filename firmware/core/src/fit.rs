//! The law fitted to what a memory knows, with standard errors, in SI.
//!
//! Floats are allowed here, as everything is basic arithmetic that gives the same bits on every machine.

use crate::active::Scales;
use crate::bank::BankState;
use crate::constants::{self, UPDATES_PER_BOX};
use crate::ldl::{FACTOR_BITS, MATRIX_BITS, UNKNOWNS, solve};
use crate::math::{greater, magnitude, power, sqrt};
use crate::near_rest::WEIGHT;
use crate::rls::{PRODUCTS, place, scaled};
use crate::solution::{pivot, standard_errors};

const CORRELATION_BOXES: f32 = constants::CORRELATION_BOXES as f32;
const COVERAGE: f32 = constants::COVERAGE as f32;
const EXACT: f32 = constants::EXACT as f32;
const ROUNDING: f32 = constants::ROUNDING as f32;
/// Greatest error of a rounding over its rms.
const ROOT_3: f32 = 1.732_050_8;
/// Independent observations under which nothing is said: twice the unknowns, so that a residual is left.
const LEAST_OBSERVATIONS: f32 = 8.0;

/// The law fitted to what is known, in SI.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fit {
    /// Inertance with the structure, viscous and Coulomb friction, offset.
    pub values: [f32; UNKNOWNS],
    /// Standard error of each; infinite where the motion cannot show it.
    pub errors: [f32; UNKNOWNS],
    /// Variance of the residual [N^2].
    pub variance: f32,
    /// Independent observations.
    pub observations: f32,
}

impl Fit {
    /// From nothing.
    pub const NONE: Self = Self { values: [0.0; UNKNOWNS], errors: [0.0; UNKNOWNS], variance: 0.0, observations: 0.0 };
}

/// What one bank's memory knows.
pub(crate) struct Knowledge {
    matrix: [i64; PRODUCTS],
    /// Average product per unit of the matrix.
    per_unit: f32,
    /// Equally weighted updates that would know as much.
    updates: f32,
}

impl Knowledge {
    /// The recent memory.
    pub fn recent(bank: &BankState) -> Self {
        let weight = bank.recent.weight() as f32;
        let updates = if weight > 0.0 { power(MATRIX_BITS as i32) / weight } else { 0.0 };
        Self { matrix: *bank.recent.averages(), per_unit: 1.0, updates }
    }

    /// The recent memory without the updates near rest.
    pub fn away(bank: &BankState) -> Self {
        let recent = Self::recent(bank);
        let matrix = bank.near_rest.away(&bank.recent);
        let part = matrix[WEIGHT] as f32 / recent.matrix[WEIGHT] as f32;
        Self { matrix, per_unit: recent.per_unit / part, updates: recent.updates * part }
    }

    /// All since the reset.
    pub fn whole_run(bank: &BankState) -> Self {
        Self::summed(bank.whole.sums(), bank.whole.updates())
    }

    /// What was learnt between two readings of the exact sums, `updates` apart.
    pub fn between(before: &[i128; PRODUCTS], after: &[i128; PRODUCTS], updates: u32) -> Self {
        let mut sums = *after;
        for (sum, before) in sums.iter_mut().zip(before) {
            *sum = sum.wrapping_sub(*before);
        }
        Self::summed(&sums, updates)
    }

    fn summed(sums: &[i128; PRODUCTS], updates: u32) -> Self {
        let (matrix, shift) = scaled(sums);
        let updates = updates as f32;
        Self { matrix, per_unit: power(shift as i32) / updates.max(1.0), updates }
    }

    /// Mean square of a regressor.
    pub fn mean_square(&self, i: usize) -> f32 {
        self.matrix[place(i, i)] as f32 * self.per_unit
    }
}

/// Solves for the unknowns; nothing from too few observations.
pub(crate) fn fit(knowledge: &Knowledge, scales: &Scales) -> Option<Fit> {
    let observations = knowledge.updates / (CORRELATION_BOXES * UPDATES_PER_BOX as f32);
    if observations < LEAST_OBSERVATIONS {
        return None;
    }
    let solution = solve(&knowledge.matrix);
    let residual_variance = pivot(&solution, UNKNOWNS) * observations / (observations - UNKNOWNS as f32);
    let force_shift = i32::from(solution.shifts[UNKNOWNS]);
    // The matrix in Q62 is of regressors in Q31.
    let force_unit = scales.force * power(31 - force_shift);
    let variance = residual_variance * knowledge.per_unit * force_unit * force_unit;
    let mut fit = Fit { variance, observations, ..Fit::NONE };
    let to_si: [f32; UNKNOWNS] =
        core::array::from_fn(|i| scales.force_per[i] * power(i32::from(solution.shifts[i]) - force_shift));
    for (i, value) in fit.values.iter_mut().enumerate() {
        *value = solution.unknowns[i] as f32 * power(-(FACTOR_BITS as i32)) * to_si[i];
    }
    let mut error_variance = residual_variance / observations;
    if let Some(least) = rounding(&fit, scales) {
        let least = least * least / (knowledge.per_unit * force_unit * force_unit);
        error_variance = greater(error_variance, least);
    }
    let errors = standard_errors(&solution, error_variance);
    for (i, error) in fit.errors.iter_mut().enumerate() {
        *error = errors[i].map_or(f32::INFINITY, |error| error * to_si[i]);
    }
    Some(fit)
}

/// Error of the force that no averaging removes where a fit is exact, over [`COVERAGE`] \[N\]; nothing where it is not.
///
/// A residual under what rounding leaves of itself shows that the roundings follow the motion or stand still: then they add
/// up. They are at most half a code, the encoder's steps as one, and half a unit of each regressor.
fn rounding(fit: &Fit, scales: &Scales) -> Option<f32> {
    let [per_acceleration, ..] = scales.force_per;
    let [inertance, ..] = fit.values;
    let per_step = inertance / per_acceleration * scales.force;
    let steps = per_step * per_step * scales.quantisation;
    // One whose residual is no number is not exact either.
    let is_exact = fit.variance < EXACT * (ROUNDING * scales.noise + steps * scales.quantisation_kept);
    if !is_exact {
        return None;
    }
    let mut units = 1.0;
    for (value, force_per) in fit.values.iter().zip(scales.force_per) {
        units += magnitude(value / force_per);
    }
    Some((scales.half_code + ROOT_3 * sqrt(steps) + 0.5 * units * scales.force) / COVERAGE)
}
