//! The delay line: samples wait here until the gate has judged them and their sign has been located.
//!
//! Glossary: the *plain* velocity is that through two boxes of `m` samples, which smooth away the acceleration's jump
//! at a reversal and with it a part of the velocity; what is *lost* is that part, as computed from the force. Times are
//! in samples before the newest; the velocity belongs to half a sample after the kernel's middle.

use crate::feedback::Feedback;
use crate::sign::{self, ONE};

/// Fraction bits of the velocity from which the sign is found.
pub(crate) const VELOCITY_BITS: u32 = 8;
/// The velocity is clamped to this, far from any reversal.
const VELOCITY_LIMIT: i32 = 1 << 21;
/// Greatest correction of the velocity.
const VELOCITY_CLAMP: i64 = 1 << 27;
/// Least velocity from which a fall to zero is a stop, and not the rounding of a slow motion [counts in half a kernel].
const STOP_COUNTS: u32 = 3;
/// Samples around a reversal whose signs belong to it alone.
const OWN_SAMPLES: u8 = 3;

#[derive(Clone, Copy, Debug)]
pub(crate) struct Waiting {
    pub position: i32,
    /// Running sum of the position: its second difference over the kernel is the sign's velocity.
    pub position_sum: i32,
    pub force: i32,
    pub sign: i32,
    /// Whether the plain velocity passes zero here.
    pub passes_zero: bool,
    pub bad: bool,
}

/// The last 256 samples, indexed by a `u8`, so that no index is ever out of bounds.
#[derive(Clone, Debug)]
pub(crate) struct DelayLine {
    samples: [Waiting; 256],
    head: u8,
    pub filled: u16,
    pub last_index: u32,
    position_sum: i32,
    /// The last plain velocity that was not 0.
    pub plain_velocity: i32,
    /// Number of coming samples whose velocity still spans a discontinuity.
    pub tainted: u8,
    /// Samples since the last discontinuity or saturated force, up to 255.
    pub whole: u8,
    /// Number of waiting samples, counted from the newest, that are known to be at rest.
    pub resting: u16,
}

impl Waiting {
    const NONE: Self = Self { position: 0, position_sum: 0, force: 0, sign: 0, passes_zero: false, bad: false };

    /// Whether the velocity passes zero within this sample.
    pub fn reverses(&self) -> bool {
        self.sign.abs() < ONE
    }

    /// Whether friction can hold the screw against this force.
    pub fn may_be_held(&self, feedback: &Feedback) -> bool {
        self.force.saturating_sub(feedback.offset_code).unsigned_abs() <= feedback.weak_force_code >> 1
    }
}

impl DelayLine {
    pub const fn new() -> Self {
        Self {
            samples: [Waiting::NONE; 256],
            head: 0,
            filled: 0,
            last_index: 0,
            position_sum: 0,
            plain_velocity: 0,
            tainted: 0,
            whole: 0,
            resting: 0,
        }
    }

    /// Forgets everything, entry by entry: a new line would be built on the stack first.
    pub fn reset(&mut self) {
        let Self { samples, head, filled, last_index, position_sum, plain_velocity, tainted, whole, resting } = self;
        samples.fill(Waiting::NONE);
        (*head, *filled, *last_index, *position_sum) = (0, 0, 0, 0);
        (*plain_velocity, *tainted, *whole, *resting) = (0, 0, 0, 0);
    }

    /// Takes the newest sample.
    pub fn push(&mut self, position: i32, force: i32, saturated: bool) {
        self.head = self.head.wrapping_add(1);
        self.filled = self.filled.saturating_add(1);
        self.resting = self.resting.saturating_sub(1);
        self.position_sum = self.position_sum.wrapping_add(position);
        let bad = saturated || self.tainted > 0;
        self.tainted = self.tainted.saturating_sub(1);
        self.whole = if saturated { 0 } else { self.whole.saturating_add(1) };
        *self.ago(0) = Waiting { position, position_sum: self.position_sum, force, sign: 0, passes_zero: false, bad };
    }

