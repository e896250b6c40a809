//! The contact's law from the terminal's sensor, and the backlash of one reversal in SI.

use crate::backlash::active::BacklashActive;
use crate::backlash::step::Fit;
use crate::backlash::terminal::{Crossing, Terminal};
use crate::budget::NORMAL_COVERAGE;
use crate::detail::{Reason, Reversal, Route};
use crate::ldl::{FACTOR_BITS, UNKNOWNS, solve};
use crate::math::{greater, power, sqrt, square};
use crate::rls::{place, scaled};
use crate::solution::{Inverse, pivot};

/// Standard error of a single reversal with the sensor by the encoder's steps [counts]: a fifth of the steps' own rms
/// on either flank.
const RECORD_COUNT_PART: f32 = 0.08;
/// Fraction of the residual by which the variance taken for the stretch's noise may be wrong.
const MODEL_OF_NOISE: f32 = 0.2;
/// Noise in a regressor, as a fraction of what the others leave of it, from which on no correction for it is trusted:
/// there is then no value.
const DROWNED: f32 = 0.5;
/// Fewest blocks on either flank for the terminal's route.
const FEWEST_BLOCKS: u32 = 16;
/// The contact's law is solved again when the number of blocks has grown by one part in this many.
const LAW_GROWTH: u32 = 4;

/// How the contact's stretch depends on the force, from the terminal's sensor, in the units of its least squares.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Law {
    /// Number of blocks at which it is solved again.
    next: u32,
    /// Damping over stiffness, and 1 over the stiffness; 0 while unknown.
    lag: f32,
    compliance: f32,
    /// Variance of a block's stretch by the residual of the law, and relative variance of the compliance.
    variance: f32,
    relative: f32,
}

impl Law {
    /// Nothing is known.
    pub const UNKNOWN: Self = Self { next: 0, lag: 0.0, compliance: 0.0, variance: 0.0, relative: 0.0 };

    /// Whether there are enough new blocks to solve it again.
    pub fn is_due(&self, terminal: &Terminal) -> bool {
        terminal.totals.updates() >= self.next
    }
}

/// The terminal's least squares, solved: coefficients of `[z', z, s, 1]` in their own units, with their errors.
pub(crate) struct Solved {
    pub unknowns: [f32; UNKNOWNS],
    pub errors: [Option<f32>; UNKNOWNS],
    /// Residual variance of a block's force [codes^2].
    pub residual: f32,
}

impl Solved {
    /// Solves for the force, or if `travel` for the encoder's travel in its place, with `less` subtracted from the
    /// squares of `z'` and `z`.
    pub fn of(terminal: &Terminal, less: [f32; 2], travel: bool) -> Self {
        let (mut matrix, shift) = scaled(terminal.totals.sums());
        let down = power(-(shift as i32));
        for (i, less) in [place(0, 0), place(1, 1)].into_iter().zip(less) {
            if let Some(entry) = matrix.get_mut(i) {
                *entry -= (less * down) as i64;
            }
        }
        if travel {
            let row = matrix.iter_mut().skip(place(UNKNOWNS, 0));
            row.zip(&terminal.travel).for_each(|(entry, sum)| *entry = (*sum >> shift) as i64);
        }
        let solution = solve(&matrix);
        let freedom = terminal.totals.updates().saturating_sub(UNKNOWNS as u32).max(1) as f32;
        let last = i32::from(solution.shifts[UNKNOWNS]);
        let left = pivot(&solution, UNKNOWNS) / freedom;
        let errors = Inverse::of(&solution).errors(left);
        let unit = |i: usize| power(i32::from(solution.shifts[i]) - last);
        Self {
            unknowns: core::array::from_fn(|i| solution.unknowns[i] as f32 * power(-(FACTOR_BITS as i32)) * unit(i)),
            errors: core::array::from_fn(|i| errors[i].map(|error| error * unit(i))),
            // The Q62 matrix holds sums shifted right.
            residual: left * power(62 - last) * power(shift as i32 - last),
        }
    }
}

/// The terminal's least squares, corrected for the noise of the stretch.
pub(crate) struct Freed {
    pub solved: Solved,
    /// Subtracted from the squares of `z'` and `z`, and the most that it may be.
    pub noise: [f32; 2],
    pub most: [f32; 2],
    /// What the other regressors leave of the squares of `z'` and `z`.
    pub own_rate: f32,
    pub own_stretch: f32,
    /// Whether the noise in `z'` is too great for a correction; the damping then has no value.
    pub damping_drowned: bool,
}

impl Freed {
    fn law(&self) -> Law {
        let [damping, stiffness, ..] = self.solved.unknowns;
        let compliance = 1.0 / stiffness;
        let variance = self.solved.residual * square(compliance);
        // The noise of the stretch lowers the stiffness by its fraction of what the others leave of the stretch.
        let ([_, least], [_, most]) = (self.noise, self.most);
        let weakened = (most - least) / (NORMAL_COVERAGE * self.own_stretch);
        let error = self.solved.errors[1].map_or(0.0, |error| error * compliance);
        let relative = square(error) + square(weakened);
        Law { lag: damping * compliance, compliance, variance, relative, ..Law::UNKNOWN }
    }
}

