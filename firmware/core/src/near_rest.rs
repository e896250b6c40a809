//! The averages near rest, which show whether friction is Coulomb and viscous, and what it costs where it is not.
//!
//! Glossary: an update is *near rest* when its velocity is under half of the rms of the memory, else *away*.
//! Friction that creeps before it slips (presliding), or is greater near rest than in motion (Stribeck), departs from
//! the law near rest. The law then fits the updates away from rest better, and its parameters move. Where the law
//! holds, both fits leave the same residual. The ratio of the residual variances, all over away, is 0.8 to 1.2 with the
//! reference device, and less with 0.1 mm of backlash, as the flanks part in motion; up to 1.5 with Coulomb friction
//! that differs by 40 % between the directions; 1.7 and more with presliding over 20 um, except in slow motion, where
//! it does no harm; 1.3 to 2.4 with Stribeck friction of 1.3 at 5 mm/s (docs/tables/robustness.md). Friction that falls
//! with the velocity everywhere leaves no residual, but gives a negative viscous friction, which does not exist.
//!
//! State: the products of the updates near rest, averaged over all updates with the memory's own gain. The memory's
//! averages less these are those of the updates away from rest. Integers; `regime` evaluates them.

use crate::kernel::REGRESSORS;
use crate::rls::{Moments, PRODUCTS, part, place};

/// The velocity's product with itself.
const VELOCITY: usize = place(1, 1);

/// Part of a bank's averages that comes from updates near rest.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NearRest {
    /// Averages as of the latest update near rest.
    averages: [i64; PRODUCTS],
    /// Fraction of them forgotten since [2^-32]: weights need no more bits, as an update comes and goes as a whole.
    forgotten: u32,
}

impl NearRest {
    /// No updates yet.
    pub const fn new() -> Self {
        Self { averages: [0; PRODUCTS], forgotten: 0 }
    }

    /// Takes the products that the memory has just taken; if they are from away, only forgets as the memory does.
    #[inline]
    pub fn update(&mut self, products: &[i64; PRODUCTS], memory: &Moments, length: u32) {
        let gain = memory.gain(length);
        self.forgotten += ((u64::from(!self.forgotten) * u64::from(gain)) >> 32) as u32;
        // Half of the velocity's rms is a quarter of its mean square.
        if products[VELOCITY] < memory.averages()[VELOCITY] >> 2 {
            for (average, product) in self.averages.iter_mut().zip(products) {
                *average = part(*average, !self.forgotten) + part(*product, gain);
            }
            self.forgotten = 0;
        }
    }

    /// Part of the memory's averages that comes from updates away from rest.
    pub fn away(&self, memory: &Moments) -> [i64; PRODUCTS] {
        let mut away = *memory.averages();
        away.iter_mut().zip(self.averages).for_each(|(all, near)| *all = all.wrapping_sub(part(near, !self.forgotten)));
        away
    }
}

/// Product of the constant with itself: the weight of the updates in the averages.
pub(crate) const WEIGHT: usize = place(3, 3);
const _: () = assert!(WEIGHT < PRODUCTS && REGRESSORS == 5);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rls::products;

    fn fed(length: u32, velocities: impl Iterator<Item = i32>) -> (Moments, NearRest) {
        let (mut memory, mut near) = (Moments::new(), NearRest::new());
        for (n, velocity) in velocities.enumerate() {
            let products = products(&[(n as i32 % 91) << 20, velocity, velocity.signum() << 30, 1 << 30, velocity / 3]);
            memory.update(&products, length);
            near.update(&products, &memory, length);
        }
        (memory, near)
    }

    #[test]
    fn near_and_away_add_up_to_the_memory() {
        // One in four has a tenth of the others' velocity.
        let velocity = |n: i32| if n % 4 == 0 { 1 << 26 } else { 10 << 26 };
        for length in [50, 100_000] {
            let (memory, near) = fed(length, (1..4001).map(velocity));
            let away = near.away(&memory);
            let part = away[WEIGHT] as f64 / memory.averages()[WEIGHT] as f64;
            assert!((part - 0.75).abs() < 1.0 / f64::from(length.min(4000)), "{length}: {part}");
            // All of the faster ones are away, and nothing else.
            let mean_square = away[VELOCITY] as f64 / away[WEIGHT] as f64 * 2f64.powi(60 - 52);
            assert!((mean_square - 100.0).abs() < 1e-3, "{length}: {mean_square}");
        }
    }

    #[test]
    fn nothing_is_near_rest_at_one_speed() {
        let (memory, near) = fed(1000, (0..3000).map(|n| if n % 2 == 0 { 1 << 28 } else { -(1 << 28) }));
        assert_eq!(near.away(&memory), *memory.averages());
    }

    /// No velocity is under half of an rms of zero.
    #[test]
    fn nothing_is_near_rest_without_motion() {
        let (memory, near) = fed(1000, (0..100).map(|_| 0));
        assert!(memory.averages()[WEIGHT] > 0);
        assert_eq!(near.away(&memory), *memory.averages());
    }
}