    /// Assumes that the screw stood here, because earlier positions do not show how it came: a jump would look like a
    /// velocity.
    #[cold]
    #[inline(never)]
    pub fn break_off(&mut self, position: i32) {
        (self.whole, self.plain_velocity) = (0, 0);
        let mut sum = self.position_sum;
        for ago in 0..=u8::MAX {
            self.ago(ago).position_sum = sum;
            sum = sum.wrapping_sub(position);
        }
    }

    /// Marks the newest samples as bad.
    #[inline(never)]
    pub fn spoil(&mut self, samples: u8) {
        (0..=samples).for_each(|ago| self.ago(ago).bad = true);
    }

    /// Marks as bad what lies within `m` samples of one where the screw comes to a stop that friction can hold. It may
    /// stick there for too short a time to count as rest, and then continue the same way.
    #[cold]
    #[inline(never)]
    pub fn hold(&mut self, m: u8, codes_per_count: u32, feedback: &Feedback) {
        if !self.at(m).may_be_held(feedback) {
            return;
        }
        let [velocity, earlier] = [0, m].map(|ago| self.smooth_velocity(ago, m));
        // If it slows as much again, it stands within the kernel. Velocities may be wrong by one count in `m` samples.
        if velocity.unsigned_abs() <= velocity.abs_diff(earlier)
            && earlier.unsigned_abs() > (STOP_COUNTS * codes_per_count * u32::from(m)) << VELOCITY_BITS
        {
            self.spoil(2 * m);
        }
    }

    pub fn ago(&mut self, samples: u8) -> &mut Waiting {
        &mut self.samples[usize::from(self.head.wrapping_sub(samples))]
    }

    pub fn at(&self, samples: u8) -> &Waiting {
        &self.samples[usize::from(self.head.wrapping_sub(samples))]
    }

    /// Velocity through two boxes of `m` samples, its latest sample `ago`, at half a sample after `ago + m`
    /// [2^-VELOCITY_BITS codes per sample, times m^2].
    pub fn smooth_velocity(&self, ago: u8, m: u8) -> i32 {
        let [newest, middle, oldest] = [0, m, 2 * m].map(|back| self.at(ago + back).position_sum);
        let velocity = newest.wrapping_add(oldest).wrapping_sub(middle.wrapping_mul(2));
        // Only values near zero matter, and there a count is coarse.
        velocity.clamp(-VELOCITY_LIMIT, VELOCITY_LIMIT) << VELOCITY_BITS
    }

    /// What the kernel of [`Self::smooth_velocity`] takes from the velocity if friction is Coulomb friction: the effect
    /// of the force, and the kink at a reversal.
    pub fn smoothed_away(&self, ago: u8, m: u8, feedback: &Feedback) -> i32 {
        let direction = self.direction(ago + m, feedback);
        let lost = self.pairs(ago, m).map(|(weight, later, earlier)| difference(weight, earlier.force, later.force));
        smoothed_away(lost.sum(), m, direction, feedback)
    }

    /// Direction in which the force pushes.
    fn direction(&self, ago: u8, feedback: &Feedback) -> i32 {
        self.at(ago).force.saturating_sub(feedback.offset_code).signum()
    }

    /// The samples after and before the kernel's time, in pairs from the ends inwards, with the weight of their
    /// difference in the velocity: for all positions beyond `i` samples, `(m - i) (m - i + 1) / 2`.
    fn pairs(&self, ago: u8, m: u8) -> impl Iterator<Item = (i32, &Waiting, &Waiting)> {
        let mut weight = 0;
        (1..m).map(move |step| {
            weight += i32::from(step);
            (weight, self.at(ago + step), self.at(ago + 2 * m - 1 - step))
        })
    }

