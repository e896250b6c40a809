//! The law `F = mt a + cf v + fc sgn(v) + F0` against the measured force, both through the estimator's kernels.
//!
//! The kernels are core's (docs/THEORY.md, 1) in f64, centred instead of delayed, so the result is what the estimator
//! compares. The structure mass adds `mr x1''` to the law, with `x1'' = a + F''/ks - cs F'''/ks^2`; the skew is
//! corrected by whole samples, and its remainder in the force by a series.

use inerter_core::constants::{FORCE_TAPS, LONGEST_SPACING, RATE_TAPS, REST_COUNTS, SIGN_TAPS};
use inerter_core::{Bank, Parameter, Parameters, Settings};
use inerter_data::series::Stretch;
use nalgebra::{DMatrix, DVector};

/// Minimum independent observations for a judgement on terms beyond the law.
pub(crate) const LEAST_OBSERVATIONS: f64 = 30.0;

/// Velocities over which friction falls, relative to the motion's rms.
pub(crate) const FALLS: [f64; 7] = [0.03, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0];
/// Distances over which friction reverses, relative to the motion's stroke.
pub(crate) const TURNS: [f64; 8] = [0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1];
/// Friction per force above which a screw is self-locking.
pub(crate) const MOST_LOAD: f64 = 0.5;

/// Values of the law.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Law {
    /// Effective inertance \[kg\].
    pub inertance_kg: f64,
    /// Viscous friction \[N s/m\].
    pub viscous_n_s_per_m: f64,
    /// Coulomb friction \[N\].
    pub coulomb_n: f64,
    /// Force offset \[N\].
    pub offset_n: f64,
}

impl Law {
    /// The estimator's values for the whole run, with the structure's mass in the inertance.
    pub(crate) fn of_run(found: &Parameters, settings: &Settings) -> Self {
        let value = |parameter: Parameter| f64::from(parameter.fitted().value);
        Self {
            inertance_kg: value(found.inertance_kg) + settings.structure_mass_kg,
            viscous_n_s_per_m: value(found.viscous_n_s_per_m),
            coulomb_n: value(found.coulomb_n),
            offset_n: value(found.offset_n),
        }
    }
}

/// The kernels of one bank, as taps centred on a sample.
pub struct Kernels {
    pub(crate) force: Vec<f64>,
    pub(crate) rate: Vec<f64>,
    pub(crate) second: Vec<f64>,
    pub(crate) third: Vec<f64>,
    pub(crate) sign: Vec<f64>,
    pub(crate) box_samples: usize,
    pub(crate) period_s: f64,
}

/// The kernels' outputs at a sample.
pub(crate) struct Measured {
    /// Force, with the skew corrected \[N\].
    pub force_n: f64,
    /// Velocity \[m/s\].
    pub velocity: f64,
    /// Acceleration \[m/s^2\].
    pub acceleration: f64,
    /// By how much the terminal's acceleration is larger \[m/s^2\].
    pub stretch: f64,
}

impl Measured {
    /// Force on the screw \[N\]: without the structure's extra force compared with a structure that moves with the
    /// screw.
    pub(crate) fn on_screw_n(&self, settings: &Settings) -> f64 {
        self.force_n - settings.structure_mass_kg * self.stretch
    }
}

impl Kernels {
    /// The kernels of a bank at a sample rate.
    pub fn new(bank: Bank, period_s: f64) -> Self {
        Self::of_box(bank.box_s(), period_s)
    }

