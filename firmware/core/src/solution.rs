//! What a factorisation says in real numbers: pivots and standard errors, in its equilibrated units.

use crate::ldl::{FACTOR_BITS, MATRIX_BITS, Solution, UNKNOWNS};
use crate::math::{power, sqrt};

/// Component of an unobservable direction that makes a parameter unobservable.
const TOUCHED: f32 = 0.02;

/// What is left of an unknown's own variance, or of the force's, once those before it are out.
pub(crate) fn pivot(solution: &Solution, i: usize) -> f32 {
    solution.pivots[i] as f32 * power(-(MATRIX_BITS as i32))
}

/// Standard error of each unknown in equilibrated units for a residual variance per observation of `variance`;
/// nothing where an unobservable direction has a part in it.
pub(crate) fn standard_errors(solution: &Solution, variance: f32) -> [Option<f32>; UNKNOWNS] {
    let factor = |row: usize, column: usize| solution.factors[row][column] as f32 * power(-(FACTOR_BITS as i32));
    let mut errors = [Some(0.0_f32); UNKNOWNS];
    // Row by row of the inverse of the unit lower factor; each is the direction that its pivot measures.
    let mut inverse = [[0.0_f32; UNKNOWNS]; UNKNOWNS];
    for row in 0..UNKNOWNS {
        let mut direction = [0.0_f32; UNKNOWNS];
        direction[row] = 1.0;
        for (earlier, parts) in inverse.iter().enumerate().take(row) {
            let factor = factor(row, earlier);
            for (sum, part) in direction.iter_mut().zip(parts) {
                *sum -= factor * part;
            }
        }
        inverse[row] = direction;
        let pivot = pivot(solution, row);
        for (error, part) in errors.iter_mut().zip(direction) {
            if pivot > 0.0 {
                *error = error.map(|sum| sum + part * part / pivot);
            } else if !(-TOUCHED..=TOUCHED).contains(&part) {
                *error = None;
            }
        }
    }
    errors.map(|sum| sum.map(|sum| sqrt(sum * variance)))
}