    /// Relocates the reversal of the sample `ago + m`, through boxes of `m` samples and with the signs known on both
    /// sides. Sets the signs of the samples up to `reach` around it accordingly.
    ///
    /// A kernel three times as long has a fifth of the noise. The first, short kernel finds reversals that lie close
    /// together.
    #[inline]
    pub fn relocate(&mut self, ago: u8, m: u8, reach: u8, feedback: &Feedback) {
        let middle = ago + m;
        let [after, here, before] = [middle - 1, middle, middle + 1].map(|ago| self.at(ago).sign);
        let direction = -before.signum();
        if here == before || before.abs() != ONE || after != direction * ONE {
            return;
        }
        self.relocate_in(direction, ago, m, reach, feedback);
    }

    /// The same where there is a reversal into this direction.
    #[cold]
    #[inline(never)]
    fn relocate_in(&mut self, direction: i32, ago: u8, m: u8, reach: u8, feedback: &Feedback) {
        let middle = ago + m;
        if self.direction(middle, feedback) != direction {
            return;
        }
        let zero = match [ago + 1, ago].map(|ago| self.unsmoothed(ago, m, direction, feedback)) {
            [Some(earlier), Some(later)] => sign::zero(earlier, later, direction, reach),
            _ => None,
        };
        // Samples beyond a reversal's own may belong to another.
        let near = if zero.is_some() { reach + 1 } else { OWN_SAMPLES.min(reach + 1) };
        let (first, last) = (middle - near, middle + near);
        let least = feedback.weak_force_code as i32;
        let jumps = |ago: &u8| feedback.jumps_are_clear && self.jump(*ago).wrapping_mul(direction) >= least;
        let jump = (first..=last).find(jumps);
        for ago in first..=last {
            let from_middle = (i32::from(middle) - i32::from(ago)) * ONE;
            let sign = match (jump, zero) {
                (Some(jump), _) if ago <= jump => ONE,
                (Some(_), _) => -ONE,
                (None, Some(zero)) => (2 * (from_middle - zero)).clamp(-ONE, ONE),
                (None, None) => return,
            };
            self.ago(ago).sign = direction * sign;
        }
    }

    /// Twice the amount by which the force's change from the sample before exceeds its mean change on either side. If
    /// that amount is three quarters of friction's own jump, nothing elastic lies between friction and load cell: each
    /// sample then has its full sign, not an average.
    #[inline(never)]
    fn jump(&self, ago: u8) -> i32 {
        let around = [ago - 1, ago, ago + 1, ago + 2].map(|ago| self.at(ago));
        if around.iter().any(|sample| sample.bad) {
            return 0;
        }
        let [next, here, before, earlier] = around.map(|sample| sample.force);
        here.wrapping_sub(before).wrapping_mul(3).wrapping_sub(next.wrapping_sub(earlier))
    }

    /// The velocity half a sample after `ago + m`, with what the kernel took from it restored; `None` if a sample is
    /// bad or another reversal lies under the same kernel.
    fn unsmoothed(&self, ago: u8, m: u8, direction: i32, feedback: &Feedback) -> Option<i32> {
        let (mut lost, mut bend) = (0_i64, 0_i64);
        let both = |later: &Waiting, earlier: &Waiting| later.position.wrapping_add(earlier.position);
        let middle = both(self.at(ago + m - 1), self.at(ago + m));
        let whole = direction * ONE;
        for (step, (weight, later, earlier)) in (1..m).zip(self.pairs(ago, m)) {
            let another = (later.sign, earlier.sign) != (whole, -whole) && step < m.saturating_sub(OWN_SAMPLES);
            if later.bad || earlier.bad || another {
                return None;
            }
            lost += difference(weight, earlier.force, later.force);
            // The velocity's differences with the same weight, summed by parts.
            bend += i64::from(step) * i64::from(middle.wrapping_sub(both(later, earlier)));
        }
        lost -= feedback.viscous.of(bend);
        let plain = self.smooth_velocity(ago, m);
        Some(plain.saturating_add(smoothed_away(lost, m, direction, feedback)))
    }
}

fn difference(weight: i32, one: i32, other: i32) -> i64 {
    i64::from(weight) * (i64::from(one) - i64::from(other))
}

