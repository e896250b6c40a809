//! The estimator itself: one call per sample, an estimate at the publish rate.
//!
//! Samples wait in a delay line until the gate knows whether they lie in a window of rest. Then they enter the
//! cascades. A kernel output becomes an update of its bank if every sample under the kernel was good. A gated output
//! neither updates nor forgets.

use crate::active::{Active, Signal};
use crate::backlash::flanks::Newest;
use crate::detail::Change;
use crate::estimate::Bank;
use crate::gate::{BLOCKS, Block};
use crate::output::{Output, Published};
use crate::plausible::Doubt;
use crate::qformat::shift_right;
use crate::sample::RawSample;
use crate::sign;
use crate::state::State;

impl Active {
    /// Takes one sample; returns what is due with it.
    ///
    /// Integer arithmetic up to what is published, and results equal to the bit on every machine. Never panics.
    pub fn step(&self, state: &mut State, sample: &RawSample) -> Output {
        let signal = &self.signal;
        let newest = state.receive(signal, sample);
        let reversal = state.backlash.push(&self.backlash, &newest);
        state.gate(signal, newest.position);
        state.locate_sign(signal);
        state.enter_cascades(signal);
        for (bank, config) in [(&mut state.fast, &self.fast), (&mut state.slow, &self.slow)] {
            if !bank.advance(config, &state.cascades, state.good_samples) {
                state.counters.saturated = state.counters.saturated.saturating_add(1);
            }
        }
        // Only an update brings something new.
        let change = if state.fast.idle_samples == 0 || state.slow.idle_samples == 0 {
            state.sample_noise(signal.delay);
            self.watch(state)
        } else {
            None
        };
        state.until_publish = state.until_publish.saturating_sub(1);
        if state.until_publish > 0 {
            return Output { published: None, reversal, warning: state.plausible.take(sample.index), change };
        }
        state.until_publish = signal.publish_samples;
        let (published, feedback) = self.publish_and_feed_back(state);
        state.published = published.estimate.bank;
        state.feedback = feedback;
        state.feedback.coulomb_like = state.velocity_reversals.coulomb_like();
        if published.estimate.recent.are_backwards() {
            state.plausible.backwards();
        }
        state.plausible.learn(self.bend(&published.estimate.recent), self.noise_beside_clipped(&state.noise));
        state.judge(signal, &published);
        Output { published: Some(published), reversal, warning: state.plausible.take(sample.index), change }
    }

    /// Watches for a change of the device; after one, both memories restart.
    fn watch(&self, state: &mut State) -> Option<Change> {
        if state.watch.begins_anew() {
            state.fast.forget();
            state.slow.forget();
        }
        let (index, bank) = (state.last_index(), state.published);
        let memories = match bank {
            Bank::Fast => &state.fast,
            Bank::Slow => &state.slow,
        };
        state.watch.push(self, bank, memories, index)
    }
}

impl State {
    /// Enters the sample into the delay line; detects discontinuities and saturation.
    fn receive(&mut self, signal: &Signal, sample: &RawSample) -> Newest {
        let line = &mut self.line;
        let skipped = sample.index.wrapping_sub(line.last_index).wrapping_sub(1);
        let first = self.counters.samples == 0;
        self.counters.samples += 1;
        line.last_index = sample.index;
        let broken = first || skipped != 0;
        if broken && !first {
            self.counters.discontinuities = self.counters.discontinuities.saturating_add(1);
            // A counter that went back is a restart: how much was lost is unknown.
            if skipped < 1 << 31 {
                self.counters.lost_samples += u64::from(skipped);
            }
        }
        let saturated = sample.force_code <= signal.force_min_code || sample.force_code >= signal.force_max_code;
        if saturated {
            self.counters.saturated = self.counters.saturated.saturating_add(1);
        }
        let force = sample.force_code.saturating_sub(signal.force_zero_code);
        let within = Some(force).filter(|_| !saturated);
        let Doubt { slipped, no_force, since_a_while } = self.plausible.push(sample.position_count, within, broken);
        if since_a_while {
            self.begin_anew(signal.delay);
        }
        let force = if signal.force_reversed { force.saturating_neg() } else { force };
        let position =
            if signal.position_reversed { sample.position_count.wrapping_neg() } else { sample.position_count };
        let mut newest = Newest {
            index: sample.index,
            position,
            force,
            terminal: sample.terminal_code,
            good: !(saturated || no_force),
            broken: broken || slipped,
            offset: self.feedback.offset_code,
        };
        if signal.force_late != 0 {
            newest = self.alignment.align(signal.force_late, newest);
        }
        let line = &mut self.line;
        if newest.broken {
            // Signs up to half a kernel before the discontinuity would be located with positions from after it.
            line.spoil(signal.sign_half_width);
            line.break_off(newest.position);
            line.tainted = signal.sign_half_width + 1;
            self.rest.reset();
        }
        line.push(newest.position, newest.force, !newest.good);
        newest
    }

