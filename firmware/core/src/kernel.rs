//! Matched kernels: force, its derivatives, velocity, acceleration and sign through one smoothing and one delay.
//!
//! Glossary: a *cascade* is a chain of running sums of one channel, wrapping and exact; a *tap* is the cascade's state
//! read in the combination that a correction filter needs; a *comb* is the fourth difference of taps one box apart.
//! Cascade and comb together are a box of `M` samples applied four times (a CIC filter of order 4, the cubic B-spline),
//! with as many sums omitted as the order of the derivative:
//!
//! | output | cascade sum | correction taps | gain |
//! |---|---|---|---|
//! | force, 0th derivative | 4th | `[1 10 1]` | `12 M^4` |
//! | sign | 4th | `[1 22 1]` | `24 M^4` |
//! | 1st derivative (velocity, speed, force rate) | 3rd | `[-1 13 13 -1]` | `24 M^4 T` |
//! | 2nd derivative (acceleration) | 2nd | none | `M^4 T^2` |
//! | 3rd derivative | 1st | `[1 1]` | `2 M^4 T^3` |
//! | 4th derivative | input | none | `M^4 T^4` |
//!
//! All have the same delay of `2 (M - 1) + 2` samples, and the same gain over frequency up to `(w T)^4`: without the
//! correction taps the inertance would be biased by `(w T)^2 / 12`. A running sum's earlier value is
//! `S_k[n-1] = S_k[n] - S_(k-1)[n]`, so the taps need no history of their own.
//! Source: E. B. Hogenauer, "An economical class of digital filters for decimation and interpolation", 1981;
//! the corrections are Numerov's.

use crate::constants::UPDATES_PER_BOX;
use crate::qformat::{Regressor, Term, shift_right, to_regressor};

/// Outputs that a kernel of four boxes spans.
const UPDATES_PER_KERNEL: usize = 4 * UPDATES_PER_BOX as usize;

/// Running sums of one channel, `[input, 1st, 2nd, 3rd, 4th]`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cascade([i64; 5]);

impl Cascade {
    /// Takes one input.
    #[inline]
    pub fn push(&mut self, input: i64) {
        self.push_for_derivatives(input);
        let [_, _, _, third, fourth] = &mut self.0;
        *fourth = fourth.wrapping_add(*third);
    }

    /// Takes one input where the 0th derivative, which alone needs the 4th sum, is not used.
    #[inline]
    pub fn push_for_derivatives(&mut self, input: i64) {
        let [value, first, second, third, _] = &mut self.0;
        *value = input;
        *first = first.wrapping_add(*value);
        *second = second.wrapping_add(*first);
        *third = third.wrapping_add(*second);
    }

    /// The latest input.
    pub fn input(&self) -> i64 {
        self.0[0]
    }

    /// `12 S_4[n-2] + S_2[n-1]`, the 0th derivative with `[1 10 1]`.
    #[inline]
    fn smoothed(&self) -> i64 {
        let [_, first, second, third, fourth] = self.0;
        weighted(&[(12, fourth), (-24, third), (13, second), (-1, first)])
    }

    /// `24 S_4[n-2] + S_2[n-1]`, the 0th derivative of an average over a sample with `[1 22 1]`.
    #[inline]
    fn smoothed_average(&self) -> i64 {
        let [_, first, second, third, fourth] = self.0;
        weighted(&[(24, fourth), (-48, third), (25, second), (-1, first)])
    }

    #[inline]
    fn first_derivative(&self) -> i64 {
        let [input, first, second, third, _] = self.0;
        weighted(&[(24, third), (-36, second), (10, first), (1, input)])
    }

    #[inline]
    fn second_derivative(&self) -> i64 {
        let [_, first, second, ..] = self.0;
        second.wrapping_sub(first)
    }

    #[inline]
    fn third_derivative(&self) -> i64 {
        let [input, first, ..] = self.0;
        first.wrapping_mul(2).wrapping_sub(input)
    }
}

#[inline]
fn weighted(terms: &[(i64, i64)]) -> i64 {
    terms.iter().fold(0, |sum, &(weight, value)| sum.wrapping_add(weight.wrapping_mul(value)))
}

/// The channels of the estimator.
#[derive(Clone, Copy, Debug)]
pub struct Cascades {
    /// Position [counts / oversampling].
    pub position: Cascade,
    /// Force [codes].
    pub force: Cascade,
    /// Sub-sample sign [2^-15].
    pub sign: Cascade,
    /// Path: travel regardless of direction [counts / oversampling].
    pub path: Cascade,
}

