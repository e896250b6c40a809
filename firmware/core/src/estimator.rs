//! The estimator itself: one call per sample, an estimate at the publish rate.
//!
//! Samples wait in a delay line until the gate knows whether they stood in a window of rest; then they enter the
//! cascades, and a bank's kernel output becomes an update when every sample that it rests on was good. A gated output
//! neither updates nor forgets.

use crate::active::{Active, BankActive, Signal};
use crate::backlash::{Gaps, Newest};
use crate::change::Watch;
use crate::conduct::NearRest;
use crate::detail::Gap;
use crate::estimate::{Bank, Estimate};
use crate::gate::{BLOCKS, Rest};
use crate::kernel::{Cascades, Comb, Term, Update};
use crate::line::DelayLine;
use crate::noise::Noise;
use crate::qformat::shift_right;
use crate::rls::{MORE_PRODUCTS, Moments, Totals, approach, more_products, products};
use crate::sample::RawSample;
use crate::sign::{self, Reversals, Sign};

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
    pub(crate) noise: Noise,
    pub(crate) fast: BankState,
    pub(crate) slow: BankState,
    pub(crate) feedback: Feedback,
    pub(crate) gaps: Gaps,
    /// The latest reversal, and whether it has not been taken. (No `Option`: its `None` is not zero, and a static with one byte
    /// that is not lies in flash as a whole.)
    gap: Gap,
    gap_waits: bool,
    pub(crate) watch: Watch,
    /// Bank of the last estimate.
    pub(crate) published: Bank,
    until_publish: u32,
}

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
    /// Viscous friction [force codes per position code and sample].
    pub viscous: Term,
    /// Friction is known well enough to move a reversal by it.
    pub friction_known: bool,
    /// Whether the reversals seen so far look like Coulomb's friction.
    pub coulomb_like: bool,
}

impl Feedback {
    pub(crate) const NONE: Self = Self {
        kink: Term { coefficient: 0, shift: 0 },
        velocity_per_force: Term { coefficient: 0, shift: 0 },
        offset_code: 0,
        weak_force_code: 0,
        viscous: Term { coefficient: 0, shift: 0 },
        friction_known: false,
        coulomb_like: false,
    };
}

/// One bank's comb and memories.
#[derive(Clone, Debug)]
pub(crate) struct BankState {
    comb: Comb,
    until_update: u32,
    pub recent: Moments,
    pub near_rest: NearRest,
    /// Mean square of the jerk over the recent memory [regressor units^2].
    pub jerk: i64,
    pub whole: Totals,
    pub more: Totals<MORE_PRODUCTS>,
    /// Samples since the last update.
    pub idle_samples: u32,
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
            noise: Noise::new(),
            fast: BankState::new(),
            slow: BankState::new(),
            feedback: Feedback::NONE,
            gaps: Gaps::new(),
            gap: Gap::EMPTY,
            gap_waits: false,
            watch: Watch::new(),
            published: Bank::Fast,
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
        let Self {
            counters,
            line,
            rest,
            sign,
            reversals,
            cascades,
            good_samples,
            noise,
            fast,
            slow,
            feedback,
            gaps,
            gap: _,
            gap_waits,
            watch,
            published,
            until_publish,
        } = self;
        *counters = Counters::default();
        line.reset();
        *rest = Rest::new();
        *sign = Sign::new();
        *reversals = Reversals::new();
        *cascades = Cascades::new();
        *good_samples = 0;
        *noise = Noise::new();
        for bank in [fast, slow] {
            bank.comb.reset();
            bank.forget();
            (bank.until_update, bank.idle_samples) = (0, 0);
        }
        *feedback = Feedback::NONE;
        gaps.reset();
        *gap_waits = false;
        *watch = Watch::new();
        *published = Bank::Fast;
        *until_publish = active.signal.publish_samples;
    }

    /// What has been counted since the reset.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// The reversal of the flanks that the last sample has concluded, once: ask after every step.
    pub fn take_gap(&mut self) -> Option<Gap> {
        core::mem::take(&mut self.gap_waits).then_some(self.gap)
    }

    /// Index of the latest sample.
    pub fn last_index(&self) -> u32 {
        self.line.last_index
    }
}

impl BankState {
    const fn new() -> Self {
        Self {
            comb: Comb::new(),
            until_update: 0,
            recent: Moments::new(),
            near_rest: NearRest::new(),
            jerk: 0,
            whole: Totals::new(),
            more: Totals::new(),
            idle_samples: 0,
        }
    }

