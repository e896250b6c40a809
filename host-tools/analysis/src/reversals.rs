//! Where a screw reverses between the samples, and how it moves around there.
//!
//! A kernel of 5 ms finds the reversals. Each is then located more accurately, as on the device (docs/THEORY.md, 2):
//! around a reversal the measured force minus friction and offset accelerates the inertance. Integrated twice from a
//! trial time, it must leave no velocity in the positions of 15 ms on either side. With counts of 2.4 um this locates a
//! reversal of 2 m/s^2 to within 15 us rms.

use inerter_core::constants::{ROUNDING, SIGN_KERNEL_S};
use inerter_data::series::Stretch;

use crate::law::{Law, around, convolved};

/// Length of the motion on either side that locates a reversal \[s\], and minimum number of samples.
const HALF_WIDTH_S: f64 = 0.015;
const LEAST_HALF_WIDTH: usize = 4;
/// Additional distance to the next reversal \[samples\].
const ROOM: f64 = 3.0;
/// Maximum correction of a reversal \[s\], and minimum number of samples.
const REACH_S: f64 = 0.003;
const LEAST_REACH: f64 = 2.0;
/// Maximum number of iterations.
const ROUNDS: usize = 4;
/// Change of its time at which the iteration ends \[samples\].
const EXACT: f64 = 1e-3;
/// Length of the motion on either side of a reversal that is resolved more finely than samples \[s\], and the length of
/// a part of it.
const NEAR_S: f64 = 0.008;
const PART_S: f64 = 0.125e-3;
/// Minimum and maximum number of parts per sample.
const PARTS: (f64, f64) = (2.0, 8.0);

/// State of the screw at one moment.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Moment {
    /// Time since the start of the stretch \[samples\].
    pub at: f64,
    /// Direction, 1 or -1.
    pub sign: f64,
    /// Velocity \[m/s\].
    pub velocity: f64,
    /// Distance since the last reversal \[m\]; infinite before the first.
    pub gone_m: f64,
    /// Number of reversals in the stretch so far.
    pub stroke: usize,
    /// Measured force \[N\].
    pub force_n: f64,
    /// Position \[m\].
    pub position_m: f64,
}

/// One reversal.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Reversal {
    /// Time since the start of the stretch \[samples\].
    pub at: f64,
    /// Position \[m\].
    pub position_m: f64,
    /// Direction of the motion after it.
    pub sign: f64,
    /// Whether it was located with the law, not by the kernel alone.
    pub is_located: bool,
}

/// The motion of one stretch.
#[derive(Clone, Debug, Default)]
pub(crate) struct Turns {
    /// In order of time.
    pub reversals: Vec<Reversal>,
    /// Mean sign of the velocity over each sample's own period.
    pub signs: Vec<f64>,
    /// The midpoint of each sample.
    pub moments: Vec<Moment>,
    /// Samples near a reversal, divided into parts, each with its fraction of the sample.
    pub near: Vec<(usize, Vec<(f64, Moment)>)>,
}

/// Dry friction at a moment \[N\].
pub(crate) type Friction<'a> = dyn Fn(&Moment) -> f64 + 'a;

impl Turns {
    /// For a stretch with the friction of the law.
    pub fn of(stretch: &Stretch, period_s: f64, law: &Law) -> Self {
        Self::with(stretch, period_s, law, &|moment| law.coulomb_n * moment.sign)
    }

    /// For a stretch with this dry friction.
    pub fn with(stretch: &Stretch, period_s: f64, law: &Law, friction: &Friction) -> Self {
        let velocities = velocities(stretch, period_s, law);
        let crossings = crossings(&velocities);
        let around = Surroundings { stretch, period_s, law, friction };
        let half_width = ((HALF_WIDTH_S / period_s).round() as usize).max(LEAST_HALF_WIDTH);
        let mut turns = Self::default();
        let mut ways = Vec::new();
        for (place, &(at, sign)) in crossings.iter().enumerate() {
            let neighbours = [place.wrapping_sub(1), place + 1].map(|other| crossings.get(other));
            let room = half_width as f64 + ROOM;
            let is_alone = neighbours.into_iter().flatten().all(|(other, _)| (other - at).abs() >= room);
            let located = around.located(at, sign, half_width).filter(|_| is_alone);
            let is_located = located.is_some();
            let (at, position_m, way) = located.unwrap_or_else(|| (at, line(&stretch.position_m, at), Way::default()));
            turns.reversals.push(Reversal { at, position_m, sign, is_located });
            ways.push(way);
        }
        let first_sign = crossings.first().map_or_else(|| overall(stretch), |(_, sign)| -sign);
        turns.walk(stretch, &velocities, first_sign);
        turns.refine(stretch, period_s, &ways);
        turns
    }

