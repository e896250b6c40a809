//! The self-test's wires from outputs of the chip to its inputs, which replace the world, and injected faults.

use super::dmamux::Request;
use super::pin::Pin;
use crate::Cycles;

/// Voltage of an input without a wire \[V\].
pub(super) const FLOATING_V: f64 = 0.6;

/// An analogue output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    /// PA4, DAC1.
    One,
    /// PA6, DAC2.
    Two,
}

/// Source of each input's wire; none if the wire is missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Jumpers {
    /// Source of the force input.
    pub force: Option<Output>,
    /// Source of the terminal input.
    pub terminal: Option<Output>,
    /// Source of encoder phase A.
    pub a: Option<Pin>,
    /// Source of encoder phase B.
    pub b: Option<Pin>,
}

impl Jumpers {
    /// Correct wiring, as in docs/HARDWARE.md.
    pub const RIGHT: Self = Self {
        force: Some(Output::One),
        terminal: Some(Output::Two),
        a: Some(Pin::new('B', 1)),
        b: Some(Pin::new('B', 2)),
    };
}

/// Injected faults of the chip or its program.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Planted {
    /// Delay of ADC1 and ADC2 after their trigger \[cycles\].
    pub late: [Cycles; 2],
    /// The request to lose, and the time from which its first occurrence is lost \[s since power was applied\].
    pub lost: Option<(Request, f64)>,
    /// The encoder counter counts only every other edge.
    pub half_counts: bool,
    /// The encoder counter misses the edge that would take it to this count for the first time.
    pub lost_edge: Option<u32>,
}

/// The encoder that two wires simulate.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Wired {
    levels: (bool, bool),
    pub(super) count: u32,
}

impl Wired {
    /// Applies the new levels. If both change at once, the direction is unknown and nothing is counted.
    pub(super) fn follow(&mut self, levels: (bool, bool)) {
        let quarter = |(a, b): (bool, bool)| if b { 3 - u32::from(a) } else { u32::from(a) };
        self.count = match (quarter(levels) + 4 - quarter(self.levels)) % 4 {
            1 => self.count.wrapping_add(1),
            3 => self.count.wrapping_sub(1),
            _ => self.count,
        };
        self.levels = levels;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_count_up_where_a_leads_and_both_at_once_count_nothing() {
        let mut wired = Wired::default();
        let (low, a, both, b) = ((false, false), (true, false), (true, true), (false, true));
        let mut seen = Vec::new();
        for levels in [a, both, b, low, b, b, both, a, low, both, low] {
            wired.follow(levels);
            seen.push(wired.count as i32);
        }
        assert_eq!(seen, [1, 2, 3, 4, 3, 3, 2, 1, 0, 0, 0]);
    }
}
