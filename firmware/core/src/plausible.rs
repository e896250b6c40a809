//! Whether counts and force are plausible, for a few instructions a sample.
//!
//! - *Slipped counts*: the position bends by more than steps and the greatest force could bend it, given the inertance.
//! - *Clipped force*: codes pile up at an extreme of what was seen. A force that is not clipped leaves its extreme to
//!   the noise: of the many samples within eight rms of the greatest, one in a hundred lies within half an rms. A
//!   clipped force has lost its noise there.
//! - *Dead force*: the code stands still while the screw goes to and fro.
//! - *Wrong sign*: judged from the estimate (`report`).
//!
//! Samples that fail a check are left out. Where the check needed a while to detect it, the memories restart.

use crate::constants::{DEAD_REVERSALS, PILED_WITHIN, STILL_CODES};
use crate::detail::{Warning, WarningKind};
use crate::qformat::Term;
use crate::sign::ONE;

/// Greatest bend of the position that steps and unequal lines of an encoder cause at a steady velocity [counts].
pub(crate) const SLIP_COUNTS: f64 = 3.0;
/// Margin for the force between samples, and for its delay.
pub(crate) const SLIP_FACTOR: f64 = 2.0;
/// Fewest piled-up codes that count, and the fraction (one in this many) of the codes nearby that they must exceed.
const FEWEST: u32 = 64;
const PILED_PART: u32 = 2;
/// The force is examined once in this many samples.
const LOOK: u8 = 4;
/// Examinations without a change after which the force stands still.
const STILL_LOOKS: u8 = 2;
/// Estimates without the cause of a warning after which the warning may be repeated.
const QUIET: u8 = 10;

/// One extreme of the force.
#[derive(Clone, Copy, Debug)]
struct Extreme {
    greatest: i32,
    near: u32,
    wide: u32,
    /// `i32::MAX` less the least code that is clipped here; 0 if none is.
    room: i32,
}

impl Extreme {
    /// All zeros, as every part of the state: see `change`.
    const NONE: Self = Self { greatest: 0, near: 0, wide: 0, room: 0 };

    /// The least code that is clipped.
    fn rail(&self) -> i32 {
        i32::MAX - self.room
    }