    /// Computes signs and moments, sample by sample.
    fn walk(&mut self, stretch: &Stretch, velocities: &[f64], first_sign: f64) {
        let Self { reversals, signs, moments, .. } = self;
        let last_of = |stroke: usize| stroke.checked_sub(1).and_then(|last| reversals.get(last));
        let sign_of = |stroke: usize| last_of(stroke).map_or(first_sign, |reversal| reversal.sign);
        let mut stroke = 0;
        for (n, (&position_m, &force_n)) in stretch.position_m.iter().zip(&stretch.force_n).enumerate() {
            let (start, end) = (n as f64 - 0.5, n as f64 + 0.5);
            let (mut mean, mut from, mut middle) = (0.0, start, stroke);
            while let Some(next) = reversals.get(stroke).filter(|next| next.at < end) {
                mean += (next.at - from).max(0.0) * sign_of(stroke);
                from = from.max(next.at);
                stroke += 1;
                if next.at <= n as f64 {
                    middle = stroke;
                }
            }
            signs.push(mean + (end - from) * sign_of(stroke));
            let halves = [n.checked_sub(1), Some(n)].map(|half| half.and_then(|half| velocities.get(half)));
            let known = halves.into_iter().flatten().filter(|velocity| !velocity.is_nan());
            let (sum, count) = known.fold((0.0, 0.0), |(sum, count), velocity| (sum + velocity, count + 1.0));
            moments.push(Moment {
                at: n as f64,
                sign: sign_of(middle),
                velocity: if count > 0.0 { sum / count } else { 0.0 },
                gone_m: last_of(middle).map_or(f64::INFINITY, |reversal| (position_m - reversal.position_m).abs()),
                stroke: middle,
                force_n,
                position_m,
            });
        }
    }

    /// Replaces the motion near reversals by that of the law.
    fn refine(&mut self, stretch: &Stretch, period_s: f64, ways: &[Way]) {
        let parts = (period_s / PART_S).round().clamp(PARTS.0, PARTS.1) as usize;
        let near = NEAR_S / period_s;
        for (place, (reversal, way)) in
            self.reversals.iter().zip(ways).enumerate().filter(|(_, (one, _))| one.is_located)
        {
            let from = (reversal.at - near).ceil().max(0.0) as usize;
            let to = ((reversal.at + near).floor() as usize).min(stretch.force_n.len().saturating_sub(1));
            for n in from..=to {
                let moment = |at: f64| {
                    let is_after = at >= reversal.at;
                    let (velocity, gone_m) = way.at(at - reversal.at);
                    let before_m = match place.checked_sub(1).and_then(|last| self.reversals.get(last)) {
                        Some(last) => (reversal.position_m - last.position_m).abs() - gone_m,
                        None => f64::INFINITY,
                    };
                    let sign = if is_after { reversal.sign } else { -reversal.sign };
                    Moment {
                        at,
                        sign,
                        velocity,
                        gone_m: if is_after { gone_m } else { before_m.max(0.0) },
                        stroke: place + usize::from(is_after),
                        force_n: line(&stretch.force_n, at),
                        position_m: reversal.position_m + gone_m * reversal.sign,
                    }
                };
                self.moments[n] = moment(n as f64);
                // A part ends at the reversal.
                let (start, end) = (n as f64 - 0.5, n as f64 + 0.5);
                let split = reversal.at.clamp(start, end);
                let within = [(start, split), (split, end)].into_iter().filter(|(from, to)| to > from);
                let within = within.flat_map(|(from, to)| {
                    let weight = (to - from) / parts as f64;
                    (0..parts).map(move |part| (weight, from + (part as f64 + 0.5) * weight))
                });
                self.near.push((n, within.map(|(weight, at)| (weight, moment(at))).collect()));
            }
        }
    }

    /// The mean over each sample's period of a function of the moment.
    pub fn means(&self, value: impl Fn(&Moment) -> f64) -> Vec<f64> {
        let mut means: Vec<f64> = self.moments.iter().map(&value).collect();
        for (n, within) in &self.near {
            means[*n] = within.iter().map(|(weight, moment)| weight * value(moment)).sum();
        }
        means
    }
}

/// Velocity and distance from a reversal, forwards and backwards in time.
#[derive(Clone, Debug, Default)]
struct Way {
    before: Vec<Node>,
    after: Vec<Node>,
}

