//! The estimator itself: one call per sample, an estimate at the publish rate.
//!
//! Samples wait in a delay line until the gate knows whether they stood in a window of rest; then they enter the
//! cascades, and a bank's kernel output becomes an update when every sample that it rests on was good. A gated output
//! neither updates nor forgets.

use crate::active::{Active, BankActive, Signal};
use crate::estimate::{Bank, Estimate};
use crate::gate::{BLOCKS, Rest};
use crate::kernel::{Cascades, Comb, Term};
use crate::rls::{Moments, Totals, products};
use crate::sample::RawSample;
use crate::sign::{Reversals, Sign};

/// What has been counted since the reset.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Samples taken.
    pub samples: u64,
    /// Jumps of the sample counter.
    pub gaps: u32,
    /// Samples that the jumps skipped.
    pub lost_samples: u64,
    /// Samples with a saturated force, and kernel outputs beyond full scale.
    pub saturated: u32,
}

/// All that changes from sample to sample.
#[derive(Clone, Debug)]
pub struct State {
    pub(crate) counters: Counters,
    line: DelayLine,
    rest: Rest,
    sign: Sign,
    pub(crate) reversals: Reversals,
    cascades: Cascades,
    /// Consecutive good samples that have entered the cascades.
    good_samples: u32,
    pub(crate) fast: BankState,
    pub(crate) slow: BankState,
    pub(crate) feedback: Feedback,
    until_publish: u32,
}

/// Fraction bits of the velocity that the sign sees.
pub(crate) const VELOCITY_BITS: u32 = 8;
/// Velocity beyond which it is cut off, far from any reversal.
const VELOCITY_LIMIT: i32 = 1 << 21;
/// Greatest correction of it.
const VELOCITY_CLAMP: i64 = 1 << 27;

/// What the estimate gives back to the signal path. Integers, set once per publication.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Feedback {
    /// Kink of the sign's velocity at a reversal [2^-VELOCITY_BITS per cube of the kernel's half width].
    pub kink: Term,
    /// The sign's velocity per sum of the force [2^-VELOCITY_BITS per code].
    pub velocity_per_force: Term,
    /// Offset of the force [codes].
    pub offset_code: i32,
    /// Force [codes] under which a reversal is weak.
    pub weak_force_code: u32,
    /// Whether the reversals seen so far look like Coulomb's friction.
    pub coulomb_like: bool,
}

impl Feedback {
    const NONE: Self = Self {
        kink: Term { coefficient: 0, shift: 0 },
        velocity_per_force: Term { coefficient: 0, shift: 0 },
        offset_code: 0,
        weak_force_code: 0,
        coulomb_like: false,
    };
}

/// One bank's comb and memories.
#[derive(Clone, Debug)]
pub(crate) struct BankState {
    comb: Comb,
    until_update: u32,
    pub recent: Moments,
    pub whole: Totals,
    /// Samples since the last update.
    pub idle_samples: u32,
}

#[derive(Clone, Copy, Debug)]
struct Waiting {
    position: i32,
    /// Running sum of the position: its second difference over the kernel is the sign's velocity.
    position_sum: i32,
    force: i32,
    /// Running sum, three times over, of the force.
    force_sum: i64,
    sign: i32,
    /// The velocity passes zero here, by its kernel alone.
    passes_zero: bool,
    bad: bool,
}

/// The last 256 samples; a `u8` indexes it, so that no index is ever out of bounds.
#[derive(Clone, Debug)]
struct DelayLine {
    samples: [Waiting; 256],
    head: u8,
    filled: u16,
    last_index: u32,
    position_sum: i32,
    force_sums: [i64; 3],
    /// The last velocity by the sign's kernel alone.
    plain_velocity: i32,
    /// How many samples from now on still have a velocity across a gap.
    tainted: u8,
    /// How many waiting samples, counted from the newest, are known to stand in rest.
    resting: u16,
}

impl DelayLine {
    const fn new() -> Self {
        Self {
            samples: [Waiting::NONE; 256],
            head: 0,
            filled: 0,
            last_index: 0,
            position_sum: 0,
            force_sums: [0; 3],
            plain_velocity: 0,
            tainted: 0,
            resting: 0,
        }
    }

