//! Solution of the normal equations by an equilibrated LDL' factorisation in fixed point.
//!
//! Glossary: the *matrix* is the symmetric 5 x 5 of averaged products, the force last; a *pivot* is what is left of a
//! column's own variance when the columns before it have explained what they can. The last pivot is the variance of
//! the residual. Each row and column is first scaled by a power of two so that the diagonal lies in [1/2, 2).
//! A column whose pivot is under 2^-20 of its own variance cannot be distinguished from the others: it is left out, and
//! the factorisation shows which others this affects.
//! Source: Golub and Van Loan, Matrix Computations, 4th ed., 4.1.

use crate::constants::PIVOT_BITS;
use crate::kernel::REGRESSORS;
use crate::qformat::{mul_shift, widening_mul};
use crate::rls::{PRODUCTS, place};

/// Fraction bits of the matrix and the pivots.
pub const MATRIX_BITS: u32 = 62;
/// Fraction bits of the factors and the solution.
pub const FACTOR_BITS: u32 = 50;

/// Unknowns: all regressors but the force.
pub const UNKNOWNS: usize = REGRESSORS - 1;

/// The factorised matrix and the solution in equilibrated units.
#[derive(Clone, Copy, Debug, Default)]
pub struct Solution {
    /// Left shift that equilibrated each row: the equilibrated regressor is `2^shift` times the original.
    pub shifts: [i8; REGRESSORS],
    /// Pivots [Q62]; 0 where the column was left out.
    pub pivots: [i64; REGRESSORS],
    /// Unit lower factor [Q50], strictly below the diagonal, by rows.
    pub factors: [[i64; REGRESSORS]; REGRESSORS],
    /// Solution [Q50].
    pub unknowns: [i64; UNKNOWNS],
}

/// Factorises and solves. Never fails: a column that cannot be solved for has pivot 0.
#[expect(clippy::needless_range_loop, reason = "the equations are written by row and column")]
pub fn solve(matrix: &[i64; PRODUCTS]) -> Solution {
    let mut solution = Solution::default();
    let mut work = [[0_i64; REGRESSORS]; REGRESSORS];
    equilibrate(matrix, &mut work, &mut solution.shifts);
    let diagonal: [i64; REGRESSORS] = core::array::from_fn(|i| work[i][i]);

    for column in 0..REGRESSORS {
        let pivot = work[column][column];
        let least = (diagonal[column] >> PIVOT_BITS).max(1);
        if column < UNKNOWNS && pivot < least {
            continue;
        }
        solution.pivots[column] = pivot.max(0);
        if column == UNKNOWNS {
            break;
        }
        let reciprocal = Reciprocal::of(pivot);
        for row in column + 1..REGRESSORS {
            let factor = reciprocal.times(work[row][column]);
            solution.factors[row][column] = factor;
            // Ends at `row`; written so that a compiler that optimises for size sees that no index leaves the matrix.
            for inner in column + 1..REGRESSORS {
                if inner > row {
                    break;
                }
                let product = mul_shift(factor, work[inner][column], FACTOR_BITS);
                work[row][inner] = work[row][inner].wrapping_sub(product);
            }
        }
    }

    for row in (0..UNKNOWNS).rev() {
        if solution.pivots[row] == 0 {
            continue;
        }
        let mut value = solution.factors[UNKNOWNS][row];
        for later in row + 1..UNKNOWNS {
            value = value.wrapping_sub(mul_shift(solution.factors[later][row], solution.unknowns[later], FACTOR_BITS));
        }
        solution.unknowns[row] = value;
    }
    solution
}

/// An entry of the triangle. It always exists, which a compiler that optimises for size does not see.
fn entry(matrix: &[i64; PRODUCTS], row: usize, column: usize) -> i64 {
    matrix.get(place(row, column)).copied().unwrap_or_default()
}

fn equilibrate(matrix: &[i64; PRODUCTS], work: &mut [[i64; REGRESSORS]; REGRESSORS], shifts: &mut [i8; REGRESSORS]) {
    for (i, shift) in shifts.iter_mut().enumerate() {
        // Bits up to 2^62, an even number of them.
        let room = entry(matrix, i, i).max(1).leading_zeros().saturating_sub(2) as i8;
        *shift = (room + 1) / 2;
    }
    for row in 0..REGRESSORS {
        for column in 0..REGRESSORS {
            if column > row {
                break;
            }
            let shift = (shifts[row] + shifts[column]) as u32;
            work[row][column] = entry(matrix, row, column).checked_shl(shift).unwrap_or(0);
        }
    }
}

