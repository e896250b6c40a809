//! System configuration (RM0440 section 10.2): which port an external interrupt line listens to; the rest is storage.

use crate::{Cycles, Registers, Storage, Unknown, Width};

const MEMRMP: u32 = 0x00;
const EXTICR1: u32 = 0x08;

/// The registers.
#[derive(Clone, Debug)]
pub struct Syscfg(Storage, Kept);

/// Whether MEM_MODE outlives a reset by software: nothing that we read says that it does, and firmware must not go in circles
/// where it does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kept {
    /// It is gone.
    #[default]
    Nothing,
    /// It stays.
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
    /// What outlives a reset by software from now on.
    pub fn keep(&mut self, kept: Kept) {
        self.1 = kept;
    }

    /// After a reset by software, puts back what outlives it: MEM_MODE as it was before.
    pub fn restore(&mut self, mem_mode: u32) {
        if self.1 == Kept::MemMode {
            // A mode that was in use is one that it knows.
            let _ = self.0.write(MEMRMP, mem_mode, Width::Word);
        }
    }

    /// What lies at address 0: 0 is flash, 1 the ROM.
    pub fn mem_mode(&self) -> u32 {
        self.0.get(MEMRMP) & 7
    }

    /// The port (A is 0) whose pin of this number is external interrupt line of the same number.
    pub fn exti_port(&self, line: usize) -> usize {
        (self.0.get(EXTICR1 + 4 * (line as u32 / 4)) >> (4 * (line % 4)) & 0xf) as usize
    }
}

impl Registers for Syscfg {
    fn read(&mut self, offset: u32, width: Width, _: Cycles) -> Result<u32, Unknown> {
        match offset & !3 {
            // Says what the start was; the others are shared by four lines each.
            MEMRMP | 0x08..=0x14 => Ok(width.part(self.0.get(offset & !3), offset)),
            _ => self.0.read(offset, width),
        }
    }

    fn write(&mut self, offset: u32, value: u32, width: Width, _: Cycles) -> Result<(), Unknown> {
        // The ROM's boot loader wants address 0 for itself; nothing else is there in the twin.
        if offset & !3 == MEMRMP && value & 7 > 1 {
            return Err(Unknown { what: "at address 0 there is flash or the ROM" });
        }
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

    #[test]
    fn lines_choose_their_port() {
        let mut syscfg = Syscfg::default();
        syscfg.write(0x10, 1 << 8, Width::Word, 0).expect("known");
        assert_eq!((syscfg.exti_port(10), syscfg.exti_port(9)), (1, 0));
        assert!(syscfg.write(MEMRMP, 3, Width::Word, 0).is_err(), "RAM at address 0");
    }

    #[test]
    fn fields_are_metapacs() {
        use crate::metapac::fields_agree;

        fields_agree("SYSCFG", "MEMRMP", &[("MEM_MODE", 7u32)]);
        // Four lines a register, four bits each.
        fields_agree("SYSCFG", "EXTICR", &[("EXTI", 0xfu32)]);
    }
}
