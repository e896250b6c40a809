//! Least squares of the force on the law and the causes found, and how much of the rest a group of columns would
//! explain.

use nalgebra::{DMatrix, DVector};

use super::{
    candidate::{Found, Term},
    columns::Rows,
};
use crate::law::{dot, inverse, less, products, products_with, scaled, scales};

/// Index of the sign among the columns.
pub(super) const SIGN: usize = 2;
/// Fraction of a column's square that the law and the added terms must leave.
const LEAST_LEFT: f64 = 1e-4;
/// Parts of a run, of which all except two adjacent ones must agree.
const PARTS: usize = 40;
/// How much the encoder's steps weaken the acceleration, relative to white noise of their size: known to a factor of
/// two (docs/THEORY.md, 6).
const TAKEN: [f64; 3] = [0.0, 1.0, 1.5];
/// Their maximum fraction of what the other columns leave of the acceleration.
const MOST_TAKEN: f64 = 0.5;
/// Strength from which a candidate is examined more closely.
const WORTH_A_LOOK: f64 = 10.0;
/// Minimum ratio of the square left of a column to that of its noise.
const LEAST_OVER_NOISE: f64 = 25.0;

/// A fit to all rows.
pub(super) struct Model<'a> {
    rows: &'a Rows<'a>,
    columns: Vec<Vec<f64>>,
    gram: DMatrix<f64>,
    right: DVector<f64>,
    /// How much the steps may take from the acceleration's square.
    taken: Vec<f64>,
    /// The steps' fraction of what the other columns leave of the acceleration, taken as white noise.
    pub steps: f64,
    /// Coefficients of all columns.
    pub values: DVector<f64>,
    /// Residual of the force in each row \[N\].
    residual: Vec<f64>,
}

impl<'a> Model<'a> {
    /// The fit to all these columns, the first of which is the acceleration; `None` if they cannot be separated.
    pub fn of(rows: &'a Rows<'a>, columns: Vec<Vec<f64>>) -> Option<Self> {
        let count = columns.len();
        let mut gram = DMatrix::from_fn(count, count, |i, j| if i < j { 0.0 } else { dot(&columns[i], &columns[j]) });
        gram.fill_upper_triangle_with_lower_triangle();
        let right = products_with(&columns, &rows.force);
        let values = solved(&gram, &right)?;
        let residual = less(&rows.force, &columns, values.as_slice());
        let mut unit = DVector::<f64>::zeros(count);
        unit[0] = 1.0;
        let acceleration_left = solved(&gram, &unit)?[0].recip();
        let steps = rows.filter.acceleration_square * rows.force.len() as f64;
        // If they are more than that fraction of what remains, nothing is known.
        let taken = TAKEN.map(|part| part * steps).into_iter();
        let taken = taken.filter(|taken| *taken <= MOST_TAKEN * acceleration_left).collect();
        Some(Self { rows, columns, gram, right, taken, steps: steps / acceleration_left, values, residual })
    }

    /// The bias of each coefficient due to the encoder's steps, taken as white noise; `None` if they may account for
    /// everything.
    pub fn taken_by_steps(&self) -> Option<DVector<f64>> {
        let mut gram = self.gram.clone();
        gram[(0, 0)] -= self.rows.filter.acceleration_square * self.residual.len() as f64;
        Some(solved(&gram, &self.right)? - &self.values)
    }

    /// The same with more columns.
    pub fn beside(&self, more: impl IntoIterator<Item = Vec<f64>>) -> Option<Self> {
        Self::of(self.rows, self.columns.iter().cloned().chain(more).collect())
    }

    /// The coefficients of this column's regression on the columns of the model.
    pub fn along(&self, column: &[f64]) -> Option<DVector<f64>> {
        solved(&self.gram, &products_with(&self.columns, column))
    }

    /// RMS residual.
    pub fn residual_rms(&self) -> f64 {
        (self.left() / self.residual.len() as f64).sqrt()
    }