/// One point of it.
#[derive(Clone, Copy, Debug, Default)]
struct Node {
    /// Time from the reversal \[samples\], unsigned.
    after: f64,
    velocity: f64,
    /// Displacement from the reversal \[m\].
    gone_m: f64,
}

impl Way {
    /// Velocity, and unsigned distance, at a time from the reversal \[samples\].
    fn at(&self, after: f64) -> (f64, f64) {
        let (nodes, after) = if after < 0.0 { (&self.before, -after) } else { (&self.after, after) };
        let place = nodes.partition_point(|node| node.after < after);
        let [Some(first), Some(second)] = [place.saturating_sub(1), place].map(|at| nodes.get(at.min(nodes.len() - 1)))
        else {
            return (0.0, 0.0);
        };
        let length = second.after - first.after;
        let part = if length > 0.0 { (after - first.after) / length } else { 0.0 };
        let between = |a: f64, b: f64| a + (b - a) * part;
        (between(first.velocity, second.velocity), between(first.gone_m, second.gone_m).abs())
    }
}

/// The data that locate a reversal.
struct Surroundings<'a> {
    stretch: &'a Stretch,
    period_s: f64,
    law: &'a Law,
    friction: &'a Friction<'a>,
}

impl Surroundings<'_> {
    /// Time, position and motion of a reversal into this direction, which the kernel detected here; `None` if it cannot
    /// be one of a free screw.
    fn located(&self, seen: f64, sign: f64, half_width: usize) -> Option<(f64, f64, Way)> {
        if self.law.inertance_kg.is_nan() || self.law.inertance_kg <= 0.0 {
            return None;
        }
        let middle = seen.round() as usize;
        let (first, last) = (middle.checked_sub(half_width)?, middle + half_width);
        // The force's interpolation needs one more sample.
        if first < 2 || last + 2 >= self.stretch.force_n.len() {
            return None;
        }
        let reach = (REACH_S / self.period_s).max(LEAST_REACH);
        let mut at = seen;
        for _ in 0..ROUNDS {
            let way = self.way(at, sign, first, last);
            let [before, after] = [-1e-3, 1e-3].map(|side| way.at(side).0);
            // The force on both sides accelerates in the new direction.
            if before * sign >= 0.0 || after * sign <= 0.0 {
                return None;
            }
            let (position_m, velocity) = self.line_through(at, sign, &way, first, last);
            let acceleration = if velocity * sign < 0.0 { -before / 1e-3 } else { after / 1e-3 };
            let moved = (-velocity / acceleration).clamp(-1.0, 1.0);
            at += moved;
            if (at - seen).abs() > reach {
                return None;
            }
            if moved.abs() < EXACT {
                return Some((at, position_m, way));
            }
        }
        let way = self.way(at, sign, first, last);
        let (position_m, _) = self.line_through(at, sign, &way, first, last);
        Some((at, position_m, way))
    }

    /// The motion from a reversal here to the samples at both ends.
    fn way(&self, at: f64, sign: f64, first: usize, last: usize) -> Way {
        Way { before: self.side(at, sign, -1.0, at - first as f64), after: self.side(at, sign, 1.0, last as f64 - at) }
    }

    /// One side of it; `time` is its direction.
    fn side(&self, at: f64, sign: f64, time: f64, length: f64) -> Vec<Node> {
        let law = self.law;
        let step = PART_S / self.period_s;
        let steps = (length / step.min(0.5)).ceil().max(1.0);
        let step = length / steps;
        let acceleration = |node: &Node| {
            let force_n = line(&self.stretch.force_n, at + time * node.after);
            let moment = Moment {
                at: at + time * node.after,
                sign: time * sign,
                velocity: node.velocity,
                gone_m: if time > 0.0 { node.gone_m.abs() } else { f64::INFINITY },
                stroke: 0,
                force_n,
                position_m: line(&self.stretch.position_m, at),
            };
            (force_n - law.offset_n - law.viscous_n_s_per_m * node.velocity - (self.friction)(&moment))
                / law.inertance_kg
        };
        let step_s = time * step * self.period_s;
        let mut node = Node::default();
        let mut nodes = Vec::with_capacity(steps as usize + 1);
        nodes.push(node);
        let mut here = acceleration(&node);
        for _ in 0..steps as usize {
            let after = node.after + step;
            let velocity = node.velocity + here * step_s;
            let guess = Node { after, velocity, gone_m: node.gone_m + 0.5 * (node.velocity + velocity) * step_s };
            let there = acceleration(&guess);
            let velocity = node.velocity + 0.5 * (here + there) * step_s;
            let gone_m = node.gone_m + (node.velocity + (2.0 * here + there) / 6.0 * step_s) * step_s;
            node = Node { after, velocity, gone_m };
            here = acceleration(&node);
            nodes.push(node);
        }
        nodes
    }

    /// Position at the reversal, and velocity \[m/s\] that the positions have in addition to the given motion: a
    /// straight line through the residuals.
    fn line_through(&self, at: f64, sign: f64, way: &Way, first: usize, last: usize) -> (f64, f64) {
        let samples = &self.stretch.position_m[first..=last];
        let [mut count, mut sum_t, mut sum_tt, mut sum_x, mut sum_tx] = [0.0; 5];
        for (n, position) in (first..).zip(samples) {
            let t = n as f64 - at;
            // On both sides of a reversal the displacement has the same sign.
            let left = position - sign * way.at(t).1;
            count += 1.0;
            sum_t += t;
            sum_tt += t * t;
            sum_x += left;
            sum_tx += t * left;
        }
        let spread = count * sum_tt - sum_t * sum_t;
        let velocity = (count * sum_tx - sum_t * sum_x) / spread;
        ((sum_x - velocity * sum_t) / count, velocity / self.period_s)
    }
}

