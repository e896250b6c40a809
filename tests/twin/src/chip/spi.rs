//! SPI2 as a master: frames of 4 to 16 bits, two FIFOs of four bytes, DMA in both directions.
//!
//! A frame takes the time of its bits. The data from the slave is passed at its end ([`Spi::finish`]).
//! Not modelled, and refused: slave mode, bidirectional and one-way modes, CRC, I2S, LSB first, TI frame format,
//! hardware NSS output. These bits read back as written, and end the run when the SPI is enabled.
//!
//! Sources: RM0440 chapter 39, registers 39.9.1 to 39.9.4; FIFO levels and data packing, 39.5.9; status flags, 39.5.10.

use std::collections::VecDeque;

use super::clocks::Clocks;
use super::errata::Errata;
use crate::registers::Storage;
use crate::registers::{refuse, refuse_if};
use crate::{Cycles, Modelled, Registers, Unknown, Width};

registers! { u32:
    CR1 0x00 { CPHA 0, CPOL 1, MSTR 2, SPE 6, LSBFIRST 7, SSI 8, SSM 9, RXONLY 10, CRCEN 13, BIDIMODE 15 },
    CR2 0x04 { RXDMAEN 0, TXDMAEN 1, FRF 4, ERRIE 5, RXNEIE 6, TXEIE 7, FRXTH 12 },
    SR 0x08 { RXNE 0, TXE 1, OVR 6, BSY 7 },
    DR 0x0C,
    I2SCFGR 0x1C,
}
const CR1_NOT_MODELLED: u32 = LSBFIRST | RXONLY | CRCEN | BIDIMODE;
const CR2_RESET: u32 = 0x0700;

/// Size of a FIFO \[bytes\].
const DEPTH: usize = 4;

/// A frame in the shift register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Data from the master.
    pub data: u16,
    /// Frame length: 4 to 16 bits.
    pub bits: u32,
    end: Cycles,
}

/// The peripheral.
#[derive(Clone, Debug)]
pub struct Spi {
    cr1: u32,
    cr2: u32,
    overrun: bool,
    /// The data register was read while the overrun flag was set; the next read of the status register clears the flag.
    overrun_read: bool,
    transmit: VecDeque<u8>,
    receive: VecDeque<u8>,
    /// The frame in progress.
    pub frame: Option<Frame>,
    /// BSY stays set, until the peripheral is reset, because the SPI was disabled with something left to send (ES0430
    /// 2.18.1).
    pub busy_stays: bool,
    /// Errata in force.
    pub errata: Errata,
    /// Core cycles per APB clock.
    divider: u64,
    /// CRCPR, RXCRCR, TXCRCR, I2SCFGR, I2SPR.
    storage: Storage,
}

impl Default for Spi {
    /// The state after power-on.
    fn default() -> Self {
        Self {
            cr1: 0,
            cr2: CR2_RESET,
            overrun: false,
            overrun_read: false,
            transmit: VecDeque::with_capacity(DEPTH),
            receive: VecDeque::with_capacity(DEPTH),
            frame: None,
            busy_stays: false,
            errata: Errata::NONE,
            divider: 1,
            storage: Storage::new(&[
                (0x10, 7, 0xFFFF),
                (0x14, 0, 0),
                (0x18, 0, 0),
                (I2SCFGR, 0, 0x1FBF),
                (0x20, 2, 0x03FF),
            ]),
        }
    }
}

impl Spi {
    fn bits(&self) -> u32 {
        // Values below four bits select eight (39.9.2, DS).
        match self.cr2 >> 8 & 0xF {
            0..=2 => 8,
            ds => ds + 1,
        }
    }

    /// FIFO bytes per frame.
    fn frame_bytes(&self) -> usize {
        if self.bits() > 8 { 2 } else { 1 }
    }

    /// Core cycles per bit.
    fn bit(&self) -> Cycles {
        self.divider << ((self.cr1 >> 3 & 7) + 1)
    }

    /// Core cycles per frame.
    pub fn frame_cycles(&self) -> Cycles {
        self.bit() * u64::from(self.bits())
    }

    /// SPI clock rate at a core clock of `hclk_hz` \[Hz\].
    pub fn rate_hz(&self, hclk_hz: f64) -> f64 {
        hclk_hz / self.bit() as f64
    }

    /// CPOL (idle level of the clock) and CPHA (data is sampled at the second edge).
    pub fn mode(&self) -> (bool, bool) {
        (self.cr1 & CPOL != 0, self.cr1 & CPHA != 0)
    }

    fn is_enabled(&self) -> bool {
        self.cr1 & SPE != 0
    }

    fn txe(&self) -> bool {
        self.transmit.len() <= DEPTH / 2
    }

    fn rxne(&self) -> bool {
        self.receive.len() >= if self.cr2 & FRXTH != 0 { 1 } else { 2 }
    }

