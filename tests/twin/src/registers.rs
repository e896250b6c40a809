//! A peripheral as seen from the bus: its registers, and the time of its next event.

use crate::chip::clocks::{Clocks, Cycles};
use std::ops::{Index, IndexMut};

/// Width of a bus access.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Width {
    /// 8 bits.
    Byte = 1,
    /// 16 bits.
    Half = 2,
    /// 32 bits.
    Word = 4,
}

impl Width {
    /// The width for this number of bytes; none if the bus has no such access.
    pub const fn of(bytes: usize) -> Option<Self> {
        match bytes {
            1 => Some(Self::Byte),
            2 => Some(Self::Half),
            4 => Some(Self::Word),
            _ => None,
        }
    }

    /// Number of bytes: 1, 2 or 4.
    pub const fn bytes(self) -> u32 {
        self as u32
    }

    /// A mask of the bits of the access.
    pub const fn mask(self) -> u32 {
        u32::MAX >> (32 - 8 * self.bytes())
    }

    /// The part of a register's word that a read at this offset returns.
    pub const fn part(self, word: u32, offset: u32) -> u32 {
        (word >> (8 * (offset & 3))) & self.mask()
    }

    /// A register's word after a write at this offset.
    pub const fn replace(self, word: u32, offset: u32, value: u32) -> u32 {
        let shift = 8 * (offset & 3);
        let mask = self.mask() << shift;
        (word & !mask) | ((value << shift) & mask)
    }
}

/// An access that the model does not handle; it ends the run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unknown {
    /// The reason, for the message that ends the run.
    pub what: &'static str,
}

impl Unknown {
    /// There is no register at this offset.
    pub const REGISTER: Self = Self { what: "no such register in the model" };
    /// The register does not allow byte or half-word access.
    pub const WIDTH: Self = Self { what: "the register accepts only word accesses" };
}

/// The result of an access, or the reason why the model does not handle it.
pub type Modelled<T = ()> = Result<T, Unknown>;

/// The registers of a peripheral.
///
/// `offset` is relative to the peripheral's base address and keeps its two low bits. An access never crosses a word.
/// `now` never decreases.
pub trait Registers {
    /// Reads the whole word of a register, side effects included. `advance` has been called for this time.
    fn word(&mut self, register: u32, now: Cycles) -> Modelled<u32> {
        let _ = (register, now);
        Err(Unknown::REGISTER)
    }

    /// A read by the core or by DMA, side effects included.
    fn read(&mut self, offset: u32, width: Width, now: Cycles) -> Modelled<u32> {
        self.advance(now);
        Ok(width.part(self.word(offset & !3, now)?, offset))
    }

    /// A write by the core or by DMA.
    fn write(&mut self, offset: u32, value: u32, width: Width, now: Cycles) -> Modelled;

    /// Earliest time at which an interrupt request or another peripheral may change without an access. May be too
    /// early, never too late.
    fn next_event(&self) -> Option<Cycles> {
        None
    }

    /// Advances the model to `now`.
    fn advance(&mut self, now: Cycles) {
        let _ = now;
    }

    /// Applies a system reset (RM0440 7.1.2) at `now`.
    fn reset(&mut self, now: Cycles);

    /// Applies new clock frequencies. `advance` has been called for this time.
    fn set_clocks(&mut self, clocks: &Clocks) {
        let _ = clocks;
    }

    /// Offsets of storage registers that were read without a write since power-on.
    fn unwritten_reads(&self) -> Vec<u32> {
        Vec::new()
    }
}

/// Registers that are plain storage. For the hardware they are indexed by their offset.
#[derive(Clone, Debug, Default)]
pub struct Storage {
    /// One place for each word up to the last register.
    cells: Vec<Option<Cell>>,
}

#[derive(Clone, Debug)]
struct Cell {
    reset: u32,
    writable: u32,
    value: u32,
    written: bool,
    read_unwritten: bool,
}

impl Storage {
    /// Creates registers from `(offset, reset value, writable bits)`.
    pub fn new(registers: &[(u32, u32, u32)]) -> Self {
        let words = registers.iter().map(|(offset, ..)| *offset as usize / 4 + 1).max().unwrap_or(0);
        let mut cells = vec![None; words];
        for &(offset, reset, writable) in registers {
            let cell = Cell { reset, writable, value: reset, written: false, read_unwritten: false };
            cells[offset as usize / 4] = Some(cell);
        }
        Self { cells }
    }

    /// Creates registers that programs read to change single bits: a read before any write is not listed.
    pub fn shared(registers: &[(u32, u32, u32)]) -> Self {
        let mut storage = Self::new(registers);
        storage.cells.iter_mut().flatten().for_each(|cell| cell.written = true);
        storage
    }

