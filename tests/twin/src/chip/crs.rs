//! Clock recovery (RM0440 section 8.8): trims the 48 MHz oscillator by the frames of USB.
//!
//! The twin's oscillator is exact, so trimming changes nothing: each synchronisation reports success.

use crate::{Cycles, Registers, Storage, Unknown, Width};

const CR: u32 = 0x00;
const CFGR: u32 = 0x04;
const ISR: u32 = 0x08;
const ICR: u32 = 0x0c;

/// CR: the error counter runs.
const CEN: u32 = 1 << 5;
/// ISR and ICR: synchronisation done, and the pulse expected next.
const SYNCOK: u32 = 1 << 0;
const ESYNC: u32 = 1 << 3;

/// The registers.
#[derive(Clone, Debug)]
pub struct Crs {
    storage: Storage,
    flags: u32,
}

impl Default for Crs {
    fn default() -> Self {
        Self { storage: Storage::new(&[(CR, 0x4000, 0x7fef), (CFGR, 0x2022_bb7f, 0xb7ff_ffff)]), flags: 0 }
    }
}

impl Crs {
    /// A pulse of the source arrived, which for USB is the start of a frame.
    pub fn synchronise(&mut self) {
        if self.storage.get(CR) & CEN != 0 {
            self.flags |= SYNCOK | ESYNC;
        }
    }

    /// The level of the interrupt line.
    pub fn irq(&self) -> bool {
        self.flags & self.storage.get(CR) & 0xf != 0
    }
}

impl Registers for Crs {
    fn read(&mut self, offset: u32, width: Width, _: Cycles) -> Result<u32, Unknown> {
        match offset & !3 {
            ISR => Ok(width.part(self.flags, offset)),
            ICR => Ok(0),
            // Both are read so that some of their bits can be changed.
            CR | CFGR => Ok(width.part(self.storage.get(offset & !3), offset)),
            _ => Err(Unknown::REGISTER),
        }
    }

    fn write(&mut self, offset: u32, value: u32, width: Width, _: Cycles) -> Result<(), Unknown> {
        match offset & !3 {
            ICR => self.flags &= !width.replace(0, offset, value),
            CR | CFGR => self.storage.write(offset, value, width)?,
            _ => return Err(Unknown::REGISTER),
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

    #[test]
    fn a_frame_is_a_synchronisation_once_it_is_on() {
        let mut crs = Crs::default();
        crs.synchronise();
        assert_eq!(crs.read(ISR, Width::Word, 0), Ok(0));
        crs.write(CR, 0x4000 | CEN | 1, Width::Word, 0).expect("known");
        crs.synchronise();
        assert!(crs.irq());
        crs.write(ICR, SYNCOK | ESYNC, Width::Word, 0).expect("known");
        assert!(!crs.irq());
    }

    #[test]
    fn fields_are_metapacs() {
        use crate::metapac::fields_agree;

        fields_agree("CRS", "CR", &[("CEN", CEN)]);
        fields_agree("CRS", "ISR", &[("SYNCOKF", SYNCOK), ("ESYNCF", ESYNC)]);
        fields_agree("CRS", "ICR", &[("SYNCOKC", SYNCOK), ("ESYNCC", ESYNC)]);
    }
}