/// Overall direction of a stretch.
fn overall(stretch: &Stretch) -> f64 {
    let [first, last] = [stretch.position_m.first(), stretch.position_m.last()].map(|end| end.copied().unwrap_or(0.0));
    if last < first { -1.0 } else { 1.0 }
}

/// Linear interpolation between samples, and extrapolation beyond the first and the last.
fn line(data: &[f64], at: f64) -> f64 {
    let before = (at.floor().max(0.0) as usize).min(data.len().saturating_sub(2));
    match data.get(before..) {
        Some([first, second, ..]) => first + (second - first) * (at - before as f64),
        Some([only]) => *only,
        _ => 0.0,
    }
}

/// Times \[samples\] at which the velocity crosses zero, and its sign after them.
fn crossings(velocities: &[f64]) -> Vec<(f64, f64)> {
    let mut crossings = Vec::new();
    let mut last: Option<(f64, f64)> = None;
    for (half, &velocity) in velocities.iter().enumerate().filter(|(_, velocity)| velocity.abs() > 0.0) {
        let at = half as f64 + 0.5;
        if let Some((before, from)) = last.filter(|(_, from)| from * velocity < 0.0) {
            crossings.push((before + (at - before) * from.abs() / (from.abs() + velocity.abs()), velocity.signum()));
        }
        last = Some((at, velocity));
    }
    crossings
}

/// Half of the length of the estimator's short kernel, a triangle \[samples\]; its square is the sum of the taps.
pub(crate) fn short_half(period_s: f64) -> usize {
    (SIGN_KERNEL_S / period_s).round().max(1.0) as usize
}

/// Velocities halfway between the samples \[m/s\] from the short kernel, corrected for the effect of Coulomb friction
/// on it; uncorrected without an inertance. NaN if there are too few samples around.
pub(crate) fn velocities(stretch: &Stretch, period_s: f64, law: &Law) -> Vec<f64> {
    let half = short_half(period_s);
    let taps = convolved(&vec![1.0; half], &vec![1.0; half]);
    let sum: f64 = taps.iter().sum();
    // First absolute moment of the taps about the middle.
    let moment: f64 = taps.iter().enumerate().map(|(at, tap)| tap * (at as f64 - (half - 1) as f64).abs()).sum();
    let kink = if law.inertance_kg > 0.0 { moment / sum * period_s * law.coulomb_n / law.inertance_kg } else { 0.0 };
    let steps: Vec<f64> = stretch.position_m.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let velocity = |at: usize| {
        if at + 1 < half || at + half > steps.len() {
            return f64::NAN;
        }
        let force = stretch.force_n.iter().skip(at).take(2).sum::<f64>() - 2.0 * law.offset_n;
        around(&taps, &steps, at) / sum / period_s + kink * force.signum()
    };
    (0..steps.len()).map(velocity).collect()
}

/// Noise that the encoder's steps leave in these velocities \[m/s\].
pub(crate) fn velocity_noise(count_m: f64, period_s: f64) -> f64 {
    count_m * (ROUNDING * 2.0 / (short_half(period_s) as f64).powi(3)).sqrt() / period_s
}

#[cfg(test)]
#[path = "reversals_tests.rs"]
mod tests;