    /// Degrees of freedom, with this many more columns.
    pub fn freedom(&self, more: usize) -> f64 {
        self.residual.len() as f64 / self.rows.per_observation - (self.columns.len() + more) as f64
    }

    /// Sum of the squared residuals.
    pub fn left(&self) -> f64 {
        dot(&self.residual, &self.residual)
    }

    /// The same with one more column: separate, or added to the sign's.
    pub fn left_with(&self, new: &[f64], to_sign: bool) -> Option<f64> {
        let count = self.columns.len();
        let across = products_with(&self.columns, new);
        let (own, right) = (dot(new, new), dot(new, &self.rows.force));
        let (gram, right) = if to_sign {
            let (mut gram, mut rights) = (self.gram.clone(), self.right.clone());
            for i in 0..count {
                gram[(i, SIGN)] += across[i];
                gram[(SIGN, i)] += across[i];
            }
            gram[(SIGN, SIGN)] += own;
            rights[SIGN] += right;
            (gram, rights)
        } else {
            let mut gram = self.gram.clone().resize(count + 1, count + 1, own);
            for i in 0..count {
                (gram[(i, count)], gram[(count, i)]) = (across[i], across[i]);
            }
            (gram, self.right.clone().push(right))
        };
        let values = solved(&gram, &right)?;
        Some(dot(&self.rows.force, &self.rows.force) - values.dot(&right))
    }

    /// Noise variance of an observation; repeated errors count in full.
    pub fn square(&self) -> f64 {
        self.left() / self.freedom(0).max(1.0) * self.rows.filter.inflation()
    }

    /// The variance of a weighted sum of coefficients, each given by its index: from the noise of an observation, with
    /// repeated errors counted in full, or from the differences between the parts of the run, whichever makes the sum
    /// less certain.
    pub fn variance(&self) -> Option<impl Fn(&[(usize, f64)]) -> f64> {
        let inverse = inverse(&self.gram)?;
        let by_scatter = &inverse * self.scatter(&self.columns, &self.residual) * &inverse;
        let by_noise = inverse * self.square();
        Some(move |sum: &[(usize, f64)]| {
            let variance = |matrix: &DMatrix<f64>| {
                let pairs = sum.iter().flat_map(|(i, a)| sum.iter().map(move |(j, b)| (*i, *j, a * b)));
                pairs.map(|(i, j, weight)| weight * matrix[(i, j)]).sum::<f64>()
            };
            variance(&by_noise).max(variance(&by_scatter)).max(0.0)
        })
    }

    /// Scatter between the parts of the run, for these columns and a residual: the sum of the squares of their
    /// products.
    fn scatter(&self, columns: &[Vec<f64>], residual: &[f64]) -> DMatrix<f64> {
        let scores = self.scores(columns, residual);
        let all = scores
            .iter()
            .fold(DMatrix::zeros(columns.len(), columns.len()), |sum, score| sum + score * score.transpose());
        let known = self.columns.len().min(PARTS - 1);
        all * (PARTS as f64 / (PARTS - known) as f64)
    }

    /// Products of columns with a residual in each part of the run.
    fn scores(&self, columns: &[Vec<f64>], residual: &[f64]) -> Vec<DVector<f64>> {
        let length = residual.len().div_ceil(PARTS).max(1);
        let of_part = |part: usize| {
            let within = (part * length).min(residual.len())..((part + 1) * length).min(residual.len());
            let left = &residual[within.clone()];
            let each = columns.iter().map(|column| dot(&column[within.clone()], left));
            DVector::from_iterator(columns.len(), each)
        };
        (0..PARTS).map(of_part).collect()
    }

