//! State of both routes, and how a reversal is followed from one flank to the other.

use crate::backlash::active::BacklashActive;
use crate::backlash::flanks::{Flanks, Newest, Touch};
use crate::backlash::law::Law;
use crate::backlash::octaves::Octaves;
use crate::backlash::pool::Pool;
use crate::backlash::step::{self, Fit};
use crate::backlash::terminal::Terminal;
use crate::detail::Reversal;

/// A reversal whose second flank is being touched.
#[derive(Clone, Copy, Debug)]
struct Pending {
    /// Samples from the end of the first flank to the start of the second.
    flight: u32,
    /// Length of either flank [samples] at which to fit next, and beyond which not to fit.
    next: u32,
    last: u32,
}

/// A reversal that is done.
struct Concluded {
    fit: Fit,
    flight: u32,
}

/// What has been counted since the reset.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Counts {
    /// Samples firm on the negative and on the positive flank.
    pub firm: [u32; 2],
    /// Changes from one flank to the other.
    pub reversals: u32,
    /// Of these, with more than one landing.
    pub bouncing: u32,
    /// Of these, with a flank too short to bridge the flight.
    pub short: u32,
}

/// All that is known of the backlash.
#[derive(Clone, Debug)]
pub(crate) struct BacklashState {
    pub flanks: Flanks,
    octaves: Octaves,
    pub pool: Pool,
    pub terminal: Terminal,
    /// The contact's law, by the terminal's sensor.
    law: Law,
    pub counts: Counts,
    /// Side and length [samples] of the present firm contact or, in flight, of the last one.
    side: i8,
    length: u32,
    /// Samples since it ended; 0 while it lasts.
    flight: u32,
    /// Landings since it ended.
    landings: u32,
    pending: Option<Pending>,
    /// Best fit of the pending reversal so far. (Not within `Pending`: an option within an option has a `None` that is
    /// not all zeros, and a static with a single byte that is not zero lies in flash as a whole.)
    best: Option<Fit>,
}

impl Counts {
    const NONE: Self = Self { firm: [0; 2], reversals: 0, bouncing: 0, short: 0 };
}

impl BacklashState {
    /// Nothing seen.
    pub(crate) const fn new() -> Self {
        Self {
            flanks: Flanks::new(),
            octaves: Octaves::new(),
            pool: Pool::new(),
            terminal: Terminal::new(),
            law: Law::UNKNOWN,
            counts: Counts::NONE,
            side: 0,
            length: 0,
            flight: 0,
            landings: 0,
            pending: None,
            best: None,
        }
    }

    /// Forgets everything, in place.
    pub(crate) fn reset(&mut self) {
        let Self { flanks, octaves, pool, terminal, law, counts, side, length, flight, landings, pending, best } = self;
        *flanks = Flanks::new();
        octaves.reset();
        pool.reset();
        terminal.reset();
        *law = Law::UNKNOWN;
        *counts = Counts::NONE;
        (*side, *length, *flight, *landings, *pending, *best) = (0, 0, 0, 0, None, None);
    }

    /// Takes the next sample; returns a reversal, by either route, once both its flanks are known.
    pub(crate) fn push(&mut self, active: &BacklashActive, sample: &Newest) -> Option<Reversal> {
        if sample.broken {
            // Windows reach back to the start of a flank, so none spans the missing samples.
            self.pending = None;
            (self.side, self.length, self.flight) = (0, 0, 0);
            self.flanks.interrupt();
            self.terminal.interrupt();
        }
        let touch = self.flanks.push(&active.flanks, sample);
        self.octaves.push(&touch, active.flanks.guard);
        if active.terminal.present {
            self.terminal.push(&active.terminal, &touch, sample);
        }
        let Some(Concluded { fit, flight }) = self.follow(active, &touch) else {
            // A sample returns one reversal: that of the sensor waits for that of the force.
            return if self.terminal.waits { self.sensed(active) } else { None };
        };
        let since = self.length.wrapping_add(flight / 2).wrapping_add(u32::from(active.flanks.guard));
        self.pool.take(&fit).then(|| active.reversal(&fit, self.side > 0, sample.index.wrapping_sub(since)))
    }

    /// The reversal that waited, from the terminal's sensor.
    #[inline(never)]
    fn sensed(&mut self, active: &BacklashActive) -> Option<Reversal> {
        let crossing = self.terminal.take();
        if self.law.is_due(&self.terminal) {
            self.law = active.law(&self.terminal, self.flanks.noise);
        }
        active.sensed(&self.law, &crossing)
    }

