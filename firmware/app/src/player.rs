//! Turns knots into outputs, step by step: the same code on the board that plays and on the host that evaluates.
//!
//! Input: [`Knot`]s, one per 64 steps. Output: [`Step`]s, each with two 12-bit codes and a count. Integers only.
//! Voltages are linear from knot to knot; the fraction below one code is carried to the next step, so the mean of 64
//! steps is right to a 64th of a code. Counts are linear too, rounded down, with at most one edge per step.

use inerter_wire::Knot;

/// Fraction bits of a voltage between knots: sixteenths, and 64 steps.
const VOLTAGE_BITS: u32 = 4 + Knot::STEPS.ilog2();
/// Fraction bits of a count between knots: 256ths, and 64 steps.
const COUNT_BITS: u32 = 8 + Knot::STEPS.ilog2();
/// Largest code.
const GREATEST: u32 = 4095;

/// The outputs during one step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Step {
    /// Code of the force, 0 to 4095.
    pub force: u16,
    /// Code of the terminal displacement, 0 to 4095.
    pub terminal: u16,
    /// Count since the beginning; the outputs are its two lowest bits as a quadrature.
    pub count: i32,
}

/// One voltage between knots.
#[derive(Clone, Copy, Debug)]
struct Voltage {
    /// In units of 2^-[`VOLTAGE_BITS`] codes.
    now: i32,
    /// Change per step.
    slope: i32,
    /// Code of the next knot, in sixteenths.
    to: u16,
    carry: u32,
}

impl Voltage {
    const fn new() -> Self {
        Self { now: (Knot::MIDDLE as i32) << Knot::STEPS.ilog2(), slope: 0, to: Knot::MIDDLE, carry: 0 }
    }

    fn head_for(&mut self, to: u16) {
        self.slope = i32::from(to) - i32::from(self.to);
        self.to = to;
    }

    fn step(&mut self) -> u16 {
        self.now += self.slope;
        let whole = self.now as u32 + self.carry;
        self.carry = whole & ((1 << VOLTAGE_BITS) - 1);
        (whole >> VOLTAGE_BITS).min(GREATEST) as u16
    }
}

/// The outputs between two knots.
#[derive(Clone, Copy, Debug)]
pub struct Player {
    force: Voltage,
    terminal: Voltage,
    /// In units of 2^-[`COUNT_BITS`], wrapping.
    count: i64,
    advance: i16,
    /// Steps left until the knot.
    left: u32,
}

impl Player {
    /// At mid-range and count 0, at rest.
    pub const fn new() -> Self {
        Self { force: Voltage::new(), terminal: Voltage::new(), count: 0, advance: 0, left: 0 }
    }

    /// Whether the outputs rest at the last knot.
    pub fn stands(&self) -> bool {
        self.left == 0
    }

    /// Moves towards the next knot, from the previous one.
    pub fn head_for(&mut self, knot: &Knot) {
        self.force.head_for(knot.force);
        self.terminal.head_for(knot.terminal);
        self.advance = knot.advance;
        self.left = Knot::STEPS;
    }

    /// The next outputs; they hold if there is no further knot.
    pub fn step(&mut self) -> Step {
        if self.left == 0 {
            (self.force.slope, self.terminal.slope, self.advance) = (0, 0, 0);
        }
        self.left = self.left.saturating_sub(1);
        self.count = self.count.wrapping_add(i64::from(self.advance));
        Step { force: self.force.step(), terminal: self.terminal.step(), count: (self.count >> COUNT_BITS) as i32 }
    }
}

impl Default for Player {
    fn default() -> Self {
        Self::new()
    }
}

/// Levels of the encoder's A and B at a count: A leads while the count increases.
pub const fn quadrature(count: i32) -> (bool, bool) {
    let quarter = count & 3;
    (quarter == 1 || quarter == 2, quarter >= 2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::vec::Vec;

    fn played(knots: &[Knot]) -> Vec<Step> {
        let mut player = Player::new();
        let mut steps = Vec::new();
        for knot in knots {
            assert!(player.stands());
            player.head_for(knot);
            steps.extend((0..Knot::STEPS).map(|_| player.step()));
        }
        steps
    }

    #[test]
    fn voltages_go_straight_and_their_mean_is_right_to_a_64th_of_a_code() {
        let at = |force| Knot { force, terminal: 0xFFFF, advance: 0 };
        let steps = played(&[at(0), at(0), at(1000 * 16), at(1000 * 16 + 5)]);
        let sum = |part: usize| steps[part * 64..][..64].iter().map(|step| u32::from(step.force)).sum::<u32>();
        assert_eq!((steps[63].force, sum(1)), (0, 0));
        assert_eq!(steps[64 * 3 - 1].force, 1000);
        // The mean of a straight line from 0 to 1000, sampled at the ends of 64 steps.
        assert!(sum(2).abs_diff(500 * 64 + 500) <= 1, "{}", sum(2));
        // From there by 5 sixteenths: 2.5 of them on average, 10 codes in 64 steps.
        assert!(sum(3).abs_diff(1000 * 64 + 10) <= 1, "{}", sum(3));
        assert!(steps.iter().all(|step| step.terminal <= 4095));
        assert_eq!(steps[255].terminal, 4095);
    }

    #[test]
    fn a_step_has_one_edge_at_most_and_none_is_lost() {
        let by = |advance| Knot { advance, ..Knot::default() };
        for advance in [Knot::MAX_ADVANCE, -Knot::MAX_ADVANCE, 1, -1, 255, -4000, 0] {
            let knots = [by(advance); 300];
            let steps = played(&knots);
            for pair in steps.windows(2) {
                assert!(pair[0].count.abs_diff(pair[1].count) <= 1);
            }
            assert_eq!(steps.last().map(|step| step.count), Some((300 * i32::from(advance)) >> 8), "{advance}");
        }
    }

    #[test]
    fn what_has_no_knot_stands() {
        let mut player = Player::new();
        assert_eq!(player.step(), Step { force: 2048, terminal: 2048, count: 0 });
        player.head_for(&Knot { force: 100 * 16, terminal: 200 * 16, advance: 640 });
        assert!(!player.stands());
        let last = (0..64).map(|_| player.step()).last();
        assert_eq!(last, Some(Step { force: 100, terminal: 200, count: 2 }));
        for _ in 0..200 {
            assert_eq!(player.step(), Step { force: 100, terminal: 200, count: 2 });
        }
    }

    #[test]
    fn one_line_changes_at_each_count() {
        let levels = |count| {
            let (a, b) = quadrature(count);
            (u8::from(a), u8::from(b))
        };
        assert_eq!([0, 1, 2, 3, 4].map(levels), [(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)]);
        for count in -9..9 {
            let ((a, b), (c, d)) = (levels(count), levels(count + 1));
            assert_eq!((a ^ c) + (b ^ d), 1, "{count}");
        }
    }
}
