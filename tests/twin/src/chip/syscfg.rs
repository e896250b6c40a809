//! System configuration (RM0440 section 10.2): the port of each external interrupt line, and MEM_MODE; the rest is
//! storage.

use crate::registers::{peek, refuse_if};
use crate::{Cycles, Modelled, Registers, Storage, Width};

const MEMRMP: u32 = 0x00;
const EXTICR1: u32 = 0x08;

/// The SYSCFG registers.
#[derive(Clone, Debug)]
pub struct Syscfg(Storage, Kept);

/// Whether MEM_MODE survives a software reset. We found no document that says so, but firmware must not loop if it
/// does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kept {
    /// MEM_MODE is reset.
    #[default]
    Nothing,
    /// MEM_MODE is kept.
    MemMode,
}

impl Default for Syscfg {
    fn default() -> Self {
        // MEMRMP, CFGR1, EXTICR1..4, CFGR2.
        let plain = |offset, writable| (offset, 0, writable);
        Self(
            Storage::new(&[
                plain(MEMRMP, 7),
                (0x04, 0x7c00_0001, 0xfcff_0300),
                plain(0x08, 0xffff),
                plain(0x0c, 0xffff),
                plain(0x10, 0xffff),
                plain(0x14, 0xffff),
                plain(0x1c, 0xf),
            ]),
            Kept::default(),
        )
    }
}

impl Syscfg {
    /// Sets whether MEM_MODE survives a software reset from now on.
    pub fn keep(&mut self, kept: Kept) {
        self.1 = kept;
    }

    /// Restores MEM_MODE after a software reset, if it survives; `mem_mode` is the value before.
    pub fn restore(&mut self, mem_mode: u32) {
        if self.1 == Kept::MemMode {
            // A value that was in use is accepted.
            let _ = self.0.write(MEMRMP, mem_mode, Width::Word);
        }
    }

    /// MEM_MODE, which selects the memory at address 0: 0 is flash, 1 the ROM.
    pub fn mem_mode(&self) -> u32 {
        self.0.get(MEMRMP) & 7
    }

    /// Port (A is 0) whose pin number `line` drives that EXTI line.
    pub fn exti_port(&self, line: usize) -> usize {
        (self.0.get(EXTICR1 + 4 * (line as u32 / 4)) >> (4 * (line % 4)) & 0xf) as usize
    }
}

impl Registers for Syscfg {
    fn read(&mut self, offset: u32, width: Width, _: Cycles) -> Modelled<u32> {
        match offset & !3 {
            // Programs read MEMRMP for the boot mode, and EXTICR1 to EXTICR4 to change one of four lines.
            MEMRMP | 0x08..=0x14 => peek(&self.0, offset, width),
            _ => self.0.read(offset, width),
        }
    }

    fn write(&mut self, offset: u32, value: u32, width: Width, _: Cycles) -> Modelled {
        // The ROM's boot loader must be at address 0; other memories cannot be mapped there in the twin.
        refuse_if(
            offset & !3 == MEMRMP && value & 7 > 1,
            "MEM_MODE: only flash and system memory are modelled at address 0",
        )?;
        self.0.write(offset, value, width)
    }

    fn reset(&mut self, _: Cycles) {
        self.0.reset();
    }

    fn unwritten_reads(&self) -> Vec<u32> {
        self.0.unwritten_reads()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::{refuses, write};

    #[test]
    fn lines_choose_their_port() {
        let mut syscfg = Syscfg::default();
        write(&mut syscfg, 0x10, 1 << 8, 0);
        assert_eq!((syscfg.exti_port(10), syscfg.exti_port(9)), (1, 0));
        assert!(refuses(&mut syscfg, MEMRMP, 3, 0), "RAM at address 0");
    }

    #[test]
    fn fields_are_metapacs() {
        fields_agree!("SYSCFG", "MEMRMP", MEM_MODE = 7u32);
        // Four lines per register, four bits each.
        fields_agree!("SYSCFG", "EXTICR", EXTI = 0xfu32);
    }
}