    /// The kernels of a box of this length \[s\] at a sample rate.
    pub(crate) fn of_box(box_s: f64, period_s: f64) -> Self {
        let m = 2 * ((box_s / period_s / 2.0).round().clamp(1.0, LONGEST_SPACING) as usize);
        let (length, t) = (m as f64, period_s);
        let smooth = vec![1.0 / length; m];
        let mut difference = vec![0.0; m + 1];
        // Taps run forward in time: the later sample counts positive.
        (difference[0], difference[m]) = (-1.0 / (length * t), 1.0 / (length * t));
        let made = |derivative: usize, correction: &[f64]| {
            let gain: f64 = correction.iter().sum();
            let correction: Vec<f64> = correction.iter().map(|tap| tap / gain).collect();
            let steps = (0..4).map(|step| if step < derivative { &difference } else { &smooth });
            steps.fold(correction, |taps, step| convolved(&taps, step))
        };
        Self {
            force: made(0, &FORCE_TAPS),
            rate: made(1, &RATE_TAPS),
            second: made(2, &[1.0]),
            third: made(3, &[1.0, 1.0]),
            sign: made(0, &SIGN_TAPS),
            box_samples: m,
            period_s,
        }
    }

    /// Half length of the longest kernel \[samples\].
    pub(crate) fn reach(&self) -> usize {
        [&self.force, &self.rate, &self.second, &self.third, &self.sign]
            .iter()
            .map(|taps| taps.len() / 2)
            .max()
            .unwrap_or(0)
    }

    /// The kernels' outputs at a sample of an aligned series.
    pub(crate) fn measured(&self, piece: &Stretch, settings: &Settings, middle: usize) -> Measured {
        let Settings { stiffness_n_per_m: ks, contact_damping_n_s_per_m: cs, .. } = *settings;
        let (_, skew_s) = settings.skew_parts();
        let of = |taps: &[f64], data: &[f64]| around(taps, data, middle);
        let force = &piece.force_n;
        let [rate, second, third] = [&self.rate, &self.second, &self.third].map(|taps| of(taps, force));
        Measured {
            force_n: of(&self.force, force) + skew_s * (rate + skew_s / 2.0 * (second + skew_s / 3.0 * third)),
            velocity: of(&self.rate, &piece.position_m),
            acceleration: of(&self.second, &piece.position_m),
            stretch: if ks > 0.0 { (second + (skew_s - cs / ks) * third) / ks } else { 0.0 },
        }
    }
}

/// Whether the screw is at rest throughout these positions \[m\].
pub(crate) fn stands(positions: &[f64], settings: &Settings) -> bool {
    let still_m = (REST_COUNTS * settings.metres_per_count.abs()).max(settings.stuck_displacement_m);
    extent(positions.iter().copied()) <= still_m * (1.0 + 1e-6)
}

/// The mean; NaN if there are no values.
pub(crate) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// The median; `None` if there are no values.
pub(crate) fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// The minimum and the maximum.
pub(crate) fn ends(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)))
}

/// The maximum minus the minimum.
pub(crate) fn extent(values: impl Iterator<Item = f64>) -> f64 {
    let (low, high) = ends(values);
    high - low
}

/// Marks up to `count` samples from `from` on.
pub(crate) fn mark(samples: &mut [bool], from: usize, count: usize) {
    samples.iter_mut().skip(from).take(count).for_each(|sample| *sample = true);
}

pub(crate) fn convolved(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut taps = vec![0.0; a.len() + b.len() - 1];
    for (at, left) in a.iter().enumerate() {
        for (tap, right) in taps.iter_mut().skip(at).zip(b) {
            *tap += left * right;
        }
    }
    taps
}

/// Convolves taps centred on one sample. All kernels have odd length.
pub(crate) fn around(taps: &[f64], data: &[f64], middle: usize) -> f64 {
    let first = middle.saturating_sub(taps.len() / 2).min(data.len());
    dot(taps, &data[first..])
}

/// Sum of the products of two columns, over their common length. It uses eight partial sums, which the processor adds
/// in parallel.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    const SIDE: usize = 8;
    let both = a.len().min(b.len());
    let (a, b) = (a[..both].chunks_exact(SIDE), b[..both].chunks_exact(SIDE));
    let rest = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let left = rest(a.remainder(), b.remainder());
    let mut sums = [0.0; SIDE];
    for (a, b) in a.zip(b) {
        sums.iter_mut().zip(a.iter().zip(b)).for_each(|(sum, (a, b))| *sum += a * b);
    }
    left + sums.iter().sum::<f64>()
}