impl BacklashActive {
    /// The terminal's least squares, corrected for the stretch's noise, or the reason why they give no backlash.
    /// `force_noise` is as the flanks keep it.
    pub fn solved(&self, terminal: &Terminal, force_noise: i32) -> Result<Freed, Reason> {
        let blocks = terminal.totals.updates();
        let [negative, positive] = terminal.sides;
        if negative.max(positive) < FEWEST_BLOCKS {
            return Err(Reason::TooFewReversals);
        }
        if negative.min(positive) < FEWEST_BLOCKS {
            return Err(Reason::ForceNeverReverses);
        }
        let plain = Solved::of(terminal, [0.0; 2], false);
        let [damping, stiffness, ..] = plain.unknowns;
        if stiffness <= 0.0 {
            return Err(Reason::FlankTooShort);
        }
        // Noise in the stretch lowers its coefficients. Its variance in a sample is what the residual holds beyond the
        // force's own noise.
        let block = self.scales.block;
        let force_noise = block * square(force_noise as f32 * self.scales.noise);
        let excess = greater(plain.residual - force_noise, 0.0);
        let noise_by = |excess: f32| excess / (block * square(stiffness) + 2.0 * square(damping)) * blocks as f32;
        let most = noise_by(MODEL_OF_NOISE * plain.residual + excess);
        // What the others leave of a regressor is the residual over the square of its error.
        let own = plain.errors.map(|error| error.map_or(0.0, |error| plain.residual / square(error)));
        let [own_rate, own_stretch, ..] = own;
        let drowned = |part: f32, own: f32| part * most >= DROWNED * own;
        let damping_drowned = drowned(2.0, own_rate);
        if drowned(block, own_stretch) {
            return Err(Reason::FlankTooShort);
        }
        let parts = |noise: f32| [if damping_drowned { 0.0 } else { 2.0 * noise }, block * noise];
        let noise = parts(noise_by(excess));
        let solved = Solved::of(terminal, noise, false);
        let [_, stiffness, ..] = solved.unknowns;
        if stiffness <= 0.0 {
            return Err(Reason::FlankTooShort);
        }
        Ok(Freed { solved, noise, most: parts(most), own_rate, own_stretch, damping_drowned })
    }

    /// The law from all blocks so far.
    pub fn law(&self, terminal: &Terminal, force_noise: i32) -> Law {
        let blocks = terminal.totals.updates();
        let law = self.solved(terminal, force_noise).map_or(Law::UNKNOWN, |solved| solved.law());
        Law { next: blocks.saturating_add(blocks / LAW_GROWTH + 1), ..law }
    }

    /// A reversal by the terminal's sensor: the jump of `z + (cs / ks) z' - F / ks` from flank to flank. `None` if the
    /// contact's stiffness is unknown, or if the jump or its error is not finite.
    pub fn sensed(&self, law: &Law, crossing: &Crossing) -> Option<Reversal> {
        let Crossing { before: first, after: second } = crossing;
        let Law { lag, compliance, variance, relative, .. } = *law;
        if compliance <= 0.0 {
            return None;
        }
        let [before, after] = [first, second].map(|flank| {
            let [rate, stretch, force] = flank.sums.map(|sum| sum as f32 / flank.blocks as f32);
            (stretch + lag * rate, compliance * force)
        });
        let rising = second.side > 0;
        let towards = if rising { 1.0 } else { -1.0 };
        let by_force = towards * (after.1 - before.1);
        let jump = towards * (after.0 - before.0) - by_force;
        let count = RECORD_COUNT_PART * self.count_units as f32 * self.scales.block;
        let fewer = 1.0 / first.blocks as f32 + 1.0 / second.blocks as f32;
        let unit_m = self.unit_m / self.scales.block;
        let flight = second.first.wrapping_sub(first.last);
        let (value_m, error_m) =
            (jump * unit_m, sqrt(variance * fewer + square(by_force) * relative + square(count)) * unit_m);
        // The squares of lengths far beyond any machine may be beyond the format.
        (value_m.is_finite() && error_m.is_finite()).then_some(Reversal {
            index: first.last.wrapping_add(flight / 2),
            value_m,
            error_m,
            route: Route::Terminal,
            rising,
        })
    }

    /// A reversal by the force alone.
    pub fn reversal(&self, fit: &Fit, rising: bool, index: u32) -> Reversal {
        Reversal {
            index,
            value_m: fit.value as f32 * self.unit_m,
            error_m: sqrt(fit.variance as f32) * self.unit_m,
            route: Route::Force,
            rising,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{backlash::terminal::Flank, settings::Settings};

    #[test]
    fn a_reversal_whose_error_exceeds_the_format_is_not_reported() {
        let active = Settings { terminal_sensor: true, ..Settings::default() }.validate().unwrap();
        let flank = |side: i8| Flank { side, blocks: 16, sums: [0, 0, 16_000 * i64::from(side)], first: 0, last: 9 };
        let crossing = Crossing { before: flank(-1), after: flank(1) };
        let by = |compliance: f32| {
            let law = Law { next: 0, lag: 0.0, compliance, variance: 1.0, relative: 1e-3 };
            active.backlash.sensed(&law, &crossing)
        };
        assert!(by(1e-3).is_some_and(|reversal| reversal.value_m < 0.0 && reversal.error_m > 0.0));
        // The length itself is within the format, its square is not.
        assert_eq!(by(1e17), None);
    }
}
