//! The past at every time scale: line `k` holds the last 64 means over `2^k` samples.
//!
//! A reversal at 15 Hz lasts 30 ms, one at 0.05 Hz takes seconds. Either finds its window in one of the lines, with 32
//! to 63 entries, at two additions per sample.

use crate::backlash::flanks::Touch;
use crate::backlash::step::{POINTS, Points};

/// Lines: the last one reaches back 16384 samples, 4 s at 4 kHz.
const LINES: usize = 9;

#[derive(Clone, Debug)]
struct Line {
    /// Position and stretch [units], wrapping.
    reach: [i32; POINTS],
    stretch: [i16; POINTS],
    /// Entries firm on the positive and on the negative flank, one bit each.
    positive: u64,
    negative: u64,
}

/// The lines.
#[derive(Clone, Debug)]
pub(crate) struct Octaves {
    lines: [Line; LINES],
    /// Samples taken, wrapping.
    count: u32,
}

impl Line {
    const EMPTY: Self = Self { reach: [0; POINTS], stretch: [0; POINTS], positive: 0, negative: 0 };

    fn get(&self, place: u32) -> (i32, i16, i8) {
        let place = place % POINTS as u32;
        let bit = |mask: u64| (mask >> place) as i8 & 1;
        (self.reach[place as usize], self.stretch[place as usize], bit(self.positive) - bit(self.negative))
    }

    fn set(&mut self, place: u32, (reach, stretch, side): (i32, i16, i8)) {
        let place = place % POINTS as u32;
        self.reach[place as usize] = reach;
        self.stretch[place as usize] = stretch;
        self.classify(place, side);
    }

    /// Mean of an entry and the one before it; firm where both are, on the same side.
    fn mean(&self, place: u32) -> (i32, i16, i8) {
        let (reach, stretch, side) = self.get(place.wrapping_sub(1));
        let (other_reach, other_stretch, other_side) = self.get(place);
        (
            reach.wrapping_add(other_reach.wrapping_sub(reach) >> 1),
            ((i32::from(stretch) + i32::from(other_stretch)) >> 1) as i16,
            if side == other_side { side } else { 0 },
        )
    }

    fn classify(&mut self, place: u32, side: i8) {
        let bit = 1 << (place % POINTS as u32);
        self.positive = if side > 0 { self.positive | bit } else { self.positive & !bit };
        self.negative = if side < 0 { self.negative | bit } else { self.negative & !bit };
    }
}

impl Octaves {
    /// Nothing seen.
    pub const fn new() -> Self {
        Self { lines: [Line::EMPTY; LINES], count: 0 }
    }

    /// Forgets everything, in place.
    pub fn reset(&mut self) {
        let Self { lines, count } = self;
        for Line { reach, stretch, positive, negative } in lines {
            reach.fill(0);
            stretch.fill(0);
            (*positive, *negative) = (0, 0);
        }
        *count = 0;
    }

    /// Takes a sample, and the classification of the one `guard` ago.
    #[inline]
    pub fn push(&mut self, touch: &Touch, guard: u8) {
        let newest = self.count;
        self.count = newest.wrapping_add(1);
        let classified = newest.wrapping_sub(u32::from(guard));
        let mut lines = self.lines.iter_mut();
        let Some(mut finer) = lines.next() else { return };
        finer.set(newest, (touch.reach, touch.stretch, 0));
        finer.classify(classified, touch.classified);
        let mut place = classified;
        for coarser in lines {
            // An entry is complete with its second half.
            if place & 1 == 0 {
                break;
            }
            let mean = finer.mean(place);
            place >>= 1;
            coarser.set(place, mean);
            finer = coarser;
        }
    }

