//! Fits in f64 to the exact sums that core publishes, as a host computes them.

use crate::linear::Cholesky;
use inerter_core::{MoreSums, Sums};
use inerter_data::replay::Outcome;

/// Regressors `a, v, s, 1, F, |v|, dF/dt`, in this order.
pub const REGRESSORS: usize = 7;
/// Index of the force, here and in a row of [`updates`](crate::updates).
const FORCE: usize = 4;

/// Part of its diagonal within which a matrix of sums must be positive definite.
pub const SEPARABLE: f64 = 1e-13;

/// Sums of products in SI units.
pub fn matrix(sums: &Sums, more: &MoreSums) -> [[f64; REGRESSORS]; REGRESSORS] {
    assert_eq!((sums.index, sums.bank, sums.updates), (more.index, more.bank, more.updates), "of one moment");
    let units: Vec<f64> = sums.units.into_iter().chain(more.units).collect();
    let products: Vec<i128> = sums.sums.into_iter().chain(more.sums).collect();
    std::array::from_fn(|i| {
        std::array::from_fn(|k| {
            let (row, column) = (i.max(k), i.min(k));
            products[row * (row + 1) / 2 + column] as f64 * units[row] * units[column]
        })
    })
}

/// Ratio of the residual's rms to the rms of the filtered force, including its offset.
pub fn part_left(outcome: &Outcome) -> f64 {
    let (sums, more) = outcome.sums();
    let mean_square = matrix(sums, more)[FORCE][FORCE] / f64::from(sums.updates);
    f64::from(outcome.estimate.residual_rms_n) / mean_square.sqrt()
}

/// Sums of the products of the columns.
pub fn gram<const N: usize>(rows: impl Iterator<Item = [f64; N]>) -> [[f64; N]; N] {
    let mut gram = [[0.0; N]; N];
    for row in rows {
        for (line, a) in gram.iter_mut().zip(row) {
            for (sum, b) in line.iter_mut().zip(row) {
                *sum += a * b;
            }
        }
    }
    gram
}

/// Coefficients of these regressors in the force; `None` if the motion cannot separate them: the matrix is not positive
/// definite within `least` of its diagonal.
pub fn fit<const N: usize, const M: usize>(
    matrix: &[[f64; M]; M],
    regressors: [usize; N],
    least: f64,
) -> Option<[f64; N]> {
    let inner = regressors.map(|row| regressors.map(|column| matrix[row][column]));
    Some(Cholesky::of(&inner, least)?.solve(&regressors.map(|row| matrix[row][FORCE])))
}

/// Friction by direction, assuming a force offset of 0: `fc+ - fc-` and twice the offset cannot be separated.
#[derive(Clone, Copy, Debug)]
pub struct Directions {
    /// Inertance with the structure mass \[kg\].
    pub inertance_kg: f64,
    /// Viscous friction of positive and negative motion \[N s/m\].
    pub viscous_n_s_per_m: [f64; 2],
    /// Coulomb friction of positive and negative motion \[N\].
    pub coulomb_n: [f64; 2],
}

/// `F = mt a + (cf+ + cf-)/2 v + (cf+ - cf-)/2 |v| + (fc+ + fc-)/2 s + (fc+ - fc-)/2`.
pub fn directions(sums: &Sums, more: &MoreSums) -> Option<Directions> {
    let [inertance_kg, v, s, one, speed] = fit(&matrix(sums, more), [0, 1, 2, 3, 5], SEPARABLE)?;
    Some(Directions { inertance_kg, viscous_n_s_per_m: [v + speed, v - speed], coulomb_n: [s + one, s - one] })
}

/// The remaining delay of the force relative to the position \[s\].
pub fn skew_s(sums: &Sums, more: &MoreSums) -> Option<f64> {
    // F(t) = law(t - tau) = law(t) - tau dF/dt.
    fit(&matrix(sums, more), [0, 1, 2, 3, 6], SEPARABLE).map(|[.., rate]| -rate)
}
