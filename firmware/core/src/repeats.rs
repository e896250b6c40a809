//! Whether the motion repeats itself sample by sample. The encoder's steps then repeat with it, and averaging does not
//! remove them.
//!
//! Each stroke from one reversal to the next has a fingerprint: its number of samples, and the sum of its positions
//! from where it began. Strokes of which more than one sample in [`FLIPS`] lies in another count have different
//! fingerprints. A screw that is shaken by another clock, or by anything imperfect, never makes two strokes alike. The
//! strokes of a tone have one length whatever the clock; these are counted, too. Integers, once per reversal.

/// Fingerprints that are kept, each in its own place.
const PLACES: usize = 128;
/// Travel from reversal to reversal below which a stroke is a flicker [counts].
const LEAST_TRAVEL: u32 = 8;
/// A recurring stroke may have one sample in this many in another count.
const FLIPS: u32 = 16;
/// Greatest difference in length between two strokes of a steady tone [counts]: one for each end.
const LENGTHS_APART: u32 = 2;

/// Counts recurring strokes.
#[derive(Clone, Debug)]
pub struct Repeats {
    kept: [Kept; PLACES],
    strokes: u32,
    /// Sum over all fingerprints of the square of how often each has come.
    squares: u64,
    /// Length of the last stroke \[codes\].
    length: u32,
    /// Strokes that were as long as the one before.
    steady: u32,
    /// Where the stroke began: index, position and the running sum of positions; `None` before the first reversal.
    begin: Option<[i32; 3]>,
}

/// A fingerprint, and how often it has come.
#[derive(Clone, Copy, Debug)]
struct Kept {
    print: u32,
    times: u32,
}

impl Default for Repeats {
    fn default() -> Self {
        Self::new()
    }
}

impl Repeats {
    /// Nothing seen.
    pub const fn new() -> Self {
        Self { kept: [Kept { print: 0, times: 0 }; PLACES], strokes: 0, squares: 0, length: 0, steady: 0, begin: None }
    }

    /// Forgets everything, in place.
    pub fn reset(&mut self) {
        self.kept.fill(Kept { print: 0, times: 0 });
        (self.strokes, self.squares, self.begin) = (0, 0, None);
        (self.length, self.steady) = (0, 0);
    }

    /// Takes a reversal at this sample; `codes` is the number of position codes in a count.
    pub fn push(&mut self, index: u32, position: i32, position_sum: i32, codes: u32) {
        let Some([before, start, sum]) = self.begin.replace([index as i32, position, position_sum]) else { return };
        let samples = (index as i32).wrapping_sub(before);
        let travel = position.wrapping_sub(start);
        if travel.unsigned_abs() < LEAST_TRAVEL * codes {
            return;
        }
        let area = position_sum.wrapping_sub(sum).wrapping_sub(samples.wrapping_mul(start));
        if self.strokes == u32::MAX {
            return;
        }
        self.strokes += 1;
        let before = core::mem::replace(&mut self.length, travel.unsigned_abs());
        self.steady += u32::from(before.abs_diff(self.length) <= LENGTHS_APART * codes);
        // Areas are compared in cells of this width, and with the nearer one of the neighbouring cells.
        let width = (1 + samples.unsigned_abs() / FLIPS).saturating_mul(codes).clamp(1, 1 << 30) as i32;
        let (cell, within) = (area.div_euclid(width), area.rem_euclid(width));
        let other = if within < width / 2 { cell.wrapping_sub(1) } else { cell.wrapping_add(1) };
        let [here, beside] = [cell, other].map(|cell| print(samples, cell));
        let is_beside = self.kept[place(beside)].print == beside;
        let print = if is_beside { beside } else { here };
        let kept = &mut self.kept[place(print)];
        if kept.print != print {
            *kept = Kept { print, times: 0 };
        }
        self.squares += 2 * u64::from(kept.times) + 1;
        kept.times += 1;
    }

    /// All strokes, and the sum over all fingerprints of the square of how often each has come.
    pub fn strokes_and_squares(&self) -> (u32, u64) {
        (self.strokes, self.squares)
    }

    /// Strokes that were as long as the one before.
    pub fn steady(&self) -> u32 {
        self.steady
    }
}

/// The fingerprint of so many samples and this cell; never 0.
fn print(samples: i32, cell: i32) -> u32 {
    // Odd constants of the golden ratio and of the square root of two spread differences over all bits.
    ((samples as u32).wrapping_mul(0x9e37_79b1) ^ (cell as u32).wrapping_mul(0xb504_f335)).max(1)
}

