//! The whole run's sums: sufficient statistics, from which a host can fit again, merge runs or drop segments exactly.

use serde::{Deserialize, Serialize};

use crate::active::Active;
use crate::estimate::Bank;
use crate::estimator::State;
use crate::kernel::REGRESSORS;
use crate::rls::PRODUCTS;

/// Exact sums of the products of `[a, v, s, 1, F]` of one bank since the reset.
///
/// `sums[row (row + 1) / 2 + column] * units[row] * units[column]` is the sum of the product of two regressors in SI.
/// The acceleration's coefficient includes the structure mass.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
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
}
