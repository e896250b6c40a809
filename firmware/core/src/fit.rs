//! The law fitted to what a memory knows, with standard errors, in SI.
//!
//! Floats are allowed here: basic arithmetic gives the same bits on every machine.

use crate::active::Scales;
use crate::bank::{Aside, BankState};
use crate::budget::NORMAL_COVERAGE;
use crate::constants::{self, UPDATES_PER_BOX};
use crate::ldl::{FACTOR_BITS, MATRIX_BITS, UNKNOWNS, solve};
use crate::math::{greater, magnitude, power, single, single_of_wide, sqrt};
use crate::near_rest::WEIGHT;
use crate::rls::{PRODUCTS, RATE, RATE_SQUARE, place, scaled};
use crate::solution::{Inverse, pivot};

const CORRELATION_BOXES: f32 = constants::CORRELATION_BOXES as f32;
const EXACT: f32 = constants::EXACT as f32;
const ROUNDING: f32 = constants::ROUNDING as f32;
/// Greatest error of rounding over its rms.
const ROOT_3: f32 = 1.732_050_8;
/// Greatest fraction that the encoder's steps may be of what the other regressors leave of the acceleration.
const MOST_STEPS: f32 = 0.5;
/// Fewest independent observations for a result: twice the unknowns, so that a residual is left.
const LEAST_OBSERVATIONS: f32 = 8.0;

/// The law fitted to what is known, in SI.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Fit {
    /// Inertance with the structure, viscous and Coulomb friction, offset.
    pub values: [f32; UNKNOWNS],
    /// Standard error of each; infinite if the motion cannot identify it.
    pub errors: [f32; UNKNOWNS],
    /// That of the inertance, even where the steps are too great a part of the acceleration to identify it.
    pub inertance_error: f32,
    /// What each loses if the force is a second later [its unit per second].
    pub per_skew: [f32; UNKNOWNS],
    /// Mean square of the force's rate that the law does not explain [N^2/s^2]: a skew of a second would add this to
    /// the residual's.
    pub late: f32,
    /// Viscous and Coulomb friction for which the fit mistakes the force's second derivative [N s/m and N, per N/s^2].
    pub friction_in_curvature: [f32; 2],
    /// Mean square of that derivative that the law does not explain [N^2/s^4].
    pub curved: f32,
    /// Uncertainty of each that remains after the correction for the encoder's steps.
    pub steps: [f32; UNKNOWNS],
    /// Variance of the residual [N^2].
    pub variance: f32,
    /// Square of the motion's frequency, weighted by the squared velocity, times that of the kernel's box.
    pub frequency_squared: f32,
    /// Independent observations.
    pub observations: f32,
    /// Whether nothing scatters but rounding, which does not average out.
    pub is_exact: bool,
}

impl Fit {
    /// Nothing is known.
    pub const UNKNOWN: Self = Self { errors: [f32::INFINITY; UNKNOWNS], ..Self::NONE };

    /// Zeros.
    pub const NONE: Self = Self {
        values: [0.0; UNKNOWNS],
        errors: [0.0; UNKNOWNS],
        inertance_error: 0.0,
        per_skew: [0.0; UNKNOWNS],
        late: 0.0,
        friction_in_curvature: [0.0; 2],
        curved: 0.0,
        steps: [0.0; UNKNOWNS],
        variance: 0.0,
        frequency_squared: 0.0,
        observations: 0.0,
        is_exact: false,
    };

    /// Degrees of freedom of the residual.
    pub fn freedom(&self) -> f32 {
        self.observations - UNKNOWNS as f32
    }
}

/// What one bank's memory knows.
pub(crate) struct Knowledge {
    matrix: [i64; PRODUCTS],
    /// Average product per unit of the matrix.
    per_unit: f32,
    /// Number of equally weighted updates with the same information.
    updates: f32,
    /// Averages with the force's rate and its second derivative, where they are needed.
    rate: Option<Beside>,
    curvature: Option<Beside>,
}

