//! Recursive least squares in information form: averages of the products of the regressors.
//!
//! Input: `[a, v, s, 1, F]` normalised, all through one kernel. State: the 15 distinct products, averaged with a gain
//! that falls with the count until the chosen memory is reached, and summed exactly since the reset. There is no
//! covariance that could lose its positive definiteness, an update takes one 32-bit division, and rounding is forgotten
//! with the data. Nothing happens between updates, so rest of any length changes nothing.
//! Source: Ljung, System Identification, 2nd ed., 11.2.

use crate::kernel::{MORE_REGRESSORS, REGRESSORS};
use crate::qformat::Regressor;

/// Distinct products of the regressors: the lower triangle by rows.
pub const PRODUCTS: usize = REGRESSORS * (REGRESSORS + 1) / 2;
/// Distinct products with the regressors that only the whole run's sums hold: the next rows of the triangle.
pub const MORE_PRODUCTS: usize = (REGRESSORS + MORE_REGRESSORS) * (REGRESSORS + MORE_REGRESSORS + 1) / 2 - PRODUCTS;

/// Products of the force's rate with acceleration, velocity, sign and one, among those.
pub const RATE: core::ops::Range<usize> = 6..10;
/// Its product with itself.
pub const RATE_SQUARE: usize = 12;

/// Place of product `(row, column)` with `column <= row`.
pub const fn place(row: usize, column: usize) -> usize {
    row * (row + 1) / 2 + column
}

/// One set of products.
#[inline]
pub fn products(regressors: &[Regressor; REGRESSORS]) -> [i64; PRODUCTS] {
    let [a, v, s, one, f] = regressors.map(i64::from);
    [
        a * a,
        v * a,
        v * v,
        s * a,
        s * v,
        s * s,
        one * a,
        one * v,
        one * s,
        one * one,
        f * a,
        f * v,
        f * s,
        f * one,
        f * f,
    ]
}

/// The products with speed and force rate: `|v|` with `a, v, s, 1, F, |v|`, then the rate with all these and itself.
#[inline]
pub fn more_products(
    regressors: &[Regressor; REGRESSORS],
    more: &[Regressor; MORE_REGRESSORS],
) -> [i64; MORE_PRODUCTS] {
    let [a, v, s, one, f] = regressors.map(i64::from);
    let [speed, rate] = more.map(i64::from);
    [
        speed * a,
        speed * v,
        speed * s,
        speed * one,
        speed * f,
        speed * speed,
        rate * a,
        rate * v,
        rate * s,
        rate * one,
        rate * f,
        rate * speed,
        rate * rate,
    ]
}

/// Running averages with a growing, then constant memory.
#[derive(Clone, Copy, Debug, Default)]
pub struct Moments {
    averages: [i64; PRODUCTS],
    updates: u32,
    /// Sum of the squared weights, in 2^-62.
    weight: i64,
}

impl Moments {
    /// No updates yet.
    pub const fn new() -> Self {
        Self { averages: [0; PRODUCTS], updates: 0, weight: 0 }
    }

    /// Takes one set of products with a gain of `1 / min(updates, memory)`: a plain average at first, an exponential
    /// one later.
    ///
    /// Rounds half up, without which the averages would drift; cannot overflow, as an average lies between its inputs.
    #[inline]
    pub fn update(&mut self, products: &[i64; PRODUCTS], memory: u32) {
        self.updates = self.updates.saturating_add(1);
        let gain = self.gain(memory);
        if gain == u32::MAX {
            self.averages = *products;
            self.weight = 1 << 62;
            return;
        }
        for (average, product) in self.averages.iter_mut().zip(products) {
            approach(average, *product, gain);
        }
        let once = part(self.weight, gain);
        self.weight += part(once, gain) - 2 * once + ((u64::from(gain) * u64::from(gain)) >> 2) as i64;
    }

    /// Gain of the latest update: `2^32 / min(updates, memory)`, rounded down. The rounding changes the memory, not the
    /// average.
    pub fn gain(&self, memory: u32) -> u32 {
        u32::MAX / self.updates.min(memory).max(1)
    }

    /// The averages, lower triangle by rows.
    pub fn averages(&self) -> &[i64; PRODUCTS] {
        &self.averages
    }

    /// Updates taken.
    pub fn updates(&self) -> u32 {
        self.updates
    }

    /// Sum of the squared weights [2^-62]: its inverse is the number of equally weighted updates with the same
    /// information.
    pub fn weight(&self) -> i64 {
        self.weight
    }
}

