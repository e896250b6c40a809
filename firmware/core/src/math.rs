//! The few functions of a real number that reporting needs, the same to the bit on every machine.
//!
//! micromath's seed is called by path, never as a method, which would pick std's function on a PC.

use crate::qformat::Term;

/// Square root of a normal number, within two units in the last place; 0 for what has none.
pub fn sqrt(value: f32) -> f32 {
    if value > 0.0 {
        if value == f32::INFINITY {
            return value;
        }
        // micromath is up to 6 % too large; the factor puts half of that on either side. A Newton step is too large by
        // half the square of the error, up to 4.5e-4, again halved by a factor; the next is within 3e-8.
        let seed = 0.97 * micromath::F32Ext::sqrt(value);
        let near = 0.499_89 * (seed + value / seed);
        return 0.5 * (near + value / near);
    }
    // NaN has none either.
    0.0
}

/// The value without its sign.
pub fn magnitude(value: f32) -> f32 {
    if value < 0.0 { -value } else { value }
}

/// The value times itself.
pub fn square(value: f32) -> f32 {
    value * value
}

/// `value` within two units in the last place, by 32-bit words, which a Cortex-M4F converts itself. Not inlined: it has
/// many callers, and copies would cost flash.
#[inline(never)]
pub fn single(value: i64) -> f32 {
    // The lower word is taken as signed, and the upper one makes up for it: a small negative value is its lower word
    // alone.
    let lower = value as i32;
    let upper = (value >> 32) as i32 as f32 + (lower as u32 >> 31) as f32;
    upper * power(32) + lower as f32
}

/// `value` within four units in the last place.
pub fn single_of_wide(value: i128) -> f32 {
    let lower = value as i64;
    let upper = single((value >> 64) as i64) + (lower as u64 >> 63) as f32;
    upper * power(64) + single(lower)
}

/// The greater of two.
pub fn greater(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The lesser of two; the first if the second is NaN.
pub fn lesser(a: f32, b: f32) -> f32 {
    if b < a { b } else { a }
}

/// `2^exponent`; 0 or infinity beyond the format.
pub fn power_of_two(exponent: i32) -> f64 {
    match exponent {
        -1022..=1023 => f64::from_bits(((exponent + 1023) as u64) << 52),
        ..-1022 => 0.0,
        1024.. => f64::INFINITY,
    }
}

/// `2^exponent` in single precision; 0 or infinity beyond the format.
pub fn power(exponent: i32) -> f32 {
    match exponent {
        -126..=127 => f32::from_bits(((exponent + 127) as u32) << 23),
        ..-126 => 0.0,
        128.. => f32::INFINITY,
    }
}

/// `e` with `2^e <= |value| < 2^(e + 1)`, for normal numbers; -1023 for 0.
pub fn exponent(value: f64) -> i32 {
    ((value.to_bits() >> 52) & 0x7ff) as i32 - 1023
}

/// `factor` as mantissa and shift; the default if it is 0.
pub fn term(factor: f64) -> Term {
    if factor == 0.0 {
        return Term::default();
    }
    let e = exponent(factor);
    Term { coefficient: (factor * power_of_two(30 - e)) as i32, shift: (-2 - e).clamp(-64, 64) as i8 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn sqrt_is_the_root(value in 1e-30_f32..1e30) {
            let exact = f64::from(value).sqrt();
            prop_assert!((f64::from(sqrt(value)) / exact - 1.0).abs() < 2.0 * f64::from(f32::EPSILON));
        }

        #[test]
        fn single_is_the_value(value: i64, shift in 0_u32..63) {
            let value = value >> shift;
            let exact = i128::from(value);
            let error = (f64::from(single(value)) - value as f64).abs();
            prop_assert!(error <= 2.0 * f64::from(f32::EPSILON) * (value as f64).abs(), "{value}: {}", single(value));
            let wide = exact << (63 - shift);
            let error = (f64::from(single_of_wide(wide)) - wide as f64).abs();
            prop_assert!(error <= 4.0 * f64::from(f32::EPSILON) * (wide as f64).abs(), "{wide}");
        }

        #[test]
        fn exponent_brackets(value in 1e-100_f64..1e100) {
            let e = exponent(value);
            prop_assert!(power_of_two(e) <= value && value < power_of_two(e + 1));
        }
    }
}