/// Average products of a quantity for which the law has no parameter with the unknowns' regressors, and its mean
/// square.
struct Beside {
    products: [f32; UNKNOWNS],
    square: f32,
}

impl Beside {
    fn of(aside: &Aside) -> Self {
        Self { products: aside.products.map(single), square: single(aside.square) }
    }
}

impl Knowledge {
    /// The recent memory.
    pub fn recent(bank: &BankState) -> Self {
        let weight = single(bank.recent.weight());
        let updates = if weight > 0.0 { power(MATRIX_BITS as i32) / weight } else { 0.0 };
        Self {
            matrix: *bank.recent.averages(),
            per_unit: 1.0,
            updates,
            rate: Some(Beside::of(&bank.rate)),
            curvature: Some(Beside::of(&bank.curvature)),
        }
    }

    /// The recent memory without the updates near rest.
    pub fn away(bank: &BankState) -> Self {
        let recent = Self::recent(bank);
        let matrix = bank.near_rest.away(&bank.recent);
        let part = single(matrix[WEIGHT]) / single(recent.matrix[WEIGHT]);
        Self { matrix, per_unit: recent.per_unit / part, updates: recent.updates * part, rate: None, curvature: None }
    }

    /// All since the reset.
    pub fn whole_run(bank: &BankState) -> Self {
        let whole = Self::summed(bank.whole.sums(), bank.whole.updates());
        let (updates, sums) = (whole.updates.max(1.0), bank.more.sums());
        let mut products = [0.0; UNKNOWNS];
        for (average, sum) in products.iter_mut().zip(&sums[RATE]) {
            *average = single_of_wide(*sum) / updates;
        }
        Self { rate: Some(Beside { products, square: single_of_wide(sums[RATE_SQUARE]) / updates }), ..whole }
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
        Self { matrix, per_unit: power(shift as i32) / updates.max(1.0), updates, rate: None, curvature: None }
    }

    /// Number of equally weighted updates with the same information.
    pub fn updates(&self) -> f32 {
        self.updates
    }

    /// Mean square of a regressor.
    pub fn mean_square(&self, i: usize) -> f32 {
        single(self.matrix[place(i, i)]) * self.per_unit
    }
}

/// Solves for the unknowns; `None` with too few observations.
pub(crate) fn fit(knowledge: &Knowledge, scales: &Scales) -> Option<Fit> {
    let observations = knowledge.updates / (CORRELATION_BOXES * UPDATES_PER_BOX as f32);
    if observations < LEAST_OBSERVATIONS {
        return None;
    }
    let solution = solve(&knowledge.matrix);
    let residual_variance = pivot(&solution, UNKNOWNS) * observations / (observations - UNKNOWNS as f32);
    let force_shift = i32::from(solution.shifts[UNKNOWNS]);
    // The Q62 matrix is of Q31 regressors.
    let force_unit = scales.force * power(31 - force_shift);
    let variance = residual_variance * knowledge.per_unit * force_unit * force_unit;
    let acceleration = greater(knowledge.mean_square(0) - scales.quantisation, 0.0);
    let [per_acceleration, per_velocity, ..] = scales.force_per;
    let rate = per_velocity / per_acceleration;
    let frequency_squared = acceleration / knowledge.mean_square(1) * rate * rate * scales.box_squared;
    let mut fit = Fit { variance, frequency_squared, observations, ..Fit::NONE };
    let equilibrating = solution.shifts.map(|shift| power(i32::from(shift)));
    let of_force = power(-force_shift);
    let to_si: [f32; UNKNOWNS] = core::array::from_fn(|i| scales.force_per[i] * equilibrating[i] * of_force);
    for (i, value) in fit.values.iter_mut().enumerate() {
        *value = single(solution.unknowns[i]) * power(-(FACTOR_BITS as i32)) * to_si[i];
    }
    let mut error_variance = residual_variance / observations;
    if let Some(least) = rounding(&fit, scales) {
        let least = least * least / (knowledge.per_unit * force_unit * force_unit);
        error_variance = greater(error_variance, least);
        fit.is_exact = true;
    }
    let inverse = Inverse::of(&solution);
    for ((error, found), to_si) in fit.errors.iter_mut().zip(inverse.errors(error_variance)).zip(to_si) {
        *error = found.map_or(f32::INFINITY, |found| found * to_si);
    }
    [fit.inertance_error, ..] = fit.errors;
    // Average products in the matrix' own equilibrated units.
    let per_unit = power(force_shift - MATRIX_BITS as i32) / knowledge.per_unit;
    let equilibrated = |i: usize, product: f32| product * per_unit * equilibrating[i];
    // What each parameter takes of it, and the mean square that is left.
    let taken = |beside: &Beside, per_force: f32| {
        let right = core::array::from_fn(|i| equilibrated(i, beside.products[i]));
        let (moved, explained) = inverse.times(right);
        let left = greater(equilibrated(UNKNOWNS, beside.square) - explained, 0.0);
        let unit = force_unit * per_force;
        (moved, left * knowledge.per_unit * unit * unit)
    };
    if let Some(rate) = &knowledge.rate {
        let (moved, left) = taken(rate, scales.rate_per_force);
        fit.late = left;
        for ((per_skew, moved), to_si) in fit.per_skew.iter_mut().zip(moved).zip(to_si) {
            *per_skew = moved * to_si * scales.rate_per_force;
        }
    }
    if let Some(curvature) = &knowledge.curvature {
        let ([_, viscous, coulomb, _], left) = taken(curvature, scales.curvature_per_force);
        fit.friction_in_curvature =
            [viscous * to_si[1] * scales.curvature_per_force, coulomb * to_si[2] * scales.curvature_per_force];
        fit.curved = left;
    }
    let steps = equilibrated(0, scales.quantisation / scales.force_per[0]);
    let per_inertance = inverse.column(0);
    fit.correct_for_steps(core::array::from_fn(|i| steps * per_inertance[i] * to_si[i]), scales.quantisation_kept);
    Some(fit)
}

