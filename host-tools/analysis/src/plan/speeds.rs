//! Sums of the regressors by speed, from which those away from rest follow for any motion.
//!
//! The estimator fits the law to all updates and to those faster than half the RMS speed; the difference of the
//! parameters between the two widens the intervals (docs/THEORY.md, 6). Which updates those are depends on all parts of
//! a motion, so each part keeps its sums in half octaves of speed.

use crate::fit::Products;

/// Lowest and highest half octave of speed that are distinguished \[m/s, rad/s\].
const LOWEST: i32 = -60;
const HIGHEST: i32 = 20;

/// Sums of updates above each speed.
#[derive(Clone, Debug, Default)]
pub(super) struct Speeds {
    /// Sums by half octave, the slowest first.
    by_speed: Vec<Products>,
}

fn place(speed: f64) -> usize {
    let octaves = 2.0 * speed.max(f64::MIN_POSITIVE).log2();
    (octaves.floor().clamp(f64::from(LOWEST), f64::from(HIGHEST)) as i32 - LOWEST) as usize
}

impl Speeds {
    /// Adds the increase of the sums in one update.
    pub fn push(&mut self, update: &Products) {
        if self.by_speed.is_empty() {
            self.by_speed = vec![update.times(0.0); (HIGHEST - LOWEST + 1) as usize];
        }
        let [_, square] = update.mean_squares();
        let sums = &mut self.by_speed[place(square.max(0.0).sqrt())];
        *sums = sums.and(update);
    }

    /// The sums multiplied by a factor.
    pub fn times(mut self, factor: f64) -> Self {
        self.by_speed.iter_mut().for_each(|sums| *sums = sums.times(factor));
        self
    }

    /// Converts the sums into cumulative sums of all updates that are as fast or faster.
    pub fn accumulated(mut self) -> Self {
        let mut faster: Option<Products> = None;
        for sums in self.by_speed.iter_mut().rev() {
            let all = faster.map_or(*sums, |faster| faster.and(sums));
            (*sums, faster) = (all, Some(all));
        }
        self
    }

    /// Sums of the updates above a speed, interpolated between two half octaves; `None` if none is kept.
    pub fn above(&self, speed: f64) -> Option<Products> {
        let below = place(speed);
        let (slower, faster) = (self.by_speed.get(below)?, self.by_speed.get(below + 1)?);
        let part = (2.0 * speed.log2() - f64::from(below as i32 + LOWEST)).clamp(0.0, 1.0);
        Some(slower.times(1.0 - part).and(&faster.times(part)))
    }
}
