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
}
