//! All reversals together: outliers are rejected, the others summed with their information as weights.
//!
//! The latest 16 wait in a ring. Each is compared with their median when it leaves the ring, or when the sums are read.

use crate::backlash::step::Fit;

/// Reversals that wait.
const WAITING: usize = 16;
/// Fewest reversals for a useful median.
const ENOUGH: usize = 5;
/// Square of 4 standard deviations over that of the median deviation of normal noise.
const OUTLIER: u64 = 35;
/// Greatest deviation [units]: it is clamped to this.
const FARTHEST: u32 = 1 << 19;

/// Sums over the accepted reversals.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sums {
    pub accepted: u32,
    pub rejected: u32,
    /// Values are summed as differences from this [units].
    pub origin: i32,
    /// Sums of weights and, weighted, of weight, value, its square, change, its square, part by stretch, and variance.
    pub weighted: [i128; 8],
}

impl Sums {
    const NONE: Self = Self { accepted: 0, rejected: 0, origin: 0, weighted: [0; 8] };

    fn add(&mut self, fit: &Fit) {
        if self.accepted == 1 << 31 {
            return;
        }
        self.accepted += 1;
        let weight = i64::from(fit.weight);
        let value = i64::from(fit.value.wrapping_sub(self.origin));
        let change = i64::from(fit.change);
        let (by_stretch, variance) = (i64::from(fit.by_stretch), i64::from(fit.variance));
        // No factor exceeds 57 bits.
        let factors = [
            (weight, 1),
            (weight, weight),
            (weight, value),
            (weight * value, value),
            (weight, change),
            (weight * change, change),
            (weight, by_stretch),
            (weight, variance),
        ];
        for (sum, (a, b)) in self.weighted.iter_mut().zip(factors) {
            *sum += whole_product(a, b);
        }
    }
}

/// The exact product.
fn whole_product(a: i64, b: i64) -> i128 {
    let (high, low) = crate::qformat::widening_mul(a, b);
    i128::from(high) << 64 | i128::from(low)
}

/// The pool of reversals.
#[derive(Clone, Debug)]
pub(crate) struct Pool {
    waiting: [Fit; WAITING],
    /// Number of reversals taken so far, and of those that wait.
    next: u8,
    filled: u8,
    settled: Sums,
}

impl Pool {
    /// No reversals.
    pub const fn new() -> Self {
        let none = Fit { value: 0, change: 0, by_stretch: 0, variance: 0, weight: 0 };
        Self { waiting: [none; WAITING], next: 0, filled: 0, settled: Sums::NONE }
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        let Self { waiting: _, next, filled, settled } = self;
        (*next, *filled) = (0, 0);
        *settled = Sums::NONE;
    }

    /// Takes a reversal; returns whether it agrees with those before it.
    pub fn take(&mut self, fit: &Fit) -> bool {
        let outliers = self.outliers();
        let place = usize::from(self.next) % WAITING;
        if usize::from(self.filled) == WAITING {
            let leaving = self.waiting[place];
            if self.settled.accepted == 0 {
                self.settled.origin = outliers.median;
            }
            if outliers.accepts(&leaving) {
                self.settled.add(&leaving);
            } else {
                self.settled.rejected = self.settled.rejected.saturating_add(1);
            }
        }
        self.waiting[place] = *fit;
        self.next = self.next.wrapping_add(1);
        self.filled = (self.filled + 1).min(WAITING as u8);
        outliers.accepts(fit)
    }

    /// The sums as they stand, with the reversals that wait.
    pub fn sums(&self) -> Sums {
        let outliers = self.outliers();
        let mut sums = self.settled;
        if sums.accepted == 0 {
            sums.origin = outliers.median;
        }
        for fit in self.all_waiting() {
            if outliers.accepts(fit) {
                sums.add(fit);
            } else {
                sums.rejected = sums.rejected.saturating_add(1);
            }
        }
        sums
    }

    fn all_waiting(&self) -> impl Iterator<Item = &Fit> {
        self.waiting.iter().take(usize::from(self.filled))
    }

    fn outliers(&self) -> Outliers {
        let count = usize::from(self.filled);
        let value = median(&self.waiting.map(|fit| i64::from(fit.value)), count) as i32;
        let spread = median(&self.waiting.map(|fit| (deviation(&fit, value) >> 1) as i64), count) as u64;
        let limit = if count < ENOUGH { u64::MAX } else { spread.saturating_mul(2 * OUTLIER) };
        Outliers { median: value, limit }
    }
}

/// The middle one of the first `count`, or the lower of two; 0 if there are none.
fn median(values: &[i64; WAITING], count: usize) -> i64 {
    for value in values.iter().take(count) {
        let others = || values.iter().take(count);
        let below = others().filter(|other| *other < value).count();
        let not_above = others().filter(|other| *other <= value).count();
        if 2 * below < count && 2 * not_above >= count {
            return *value;
        }
    }
    0
}

