//! One kernel bank: its comb, and the memories of what went through it.

use crate::active::BankActive;
use crate::kernel::{Cascades, Comb, Update};
use crate::ldl::UNKNOWNS;
use crate::near_rest::NearRest;
use crate::rls::{MORE_PRODUCTS, Moments, RATE, RATE_SQUARE, Totals, approach, more_products, products};

/// One bank's comb and memories.
#[derive(Clone, Debug)]
pub(crate) struct BankState {
    comb: Comb,
    until_update: u32,
    pub recent: Moments,
    pub near_rest: NearRest,
    /// Mean square of the jerk over the recent memory [regressor units^2].
    pub jerk: i64,
    /// Products of the force's rate with acceleration, velocity, sign and one, averaged over the recent memory.
    pub rate: [i64; UNKNOWNS],
    /// Mean square of the force's rate, likewise.
    pub rate_square: i64,
    pub whole: Totals,
    pub more: Totals<MORE_PRODUCTS>,
    /// Samples since the last update.
    pub idle_samples: u32,
}

impl BankState {
    /// Nothing seen.
    pub const fn new() -> Self {
        Self {
            comb: Comb::new(),
            until_update: 0,
            recent: Moments::new(),
            near_rest: NearRest::new(),
            jerk: 0,
            rate: [0; UNKNOWNS],
            rate_square: 0,
            whole: Totals::new(),
            more: Totals::new(),
            idle_samples: 0,
        }
    }

    /// Forgets what was learnt, and nothing of the signals.
    pub fn forget(&mut self) {
        self.recent = Moments::new();
        self.near_rest = NearRest::new();
        self.jerk = 0;
        (self.rate, self.rate_square) = ([0; UNKNOWNS], 0);
        self.whole = Totals::new();
        self.more = Totals::new();
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        self.comb.reset();
        self.forget();
        (self.until_update, self.idle_samples) = (0, 0);
    }

    /// Takes the cascades after a sample; false where an output is beyond full scale.
    pub fn advance(&mut self, config: &BankActive, cascades: &Cascades, good_samples: u32) -> bool {
        self.idle_samples = self.idle_samples.saturating_add(1);
        if self.until_update > 1 {
            self.until_update -= 1;
            return true;
        }
        self.until_update = config.spacing;
        let output = self.comb.push(cascades);
        if good_samples < config.support {
            return true;
        }
        let Some(Update { regressors, more, jerk }) = config.normaliser.update(&output) else {
            return false;
        };
        let products = products(&regressors);
        self.recent.update(&products, config.memory);
        self.near_rest.update(&products, &self.recent, config.memory);
        let gain = self.recent.gain(config.memory);
        approach(&mut self.jerk, i64::from(jerk) * i64::from(jerk), gain);
        self.whole.update(&products);
        let more = more_products(&regressors, &more);
        self.rate.iter_mut().zip(&more[RATE]).for_each(|(average, product)| approach(average, *product, gain));
        approach(&mut self.rate_square, more[RATE_SQUARE], gain);
        self.more.update(&more);
        self.idle_samples = 0;
        true
    }
}
