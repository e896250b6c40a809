//! Pairs force and position of the same moment, to whole samples; the kernels correct the remaining skew
//! (docs/THEORY.md, 7).

use crate::backlash::flanks::Newest;

/// Samples that can wait: 5 ms at 5 kHz, rounded up to a power of two.
const LONGEST: usize = 32;

/// Delays the channel that is early: position and terminal, or the force and whether it may be used.
#[derive(Clone, Debug)]
pub(crate) struct Alignment {
    waiting: [(i32, i32); LONGEST],
    head: usize,
    /// Number of coming samples without another half after a discontinuity, plus the first that has one.
    unpaired: u8,
}

impl Alignment {
    pub const fn new() -> Self {
        Self { waiting: [(0, 0); LONGEST], head: 0, unpaired: 0 }
    }

    /// Pairs the force with the position of `late` samples ago, because it is that late; if `late` is negative, the
    /// position with the force of `-late` samples ago. At a discontinuity, such as the first sample, pairing begins
    /// anew: until the first pair is complete, the delayed half keeps its value of the discontinuity.
    #[cold]
    #[inline(never)]
    pub fn align(&mut self, late: i8, mut newest: Newest) -> Newest {
        let samples = late.unsigned_abs();
        let slot = self.head % LONGEST;
        let before = self.head.wrapping_sub(usize::from(samples)) % LONGEST;
        self.head = self.head.wrapping_add(1);
        let waits = if late > 0 { (newest.position, newest.terminal) } else { (newest.force, i32::from(newest.good)) };
        self.waiting[slot] = waits;
        if newest.broken {
            self.waiting.fill(waits);
            self.unpaired = samples + 1;
        }
        let delayed = self.waiting[before];
        if late > 0 {
            (newest.position, newest.terminal) = delayed;
        } else {
            (newest.force, newest.good) = (delayed.0, delayed.1 != 0);
        }
        newest.broken = self.unpaired > 0;
        self.unpaired = self.unpaired.saturating_sub(1);
        newest
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    extern crate std;
    use std::vec::Vec;

    fn aligned(late: i8, jump_at: i32) -> Vec<([i32; 3], bool)> {
        let mut alignment = Alignment::new();
        let sample = |n: i32| {
            let moment = if n < jump_at { n } else { n + 1000 };
            let newest = Newest {
                index: moment as u32,
                position: moment,
                force: moment - i32::from(late),
                terminal: moment,
                good: true,
                broken: n == 0 || n == jump_at,
                offset: 0,
            };
            let newest = alignment.align(late, newest);
            ([newest.position, newest.terminal, newest.force], newest.broken)
        };
        (0..40).map(sample).collect()
    }

    #[test]
    fn what_is_of_one_moment_comes_together_and_nothing_is_paired_across_a_jump() {
        for late in [-24, -3, -1, 0, 1, 2, 24] {
            let samples = aligned(late, 30);
            let width = usize::from(late.unsigned_abs());
            let broken = |n: usize| n <= width || (30..=30 + width).contains(&n);
            for (n, ([position, terminal, force], is_broken)) in samples.into_iter().enumerate() {
                assert_eq!(is_broken, broken(n), "{late}, {n}");
                assert_eq!(position, terminal, "{late}, {n}");
                assert!(is_broken || position == force, "{late}, {n}: {position} {force}");
            }
        }
    }

    /// Every third force may not be used, wherever it is paired.
    #[test]
    fn whether_a_force_may_be_used_stays_with_it() {
        for late in [-24, -1, 0, 1, 24] {
            let mut alignment = Alignment::new();
            for n in 0..80_i32 {
                let newest = Newest {
                    index: n as u32,
                    position: 1000 + n,
                    force: n,
                    terminal: -n,
                    good: n % 3 != 0,
                    broken: n == 0,
                    offset: 7,
                };
                let paired = alignment.align(late, newest);
                assert_eq!(paired.good, paired.force % 3 != 0, "{late}, {n}");
                assert_eq!((paired.index, paired.offset), (n as u32, 7));
            }
        }
    }
}