fn place(print: u32) -> usize {
    (print >> 25) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    const CODES: u32 = 64;

    /// How often a stroke comes on average, in `turns` periods of `period` samples.
    fn times(turns: u32, period: f64) -> f64 {
        let strokes = shaken(turns, period, |_| 400.3);
        let (count, squares) = strokes.strokes_and_squares();
        assert!(count.abs_diff(2 * turns) <= 2, "{count} strokes in {turns} turns");
        squares as f64 / f64::from(count)
    }

    /// `turns` periods of `period` samples, with the amplitude in counts at each sample.
    fn shaken(turns: u32, period: f64, amplitude: impl Fn(u32) -> f64) -> Repeats {
        let (mut repeats, mut sum, mut reversal) = (Repeats::new(), 0_i32, period / 4.0);
        for index in 0..(f64::from(turns) * period) as u32 {
            let angle = core::f64::consts::TAU * f64::from(index) / period;
            let position = (amplitude(index) * angle.sin()).floor() as i32 * CODES as i32;
            sum = sum.wrapping_add(position);
            if f64::from(index) >= reversal {
                reversal += period / 2.0;
                repeats.push(index, position, sum, CODES);
            }
        }
        repeats
    }

    #[test]
    fn strokes_of_one_clock_come_again_and_those_of_two_do_not() {
        // One stroke up and one down in each turn.
        assert!((times(40, 97.0) - 40.0).abs() < 2.0, "{}", times(40, 97.0));
        let golden = (1.0 + 5_f64.sqrt()) / 2.0;
        assert!(times(40, 96.0 + golden) < 4.0, "{}", times(40, 96.0 + golden));
    }

    #[test]
    fn strokes_of_a_steady_tone_are_of_one_length_whatever_the_clock() {
        let part = |strokes: Repeats| f64::from(strokes.steady()) / f64::from(strokes.strokes_and_squares().0);
        let golden = (1.0 + 5_f64.sqrt()) / 2.0;
        for period in [97.0, 96.0 + golden] {
            assert!(part(shaken(40, period, |_| 400.3)) > 0.95);
            let swelling = |index: u32| 400.3 * (1.0 + 0.3 * (f64::from(index) / 173.0).sin());
            assert!(part(shaken(40, period, swelling)) < 0.2, "{}", part(shaken(40, period, swelling)));
        }
    }

    /// Strokes of given samples, travel and area, one after another.
    struct Strokes {
        repeats: Repeats,
        index: i32,
        position: i32,
        sum: i32,
    }

    impl Strokes {
        const CODES: u32 = 10;

        fn new() -> Self {
            let mut strokes = Self { repeats: Repeats::new(), index: 0, position: 300, sum: 0 };
            strokes.reverse();
            strokes
        }

        fn reverse(&mut self) {
            self.repeats.push(self.index as u32, self.position, self.sum, Self::CODES);
        }

        /// Its area is the sum of the positions from where it began.
        fn push(&mut self, samples: i32, travel: i32, area: i32) {
            self.sum += area + samples * self.position;
            self.index += samples;
            self.position += travel;
            self.reverse();
        }
    }

    #[test]
    fn less_than_eight_counts_are_no_stroke() {
        for (travel, is_stroke) in [(79, 0), (80, 1), (-79, 0), (-80, 1), (200, 1)] {
            let mut strokes = Strokes::new();
            strokes.push(48, travel, 1000);
            assert_eq!(strokes.repeats.strokes_and_squares(), (is_stroke, u64::from(is_stroke)), "{travel}");
        }
    }

    #[test]
    fn strokes_within_two_counts_are_of_one_length() {
        let mut strokes = Strokes::new();
        for (travel, steady) in [(100, 0), (120, 1), (141, 1), (-121, 2), (121, 3), (100, 3)] {
            strokes.push(48, travel, 1000);
            assert_eq!(strokes.repeats.steady(), steady, "{travel}");
        }
    }

    /// Of 48 samples, three may lie in another count, and one more is the width of a cell: four counts of ten codes.
    /// What lies in the half of a neighbouring cell that is nearer is the same, too.
    #[test]
    fn areas_are_the_same_within_a_cell_and_the_nearer_half_of_its_neighbours() {
        for (first, second, is_same) in [
            (1000, 1000, true),
            (1000, 1039, true),
            (1000, 1059, true),
            (1000, 1060, false),
            (1000, 980, true),
            (1000, 979, false),
            (-1000, -961, true),
            (-1000, -1020, true),
            (-1000, -1021, false),
        ] {
            let mut strokes = Strokes::new();
            strokes.push(48, 400, first);
            strokes.push(48, -400, second);
            let squares = if is_same { 4 } else { 2 };
            assert_eq!(strokes.repeats.strokes_and_squares(), (2, squares), "{first} {second}");
            // The same area in another number of samples is another stroke.
            strokes.push(47, 400, second);
            assert_eq!(strokes.repeats.strokes_and_squares(), (3, squares + 1), "{first} {second}");
        }
    }

    /// Strokes of similar lengths and areas are spread over all places, 32 to each on average, and have fingerprints of
    /// their own.
    #[test]
    fn fingerprints_are_spread_over_all_places() {
        let mut prints = std::vec::Vec::new();
        let mut used = [0; PLACES];
        for samples in 20..84 {
            for cell in -32..32 {
                prints.push(print(samples, cell));
                used[place(print(samples, cell))] += 1;
            }
        }
        assert!(used.iter().all(|times| (16..64).contains(times)), "{used:?}");
        prints.sort_unstable();
        prints.dedup();
        assert_eq!(prints.len(), 64 * 64);
    }
}
