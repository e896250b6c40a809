//! The few functions of a real number that reporting needs, the same to the bit on every machine.
//!
//! micromath gives the seed by name, never through method call syntax, which would pick std's function on a PC.

use crate::qformat::Term;

/// Square root, within two units in the last place; 0 for what has none.
pub fn sqrt(value: f32) -> f32 {
    if value.is_nan() || value <= 0.0 {
        return 0.0;
    }
    if value.is_infinite() {
        return value;
    }
    // micromath is within 6 %; each Newton step squares that: 2e-3, 2e-6, 2e-12.
    let seed = micromath::F32Ext::sqrt(value);
    (0..3).fold(seed, |root, _| 0.5 * (root + value / root))
}

/// The value without its sign.
pub fn magnitude(value: f32) -> f32 {
    if value < 0.0 { -value } else { value }
}

/// The value times itself.
pub fn square(value: f32) -> f32 {
    value * value
}

/// `value` as it is, nearly.
pub fn single(value: i128) -> f32 {
    let magnitude = value.unsigned_abs();
    let unsigned = (magnitude >> 64) as u64 as f32 * power(64) + magnitude as u64 as f32;
    if value < 0 { -unsigned } else { unsigned }
}

/// The greater of two.
pub fn greater(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
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

/// `factor` as mantissa and shift; nothing when it is 0.
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
        fn exponent_brackets(value in 1e-100_f64..1e100) {
            let e = exponent(value);
            prop_assert!(power_of_two(e) <= value && value < power_of_two(e + 1));
        }
    }
}
