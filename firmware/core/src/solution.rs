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