/// The inverse of a positive Q62 number.
struct Reciprocal {
    /// `2^124 / (pivot * 2^normalising)`, in (2^61, 2^62].
    mantissa: i64,
    /// Left shift that brings the pivot to [2^62, 2^63).
    normalising: u32,
}

impl Reciprocal {
    /// Of a positive pivot, accurate to about 58 bits.
    fn of(pivot: i64) -> Self {
        let pivot = pivot.max(1);
        let normalising = pivot.leading_zeros() - 1;
        let divisor = pivot << normalising;
        // A 32-bit division gives 15 bits; each Newton step, x += x (1 - d x), doubles them. A 64-bit division costs
        // more.
        let seed = i64::from(u32::MAX / ((divisor >> 46) as u32).max(1)) << 46;
        let refine = |estimate: i64| {
            let (product, _) = widening_mul(divisor, estimate);
            let error = (1_i64 << 60) - product;
            estimate + mul_shift(estimate, error, 60)
        };
        Self { mantissa: refine(refine(seed)), normalising }
    }

    /// `value / pivot` [Q50] of a value [Q62], rounded down; clamped to +-2^62.
    fn times(&self, value: i64) -> i64 {
        const LIMIT: i64 = 1 << 62;
        let (high, low) = widening_mul(value, self.mantissa);
        // Between 12 and 74.
        let shift = 74 - self.normalising;
        if shift >= 64 {
            return high >> (shift - 64);
        }
        // `high << (64 - shift)` must stay below 2^62.
        if high.unsigned_abs() >> (shift - 2) != 0 {
            return if high < 0 { -LIMIT } else { LIMIT };
        }
        (high << (64 - shift)) | (low >> shift) as i64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use inerter_needs::Random;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn reciprocal_divides(pivot in 1_i64 << 40..1 << 62, value in -(1_i64 << 62)..1 << 62) {
            let quotient = Reciprocal::of(pivot).times(value);
            let exact = (i128::from(value) << 50) / i128::from(pivot);
            if exact.abs() < 1 << 61 {
                prop_assert!((i128::from(quotient) - exact).abs() <= 2 + (exact.abs() >> 56), "{quotient} {exact}");
            }
        }

        /// From pivots of any size, quotients of any size: exact, or the limit.
        #[test]
        fn reciprocal_of_any_pivot_divides_up_to_the_limit(
            pivot in 1_i64 << 60..i64::MAX,
            value in -(1_i64 << 62)..1 << 62,
            narrow in 0_u32..60,
            small in 0_u32..60,
        ) {
            let (pivot, value) = (pivot >> narrow, value >> small);
            let quotient = i128::from(Reciprocal::of(pivot).times(value));
            let exact = (i128::from(value) << 50) / i128::from(pivot);
            let limit = 1_i128 << 62;
            if exact.abs() > limit + 256 {
                prop_assert_eq!(quotient, limit * exact.signum());
            } else if exact.abs() < limit - 256 {
                prop_assert!((quotient - exact).abs() <= 2 + (exact.abs() >> 56), "{quotient} {exact}");
            }
        }

        #[test]
        fn nothing_panics(matrix: [i64; PRODUCTS]) {
            solve(&matrix);
        }
    }

    /// Averages of a known linear law come back as the law.
    #[test]
    fn solves_a_known_law() {
        let mut sums = [0_i128; PRODUCTS];
        let mut numbers = Random(1);
        let mut random = || numbers.below(1_i32 << 28) - (1 << 27);
        for _ in 0..1000 {
            let [a, v, s] = [random() >> 12, random(), random().signum() << 30];
            let force = 300 * a + v / 4 - s / 8 + (1 << 20);
            for (sum, product) in sums.iter_mut().zip(crate::rls::products(&[a, v, s, 1 << 30, force])) {
                *sum += i128::from(product);
            }
        }
        let solution = solve(&sums.map(|sum| (sum / 1000) as i64));
        let value = |i: usize| {
            solution.unknowns[i] as f64
                * 2_f64.powi(-50)
                * 2_f64.powi(i32::from(solution.shifts[i]) - i32::from(solution.shifts[UNKNOWNS]))
        };
        assert!((value(0) - 300.0).abs() < 1e-4, "{}", value(0));
        assert!((value(1) - 0.25).abs() < 1e-7, "{}", value(1));
        assert!((value(2) + 0.125).abs() < 1e-9, "{}", value(2));
        assert!((value(3) - 2_f64.powi(-10)).abs() < 1e-9, "{}", value(3));
    }

