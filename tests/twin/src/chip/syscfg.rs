//! System configuration (RM0440 section 10.2): the port of each external interrupt line, and MEM_MODE; the rest is
//! storage.

use crate::registers::refuse_if;
use crate::{Cycles, Modelled, Registers, Storage, Width};

const MEMRMP: u32 = 0x00;
const EXTICR1: u32 = 0x08;

/// The SYSCFG registers.
#[derive(Clone, Debug)]
pub struct Syscfg {
    storage: Storage,
    /// Whether MEM_MODE survives a software reset. We found no document that says so, but firmware must not loop if it
    /// does.
    pub keeps_mem_mode: bool,
}

impl Default for Syscfg {
    fn default() -> Self {
        // Programs read MEMRMP for the boot mode, and EXTICR1 to EXTICR4 to change one of four lines.
        let port = |number: u32| (EXTICR1 + 4 * number, 0, 0xffff);
        let shared = Storage::shared(&[(MEMRMP, 0, 7), port(0), port(1), port(2), port(3)]);
        // CFGR1, CFGR2.
        let others = Storage::new(&[(0x04, 0x7c00_0001, 0xfcff_0300), (0x1c, 0, 0xf)]);
        Self { storage: shared.and(others), keeps_mem_mode: false }
    }
}

impl Syscfg {
    /// Restores MEM_MODE after a software reset, if it survives; `mem_mode` is the value before.
    pub fn restore(&mut self, mem_mode: u32) {
        if self.keeps_mem_mode {
            self.storage[MEMRMP] = mem_mode;
        }
    }

    /// MEM_MODE, which selects the memory at address 0: 0 is flash, 1 the ROM.
    pub fn mem_mode(&self) -> u32 {
        self.storage[MEMRMP] & 7
    }

    /// Port (A is 0) whose pin number `line` drives that EXTI line.
    pub fn exti_port(&self, line: usize) -> usize {
        (self.storage[EXTICR1 + 4 * (line as u32 / 4)] >> (4 * (line % 4)) & 0xf) as usize
    }
}

impl Registers for Syscfg {
    fn word(&mut self, register: u32, _: Cycles) -> Modelled<u32> {
        self.storage.load(register)
    }

    fn write(&mut self, offset: u32, value: u32, width: Width, now: Cycles) -> Modelled {
        // The ROM's boot loader must be at address 0; other memories cannot be mapped there in the twin.
        refuse_if(
            offset & !3 == MEMRMP && value & 7 > 1,
            "MEM_MODE: only flash and system memory are modelled at address 0",
        )?;
        self.storage.write(offset, value, width, now)
    }

    fn reset(&mut self, _: Cycles) {
        self.storage.reset();
    }

    fn unwritten_reads(&self) -> Vec<u32> {
        self.storage.unwritten_reads()
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