    fn status(&self) -> u32 {
        let level = |fifo: &VecDeque<u8>| fifo.len().min(3) as u32;
        let flag = |set: bool, bit: u32| if set { bit } else { 0 };
        let busy = self.frame.is_some() || self.busy_stays || self.is_enabled() && !self.transmit.is_empty();
        flag(self.rxne(), RXNE)
            | flag(self.txe(), TXE)
            | flag(self.overrun, OVR)
            | flag(busy, BSY)
            | level(&self.receive) << 9
            | level(&self.transmit) << 11
    }

    /// End of the frame in progress; [`finish`](Self::finish) must be called then.
    pub fn due(&self) -> Option<Cycles> {
        self.frame.map(|frame| frame.end)
    }

    /// Ends the frame in progress, in which the slave sent `answer`. The next frame starts at once.
    pub fn finish(&mut self, answer: u16) {
        let Some(frame) = self.frame.take() else { return };
        let bytes = self.frame_bytes();
        if self.receive.len() + bytes > DEPTH {
            self.overrun = true;
        } else {
            // The low byte is read first (39.5.9).
            self.receive.extend(answer.to_le_bytes().into_iter().take(bytes));
        }
        self.start(frame.end);
    }

    fn start(&mut self, now: Cycles) {
        let bytes = self.frame_bytes();
        if self.frame.is_some() || !self.is_enabled() || self.transmit.len() < bytes {
            return;
        }
        let taken: Vec<u8> = self.transmit.drain(..bytes).collect();
        let data = taken.iter().rev().fold(0, |data, byte| data << 8 | u16::from(*byte));
        self.frame = Some(Frame { data, bits: self.bits(), end: now + self.frame_cycles() });
    }

    /// Whether a received frame requests DMA.
    pub fn receive_request(&self) -> bool {
        self.cr2 & RXDMAEN != 0 && self.rxne()
    }

    /// Whether free space in the FIFO requests DMA.
    pub fn transmit_request(&self) -> bool {
        self.cr2 & TXDMAEN != 0 && self.is_enabled() && self.txe()
    }

    /// Level of the interrupt request.
    pub fn irq(&self) -> bool {
        self.cr2 & TXEIE != 0 && self.txe()
            || self.cr2 & RXNEIE != 0 && self.rxne()
            || self.cr2 & ERRIE != 0 && self.overrun
    }

    /// Whether each frame may raise the interrupt request.
    pub fn interrupts_each(&self) -> bool {
        self.cr2 & (TXEIE | RXNEIE | ERRIE) != 0
    }

    fn write_control(&mut self, value: u32, now: Cycles) -> Modelled {
        if value & SPE != 0 {
            refuse_if(
                self.is_enabled() && (self.cr1 ^ value) & !(SPE | SSI) != 0,
                "SPI_CR1 changed while the SPI is enabled",
            )?;
            refuse_if(
                value & MSTR == 0 || value & CR1_NOT_MODELLED != 0 || self.cr2 & FRF != 0,
                "SPI_CR1: only a full-duplex master without CRC is modelled",
            )?;
            refuse_if(value & (SSM | SSI) != SSM | SSI, "SPI_CR1: only software NSS (SSM, SSI) is modelled")?;
        }
        let was_sending = self.is_enabled() && (self.frame.is_some() || !self.transmit.is_empty());
        self.cr1 = value & 0xFFFF;
        self.busy_stays |= was_sending && !self.is_enabled() && self.errata.spi_busy_stays;
        self.start(now);
        Ok(())
    }

    fn write_data(&mut self, value: u32, width: Width, now: Cycles) -> Modelled {
        // A half-word holds two frames of up to eight bits. A byte cannot hold a longer frame.
        let bytes = match width {
            Width::Byte if self.frame_bytes() == 2 => {
                return refuse("SPI_DR: byte write with a frame size above 8 bits");
            }
            Width::Byte => 1,
            Width::Half => 2,
            Width::Word => return Err(Unknown::WIDTH),
        };
        refuse_if(self.transmit.len() + bytes > DEPTH, "SPI_DR write does not fit in the transmit FIFO")?;
        self.transmit.extend(value.to_le_bytes().into_iter().take(bytes));
        self.start(now);
        Ok(())
    }

    fn read_data(&mut self, width: Width) -> u32 {
        self.overrun_read |= self.overrun;
        let bytes = width.bytes().min(2) as usize;
        let mut value = 0;
        for place in 0..bytes {
            value |= u32::from(self.receive.pop_front().unwrap_or(0)) << (8 * place);
        }
        value
    }
}

