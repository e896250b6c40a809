//! The self-test's wires from outputs of the chip to its inputs, in place of the world, and faults that a test plants.

use super::{Chip, Pin};
use crate::chip::dmamux::Request;
use crate::chip::gpio::Mode;
use crate::{Cycles, Unknown};

/// Voltage of an input to which no wire leads \[V\].
const FLOATING_V: f64 = 0.6;

/// An output of volts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    /// PA4, DAC1.
    One,
    /// PA6, DAC2.
    Two,
}

/// Where each input's wire comes from; nothing where it is missing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Jumpers {
    /// The force input's.
    pub force: Option<Output>,
    /// The terminal input's.
    pub terminal: Option<Output>,
    /// Phase A's.
    pub a: Option<Pin>,
    /// Phase B's.
    pub b: Option<Pin>,
}

impl Jumpers {
    /// As docs/HARDWARE.md has them.
    pub const RIGHT: Self = Self {
        force: Some(Output::One),
        terminal: Some(Output::Two),
        a: Some(Pin::new('B', 1)),
        b: Some(Pin::new('B', 2)),
    };
}

/// What is wrong with the chip or its program, on purpose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Planted {
    /// By how much ADC1 and ADC2 start after their trigger \[cycles\].
    pub late: [Cycles; 2],
    /// The first such request after this moment comes to nothing \[s since power was applied\].
    pub lost: Option<(Request, f64)>,
    /// The encoder's counter takes every other edge.
    pub half_counts: bool,
}

/// The encoder that two wires are.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Wired {
    levels: (bool, bool),
    count: u32,
}

impl Wired {
    /// The levels are these now. Both at once tell no direction.
    fn follow(&mut self, levels: (bool, bool)) {
        let quarter = |(a, b): (bool, bool)| if b { 3 - u32::from(a) } else { u32::from(a) };
        self.count = match (quarter(levels) + 4 - quarter(self.levels)) % 4 {
            1 => self.count.wrapping_add(1),
            3 => self.count.wrapping_sub(1),
            _ => self.count,
        };
        self.levels = levels;
    }
}

impl Chip {
    /// The wires lead what the outputs do now to the encoder's inputs.
    pub(super) fn follow_jumpers(&mut self) {
        let Some(jumpers) = self.jumpers else { return };
        // The inputs are pulled up.
        let level = |pin: Option<Pin>| pin.is_none_or(|pin| self.pin_mode(pin) != Mode::Output || self.pin_output(pin));
        let levels = (level(jumpers.a), level(jumpers.b));
        self.wired.follow(levels);
    }

    /// Where the encoder is, whether it is the world's or made of wires.
    pub(super) fn encoder_count(&mut self, time_s: f64) -> u32 {
        let count = if self.jumpers.is_some() { self.wired.count } else { self.world.encoder(time_s) };
        if self.planted.half_counts { (count as i32 >> 1) as u32 } else { count }
    }

    /// Voltage at the force's or the terminal's pin \[V\].
    pub(super) fn input_volts(&mut self, pin: Pin, at: Cycles, time_s: f64) -> Result<f64, Unknown> {
        let (is_force, is_terminal) = (pin == self.board.force, pin == self.board.terminal);
        match (self.jumpers, is_force, is_terminal) {
            (Some(jumpers), true, _) => Ok(self.wire_volts(jumpers.force, at)),
            (Some(jumpers), _, true) => Ok(self.wire_volts(jumpers.terminal, at)),
            (None, true, _) => Ok(self.world.force_volts(time_s)),
            (None, _, true) => Ok(self.world.terminal_volts(time_s)),
            _ => Err(Unknown { what: "a conversion of a pin to which nothing is connected" }),
        }
    }

    fn wire_volts(&self, from: Option<Output>, at: Cycles) -> f64 {
        let dac = from.map(|output| &self.dac[output as usize]);
        dac.and_then(|dac| dac.volts(at)).unwrap_or(FLOATING_V)
    }

    /// Whether this request is the one that is to come to nothing.
    pub(super) fn loses(&mut self, request: Request, now: Cycles) -> bool {
        let lost = self.planted.lost.is_some_and(|(which, after_s)| which == request && self.seconds(now) >= after_s);
        if lost {
            self.planted.lost = None;
        }
        lost
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
