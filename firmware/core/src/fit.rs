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
    /// Decrease of each per second of delay of the force [its unit per second].
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::{ONE, REGRESSORS};
    use crate::qformat::Regressor;
    use crate::rls::{more_products, products};
    use crate::settings::Settings;

    /// One of eight functions of the update that are 1 or -1, and orthogonal over eight updates.
    fn walsh(n: i32, bits: i32) -> i32 {
        if (n & bits).count_ones().is_multiple_of(2) { 1 } else { -1 }
    }

    const ACCELERATION: i32 = 1 << 24;
    const VELOCITY: i32 = 1 << 26;
    const RESIDUAL: i32 = 1 << 20;

    /// Force is 5 times acceleration, a quarter of velocity, minus 2^-10 of the sign and 2^-12 of the constant, and a
    /// residual of its own.
    fn regressors(n: i32, acceleration: i32, velocity: i32) -> [Regressor; REGRESSORS] {
        let (a, v, s) = (acceleration * walsh(n, 1), velocity * walsh(n, 2), ONE * walsh(n, 4));
        [a, v, s, ONE, 5 * a + v / 4 - s / 1024 + ONE / 4096 + RESIDUAL * walsh(n, 7)]
    }

    fn take(bank: &mut BankState, regressors: &[Regressor; REGRESSORS], rate: Regressor, curvature: Regressor) {
        const MEMORY: u32 = 100_000;
        let products = products(regressors);
        bank.recent.update(&products, MEMORY);
        bank.near_rest.update(&products, &bank.recent, MEMORY);
        let gain = bank.recent.gain(MEMORY);
        bank.rate.update(rate, regressors, gain);
        bank.curvature.update(curvature, regressors, gain);
        bank.whole.update(&products);
        bank.more.update(&more_products(regressors, &[7, rate]));
    }

    fn near(found: f32, wanted: f64, what: &str) {
        assert!((f64::from(found) - wanted).abs() <= 1e-4 * wanted.abs(), "{what}: {found} for {wanted}");
    }

    /// The force's rate is a multiple of the acceleration and something else; its second derivative, of velocity and
    /// sign and something else. All of it is orthogonal, so each result is by hand.
    #[test]
    fn a_fit_takes_its_part_and_leaves_the_rest() {
        let scales = Scales { quantisation: 0.0, ..Settings::default().validate().unwrap().fast.scales };
        let mut bank = BankState::new();
        for n in 0..80 {
            let rate = (3 << 20) * walsh(n, 1) + (5 << 20) * walsh(n, 3);
            let curvature = (3 << 22) * walsh(n, 2) - (1 << 22) * walsh(n, 4) + (5 << 19) * walsh(n, 5);
            take(&mut bank, &regressors(n, ACCELERATION, VELOCITY), rate, curvature);
        }
        let observations = 80.0 / (2.0 * 2.09);
        let force_per = scales.force_per.map(f64::from);
        let [rate_unit, curvature_unit] = [scales.rate_per_force, scales.curvature_per_force].map(f64::from);
        let force = f64::from(scales.force);
        for (knowledge, is_recent) in [(Knowledge::recent(&bank), true), (Knowledge::whole_run(&bank), false)] {
            near(knowledge.updates(), 80.0, "updates");
            near(knowledge.mean_square(1), f64::from(VELOCITY).powi(2), "velocity");
            let fit = fit(&knowledge, &scales).unwrap();
            near(fit.observations, observations, "observations");
            near(fit.freedom(), observations - 4.0, "freedom");
            let residual = f64::from(RESIDUAL) / (observations - 4.0).sqrt();
            near(fit.variance, (residual * force).powi(2) * observations, "variance");
            let sizes = [ACCELERATION, VELOCITY, ONE, ONE].map(f64::from);
            for (i, part) in [5.0, 0.25, -1.0 / 1024.0, 1.0 / 4096.0].into_iter().enumerate() {
                near(fit.values[i], part * force_per[i], "value");
                near(fit.errors[i], residual / sizes[i] * force_per[i], "error");
            }
            assert_eq!((fit.inertance_error, fit.is_exact, fit.steps), (fit.errors[0], false, [0.0; UNKNOWNS]));
            near(fit.per_skew[0], 3.0 / 16.0 * force_per[0] * rate_unit, "skew");
            near(fit.late, (f64::from(5 << 20) * force * rate_unit).powi(2), "late");
            let [viscous, coulomb] = fit.friction_in_curvature;
            let there = f64::from(u8::from(is_recent));
            near(viscous, there * 3.0 / 16.0 * force_per[1] * curvature_unit, "viscous");
            near(coulomb, there / -256.0 * force_per[2] * curvature_unit, "coulomb");
            near(fit.curved, there * (f64::from(5 << 19) * force * curvature_unit).powi(2), "curved");
        }
    }

    #[test]
    fn fewer_than_eight_observations_are_no_fit() {
        let scales = Settings::default().validate().unwrap().fast.scales;
        let mut bank = BankState::new();
        assert!(fit(&Knowledge::recent(&bank), &scales).is_none());
        for n in 0..40 {
            take(&mut bank, &regressors(n, ACCELERATION, VELOCITY), 0, 0);
            // Of 33 updates there are 7.9, of 34 there are 8.1.
            assert_eq!(fit(&Knowledge::recent(&bank), &scales).is_some(), n >= 33, "{n}");
            assert_eq!(fit(&Knowledge::whole_run(&bank), &scales).is_some(), n >= 33, "{n}");
        }
    }

    /// Every other eight updates are near rest, at an eighth of the velocity.
    #[test]
    fn what_is_away_from_rest_is_the_rest() {
        let mut bank = BankState::new();
        for n in 0..160 {
            let is_slow = n & 8 != 0;
            let (a, v) = if is_slow { (3 * ACCELERATION, VELOCITY / 8) } else { (ACCELERATION, VELOCITY) };
            take(&mut bank, &regressors(n, a, v), 0, 0);
        }
        let away = Knowledge::away(&bank);
        near(away.updates(), 80.0, "updates");
        near(away.mean_square(0), f64::from(ACCELERATION).powi(2), "acceleration");
        near(away.mean_square(1), f64::from(VELOCITY).powi(2), "velocity");
        near(Knowledge::recent(&bank).mean_square(0), 5.0 * f64::from(ACCELERATION).powi(2), "all");
    }

    /// Steps take a fifth of the inertance: its fit has 4 of 5 parts. Of what is missing, half of the part that the
    /// readings keep and half of all is restored, and half of all is uncertain.
    #[test]
    fn what_steps_take_is_restored() {
        let found = Fit { values: [100.0, 10.0, 5.0, 1.0], ..Fit::NONE };
        let mut fit = found;
        fit.correct_for_steps([0.2, 0.01, -0.02, 0.0], 0.25);
        for (i, (value, steps)) in
            [(115.625, 12.5), (10.781_25, 0.625), (3.4375, 1.25), (1.0, 0.0)].into_iter().enumerate()
        {
            near(fit.values[i], value, "value");
            near(fit.steps[i], steps, "steps");
        }
        for (of_itself, is_known) in [(0.49, true), (0.51, false)] {
            let mut fit = found;
            fit.correct_for_steps([of_itself, 0.0, 0.0, 0.0], 0.25);
            assert_eq!((fit.errors[0].is_finite(), fit.values[0] > 100.0), (is_known, is_known), "{of_itself}");
        }
    }

    /// A quarter of what rounding to codes, `1/12` of their square, and independent steps leave behind the kernel.
    #[test]
    fn a_residual_under_a_quarter_of_the_rounding_is_exact() {
        let settings = Settings {
            newtons_per_code: 3.0,
            oversampling: 4.0,
            full_scale_acceleration_m_per_s2: 1e6,
            full_scale_velocity_m_per_s: 1e4,
            ..Settings::default()
        };
        let scales = settings.validate().unwrap().fast.scales;
        let values: [f32; UNKNOWNS] = [300.0, -2000.0, 50.0, 7.0];
        let [per_a, .., per_force] = scales.units;
        let steps = (300.0 * per_a).powi(2) * f64::from(scales.quantisation);
        // Boxes of 16 samples.
        let limit = 0.25 * (151.0 / 315.0 / 16.0 * 9.0 / 12.0 + steps / 4.0);
        let of = |variance: f64| rounding(&Fit { values, variance: variance as f32, ..Fit::NONE }, &scales);
        assert_eq!((of(1.01 * limit), of(f64::NAN)), (None, None));
        // Half a code, the greatest step, and half a unit of the force and of each regressor.
        let of_units: f64 = values.iter().zip(scales.units).map(|(value, unit)| f64::from(value.abs()) * unit).sum();
        let wanted = (1.5 + (3.0 * steps).sqrt() + 0.5 * (per_force + of_units)) / 1.959_964;
        near(of(0.99 * limit).unwrap(), wanted, "rounding");
        // Each part is seen: the least is a hundredth of all.
        assert!(0.5 * per_force > 0.005 * wanted && 0.5 * of_units > 0.005 * wanted && steps > 1e-4, "{of_units}");
    }
}
