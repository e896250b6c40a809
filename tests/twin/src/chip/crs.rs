//! Clock recovery system (RM0440 section 8.8): trims HSI48 by the USB SOF packets.
//!
//! The twin's oscillator is exact, so trimming changes nothing and each synchronisation reports success.

use crate::{Cycles, Modelled, Registers, Storage, Width};

registers! { u32:
    // Frequency error counter enable.
    CR 0x00 { CEN 5 },
    CFGR 0x04,
    // Synchronisation OK, and expected synchronisation; the same bits in ICR.
    ISR 0x08 { SYNCOK 0, ESYNC 3 },
    ICR 0x0c,
}

/// The CRS registers.
#[derive(Clone, Debug)]
pub struct Crs {
    storage: Storage,
    flags: u32,
}

impl Default for Crs {
    fn default() -> Self {
        Self { storage: Storage::shared(&[(CR, 0x4000, 0x7fef), (CFGR, 0x2022_bb7f, 0xb7ff_ffff)]), flags: 0 }
    }
}

impl Crs {
    /// Processes a pulse of the synchronisation source, which for USB is an SOF packet.
    pub fn synchronise(&mut self) {
        if self.storage[CR] & CEN != 0 {
            self.flags |= SYNCOK | ESYNC;
        }
    }

    /// Level of the interrupt request.
    pub fn irq(&self) -> bool {
        self.flags & self.storage[CR] & 0xf != 0
    }
}

impl Registers for Crs {
    fn word(&mut self, register: u32, _: Cycles) -> Modelled<u32> {
        match register {
            ISR => Ok(self.flags),
            ICR => Ok(0),
            _ => self.storage.load(register),
        }
    }

    fn write(&mut self, offset: u32, value: u32, width: Width, now: Cycles) -> Modelled {
        match offset & !3 {
            ICR => self.flags &= !width.replace(0, offset, value),
            _ => return self.storage.write(offset, value, width, now),
        }
        Ok(())
    }

    fn reset(&mut self, _: Cycles) {
        self.storage.reset();
        self.flags = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::write;

    #[test]
    fn a_frame_is_a_synchronisation_once_it_is_on() {
        let mut crs = Crs::default();
        crs.synchronise();
        assert_eq!(crs.read(ISR, Width::Word, 0), Ok(0));
        write(&mut crs, CR, 0x4000 | CEN | 1, 0);
        crs.synchronise();
        assert!(crs.irq());
        write(&mut crs, ICR, SYNCOK | ESYNC, 0);
        assert!(!crs.irq());
    }

    #[test]
    fn fields_are_metapacs() {
        fields_agree!("CRS", "CR", CEN);
        fields_agree!("CRS", "ISR", SYNCOKF = SYNCOK, ESYNCF = ESYNC);
        fields_agree!("CRS", "ICR", SYNCOKC = SYNCOK, ESYNCC = ESYNC);
    }
}