    /// Whether the load stays on one flank.
    pub fn one_sided(&self, active: &BacklashActive) -> bool {
        let [negative, positive] = self.counts.firm;
        let (less, more) = (negative.min(positive), negative.max(positive));
        more >= active.scales.one_sided && self.counts.reversals == 0 && less < active.least_flank
    }

    /// Follows the firm contacts; returns the result of a reversal at its end.
    fn follow(&mut self, active: &BacklashActive, touch: &Touch) -> Option<Concluded> {
        let touching = self.flight == 0 && self.side != 0;
        let mut concluded = None;
        match (touch.classified, touching) {
            (0, true) => {
                self.look(active, 1);
                concluded = self.conclude();
                (self.flight, self.landings) = (1, 0);
            }
            (0, false) => self.flight = self.flight.saturating_add(1),
            (_, true) => {
                self.length = self.length.saturating_add(1);
                self.count(touch.classified);
                if self.pending.is_some_and(|pending| self.length >= pending.next) {
                    self.look(active, 0);
                    if self.pending.is_some_and(|pending| pending.next > pending.last) {
                        concluded = self.conclude();
                    }
                }
            }
            (side, false) => {
                self.land(active, side);
                self.count(side);
            }
        }
        self.landings = self.landings.saturating_add(u32::from(touch.landed));
        concluded
    }

    fn count(&mut self, side: i8) {
        let [negative, positive] = &mut self.counts.firm;
        let firm = if side > 0 { positive } else { negative };
        *firm = firm.saturating_add(1);
    }

    /// A firm contact begins on this side.
    fn land(&mut self, active: &BacklashActive, side: i8) {
        if self.side == -side {
            self.counts.reversals = self.counts.reversals.saturating_add(1);
            // From the middle of the flight two thirds of the way to the reversals on either side, which is two thirds
            // of a period: the polynomial cannot follow more.
            let half = self.length.saturating_add(self.flight).min(1 << 24) * 2 / 3;
            let last = half.saturating_sub(self.flight / 2).min(self.length);
            if self.landings > 1 {
                self.counts.bouncing = self.counts.bouncing.saturating_add(1);
            } else if last < active.least_flank || !active.stiffness_known {
                self.counts.short = self.counts.short.saturating_add(1);
            } else {
                let next = look_at(2 * active.least_flank, last);
                self.pending = Some(Pending { flight: self.flight, next, last });
                self.best = None;
            }
        } else if self.side == side && self.landings > 0 && self.length < active.least_flank {
            // The flank was only the first touch of a reversal.
            self.counts.bouncing = self.counts.bouncing.saturating_add(1);
        }
        (self.side, self.length, self.flight) = (side, 1, 0);
    }

    /// Fits the pending reversal with as much of either flank as there is, up to `late` samples ago.
    fn look(&mut self, active: &BacklashActive, late: u32) {
        let Some(pending) = &mut self.pending else { return };
        let flank = self.length.min(pending.last);
        // The end of a flank is worth a fit of its own where it adds a quarter to the last one.
        let worth = late == 0 || flank >= pending.next - pending.next * 3 / 8;
        if worth && flank >= active.least_flank && pending.flight <= 4 * flank {
            let samples = (2 * flank + pending.flight).saturating_add(late);
            let noise = self.flanks.stretch_noise(&active.flanks);
            let points = self.octaves.window(samples, active.flanks.guard);
            if let Some(fit) = points.and_then(|points| step::fit(&points, active.count_units, noise))
                && self.best.is_none_or(|best| fit.variance < best.variance)
            {
                self.best = Some(fit);
            }
        }
        pending.next =
            if pending.next >= pending.last { u32::MAX } else { look_at(pending.next.saturating_mul(2), pending.last) };
    }

    /// Ends the pending reversal.
    fn conclude(&mut self) -> Option<Concluded> {
        let pending = self.pending.take()?;
        let best = self.best.take();
        if best.is_none() {
            self.counts.short = self.counts.short.saturating_add(1);
        }
        best.map(|fit| Concluded { fit, flight: pending.flight })
    }
}

