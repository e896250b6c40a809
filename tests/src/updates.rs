//! The updates of the estimator, reconstructed one by one from the exact sums that core publishes.

use crate::{
    grid::{Estimator, Result},
    sums::{self, gram},
};
use inerter_core::{Bank, RawSample, Settings};

/// Acceleration \[m/s^2\], velocity \[m/s\], sign, one, force \[N\].
pub type Row = [f64; 5];

/// One row for each update of a bank since its memory was last reset.
pub fn rows(settings: &Settings, samples: &[RawSample], bank: Bank) -> Result<Vec<Row>> {
    let mut estimator = Estimator::new(settings)?;
    let (mut rows, mut column) = (Vec::new(), [0_i128; 5]);
    for sample in samples {
        estimator.step(sample);
        let sums = estimator.active.sums(&estimator.state, bank);
        if (sums.updates as usize) < rows.len() {
            (rows, column) = (Vec::new(), [0; 5]);
        }
        if sums.updates as usize > rows.len() {
            // Differences of the products with the constant regressor.
            let now = [6, 7, 8, 9, 13].map(|place: usize| sums.sums[place]);
            let constant = 2_f64.powi(30);
            rows.push(std::array::from_fn(|i| (now[i] - column[i]) as f64 / constant * sums.units[i]));
            column = now;
        }
    }
    Ok(rows)
}

/// Least squares over rows: mt with the structure \[kg\], cf \[N s/m\], fc \[N\], F0 \[N\]; `None` if the matrix is not
/// positive definite within `least` of its diagonal.
pub fn fit(rows: impl Iterator<Item = Row>, least: f64) -> Option<[f64; 4]> {
    sums::fit(&gram(rows), [0, 1, 2, 3], least)
}

/// Residual of a row's force with these parameters \[N\].
pub fn left(values: &[f64; 4], row: &Row) -> f64 {
    row[4] - values.iter().zip(row).map(|(value, regressor)| value * regressor).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{MOTIONS, RIGS, calibrated, raw, rms, simulation};
    use inerter_plant::Inerter;

    /// The fit to the rows equals core's fit, except for core's correction for the encoder's steps.
    #[test]
    fn the_rows_are_those_of_the_estimate() {
        let (device, motion) = (Inerter::paper(), &MOTIONS[4]);
        let simulated = simulation(&device, motion, &RIGS[0], 3).unwrap();
        let settings = calibrated(&device, simulated.sensors());
        let samples: Vec<RawSample> = simulated.lasting(8.0).map(|sample| raw(&sample)).collect();
        let rows = rows(&settings, &samples, Bank::Fast).unwrap();
        assert!((900..1000).contains(&rows.len()), "{}", rows.len());
        let values = fit(rows.iter().copied(), sums::SEPARABLE).unwrap();
        assert!((values[0] - device.inertance_kg - device.structure_mass_kg).abs() < 0.02, "{values:?}");
        assert!((values[2] - device.coulomb_n).abs() < 0.2, "{values:?}");
        assert!((0.3..0.6).contains(&rms(rows.iter().map(|row| left(&values, row)))));
    }
}