    #[cold]
    fn judge(&mut self, signal: &Signal, published: &Published) {
        if self.trial.judge(published) {
            self.begin_anew(signal.delay);
        }
    }

    /// Restarts all learning: neither what was learnt nor what waits describes the device.
    #[cold]
    fn begin_anew(&mut self, delay: u8) {
        self.line.spoil(delay);
        self.fast.forget();
        self.slow.forget();
        self.watch.forget();
    }

    /// Marks windows of rest, stops and grazing reversals.
    fn gate(&mut self, signal: &Signal, position: i32) {
        let line = &mut self.line;
        let window = signal.rest_block as u8 * BLOCKS as u8;
        match self.rest.push(position, signal.rest_block, signal.rest_limit) {
            Some(Block::AtRest) => {
                // The window and a block on either side of it.
                line.resting = u16::from(signal.delay) + signal.rest_block;
            }
            Some(Block::Moving) if self.feedback.coulomb_like && self.velocity_reversals.have_told() => {
                line.hold(signal.sign_half_width, signal.codes_per_count, &self.feedback);
            }
            Some(Block::Moving) | None => {}
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

    /// Gives the sample half a kernel ago its sign, and relocates the reversal half a long kernel ago.
    fn locate_sign(&mut self, signal: &Signal) {
        let m = signal.sign_half_width;
        let feedback = &self.feedback;
        let line = &mut self.line;
        let plain = line.smooth_velocity(0, m);
        let before = line.plain_velocity;
        // A slow stroke stands within one count before it reverses.
        line.plain_velocity = if plain == 0 { before } else { plain };
        // The comparison of reversals must not depend on its own conclusion: it uses the uncorrected velocity.
        let passes_zero = i64::from(line.plain_velocity) * i64::from(before) < 0;
        // The correction is computed only where the velocity could reach zero within the kernel, to save time.
        let near = plain.unsigned_abs() <= plain.abs_diff(before).saturating_mul(u32::from(m));
        let lost = if feedback.coulomb_like && near { line.smoothed_away(0, m, feedback) } else { 0 };
        // Until friction is known, what hardly moves may stick or creep, and its sign is unreliable.
        let slow = |velocity: i32| velocity.unsigned_abs() <= signal.creep_limit;
        let creeps = feedback.weak_force_code == 0 && slow(plain) && slow(line.smooth_velocity(m, m));
        let middle = line.ago(m);
        middle.passes_zero = passes_zero;
        middle.sign = self.sign.push(plain.saturating_add(lost));
        middle.bad |= creeps;
        // A reversal that friction can hold may have stuck for a moment.
        if feedback.coulomb_like && middle.reverses() {
            middle.bad |= middle.may_be_held(feedback);
        }
        // Across lost or saturated samples, neither the velocity nor the prediction is valid.
        if line.ago(2 * m).passes_zero && line.whole > 4 * m {
            self.pass_zero(signal, m);
        }
        if self.feedback.coulomb_like && self.feedback.friction_known {
            self.line.relocate(m, signal.reversal_half_width, signal.reversal_reach, &self.feedback);
        }
    }

    /// Evaluates a reversal, half a long kernel after it: whether it shows the kink of Coulomb friction, and whether
    /// the stroke before it has recurred.
    #[cold]
    #[inline(never)]
    fn pass_zero(&mut self, signal: &Signal, m: u8) {
        let (line, feedback) = (&self.line, &self.feedback);
        // A screw that stood still before the reversal shows no kink.
        if line.smooth_velocity(m + 1, m) != 0 {
            let narrow = line.smooth_velocity(m, m);
            let wide = line.smooth_velocity(0, 2 * m) >> 2;
            let predicted = line.smoothed_away(m, m, feedback) - (line.smoothed_away(0, 2 * m, feedback) >> 2);
            // Where the force jumps with the friction, as under a shaker that keeps its path, most of the kink is
            // missing, and the prediction is only the force's noise.
            if 2 * u64::from(predicted.unsigned_abs()) >= feedback.kink(m).unsigned_abs() {
                self.velocity_reversals.compare(predicted, wide - narrow, line.at(2 * m).may_be_held(feedback));
            }
        }
        // Counts the samples received, as the sum of positions does. By the index, a stroke with lost samples would
        // change with the count at which it begins.
        let place = (self.counters.samples as u32).wrapping_sub(2 * u32::from(m));
        let here = line.at(2 * m);
        self.repeats.push(place, here.position, here.position_sum, signal.codes_per_count);
    }

    /// Measures the force's noise on the samples that have just left the line: at an update they are all good.
    #[cold]
    fn sample_noise(&mut self, delay: u8) {
        let [a, b, c, d, e] = [0, 1, 2, 3, 4].map(|before: u8| self.line.at(delay.wrapping_add(before)).force);
        self.noise.push([a, b, c, d, e]);
    }

    /// Moves the oldest waiting sample into the cascades.
    fn enter_cascades(&mut self, signal: &Signal) {
        let line = &self.line;
        let known_rest = line.resting > 0;
        let full = line.filled > u16::from(signal.delay);
        let before = line.at(signal.delay.wrapping_add(1));
        let sample = line.at(signal.delay);
        let travel = i64::from(sample.position.wrapping_sub(before.position));
        // Signs are averages around the samples; travel is between the samples. Half of each sign's time lies in
        // between, and away from a reversal's sample both are the same.
        let between = i64::from((before.sign + sample.sign).clamp(-sign::ONE, sign::ONE));
        let travelled = shift_right(travel * between, sign::BITS as i8);
        let cascades = &mut self.cascades;
        cascades.position.push_for_derivatives(cascades.position.input().wrapping_add(travel));
        cascades.path.push_for_derivatives(cascades.path.input().wrapping_add(travelled));
        cascades.force.push(i64::from(sample.force));
        cascades.sign.push(i64::from(sample.sign));
        let good = full && !sample.bad && !known_rest;
        if good && self.plausible.goes(sample.sign) {
            self.begin_anew(signal.delay);
        }
        self.good_samples = if good { self.good_samples.saturating_add(1) } else { 0 };
    }
}

#[cfg(test)]
mod tests {
    use crate::{RawSample, Settings, State};
    use std::boxed::Box;

    /// Strokes and the sum of their squares, for a motion that begins at a position and nearly repeats, with a sample
    /// lost now and then.
    fn strokes(start: i32) -> (u32, u64) {
        let active = Settings::default().validate().unwrap();
        let mut state = Box::new(State::new(&active));
        for index in (0..20_000_u32).filter(|index| index % 73 != 45) {
            let phase = core::f64::consts::TAU * f64::from(index) / 100.0;
            let flicker = (index.wrapping_mul(0x9E37_79B9) >> 31) as i32;
            let position_count = start + (3_000.0 * phase.sin()) as i32 + flicker;
            let force_code = (50_000.0 * phase.cos() - 80_000.0 * phase.sin()) as i32;
            active.step(&mut state, &RawSample { index, position_count, force_code, terminal_code: 0 });
        }
        state.repeats.strokes_and_squares()
    }

    #[test]
    fn strokes_with_lost_samples_are_the_same_wherever_they_lie() {
        let (all, squares) = strokes(0);
        assert!(all > 100 && squares > u64::from(all), "{squares} in {all} strokes");
        for start in [1, -77_777, 1 << 30] {
            assert_eq!(strokes(start), (all, squares), "from {start}");
        }
    }
}