/// Square of the deviation, weighted by its information.
fn deviation(fit: &Fit, from: i32) -> u64 {
    let distance = u64::from(fit.value.abs_diff(from).min(FARTHEST));
    distance * distance * u64::from(fit.weight)
}

/// The median, and the limit beyond which a reversal is an outlier.
struct Outliers {
    median: i32,
    limit: u64,
}

impl Outliers {
    fn accepts(&self, fit: &Fit) -> bool {
        deviation(fit, self.median) <= self.limit
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use inerter_needs::Random;
    use std::vec::Vec;

    fn fit(value: i32) -> Fit {
        Fit { value, weight: 100, ..Fit::default() }
    }

    #[test]
    fn outliers_stay_out() {
        let mut pool = Pool::new();
        let values: Vec<i32> = (0..100).map(|n| if n % 10 == 9 { 50_000 } else { 1000 + n * 37 % 21 }).collect();
        let agreed = values.iter().filter(|value| pool.take(&fit(**value))).count();
        let sums = pool.sums();
        assert_eq!((sums.accepted, sums.rejected), (90, 10));
        assert_eq!(agreed, 90);
        let mean = f64::from(sums.origin) + sums.weighted[2] as f64 / sums.weighted[0] as f64;
        assert!((mean - 1010.0).abs() < 1.0, "{mean}");
    }

    #[test]
    fn products_are_whole() {
        assert_eq!(whole_product(-3, 5), -15);
        assert_eq!(whole_product(1 << 40, 1 << 40), 1 << 80);
        assert_eq!(whole_product(-(1 << 40), 1 << 40), -(1 << 80));
    }

    /// Every sum of three reversals, by hand; their median is the origin.
    #[test]
    fn sums_are_those_of_their_reversals() {
        let fits = [
            Fit { value: 1000, change: -3, by_stretch: 70, variance: 11, weight: 5 },
            Fit { value: 1020, change: 4, by_stretch: -20, variance: 6, weight: 7 },
            Fit { value: 990, change: 9, by_stretch: 40, variance: 9, weight: 2 },
        ];
        let mut pool = Pool::new();
        assert!(fits.iter().all(|fit| pool.take(fit)));
        let sums = pool.sums();
        assert_eq!((sums.accepted, sums.rejected, sums.origin), (3, 0, 1000));
        assert_eq!(sums.weighted, [14, 78, 120, 3000, 31, 319, 290, 115]);
        pool.reset();
        let sums = pool.sums();
        assert_eq!((sums.accepted, sums.rejected, sums.origin, sums.weighted), (0, 0, 0, [0; 8]));
    }

    /// The origin stays while the values drift, so that their sum is whole. It is the median of the first 16.
    #[test]
    fn values_that_drift_have_their_mean() {
        let mut pool = Pool::new();
        assert!((1000..1100).all(|value| pool.take(&fit(value))));
        let sums = pool.sums();
        assert_eq!((sums.accepted, sums.rejected, sums.origin), (100, 0, 1007));
        // The mean of 1000 to 1099 is 1049.5, and each weighs 100.
        assert_eq!(i128::from(sums.origin) * sums.weighted[0] + sums.weighted[2], 10_495_000);
    }

    /// Of five with a median deviation of 10, an outlier's square is over 35 times a hundred, times their weight over
    /// its own. Four tell no outlier.
    #[test]
    fn an_outlier_deviates_by_four_standard_deviations() {
        let agrees = |waiting: &[i32], value: i32, weight: u32| {
            let mut pool = Pool::new();
            for waiting in waiting {
                pool.take(&fit(*waiting));
            }
            pool.take(&Fit { value, weight, ..Fit::default() })
        };
        let five = [990, 1010, 1000, 990, 1010];
        for (weight, most) in [(100, 59), (400, 29), (25, 118)] {
            for sign in [1, -1] {
                let [within, beyond] = [most, most + 1].map(|distance| 1000 + sign * distance);
                assert!(agrees(&five, within, weight) && !agrees(&five, beyond, weight), "{weight} {sign}");
                assert!(agrees(&five[..4], 1000 + sign * 100_000, weight), "{weight} {sign}");
            }
        }
    }

    #[test]
    fn the_median_is_the_middle_one_or_the_lower_of_two() {
        let mut random = Random(5);
        for round in 0..2000 {
            let count = round % (WAITING + 1);
            let values: [i64; WAITING] = core::array::from_fn(|_| random.below(9_i64) - 4);
            let mut sorted = values[..count].to_vec();
            sorted.sort_unstable();
            let wanted = if count > 0 { sorted[(count - 1) / 2] } else { 0 };
            assert_eq!(median(&values, count), wanted, "{count} of {values:?}");
        }
    }
}