/// One reading of all cascades, and also one output of their combs.
#[derive(Clone, Copy, Debug)]
pub struct Taps {
    /// Force and its first to fourth derivative.
    pub force: [i64; 5],
    /// Velocity.
    pub velocity: i64,
    /// Acceleration.
    pub acceleration: i64,
    /// Third derivative of the position.
    pub jerk: i64,
    /// Fourth derivative of the position.
    pub snap: i64,
    /// Sign.
    pub sign: i64,
    /// Speed: the path's first derivative.
    pub speed: i64,
}

impl Cascades {
    /// Before the first sample.
    pub const fn new() -> Self {
        let zero = Cascade([0; 5]);
        Self { position: zero, force: zero, sign: zero, path: zero }
    }

    fn taps(&self) -> Taps {
        let force = &self.force;
        Taps {
            force: [
                force.smoothed(),
                force.first_derivative(),
                force.second_derivative(),
                force.third_derivative(),
                force.input(),
            ],
            velocity: self.position.first_derivative(),
            acceleration: self.position.second_derivative(),
            jerk: self.position.third_derivative(),
            snap: self.position.input(),
            sign: self.sign.smoothed_average(),
            speed: self.path.first_derivative(),
        }
    }
}

impl Taps {
    const ZERO: Self = Self { force: [0; 5], velocity: 0, acceleration: 0, jerk: 0, snap: 0, sign: 0, speed: 0 };

    /// Fourth difference of the taps of this update and of those one to four boxes ago.
    #[inline]
    fn fourth_difference(now: &Self, one: &Self, two: &Self, three: &Self, four: &Self) -> Self {
        let of = |read: fn(&Self) -> i64| {
            let ends = read(now).wrapping_add(read(four));
            let inner = read(one).wrapping_add(read(three)).wrapping_shl(2);
            let middle = read(two).wrapping_shl(2).wrapping_add(read(two).wrapping_shl(1));
            ends.wrapping_add(middle).wrapping_sub(inner)
        };
        Self {
            force: [
                of(|taps| taps.force[0]),
                of(|taps| taps.force[1]),
                of(|taps| taps.force[2]),
                of(|taps| taps.force[3]),
                of(|taps| taps.force[4]),
            ],
            velocity: of(|taps| taps.velocity),
            acceleration: of(|taps| taps.acceleration),
            jerk: of(|taps| taps.jerk),
            snap: of(|taps| taps.snap),
            sign: of(|taps| taps.sign),
            speed: of(|taps| taps.speed),
        }
    }
}

/// One kernel length of taps of one bank.
#[derive(Clone, Debug)]
pub struct Comb {
    history: [Taps; UPDATES_PER_KERNEL],
    next: u8,
}

impl Comb {
    /// Before the first taps.
    pub const fn new() -> Self {
        Self { history: [Taps::ZERO; UPDATES_PER_KERNEL], next: 0 }
    }

    /// Forgets all taps, in place.
    pub fn reset(&mut self) {
        self.history.fill(Taps::ZERO);
        self.next = 0;
    }

    /// Takes the taps of this update; returns the kernel outputs that end here.
    pub fn push(&mut self, cascades: &Cascades) -> Taps {
        let now = cascades.taps();
        let place = |updates_ago: u8| usize::from(self.next.wrapping_sub(updates_ago)) % UPDATES_PER_KERNEL;
        let ago = |boxes: u8| &self.history[place(boxes * UPDATES_PER_BOX as u8)];
        let output = Taps::fourth_difference(&now, ago(1), ago(2), ago(3), ago(4));
        self.history[place(0)] = now;
        self.next = self.next.wrapping_add(1);
        output
    }
}

/// How the kernel outputs of one bank become regressors: powers of two, and the corrections of the force.
#[derive(Clone, Copy, Debug, Default)]
pub struct Normaliser {
    /// Right shift of the acceleration.
    pub acceleration_shift: i8,
    /// Right shift of velocity and speed.
    pub velocity_shift: i8,
    /// Right shift of the sign.
    pub sign_shift: i8,
    /// Right shift of the force.
    pub force_shift: i8,
    /// Right shift of the force's rate.
    pub force_rate_shift: i8,
    /// Right shift of the force's second derivative.
    pub curvature_shift: i8,
    /// Right shift of the third derivative.
    pub jerk_shift: i8,
    /// Skew and structure mass: multiples of the force's first to fourth derivative, in regressor units.
    pub force_terms: [Term; 4],
    /// The same for the force's rate, to second order: multiples of the force's second and third derivative.
    pub force_rate_terms: [Term; 2],
    /// Structure mass: multiple of the position's fourth derivative, in regressor units.
    pub snap_term: Term,
}