    /// These registers and others.
    pub fn and(mut self, others: Self) -> Self {
        self.cells.resize(self.cells.len().max(others.cells.len()), None);
        for (cell, other) in self.cells.iter_mut().zip(others.cells) {
            *cell = cell.take().or(other);
        }
        self
    }

    fn cell(&mut self, register: u32) -> Modelled<&mut Cell> {
        let cell = self.cells.get_mut(register as usize / 4).filter(|_| register.is_multiple_of(4));
        cell.and_then(Option::as_mut).ok_or(Unknown::REGISTER)
    }

    /// A read by the program.
    pub fn load(&mut self, register: u32) -> Modelled<u32> {
        let cell = self.cell(register)?;
        cell.read_unwritten |= !cell.written;
        Ok(cell.value)
    }

    /// A write by the program; bits that are not writable keep their value. Returns the word before it.
    pub fn store(&mut self, offset: u32, value: u32, width: Width) -> Modelled<u32> {
        let cell = self.cell(offset & !3)?;
        let before = cell.value;
        cell.value = before & !cell.writable | width.replace(before, offset, value) & cell.writable;
        cell.written = true;
        Ok(before)
    }

    /// Sets all registers to their reset values; the record of reads and writes is kept.
    pub fn reset(&mut self) {
        for cell in self.cells.iter_mut().flatten() {
            cell.value = cell.reset;
        }
    }
}

/// A register's value as the hardware sees it. Panics if there is none at this offset, which is an error in the model.
impl Index<u32> for Storage {
    type Output = u32;

    fn index(&self, register: u32) -> &u32 {
        match self.cells.get(register as usize / 4) {
            Some(Some(cell)) if register.is_multiple_of(4) => &cell.value,
            _ => panic!("no register at {register:#x}"),
        }
    }
}

impl IndexMut<u32> for Storage {
    fn index_mut(&mut self, register: u32) -> &mut u32 {
        match self.cell(register) {
            Ok(cell) => &mut cell.value,
            Err(_) => panic!("no register at {register:#x}"),
        }
    }
}

impl Registers for Storage {
    fn word(&mut self, register: u32, _: Cycles) -> Modelled<u32> {
        self.load(register)
    }

    fn write(&mut self, offset: u32, value: u32, width: Width, _: Cycles) -> Modelled {
        self.store(offset, value, width).map(|_| ())
    }

    fn reset(&mut self, _: Cycles) {
        self.reset();
    }

    fn unwritten_reads(&self) -> Vec<u32> {
        let is_listed = |cell: &Option<Cell>| cell.as_ref().is_some_and(|cell| cell.read_unwritten);
        (0..).step_by(4).zip(&self.cells).filter(|(_, cell)| is_listed(cell)).map(|(offset, _)| offset).collect()
    }
}

/// The error that ends the run.
pub fn refuse<T>(what: &'static str) -> Modelled<T> {
    Err(Unknown { what })
}

/// The same where a condition holds.
pub fn refuse_if(condition: bool, what: &'static str) -> Modelled {
    if condition { refuse(what) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_of_a_word() {
        assert_eq!(Width::Byte.part(0x4433_2211, 2), 0x33);
        assert_eq!(Width::Half.part(0x4433_2211, 2), 0x4433);
        assert_eq!(Width::Word.part(0x4433_2211, 0), 0x4433_2211);
        assert_eq!(Width::Byte.replace(0x4433_2211, 1, 0xaa), 0x4433_aa11);
        assert_eq!(Width::Half.replace(0x4433_2211, 2, 0xaabb), 0xaabb_2211);
        assert_eq!(Width::of(8), None);
    }

    #[test]
    fn storage_keeps_what_is_writable_and_lists_what_was_read_before() {
        let mut storage = Storage::new(&[(0x00, 0x10, 0xff), (0x04, 0, u32::MAX)]);
        assert_eq!(storage.read(0x00, Width::Word, 0), Ok(0x10));
        storage.write(0x00, 0xabcd, Width::Word, 0).expect("modelled access");
        storage.write(0x05, 0x12, Width::Byte, 0).expect("modelled access");
        assert_eq!((storage[0x00], storage[0x04]), (0xcd, 0x1200));
        assert_eq!(storage.read(0x04, Width::Half, 0), Ok(0x1200));
        assert_eq!(storage.read(0x08, Width::Word, 0), Err(Unknown::REGISTER));
        assert_eq!(storage.unwritten_reads(), [0x00]);
        storage.reset();
        assert_eq!(storage[0x00], 0x10);
    }
}