/// Moves an average of products by `gain * 2^-32` of the way towards one.
#[inline]
pub(crate) fn approach(average: &mut i64, product: i64, gain: u32) {
    // |product - average| < 2^63 since both are below 2^62.
    *average += part(product.wrapping_sub(*average), gain);
}

/// `value * gain * 2^-32`, rounded half up.
#[inline]
pub(crate) fn part(value: i64, gain: u32) -> i64 {
    let gain = i64::from(gain);
    let low = (value & 0xffff_ffff) as u64 * gain as u64;
    (value >> 32) * gain + ((low + (1 << 31)) >> 32) as i64
}

/// Exact sums since the reset.
#[derive(Clone, Copy, Debug)]
pub struct Totals<const N: usize = PRODUCTS> {
    sums: [i128; N],
    updates: u32,
}

impl<const N: usize> Default for Totals<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> Totals<N> {
    /// No updates yet.
    pub const fn new() -> Self {
        Self { sums: [0; N], updates: 0 }
    }

    /// Takes one set of products. Has room for 2^32 updates, then stops.
    #[inline]
    pub fn update(&mut self, products: &[i64; N]) {
        if self.updates == u32::MAX {
            return;
        }
        self.updates += 1;
        for (sum, &product) in self.sums.iter_mut().zip(products) {
            *sum = sum.wrapping_add(i128::from(product));
        }
    }

    /// The sums, by rows.
    pub fn sums(&self) -> &[i128; N] {
        &self.sums
    }

    /// Updates taken.
    pub fn updates(&self) -> u32 {
        self.updates
    }
}

/// Sums brought to at most 62 bits by one common right shift, and that shift.
pub fn scaled(sums: &[i128; PRODUCTS]) -> ([i64; PRODUCTS], u32) {
    // No sum of products is wider than the widest sum of squares.
    let squares: [i128; REGRESSORS] = core::array::from_fn(|i| sums[place(i, i)]);
    let shift = (128 - squares.iter().fold(0, |all, square| all | square).leading_zeros()).saturating_sub(62);
    // By words: a 128-bit shift is a function call on a Cortex-M4.
    let scaled = sums.map(|sum| {
        let (high, low) = ((sum >> 64) as u64, sum as u64);
        match shift {
            0 => low as i64,
            1..=63 => ((high << (64 - shift)) | (low >> shift)) as i64,
            _ => (high as i64) >> (shift - 64),
        }
    });
    (scaled, shift)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn part_rounds_half_up(value: i64, narrow in 0_u32..63, gain: u32) {
            let value = value >> narrow;
            let exact = (i128::from(value) * i128::from(gain) + (1 << 31)) >> 32;
            prop_assert_eq!(i128::from(part(value, gain)), exact);
        }
    }

    /// Plain averages over what has come, then exponential ones; the squared weights add up to `1 / n`, in the end to
    /// `1 / (2 memory - 1)`.
    #[test]
    fn averages_and_weights_are_those_of_the_memory() {
        const MEMORY: u32 = 50;
        let mut moments = Moments::new();
        let mut wanted = 0.0;
        for n in 1..=1000_u32 {
            let product = i64::from(n * n % 97) << 40;
            moments.update(&[product; PRODUCTS], MEMORY);
            wanted += (product as f64 - wanted) / f64::from(n.min(MEMORY));
            for average in moments.averages() {
                assert!((*average as f64 / wanted - 1.0).abs() < 1e-6, "{n}: {average} for {wanted}");
            }
            let weight = moments.weight() as f64 / 2_f64.powi(62);
            if n <= MEMORY {
                assert!((weight * f64::from(n) - 1.0).abs() < 1e-6, "{n}: {weight}");
            }
            assert_eq!(moments.updates(), n);
        }
        let weight = moments.weight() as f64 / 2_f64.powi(62);
        assert!((weight * f64::from(2 * MEMORY - 1) - 1.0).abs() < 1e-6, "{weight}");
    }

    /// Where two sums of squares are the widest, and as wide as each other, too.
    #[test]
    fn sums_of_any_width_keep_62_bits() {
        for bits in [1_u32, 40, 61, 62, 63, 64, 94, 124, 125, 126, 127] {
            let wide = i128::MAX >> (127 - bits);
            let mut sums = [-(wide / 3); PRODUCTS];
            (0..REGRESSORS).for_each(|i| sums[place(i, i)] = wide >> 5);
            (sums[place(0, 0)], sums[place(3, 3)]) = (wide, wide);
            let (scaled, shift) = scaled(&sums);
            assert_eq!(shift, bits.saturating_sub(62));
            assert_eq!(scaled.map(i128::from), sums.map(|sum| sum >> shift), "{bits} bits");
        }
    }
}
