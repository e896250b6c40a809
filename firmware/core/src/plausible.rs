//! Whether counts and force are what sensors can give, for a few instructions a sample.
//!
//! - *Slipped counts*: the position bends more than the greatest force could bend it, given the inertance, and than steps do.
//! - *Clipped force*: codes pile up at an extreme of what was seen. A force that is not clipped leaves its extreme to the
//!   noise: within half its rms of the greatest of many samples lies one in a hundred of those within eight rms. A clipped one
//!   has lost its noise there.
//! - *Dead force*: the code stands still while the screw goes to and fro.
//! - *Wrong sign* is judged by the estimate (`report`).
//!
//! Samples that fail a gate are left out; where the gate needed a while to see it, the memories begin anew.

use crate::constants::{DEAD_REVERSALS, PILED_WITHIN, STILL_CODES};
use crate::detail::{Warning, WarningKind};
use crate::qformat::Term;
use crate::sign::ONE;

/// Bend of the position that steps and unequal lines of an encoder make of a steady velocity, at most [counts].
pub(crate) const SLIP_COUNTS: f64 = 3.0;
/// Room for the force that was not sampled, and for its delay.
pub(crate) const SLIP_FACTOR: f64 = 2.0;
/// Piled-up codes that tell something, and the part of the others that they must be.
const FEWEST: u32 = 64;
const PILED_PART: u32 = 2;
/// Every so many samples the force is looked at.
const LOOK: u8 = 4;
/// Looks after which it does.
const STILL_LOOKS: u8 = 2;
/// Estimates without the same cause until it is told again.
const QUIET: u8 = 10;

/// One extreme of the force.
#[derive(Clone, Copy, Debug)]
struct Extreme {
    greatest: i32,
    near: u32,
    wide: u32,
    /// The greatest code of all less the least one that is clipped here; 0 where none is.
    room: i32,
}

impl Extreme {
    /// All zeros, as every part of the state: see `change`.
    const NONE: Self = Self { greatest: 0, near: 0, wide: 0, room: 0 };

    /// The least code that is clipped.
    fn rail(&self) -> i32 {
        i32::MAX - self.room
    }

    /// Takes a code; true when those at this extreme have piled up now.
    fn push(&mut self, code: i32, resolution: i32) -> bool {
        let above = code.saturating_sub(self.greatest);
        if above > 0 {
            if above >= resolution {
                // Beyond what was taken for the extreme.
                *self = Self { greatest: code, ..Self::NONE };
            }
            self.greatest = code;
        }
        let below = -above.min(0);
        if below >= resolution * PILED_WITHIN {
            return false;
        }
        self.wide = self.wide.saturating_add(1);
        self.near = self.near.saturating_add(u32::from(below < resolution));
        let piled = self.near >= FEWEST && self.near.saturating_mul(PILED_PART) > self.wide;
        let newly = piled && self.room == 0;
        if newly {
            self.room = i32::MAX - (self.greatest - (resolution - 1)).max(1);
        }
        newly
    }
}

/// What the gates remember.
#[derive(Clone, Debug)]
pub(crate) struct Plausible {
    /// The last two positions, and how many in a row there are since they were lost, up to three.
    positions: [i32; 2],
    known: u8,
    /// Bend of the position by steps alone, 0 before the inertance is known, and per force code.
    bend: (u32, Term),
    /// Greatest force, which is forgotten by a sixteenth with each estimate.
    strongest: u32,
    high: Extreme,
    low: Extreme,
    /// Half of the force's noise [codes]; 0 where it is not known, or too little.
    resolution: i32,
    until_look: u8,
    still_at: i32,
    still_looks: u8,
    reversals: u8,
    sign: i32,
    quiet: [u8; 4],
    /// Estimates; each time that it comes round, half of what lies near the extremes is forgotten.
    estimates: u8,
    /// What is to be told, if anything is.
    pending: (bool, WarningKind),
}

/// What is wrong with a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Doubt {
    /// The position has jumped.
    pub slipped: bool,
    /// The force is none.
    pub no_force: bool,
    /// It has been none for a while, and was not known to be.
    pub since_a_while: bool,
}

impl Plausible {
    /// Nothing seen.
    pub const fn new() -> Self {
        Self {
            positions: [0; 2],
            known: 0,
            bend: (0, Term { coefficient: 0, shift: 0 }),
            strongest: 0,
            high: Extreme::NONE,
            low: Extreme::NONE,
            resolution: 0,
            until_look: 0,
            still_at: 0,
            still_looks: 0,
            reversals: 0,
            sign: 0,
            quiet: [0; 4],
            estimates: 0,
            pending: (false, WarningKind::WrongSign),
        }
    }

