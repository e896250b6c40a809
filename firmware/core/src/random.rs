//! Random numbers for tests, the same for the same seed: the linear congruential generator of Knuth's MMIX.

/// The next number, which is the next seed.
pub fn draw(seed: &mut u64) -> u64 {
    *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    *seed
}

/// Normal enough for quartiles: the sum of twelve uniform numbers.
pub fn normal(seed: &mut u64) -> f64 {
    (0..12).fold(-6.0, |sum, _| sum + (draw(seed) >> 11) as f64 / (1_u64 << 53) as f64)
}
