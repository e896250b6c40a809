//! Debug support of the chip (RM0440 section 47.6): the device ID. The freeze bits are storage.

use crate::registers::peek;
use crate::{Cycles, Modelled, Registers, Storage, Width};

/// Category 3 devices of the G4, revision X (RM0440 47.6.1).
const IDCODE: u32 = 0x2003_6469;

/// The DBGMCU registers.
#[derive(Clone, Debug)]
pub struct Dbgmcu(Storage);

impl Default for Dbgmcu {
    fn default() -> Self {
        // IDCODE, CR, APB1FZR1, APB1FZR2, APB2FZR.
        Self(Storage::new(&[
            (0x00, IDCODE, 0),
            (0x04, 0, 0xe7),
            (0x08, 0, 0xc060_1c3f),
            (0x0c, 0, 0x2),
            (0x10, 0, 0x3c17_2800),
        ]))
    }
}

impl Registers for Dbgmcu {
    fn read(&mut self, offset: u32, width: Width, _: Cycles) -> Modelled<u32> {
        peek(&self.0, offset, width)
    }

    fn write(&mut self, offset: u32, value: u32, width: Width, _: Cycles) -> Modelled {
        self.0.write(offset, value, width)
    }

    fn reset(&mut self, _: Cycles) {
        self.0.reset();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::write;

    #[test]
    fn identity_cannot_be_changed() {
        let mut dbgmcu = Dbgmcu::default();
        write(&mut dbgmcu, 0, 0, 0);
        assert_eq!(dbgmcu.read(0, Width::Word, 0), Ok(IDCODE));
    }
}