    /// Takes a sample: position and, where it is within its rails, force, in codes.
    pub fn push(&mut self, position: i32, force: Option<i32>, broken: bool) -> Doubt {
        let mut doubt = Doubt::default();
        let [last, before] = self.positions;
        let bent = position.wrapping_sub(last).wrapping_sub(last.wrapping_sub(before)).unsigned_abs();
        self.positions = [position, last];
        self.known = if broken { 1 } else { (self.known + 1).min(3) };
        let Some(force) = force else { return doubt };
        self.until_look = self.until_look.wrapping_sub(1);
        if self.until_look.is_multiple_of(LOOK) {
            doubt.since_a_while = self.look(force);
        }
        let is_clipped = self.high.room | self.low.room != 0 && self.is_clipped(force);
        doubt.no_force = is_clipped || self.reversals >= DEAD_REVERSALS;
        // A force that stands still may be none.
        if bent > self.bend.0
            && self.known == 3
            && !is_clipped
            && self.still_looks < STILL_LOOKS
            && self.slips(bent, force)
        {
            doubt.slipped = true;
            self.known = 0;
            self.warn(WarningKind::CountSlip);
        }
        doubt
    }

    /// Looks at a force; true when it has become clear that it is clipped.
    #[inline(never)]
    fn look(&mut self, force: i32) -> bool {
        self.strongest = self.strongest.max(force.unsigned_abs());
        self.still_looks = self.still_looks.saturating_add(1);
        if force.abs_diff(self.still_at) > STILL_CODES {
            (self.still_at, self.still_looks, self.reversals) = (force, 0, 0);
        }
        self.resolution > 0 && self.is_clipped_now(force)
    }

    fn is_clipped(&self, force: i32) -> bool {
        force >= self.high.rail() || force.saturating_neg() >= self.low.rail()
    }

    /// Whether the position bends by more than the force can do.
    #[inline(never)]
    fn slips(&self, bent: u32, force: i32) -> bool {
        let (steps, per_code) = self.bend;
        let strongest = i64::from(self.strongest.max(force.unsigned_abs()));
        steps > 0 && i64::from(bent) > i64::from(steps) + per_code.of(strongest)
    }

    /// Takes a force into its extremes; true when it has become clear that it is clipped.
    fn is_clipped_now(&mut self, force: i32) -> bool {
        let resolution = self.resolution;
        if self.high.push(force, resolution) | self.low.push(force.saturating_neg(), resolution) {
            // A force that hardly changes has no extremes.
            if self.high.greatest.saturating_add(self.low.greatest) > 2 * PILED_WITHIN * resolution {
                self.warn(WarningKind::ClippedForce);
                return true;
            }
            (self.high, self.low) = (Extreme::NONE, Extreme::NONE);
        }
        false
    }

    /// Which way the screw goes, in a sample that counts; true when the force has stood still for too long by now.
    pub fn goes(&mut self, sign: i32) -> bool {
        if sign.abs() != ONE || sign == self.sign {
            return false;
        }
        self.sign = sign;
        self.reversals = self.reversals.saturating_add(1);
        let dead = self.reversals == DEAD_REVERSALS;
        if dead {
            self.warn(WarningKind::DeadForce);
        }
        dead
    }

    /// After an estimate whose force pushes the screw the wrong way; one that stands still is not of any sign.
    pub fn backwards(&mut self) {
        if self.reversals < 2 {
            self.warn(WarningKind::WrongSign);
        }
    }

    /// After an estimate: what bends the position, and the force's noise [codes, rms].
    pub fn learn(&mut self, bend: Option<(u32, Term)>, noise: Option<f32>) {
        self.bend = bend.unwrap_or_default();
        self.strongest -= self.strongest.div_ceil(16);
        let resolution = match noise {
            Some(rms) => ((0.5 * rms) as i32).max(1),
            None => 0,
        };
        // What was counted by half or twice the width is no count.
        if resolution > 2 * self.resolution || 2 * resolution < self.resolution {
            for extreme in [&mut self.high, &mut self.low] {
                (extreme.near, extreme.wide) = (0, 0);
            }
            self.resolution = resolution;
        }
        self.estimates = self.estimates.wrapping_add(1);
        if self.estimates == 0 {
            for extreme in [&mut self.high, &mut self.low] {
                (extreme.near, extreme.wide) = (extreme.near / 2, extreme.wide / 2);
            }
        }
        self.quiet.iter_mut().for_each(|quiet| *quiet = quiet.saturating_sub(1));
    }

    /// Something is wrong; told once, and again after it was right for a while.
    #[cold]
    fn warn(&mut self, kind: WarningKind) {
        if let Some(quiet) = self.quiet.get_mut(kind as usize) {
            if *quiet == 0 {
                self.pending = (true, kind);
            }
            *quiet = QUIET;
        }
    }

