//! Every fixed-point format of the signal path, and the few operations they need.
//!
//! | quantity | type | one unit in the last place | range | why |
//! |---|---|---|---|---|
//! | encoder position | `i64` | 1 encoder count / `oversampling` | wraps | only differences within a kernel are used, and those are exact modulo 2^64 |
//! | force | `i32` | 1 force code | +-2^24 | 24-bit converters, tare included |
//! | sub-sample sign | `i32` | 2^-15 | +-1 | a reversal is located to 1/65536 of a sample |
//! | cascade and comb | `i64` | one of the above | wraps | box^4 of 512 samples of 24 bits times 24 is 2^63 at most |
//! | regressor | `i32`, [`Regressor`] | a power of two, chosen by `Settings::validate` | +-(2^31 - 1) | product of two fits `i64` |
//! | moment | `i64`, Q62 of the regressors' units | 2^-62 of full scale squared | +-2^62 | slow motion uses 2^-34 of it and keeps 28 bits |
//! | whole-run sum | `i128` | the product's | 2^64 updates | exact: no rounding at all |
//! | equilibrated matrix, pivots | `i64`, Q62 | 2^-62 | [1/2, 2) on the diagonal | see `ldl` |
//! | factors, solution | `i64`, Q50 | 2^-50 | +-2^12 | a pivot above 2^-20 bounds them by 2^11 |
//!
//! Right shifts round half up; [`mul_shift`] and [`scale`] round down. Regressors are rounded half to even, except
//! those of the force: with few dropped bits many values are ties, and half up would add a bias that does not average
//! out. All left shifts are checked by the caller's choice of format.

/// A normalised regressor, full scale +-(2^31 - 1).
pub type Regressor = i32;

/// `value * 2^-shift`, rounded half up; a negative shift multiplies, wrapping.
///
/// Shifts beyond +-63 give 0.
#[inline]
pub fn shift_right(value: i64, shift: i8) -> i64 {
    match shift {
        0 => value,
        1..=62 => (value >> shift) + ((value >> (shift - 1)) & 1),
        -63..=-1 => value.wrapping_shl(u32::from(shift.unsigned_abs())),
        _ => 0,
    }
}

/// As [`shift_right`], but rounded half to even; `None` if the result does not fit a [`Regressor`]. Not inlined: it has
/// many callers, and copies would cost flash.
#[inline(never)]
pub fn to_regressor(value: i64, shift: i8) -> Option<Regressor> {
    if shift < 0 && value.unsigned_abs().leading_zeros() <= u32::from(shift.unsigned_abs()) {
        return None;
    }
    let half_up = shift_right(value, shift);
    let is_half_way = shift > 0 && value.wrapping_shl(u32::from(shift.unsigned_abs()).wrapping_neg()) == i64::MIN;
    match i32::try_from(half_up - (half_up & i64::from(is_half_way))) {
        Ok(i32::MIN) | Err(_) => None,
        Ok(value) => Some(value),
    }
}

/// The 128-bit product of two `i64`, as high and low word.
#[inline(always)]
pub fn widening_mul(a: i64, b: i64) -> (i64, u64) {
    // Four 32-bit products: the compiler's own 128-bit multiply costs three times as much on a Cortex-M4.
    let (a_high, a_low) = ((a >> 32) as i32, a as u32);
    let (b_high, b_low) = ((b >> 32) as i32, b as u32);
    let low = u64::from(a_low) * u64::from(b_low);
    let cross_a = i64::from(a_high).wrapping_mul(i64::from(b_low)).wrapping_add((low >> 32) as i64);
    let cross_b = i64::from(a_low).wrapping_mul(i64::from(b_high)).wrapping_add(i64::from(cross_a as u32));
    let high = i64::from(a_high) * i64::from(b_high) + (cross_a >> 32) + (cross_b >> 32);
    (high, (low & 0xffff_ffff) | ((cross_b as u64) << 32))
}

/// `(a * b) >> shift` for `shift` in 1..=63, rounded down; bits beyond 64 are dropped.
#[inline(always)]
pub fn mul_shift(a: i64, b: i64, shift: u32) -> i64 {
    let (high, low) = widening_mul(a, b);
    (high.wrapping_shl(64 - shift)) | (low.wrapping_shr(shift) as i64)
}