/// Products of all columns with all of others.
pub(crate) fn products(columns: &[Vec<f64>], others: &[Vec<f64>]) -> DMatrix<f64> {
    DMatrix::from_fn(columns.len(), others.len(), |i, j| dot(&columns[i], &others[j]))
}

/// Products of all columns with one.
pub(crate) fn products_with(columns: &[Vec<f64>], one: &[f64]) -> DVector<f64> {
    DVector::from_iterator(columns.len(), columns.iter().map(|column| dot(column, one)))
}

/// A column minus these multiples of others.
pub(crate) fn less(column: &[f64], others: &[Vec<f64>], parts: &[f64]) -> Vec<f64> {
    let mut left = column.to_vec();
    for (other, part) in others.iter().zip(parts) {
        left.iter_mut().zip(other).for_each(|(left, other)| *left -= part * other);
    }
    left
}

/// Scale factors that make the diagonal one.
pub(crate) fn scales(gram: &DMatrix<f64>) -> Vec<f64> {
    gram.diagonal().iter().map(|square| square.sqrt().recip()).collect()
}

/// Scales rows and columns.
pub(crate) fn scaled(matrix: &DMatrix<f64>, unit: &[f64]) -> DMatrix<f64> {
    DMatrix::from_fn(unit.len(), unit.len(), |i, j| matrix[(i, j)] * unit[i] * unit[j])
}

/// Inverse of the columns' Gram matrix; `None` if the columns cannot be separated.
pub(crate) fn inverse(gram: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let unit = scales(gram);
    Some(scaled(&scaled(gram, &unit).cholesky()?.inverse(), &unit))
}

/// Least squares of rows on columns.
pub(crate) struct Squares {
    pub columns: Vec<Vec<f64>>,
    /// Inverse of the columns' Gram matrix.
    pub inverse: DMatrix<f64>,
    pub values: DVector<f64>,
    pub residual: Vec<f64>,
}

/// The effect of one more column.
pub(crate) struct More {
    /// Its coefficient.
    pub size: f64,
    /// Fraction of its square that the others leave.
    pub left: f64,
    /// Square that it would explain.
    pub explained: f64,
    /// What it would take from the coefficients of the others, per unit of its own coefficient.
    along: DVector<f64>,
    /// Square of what the others leave of it.
    square: f64,
}

impl Squares {
    /// Fits the columns; `None` if they cannot be separated.
    pub fn of(force: &[f64], columns: Vec<Vec<f64>>) -> Option<Self> {
        let inverse = inverse(&products(&columns, &columns))?;
        let values = &inverse * products_with(&columns, force);
        let residual = less(force, &columns, values.as_slice());
        Some(Self { columns, inverse, values, residual })
    }

    /// Mean square residual.
    pub fn square(&self) -> f64 {
        dot(&self.residual, &self.residual) / self.residual.len() as f64
    }

    /// Weight of each row in the coefficient at this index.
    pub fn weights(&self, place: usize) -> Vec<f64> {
        let mut weights = vec![0.0; self.residual.len()];
        for (i, column) in self.columns.iter().enumerate() {
            let part = self.inverse[(place, i)];
            weights.iter_mut().zip(column).for_each(|(weight, value)| *weight += part * value);
        }
        weights
    }

    /// The effect of adding a column.
    pub fn with(&self, column: &[f64]) -> More {
        let along = &self.inverse * products_with(&self.columns, column);
        let alone = less(column, &self.columns, along.as_slice());
        let (square, all) = (dot(&alone, &alone), dot(column, column));
        let said = dot(&alone, &self.residual);
        More { size: said / square, left: square / all, explained: said * said / square, along, square }
    }
}

impl More {
    /// By how much it shifts the coefficient at this index, and the square of the shift by chance, per mean square
    /// residual of an independent row.
    pub fn moves(&self, place: usize) -> (f64, f64) {
        (-self.along[place] * self.size, self.along[place] * self.along[place] / self.square)
    }
}

#[cfg(test)]
#[path = "law_tests.rs"]
mod tests;