    /// Forgets everything, entry by entry: a new line would be built on the stack first.
    fn reset(&mut self) {
        let Self { samples, head, filled, last_index, position_sum, force_sums, plain_velocity, tainted, resting } =
            self;
        samples.fill(Waiting::NONE);
        (*head, *filled, *last_index, *position_sum) = (0, 0, 0, 0);
        (*force_sums, *plain_velocity, *tainted, *resting) = ([0; 3], 0, 0, 0);
    }

    fn ago(&mut self, samples: u8) -> &mut Waiting {
        &mut self.samples[usize::from(self.head.wrapping_sub(samples))]
    }

    /// Velocity through two boxes of `m` samples, its latest sample `ago`, at half a sample after `ago + m`
    /// [2^-VELOCITY_BITS counts per sample, times m^2].
    fn smooth_velocity(&mut self, ago: u8, m: u8) -> i32 {
        let [newest, middle, oldest] = [0, m, 2 * m].map(|back| self.ago(ago + back).position_sum);
        let velocity = newest.wrapping_add(oldest).wrapping_sub(middle.wrapping_mul(2));
        // Only the surroundings of zero matter, and there a count is coarse.
        velocity.clamp(-VELOCITY_LIMIT, VELOCITY_LIMIT) << VELOCITY_BITS
    }

    /// What the kernel of [`Self::smooth_velocity`] takes from the velocity if friction is Coulomb's: what the force
    /// makes of it (its running sum less the smoothed sum), and the kink at a reversal.
    fn smoothed_away(&mut self, ago: u8, m: u8, feedback: &Feedback) -> i32 {
        let second_difference = |sums: [i64; 3]| sums[0].wrapping_add(sums[2]).wrapping_sub(sums[1].wrapping_mul(2));
        let sum = second_difference([m, m + 1, m + 2].map(|back| self.ago(ago + back).force_sum));
        let smoothed = second_difference([1, m + 1, 2 * m + 1].map(|back| self.ago(ago + back).force_sum));
        let lost = sum.wrapping_mul(i64::from(m) * i64::from(m)).wrapping_sub(smoothed);
        let made = feedback.velocity_per_force.of(lost);
        let direction = self.ago(ago + m).force.saturating_sub(feedback.offset_code).signum();
        let kink = feedback.kink.of(i64::from(m) * i64::from(m) * i64::from(m)) * i64::from(direction);
        (made.saturating_add(kink)).clamp(-VELOCITY_CLAMP, VELOCITY_CLAMP) as i32
    }
}

impl Waiting {
    const NONE: Self =
        Self { position: 0, position_sum: 0, force: 0, force_sum: 0, sign: 0, passes_zero: false, bad: false };

    /// Whether the velocity goes through zero within this sample.
    fn reverses(&self) -> bool {
        self.sign.abs() < crate::sign::ONE
    }
}

impl Default for State {
    fn default() -> Self {
        Self::empty()
    }
}

impl State {
    /// A state that has seen nothing and belongs to no settings yet: [`reset`](Self::reset) it before the first step.
    ///
    /// Constant, so that it can lie in a `static` without costing stack.
    pub const fn empty() -> Self {
        Self {
            counters: Counters { samples: 0, gaps: 0, lost_samples: 0, saturated: 0 },
            line: DelayLine::new(),
            rest: Rest::new(),
            sign: Sign::new(),
            reversals: Reversals::new(),
            cascades: Cascades::new(),
            good_samples: 0,
            fast: BankState::new(),
            slow: BankState::new(),
            feedback: Feedback::NONE,
            until_publish: 0,
        }
    }

    /// A state that has seen nothing.
    pub fn new(active: &Active) -> Self {
        let mut state = Self::empty();
        state.until_publish = active.signal.publish_samples;
        state
    }

