//! Extended interrupts (RM0440 section 15.5): edges of pins and of internal lines become pending requests.
//!
//! Lines 0 to 15 are pins (SYSCFG selects the port), 16 is the PVD, 18 the USB wake-up. Event masks (EMR) are storage,
//! as the twin has no sleep mode that needs them.

use crate::{Cycles, Modelled, Registers, Storage, Width};

registers! { u32:
    IMR1 0x00,
    EMR1 0x04,
    RTSR1 0x08,
    FTSR1 0x0c,
    SWIER1 0x10,
    PR1 0x14,
    IMR2 0x20,
    EMR2 0x24,
}

/// The controller.
#[derive(Clone, Debug)]
pub struct Exti {
    storage: Storage,
    pending: u32,
}

impl Default for Exti {
    fn default() -> Self {
        // All users of the lines share these registers, and each changes one bit.
        let shared = Storage::shared(&[
            (IMR1, 0x1f84_0000, u32::MAX),
            (EMR1, 0, u32::MAX),
            (RTSR1, 0, u32::MAX),
            (FTSR1, 0, u32::MAX),
        ]);
        let others = Storage::new(&[(SWIER1, 0, u32::MAX), (IMR2, 0xffff_ff3c, u32::MAX), (EMR2, 0, u32::MAX)]);
        Self { storage: shared.and(others), pending: 0 }
    }
}

impl Exti {
    /// Processes an edge on a line.
    pub fn edge(&mut self, line: usize, rising: bool) {
        let trigger = self.storage[if rising { RTSR1 } else { FTSR1 }];
        self.pending |= trigger & 1 << line;
    }

    /// Whether an unmasked request is pending on any of these lines (bit mask).
    pub fn requests(&self, lines: u32) -> bool {
        self.pending & self.storage[IMR1] & lines != 0
    }

    /// Whether a direct line, which has no pending bit, is unmasked.
    pub fn unmasked(&self, line: usize) -> bool {
        self.storage[IMR1] >> line & 1 != 0
    }
}

impl Registers for Exti {
    fn word(&mut self, register: u32, _: Cycles) -> Modelled<u32> {
        if register == PR1 { Ok(self.pending) } else { self.storage.load(register) }
    }

    fn write(&mut self, offset: u32, value: u32, width: Width, now: Cycles) -> Modelled {
        match offset & !3 {
            PR1 => self.pending &= !width.replace(0, offset, value),
            SWIER1 => self.pending |= width.replace(0, offset, value) & self.storage[IMR1],
            _ => return self.storage.write(offset, value, width, now),
        }
        Ok(())
    }

    fn reset(&mut self, _: Cycles) {
        self.storage.reset();
        self.pending = 0;
    }

    fn unwritten_reads(&self) -> Vec<u32> {
        self.storage.unwritten_reads()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::write;

    #[test]
    fn only_the_chosen_edge_is_pending_until_it_is_cleared() {
        let mut exti = Exti::default();
        write(&mut exti, FTSR1, 1 << 10, 0);
        exti.edge(10, true);
        assert_eq!(exti.read(PR1, Width::Word, 0), Ok(0));
        exti.edge(10, false);
        assert_eq!(exti.read(PR1, Width::Word, 0), Ok(1 << 10));
        assert!(!exti.requests(0xfc00), "masked");
        write(&mut exti, IMR1, 1 << 10, 0);
        assert!(exti.requests(0xfc00) && !exti.requests(0x3e0));
        write(&mut exti, PR1, 1 << 10, 0);
        assert!(!exti.requests(0xfc00));
    }

    #[test]
    fn software_raises_an_unmasked_line() {
        let mut exti = Exti::default();
        write(&mut exti, SWIER1, 3, 0);
        assert!(!exti.requests(3));
        write(&mut exti, IMR1, 1, 0);
        write(&mut exti, SWIER1, 3, 0);
        assert!(exti.requests(1) && !exti.requests(2));
    }
}
