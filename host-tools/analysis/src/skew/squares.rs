//! Least squares of rows on columns, and what one column more would do.

use nalgebra::{DMatrix, DVector};

use crate::law::{self, less};

pub(super) struct Squares {
    pub columns: Vec<Vec<f64>>,
    /// Of the sums of the columns' products.
    pub inverse: DMatrix<f64>,
    pub values: DVector<f64>,
    pub residual: Vec<f64>,
}

/// What one column more would do.
pub(super) struct More {
    /// Coefficient that it would have.
    pub size: f64,
    /// Part of its square that the others leave over.
    pub left: f64,
    /// Square that it would explain.
    pub explained: f64,
    /// What it would take from the coefficients of the others, per unit of its own.
    along: DVector<f64>,
    /// Square of what the others leave over of it.
    square: f64,
}

impl Squares {
    /// Fits the columns; nothing where they cannot be told apart.
    pub fn of(force: &[f64], columns: Vec<Vec<f64>>) -> Option<Self> {
        let inverse = inverse(&columns)?;
        let values = &inverse * products(&columns, force);
        let residual = less(force, &columns, values.as_slice());
        Some(Self { columns, inverse, values, residual })
    }

    /// Mean square of what is left over.
    pub fn square(&self) -> f64 {
        dot(&self.residual, &self.residual) / self.residual.len() as f64
    }

    /// What each row counts in the coefficient at this place.
    pub fn weights(&self, place: usize) -> Vec<f64> {
        let mut weights = vec![0.0; self.residual.len()];
        for (i, column) in self.columns.iter().enumerate() {
            let part = self.inverse[(place, i)];
            weights.iter_mut().zip(column).for_each(|(weight, value)| *weight += part * value);
        }
        weights
    }

    /// With a column more.
    pub fn with(&self, column: &[f64]) -> More {
        let along = &self.inverse * products(&self.columns, column);
        let alone = less(column, &self.columns, along.as_slice());
        let (square, all) = (dot(&alone, &alone), dot(column, column));
        let said = dot(&alone, &self.residual);
        More { size: said / square, left: square / all, explained: said * said / square, along, square }
    }
}

impl More {
    /// What it moves the coefficient at this place by, and the square of what chance alone would, per mean square of
    /// the residual of an independent row.
    pub fn moves(&self, place: usize) -> (f64, f64) {
        (-self.along[place] * self.size, self.along[place] * self.along[place] / self.square)
    }
}

/// Inverse of the sums of the columns' products; nothing where they cannot be told apart.
pub(super) fn inverse(columns: &[Vec<f64>]) -> Option<DMatrix<f64>> {
    let count = columns.len();
    law::inverse(&DMatrix::from_fn(count, count, |i, j| dot(&columns[i], &columns[j])))
}

/// Products of columns with one.
pub(super) fn products(columns: &[Vec<f64>], one: &[f64]) -> DVector<f64> {
    DVector::from_iterator(columns.len(), columns.iter().map(|column| dot(column, one)))
}

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
