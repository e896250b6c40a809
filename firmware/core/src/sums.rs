//! The whole run's sums: sufficient statistics, from which a host can fit again, merge runs or drop segments exactly.

use crate::active::Active;
use crate::estimate::Bank;
use crate::kernel::{MORE_REGRESSORS, REGRESSORS};
use crate::rls::{MORE_PRODUCTS, PRODUCTS};
use crate::state::State;

/// Exact sums of the products of `[a, v, s, 1, F]` of one bank since the reset.
///
/// `sums[row (row + 1) / 2 + column] * units[row] * units[column]` is the sum of the product of two regressors in SI.
/// The acceleration's coefficient includes the structure mass.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Sums {
    /// Index of the latest sample.
    pub index: u32,
    /// Bank whose kernel the regressors went through.
    pub bank: Bank,
    /// Products summed.
    pub updates: u32,
    /// SI value of one unit of acceleration \[m/s^2\], velocity \[m/s\], sign, one, force \[N\].
    pub units: [f64; REGRESSORS],
    /// Lower triangle by rows.
    pub sums: [i128; PRODUCTS],
}

/// Supplement to [`Sums`] of the same index and bank: the next rows of the triangle, for friction by direction and for
/// the skew.
///
/// Row 5 is the speed `|v|` with `a, v, s, 1, F, |v|`, row 6 the force's rate with `a, v, s, 1, F, |v|, dF/dt`. The
/// rate is corrected for the present skew and the structure, as the force is. The path, whose derivative is the speed,
/// reverses with the sub-sample sign.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct MoreSums {
    /// Index of the latest sample.
    pub index: u32,
    /// Bank whose kernel the regressors went through.
    pub bank: Bank,
    /// Products summed.
    pub updates: u32,
    /// SI value of one unit of speed \[m/s\] and force rate \[N/s\]; those of the others are in [`Sums`].
    pub units: [f64; MORE_REGRESSORS],
    /// Rows 5 and 6 of the lower triangle.
    pub sums: [i128; MORE_PRODUCTS],
}

impl Active {
    /// The sums as they stand.
    pub fn sums(&self, state: &State, bank: Bank) -> Sums {
        let (config, bank_state) = self.bank(state, bank);
        Sums {
            index: state.last_index(),
            bank,
            updates: bank_state.whole.updates(),
            units: config.scales.units,
            sums: *bank_state.whole.sums(),
        }
    }

    /// The sums with speed and force rate as they stand.
    pub fn more_sums(&self, state: &State, bank: Bank) -> MoreSums {
        let (config, bank_state) = self.bank(state, bank);
        MoreSums {
            index: state.last_index(),
            bank,
            updates: bank_state.more.updates(),
            units: config.scales.more_units,
            sums: *bank_state.more.sums(),
        }
    }
}