    /// Forgets everything, in place.
    pub fn reset(&mut self, active: &Active) {
        let Self { counters, line, rest, sign, reversals, cascades, good_samples, fast, slow, feedback, until_publish } =
            self;
        *counters = Counters::default();
        line.reset();
        *rest = Rest::new();
        *sign = Sign::new();
        *reversals = Reversals::new();
        *cascades = Cascades::new();
        *good_samples = 0;
        for BankState { comb, until_update, recent, whole, idle_samples } in [fast, slow] {
            comb.reset();
            *recent = Moments::new();
            *whole = Totals::new();
            (*until_update, *idle_samples) = (0, 0);
        }
        *feedback = Feedback::NONE;
        *until_publish = active.signal.publish_samples;
    }

    /// What has been counted since the reset.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// Index of the latest sample.
    pub fn last_index(&self) -> u32 {
        self.line.last_index
    }
}

impl BankState {
    const fn new() -> Self {
        Self { comb: Comb::new(), until_update: 0, recent: Moments::new(), whole: Totals::new(), idle_samples: 0 }
    }

    fn advance(&mut self, config: &BankActive, cascades: &Cascades, good_samples: u32) -> bool {
        self.idle_samples = self.idle_samples.saturating_add(1);
        if self.until_update > 1 {
            self.until_update -= 1;
            return true;
        }
        self.until_update = config.spacing;
        let output = self.comb.push(cascades);
        if good_samples < config.support {
            return true;
        }
        let Some(regressors) = config.normaliser.regressors(&output) else {
            return false;
        };
        let products = products(&regressors);
        self.recent.update(&products, config.memory);
        self.whole.update(&products);
        self.idle_samples = 0;
        true
    }
}

impl Active {
    /// Takes one sample; gives an estimate at the publish rate.
    ///
    /// Integers up to the estimate itself, which is the same to the bit on every machine. Never panics.
    pub fn step(&self, state: &mut State, sample: &RawSample) -> Option<Estimate> {
        let signal = &self.signal;
        state.receive(signal, sample);
        state.gate(signal, sample);
        state.locate_sign(signal);
        state.leave(signal);
        for (bank, config) in [(&mut state.fast, &self.fast), (&mut state.slow, &self.slow)] {
            if !bank.advance(config, &state.cascades, state.good_samples) {
                state.counters.saturated = state.counters.saturated.saturating_add(1);
            }
        }
        state.until_publish = state.until_publish.saturating_sub(1);
        if state.until_publish > 0 {
            return None;
        }
        state.until_publish = signal.publish_samples;
        let estimate = self.estimate(state);
        state.feedback = self.feedback(&estimate, state.feedback);
        state.feedback.coulomb_like = state.reversals.coulomb_like();
        Some(estimate)
    }

    /// The configuration and state of a bank.
    pub(crate) fn bank<'a>(&'a self, state: &'a State, bank: Bank) -> (&'a BankActive, &'a BankState) {
        match bank {
            Bank::Fast => (&self.fast, &state.fast),
            Bank::Slow => (&self.slow, &state.slow),
        }
    }
}

impl State {
    /// Enters the sample into the delay line, noticing gaps and saturation.
    fn receive(&mut self, signal: &Signal, sample: &RawSample) {
        let line = &mut self.line;
        let skipped = sample.index.wrapping_sub(line.last_index).wrapping_sub(1);
        let first = self.counters.samples == 0;
        self.counters.samples += 1;
        line.last_index = sample.index;
        let broken = first || skipped != 0;
        if broken && !first {
            self.counters.gaps = self.counters.gaps.saturating_add(1);
            // A counter that went back is a restart: nothing says how much was lost.
            if skipped < 1 << 31 {
                self.counters.lost_samples += u64::from(skipped);
            }
        }
        let saturated = sample.force_code <= signal.force_min_code || sample.force_code >= signal.force_max_code;
        if saturated {
            self.counters.saturated = self.counters.saturated.saturating_add(1);
        }
        if broken {
            // Signs up to half a kernel before the gap would be located with positions from behind it.
            for ago in 0..=signal.sign_half_width {
                line.ago(ago).bad = true;
            }
            line.tainted = signal.sign_half_width + 1;
            self.rest.reset();
        }
        let force = sample.force_code.saturating_sub(signal.force_zero_code);
        let force = if signal.force_reversed { force.saturating_neg() } else { force };
        let [first, second, third] = &mut line.force_sums;
        *first = first.wrapping_add(i64::from(force));
        *second = second.wrapping_add(*first);
        *third = third.wrapping_add(*second);
        let force_sum = *third;
        line.head = line.head.wrapping_add(1);
        line.filled = line.filled.saturating_add(1);
        line.resting = line.resting.saturating_sub(1);
        let position =
            if signal.position_reversed { sample.position_count.wrapping_neg() } else { sample.position_count };
        line.position_sum = line.position_sum.wrapping_add(position);
        *line.ago(0) = Waiting {
            position,
            position_sum: line.position_sum,
            force,
            force_sum,
            sign: 0,
            passes_zero: false,
            bad: saturated || line.tainted > 0,
        };
        line.tainted = line.tainted.saturating_sub(1);
    }