impl Registers for Spi {
    fn read(&mut self, offset: u32, width: Width, _: Cycles) -> Modelled<u32> {
        let word = match offset & !3 {
            CR1 => self.cr1,
            CR2 => self.cr2,
            SR => {
                let status = self.status();
                if std::mem::take(&mut self.overrun_read) {
                    self.overrun = false;
                }
                status
            }
            DR if offset & 3 == 0 => return Ok(self.read_data(width)),
            register => self.storage.load(register)?,
        };
        Ok(width.part(word, offset))
    }

    fn write(&mut self, offset: u32, value: u32, width: Width, now: Cycles) -> Modelled {
        match offset & !3 {
            CR1 => self.write_control(width.replace(self.cr1, offset, value), now),
            CR2 => {
                let value = width.replace(self.cr2, offset, value) & 0x7FFF;
                // DS, FRF, NSSP and SSOE may change only while the SPI is disabled (39.9.2).
                let fixed = 0xF << 8 | FRF | 1 << 3 | 1 << 2;
                refuse_if(
                    self.is_enabled() && (self.cr2 ^ value) & fixed != 0,
                    "SPI_CR2 changed while the SPI is enabled",
                )?;
                self.cr2 = value;
                Ok(())
            }
            // Error flags that this model does not raise.
            SR => Ok(()),
            DR if offset & 3 == 0 => self.write_data(value, width, now),
            I2SCFGR if value & 1 << 11 != 0 => refuse("SPI_I2SCFGR.I2SMOD: I2S is not modelled"),
            _ => self.storage.write(offset, value, width, now),
        }
    }

    /// The end of the frame in progress, if it may raise the interrupt request.
    fn next_event(&self) -> Option<Cycles> {
        self.due().filter(|_| self.interrupts_each())
    }

    fn reset(&mut self, _: Cycles) {
        self.storage.reset();
        *self = Self { divider: self.divider, errata: self.errata, storage: self.storage.clone(), ..Self::default() };
    }

    fn set_clocks(&mut self, clocks: &Clocks) {
        self.divider = ((clocks.hclk_hz / clocks.pclk1_hz).round() as u64).max(1);
    }

