//! The backlash of one reversal: the step that remains when a polynomial is removed.
//!
//! Discrete orthogonal polynomials over the firm entries by the three-term recurrence, normalised in Q30. Each is
//! removed from reach and side in turn. Degree 7 follows a sine over two thirds of its period so well that the step is
//! wrong by 1e-4 of the amplitude at most. Degree 9 is the check: where it explains more than noise, the window is too
//! long and there is no value. Choosing the degree by the data would bias the value, because it picks the noise that
//! hides what is missing.
//! Source: G. E. Forsythe, "Generation and use of orthogonal polynomials for data-fitting", 1957.

use crate::qformat::{mul_shift, shift_right};

/// Most entries in a window.
pub(crate) const POINTS: usize = 64;
/// Degree of the value, and of its check.
const DEGREE: u32 = 7;
const CHECK: u32 = 9;
/// Fewest entries: four more than there are unknowns; and fewest on either flank.
const FEWEST: u32 = CHECK + 6;
const FEWEST_ON_A_FLANK: u32 = 4;
/// The check's two degrees may explain this many times the noise of one.
const TOLERANCE: u64 = 8;
/// Bits of the reach, so that products with Q30 add up in 64.
const REACH_BITS: i32 = 25;
/// Fraction bits of the side, for the same reason.
const SIDE_BITS: u32 = 24;
/// Smallest divisor: the square of the side [2^-48]. Below it there is no value.
const LEAST_SIDE: i64 = 1 << 34;
/// Largest variance of the residual [units^2 as scaled], so that its quotient by [`LEAST_SIDE`] fits 64 bits. If the
/// greatest reach has 13 bits or more, this is a noise of 1/32 to 1/16 of it. Above it there is no value.
const MOST_VARIANCE: u64 = 1 << 40;
/// Fraction bits of the polynomials.
const Q: u32 = 30;

/// Entries of a window, oldest first.
#[derive(Clone, Debug)]
pub(crate) struct Points {
    /// Place in the window of each firm entry.
    places: [u8; POINTS],
    reach: [i32; POINTS],
    stretch: [i16; POINTS],
    side: [i8; POINTS],
    /// Firm entries, and all.
    firm: u32,
    all: u32,
    /// Samples in an entry, as a power of two.
    pub scale: u8,
}

/// The result of a reversal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Fit {
    /// The backlash [units].
    pub value: i32,
    /// By how much the check would change it [units].
    pub change: i32,
    /// Its part that comes from the stretch [units, shifted as in the memory]: its derivative with respect to the
    /// logarithm of the compliance.
    pub by_stretch: i32,
    /// Variance of the value by the noise of its own flanks [units^2].
    pub variance: u32,
    /// Information: the square of what remains of the side [2^-10], times the samples in an entry.
    pub weight: u32,
}

impl Points {
    /// No entries.
    pub fn new() -> Self {
        Self {
            places: [0; POINTS],
            reach: [0; POINTS],
            stretch: [0; POINTS],
            side: [0; POINTS],
            firm: 0,
            all: 0,
            scale: 0,
        }
    }

    /// Adds an entry.
    pub fn push(&mut self, reach: i32, stretch: i16, side: i8) {
        let place = self.all as u8;
        self.all += 1;
        if side != 0 {
            let slot = (self.firm % POINTS as u32) as usize;
            self.places[slot] = place;
            self.reach[slot] = reach;
            self.stretch[slot] = stretch;
            self.side[slot] = side;
            self.firm += 1;
        }
    }

    fn count(&self) -> usize {
        (self.firm as usize).min(POINTS)
    }
}

/// `sum(a b)`.
fn dot(a: &[i32; POINTS], b: &[i32; POINTS], count: usize) -> i64 {
    a.iter().zip(b).take(count).map(|(a, b)| times(*a, *b)).sum()
}

/// A sum of products with Q30, rounded half up to a whole number.
#[inline(always)]
fn whole(value: i64) -> i32 {
    ((value + (1 << (Q - 1))) >> Q) as i32
}

