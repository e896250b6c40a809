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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Settings;

    /// Half of the way towards each product.
    #[test]
    fn an_aside_averages_its_products_and_its_square() {
        let mut aside = Aside::NONE;
        aside.update(3 << 20, &[1 << 20, -(2 << 20), 1 << 30, -(1 << 30), 5], 1 << 31);
        assert_eq!(aside.products, [3 << 39, -(6 << 39), 3 << 49, -(3 << 49)]);
        assert_eq!(aside.square, 9 << 39);
    }

    /// An update comes every so many samples, as soon as every sample under the kernel is good.
    #[test]
    fn updates_come_at_their_spacing_with_the_first_good_kernel() {
        let active = Settings::default().validate().unwrap();
        for config in [&active.fast, &active.slow] {
            let (mut bank, cascades) = (BankState::new(), Cascades::new());
            assert!(bank.advance(config, &cascades, config.support - 1));
            assert_eq!((bank.whole.updates(), bank.idle_samples), (0, 1));
            for updates in 0..3 {
                for _ in 1..config.spacing {
                    assert!(bank.advance(config, &cascades, config.support));
                    assert_eq!(bank.whole.updates(), updates);
                }
                assert!(bank.advance(config, &cascades, config.support));
                assert_eq!((bank.whole.updates(), bank.more.updates()), (updates + 1, updates + 1));
                assert_eq!((bank.recent.updates(), bank.idle_samples), (updates + 1, 0));
            }
            bank.reset();
            assert_eq!((bank.whole.updates(), bank.recent.updates(), bank.idle_samples), (0, 0, 0));
            // Its next sample is an update again.
            assert!(bank.advance(config, &cascades, config.support));
            assert_eq!(bank.whole.updates(), 1);
        }
    }
}
