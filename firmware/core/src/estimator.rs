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
    use crate::{Active, RawSample, Settings, State};
    use std::boxed::Box;

    fn fresh(settings: &Settings) -> (Active, Box<State>) {
        let active = settings.validate().unwrap();
        let state = Box::new(State::new(&active));
        (active, state)
    }

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

    /// An index that is ahead by less than half of its range has skipped samples; any other is a restart.
    #[test]
    fn an_index_ahead_by_half_of_its_range_is_a_restart() {
        const HALF: u32 = 1 << 31;
        for (next, lost, jumps) in [(1, 0, 0), (3, 2, 1), (HALF, u64::from(HALF) - 1, 1), (HALF + 1, 0, 1), (0, 0, 1)] {
            let (active, mut state) = fresh(&Settings::default());
            for index in [0, next] {
                active.step(&mut state, &RawSample { index, position_count: 0, force_code: 0, terminal_code: 0 });
            }
            let counters = state.counters();
            assert_eq!((counters.lost_samples, counters.discontinuities), (lost, jumps), "{next}");
        }
    }

    #[test]
    fn codes_at_the_limits_and_beyond_are_saturated() {
        let settings = Settings { force_min_code: -1000.0, force_max_code: 1500.0, ..Settings::default() };
        for (force_code, saturated) in
            [(-1001, 1), (-1000, 1), (-999, 0), (0, 0), (1499, 0), (1500, 1), (i32::MAX, 1), (i32::MIN, 1)]
        {
            let (active, mut state) = fresh(&settings);
            active.step(&mut state, &RawSample { index: 0, position_count: 0, force_code, terminal_code: 0 });
            assert_eq!(state.counters().saturated, saturated, "{force_code}");
        }
    }

    /// At a hundred times full scale each output is refused and counted: one in 8 samples and one in 32, from when the
    /// kernels of 66 and 258 samples are filled.
    #[test]
    fn outputs_beyond_full_scale_are_counted_and_teach_nothing() {
        let (active, mut state) =
            fresh(&Settings { full_scale_velocity_m_per_s: 1e-3, metres_per_count: 2.44e-6, ..Settings::default() });
        for index in 0..2000_u32 {
            let position_count = 41 * index as i32;
            active.step(&mut state, &RawSample { index, position_count, force_code: 0, terminal_code: 0 });
        }
        let outputs = (2000 - 66) / 8 + (2000 - 258) / 32;
        let saturated = state.counters().saturated;
        assert!((outputs - 20..=outputs).contains(&saturated), "{saturated} of {outputs}");
        assert_eq!((state.fast.whole.updates(), state.slow.whole.updates()), (0, 0));
    }

    /// The force's noise is measured once at each update, whether of one bank or of both.
    #[test]
    fn noise_is_measured_once_at_each_update() {
        let (active, mut state) = fresh(&Settings::default());
        // Before the second estimate, nothing is forgotten.
        for index in 0..395_u32 {
            let phase = core::f64::consts::TAU * f64::from(index) / 100.0;
            let position_count = (3_000.0 * phase.sin()) as i32;
            let force_code = (50_000.0 * phase.cos() - 80_000.0 * phase.sin()) as i32;
            active.step(&mut state, &RawSample { index, position_count, force_code, terminal_code: 0 });
        }
        // Each difference forgets 1/2048 of those before it.
        let (updates, differences) = (state.fast.whole.updates(), state.noise.differences());
        assert!(updates > 30 && differences.abs_diff(updates) <= 2, "{differences} at {updates} updates");
    }

    /// Signs are found within 5 samples on either side, and between samples.
    #[test]
    fn signs_across_a_jump_are_bad() {
        let (active, mut state) = fresh(&Settings::default());
        for n in 0..60_u32 {
            let index = if n < 40 { n } else { n + 5 };
            let sample = RawSample { index, position_count: 40 * n as i32, force_code: 1000, terminal_code: 0 };
            state.receive(&active.signal, &sample);
        }
        // Samples 34 to 45.
        assert!((0..50_u8).filter(|&ago| state.line.at(ago).bad).eq(14..=25));
    }

    /// In 24 samples a reversal moves by four counts at most, under a force that is weak beside its offset.
    #[test]
    fn weak_reversals_graze() {
        for (travel, force, is_bad) in [
            (4, 10, true),
            (5, 10, false),
            (-4, 10, true),
            (-5, 10, false),
            (4, 109, true),
            (4, 110, false),
            (4, -89, true),
            (4, -90, false),
        ] {
            let (active, mut state) = fresh(&Settings::default());
            (state.feedback.weak_force_code, state.feedback.offset_code) = (100, 10);
            (0..60).for_each(|n| state.line.push(if n < 40 { 0 } else { travel }, force, false));
            state.gate(&active.signal, travel);
            let bad = (0..60_u8).filter(|&ago| state.line.at(ago).bad);
            // In the middle of the window.
            assert!(bad.eq((12..13).filter(|_| is_bad)), "{travel} {force}");
        }
    }

    /// The first window ends with the 24th sample. All that wait are then at rest, and the next block's samples too.
    #[test]
    fn a_window_without_motion_is_rest() {
        let (active, mut state) = fresh(&Settings::default());
        for n in 1..=26 {
            state.line.push(7, 0, false);
            state.gate(&active.signal, 7);
            let resting = if n < 24 { 0 } else { 30 + 3 - (n - 24) };
            assert_eq!(state.line.resting, resting, "{n}");
        }
    }

    /// Where a screw stops under a force that friction can hold, it may stick, if friction has shown to be Coulomb
    /// friction.
    #[test]
    fn stops_are_bad_where_coulomb_friction_has_shown() {
        for (coulomb_like, have_told) in [(true, true), (true, false), (false, true), (false, false)] {
            let (active, mut state) = fresh(&Settings::default());
            state.feedback.weak_force_code = 100;
            if have_told {
                state.velocity_reversals.compare(100, 95, true);
            }
            for n in 0..60_i32 {
                // Two counts a sample, then none.
                let position = 2 * n.min(49);
                state.line.push(position, 0, false);
                state.feedback.coulomb_like = coulomb_like && n == 59;
                state.gate(&active.signal, position);
            }
            let bad = (0..60_u8).filter(|&ago| state.line.at(ago).bad).count();
            // The sign's kernels reach five samples to both sides of the stop.
            assert_eq!(bad, if coulomb_like && have_told { 11 } else { 0 }, "{coulomb_like} {have_told}");
        }
    }
}