/// Both factors have 32 bits: one instruction.
#[inline(always)]
fn times(a: i32, b: i32) -> i64 {
    i64::from(a) * i64::from(b)
}

/// Removes `direction` [Q30] from `values`.
fn free(values: &mut [i32; POINTS], direction: &[i32; POINTS], count: usize) {
    let part = whole(dot(values, direction, count));
    for (value, direction) in values.iter_mut().zip(direction).take(count) {
        *value = value.wrapping_sub(whole(times(part, *direction)));
    }
}

/// The square root, rounded down.
fn root(value: u64) -> u64 {
    let (mut rest, mut root) = (value, 0_u64);
    let mut bit = 1_u64 << 62;
    while bit > 0 {
        let step = root + bit;
        root >>= 1;
        if rest >= step {
            rest -= step;
            root += bit;
        }
        bit >>= 2;
    }
    root
}

/// What remains of the fit once all polynomials so far are removed.
#[derive(Clone, Copy, Debug, Default)]
struct Left {
    /// Square of the side [2^-48].
    side: i64,
    /// The step from the negative to the positive side, halved [units as scaled].
    half: i64,
    /// Sum of the squares of the residual [units^2 as scaled].
    residual: u64,
}

/// The inverse of a square of the side, from its upper 31 bits.
#[derive(Clone, Copy)]
struct Inverse {
    mantissa: i64,
    shift: u32,
}

impl Inverse {
    /// `side` is at least [`LEAST_SIDE`].
    fn of(side: i64) -> Self {
        let shift = 33 - side.leading_zeros();
        Self { mantissa: ((1_u64 << 62) / (side >> shift).max(1) as u64) as i64, shift }
    }

    /// `value * 2^bits / side`.
    fn times(self, value: i64, bits: u32) -> i64 {
        mul_shift(value, self.mantissa, 62 + self.shift - bits)
    }
}

impl Left {
    fn of(reach: &[i32; POINTS], side: &[i32; POINTS], count: usize) -> Self {
        let across = dot(reach, side, count);
        let side = dot(side, side, count);
        if side < LEAST_SIDE {
            return Self { side, ..Self::default() };
        }
        let half = Inverse::of(side).times(across, SIDE_BITS);
        let explained = mul_shift(across, half, SIDE_BITS);
        let all = dot(reach, reach, count);
        Self { side, half, residual: all.saturating_sub(explained).max(0) as u64 }
    }
}