/// The constant regressor.
pub const ONE: Regressor = 1 << 30;

/// Number of regressors, the force among them.
pub const REGRESSORS: usize = 5;
/// Number of regressors that only the sums of the whole run hold.
pub const MORE_REGRESSORS: usize = 2;

/// One update.
#[derive(Clone, Copy, Debug)]
pub struct Update {
    /// `[a, v, s, 1, F]`.
    pub regressors: [Regressor; REGRESSORS],
    /// `[|v|, dF/dt]`.
    pub more: [Regressor; MORE_REGRESSORS],
    /// Third derivative of the position, clamped to full scale.
    pub jerk: Regressor,
    /// Second derivative of the force, likewise.
    pub curvature: Regressor,
}

impl Normaliser {
    /// The regressors; `None` if one is beyond its full scale.
    pub fn update(&self, output: &Taps) -> Option<Update> {
        let [force, derivatives @ ..] = output.force;
        let [rate, higher @ ..] = derivatives;
        let force = corrected(force, self.force_shift, &self.force_terms, &derivatives);
        let force = force.wrapping_add(self.snap_term.of(output.snap));
        let rate = corrected(rate, self.force_rate_shift, &self.force_rate_terms, &higher);
        Some(Update {
            regressors: [
                to_regressor(output.acceleration, self.acceleration_shift)?,
                to_regressor(output.velocity, self.velocity_shift)?,
                to_regressor(output.sign, self.sign_shift)?,
                ONE,
                to_regressor(force, 0)?,
            ],
            more: [to_regressor(output.speed, self.velocity_shift)?, to_regressor(rate, 0)?],
            jerk: held(output.jerk, self.jerk_shift),
            curvature: held(output.force[2], self.curvature_shift),
        })
    }
}

/// The regressor of a kernel output, clamped to full scale.
fn held(value: i64, shift: i8) -> Regressor {
    shift_right(value, shift).clamp(-i64::from(Regressor::MAX), i64::from(Regressor::MAX)) as Regressor
}

