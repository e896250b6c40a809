//! Least squares of rows on columns, and the effect of one more column.

use nalgebra::{DMatrix, DVector};

use crate::law::{self, less};

pub(super) struct Squares {
    pub columns: Vec<Vec<f64>>,
    /// Inverse of the columns' Gram matrix.
    pub inverse: DMatrix<f64>,
    pub values: DVector<f64>,
    pub residual: Vec<f64>,
}

/// The effect of one more column.
pub(super) struct More {
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
        let inverse = inverse(&columns)?;
        let values = &inverse * products(&columns, force);
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
        let along = &self.inverse * products(&self.columns, column);
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

/// Inverse of the columns' Gram matrix; `None` if they cannot be separated.
pub(super) fn inverse(columns: &[Vec<f64>]) -> Option<DMatrix<f64>> {
    let count = columns.len();
    law::inverse(&DMatrix::from_fn(count, count, |i, j| dot(&columns[i], &columns[j])))
}

/// Products of all columns with one.
pub(super) fn products(columns: &[Vec<f64>], one: &[f64]) -> DVector<f64> {
    DVector::from_iterator(columns.len(), columns.iter().map(|column| dot(column, one)))
}

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
