//! Random numbers of the defects: devices, sizes and noise. No threshold was set on any of them.

use rand_chacha::{
    ChaCha8Rng,
    rand_core::{RngCore, SeedableRng},
};

/// First seed of the defects. All other tests use much smaller seeds.
const FIRST: u64 = 0x00de_fec7_0000_0000;

/// Random numbers of one run.
#[derive(Clone, Debug)]
pub struct Draw(ChaCha8Rng);

impl Draw {
    /// The numbers of a run, from its seed and the number of its kind and motion.
    pub fn new(seed: u64, stream: u64) -> Self {
        let mut random = ChaCha8Rng::seed_from_u64(FIRST + seed);
        random.set_stream(stream);
        Self(random)
    }

    /// Uniform between 0 and 1, both excluded.
    pub fn unit(&mut self) -> f64 {
        ((self.0.next_u64() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    }

    /// Uniform between two numbers.
    pub fn within(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Log-uniform between two positive numbers.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low * (high / low).powf(self.unit())
    }

    /// 1 or -1.
    pub fn sign(&mut self) -> f64 {
        if self.unit() < 0.5 { -1.0 } else { 1.0 }
    }

    /// True with this probability.
    pub fn happens(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }

    /// A random element.
    pub fn one_of<T: Copy>(&mut self, all: &[T]) -> T {
        all[((self.unit() * all.len() as f64) as usize).min(all.len() - 1)]
    }

    /// Noise of unit variance: the sum of two uniform numbers. Its tails end at 2.4 standard deviations, unlike those
    /// of the simulator's noise.
    pub fn noise(&mut self) -> f64 {
        (self.unit() + self.unit() - 1.0) * 6_f64.sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_spread_as_told_and_streams_differ() {
        let mut draw = Draw::new(1, 2);
        let noise: Vec<f64> = (0..20_000).map(|_| draw.noise()).collect();
        let square = noise.iter().map(|x| x * x).sum::<f64>() / noise.len() as f64;
        assert!((square - 1.0).abs() < 0.02 && noise.iter().sum::<f64>().abs() < 400.0, "{square}");
        assert!((0..1000).all(|_| (2.0..8.0).contains(&draw.between(2.0, 8.0))));
        assert!((0..1000).any(|_| draw.one_of(&[1, 2, 3]) == 3));
        assert_ne!(Draw::new(1, 3).unit(), Draw::new(1, 4).unit());
        assert_eq!(Draw::new(1, 3).unit(), Draw::new(1, 3).unit());
    }
}
