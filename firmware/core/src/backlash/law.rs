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
pub(super) mod tests {
    use super::*;
    use crate::backlash::terminal::{Flank, ONE};
    use crate::rls::products;
    use crate::settings::Settings;
    use inerter_needs::Random;
    use std::vec::Vec;

    /// Blocks of a contact with 8 codes per unit of rate and 2 per unit of stretch, a side of -7 and a force that
    /// scatters by so much: rows of `[z', z, s, 1, F]`, and the encoder's travel, a third of which is like the stretch.
    pub fn blocks(count: usize, scatter: i32) -> (Vec<[i32; 5]>, Vec<i32>) {
        let mut random = Random(6);
        let mut within = |most: i32| random.below(2 * most + 1) - most;
        (0..count)
            .map(|n| {
                let side = if n / 5 % 2 == 0 { ONE } else { -ONE };
                let (rate, stretch) = (within(20_000_000), within(80_000_000) + 20 * side);
                let force = 8 * rate + 2 * stretch - 7 * side + 3 * ONE + within(scatter);
                ([rate, stretch, side, ONE, force], stretch / 3 + within(50_000_000))
            })
            .unzip()
    }

    /// The state after these blocks.
    pub fn seen((rows, travel): &(Vec<[i32; 5]>, Vec<i32>)) -> Terminal {
        let mut terminal = Terminal::new();
        for (row, travel) in rows.iter().zip(travel) {
            terminal.totals.update(&products(row));
            terminal.sides[usize::from(row[2] > 0)] += 1;
            let [a, b, c, d, _] = *row;
            for (sum, other) in terminal.travel.iter_mut().zip([a, b, c, d, *travel]) {
                *sum += i128::from(*travel) * i128::from(other);
            }
        }
        terminal
    }

    /// Least squares of the targets by the first four columns in f64, with `less` taken from the squares of the first
    /// two: the unknowns, the diagonal of the inverse, and the residual variance.
    pub fn reckoned(rows: &[[i32; 5]], targets: &[f64], less: [f64; 2]) -> ([f64; 4], [f64; 4], f64) {
        // The matrix, the right-hand side, and a unit matrix that becomes the inverse.
        let mut all = [[0.0; 9]; 4];
        for (i, line) in all.iter_mut().enumerate() {
            for (row, target) in rows.iter().zip(targets) {
                let own = f64::from(row[i]);
                for (entry, other) in line.iter_mut().zip(&row[..4]) {
                    *entry += own * f64::from(*other);
                }
                line[4] += own * target;
            }
            line[5 + i] = 1.0;
            if i < 2 {
                line[i] -= less[i];
            }
        }
        let right = all.map(|line| line[4]);
        for i in 0..4 {
            let pivot = all[i][i];
            let unit = all[i].map(|entry| entry / pivot);
            for (other, line) in all.iter_mut().enumerate() {
                let part = line[i];
                if other == i {
                    *line = unit;
                } else {
                    line.iter_mut().zip(unit).for_each(|(entry, unit)| *entry -= part * unit);
                }
            }
        }
        let unknowns = all.map(|line| line[4]);
        let square = targets.iter().map(|target| target * target).sum::<f64>();
        let explained = unknowns.iter().zip(right).map(|(unknown, right)| unknown * right).sum::<f64>();
        let inverse = core::array::from_fn(|i| all[i][5 + i]);
        (unknowns, inverse, (square - explained) / (rows.len() as f64 - 4.0))
    }

    pub fn forces(rows: &[[i32; 5]]) -> Vec<f64> {
        rows.iter().map(|row| f64::from(row[4])).collect()
    }

    fn near(found: f32, wanted: f64, size: f64, what: &str) {
        assert!((f64::from(found) - wanted).abs() <= 2e-3 * size, "{what}: {found} for {wanted}");
    }

    fn sensing() -> BacklashActive {
        Settings { terminal_sensor: true, ..Settings::default() }.validate().unwrap().backlash
    }