    /// Takes a code; returns true if the codes at this extreme have just been found to pile up.
    fn push(&mut self, code: i32, resolution: i32) -> bool {
        let above = code.saturating_sub(self.greatest);
        if above > 0 {
            if above >= resolution {
                // Beyond what seemed to be the extreme.
                *self = Self::NONE;
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

/// State of the checks.
#[derive(Clone, Debug)]
pub(crate) struct Plausible {
    /// The last two positions, and the number of consecutive positions since the last discontinuity, up to three.
    positions: [i32; 2],
    known: u8,
    /// Greatest bend of the position: by steps alone, 0 before the inertance is known, and per force code.
    bend: (u32, Term),
    /// Greatest force; a sixteenth of it is forgotten with each estimate.
    strongest: u32,
    high: Extreme,
    low: Extreme,
    /// Half of the rms of the force's noise [codes]; 0 if it is unknown or too small.
    resolution: i32,
    until_look: u8,
    still_at: i32,
    still_looks: u8,
    reversals: u8,
    sign: i32,
    quiet: [u8; 4],
    /// Number of estimates; each time that it wraps, half of the counts near the extremes is forgotten.
    estimates: u8,
    /// Whether a warning is to be returned, and which.
    pending: (bool, WarningKind),
}

/// What is wrong with a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Doubt {
    /// The position has jumped.
    pub slipped: bool,
    /// The force is invalid.
    pub no_force: bool,
    /// It has been invalid for a while, and was not known to be.
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

    /// Takes a sample: the position and, if it is within its rails, the force, in codes.
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
        // A force that stands still may be dead.
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

    /// Examines a force; returns true if it has just been found to be clipped.
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

    /// Whether the position bends by more than the force can cause.
    #[inline(never)]
    fn slips(&self, bent: u32, force: i32) -> bool {
        let (steps, per_code) = self.bend;
        let strongest = i64::from(self.strongest.max(force.unsigned_abs()));
        steps > 0 && i64::from(bent) > i64::from(steps) + per_code.of(strongest)
    }

    /// Takes a force into its extremes; returns true if it has just been found to be clipped.
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

    /// Takes the direction of the screw in a good sample; returns true if the force has now stood still for too long.
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

    /// For an estimate whose force pushes the screw the wrong way. A force that stands still has no sign.
    pub fn backwards(&mut self) {
        if self.reversals < 2 {
            self.warn(WarningKind::WrongSign);
        }
    }

    /// After an estimate: the limits of the position's bend, and the force's noise [codes, rms].
    pub fn learn(&mut self, bend: Option<(u32, Term)>, noise: Option<f32>) {
        self.bend = bend.unwrap_or_default();
        self.strongest -= self.strongest.div_ceil(16);
        let resolution = match noise {
            Some(rms) => ((0.5 * rms) as i32).max(1),
            None => 0,
        };
        // Counts made with half or twice the width are invalid.
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

    /// Raises a warning: once, and again after the cause was absent for a while.
    #[cold]
    fn warn(&mut self, kind: WarningKind) {
        if let Some(quiet) = self.quiet.get_mut(kind as usize) {
            if *quiet == 0 {
                self.pending = (true, kind);
            }
            *quiet = QUIET;
        }
    }

    /// The warning to be returned with this sample.
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
    use inerter_needs::Random;

    /// The warnings for a force, given by the number of its sample, with noise of 20 codes before it is clipped to
    /// +-`rail`.
    fn of_force(rail: f64, force: impl Fn(f64) -> f64) -> Vec<WarningKind> {
        let (mut plausible, mut random) = (Plausible::new(), Random(5));
        let mut told = Vec::new();
        for n in 0..20_000u32 {
            if n.is_multiple_of(100) {
                plausible.learn(None, (n > 0).then_some(20.0));
            }
            let clipped = (force(f64::from(n)) + 20.0 * random.normal()).clamp(-rail, rail);
            // The noise that the converter adds.
            let code = (clipped + random.normal()).round() as i32;
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
        // Two codes to and fro are the converter's.
        assert_eq!(dead(&[100, 102, 100, 102, 100, 102, 100, 102]), 2);
    }

    /// By hand, for a resolution of 10: nearer than 10 is at the extreme, nearer than 160 is compared with it.
    #[test]
    fn codes_are_counted_by_their_distance_from_the_extreme() {
        let mut extreme = Extreme::NONE;
        assert_eq!(extreme.rail(), i32::MAX);
        for (code, near, wide, greatest) in [
            (1000, 1, 1, 1000),
            (991, 2, 2, 1000),
            (990, 2, 3, 1000),
            (841, 2, 4, 1000),
            (840, 2, 4, 1000),
            (-5000, 2, 4, 1000),
            // A little more is the same extreme; as much as the resolution is another one.
            (1009, 3, 5, 1009),
            (1019, 1, 1, 1019),
        ] {
            assert!(!extreme.push(code, 10));
            assert_eq!((extreme.near, extreme.wide, extreme.greatest), (near, wide, greatest), "{code}");
        }
    }

    #[test]
    fn codes_pile_up_from_64_on_that_are_more_than_half() {
        for (others, enough) in [(0, 64), (63, 64), (64, 65), (100, 101)] {
            let mut extreme = Extreme::NONE;
            assert!(!extreme.push(1000, 10));
            assert!(!(0..others).any(|_| extreme.push(950, 10)));
            assert_eq!((2..200).find(|_| extreme.push(1000, 10)), Some(enough), "among {others}");
            // What is nearer than the resolution is clipped; found once.
            assert_eq!(extreme.rail(), 991);
            assert!(!extreme.push(1000, 10));
        }
        // No force is no extreme.
        let mut small = Extreme::NONE;
        assert_eq!((1..200).find(|_| small.push(5, 10)), Some(64));
        assert_eq!(small.rail(), 1);
    }

    #[test]
    fn a_force_at_a_rail_or_beyond_is_left_out_on_that_side() {
        for (high, low) in [(true, false), (false, true), (true, true)] {
            let mut plausible = Plausible::new();
            plausible.high.room = if high { i32::MAX - 991 } else { 0 };
            plausible.low.room = if low { i32::MAX - 991 } else { 0 };
            let left_out = [990, 991, -990, -991].map(|force| plausible.push(0, Some(force), false).no_force);
            assert_eq!(left_out, [false, high, false, low]);
        }
    }

    /// Three positions show a bend, and a force that two looks found the same, at every fourth sample, may be dead.
    #[test]
    fn a_jump_is_told_from_the_third_sample_on_while_the_force_is_alive() {
        let slips = |n: i32| {
            let mut plausible = Plausible::new();
            plausible.learn(Some((3, Term::default())), None);
            for i in 1..n {
                plausible.push(10 * i, Some(100), i == 1);
            }
            plausible.push(10 * n + 100, Some(100), n == 1).slipped
        };
        for n in 1..=16 {
            // The first look finds a change, those at samples 8 and 12 find none.
            assert_eq!(slips(n), (3..12).contains(&n), "{n}");
        }
    }

    /// Three codes, and one per 128 codes of the greatest force: more than that is a jump.
    #[test]
    fn a_position_bends_by_steps_and_the_strongest_force() {
        let slips = |bent: i32, before: i32, now: i32| {
            let mut plausible = Plausible::new();
            plausible.learn(Some((3, crate::math::term(1.0 / 128.0))), None);
            for n in 0..4 {
                plausible.push(0, Some(before), n == 0);
            }
            plausible.push(bent, Some(now), false).slipped
        };
        for (before, now) in [(0, 1280), (1280, 0), (-1280, 5), (5, -1280)] {
            assert!(!slips(13, before, now) && slips(14, before, now), "{before} {now}");
            assert!(!slips(-13, before, now) && slips(-14, before, now), "{before} {now}");
        }
        assert!(!slips(3, 0, 0) && slips(4, 0, 0));
        // A sixteenth of the strongest force is forgotten with each estimate, and at least a code.
        let mut plausible = Plausible::new();
        for (before, after) in [(160, 150), (17, 15), (16, 15), (1, 0), (0, 0)] {
            plausible.strongest = before;
            plausible.learn(None, None);
            assert_eq!(plausible.strongest, after);
        }
    }

    #[test]
    fn counts_at_an_extreme_hold_for_about_the_same_noise_and_fade() {
        // Half of the rms is the resolution.
        for (before, rms, after) in [
            (10, Some(38.0), 10),
            (10, Some(44.0), 22),
            (10, Some(12.0), 10),
            (10, Some(8.0), 4),
            (0, Some(40.0), 20),
            (0, Some(0.8), 1),
            (10, None, 0),
        ] {
            let mut plausible = Plausible::new();
            plausible.resolution = before;
            (plausible.high.near, plausible.high.wide) = (7, 9);
            (plausible.low.near, plausible.low.wide) = (8, 20);
            plausible.learn(None, rms);
            let counts = [&plausible.high, &plausible.low].map(|extreme| (extreme.near, extreme.wide));
            let kept = if after == before { [(7, 9), (8, 20)] } else { [(0, 0); 2] };
            assert_eq!((plausible.resolution, counts), (after, kept), "{before} {rms:?}");
        }
        // Half is forgotten with every 256th estimate.
        let mut plausible = Plausible::new();
        (plausible.high.near, plausible.high.wide) = (7, 9);
        (plausible.low.near, plausible.low.wide) = (8, 20);
        (0..255).for_each(|_| plausible.learn(None, None));
        assert_eq!((plausible.high.near, plausible.low.wide), (7, 20));
        plausible.learn(None, None);
        let counts = [&plausible.high, &plausible.low].map(|extreme| (extreme.near, extreme.wide));
        assert_eq!(counts, [(3, 4), (4, 10)]);
    }

    #[test]
    fn a_dead_force_is_told_at_the_sixth_whole_direction_and_has_no_sign() {
        let mut plausible = Plausible::new();
        let signs = [ONE / 2, ONE, ONE, 0, -ONE, -ONE / 2, ONE, -ONE, ONE];
        assert_eq!(signs.map(|sign| plausible.goes(sign)), [false; 9]);
        assert!(!plausible.push(0, Some(0), false).no_force);
        assert!(plausible.goes(-ONE));
        assert_eq!(plausible.take(9), Some(Warning { index: 9, kind: WarningKind::DeadForce }));
        assert!(plausible.push(0, Some(0), false).no_force);
        assert!(!plausible.goes(ONE));
        plausible.backwards();
        assert_eq!(plausible.take(10), None);
        for (reversals, told) in [(2, None), (1, Some(Warning { index: 11, kind: WarningKind::WrongSign }))] {
            plausible.reversals = reversals;
            plausible.backwards();
            assert_eq!(plausible.take(11), told);
        }
    }

    /// A warning comes again after ten estimates without its cause.
    #[test]
    fn a_warning_is_told_once_while_its_cause_lasts() {
        let mut plausible = Plausible::new();
        let mut told = |estimates: u32, kind: WarningKind| {
            (0..estimates).for_each(|_| plausible.learn(None, None));
            plausible.warn(kind);
            plausible.take(5).map(|warning| warning.kind)
        };
        assert_eq!(told(0, WarningKind::CountSlip), Some(WarningKind::CountSlip));
        assert_eq!(told(0, WarningKind::CountSlip), None);
        assert_eq!(told(9, WarningKind::CountSlip), None);
        assert_eq!(told(0, WarningKind::WrongSign), Some(WarningKind::WrongSign));
        assert_eq!(told(10, WarningKind::CountSlip), Some(WarningKind::CountSlip));
    }
}