impl Fit {
    /// Restores what the encoder's steps take away, as noise in a regressor does: `taken` per unit of inertance, to
    /// first order. A sample sums readings. If their errors are independent, the fraction `kept` of the steps remains;
    /// if they are equal, all of it does. The mean of both is restored. Steps in a slow motion are not as white as
    /// noise, so half of the full correction is uncertain.
    fn correct_for_steps(&mut self, taken: [f32; UNKNOWNS], kept: f32) {
        let [inertance, ..] = self.values;
        let [of_itself, ..] = taken;
        if of_itself > MOST_STEPS {
            // Most of what the others leave of the acceleration is the encoder's steps.
            self.errors[0] = f32::INFINITY;
            return;
        }
        for ((value, steps), taken) in self.values.iter_mut().zip(&mut self.steps).zip(taken) {
            let all = inertance * taken / (1.0 - of_itself);
            *value += all * 0.5 * (1.0 + kept);
            *steps = magnitude(all) * 0.5;
        }
    }
}

/// Standard error of the force that averaging does not remove, where a fit is exact \[N\]; `None` where it is not.
///
/// A residual smaller than rounding leaves shows that the rounding errors follow the motion or are constant: then they
/// add up. They are at most half a code, the rms of the encoder's steps times the peak over rms of one rounding, and
/// half a unit of each regressor.
fn rounding(fit: &Fit, scales: &Scales) -> Option<f32> {
    let [per_acceleration, ..] = scales.force_per;
    let [inertance, ..] = fit.values;
    let per_step = inertance / per_acceleration * scales.force;
    let steps = per_step * per_step * scales.quantisation;
    // A residual that is NaN is not exact either.
    let is_exact = fit.variance < EXACT * (ROUNDING * scales.noise + steps * scales.quantisation_kept);
    if !is_exact {
        return None;
    }
    let mut units = 1.0;
    for (value, force_per) in fit.values.iter().zip(scales.force_per) {
        units += magnitude(value / force_per);
    }
    Some((scales.half_code + ROOT_3 * sqrt(steps) + 0.5 * units * scales.force) / NORMAL_COVERAGE)
}