/// The velocity that a kernel of `m` took away: by the weighted sum of the force, and by the kink of one reversal.
fn smoothed_away(lost: i64, m: u8, direction: i32, feedback: &Feedback) -> i32 {
    let kink = feedback.kink(m) * i64::from(direction);
    feedback.velocity_per_force.of(lost).saturating_add(kink).clamp(-VELOCITY_CLAMP, VELOCITY_CLAMP) as i32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::term;

    const MASS_KG: f64 = 300.0;
    const COULOMB_N: f64 = 50.0;
    const RATE_HZ: f64 = 1000.0;
    const COUNT_M: f64 = 2.44e-6;
    const CODE_N: f64 = 0.01;

    fn known() -> Feedback {
        let per_impulse = 256.0 / (RATE_HZ * RATE_HZ * COUNT_M * MASS_KG);
        Feedback {
            kink: term(per_impulse / 3.0 * COULOMB_N),
            velocity_per_force: term(per_impulse * CODE_N),
            weak_force_code: (3.0 * COULOMB_N / CODE_N) as u32,
            jumps_are_clear: true,
            ..Feedback::NONE
        }
    }

    /// Error of the place of the reversal according to the signs [samples], for a screw that reverses at `zero` samples
    /// from the middle of its 40th, under a force that falls by 5 N in a sample.
    fn error(zero: f64, direction: i32, phase: f64, relocates: bool) -> f64 {
        error_in_oil(zero, direction, phase, relocates, 0.0)
    }

    /// The same on the same path, with so much viscous friction \[N s/m\] that the force carries as well.
    fn error_in_oil(zero: f64, direction: i32, phase: f64, relocates: bool, viscous: f64) -> f64 {
        let (mut line, mut sign) = (DelayLine::new(), sign::Sign::new());
        let feedback = Feedback { viscous: term(viscous * RATE_HZ * COUNT_M / CODE_N), ..known() };
        let (force, fall) = (600.0, 5000.0);
        for n in 0..=65 {
            let t = (f64::from(n) - 40.0 - zero) / RATE_HZ;
            let friction = if t > 0.0 { -COULOMB_N } else { COULOMB_N };
            let x = ((force + friction) * t * t / 2.0 - fall * t * t * t / 6.0) / MASS_KG;
            let position = f64::from(direction) * x / COUNT_M + phase;
            let drag = viscous * ((force + friction) * t - fall * t * t / 2.0) / MASS_KG;
            line.push(position.floor() as i32, direction * ((force - fall * t + drag) / CODE_N) as i32, false);
            let velocity = line.smooth_velocity(0, 5) + line.smoothed_away(0, 5, &feedback);
            // Before the line has filled, its velocities are invalid.
            line.ago(5).sign = if n < 12 { -direction * ONE } else { sign.push(velocity) };
            if relocates {
                line.relocate(5, 15, 2, &feedback);
            }
        }
        // The sum of the signs around a reversal gives its place.
        let sum: i32 = (20..=30).map(|ago| line.at(ago).sign).sum();
        -f64::from(direction * sum) / f64::from(2 * ONE) - zero
    }

    #[test]
    fn a_long_kernel_places_a_reversal_better_than_a_short_one() {
        let [short, long] = [false, true].map(|relocates| {
            let errors = (0..400).map(|n| {
                let direction = if n < 200 { 1 } else { -1 };
                error(f64::from(n % 200) / 200.0 - 0.5, direction, f64::from(n) * 0.618, relocates)
            });
            let (mean, square) =
                errors.fold((0.0, 0.0), |(mean, square), error| (mean + error, square + error * error));
            (mean / 400.0, (square / 400.0 - mean * mean / 160_000.0).sqrt())
        });
        // In samples of 1 ms: systematically 2 us at most, and a scatter of a third at most.
        assert!(short.0.abs() < 5e-3 && long.0.abs() < 2e-3, "{short:?} {long:?}");
        assert!(long.1 < 0.015 && long.1 < short.1 / 3.0, "{short:?} {long:?}");
    }

    /// Whether each sample around a reversal at `zero` has its full sign, on an imposed path, where the force follows
    /// the friction within `lag` samples.
    fn has_whole_signs(zero: f64, direction: i32, lag: f64, spoil: impl Fn(i32, &mut DelayLine)) -> bool {
        let (mut line, mut sign, feedback) = (DelayLine::new(), sign::Sign::new(), known());
        for n in 0..=65 {
            let t = f64::from(n) - 40.0 - zero;
            let position = f64::from(direction) * 0.4 * t * t + zero;
            let friction = if lag > 0.0 { (t / lag).clamp(-1.0, 1.0) } else { t.signum() } * COULOMB_N;
            line.push(position.floor() as i32, direction * ((400.0 + t + friction) / CODE_N) as i32, false);
            line.ago(5).sign = if n < 12 { -direction * ONE } else { sign.push(line.smooth_velocity(0, 5)) };
            spoil(n, &mut line);
            line.relocate(5, 15, 2, &feedback);
        }
        // The sample `ago` is the (65 - ago)-th.
        (20..=30).all(|ago| direction * line.at(ago).sign == if 25.0 - f64::from(ago) > zero { ONE } else { -ONE })
    }

    #[test]
    fn a_force_that_jumps_gives_each_sample_all_of_its_sign() {
        let whole = |lag, spoil: fn(i32, &mut DelayLine)| {
            let each = (0..100).flat_map(|n| [(n, 1), (n, -1)]);
            each.filter(|(n, direction)| has_whole_signs((f64::from(*n) + 0.5) / 100.0 - 0.5, *direction, lag, spoil))
                .count()
        };
        let [jumps, follows] = [0.0, 4.0].map(|lag| whole(lag, |_, _| ()));
        assert!(jumps == 200 && follows < 10, "{jumps} and {follows} of 200");
        // A bad sample under the long kernel does not matter away from the jump; at the jump, it may be what jumps.
        let far = whole(0.0, |n, line| line.ago(0).bad = n == 32);
        let there = whole(0.0, |n, line| line.ago(0).bad = (39..=41).contains(&n));
        assert!(far == 200 && there < 10, "{far} and {there} of 200");
    }

    /// With another reversal under the long kernel, a bad sample, or a force against the reversal, the short kernel's
    /// place stays.
    #[test]
    fn what_the_long_kernel_cannot_see_through_stays() {
        let changed = |spoil: fn(&mut Waiting)| {
            let mut line = DelayLine::new();
            for n in 0..40 {
                line.push((n - 20) * (n - 20), 60_000, false);
                line.ago(0).sign = if n < 21 { -ONE } else { ONE };
            }
            line.ago(28).sign = -ONE;
            spoil(line.ago(10));
            spoil(line.ago(28));
            let before = line.ago(19).sign;
            // The reversal is the sample 19 ago.
            (0..=4).for_each(|ago| line.relocate(ago, 15, 2, &known()));
            line.ago(19).sign != before
        };
        assert!(changed(|_| ()));
        assert!(!changed(|sample| sample.bad = true));
        assert!(!changed(|sample| sample.sign = ONE));
    }

    /// Viscous friction of 4 kN s/m makes the force rise by 8 N in a sample. Taken for a force on the mass, that would
    /// place a reversal 0.25 samples off, through the long kernel: its mean square width is 37.5 samples squared.
    #[test]
    fn viscous_friction_in_the_force_does_not_move_a_reversal() {
        for direction in [1, -1] {
            let errors = (0..200).map(|n| {
                let (zero, phase) = (f64::from(n) / 200.0 - 0.5, f64::from(n) * 0.618);
                error_in_oil(zero, direction, phase, true, 4000.0)
            });
            let mean = errors.sum::<f64>() / 200.0;
            // By the positions between samples, an eighth of it stays.
            assert!(mean.abs() < 0.08, "{mean}");
        }
    }

    #[test]
    fn friction_may_hold_what_is_at_most_half_of_a_weak_force() {
        let feedback = Feedback { weak_force_code: 100, offset_code: 7, ..Feedback::NONE };
        for (force, may_be_held) in [(57, true), (58, false), (-43, true), (-44, false)] {
            assert_eq!(Waiting { force, ..Waiting::NONE }.may_be_held(&feedback), may_be_held, "{force}");
        }
        for (sign, reverses) in [(ONE, false), (ONE - 1, true), (0, true), (1 - ONE, true), (-ONE, false)] {
            assert_eq!(Waiting { sign, ..Waiting::NONE }.reverses(), reverses, "{sign}");
        }
    }

    #[test]
    fn samples_are_bad_that_are_saturated_or_under_a_discontinuity() {
        let mut line = DelayLine::new();
        (line.tainted, line.resting) = (2, 1);
        for (saturated, bad, whole) in
            [(false, true, 1), (false, true, 2), (false, false, 3), (true, true, 0), (false, false, 1)]
        {
            line.push(0, 0, saturated);
            assert_eq!((line.at(0).bad, line.whole), (bad, whole));
        }
        assert_eq!((line.filled, line.resting), (5, 0));
        (0..5).for_each(|_| line.push(0, 0, false));
        line.spoil(3);
        assert_eq!([0, 3, 4].map(|ago| line.at(ago).bad), [true, true, false]);
    }

    /// Positions before a discontinuity are taken to be the one after it: nothing seems to move.
    #[test]
    fn a_screw_that_has_jumped_stood_where_it_is() {
        let mut line = DelayLine::new();
        (0..300).for_each(|n| line.push(100 * n, 0, false));
        assert_eq!(line.smooth_velocity(0, 5), (100 * 25) << VELOCITY_BITS);
        line.break_off(-7000);
        assert_eq!(line.whole, 0);
        for _ in 0..12 {
            line.push(-7000, 0, false);
            assert_eq!([(0, 5), (3, 60)].map(|(ago, m)| line.smooth_velocity(ago, m)), [0, 0]);
        }
        // From there on the velocity is what it is: one of the five newest samples has moved by 2.
        line.push(-6998, 0, false);
        assert_eq!(line.smooth_velocity(0, 5), 2 << VELOCITY_BITS);
    }

    /// Three blocks of five samples: the velocities are five times the steps between them.
    fn in_steps(first: i32, second: i32) -> DelayLine {
        let mut line = DelayLine::new();
        (0..40).for_each(|_| line.push(0, 0, false));
        (0..5).for_each(|_| line.push(first, 0, false));
        (0..5).for_each(|_| line.push(first + second, 0, false));
        line
    }

    #[test]
    fn a_velocity_is_clamped_far_from_a_reversal() {
        for (step, velocity) in
            [(419_000, 2_095_000), (420_000, 1 << 21), (-419_000, -2_095_000), (-420_000, -(1 << 21))]
        {
            assert_eq!(in_steps(0, step).smooth_velocity(0, 5), velocity * 256);
        }
    }

    /// With four codes a count, three counts in five samples are a velocity of 60.
    #[test]
    fn a_stop_that_friction_can_hold_spoils_both_its_kernels() {
        let feedback = Feedback { weak_force_code: 200, ..Feedback::NONE };
        for (first, second, stops) in [
            // Faster than 60 before it stands.
            (13, 0, true),
            (12, 0, false),
            (-13, 0, true),
            // It has lost half of its velocity, or more.
            (20, 10, true),
            (20, 11, false),
            (20, -30, true),
        ] {
            let mut line = in_steps(first, second);
            line.hold(5, 4, &feedback);
            let bad = [0, 10, 11].map(|ago| line.at(ago).bad);
            assert_eq!(bad, [stops, stops, false], "{first} {second}");
        }
        // A force of more than half of a weak one moves the screw on.
        for (force, stops) in [(100, true), (101, false)] {
            let mut line = in_steps(13, 0);
            line.ago(5).force = force;
            line.hold(5, 4, &feedback);
            assert_eq!(line.at(0).bad, stops, "{force}");
        }
    }
}