    /// Marks windows of rest and grazing reversals.
    fn gate(&mut self, signal: &Signal, sample: &RawSample) {
        let line = &mut self.line;
        let window = signal.rest_block as u8 * BLOCKS as u8;
        if self.rest.push(sample.position_count, signal.rest_block, signal.rest_limit) {
            // The window and a block on either side of it.
            line.resting = u16::from(signal.delay) + signal.rest_block;
        }
        let travel = line.ago(0).position.wrapping_sub(line.ago(window).position);
        if travel.unsigned_abs() <= signal.grazing_limit {
            let middle = line.ago(window / 2);
            let force = middle.force.saturating_sub(self.feedback.offset_code);
            if force.unsigned_abs() < self.feedback.weak_force_code {
                middle.bad = true;
            }
        }
    }

    /// Gives the sample half a kernel ago its sign.
    fn locate_sign(&mut self, signal: &Signal) {
        let m = signal.sign_half_width;
        let feedback = self.feedback;
        let line = &mut self.line;
        let mut velocity = line.smooth_velocity(0, m);
        let before = line.plain_velocity;
        line.plain_velocity = velocity;
        // What is compared must not depend on what has been concluded.
        line.ago(m).passes_zero = (velocity ^ before) < 0 && before != 0 && velocity != 0;
        // The correction is worth its cost only where the velocity could reach zero within the kernel.
        let change = velocity.abs_diff(before);
        if feedback.coulomb_like && velocity.unsigned_abs() >> 2 <= change.saturating_mul(u32::from(m)) {
            velocity = velocity.saturating_add(line.smoothed_away(0, m, &feedback));
        }
        let middle = line.ago(m);
        middle.sign = self.sign.push(velocity);
        // A reversal that friction can hold is one that may have stuck for a moment.
        if feedback.coulomb_like && middle.reverses() {
            let force = middle.force.saturating_sub(feedback.offset_code).unsigned_abs();
            middle.bad |= force <= feedback.weak_force_code >> 1;
        }
        if line.ago(2 * m).passes_zero {
            let narrow = line.smooth_velocity(m, m);
            let wide = line.smooth_velocity(0, 2 * m) >> 2;
            let predicted = line.smoothed_away(m, m, &feedback) - (line.smoothed_away(0, 2 * m, &feedback) >> 2);
            self.reversals.compare(predicted, wide - narrow);
        }
    }

    /// Moves the oldest waiting sample into the cascades.
    fn leave(&mut self, signal: &Signal) {
        let line = &mut self.line;
        let known_rest = line.resting > 0;
        let full = line.filled > u16::from(signal.delay);
        let before = line.ago(signal.delay.wrapping_add(1)).position;
        let sample = *line.ago(signal.delay);
        let travel = i64::from(sample.position.wrapping_sub(before));
        let position = self.cascades.position.input().wrapping_add(travel);
        self.cascades.position.push(position);
        self.cascades.force.push(i64::from(sample.force));
        self.cascades.sign.push(i64::from(sample.sign));
        let good = full && !sample.bad && !known_rest;
        self.good_samples = if good { self.good_samples.saturating_add(1) } else { 0 };
    }
}
