//! Small symmetric systems in f64, as in a textbook: the fixed-point solution is compared with them.

/// Lower factor `L` of a symmetric positive definite matrix that was first scaled to a unit diagonal.
#[derive(Clone, Copy, Debug)]
pub struct Cholesky<const N: usize> {
    lower: [[f64; N]; N],
    scale: [f64; N],
}

impl<const N: usize> Cholesky<N> {
    /// Factorises; `None` if the matrix is not positive definite within `least` of its diagonal.
    pub fn of(matrix: &[[f64; N]; N], least: f64) -> Option<Self> {
        let scale: [f64; N] = std::array::from_fn(|i| matrix[i][i].sqrt().recip());
        let mut lower = [[0.0; N]; N];
        for row in 0..N {
            for column in 0..=row {
                let known: f64 = (0..column).map(|k| lower[row][k] * lower[column][k]).sum();
                let left = matrix[row][column] * scale[row] * scale[column] - known;
                if row > column {
                    lower[row][column] = left / lower[column][column];
                } else if left > least {
                    lower[row][row] = left.sqrt();
                } else {
                    return None;
                }
            }
        }
        Some(Self { lower, scale })
    }

    /// The solution for one right-hand side.
    pub fn solve(&self, right: &[f64; N]) -> [f64; N] {
        let mut x: [f64; N] = std::array::from_fn(|i| right[i] * self.scale[i]);
        for row in 0..N {
            let known: f64 = (0..row).map(|k| self.lower[row][k] * x[k]).sum();
            x[row] = (x[row] - known) / self.lower[row][row];
        }
        for row in (0..N).rev() {
            let known: f64 = (row + 1..N).map(|k| self.lower[k][row] * x[k]).sum();
            x[row] = (x[row] - known) / self.lower[row][row];
        }
        std::array::from_fn(|i| x[i] * self.scale[i])
    }

    /// The diagonal of the inverse.
    pub fn inverse_diagonal(&self) -> [f64; N] {
        std::array::from_fn(|i| {
            let mut unit = [0.0; N];
            unit[i] = 1.0;
            self.solve(&unit)[i]
        })
    }
}
