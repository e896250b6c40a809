//! A factorisation in real numbers: pivots and standard errors, in its equilibrated units.

use crate::ldl::{FACTOR_BITS, MATRIX_BITS, Solution, UNKNOWNS};
use crate::math::{power, single, sqrt};

/// A parameter with a greater component than this in an unobservable direction is unobservable.
const TOUCHED: f32 = 0.02;

/// What is left of an unknown's own variance, or of the force's, once those before it are removed.
pub(crate) fn pivot(solution: &Solution, i: usize) -> f32 {
    single(solution.pivots[i]) * power(-(MATRIX_BITS as i32))
}

/// The inverse of the unknowns' own matrix, in equilibrated units: `sum of direction direction' / pivot`.
pub(crate) struct Inverse {
    /// Rows of the inverse of the unit lower factor; each is the direction that its pivot measures.
    directions: [[f32; UNKNOWNS]; UNKNOWNS],
    pivots: [f32; UNKNOWNS],
}

impl Inverse {
    /// From the factorisation.
    pub fn of(solution: &Solution) -> Self {
        let factor = |row: usize, column: usize| single(solution.factors[row][column]) * power(-(FACTOR_BITS as i32));
        let mut directions = [[0.0_f32; UNKNOWNS]; UNKNOWNS];
        for row in 0..UNKNOWNS {
            let mut direction = [0.0_f32; UNKNOWNS];
            direction[row] = 1.0;
            for (earlier, parts) in directions.iter().enumerate().take(row) {
                let factor = factor(row, earlier);
                for (sum, part) in direction.iter_mut().zip(parts) {
                    *sum -= factor * part;
                }
            }
            directions[row] = direction;
        }
        Self { directions, pivots: core::array::from_fn(|row| pivot(solution, row)) }
    }

    /// Standard errors for a residual variance per observation of `variance`; `None` if an unobservable direction has a
    /// part in the unknown.
    pub fn errors(&self, variance: f32) -> [Option<f32>; UNKNOWNS] {
        let mut diagonal = [0.0_f32; UNKNOWNS];
        for (direction, pivot) in self.directions.iter().zip(self.pivots) {
            for (sum, part) in diagonal.iter_mut().zip(direction) {
                if pivot > 0.0 {
                    *sum += part * part / pivot;
                } else if !(-TOUCHED..=TOUCHED).contains(part) {
                    *sum = f32::INFINITY;
                }
            }
        }
        diagonal.map(|square| square.is_finite().then(|| sqrt(square * variance)))
    }

    /// One column of the inverse, without the unobservable directions.
    pub fn column(&self, i: usize) -> [f32; UNKNOWNS] {
        let mut column = [0.0; UNKNOWNS];
        for (direction, pivot) in self.directions.iter().zip(self.pivots).filter(|(_, pivot)| *pivot > 0.0) {
            let along = direction[i] / pivot;
            column.iter_mut().zip(direction).for_each(|(sum, part)| *sum += part * along);
        }
        column
    }

    /// The inverse times a right-hand side, without the unobservable directions; and that product times the right-hand
    /// side.
    pub fn times(&self, right: [f32; UNKNOWNS]) -> ([f32; UNKNOWNS], f32) {
        let (mut product, mut square) = ([0.0; UNKNOWNS], 0.0);
        for (direction, pivot) in self.directions.iter().zip(self.pivots).filter(|(_, pivot)| *pivot > 0.0) {
            let all = direction.iter().zip(right).map(|(part, right)| part * right).sum::<f32>();
            let along = all / pivot;
            square += all * along;
            product.iter_mut().zip(direction).for_each(|(sum, part)| *sum += part * along);
        }
        (product, square)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::REGRESSORS;

    /// Pivots 1/2, 1/4, none and 1/8. The inverse of the factor has the rows `[1, 0, 0, 0]`, `[-1/2, 1, 0, 0]`,
    /// `[-touch, 0, 1, 0]` and `[1, -2, 0, 1]`.
    fn factorised(touch: f64) -> Solution {
        let pivots = [0.5, 0.25, 0.0, 0.125, 0.0].map(|pivot: f64| (pivot * 2_f64.powi(62)) as i64);
        let mut factors = [[0; REGRESSORS]; REGRESSORS];
        for (row, column, factor) in [(1, 0, 0.5), (2, 0, touch), (3, 1, 2.0)] {
            factors[row][column] = (factor * 2_f64.powi(50)) as i64;
        }
        Solution { pivots, factors, ..Solution::default() }
    }

    /// Of the three directions, the sum of their squares over their pivots: `2 [1, 0]`, `4 [1/4, 1]` and `8 [1, 4]` for
    /// the first two unknowns, and 8 for the last.
    #[test]
    fn errors_are_the_roots_of_the_inverse_where_nothing_unobservable_touches() {
        for (touch, is_touched) in [(0.0, false), (0.018, false), (-0.018, false), (0.022, true), (-0.022, true)] {
            let [first, second, third, fourth] = Inverse::of(&factorised(touch)).errors(4.0);
            assert_eq!((first.is_none(), third), (is_touched, None), "{touch}");
            for (found, squared) in [(first, 44.0), (second, 144.0), (fourth, 32.0)] {
                let Some(found) = found else { continue };
                assert!((found * found / squared - 1.0).abs() < 1e-6, "{touch}: {found} for the root of {squared}");
            }
            assert!(second.is_some() && fourth.is_some());
        }
    }

    /// By hand from the same directions: each times its product with the right-hand side, over its pivot.
    #[test]
    fn columns_and_products_are_those_of_the_inverse() {
        let inverse = Inverse::of(&factorised(0.0));
        assert_eq!(inverse.column(0), [11.0, -18.0, 0.0, 8.0]);
        assert_eq!(inverse.column(1), [-18.0, 36.0, 0.0, -16.0]);
        assert_eq!(inverse.column(2), [0.0; UNKNOWNS]);
        assert_eq!(inverse.times([1.0, 2.0, 3.0, 4.0]), ([7.0, -10.0, 0.0, 8.0], 19.0));
    }

    #[test]
    fn a_pivot_is_its_fraction_of_one() {
        let solution = factorised(0.0);
        assert_eq!([0, 1, 2, 3].map(|i| pivot(&solution, i)), [0.5, 0.25, 0.0, 0.125]);
    }
}