    /// At constant velocity, sign, constant and velocity cannot be distinguished.
    #[test]
    fn leaves_out_what_cannot_be_told_apart() {
        let regressors = [1 << 20, 1 << 24, 1 << 30, 1 << 30, 1 << 25];
        let other = [-(1 << 20), 1 << 24, 1 << 30, 1 << 30, 1 << 24];
        let mut matrix = crate::rls::products(&regressors);
        for (sum, product) in matrix.iter_mut().zip(crate::rls::products(&other)) {
            *sum = *sum / 2 + product / 2;
        }
        let solution = solve(&matrix);
        assert!(solution.pivots[0] > 0);
        assert_eq!(
            solution.pivots.iter().filter(|&&pivot| pivot == 0).count(),
            2 + usize::from(solution.pivots[4] == 0)
        );
    }

    /// A square of any size is shifted by an even number of bits to between a half and two.
    #[test]
    fn diagonals_of_any_size_are_brought_near_one() {
        for bit in 1..62_u32 {
            for square in [1_i64 << bit, 3 << (bit - 1), (2 << bit) - 1] {
                let mut matrix = [0; PRODUCTS];
                (0..REGRESSORS).for_each(|i| matrix[place(i, i)] = square);
                let solution = solve(&matrix);
                for (pivot, shift) in solution.pivots.into_iter().zip(solution.shifts) {
                    assert_eq!(i128::from(pivot), i128::from(square) << (2 * shift), "{square}");
                    assert!(pivot >= 1 << 61, "{square}: {pivot}");
                }
                assert_eq!((solution.factors, solution.unknowns), ([[0; REGRESSORS]; REGRESSORS], [0; UNKNOWNS]));
            }
        }
    }

    /// A matrix that was multiplied from its factors comes apart into them, and its unknowns are the last row through
    /// the transposed factor, by hand.
    #[test]
    fn a_product_of_factors_comes_apart_into_them() {
        let lower = [
            [1.0, 0.0, 0.0, 0.0, 0.0],
            [0.5, 1.0, 0.0, 0.0, 0.0],
            [-0.5, 0.25, 1.0, 0.0, 0.0],
            [0.25, 0.0, 0.5, 1.0, 0.0],
            [0.5, -0.25, 0.125, 0.5, 1.0],
        ];
        let pivots = [1.0, 0.5, 0.5, 0.5, 0.25];
        let mut matrix = [0; PRODUCTS];
        for row in 0..REGRESSORS {
            for column in 0..=row {
                let sum: f64 = (0..=column).map(|k| lower[row][k] * lower[column][k] * pivots[k]).sum();
                matrix[place(row, column)] = (sum * 2_f64.powi(62)) as i64;
            }
        }
        let solution = solve(&matrix);
        let near = |found: i64, bits: u32, wanted: f64| (found as f64 / 2_f64.powi(bits as i32) - wanted).abs() < 1e-12;
        for (row, (pivot, wanted)) in solution.pivots.into_iter().zip(pivots).enumerate() {
            assert!(near(pivot, MATRIX_BITS, wanted), "{row}: {pivot} for {wanted}");
            for (column, factor) in solution.factors[row].into_iter().enumerate() {
                let wanted = if column < row { lower[row][column] } else { 0.0 };
                assert!(near(factor, FACTOR_BITS, wanted), "{row} {column}: {factor}");
            }
        }
        assert_eq!(solution.shifts, [0; REGRESSORS]);
        for (found, wanted) in solution.unknowns.into_iter().zip([0.421_875, -0.218_75, -0.125, 0.5]) {
            assert!(near(found, FACTOR_BITS, wanted), "{found} for {wanted}");
        }
    }
}