/// A derivative of the force, corrected by the higher ones.
fn corrected(value: i64, shift: i8, terms: &[Term], higher: &[i64]) -> i64 {
    let value = shift_right(value, shift);
    terms.iter().zip(higher).fold(value, |sum, (term, &higher)| sum.wrapping_add(term.of(higher)))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::constants::{FORCE_TAPS, RATE_TAPS, SIGN_TAPS};
    use inerter_needs::Random;
    use std::vec::Vec;

    /// Box of `length` samples four times, as plain numbers.
    fn box4(length: usize) -> Vec<f64> {
        let mut kernel = std::vec![1.0];
        for _ in 0..4 {
            kernel = convolve(&kernel, &std::vec![1.0; length]);
        }
        kernel
    }

    pub(crate) fn convolve(a: &[f64], b: &[f64]) -> Vec<f64> {
        let mut result = std::vec![0.0; a.len() + b.len() - 1];
        for (i, x) in a.iter().enumerate() {
            for (j, y) in b.iter().enumerate() {
                result[i + j] += x * y;
            }
        }
        result
    }

    /// `kernel` against the last inputs, the newest first, `delay` samples ago.
    fn apply(kernel: &[f64], inputs: &[i64], delay: usize) -> f64 {
        kernel.iter().zip(inputs.iter().rev().skip(delay)).map(|(k, &x)| k * x as f64).sum()
    }

    fn noise(count: usize, bits: u32) -> Vec<i64> {
        let mut random = Random(7);
        (0..count).map(|_| (random.draw() as i64) >> (64 - bits)).collect()
    }

    /// Every output is the direct convolution, to the bit, also after the cascades have wrapped many times.
    #[test]
    fn outputs_are_the_direct_convolution() {
        for spacing in [1, 3, 12] {
            let length = spacing * UPDATES_PER_BOX as usize;
            let position = noise(40 * length, 20);
            let force = noise(40 * length, 16);
            let sign = noise(40 * length, 15);
            let mut cascades = Cascades::new();
            // Start far up, so that the sums wrap.
            cascades.force.0 = [0, i64::MAX / 3, i64::MAX / 5, i64::MAX - 7, i64::MIN / 3];
            cascades.position.0 = [0, i64::MAX / 3, i64::MAX / 7, i64::MIN + 9, 5];
            let mut comb = Comb::new();
            let smooth = box4(length);
            let derived = |taps: &[f64]| convolve(&smooth, taps);
            for n in 0..position.len() {
                cascades.position.push_for_derivatives(position[n]);
                cascades.force.push(force[n]);
                cascades.sign.push(sign[n]);
                cascades.path.push_for_derivatives(force[n]);
                if n % spacing != 0 {
                    continue;
                }
                let output = comb.push(&cascades);
                if n < 6 * length {
                    continue;
                }
                let [x, f, s] = [&position[..=n], &force[..=n], &sign[..=n]];
                let first = convolve(&RATE_TAPS, &[1.0, -1.0]);
                let second = [1.0, -2.0, 1.0];
                let third = convolve(&[1.0, 1.0], &[1.0, -3.0, 3.0, -1.0]);
                let fourth = [1.0, -4.0, 6.0, -4.0, 1.0];
                assert_eq!(output.force[0] as f64, apply(&derived(&FORCE_TAPS), f, 1));
                assert_eq!(output.force[1] as f64, apply(&derived(&first), f, 0));
                assert_eq!(output.force[2] as f64, apply(&derived(&second), f, 1));
                assert_eq!(output.force[3] as f64, apply(&derived(&third), f, 0));
                assert_eq!(output.force[4] as f64, apply(&derived(&fourth), f, 0));
                assert_eq!(output.velocity as f64, apply(&derived(&first), x, 0));
                assert_eq!(output.acceleration as f64, apply(&derived(&second), x, 1));
                assert_eq!(output.jerk as f64, apply(&derived(&third), x, 0));
                assert_eq!(output.speed as f64, apply(&derived(&first), f, 0));
                assert_eq!(output.snap as f64, apply(&derived(&fourth), x, 0));
                assert_eq!(output.sign as f64, apply(&derived(&SIGN_TAPS), s, 1));
            }
        }
    }

    /// Force, velocity and acceleration of a sine keep their proportions to `(w T)^4 / 50`.
    #[test]
    fn gains_are_matched_over_frequency() {
        let length = 12_usize;
        let gain = (length as f64).powi(4);
        for omega in [0.01_f64, 0.1, 0.2] {
            let response = |kernel: &[f64], delay: f64| {
                kernel.iter().enumerate().fold((0.0, 0.0), |(re, im), (i, k)| {
                    let phase = omega * (i as f64 + delay);
                    (re + k * phase.cos(), im - k * phase.sin())
                })
            };
            let magnitude = |(re, im): (f64, f64)| (re * re + im * im).sqrt();
            let smooth = box4(length);
            let force = magnitude(response(&convolve(&smooth, &[1.0, 10.0, 1.0]), 1.0)) / (12.0 * gain);
            let velocity_taps = convolve(&RATE_TAPS, &[1.0, -1.0]);
            let velocity = magnitude(response(&convolve(&smooth, &velocity_taps), 0.0)) / (24.0 * gain) / omega;
            let acceleration = magnitude(response(&convolve(&smooth, &[1.0, -2.0, 1.0]), 1.0)) / gain / omega.powi(2);
            let bound = 0.02 * omega.powi(4);
            assert!((acceleration / force - 1.0).abs() < bound, "{omega}: {}", acceleration / force - 1.0);
            assert!((velocity / force - 1.0).abs() < bound, "{omega}: {}", velocity / force - 1.0);
        }
    }

    #[test]
    fn a_comb_that_was_reset_is_a_new_one() {
        let mut cascades = Cascades::new();
        let (mut used, mut fresh) = (Comb::new(), Comb::new());
        for n in 1..30 {
            cascades.force.push(n);
            used.push(&cascades);
        }
        used.reset();
        for n in 1..30 {
            cascades.force.push(n * n);
            assert_eq!(used.push(&cascades).force, fresh.push(&cascades).force, "{n}");
        }
    }

    /// Full scale in either direction is `2^31 - 1`.
    #[test]
    fn what_is_held_ends_at_full_scale() {
        const FULL: Regressor = Regressor::MAX;
        for (value, shift, wanted) in [
            (40, 3, 5),
            (-20, 2, -5),
            (6, 2, 2),
            (3, -2, 12),
            (i64::from(FULL), 0, FULL),
            (1 << 40, 8, FULL),
            (-(1 << 40), 8, -FULL),
            (i64::from(i32::MIN), 0, -FULL),
            (i64::MIN, 1, -FULL),
        ] {
            assert_eq!(held(value, shift), wanted, "{value} {shift}");
        }
    }
}