    fn unwritten_reads(&self) -> Vec<u32> {
        self.storage.unwritten_reads()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Width::{Byte, Half, Word};

    const DR: u32 = 0x0C;

    fn write(spi: &mut Spi, offset: u32, value: u32, width: Width) {
        spi.write(offset, value, width, 0).unwrap();
    }

    fn read(spi: &mut Spi, offset: u32, width: Width) -> u32 {
        spi.read(offset, width, 0).unwrap()
    }

    /// Frames of one byte, at HCLK / 8.
    fn master() -> Spi {
        let mut spi = Spi::default();
        write(&mut spi, 0x04, 7 << 8 | FRXTH, Word);
        let mode = MSTR | SSM | SSI | CPHA | 2 << 3;
        write(&mut spi, 0x00, mode, Word);
        write(&mut spi, 0x00, mode | SPE, Word);
        spi
    }

    fn levels(spi: &mut Spi) -> (u32, u32) {
        let status = read(spi, 0x08, Word);
        (status >> 9 & 3, status >> 11 & 3)
    }

    #[test]
    fn the_busy_flag_stays_where_it_was_switched_off_with_something_to_send() {
        let busy = |errata: Errata, frames: usize, ended: usize| {
            let mut spi = master();
            spi.errata = errata;
            (0..frames).for_each(|_| write(&mut spi, DR, 0x11, Byte));
            (0..ended).for_each(|_| spi.finish(0));
            let cr1 = read(&mut spi, 0, Word);
            write(&mut spi, 0, cr1 & !SPE, Word);
            let stays = spi.busy_stays;
            spi.reset(0);
            assert!(!spi.busy_stays);
            stays
        };
        let only = Errata { spi_busy_stays: true, ..Errata::NONE };
        assert!(busy(only, 2, 0) && busy(only, 2, 1));
        assert!(!busy(only, 2, 2) && !busy(only, 0, 0), "all was sent");
        assert!(!busy(Errata::NONE, 2, 0) && !busy(Errata::NONE, 2, 1));
    }

    #[test]
    fn bytes_leave_one_after_the_other_and_answers_come_back() {
        let mut spi = master();
        assert_eq!((spi.mode(), spi.rate_hz(168e6), spi.frame_cycles()), ((false, true), 21e6, 64));
        for byte in [0x11, 0x22, 0x33] {
            write(&mut spi, DR, byte, Byte);
        }
        // One frame in the shift register, two in the FIFO.
        assert_eq!(levels(&mut spi), (0, 2));
        assert_eq!(spi.frame, Some(Frame { data: 0x11, bits: 8, end: 64 }));
        assert_ne!(read(&mut spi, 0x08, Word) & BSY, 0);
        for (answer, end) in [(0xA1, 128), (0xA2, 192)] {
            spi.finish(answer);
            assert_eq!(spi.due(), Some(end));
        }
        spi.finish(0xA3);
        assert_eq!((spi.due(), levels(&mut spi)), (None, (3, 0)));
        assert_eq!(read(&mut spi, 0x08, Word) & BSY, 0);
        let back: Vec<u32> = (0..3).map(|_| read(&mut spi, DR, Byte)).collect();
        assert_eq!(back, [0xA1, 0xA2, 0xA3]);
    }

    #[test]
    fn a_half_word_holds_two_bytes() {
        let mut spi = master();
        write(&mut spi, DR, 0x2211, Half);
        assert_eq!(spi.frame.unwrap().data, 0x11);
        spi.finish(0xA1);
        assert_eq!(spi.frame.unwrap().data, 0x22);
        spi.finish(0xA2);
        assert_eq!(read(&mut spi, DR, Half), 0xA2A1);
    }

    #[test]
    fn frames_of_sixteen_bits() {
        let mut spi = Spi::default();
        write(&mut spi, 0x04, 15 << 8, Word);
        write(&mut spi, 0x00, MSTR | SSM | SSI | SPE, Word);
        write(&mut spi, DR, 0xBEEF, Half);
        assert_eq!((spi.frame.unwrap().data, spi.frame.unwrap().bits, spi.due()), (0xBEEF, 16, Some(32)));
        spi.finish(0x1234);
        assert!(read(&mut spi, 0x08, Half) & RXNE != 0);
        assert_eq!(read(&mut spi, DR, Half), 0x1234);
        assert!(spi.write(DR, 1, Byte, 0).is_err());
    }

    #[test]
    fn requests_follow_the_levels() {
        let mut spi = master();
        assert!(!spi.transmit_request() && !spi.receive_request());
        write(&mut spi, 0x04, 7 << 8 | FRXTH | RXDMAEN | TXDMAEN, Word);
        let mut sent = 0;
        while spi.transmit_request() {
            write(&mut spi, DR, sent, Byte);
            sent += 1;
        }
        assert_eq!((sent, levels(&mut spi).1), (4, 3));
        spi.finish(0x55);
        assert!(spi.receive_request() && spi.transmit_request());
        read(&mut spi, DR, Byte);
        assert!(!spi.receive_request());
    }

    #[test]
    fn a_full_receiver_loses_what_comes_and_says_so() {
        let mut spi = master();
        for answer in 1..=5 {
            write(&mut spi, DR, 0, Byte);
            spi.finish(answer);
        }
        assert_ne!(read(&mut spi, 0x08, Word) & OVR, 0);
        assert_eq!((0..4).map(|_| read(&mut spi, DR, Byte)).collect::<Vec<_>>(), [1, 2, 3, 4]);
        // A read of the data register, then of the status register, clears the flag.
        assert_ne!(read(&mut spi, 0x08, Word) & OVR, 0);
        assert_eq!(read(&mut spi, 0x08, Word) & OVR, 0);
    }

    #[test]
    fn interrupts_follow_their_enables() {
        let mut spi = master();
        assert!(!spi.irq());
        write(&mut spi, 0x04, 7 << 8 | FRXTH | TXEIE, Word);
        assert!(spi.irq() && spi.interrupts_each());
        write(&mut spi, 0x04, 7 << 8 | FRXTH | RXNEIE, Word);
        assert!(!spi.irq());
        write(&mut spi, DR, 0, Byte);
        assert_eq!(spi.next_event(), Some(64));
        spi.finish(0);
        assert!(spi.irq());
    }

    #[test]
    fn what_is_not_modelled_is_refused() {
        let enable = MSTR | SSM | SSI | SPE;
        for mode in
            [enable & !MSTR, enable & !SSI, enable | CRCEN, enable | LSBFIRST, enable | RXONLY, enable | BIDIMODE]
        {
            assert!(Spi::default().write(0x00, mode, Word, 0).is_err(), "{mode:#x}");
        }
        let mut spi = master();
        assert!(spi.write(0x04, 15 << 8, Word, 0).is_err());
        assert!(spi.write(0x1C, 1 << 11, Word, 0).is_err());
        assert!(spi.read(0x24, Word, 0).is_err());
        for _ in 0..5 {
            write(&mut spi, DR, 0, Byte);
        }
        assert!(spi.write(DR, 0, Byte, 0).is_err());
    }

    #[test]
    fn fields_are_metapacs() {
        fields_agree!("SPI2", "CR1", SPE, LSBFIRST, SSI, SSM, RXONLY, CRCEN, BIDIMODE);
        fields_agree!("SPI2", "CR2", RXDMAEN, TXDMAEN, FRF, ERRIE, RXNEIE, TXEIE, FRXTH);
        fields_agree!("SPI2", "SR", RXNE, TXE, OVR, BSY);
    }
}