    /// Unknowns, errors and residual of the force and of the travel are those of the least squares in f64, also with
    /// less of the squares.
    #[test]
    fn blocks_are_solved_as_in_f64() {
        let blocks = blocks(2000, 80_000_000);
        let terminal = seen(&blocks);
        let (rows, travel) = &blocks;
        let square = |i: usize| rows.iter().map(|row| f64::from(row[i]).powi(2)).sum::<f64>();
        let travel: Vec<f64> = travel.iter().map(|travel| f64::from(*travel)).collect();
        for less in [[0.0, 0.0], [0.02 * square(0), 0.01 * square(1)]] {
            for (targets, is_travel) in [(forces(rows), false), (travel.clone(), true)] {
                let (unknowns, inverse, residual) = reckoned(rows, &targets, less);
                let found = Solved::of(&terminal, less.map(|less| less as f32), is_travel);
                near(found.residual, residual, residual, "residual");
                for i in 0..UNKNOWNS {
                    let error = (residual * inverse[i]).sqrt();
                    near(found.unknowns[i], unknowns[i], 0.2 * unknowns[i].abs() + 0.2 * error, "unknown");
                    near(found.errors[i].unwrap(), error, error, "error");
                }
            }
        }
    }

    /// What the residual holds beyond the force's own noise is the noise of the stretch, of which a block of four sums
    /// has four times and its rate twice; a fifth of the residual more is the most that it may be. Where this is half
    /// of what is left of a regressor, there is no correction.
    #[test]
    fn the_noise_of_the_stretch_is_taken_from_its_square() {
        let active = sensing();
        assert!((active.scales.block - 4.0).abs() < 1e-6);
        for (scatter, force_noise, drowns) in [
            (80_000_000, 0, [false, false]),
            (80_000_000, 1_000_000_000, [false, false]),
            (80_000_000, 2_000_000_000, [false, false]),
            (160_000_000, 0, [true, false]),
            (900_000_000, 0, [true, true]),
        ] {
            let blocks = blocks(2000, scatter);
            let (rows, _) = &blocks;
            let targets = forces(rows);
            let ([damping, stiffness, ..], inverse, residual) = reckoned(rows, &targets, [0.0; 2]);
            let force_variance = 4.0 * (f64::from(force_noise) * f64::from(active.scales.noise)).powi(2);
            let excess = (residual - force_variance).max(0.0);
            let per_sample = |excess: f64| excess / (4.0 * stiffness.powi(2) + 2.0 * damping.powi(2)) * 2000.0;
            let (least, most) = (per_sample(excess), per_sample(excess + 0.2 * residual));
            let is_drowned = [2.0 * most >= 0.5 / inverse[0], 4.0 * most >= 0.5 / inverse[1]];
            assert_eq!(is_drowned, drowns, "{scatter}");
            let found = active.solved(&seen(&blocks), force_noise);
            let [of_rate, of_stretch] = drowns;
            if of_stretch {
                assert_eq!(found.err(), Some(Reason::FlankTooShort));
                continue;
            }
            let Ok(found) = found else { panic!("{scatter}") };
            let parts = |noise: f64| [if of_rate { 0.0 } else { 2.0 * noise }, 4.0 * noise];
            let (less, greatest) = (parts(least), parts(most));
            for i in 0..2 {
                near(found.noise[i], less[i], less[i], "noise");
                near(found.most[i], greatest[i], greatest[i], "most");
            }
            assert_eq!(found.damping_drowned, of_rate);
            near(found.own_rate, 1.0 / inverse[0], 1.0 / inverse[0], "rate");
            near(found.own_stretch, 1.0 / inverse[1], 1.0 / inverse[1], "stretch");
            let (unknowns, ..) = reckoned(rows, &targets, less);
            for (found, wanted) in found.solved.unknowns.into_iter().zip(unknowns).take(2) {
                near(found, wanted, wanted.abs(), "freed");
            }
        }
    }

    /// Sixteen blocks are needed on either flank, and a contact that pushes back.
    #[test]
    fn too_few_blocks_and_a_contact_that_pulls_have_no_law() {
        let active = sensing();
        let of = |terminal: &Terminal| active.solved(terminal, 0).err();
        for (sides, wanted) in [
            ([15, 15], Reason::TooFewReversals),
            ([15, 16], Reason::ForceNeverReverses),
            ([16, 15], Reason::ForceNeverReverses),
            // Blocks of nothing have no stiffness.
            ([16, 16], Reason::FlankTooShort),
        ] {
            let mut terminal = Terminal::new();
            terminal.sides = sides;
            assert_eq!(of(&terminal), Some(wanted), "{sides:?}");
        }
        let (mut rows, travel) = blocks(200, 1000);
        assert_eq!(of(&seen(&(rows.clone(), travel.clone()))), None);
        rows.iter_mut().for_each(|row| row[4] = -row[4]);
        assert_eq!(of(&seen(&(rows, travel))), Some(Reason::FlankTooShort));
    }