    /// Forgets what was learnt, and nothing of the signals.
    pub fn forget(&mut self) {
        self.recent = Moments::new();
        self.near_rest = NearRest::new();
        self.jerk = 0;
        self.whole = Totals::new();
        self.more = Totals::new();
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
        let Some(Update { regressors, more, jerk }) = config.normaliser.update(&output) else {
            return false;
        };
        let products = products(&regressors);
        self.recent.update(&products, config.memory);
        self.near_rest.update(&products, &self.recent, config.memory);
        approach(&mut self.jerk, i64::from(jerk) * i64::from(jerk), self.recent.gain(config.memory));
        self.whole.update(&products);
        self.more.update(&more_products(&regressors, &more));
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
        let newest = state.receive(signal, sample);
        if let Some(gap) = state.gaps.push(&self.backlash, &newest) {
            (state.gap, state.gap_waits) = (gap, true);
        }
        state.gate(signal, sample);
        state.locate_sign(signal);
        state.leave(signal);
        for (bank, config) in [(&mut state.fast, &self.fast), (&mut state.slow, &self.slow)] {
            if !bank.advance(config, &state.cascades, state.good_samples) {
                state.counters.saturated = state.counters.saturated.saturating_add(1);
            }
        }
        // Only an update tells something new.
        if state.fast.idle_samples == 0 || state.slow.idle_samples == 0 {
            state.listen(signal.delay);
            self.watch(state);
        }
        state.until_publish = state.until_publish.saturating_sub(1);
        if state.until_publish > 0 {
            return None;
        }
        state.until_publish = signal.publish_samples;
        let estimate = self.estimate(state);
        state.published = estimate.bank;
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
    fn receive(&mut self, signal: &Signal, sample: &RawSample) -> Newest {
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
        let position =
            if signal.position_reversed { sample.position_count.wrapping_neg() } else { sample.position_count };
        line.push(position, force, saturated);
        Newest {
            index: sample.index,
            position,
            force,
            terminal: sample.terminal_code,
            good: !saturated,
            broken,
            offset: self.feedback.offset_code,
        }
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

    /// Gives the sample half a kernel ago its sign, and the reversal half a long kernel ago its place.
    fn locate_sign(&mut self, signal: &Signal) {
        let m = signal.sign_half_width;
        let feedback = self.feedback;
        let line = &mut self.line;
        let plain = line.smooth_velocity(0, m);
        let before = core::mem::replace(&mut line.plain_velocity, plain);
        // What is compared must not depend on what has been concluded.
        line.ago(m).passes_zero = (plain ^ before) < 0 && before != 0 && plain != 0;
        // The correction is worth its cost only where the velocity could reach zero within the kernel.
        let near = plain.unsigned_abs() <= plain.abs_diff(before).saturating_mul(u32::from(m));
        let lost = if feedback.coulomb_like && near { line.smoothed_away(0, m, &feedback) } else { 0 };
        // Until friction is known, what hardly moves may stick or creep, and its sign is not to be had.
        let slow = |velocity: i32| velocity.unsigned_abs() <= signal.creep_limit;
        let creeps = feedback.weak_force_code == 0 && slow(plain) && slow(line.smooth_velocity(m, m));
        let middle = line.ago(m);
        middle.sign = self.sign.push(plain.saturating_add(lost));
        middle.bad |= creeps;
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
        if feedback.coulomb_like && feedback.friction_known {
            line.relocate(m, signal.reversal_half_width, signal.reversal_reach, &feedback);
        }
    }

    /// Takes the force's noise from the samples that have just left: under an update all are good.
    #[cold]
    fn listen(&mut self, delay: u8) {
        let [a, b, c, d, e] = [0, 1, 2, 3, 4].map(|before: u8| self.line.at(delay.wrapping_add(before)).force);
        self.noise.push([a, b, c, d, e]);
    }

    /// Moves the oldest waiting sample into the cascades.
    fn leave(&mut self, signal: &Signal) {
        let line = &mut self.line;
        let known_rest = line.resting > 0;
        let full = line.filled > u16::from(signal.delay);
        let before = *line.ago(signal.delay.wrapping_add(1));
        let sample = *line.ago(signal.delay);
        let travel = i64::from(sample.position.wrapping_sub(before.position));
        // Signs are averages around the samples, travel is between them. Half of each sign's time lies in between, and
        // outside of a reversal's sample both are one.
        let between = i64::from((before.sign + sample.sign).clamp(-sign::ONE, sign::ONE));
        let travelled = shift_right(travel * between, sign::BITS as i8);
        let cascades = &mut self.cascades;
        cascades.position.push_for_derivatives(cascades.position.input().wrapping_add(travel));
        cascades.path.push_for_derivatives(cascades.path.input().wrapping_add(travelled));
        cascades.force.push(i64::from(sample.force));
        cascades.sign.push(i64::from(sample.sign));
        let good = full && !sample.bad && !known_rest;
        self.good_samples = if good { self.good_samples.saturating_add(1) } else { 0 };
    }
}
