//! Data rate, group delay, and the encoder position that matches both.
//!
//! Up to an OSR of 1024 the decimation filter is sinc3 of N = OSR. Above, it is sinc3 of N = 1024 followed by sinc1 of
//! M = OSR / 1024 (SBAS890, "SINC3 and SINC3 + SINC1 Filter"), so the delay in periods is not the same at every rate:
//!
//! | OSR | CLKIN 8 MHz \[Hz\] | group delay \[periods\] | \[us\] |
//! |---|---|---|---|
//! | 1024 | 3906.25 | 3/2 | 384 |
//! | 2048 | 1953.125 | 1 | 512 |
//! | 4096 | 976.5625 | 3/4 | 768 |
//!
//! What the chip adds on top (half of it a modulator sample of 0.25 us, the rest the time from the end of the filter to
//! DRDY) is constant and belongs to the setting `skew_s`.

/// Oversampling ratio.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
#[repr(u8)]
pub enum Osr {
    /// 128.
    X128 = 0,
    /// 256.
    X256 = 1,
    /// 512.
    X512 = 2,
    /// 1024: the chip's own default.
    #[default]
    X1024 = 3,
    /// 2048.
    X2048 = 4,
    /// 4096.
    X4096 = 5,
    /// 8192.
    X8192 = 6,
    /// 16384.
    X16384 = 7,
}

/// Longest sinc3.
const SINC3_MAX: u32 = 1024;

impl Osr {
    /// All, in the order of the register.
    pub const ALL: [Self; 8] =
        [Self::X128, Self::X256, Self::X512, Self::X1024, Self::X2048, Self::X4096, Self::X8192, Self::X16384];

    /// tMOD in one conversion.
    pub const fn ratio(self) -> u32 {
        128 << self as u32
    }

    /// Lengths of the filter's stages: sinc3 \[tMOD\], and sinc1 \[outputs of the sinc3\].
    pub const fn stages(self) -> (u32, u32) {
        let ratio = self.ratio();
        if ratio > SINC3_MAX { (SINC3_MAX, ratio / SINC3_MAX) } else { (ratio, 1) }
    }

    /// CLKIN periods from conversion to conversion.
    pub const fn period_clkin(self) -> u32 {
        2 * self.ratio()
    }

    /// Conversions a second: `clkin_hz / 2 / OSR`. Exact for every clock of a whole number of hertz.
    pub const fn data_rate_hz(self, clkin_hz: u32) -> f64 {
        clkin_hz as f64 / self.period_clkin() as f64
    }

    /// The ratio that gives this rate, exactly.
    pub fn from_data_rate(clkin_hz: u32, rate_hz: f64) -> Option<Self> {
        Self::ALL.into_iter().find(|osr| osr.data_rate_hz(clkin_hz) == rate_hz)
    }

    /// Group delay \[CLKIN periods\], from the middle of what a conversion averages to the last modulator sample in it:
    /// `3 (N - 1) + (M - 1) N`.
    pub const fn group_delay_clkin(self) -> u32 {
        let (n, m) = self.stages();
        3 * (n - 1) + (m - 1) * n
    }

    /// Conversions after a step that still contain data from before: `3` with sinc3 alone, else `2`.
    /// After a reset two come from the fast-settling filter, so [`SETTLING`](Self::SETTLING) are left out in every
    /// case.
    pub const fn settling(self) -> u32 {
        let (_, m) = self.stages();
        if m == 1 { 3 } else { 2 }
    }

    /// Conversions not to be used after a reset, a change of set-up or a resynchronisation: two of the fast-settling
    /// filter (SBAS890, "Fast-Settling Filter"), and up to three in which sinc3 settles.
    pub const SETTLING: u32 = 5;

    /// Weights of the counts latched by this DRDY edge and the three before, in 256ths.
    ///
    /// They have the mean, the variance and the third moment of the chip's filter: `(M + 2) / 2 M` periods,
    /// `(M^2 + 2) / 12 M^2` periods squared, and zero. The mismatch left between position and force, up to an OSR
    /// of 4096 at CLKIN 8 MHz, is under 2 ns and 2.2 ppm for motion up to 16 Hz (test
    /// `position_and_force_have_one_delay_and_one_droop`).
    pub const fn position_taps(self) -> [i16; 4] {
        match self {
            Self::X128 | Self::X256 | Self::X512 | Self::X1024 => [0, 128, 128, 0],
            Self::X2048 => [16, 224, 16, 0],
            Self::X4096 => [45, 237, -33, 7],
            Self::X8192 => [67, 228, -49, 10],
            Self::X16384 => [81, 216, -51, 10],
        }
    }
}