    /// The law is solved again after a quarter more blocks and one.
    #[test]
    fn the_law_is_due_with_a_quarter_more_blocks() {
        let active = sensing();
        let law = active.law(&Terminal::new(), 0);
        assert_eq!((law.next, law.compliance), (1, 0.0));
        let blocks = blocks(2000, 1000);
        let mut terminal = seen(&blocks);
        let law = active.law(&terminal, 0);
        assert_eq!(law.next, 2501);
        assert!((law.compliance - 0.5).abs() < 1e-3 && (law.lag - 4.0).abs() < 1e-2);
        assert!(Law::UNKNOWN.is_due(&terminal));
        for more in 0..502 {
            assert_eq!(law.is_due(&terminal), more >= 501, "{more}");
            terminal.totals.update(&products(&[0; 5]));
        }
    }

    /// The law's lag, compliance and variances, by hand.
    #[test]
    fn the_law_is_the_inverse_of_the_contact() {
        let solved = Solved { unknowns: [6.0, 2.0, 0.0, 0.0], errors: [None, Some(0.08), None, None], residual: 12.0 };
        let freed = Freed {
            solved,
            noise: [0.0, 3.0],
            most: [0.0, 8.0],
            own_rate: 0.0,
            own_stretch: 50.0,
            damping_drowned: false,
        };
        let law = freed.law();
        near(law.lag, 3.0, 3.0, "lag");
        near(law.compliance, 0.5, 0.5, "compliance");
        near(law.variance, 3.0, 3.0, "variance");
        let relative = 0.04_f64.powi(2) + (5.0 / (1.959_964 * 50.0_f64)).powi(2);
        near(law.relative, relative, relative, "relative variance");
    }

    /// One reversal by hand: `z + lag z'` goes from 16 to 23 and the force over the stiffness from 3 to 1, so that the
    /// jump is 9. The other way round it is -9.
    #[test]
    fn a_reversal_is_the_jump_from_flank_to_flank() {
        let active = sensing();
        let law = Law { next: 0, lag: 3.0, compliance: 0.5, variance: 40.0, relative: 25.0 };
        let first = Flank { side: -1, blocks: 4, sums: [8, 40, 24], first: 500, last: 1000 };
        let second = Flank { side: 1, blocks: 16, sums: [16, 320, 32], first: 1021, last: 1500 };
        let unit = f64::from(active.unit_m) / 4.0;
        // A quarter and a sixteenth of the variance, the force's part of 2 units, and 0.08 counts of four samples.
        let count = 0.08 * 256.0 * 4.0_f64;
        let error = (40.0 * 5.0 / 16.0 + 4.0 * 25.0 + count * count).sqrt();
        for (rising, jump) in [(true, 9.0), (false, -9.0)] {
            let turned = if rising { 1 } else { -1 };
            let [before, after] = [first, second].map(|flank| Flank { side: turned * flank.side, ..flank });
            let reversal = active.sensed(&law, &Crossing { before, after }).unwrap();
            assert_eq!((reversal.index, reversal.route, reversal.rising), (1010, Route::Terminal, rising));
            near(reversal.value_m, jump * unit, 9.0 * unit, "jump");
            near(reversal.error_m, error * unit, 0.1 * error * unit, "error");
            assert_eq!(active.sensed(&Law::UNKNOWN, &Crossing { before, after }), None);
        }
        let fit = Fit { value: -300, variance: 144, ..Fit::default() };
        let reversal = active.reversal(&fit, true, 77);
        assert_eq!((reversal.index, reversal.route, reversal.rising), (77, Route::Force, true));
        near(reversal.value_m, -300.0 * 4.0 * unit, 300.0 * unit, "value");
        near(reversal.error_m, 12.0 * 4.0 * unit, 12.0 * unit, "error");
    }

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
