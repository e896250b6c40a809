//! One kernel bank: its comb, and the memories of its outputs.

use crate::active::BankActive;
use crate::kernel::{Cascades, Comb, REGRESSORS, Update};
use crate::ldl::UNKNOWNS;
use crate::near_rest::NearRest;
use crate::qformat::Regressor;
use crate::rls::{MORE_PRODUCTS, Moments, Totals, approach, more_products, products};

/// Averages over the recent memory of a quantity for which the law has no parameter.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Aside {
    /// Its products with acceleration, velocity, sign and one.
    pub products: [i64; UNKNOWNS],
    /// Its mean square.
    pub square: i64,
}

impl Aside {
    pub const NONE: Self = Self { products: [0; UNKNOWNS], square: 0 };

    /// Takes its value with the regressors of the same update, at the gain of their averages.
    #[inline]
    pub fn update(&mut self, value: Regressor, regressors: &[Regressor; REGRESSORS], gain: u32) {
        let value = i64::from(value);
        for (average, regressor) in self.products.iter_mut().zip(regressors) {
            approach(average, value * i64::from(*regressor), gain);
        }
        approach(&mut self.square, value * value, gain);
    }
}

/// One bank's comb and memories.
#[derive(Clone, Debug)]
pub(crate) struct BankState {
    until_update: u32,
    /// Samples since the last update.
    pub idle_samples: u32,
    pub recent: Moments,
    pub near_rest: NearRest,
    /// Mean square of the jerk over the recent memory [regressor units^2].
    pub jerk: i64,
    /// The force's rate and its second derivative over the recent memory.
    pub rate: Aside,
    pub curvature: Aside,
    pub whole: Totals,
    pub more: Totals<MORE_PRODUCTS>,
    comb: Comb,
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
            rate: Aside::NONE,
            curvature: Aside::NONE,
            whole: Totals::new(),
            more: Totals::new(),
            idle_samples: 0,
        }
    }

    /// Forgets what was learnt, but not the signals.
    pub fn forget(&mut self) {
        self.recent = Moments::new();
        self.near_rest = NearRest::new();
        self.jerk = 0;
        (self.rate, self.curvature) = (Aside::NONE, Aside::NONE);
        self.whole = Totals::new();
        self.more = Totals::new();
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        self.comb.reset();
        self.forget();
        (self.until_update, self.idle_samples) = (0, 0);
    }

    /// Takes the cascades after a sample; returns false if an output is beyond full scale.
    #[inline]
    pub fn advance(&mut self, config: &BankActive, cascades: &Cascades, good_samples: u32) -> bool {
        self.idle_samples = self.idle_samples.saturating_add(1);
        if self.until_update > 1 {
            self.until_update -= 1;
            return true;
        }
        self.until_update = config.spacing;
        self.take(config, cascades, good_samples)
    }

    /// Out of line, so that the samples between updates, which are most, do not pay for its registers.
    #[inline(never)]
    fn take(&mut self, config: &BankActive, cascades: &Cascades, good_samples: u32) -> bool {
        let output = self.comb.push(cascades);
        if good_samples < config.support {
            return true;
        }
        let Some(Update { regressors, more, jerk, curvature }) = config.normaliser.update(&output) else {
            return false;
        };
        let products = products(&regressors);
        self.recent.update(&products, config.memory);
        self.near_rest.update(&products, &self.recent, config.memory);
        let gain = self.recent.gain(config.memory);
        approach(&mut self.jerk, i64::from(jerk) * i64::from(jerk), gain);
        self.whole.update(&products);
        let [.., rate] = more;
        self.rate.update(rate, &regressors, gain);
        self.curvature.update(curvature, &regressors, gain);
        self.more.update(&more_products(&regressors, &more));
        self.idle_samples = 0;
        true
    }
}
