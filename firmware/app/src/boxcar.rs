//! Sums the conversions of the analogue front end into samples.
//!
//! Terms:
//! - *entry*: the result of one trigger: an encoder count and two conversions, latched together.
//! - *window*: the entries that are summed into one sample.
//! - *rail*: either end of the converter's range. A window that touches a rail has lost part of the signal.
//!
//! Positions are in 64ths of a count and codes are sums of 64 conversions at every rate, so settings suit all rates.

use inerter_core::RawSample;

/// Counts and conversions that a sample represents, however many were summed: the setting `oversampling`.
pub const WEIGHT: u32 = 64;
/// Largest 12-bit conversion.
const GREATEST: u16 = 4095;
/// Force code of a window that touches the lower rail: the setting `force_min_code`.
pub const LOWER_RAIL: i32 = 0;
/// Force code of a window that touches the upper rail: the setting `force_max_code`.
pub const UPPER_RAIL: i32 = (WEIGHT * GREATEST as u32) as i32;

/// Sums entries into samples.
///
/// Sample `n` is the sum of the entries `n * w` to `n * w + w - 1`, with `w` the window length; the counter wraps at
/// 2^32. Positions wrap with the counts; force and terminal codes are 0 to [`UPPER_RAIL`]. A force code is a rail when
/// any conversion of its window is, so that the estimator leaves it out.
#[derive(Clone, Debug)]
pub struct Boxcar {
    window: u32,
    /// log2 of the factor that scales a sum of `window` entries to [`WEIGHT`].
    shift: u32,
    /// Index of the sample that the current window will become.
    index: u32,
    /// Entries of the current window so far.
    passed: u32,
    /// Whether some of them were lost.
    incomplete: bool,
    position: u32,
    force: u32,
    terminal: u32,
    /// Smallest and largest force conversion of the window.
    least: u16,
    greatest: u16,
}

impl Boxcar {
    /// A boxcar at the start of its first window, of 16, 32 or 64 entries: 4, 2 or 1 kHz from 64 kHz.
    ///
    /// # Panics
    /// With any other number.
    pub const fn new(entries_per_sample: u32) -> Self {
        Self::starting_at(entries_per_sample, 0)
    }

    /// As [`new`](Self::new), but the first sample has this index, to continue where another boxcar stopped.
    ///
    /// # Panics
    /// As [`new`](Self::new).
    pub const fn starting_at(entries_per_sample: u32, index: u32) -> Self {
        assert!(matches!(entries_per_sample, 16 | 32 | 64), "a sample is the sum of 16, 32 or 64 entries");
        Self {
            window: entries_per_sample,
            shift: WEIGHT.ilog2() - entries_per_sample.ilog2(),
            index,
            passed: 0,
            incomplete: false,
            position: 0,
            force: 0,
            terminal: 0,
            least: u16::MAX,
            greatest: 0,
        }
    }

    /// Index of the next sample.
    pub fn index(&self) -> u32 {
        self.index
    }

    /// Takes the next entries and passes each sample that they complete to `into`.
    ///
    /// The slices should have the same length; the excess of longer ones is ignored.
    pub fn push_half(
        &mut self,
        positions: &[u32],
        forces: &[u16],
        terminals: &[u16],
        into: &mut impl FnMut(RawSample),
    ) {
        let (mut positions, mut forces, mut terminals) = (positions, forces, terminals);
        loop {
            let wanted = (self.window - self.passed) as usize;
            let count = wanted.min(positions.len()).min(forces.len()).min(terminals.len());
            let Some((position, later_positions)) = positions.split_at_checked(count) else { return };
            let Some((force, later_forces)) = forces.split_at_checked(count) else { return };
            let Some((terminal, later_terminals)) = terminals.split_at_checked(count) else { return };
            self.add(position, force, terminal);
            if count < wanted {
                return;
            }
            if !self.incomplete {
                into(self.sample());
            }
            self.begin_window(1);
            (positions, forces, terminals) = (later_positions, later_forces, later_terminals);
        }
    }

    /// Skips entries that were lost: the windows that they belong to are left out, and the sample counter shows it.
    pub fn skip(&mut self, entries: u32) {
        if entries == 0 {
            return;
        }
        let passed = u64::from(self.passed) + u64::from(entries);
        let window = u64::from(self.window);
        self.begin_window((passed / window) as u32);
        self.passed = (passed % window) as u32;
        self.incomplete = self.passed > 0;
    }

    fn begin_window(&mut self, samples_later: u32) {
        self.index = self.index.wrapping_add(samples_later);
        (self.passed, self.incomplete) = (0, false);
        (self.position, self.force, self.terminal) = (0, 0, 0);
        (self.least, self.greatest) = (u16::MAX, 0);
    }

