//! Backup registers (RM0440 section 36.6): 32 words that survive a reset but not a loss of power. Tamper detection is
//! refused.

use crate::{Cycles, Modelled, Registers, Storage, Width};

const BACKUP: std::ops::RangeInclusive<u32> = 0x100..=0x17c;

/// The TAMP registers.
#[derive(Clone, Debug)]
pub struct Tamp(Storage);

impl Default for Tamp {
    fn default() -> Self {
        // CR1 starts with the internal tampers enabled. They can be disabled, which has no other effect.
        let control = Storage::new(&[(0x00, 0xffff_0000, 0x3f_0007)]);
        // Programs read the backup registers for the values of the previous run.
        let backup: Vec<_> = BACKUP.step_by(4).map(|offset| (offset, 0, u32::MAX)).collect();
        Self(control.and(Storage::shared(&backup)))
    }
}

impl Tamp {
    /// The backup domain loses power.
    pub fn lose_power(&mut self) {
        self.0.reset();
    }
}

impl Registers for Tamp {
    fn word(&mut self, register: u32, _: Cycles) -> Modelled<u32> {
        self.0.load(register)
    }

    fn write(&mut self, offset: u32, value: u32, width: Width, now: Cycles) -> Modelled {
        self.0.write(offset, value, width, now)
    }

    fn reset(&mut self, _: Cycles) {}

    fn unwritten_reads(&self) -> Vec<u32> {
        self.0.unwritten_reads()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::write;

    #[test]
    fn outlives_a_reset_only() {
        let mut tamp = Tamp::default();
        write(&mut tamp, 0x104, 7, 0);
        tamp.reset(0);
        assert_eq!(tamp.read(0x104, Width::Word, 0), Ok(7));
        tamp.lose_power();
        assert_eq!(tamp.read(0x104, Width::Word, 0), Ok(0));
        assert!(tamp.read(0x180, Width::Word, 0).is_err());
    }
}