/// `value * coefficient * 2^(-32 - shift)`, rounded down, for a coefficient of up to 31 bits.
#[inline]
pub fn scale(value: i64, coefficient: i32, shift: i8) -> i64 {
    let high = (value >> 32) * i64::from(coefficient);
    let low = (i64::from(value as u32) * i64::from(coefficient)) >> 32;
    shift_right(high.wrapping_add(low), shift)
}

/// A fixed real multiple of an integer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Term {
    /// 31-bit mantissa.
    pub coefficient: i32,
    /// The factor is `coefficient * 2^(-32 - shift)`.
    pub shift: i8,
}

impl Term {
    /// `value` times the factor, rounded as in [`scale`].
    #[inline]
    pub fn of(self, value: i64) -> i64 {
        if self.coefficient == 0 { 0 } else { scale(value, self.coefficient, self.shift) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn product_is_the_128_bit_one(a: i64, b: i64) {
            let expected = i128::from(a) * i128::from(b);
            let (high, low) = widening_mul(a, b);
            prop_assert_eq!((i128::from(high) << 64) | i128::from(low), expected);
        }

        #[test]
        fn shifted_product_is_exact(a in -(1_i64 << 62)..1 << 62, b in -(1_i64 << 50)..1 << 50, shift in 50_u32..64) {
            prop_assert_eq!(i128::from(mul_shift(a, b, shift)), (i128::from(a) * i128::from(b)) >> shift);
        }

        #[test]
        fn shift_rounds_half_up(value: i64, shift in 1_i8..63) {
            let expected = (i128::from(value) + (1 << (shift - 1))) >> shift;
            prop_assert_eq!(i128::from(shift_right(value, shift)), expected);
        }

        #[test]
        fn regressor_fits_or_is_refused(
            value in prop_oneof![any::<i64>(), -10_000_i64..10_000],
            shift in -40_i8..=i8::MAX,
        ) {
            let exact = if shift > 62 {
                0
            } else if shift > 0 {
                let (down, rest) = (i128::from(value) >> shift, i128::from(value) & ((1 << shift) - 1));
                let is_up = rest + (down & 1) > 1 << (shift - 1);
                down + i128::from(is_up)
            } else {
                i128::from(value) << -shift
            };
            let fits = exact.unsigned_abs() < 1 << 31;
            prop_assert_eq!(to_regressor(value, shift).map(i128::from), fits.then_some(exact));
        }

        /// Few dropped bits, so that many values lie half way.
        #[test]
        fn regressors_of_mirrored_values_are_mirrored(value in -10_000_i64..10_000, shift in -4_i8..6) {
            let negated = to_regressor(value, shift).map(|regressor| -regressor);
            prop_assert_eq!(to_regressor(-value, shift), negated);
        }

        #[test]
        fn multiplied_regressors_fit_or_are_refused(value: i64, narrow in 0_u32..64, shift in -63_i8..0) {
            let value = value >> narrow;
            let exact = i128::from(value) << shift.unsigned_abs();
            let fits = exact.unsigned_abs() < 1 << 31;
            prop_assert_eq!(to_regressor(value, shift).map(i128::from), fits.then_some(exact));
        }

        #[test]
        fn scale_is_within_one_unit(value in -(1_i64 << 60)..1 << 60, coefficient: i32, shift in 0_i8..30) {
            let exact = (i128::from(value) * i128::from(coefficient)) as f64 / ((1_u64 << (32 + shift)) as f64);
            prop_assert!((scale(value, coefficient, shift) as f64 - exact).abs() <= 1.0 + exact.abs() * 1e-15);
        }
    }

    /// What a left shift pushes out of 64 bits is not lost without notice.
    #[test]
    fn what_leaves_64_bits_is_no_regressor() {
        for (value, shift) in [(1_i64 << 60, -4), (-1 << 62, -2), (3 << 40, -24), (1 << 24, -40), (i64::MIN, -1)] {
            assert_eq!(to_regressor(value, shift), None, "{value} {shift}");
        }
        assert_eq!(to_regressor(0, -63), Some(0));
        assert_eq!((to_regressor(-3, -2), to_regressor(7, 0)), (Some(-12), Some(7)));
    }
}