    /// Adds slices of equal length; one loop per slice, so that each takes a few instructions per entry.
    fn add(&mut self, positions: &[u32], forces: &[u16], terminals: &[u16]) {
        self.position = positions.iter().fold(self.position, |sum, count| sum.wrapping_add(*count));
        for &code in forces {
            self.force += u32::from(code);
            self.least = self.least.min(code);
            self.greatest = self.greatest.max(code);
        }
        self.terminal += terminals.iter().map(|code| u32::from(*code)).sum::<u32>();
        self.passed += positions.len() as u32;
    }

    fn sample(&self) -> RawSample {
        let force_code = if self.least == 0 {
            LOWER_RAIL
        } else if self.greatest >= GREATEST {
            UPPER_RAIL
        } else {
            (self.force << self.shift) as i32
        };
        RawSample {
            index: self.index,
            position_count: (self.position << self.shift) as i32,
            force_code,
            terminal_code: (self.terminal << self.shift) as i32,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Boxcar, LOWER_RAIL, UPPER_RAIL};
    use inerter_core::{RawSample, Settings};
    use std::vec::Vec;

    /// Entries of a uniformly turning screw, with a force that follows the entry number.
    struct Entries {
        positions: Vec<u32>,
        forces: Vec<u16>,
        terminals: Vec<u16>,
    }

    impl Entries {
        fn new(count: u32, position: impl Fn(u32) -> u32, force: impl Fn(u32) -> u16) -> Self {
            let terminals = (0..count).map(|entry| (entry * 7 % 4096) as u16).collect();
            Self { positions: (0..count).map(position).collect(), forces: (0..count).map(force).collect(), terminals }
        }

        fn even(count: u32) -> Self {
            Self::new(count, |entry| entry.wrapping_mul(3).wrapping_sub(1_000), |entry| (1 + entry % 4_094) as u16)
        }

        fn push(&self, range: core::ops::Range<usize>, boxcar: &mut Boxcar) -> Vec<RawSample> {
            let mut samples = Vec::new();
            let (positions, forces) = (&self.positions[range.clone()], &self.forces[range.clone()]);
            boxcar.push_half(positions, forces, &self.terminals[range], &mut |sample| samples.push(sample));
            samples
        }

        fn all(&self, boxcar: &mut Boxcar) -> Vec<RawSample> {
            self.push(0..self.positions.len(), boxcar)
        }

        /// Computed from the definition, one sum at a time.
        fn expected(&self, window: usize) -> Vec<RawSample> {
            let worth = (64 / window) as i64;
            let windows = self.positions.len() / window;
            (0..windows)
                .map(|place| {
                    let range = place * window..(place + 1) * window;
                    let position: i64 = self.positions[range.clone()].iter().map(|count| i64::from(*count)).sum();
                    let force: i64 = self.forces[range.clone()].iter().map(|code| i64::from(*code)).sum();
                    let terminal: i64 = self.terminals[range].iter().map(|code| i64::from(*code)).sum();
                    RawSample {
                        index: place as u32,
                        position_count: (position * worth) as i32,
                        force_code: (force * worth) as i32,
                        terminal_code: (terminal * worth) as i32,
                    }
                })
                .collect()
        }
    }

    #[test]
    fn samples_are_the_sums_at_each_rate_however_the_entries_come() {
        let entries = Entries::even(4_096);
        for window in [16, 32, 64] {
            let expected = entries.expected(window);
            assert_eq!(expected.len(), 4_096 / window);
            assert_eq!(entries.all(&mut Boxcar::new(window as u32)), expected);
            for portion in [1, 7, 15, 16, 17, 63, 64, 65, 255, 256, 1_000] {
                let mut boxcar = Boxcar::new(window as u32);
                let starts = (0..4_096).step_by(portion);
                let samples: Vec<RawSample> =
                    starts.flat_map(|from| entries.push(from..(from + portion).min(4_096), &mut boxcar)).collect();
                assert_eq!(samples, expected, "{window} {portion}");
            }
        }
    }

    #[test]
    fn codes_do_not_depend_on_the_rate() {
        let entries = Entries::new(64, |_| 123_456, |_| 2_345);
        for window in [16, 32, 64] {
            for sample in entries.all(&mut Boxcar::new(window)) {
                assert_eq!((sample.position_count, sample.force_code), (123_456 * 64, 2_345 * 64));
            }
        }
    }

    #[test]
    fn positions_wrap_with_the_counter_and_differences_survive() {
        for window in [16, 32, 64] {
            // The counter passes 2^32 and the sum 2^31, both ways.
            for step in [5u32, 5u32.wrapping_neg()] {
                let entries = Entries::new(2_048, |entry| entry.wrapping_mul(step).wrapping_sub(1_000), |_| 100);
                let samples = entries.all(&mut Boxcar::new(window));
                let moved = (step as i32).wrapping_mul(window as i32 * 64);
                for pair in samples.windows(2) {
                    assert_eq!(pair[1].position_count.wrapping_sub(pair[0].position_count), moved);
                }
            }
        }
    }

    #[test]
    fn a_window_that_touches_a_rail_is_the_rail() {
        for window in [16u32, 32, 64] {
            for touched in 0..window {
                for (code, rail) in [(0, LOWER_RAIL), (4_095, UPPER_RAIL), (1, 0), (4_094, 0)] {
                    let force = |entry| if entry == window + touched { code } else { 2_000 };
                    let samples = Entries::new(3 * window, |_| 0, force).all(&mut Boxcar::new(window));
                    let codes: Vec<i32> = samples.iter().map(|sample| sample.force_code).collect();
                    let near = (128_000 - 2_000 * (64 / window as i32)) + i32::from(code) * (64 / window as i32);
                    let expected = if code == 0 || code == 4_095 { rail } else { near };
                    assert_eq!(codes, [128_000, expected, 128_000], "{window} {touched} {code}");
                }
            }
        }
        // With the rails as limits, core leaves out exactly such windows.
        let limits = Settings {
            force_min_code: f64::from(LOWER_RAIL),
            force_max_code: f64::from(UPPER_RAIL),
            force_zero_code: 131_040.0,
            oversampling: 64.0,
            ..Settings::default()
        };
        assert!(limits.validate().is_ok());
        let nearly = Entries::new(64, |_| 0, |_| 4_094).all(&mut Boxcar::new(64));
        assert!(nearly[0].force_code < UPPER_RAIL);
    }

    #[test]
    fn a_terminal_code_is_the_plain_sum() {
        let mut entries = Entries::even(64);
        entries.terminals = std::vec![4_095; 64];
        assert_eq!(entries.all(&mut Boxcar::new(64))[0].terminal_code, UPPER_RAIL);
        entries.terminals[0] = 0;
        assert_eq!(entries.all(&mut Boxcar::new(64))[0].terminal_code, UPPER_RAIL - 4_095);
    }

    /// Whatever is lost, the complete windows are delivered with their own numbers.
    #[test]
    fn windows_that_lost_entries_are_left_out_and_counted() {
        let entries = Entries::even(2_048);
        for window in [16, 32, 64] {
            let expected = entries.expected(window);
            for from in [0, 1, 15, 16, 63, 64, 100, 256, 511] {
                for lost in [0, 1, 15, 16, 17, 48, 63, 64, 65, 256, 1_000] {
                    let mut boxcar = Boxcar::new(window as u32);
                    let mut samples = entries.push(0..from, &mut boxcar);
                    boxcar.skip(lost as u32);
                    samples.extend(entries.push(from + lost..2_048, &mut boxcar));
                    let whole = expected.iter().enumerate().filter(|(place, _)| {
                        let (begin, end) = (place * window, (place + 1) * window);
                        lost == 0 || end <= from || begin >= from + lost
                    });
                    let whole: Vec<RawSample> = whole.map(|(_, sample)| *sample).collect();
                    assert_eq!(samples, whole, "{window} {from} {lost}");
                    assert_eq!(boxcar.index() as usize, 2_048 / window);
                }
            }
        }
    }

    #[test]
    fn losses_add_up_and_the_sample_counter_wraps() {
        let mut boxcar = Boxcar::starting_at(16, u32::MAX);
        boxcar.skip(10);
        boxcar.skip(5);
        let entries = Entries::even(33);
        let samples = entries.all(&mut boxcar);
        assert_eq!(samples.iter().map(|sample| sample.index).collect::<Vec<_>>(), [0, 1]);
        boxcar.skip(u32::MAX);
        assert_eq!(boxcar.index(), 2 + (1 << 28) - 1);
    }

    #[test]
    fn slices_of_different_length_are_taken_as_far_as_all_go() {
        let mut boxcar = Boxcar::new(16);
        let mut samples = 0;
        boxcar.push_half(&[0; 40], &[1; 20], &[1; 33], &mut |_| samples += 1);
        assert_eq!(samples, 1);
        boxcar.push_half(&[], &[], &[], &mut |_| samples += 1);
        boxcar.push_half(&[0; 12], &[1; 12], &[1; 12], &mut |_| samples += 1);
        assert_eq!(samples, 2);
    }

    #[test]
    #[should_panic(expected = "16, 32 or 64")]
    fn other_windows_are_the_programmers_mistake() {
        Boxcar::new(48);
    }
}