    /// What a term with these columns would explain; `noise_square` is the mean square of the noise in each of them.
    /// `None` if too little of it remains, or if its size is implausible for the Coulomb friction that then results
    /// \[N\].
    pub fn evidence(
        &self,
        term: Term,
        group: &[Vec<f64>],
        noise_square: f64,
        can_be: impl Fn(f64, f64) -> bool,
    ) -> Option<Found> {
        let width = group.len();
        let rows = self.residual.len() as f64;
        let across = products(&self.columns, group);
        let own = products(group, group);
        let right = products_with(group, &self.rows.force);
        let mut least: Option<(f64, DVector<f64>, DMatrix<f64>)> = None;
        for taken in &self.taken {
            let mut gram = self.gram.clone();
            gram[(0, 0)] -= taken;
            let along = part_of(&gram, &across)?;
            let left = &own - across.transpose() * &along;
            let least_left = |k: usize| (LEAST_LEFT * own[(k, k)]).max(LEAST_OVER_NOISE * noise_square * rows);
            if (0..width).any(|k| left[(k, k)] <= least_left(k)) {
                return None;
            }
            let of_residual = &right - along.transpose() * &self.right;
            let sizes = solved(&left, &of_residual)?;
            let explained = sizes.dot(&of_residual);
            if least.as_ref().is_none_or(|(before, ..)| explained < *before) {
                least = Some((explained, sizes, along));
            }
        }
        let (explained, sizes, along) = least?;
        let beside = |place: usize| self.values[place] - (along.row(place) * &sizes)[0];
        if width == 1 && !can_be(sizes[0], beside(SIGN)) {
            return None;
        }
        let square = (self.left() - explained).max(f64::MIN_POSITIVE) / self.freedom(width).max(1.0);
        let strength = explained / (square * self.rows.filter.inflation());
        let strength = if strength < WORTH_A_LOOK { strength } else { self.agreed(group, &along, &sizes, strength) };
        let sizes = [sizes[0], sizes.get(1).copied().unwrap_or(0.0)];
        Some(Found { term, sizes, strength, rival: None, is_whole: false })
    }

    /// The part of a strength on which the parts of the run agree: a single event is not a cause, and the residual
    /// scatters between the parts by more than white noise if something else is wrong.
    fn agreed(&self, group: &[Vec<f64>], along: &DMatrix<f64>, sizes: &DVector<f64>, strength: f64) -> f64 {
        // What the other columns leave of these, and what these leave of the force.
        let left_of = |(k, new): (usize, &Vec<f64>)| less(new, &self.columns, along.column(k).as_slice());
        let own: Vec<Vec<f64>> = group.iter().enumerate().map(left_of).collect();
        let after = less(&self.residual, &own, sizes.as_slice());
        let said: Vec<f64> = self.scores(&own, &self.residual).iter().map(|score| score.dot(sizes)).collect();
        let explained: f64 = said.iter().sum();
        let most = said.windows(2).map(|pair| pair.iter().sum::<f64>()).fold(0.0, f64::max);
        let lasting = ((explained - most).max(0.0) / explained * PARTS as f64 / (PARTS - 2) as f64).min(1.0);
        let scatter = self.scatter(&own, &after);
        let against = products(&own, &own) * sizes;
        let by_scatter = solved(&scatter, &against).map_or(0.0, |part| part.dot(&against));
        lasting * strength.min(by_scatter)
    }
}

/// Least squares through the normal equations.
fn solved(gram: &DMatrix<f64>, right: &DVector<f64>) -> Option<DVector<f64>> {
    let part = part_of(gram, &DMatrix::from_column_slice(right.len(), 1, right.as_slice()))?;
    Some(part.column(0).into_owned())
}

/// The same for several right-hand sides.
fn part_of(gram: &DMatrix<f64>, right: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let unit = scales(gram);
    let in_units =
        |matrix: &DMatrix<f64>| DMatrix::from_fn(matrix.nrows(), matrix.ncols(), |i, j| matrix[(i, j)] * unit[i]);
    let part = scaled(gram, &unit).cholesky()?.solve(&in_units(right));
    part.iter().all(|value| value.is_finite()).then(|| in_units(&part))
}