/// The next length, or the whole flank where that is hardly longer.
fn look_at(next: u32, last: u32) -> u32 {
    if next.saturating_add(next / 4) > last { last } else { next }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Settings;
    use proptest::prelude::*;
    use std::{boxed::Box, vec::Vec};

    proptest! {
        #[test]
        fn nothing_panics(
            samples in prop::collection::vec((any::<i32>(), any::<i32>(), any::<i32>(), any::<u8>()), 1..400),
            rate in 50.0_f64..5000.0,
            oversampling in 1.0_f64..64.0,
        ) {
            let settings = Settings {
                sample_rate_hz: rate,
                oversampling: oversampling.floor(),
                stiffness_n_per_m: 2e6,
                contact_damping_n_s_per_m: 1200.0,
                terminal_sensor: true,
                ..Settings::default()
            };
            let active = settings.validate().unwrap();
            let mut state = Box::new(BacklashState::new());
            for repeat in 0..20_u32 {
                for (index, (position, force, terminal, flags)) in (0..).zip(&samples) {
                    // Mostly steady, so that flanks form.
                    let force = if flags % 8 == 0 { *force } else { if repeat % 2 == 0 { 100_000 } else { -100_000 } };
                    let newest = Newest {
                        index,
                        position: *position,
                        force,
                        terminal: *terminal,
                        good: flags % 64 != 1,
                        broken: *flags == 2,
                        offset: 0,
                    };
                    state.push(&active.backlash, &newest);
                }
                active.backlash.found(&state, 1.0);
            }
        }
    }

    /// Lengths at which a reversal is fitted.
    #[test]
    fn looks_go_on_to_the_last() {
        let looks = |last: u32| -> Vec<u32> {
            core::iter::successors(Some(look_at(16, last)), |now| (*now < last).then(|| look_at(2 * now, last)))
                .collect()
        };
        assert_eq!(looks(18), [18]);
        assert_eq!(looks(93), [16, 32, 64, 93]);
        assert_eq!(looks(5640), [16, 32, 64, 128, 256, 512, 1024, 2048, 4096, 5640]);
    }

    fn active(stiffness_n_per_m: f64) -> BacklashActive {
        Settings { stiffness_n_per_m, ..Settings::default() }.validate().unwrap().backlash
    }

    /// A second flank begins a reversal that reaches two thirds of the way to the next one, if it has landed once and
    /// either flank holds the shortest of 8 samples.
    #[test]
    fn a_reversal_reaches_two_thirds_of_the_way() {
        // Side, length and flight before, landings; the pending lengths, and what is counted.
        for ((side, length, flight, landings), pending, counts) in [
            ((-1, 90, 30, 1), Some((16, 65)), [1, 0, 0]),
            ((-1, 90, 30, 0), Some((16, 65)), [1, 0, 0]),
            ((-1, 90, 30, 2), None, [1, 1, 0]),
            // The flank itself is shorter than that.
            ((-1, 20, 60, 1), Some((16, 20)), [1, 0, 0]),
            ((-1, 12, 1, 1), Some((8, 8)), [1, 0, 0]),
            ((-1, 10, 1, 1), None, [1, 0, 1]),
            // No flank before, or the same one: met again after a touch that was too short for a flank, it bounces.
            ((0, 0, 30, 1), None, [0, 0, 0]),
            ((1, 90, 30, 1), None, [0, 0, 0]),
            ((1, 8, 30, 1), None, [0, 0, 0]),
            ((1, 7, 30, 1), None, [0, 1, 0]),
            ((1, 7, 30, 0), None, [0, 0, 0]),
        ] {
            for turned in [1, -1] {
                let mut state = Box::new(BacklashState::new());
                (state.side, state.length, state.flight, state.landings) = (turned * side, length, flight, landings);
                state.land(&active(2e6), turned);
                let what = (side, length, flight, landings);
                assert_eq!(state.pending.map(|pending| (pending.next, pending.last)), pending, "{what:?}");
                assert!(state.pending.is_none_or(|pending| pending.flight == flight), "{what:?}");
                let Counts { reversals, bouncing, short, .. } = state.counts;
                assert_eq!([reversals, bouncing, short], counts, "{what:?}");
                assert_eq!((state.side, state.length, state.flight), (turned, 1, 0), "{what:?}");
            }
        }
        let mut state = Box::new(BacklashState::new());
        (state.side, state.length, state.flight) = (-1, 90, 30);
        state.land(&active(0.0), 1);
        assert_eq!((state.pending.is_none(), state.counts.short), (true, 1));
    }

    /// A state in which a step of 500 units has passed, the second flank this long.
    fn stepped(active: &BacklashActive, length: u32) -> Box<BacklashState> {
        let mut state = Box::new(BacklashState::new());
        let guard = u32::from(active.flanks.guard);
        for n in 0..200 + length + guard {
            let reach = if n < 200 { 0 } else { -500 };
            let classified = if n < 200 + guard { -1 } else { 1 };
            state.octaves.push(&Touch { reach, classified, ..Touch::default() }, active.flanks.guard);
        }
        (state.side, state.length) = (1, length);
        state
    }

    /// A reversal is fitted over as much of either flank as there is: at its end only if that adds a quarter to the
    /// last fit, and only if the flight is no longer than both flanks twice.
    #[test]
    fn a_look_takes_as_much_of_either_flank() {
        let active = active(2e6);
        for (length, (flight, next, last), late, window) in [
            (16, (6, 16, 65), 0, Some(38)),
            (64, (6, 64, 50), 0, Some(106)),
            (20, (80, 16, 65), 0, Some(120)),
            (20, (81, 16, 65), 0, None),
            (8, (6, 8, 65), 0, Some(22)),
            (7, (6, 7, 65), 0, None),
            (20, (6, 32, 65), 1, Some(47)),
            (19, (6, 32, 65), 1, None),
            (19, (6, 32, 65), 0, Some(44)),
        ] {
            let what = (length, flight, next, last, late);
            let mut state = stepped(&active, length);
            state.pending = Some(Pending { flight, next, last });
            state.look(&active, late);
            let wanted = window.and_then(|samples| {
                let points = state.octaves.window(samples, active.flanks.guard).unwrap();
                step::fit(&points, active.count_units, 0)
            });
            assert_eq!(wanted.is_some(), window.is_some(), "{what:?}");
            assert_eq!(state.best, wanted, "{what:?}");
            assert!(wanted.is_none_or(|fit| fit.value.abs_diff(500) <= 2), "{what:?}");
            // The next look is at twice the length, or at the whole flank where that is hardly longer.
            let following = match (next, last) {
                (64, 50) => u32::MAX,
                (32, 65) => 65,
                _ => 2 * next,
            };
            assert_eq!(state.pending.unwrap().next, following, "{what:?}");
        }
    }

    /// Of several looks the one with the least variance counts.
    #[test]
    fn the_best_look_counts() {
        let active = active(2e6);
        let mut state = stepped(&active, 16);
        for (variance, stays) in [(0, true), (u32::MAX, false)] {
            let best = Some(Fit { value: 7, variance, ..Fit::default() });
            state.best = best;
            state.pending = Some(Pending { flight: 6, next: 16, last: 65 });
            state.look(&active, 0);
            assert_eq!(state.best == best, stays, "{variance}");
        }
    }

    /// A reversal ends with its last look or with its flank. Without a fit it was too short.
    #[test]
    fn a_reversal_ends_with_its_last_look() {
        let active = active(2e6);
        let on = Touch { classified: 1, ..Touch::default() };
        for (length, next, last, ends) in
            [(64, 65, 65, true), (63, 65, 65, false), (31, 32, 65, false), (15, 16, 16, true)]
        {
            let mut state = stepped(&active, length + 1);
            state.length = length;
            state.pending = Some(Pending { flight: 6, next, last });
            let concluded = state.follow(&active, &on);
            assert_eq!(concluded.is_some(), ends, "{length} {next} {last}");
            assert!(concluded.is_none_or(|concluded| concluded.flight == 6));
            assert_eq!((state.pending.is_none(), state.counts.short, state.length), (ends, 0, length + 1));
        }
        // The flank ends first.
        for (length, short) in [(20, 0), (5, 1)] {
            let mut state = stepped(&active, length);
            state.pending = Some(Pending { flight: 6, next: 16, last: 65 });
            let concluded = state.follow(&active, &Touch::default());
            assert_eq!((concluded.is_some(), state.counts.short), (short == 0, short), "{length}");
            assert_eq!((state.pending.is_none(), state.flight, state.landings), (true, 1, 0));
            // In flight, samples and landings are counted.
            state.follow(&active, &Touch { landed: true, ..Touch::default() });
            assert_eq!((state.flight, state.landings), (2, 1));
        }
    }
}