    /// What is to be told with this sample.
    pub fn take(&mut self, index: u32) -> Option<Warning> {
        let (is_due, kind) = self.pending;
        self.pending.0 = false;
        is_due.then_some(Warning { index, kind })
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use super::*;

    /// Sums of twelve are normal enough.
    fn normal(seed: &mut u64) -> f64 {
        (0..12).fold(-6.0, |sum, _| {
            *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            sum + (*seed >> 11) as f64 / (1_u64 << 53) as f64
        })
    }

    /// The warnings of a force by its sample and the noise of 20 codes that it has before it is clipped to +-`rail`.
    fn of_force(rail: f64, force: impl Fn(f64) -> f64) -> Vec<WarningKind> {
        let (mut plausible, mut seed) = (Plausible::new(), 5);
        let mut told = Vec::new();
        for n in 0..20_000u32 {
            if n.is_multiple_of(100) {
                plausible.learn(None, (n > 0).then_some(20.0));
            }
            let clipped = (force(f64::from(n)) + 20.0 * normal(&mut seed)).clamp(-rail, rail);
            // What the converter adds.
            let code = (clipped + normal(&mut seed)).round() as i32;
            plausible.push(0, Some(code), false);
            told.extend(plausible.take(n).map(|warning| warning.kind));
        }
        told
    }

    #[test]
    fn a_clipped_force_piles_up_and_no_other_does() {
        let sine = |n: f64| 9000.0 * (n * 0.02).sin();
        assert_eq!(of_force(8000.0, sine), [WarningKind::ClippedForce]);
        assert_eq!(of_force(8900.0, sine), [WarningKind::ClippedForce]);
        let square = |n: f64| 9000.0 * (n * 0.02).sin().signum();
        let ramp = |n: f64| 9000.0 - 18_000.0 * (n * 0.01 % 1.0);
        let flat = |n: f64| 9000.0 * (1.3 * (n * 0.02).sin() + 0.2 * (n * 0.06).sin());
        for force in [&sine as &dyn Fn(f64) -> f64, &square, &ramp, &flat, &|_| 300.0, &|n| 0.5 * n] {
            assert_eq!(of_force(1e9, force), []);
        }
    }

    #[test]
    fn a_force_beyond_what_was_taken_for_clipping_is_a_force() {
        let mut plausible = Plausible::new();
        plausible.learn(None, Some(4.0));
        let mut clipped = |codes: core::ops::Range<i32>, limit: i32| {
            codes
                .filter(|n| plausible.push(0, Some((n * 37 % 4001 - 2000).clamp(-limit, limit)), false).no_force)
                .count()
        };
        assert!(clipped(0..16_000, 1500) > 2000);
        assert!(clipped(0..1600, 2000) < 40);
    }

    #[test]
    fn a_position_bends_by_the_force_and_jumps_by_nothing() {
        let mut plausible = Plausible::new();
        let bend = |n: i32| n * n / 2;
        // A code bends it by 0.01 of a step.
        plausible.learn(Some((3, crate::math::term(0.01))), None);
        let doubts = (0..300)
            .filter(|n| {
                plausible.push(bend(n % 100) + 3 * (n % 2), Some(100 + 9 * (n / i32::from(LOOK) % 2)), *n == 0).slipped
            })
            .count();
        assert!(doubts > 0, "by 6 steps at each sample");
        let mut plausible = Plausible::new();
        plausible.learn(Some((3, crate::math::term(0.01))), None);
        assert!(!(0..300).any(|n| plausible.push(bend(n), Some(100 + 9 * (n / i32::from(LOOK) % 2)), n == 0).slipped));
        let slips: Vec<i32> = (300..400)
            .filter(|n| {
                plausible
                    .push(bend(*n) + 7 * i32::from(*n > 350), Some(100 + 9 * (n / i32::from(LOOK) % 2)), false)
                    .slipped
            })
            .collect();
        assert_eq!(slips, [351]);
        assert_eq!(plausible.take(7), Some(Warning { index: 7, kind: WarningKind::CountSlip }));
        assert_eq!(plausible.take(8), None);
    }

    #[test]
    fn a_force_is_dead_that_stands_still_while_the_screw_reverses() {
        let mut plausible = Plausible::new();
        let mut dead = |codes: &[i32]| {
            let each = codes.iter().map(|code| {
                let told =
                    [(); LOOK as usize].map(|()| plausible.push(0, Some(*code), false).no_force)[LOOK as usize - 1];
                plausible.goes(-plausible.sign.signum() * ONE + ONE * i32::from(plausible.sign == 0));
                told
            });
            each.filter(|told| *told).count()
        };
        assert_eq!(dead(&[100; 8]), 2);
        assert_eq!(dead(&[103, 103, 103, 103]), 0);
        assert_eq!(dead(&[100, 108, 100, 108, 100, 108, 100, 108]), 0);
    }
}
