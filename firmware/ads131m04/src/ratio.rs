//! Correction of a bridge's conversion for its excitation.
//!
//! A bridge's output is proportional to its excitation, which is converted at the same instant on another channel.
//! `corrected = bridge * nominal / excitation`: what the bridge would have given at the nominal excitation.

/// The excitation is not what the bridge was calibrated with: a broken wire, a short, or a supply that is off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ExcitationFault {
    /// The excitation's code.
    pub code: i32,
}

impl core::fmt::Display for ExcitationFault {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "excitation code {}: more than a quarter off; check the bridge's supply and wiring", self.code)
    }
}

impl core::error::Error for ExcitationFault {}

/// Multiplies by the ratio of the excitations, in integers.
///
/// Rounds to the nearest code, halves up: within half a code of the exact quotient (test `within_half_a_code`). A
/// bridge code at either end of the range stays there, so that saturation remains visible; a product beyond the range
/// is clamped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ratiometric {
    nominal: i32,
}

/// Ends of a conversion's range.
const MIN: i32 = -0x80_0000;
const MAX: i32 = 0x7F_FFFF;

impl Ratiometric {
    /// For this code of the nominal excitation. `None` under 2^16, where its own noise would show in the quotient, and
    /// above 6710886, where an excitation a quarter higher would look like a saturated one.
    pub const fn new(nominal: i32) -> Option<Self> {
        if nominal < 1 << 16 || nominal > MAX / 5 * 4 {
            return None;
        }
        Some(Self { nominal })
    }

    /// The bridge's code at the nominal excitation. The excitation must lie within a quarter of nominal.
    pub const fn correct(&self, bridge: i32, excitation: i32) -> Result<i32, ExcitationFault> {
        let quarter = self.nominal / 4;
        if excitation < self.nominal - quarter || excitation > self.nominal + quarter {
            return Err(ExcitationFault { code: excitation });
        }
        if bridge <= MIN {
            return Ok(MIN);
        }
        if bridge >= MAX {
            return Ok(MAX);
        }
        // |bridge| and nominal are under 2^23: the product is under 2^46, twice that is exact.
        let (product, divisor) = (bridge as i64 * self.nominal as i64, excitation as i64);
        let rounded = (2 * product + divisor).div_euclid(2 * divisor);
        Ok(if rounded < MIN as i64 {
            MIN
        } else if rounded > MAX as i64 {
            MAX
        } else {
            rounded as i32
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use inerter_needs::Random;

    #[test]
    fn within_half_a_code() {
        let mut random = Random(1);
        let mut worst = 0.0_f64;
        for _ in 0..200_000 {
            let nominal = 65_536 + random.below(6_600_000_i32);
            let excitation = nominal - nominal / 4 + random.below(nominal / 2);
            let bridge = random.below(1_i32 << 24) - 0x80_0000;
            let exact = f64::from(bridge) * f64::from(nominal) / f64::from(excitation);
            let got = Ratiometric::new(nominal).expect("in range").correct(bridge, excitation).expect("in range");
            if (f64::from(MIN)..=f64::from(MAX)).contains(&exact) && bridge > MIN && bridge < MAX {
                worst = worst.max((f64::from(got) - exact).abs());
            } else {
                assert!(got == MIN || got == MAX);
            }
        }
        assert!((0.499..=0.500_000_1).contains(&worst), "{worst}");
    }

    #[test]
    fn a_drifting_excitation_leaves_no_trace() {
        let ratio = Ratiometric::new(6_000_000).expect("in range");
        for permille in 760..=1240 {
            let (bridge, excitation) = (1_000 * permille, 6_000 * permille);
            let corrected = ratio.correct(bridge, excitation).expect("in range");
            assert!((corrected - 1_000_000).abs() <= 1, "{corrected}");
        }
    }

    #[test]
    fn halves_round_up() {
        // Seven eighths of 4 is 3.5, of -4 it is -3.5.
        let ratio = Ratiometric::new(7 << 17).expect("in range");
        assert_eq!([4, -4, 3, -3].map(|bridge| ratio.correct(bridge, 8 << 17)), [Ok(4), Ok(-3), Ok(3), Ok(-3)]);
    }

    #[test]
    fn ends_of_the_range_stay_visible() {
        let ratio = Ratiometric::new(4_000_000).expect("in range");
        assert_eq!(ratio.correct(MAX, 5_000_000), Ok(MAX));
        assert_eq!(ratio.correct(MIN, 5_000_000), Ok(MIN));
        assert_eq!(ratio.correct(MAX - 1, 3_500_000), Ok(MAX));
        assert_eq!(ratio.correct(i32::MIN, 4_000_000), Ok(MIN));
        assert_eq!(ratio.correct(i32::MAX, 4_000_000), Ok(MAX));
    }

    #[test]
    fn a_broken_excitation_is_a_fault() {
        let ratio = Ratiometric::new(4_000_000).expect("in range");
        for code in [0, -4_000_000, 2_999_999, 5_000_001, i32::MIN, i32::MAX] {
            assert_eq!(ratio.correct(1, code), Err(ExcitationFault { code }));
        }
        assert_eq!(Ratiometric::new(0), None);
        assert_eq!(Ratiometric::new(MAX), None);
    }
}
