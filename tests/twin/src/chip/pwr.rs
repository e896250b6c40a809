//! Power control (RM0440 section 6.4): boost mode and write protection of the backup domain; the rest is storage.

use crate::registers::refuse_if;
use crate::{Cycles, Modelled, Registers, Storage, Width};

registers! { u32:
    // Write access to the backup domain.
    CR1 0x00 { DBP 8 },
    // Range 1 normal mode, without boost.
    CR5 0x80 { R1MODE 8 },
}

/// The PWR registers.
#[derive(Clone, Debug)]
pub struct Pwr(Storage);

impl Default for Pwr {
    fn default() -> Self {
        // CR1 to CR4, SR1, SR2, SCR, CR5. Only range 1 is modelled: VOS does not change.
        Self(Storage::shared(&[
            (CR1, 0x200, 0x4107 | DBP),
            (0x04, 0, 0xf0),
            (0x08, 0x8000, 0xc51f),
            (0x0c, 0, 0x31f),
            (0x10, 0, 0),
            (0x14, 0, 0),
            (0x18, 0, 0),
            (CR5, R1MODE, R1MODE),
        ]))
    }
}

impl Pwr {
    /// Whether range 1 boost mode is on, in which the core may exceed 150 MHz.
    pub fn boost(&self) -> bool {
        self.0[CR5] & R1MODE == 0
    }

    /// Whether the backup domain is writable.
    pub fn backup_is_open(&self) -> bool {
        self.0[CR1] & DBP != 0
    }
}

impl Registers for Pwr {
    fn word(&mut self, register: u32, _: Cycles) -> Modelled<u32> {
        self.0.load(register)
    }

    fn write(&mut self, offset: u32, value: u32, width: Width, now: Cycles) -> Modelled {
        refuse_if(
            offset & !3 == CR1 && width == Width::Word && value >> 9 & 3 != 1,
            "PWR_CR1.VOS: only range 1 is modelled",
        )?;
        self.0.write(offset, value, width, now)
    }

    fn reset(&mut self, _: Cycles) {
        self.0.reset();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::{refuses, write};

    #[test]
    fn boost_and_backup() {
        let mut pwr = Pwr::default();
        assert!(!pwr.boost() && !pwr.backup_is_open());
        write(&mut pwr, CR5, 0, 0);
        write(&mut pwr, CR1, 0x300, 0);
        assert!(pwr.boost() && pwr.backup_is_open());
        assert_eq!(pwr.read(CR1, Width::Word, 0), Ok(0x300));
        assert!(refuses(&mut pwr, CR1, 0x400, 0), "range 2");
        pwr.reset(0);
        assert!(!pwr.boost());
    }

    #[test]
    fn fields_are_metapacs() {
        fields_agree!("PWR", "CR1", DBP);
    }
}