/// The backlash of a window; `None` if the window cannot show it. The encoder's step and the stretch's noise are in
/// units.
pub(crate) fn fit(points: &Points, count_units: u32, noise_units: u32) -> Option<Fit> {
    let count = points.count();
    let firm = count as u32;
    let on = |side: i8| points.side.iter().take(count).filter(|s| **s == side).count() as u32;
    if firm < FEWEST || on(1) < FEWEST_ON_A_FLANK || on(-1) < FEWEST_ON_A_FLANK {
        return None;
    }
    let [origin, ..] = points.reach;
    let mut reach = points.reach.map(|reach| reach.wrapping_sub(origin));
    let greatest = reach.iter().take(count).fold(1, |all, reach| all | reach.unsigned_abs());
    // Left shift that gives the greatest value its bits; a reach of no more than a few units does not need more.
    let up = (REACH_BITS - (32 - greatest.leading_zeros() as i32)).clamp(-7, 12) as i8;
    for value in &mut reach {
        *value = shift_right(i64::from(*value), -up) as i32;
    }
    let mut side = points.side.map(|side| i32::from(side) << SIDE_BITS);
    let width = points.all.max(1);
    let per_place = ((1 << Q) / width) as i32;
    let time = points.places.map(|place| (2 * i32::from(place) + 1 - width as i32) * per_place);

    let mut before = [0_i32; POINTS];
    let even = root((1_u64 << (2 * Q)) / u64::from(firm.max(1))) as i32;
    let mut polynomial = [even; POINTS];
    let mut norm = 0_i32;
    let (mut value, mut check, mut free_side) = (Left::default(), Left::default(), side);
    for degree in 0..=CHECK {
        free(&mut reach, &polynomial, count);
        free(&mut side, &polynomial, count);
        if degree == DEGREE {
            value = Left::of(&reach, &side, count);
            free_side = side;
        } else if degree == CHECK {
            check = Left::of(&reach, &side, count);
            break;
        }
        // The next one: (t - a) q - b q', normalised.
        let mut next = [0_i32; POINTS];
        for ((next, time), q) in next.iter_mut().zip(&time).zip(&polynomial).take(count) {
            *next = whole(times(*time, *q));
        }
        let mean = whole(dot(&next, &polynomial, count));
        for ((next, q), before) in next.iter_mut().zip(&polynomial).zip(&before).take(count) {
            *next = next.wrapping_sub(whole(times(mean, *q) + times(norm, *before)));
        }
        norm = root(dot(&next, &next, count).max(0) as u64) as i32;
        if norm < 1 << 16 {
            return None;
        }
        let inverse = ((1_u64 << (2 * Q)) / norm as u64) as i64;
        for next in next.iter_mut().take(count) {
            *next = whole(i64::from(*next) * inverse);
        }
        before = polynomial;
        polynomial = next;
    }

    // Noise of an entry: at least a third of the variance of the encoder's steps, which averages over its samples, and
    // at most that of a single sample and more. Beyond that, the check itself does not fit.
    let freedom = u64::from(firm - CHECK - 2);
    let square = |value: u32| u64::from(value) * u64::from(value);
    let scaled = |squared: u64| shift_right(squared.min(1 << 38) as i64, -2 * up) as u64;
    let least = scaled(((square(count_units) / 40) >> points.scale) + 1).saturating_mul(freedom);
    let most = scaled(square(count_units).saturating_add(4 * square(noise_units))).saturating_mul(freedom);
    let noise = check.residual.max(least);
    let gained = value.residual.saturating_sub(check.residual);
    let explained = gained.saturating_mul(freedom) < TOLERANCE.saturating_mul(noise) && check.residual <= most;
    if check.side < LEAST_SIDE || !explained {
        return None;
    }
    let stretch = points.stretch.map(i32::from);
    let stretch_across = dot(&stretch, &free_side, count);
    let inverse = Inverse::of(value.side);
    // Variance of the value: four times the residual's over the square of the side.
    let variance = value.residual / u64::from((firm - DEGREE - 2).max(1));
    if variance > MOST_VARIANCE {
        return None;
    }
    let variance = inverse.times((variance as i64) << 2, 2 * SIDE_BITS);
    Some(Fit {
        value: shift_right(-2 * value.half, up) as i32,
        change: shift_right(2 * (check.half - value.half), up) as i32,
        by_stretch: (-2 * inverse.times(stretch_across, SIDE_BITS)) as i32,
        variance: shift_right(variance, 2 * up).clamp(0, i64::from(u32::MAX)) as u32,
        weight: (value.side >> (2 * SIDE_BITS - 10) << points.scale).clamp(1, 1 << 24) as u32,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use inerter_needs::Random;
    use proptest::prelude::*;
    use std::{format, vec::Vec};

    proptest! {
        /// A polynomial of degree 7 with a step in it gives the step, whatever the flight between. Its coefficients
        /// decay as those of a motion over two thirds of its period do.
        #[test]
        fn a_step_on_a_polynomial_is_found(
            parts in prop::array::uniform8(-1.0_f64..1.0),
            size in 1e3_f64..1e7,
            jump in -30_000_i32..30_000,
            flight in 0_u32..12,
            first in 14_u32..26,
            second in 14_u32..26,
        ) {
            let mut points = Points::new();
            let all = first + flight + second;
            for place in 0..all {
                let t = 2.0 * f64::from(place) / f64::from(all) - 1.0;
                let smooth = parts.iter().rev().fold(0.0, |sum, part| sum * t * 0.4 + part) * size;
                let side = if place < first { -1 } else if place < first + flight { 0 } else { 1 };
                points.push((smooth - f64::from(i32::from(side) * jump) / 2.0) as i32, 0, side);
            }
            let found = fit(&points, 256, 0).unwrap();
            // The reach has 25 bits.
            let slack = 8.0 + 2.0_f64.powi(-20) * size * 8.0;
            prop_assert!((f64::from(found.value - jump)).abs() <= slack, "{found:?} for {jump}, {slack}");
        }

        #[test]
        fn nothing_panics(entries: Vec<(i32, i16, i8)>, count: u16) {
            let mut points = Points::new();
            for (reach, stretch, side) in entries {
                points.push(reach, stretch, side.signum());
            }
            fit(&points, u32::from(count), u32::from(count));
        }

        #[test]
        fn root_is_the_whole_part(value: u64) {
            let root = u128::from(root(value));
            let value = u128::from(value);
            prop_assert!(root * root <= value && value < (root + 1) * (root + 1));
        }
    }

    /// Two thirds of a sine's period with a flight in the middle, which friction shifts by up to 0.4 of a radian from
    /// the middle of the stroke: the step is wrong by at most 1e-4 of the amplitude.
    #[test]
    fn two_thirds_of_a_sine_leave_little() {
        for phase in -4..5 {
            let mut points = Points::new();
            for place in 0..60_i32 {
                let angle = (f64::from(place) / 60.0 - 0.5) / 1.5 * core::f64::consts::TAU + f64::from(phase) * 0.1;
                let side = match place {
                    ..25 => -1,
                    25..35 => 0,
                    _ => 1,
                };
                points.push((angle.sin() * 1e6) as i32, 0, side);
            }
            let found = fit(&points, 256, 0).unwrap();
            assert!(found.value.abs() <= 100, "{phase}: {found:?}");
        }
    }

    /// A window in which the motion reverses too often is refused.
    #[test]
    fn what_no_polynomial_follows_is_refused() {
        let mut points = Points::new();
        for place in 0..60_i32 {
            let motion = (f64::from(place) * 0.6).sin() * 1e5;
            points.push(motion as i32, 0, if place < 30 { -1 } else { 1 });
        }
        assert_eq!(fit(&points, 256, 0), None);
    }

    /// The value's own variance is that of its scatter under white noise.
    #[test]
    fn variance_is_the_scatter() {
        let mut random = Random(3);
        let mut noise = || (0..4).map(|_| random.below(256_i32) - 128).sum();
        let (mut squares, mut variances, mut count) = (0.0, 0.0, 0.0);
        for _ in 0..400 {
            let mut points = Points::new();
            for place in 0..50 {
                let side = if place < 22 {
                    -1
                } else if place < 28 {
                    0
                } else {
                    1
                };
                points.push(noise(), 0, side);
            }
            let Some(fit) = fit(&points, 256, 0) else { continue };
            squares += f64::from(fit.value) * f64::from(fit.value);
            variances += f64::from(fit.variance);
            count += 1.0;
        }
        assert!(count > 380.0, "{count}");
        assert!((0.8..1.25).contains(&(squares / variances)), "{}", squares / variances);
    }

    /// What the polynomials up to this degree leave of the values, by Gram and Schmidt in f64.
    fn left_of(values: &[f64], times: &[f64], degree: i32) -> Vec<f64> {
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let free = |values: &mut Vec<f64>, basis: &[Vec<f64>]| {
            // Twice is enough.
            for direction in basis.iter().chain(basis) {
                let part = dot(values, direction);
                values.iter_mut().zip(direction).for_each(|(value, direction)| *value -= part * direction);
            }
        };
        let mut basis: Vec<Vec<f64>> = Vec::new();
        for power in 0..=degree {
            let mut next: Vec<f64> = times.iter().map(|time| time.powi(power)).collect();
            free(&mut next, &basis);
            let norm = dot(&next, &next).sqrt();
            next.iter_mut().for_each(|value| *value /= norm);
            basis.push(next);
        }
        let mut left = values.to_vec();
        free(&mut left, &basis);
        left
    }

    /// Of a reach of 17 bits the residual may have 4096 units. This one has `noise^2` times the 50 entries over their
    /// 41 degrees of freedom: 3709 units is the limit.
    #[test]
    fn a_residual_too_large_for_its_variance_is_refused() {
        let variance = |noise: i32| {
            let mut points = Points::new();
            for place in 0..50 {
                let side = if place < 25 { -1 } else { 1 };
                points.push(2000 * place + if place % 2 == 0 { noise } else { -noise }, 0, side);
            }
            Some(fit(&points, 20_000, 0)?.variance)
        };
        let [less, more] = [1800, 3600].map(|noise| f64::from(variance(noise).unwrap()));
        assert!((more / less - 4.0).abs() < 0.01, "{less}, {more}");
        assert_eq!(variance(3800), None);
    }

    /// Every figure of a window is that of the least squares in f64, and a window is refused where the check's two
    /// degrees explain more than 8 variances, or the residual is more than a count and twice the stretch's noise.
    #[test]
    fn a_window_is_fitted_as_in_f64_and_refused_by_its_residual() {
        let mut numbers = Random(11);
        let mut random = || 2.0 * numbers.share() - 1.0;
        let (mut accepted, mut bent, mut rough) = (0, 0, 0);
        for _ in 0..600 {
            let count_units = 2_f64.powf(8.0 + 2.0 * random()) as u32;
            let noise_units = (f64::from(count_units) * (0.4 + 0.4 * random())) as u32;
            let scale = (3.0 + 3.0 * random()) as u8;
            let unit = f64::from(count_units);
            let (size, noise) = (unit * 10_f64.powf(3.0 + random()), unit * 10_f64.powf(0.9 * random() - 0.4));
            let bend = unit * 10_f64.powf(random() - 0.8);
            let [first, flight, second] = [14.0, 6.0, 14.0].map(|mean| (mean * (1.4 + 0.4 * random())) as u32);
            let (all, parts) = (first + flight + second, [(); 8].map(|()| random()));
            let mut points = Points::new();
            let (mut times, mut reach, mut stretch, mut sides) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
            for place in 0..all {
                let time = (f64::from(2 * place + 1) - f64::from(all)) / f64::from(all);
                let side = if place < first {
                    -1
                } else if place < first + flight {
                    0
                } else {
                    1
                };
                let smooth = parts.iter().rev().fold(0.0, |sum, part| sum * time * 0.4 + part) * size;
                let value = (smooth - 700.0 * f64::from(side) + noise * random() + 40.0 * bend * time.powi(8)) as i32;
                let by = (3000.0 * random()) as i16;
                points.push(value, by, side);
                if side != 0 {
                    times.push(time);
                    reach.push(f64::from(value));
                    stretch.push(f64::from(by));
                    sides.push(f64::from(side));
                }
            }
            points.scale = scale;
            let sum = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
            let of = |degree: i32| {
                let (reach, side) = (left_of(&reach, &times, degree), left_of(&sides, &times, degree));
                let (square, across) = (sum(&side, &side), sum(&reach, &side));
                (-2.0 * across / square, sum(&reach, &reach) - across * across / square, side, square)
            };
            let ((value, residual, side, square), (check, check_residual, ..)) = (of(7), of(9));
            let freedom = times.len() as f64 - 11.0;
            let least = (unit * unit / 40.0 / f64::from(1_u32 << scale) + 1.0) * freedom;
            let most = (unit * unit + 4.0 * f64::from(noise_units).powi(2)) * freedom;
            let explained = (residual - check_residual) * freedom / (8.0 * check_residual.max(least));
            let roughness = check_residual / most;
            if [explained, roughness].iter().any(|ratio| (ratio - 1.0).abs() < 0.05) {
                continue;
            }
            let found = fit(&points, count_units, noise_units);
            let what = format!("{found:?}: {explained} {roughness} of {count_units}, {scale}");
            assert_eq!(found.is_some(), explained < 1.0 && roughness < 1.0, "{what}");
            rough += u32::from(explained < 1.0 && roughness > 1.0);
            bent += u32::from(explained > 1.0 && roughness < 1.0);
            let Some(found) = found else { continue };
            accepted += 1;
            let variance = 4.0 * residual / (times.len() as f64 - 9.0) / square;
            let near = |found: f64, wanted: f64, slack: f64| {
                assert!((found - wanted).abs() <= slack, "{what}: {found} for {wanted}");
            };
            // A reach has 25 bits.
            let slack = 2.0 + 0.01 * variance.sqrt() + size * 2_f64.powi(-20);
            near(f64::from(found.value), value, slack);
            near(f64::from(found.change).abs(), (check - value).abs(), 2.0 * slack);
            near(f64::from(found.variance), variance, 2.0 + 0.02 * variance);
            near(f64::from(found.by_stretch), -2.0 * sum(&stretch, &side) / square, 2.0);
            let weight = (square * 1024.0 * f64::from(1_u32 << scale)).max(1.0);
            near(f64::from(found.weight), weight, f64::from(1_u32 << scale) + 0.01 * weight);
        }
        assert!(accepted > 100 && bent > 30 && rough > 30, "{accepted} {bent} {rough}");
    }

    #[test]
    fn products_are_rounded_half_up() {
        for (halves, wanted) in [(0, 0), (1, 1), (2, 1), (3, 2), (-1, 0), (-2, -1), (-3, -1), (-5, -2)] {
            assert_eq!(whole(halves << 29), wanted, "{halves}");
            let below = if halves % 2 == 0 { wanted } else { wanted - 1 };
            assert_eq!(whole((halves << 29) - 1), below, "{halves}");
        }
    }

    /// Fifteen entries are needed, and four of them on either flank.
    #[test]
    fn fewer_entries_than_needed_tell_nothing() {
        let of = |first: u32, second: u32| {
            let mut points = Points::new();
            for place in 0..first + second {
                points.push(0, 0, if place < first { -1 } else { 1 });
            }
            fit(&points, 256, 0)
        };
        for (first, second, tells) in
            [(7, 8, true), (8, 7, true), (7, 7, false), (4, 26, true), (26, 4, true), (3, 27, false), (27, 3, false)]
        {
            assert_eq!(of(first, second).map(|fit| fit.value), tells.then_some(0), "{first} {second}");
        }
    }

    /// The reach gets its bits from the greatest, whatever the others are: here all on one flank are alike.
    #[test]
    fn a_pure_step_is_found_at_any_size() {
        for bits in [0, 5, 13, 19] {
            for sign in [1, -1] {
                let jump = sign << bits;
                let mut points = Points::new();
                for place in 0..40 {
                    points.push(if place < 20 { 0 } else { -jump }, 0, if place < 20 { -1 } else { 1 });
                }
                let found = fit(&points, 256, 0).unwrap();
                assert!(found.value.abs_diff(jump) <= 2 + (1 << bits >> 18), "{bits}: {found:?}");
            }
        }
    }

    /// In ten places a polynomial of degree 9 follows any side, so that nothing is left to tell a step by.
    #[test]
    fn a_side_that_a_polynomial_follows_tells_nothing() {
        let mut points = Points::new();
        for n in 0..60 {
            points.push(0, 0, if n % 2 == 0 { -1 } else { 1 });
        }
        points.places = core::array::from_fn(|n| 30 + n as u8 % 10 * 3);
        assert_eq!(fit(&points, 256, 0), None);
    }

    /// Entries in few places tell no polynomial of degree 9, and no step beside it.
    #[test]
    fn few_places_tell_nothing() {
        for places in [1, 2, 5, 8, 9_u8] {
            let mut points = Points::new();
            for n in 0..61 {
                points.push(n * n, 0, if n % 2 == 0 { -1 } else { 1 });
            }
            // A single one in the middle, where time is nothing.
            points.places = core::array::from_fn(|n| 30 + n as u8 % places * 3);
            assert_eq!(fit(&points, 256, 0), None, "{places}");
        }
    }
}