/// The encoder's position at the instant of a conversion.
///
/// Takes the 32-bit count that each DRDY edge latched, wrapping; returns 64ths of a count, wrapping, rounded half up:
/// within 1/128 count of the weighted mean. Push for every conversion, in order, whether it is used or not; after a
/// loss, call [`reset`](Self::reset).
#[derive(Clone, Debug)]
pub struct MatchedPosition {
    taps: [i16; 4],
    /// Counts before this one, the latest first.
    before: [u32; 3],
    known: usize,
}

impl MatchedPosition {
    /// For conversions at this ratio.
    pub const fn new(osr: Osr) -> Self {
        Self { taps: osr.position_taps(), before: [0; 3], known: 0 }
    }

    /// Forgets earlier counts: the next position comes with the fourth count.
    pub const fn reset(&mut self) {
        self.known = 0;
    }

    /// Takes the count latched with a conversion and returns that conversion's position \[1/64 count\].
    ///
    /// `None` for the first three, and if the counts are tens of millions apart, which no encoder moves in a period.
    pub fn push(&mut self, latched: u32) -> Option<i32> {
        let counts = [latched, self.before[0], self.before[1], self.before[2]];
        self.before = [counts[0], counts[1], counts[2]];
        if self.known < self.before.len() {
            self.known += 1;
            return None;
        }
        // Differences from one of them are small, whatever the wrap; their weighted sum is 256ths.
        let origin = counts[1];
        let sum: i64 = counts
            .iter()
            .zip(self.taps)
            .map(|(count, tap)| i64::from(count.wrapping_sub(origin) as i32) * i64::from(tap))
            .sum();
        let fraction = i32::try_from((sum + 2) >> 2).ok()?;
        Some((origin as i32).wrapping_mul(64).wrapping_add(fraction))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::TAU;
    use std::vec;
    use std::vec::Vec;

    const CLKIN_HZ: u32 = 8_000_000;

    /// The chip's filter, built from its definition: three boxes of N modulator samples, one of M spaced by N.
    fn impulse_response(osr: Osr) -> Vec<f64> {
        let (n, m) = osr.stages();
        let convolve = |signal: &[f64], taps: u32, spacing: u32| {
            let mut out = vec![0.0; signal.len() + ((taps - 1) * spacing) as usize];
            for tap in 0..taps as usize {
                for (index, value) in signal.iter().enumerate() {
                    out[index + tap * spacing as usize] += value / f64::from(taps);
                }
            }
            out
        };
        // Running sums would round; these lengths are short enough for plain convolution, on a thinned grid.
        let thin = 16;
        let mut response = vec![1.0];
        for _ in 0..3 {
            response = convolve(&response, n / thin, 1);
        }
        convolve(&response, m, n / thin)
    }

    /// Phase \[rad\] and gain at a frequency given in cycles per element, phase relative to element zero.
    fn spectrum(weights: impl Iterator<Item = (f64, f64)>, radians_per_unit: f64) -> (f64, f64) {
        let (re, im) = weights.fold((0.0, 0.0), |(re, im), (place, weight)| {
            (re + weight * (radians_per_unit * place).cos(), im + weight * (radians_per_unit * place).sin())
        });
        (im.atan2(re), re.hypot(im))
    }

    #[test]
    fn rates_and_delays_of_the_data_sheet() {
        assert_eq!(
            [Osr::X1024, Osr::X2048, Osr::X4096].map(|osr| osr.data_rate_hz(CLKIN_HZ)),
            [3906.25, 1953.125, 976.5625]
        );
        assert_eq!(Osr::X1024.data_rate_hz(8_192_000), 4000.0);
        assert_eq!(Osr::from_data_rate(CLKIN_HZ, 976.5625), Some(Osr::X4096));
        assert_eq!(Osr::from_data_rate(CLKIN_HZ, 1000.0), None);
        for osr in Osr::ALL {
            let response = impulse_response(osr);
            let total: f64 = response.iter().sum();
            assert!((total - 1.0).abs() < 1e-9);
            let mean: f64 = response.iter().enumerate().map(|(place, weight)| place as f64 * weight).sum();
            // A cell of the thinned grid stands for 16 modulator samples, with its middle at 7.5, which counts once
            // per box.
            let delay_tmod = mean * 16.0 + 3.0 * 7.5;
            assert!((delay_tmod * 2.0 - f64::from(osr.group_delay_clkin())).abs() < 1e-6, "{osr:?}");
        }
    }

    #[test]
    fn position_and_force_have_one_delay_and_one_droop() {
        for (osr, delay_bound_s, gain_bound) in [
            (Osr::X1024, 1e-11, 1e-7),
            (Osr::X2048, 1e-11, 1e-7),
            (Osr::X4096, 2e-9, 2.2e-6),
            (Osr::X8192, 1e-7, 5e-5),
            (Osr::X16384, 4e-6, 1e-3),
        ] {
            let ratio = f64::from(osr.ratio());
            let period_s = 1.0 / osr.data_rate_hz(CLKIN_HZ);
            assert_eq!(osr.position_taps().iter().map(|&tap| i32::from(tap)).sum::<i32>(), 256);
            for hz in [0.053, 0.5, 3.2, 8.0, 16.0] {
                let radians_per_s = TAU * hz;
                let response = impulse_response(osr);
                // Places back in time [s], less the constant half modulator samples: 1.5 tMOD in all.
                let length = response.len() as f64;
                let (n, m) = osr.stages();
                let nominal_s = period_s * f64::from(3 * n + (m - 1) * n) / (2.0 * ratio);
                let force = spectrum(
                    response.iter().enumerate().map(|(place, &weight)| {
                        let centred = place as f64 - (length - 1.0) / 2.0;
                        (nominal_s + centred * 16.0 / ratio * period_s, weight)
                    }),
                    radians_per_s,
                );
                let position = spectrum(
                    osr.position_taps()
                        .iter()
                        .enumerate()
                        .map(|(back, &tap)| (back as f64 * period_s, f64::from(tap) / 256.0)),
                    radians_per_s,
                );
                let delay_s = (position.0 - force.0) / radians_per_s;
                let gain = position.1 / force.1 - 1.0;
                assert!(delay_s.abs() < delay_bound_s, "{osr:?} at {hz} Hz: {delay_s} s");
                assert!(gain.abs() < gain_bound, "{osr:?} at {hz} Hz: {gain}");
            }
        }
    }

    #[test]
    fn a_steady_motion_is_read_where_it_was() {
        for osr in Osr::ALL {
            let (n, m) = osr.stages();
            let delay = f64::from((m + 2) * n) / f64::from(2 * osr.ratio());
            let mut position = MatchedPosition::new(osr);
            // Across the wrap of the counter.
            let counts = (0..8_u32).map(|step| (0xFFFF_FF00_u32).wrapping_add(step * 100));
            for (step, count) in counts.enumerate() {
                let expected = (step as f64 - delay) * 100.0 * 64.0 - 256.0 * 64.0;
                match position.push(count) {
                    None => assert!(step < 3),
                    Some(value) => assert!((f64::from(value) - expected).abs() <= 25.5, "{osr:?}: {value} {expected}"),
                }
            }
        }
    }

    #[test]
    fn rounding_is_within_half_a_64th() {
        let mut position = MatchedPosition::new(Osr::X4096);
        let counts = [7_u32, 19, 3, 11, 8, 1_000_003, 22, 4];
        for (index, &count) in counts.iter().enumerate() {
            if let Some(value) = position.push(count) {
                let back = |steps: usize| f64::from(counts[index - steps]);
                let exact = (45.0 * back(0) + 237.0 * back(1) - 33.0 * back(2) + 7.0 * back(3)) / 4.0;
                assert!((f64::from(value) - exact).abs() <= 0.5, "{value} {exact}");
            }
        }
    }

    #[test]
    fn after_a_loss_three_counts_are_needed_again() {
        let mut position = MatchedPosition::new(Osr::X1024);
        assert_eq!([0, 2, 4, 6].map(|count| position.push(count)), [None, None, None, Some(3 * 64)]);
        position.reset();
        assert_eq!([1000, 1002, 1004, 1006].map(|count| position.push(count)), [None, None, None, Some(1003 * 64)]);
    }

    #[test]
    fn counts_that_no_encoder_gives_are_no_position() {
        let mut position = MatchedPosition::new(Osr::X4096);
        assert_eq!([0, 0, 0, 0x7FFF_FFFF].map(|count| position.push(count)), [None; 4]);
    }
}
