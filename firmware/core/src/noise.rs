//! Noise of the force in one sample, whatever the motion.
//!
//! The fourth difference of five samples is 8.4 times the rms of white noise, and passes `(w T)^4` of a motion: 1e-4 of
//! 16 Hz at 1 kHz, 1 % of mains pickup. Flanks that meet and friction that reverses leave far more, but in few samples.
//! So the differences are counted by octaves of their magnitude, and their lower quartile gives the noise: within 8 %
//! after 4 s of white noise, 20 % too high with the impacts of 0.1 mm of backlash at 1 kHz. It is too low for coloured
//! noise and for drift, and too high at sample rates below 500 Hz.
//!
//! State: counters, which forget a fraction of their counts with each difference: a memory of 16 s at one difference in
//! 8 ms. A count depends only on which differences came and how many have followed each, so the same samples again
//! leave the same counts.

/// Logarithm of the number of differences that are remembered.
const MEMORY_LOG2: u32 = 11;
/// Increment for one difference: the counts together are 2^31 at most, and what truncation never forgets is 2^-9 of a
/// difference.
const ONE: u32 = 1 << (31 - MEMORY_LOG2);
/// Fewest differences for a result: the noise is then within 60 %.
const FEWEST: u32 = 32;
/// Octaves of a magnitude of 32 bits, and zero.
const OCTAVES: usize = 33;

/// Fourth differences of the force by the octaves of their magnitude.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Noise {
    octaves: [u32; OCTAVES],
}

impl Noise {
    /// Fraction bits of the quartile.
    pub const FRACTION: u32 = 8;

    /// Nothing seen.
    pub const fn new() -> Self {
        Self { octaves: [0; OCTAVES] }
    }

    /// Takes five consecutive samples of the force [codes]; wraps where they are beyond 28 bits.
    #[inline]
    pub fn push(&mut self, [a, b, c, d, e]: [i32; 5]) {
        let ends = a.wrapping_add(e).wrapping_sub(b.wrapping_add(d).wrapping_shl(2));
        let difference = ends.wrapping_add(c.wrapping_mul(6)).unsigned_abs();
        let octave = u32::BITS - difference.leading_zeros();
        self.octaves.iter_mut().for_each(|count| *count -= *count >> MEMORY_LOG2);
        if let Some(count) = self.octaves.get_mut(octave as usize) {
            *count += ONE;
        }
    }

    /// Number of differences remembered.
    pub fn differences(&self) -> u32 {
        self.octaves.iter().sum::<u32>() / ONE
    }

    /// The magnitude [2^-FRACTION codes] below which this many quarters of the fourth differences lie, interpolated
    /// linearly within its octave; `None` with too few differences.
    pub fn quantile(&self, quarters: u32) -> Option<u64> {
        let total: u32 = self.octaves.iter().sum();
        // Each difference has lost a little to those after it, all together less than one.
        if total <= (FEWEST - 1) * ONE {
            return None;
        }
        let mut missing = (total >> 2) * quarters;
        // What rounds to an octave's least or greatest code belongs to the octave.
        let (mut from, mut to) = (0_u64, 1 << (Self::FRACTION - 1));
        for &count in &self.octaves {
            if count > missing {
                // Linear interpolation over at most 2^40, in steps of 2^-16.
                let along = (u64::from(missing) << 16) / u64::from(count);
                return Some(from + (((to - from) * along) >> 16));
            }
            missing -= count;
            (from, to) = (to, 2 * to + (1 << (Self::FRACTION - 1)));
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use inerter_needs::Random;

    /// Quartile of the fourth differences of normal noise, per its rms.
    const QUARTILE: f64 = 0.3186 * 8.3666;

    /// The rms found for a force with noise of `rms` [codes]. `disturbance` is added, by the number of the five samples
    /// and the place among them.
    fn told(noise: &mut Noise, rms: f64, count: usize, disturbance: impl Fn(usize, usize) -> f64) -> f64 {
        let mut random = Random(11);
        for n in 0..count {
            let sample = |i: usize| (rms * random.normal() + disturbance(n, i)).round() as i32;
            noise.push([0, 1, 2, 3, 4].map(sample));
        }
        noise.quantile(1).unwrap() as f64 / f64::from(1 << Noise::FRACTION) / QUARTILE
    }

    #[test]
    fn white_noise_is_told_at_any_strength() {
        // From one code, below which the differences are too coarse, to saturation.
        for rms in [1.0, 3.3, 70.0, 1000.0, 3e5] {
            let found = told(&mut Noise::new(), rms, 4000, |_, _| 0.0);
            let all = (rms * rms + 1.0 / 12.0_f64).sqrt();
            assert!((found / all - 1.0).abs() < 0.06, "{rms}: {found}");
        }
    }

    #[test]
    fn motion_and_impacts_are_not_noise() {
        // 600 N at 16 Hz and 1 kHz with 5 N of pickup at 50 Hz, in codes of 5 mN, under noise of 1 N and of 0.1 N.
        let motion = |n: usize, i: usize| {
            let t = (8 * n + i) as f64 * 1e-3 * core::f64::consts::TAU;
            1.2e5 * (16.0 * t).sin() + 1e3 * (50.0 * t).sin()
        };
        let impacts = |n: usize, i: usize| if n.is_multiple_of(5) && i > 2 { 2e4 } else { 0.0 };
        let plain = told(&mut Noise::new(), 200.0, 4000, |_, _| 0.0);
        assert!((told(&mut Noise::new(), 200.0, 4000, motion) / plain - 1.0).abs() < 0.02);
        assert!((told(&mut Noise::new(), 20.0, 4000, motion) / 20.0 - 1.0).abs() < 0.3);
        let struck = told(&mut Noise::new(), 200.0, 4000, impacts);
        assert!((1.1..1.4).contains(&(struck / plain)), "{struck} against {plain}");
    }

    #[test]
    fn the_past_is_forgotten_and_few_tell_nothing() {
        let mut noise = Noise::new();
        assert_eq!(noise.quantile(1), None);
        told(&mut noise, 100.0, 30_000, |_, _| 0.0);
        let after = told(&mut noise, 1000.0, 20_000, |_, _| 0.0);
        assert!((after / 1000.0 - 1.0).abs() < 0.06, "{after}");
        (0..50_000).for_each(|_| noise.push([i32::MIN, i32::MAX, i32::MIN, i32::MAX, 7]));
        assert!(noise.quantile(1).is_some() && noise.octaves.iter().sum::<u32>() < (1 << 31) + (1 << 17));
        let mut few = Noise::new();
        (1..FEWEST).for_each(|_| few.push([5; 5]));
        assert_eq!(few.quantile(1), None);
        few.push([5; 5]);
        // Noise that cannot be distinguished from none.
        assert!(few.quantile(1).unwrap() < 128);
    }

    /// An octave holds the magnitudes that round to its codes: 8 to 15 and 16 to 31 in the fourth and fifth. Of 40
    /// differences in each, every quarter is half an octave.
    #[test]
    fn quarters_of_two_octaves_are_their_middles_and_what_lies_between() {
        let mut noise = Noise::new();
        (noise.octaves[4], noise.octaves[5]) = (40 * ONE, 40 * ONE);
        for (quarters, codes) in [(1, 11.5), (2, 15.5), (3, 23.5)] {
            let found = noise.quantile(quarters).unwrap() as f64 / f64::from(1 << Noise::FRACTION);
            assert!((found - codes).abs() < 0.01, "{quarters}: {found}");
        }
        assert_eq!(noise.differences(), 80);
    }
}