    /// The classified ones of the last `samples`, oldest first, in the finest line that holds them; `None` if no line
    /// does.
    pub fn window(&self, samples: u32, guard: u8) -> Option<Points> {
        let classified = self.count.wrapping_sub(u32::from(guard));
        // The first line's newest entries are not yet classified.
        let room = |line: usize| POINTS as u32 - 1 - if line == 0 { u32::from(guard) } else { 0 };
        let (number, line) = self.lines.iter().enumerate().find(|(number, _)| samples >> number < room(*number))?;
        let end = classified >> number;
        let start_sample = classified.wrapping_sub(samples);
        let mut points = Points::new();
        for back in (1..=room(number)).rev() {
            let place = end.wrapping_sub(back);
            // Whether the entry starts within the window.
            let first = (place << number).wrapping_sub(start_sample);
            if first <= samples {
                let (reach, stretch, side) = line.get(place);
                points.push(reach, stretch, side);
            }
        }
        points.scale = number as u8;
        Some(points)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backlash::step::fit;
    use inerter_needs::Random;
    use std::{format, vec::Vec};

    fn touch(reach: i32, classified: i8) -> Touch {
        Touch { reach, classified, ..Touch::default() }
    }

    /// A step on a straight line is found in every line, also where reach and count wrap.
    #[test]
    fn a_step_is_found_at_every_pace() {
        const GUARD: u8 = 5;
        for number in 0..LINES as u32 {
            let mut octaves = Octaves::new();
            octaves.count = u32::MAX - 7000;
            let half = 20_i32 << number;
            let total = 20_000 + 2 * half;
            for n in 0..total + i32::from(GUARD) {
                let before = n - total + half;
                let reach = i32::MAX.wrapping_add(n.wrapping_mul(3)).wrapping_add(if before >= 0 { -1000 } else { 0 });
                let classified = match before - i32::from(GUARD) {
                    0.. => 1,
                    ..0 => -1,
                };
                octaves.push(&touch(reach, classified), GUARD);
            }
            let points = octaves.window(2 * half as u32, GUARD).unwrap();
            assert_eq!(u32::from(points.scale), number);
            let found = fit(&points, 16, 0).unwrap();
            assert!(found.value.abs_diff(1000) <= 2, "{number}: {found:?}");
        }
    }

    #[test]
    fn what_is_too_long_has_no_window() {
        assert!(Octaves::new().window(63 << 8, 4).is_none());
        assert!(Octaves::new().window(62 << 8, 4).is_some());
    }

    /// Each line holds the means of two entries of the line before it, firm where both are on one flank. A window lies
    /// in the first line with room for it: 64 entries, less one for where it begins and, in the first line, less those
    /// not yet classified.
    #[test]
    fn a_window_holds_the_means_of_its_samples() {
        let mut random = Random(7);
        let mut windows = [0; LINES];
        for guard in [2_u8, 5, 31] {
            let unclassified = usize::from(guard);
            let mut octaves = Octaves::new();
            let mut samples: Vec<(i64, i64, i8)> = Vec::new();
            let mut side = 0_i8;
            for n in 0..6000 {
                if random.percent(1) {
                    side = random.pick(&[-1, 0, 1]);
                }
                let (reach, stretch) = (random.below(2_000_001_i32) - 1_000_000, random.below(60_001_i32) - 30_000);
                samples.push((i64::from(reach), i64::from(stretch), side));
                let classified = if n < unclassified { 0 } else { samples[n - unclassified].2 };
                octaves.push(&Touch { reach, stretch: stretch as i16, classified, ..Touch::default() }, guard);
                if n % 449 != 448 {
                    continue;
                }
                let end = n + 1 - unclassified;
                for length in [3, 31, 32, 57, 58, 60, 61, 62, 63, 64, 100, 200, 500, 900, 1500, 4000] {
                    let first_room = 63 - unclassified;
                    let number = (0..LINES)
                        .find(|number| (length >> *number) < if *number == 0 { first_room } else { 63 })
                        .unwrap();
                    if length > end {
                        continue;
                    }
                    let mut line = samples[..end].to_vec();
                    for _ in 0..number {
                        let means = line.chunks_exact(2).map(|pair| {
                            let [(reach, stretch, side), (other_reach, other_stretch, other_side)] = [pair[0], pair[1]];
                            let both = if side == other_side { side } else { 0 };
                            ((reach + other_reach).div_euclid(2), (stretch + other_stretch).div_euclid(2), both)
                        });
                        line = means.collect();
                    }
                    let mut wanted = Points::new();
                    for (place, (reach, stretch, side)) in line.iter().enumerate() {
                        if place << number >= end - length {
                            wanted.push(*reach as i32, *stretch as i16, *side);
                        }
                    }
                    wanted.scale = number as u8;
                    let found = octaves.window(length as u32, guard).unwrap();
                    assert_eq!(format!("{found:?}"), format!("{wanted:?}"), "{length} at {n}");
                    windows[number] += 1;
                }
            }
            octaves.reset();
            assert_eq!(format!("{octaves:?}"), format!("{:?}", Octaves::new()));
        }
        assert!(windows[..7].iter().all(|count| *count > 0), "{windows:?}");
    }
}
