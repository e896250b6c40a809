//! The serial link LPUART1 (RM0440 section 38.7): 8 data bits, no parity, one stop bit.
//!
//! The remote end is a pair of byte queues: [`Lpuart::send`] and [`Lpuart::take_sent`]. Bytes take their time at the
//! baud rate set in the registers; a remote end at another rate causes framing errors. Modelled: FIFO with thresholds
//! and interrupts, idle line, overrun, DMA requests. Refused: flow control, addressing, wake-up, half-duplex.

use crate::registers::{refuse, refuse_if};
use crate::{Cycles, Modelled, Registers, Storage, Width, chip::clocks::Clocks};
use std::collections::VecDeque;

registers! { u32:
    // UART enable, receiver enable, transmitter enable, FIFO enable.
    CR1 0x00 { UE 0, RE 2, TE 3, FIFOEN 29 },
    CR2 0x04,
    // Error interrupt enable, DMA enable of receiver and transmitter, overrun disable.
    CR3 0x08 { EIE 0, DMAR 6, DMAT 7, OVRDIS 12 },
    BRR 0x0c,
    RQR 0x18,
    ISR 0x1c {
        FE 1, ORE 3, IDLE 4, RXNE 5, TC 6, TXE 7, BUSY 16, TEACK 21, REACK 22, TXFE 23, RXFF 24, RXFT 26, TXFT 27
    },
    ICR 0x20,
    RDR 0x24,
    TDR 0x28,
    PRESC 0x2c,
}
/// CR1: word length other than 8, parity, mute mode.
const CR1_UNKNOWN: u32 = 1 << 28 | 1 << 12 | 1 << 10 | 1 << 13;
const CR3_KNOWN: u32 = EIE | DMAR | DMAT | OVRDIS | 7 << 25 | 7 << 29 | 1 << 28 | 1 << 23 | 1 << 13;

/// Start bit, eight data bits, stop bit.
const BITS: f64 = 10.0;
/// Relative difference of the baud rates above which bytes are received with errors: half a bit in ten.
const TOLERANCE: f64 = 0.045;

/// The UART and the remote end.
#[derive(Clone, Debug)]
pub struct Lpuart {
    storage: Storage,
    flags: u32,
    clock_hz: f64,
    hclk_hz: f64,
    /// Baud rate of the remote end \[bit/s\].
    pub far_baud: f64,
    /// Byte in the shift register, and the end of its last bit.
    shifting: Option<(u8, Cycles)>,
    transmit: VecDeque<u8>,
    /// Last value written to TDR, which reads back.
    written: u8,
    receive: VecDeque<u8>,
    sent: Vec<u8>,
    arriving: VecDeque<u8>,
    /// Time at which the first of the arriving bytes is complete.
    arrives: Cycles,
    idles: Option<Cycles>,
}

impl Default for Lpuart {
    fn default() -> Self {
        // Receiver and transmitter share these registers.
        let shared = Storage::shared(&[(CR1, 0, u32::MAX), (CR2, 0, 0xffff_ff70), (CR3, 0, u32::MAX)]);
        Self {
            storage: shared.and(Storage::new(&[(BRR, 0, 0xf_ffff), (PRESC, 0, 0xf)])),
            flags: TC,
            clock_hz: 16e6,
            hclk_hz: 16e6,
            far_baud: 921_600.0,
            shifting: None,
            transmit: VecDeque::new(),
            written: 0,
            receive: VecDeque::new(),
            sent: Vec::new(),
            arriving: VecDeque::new(),
            arrives: 0,
            idles: None,
        }
    }
}

impl Lpuart {
    /// Sends bytes from the remote end.
    pub fn send(&mut self, bytes: &[u8], now: Cycles) {
        if self.arriving.is_empty() {
            self.arrives = now + self.byte_time(self.far_baud);
        }
        self.arriving.extend(bytes);
    }

    /// Bytes that the remote end received since the last call.
    pub fn take_sent(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.sent)
    }

    /// Baud rate set in the registers \[bit/s\]; none if the setting is invalid.
    pub fn baud(&self) -> Option<f64> {
        let prescaler = [1.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 16.0, 32.0, 64.0, 128.0, 256.0];
        let divider = f64::from(self.storage[BRR]);
        let prescaler = prescaler.get(self.storage[PRESC] as usize)?;
        let baud = 256.0 * self.clock_hz / prescaler / divider;
        (baud.is_finite() && baud > 0.0).then_some(baud)
    }

    fn byte_time(&self, baud: f64) -> Cycles {
        (BITS * self.hclk_hz / baud).round() as Cycles
    }

    fn own_byte_time(&self) -> Cycles {
        self.byte_time(self.baud().unwrap_or(self.far_baud))
    }

    fn rates_agree(&self) -> bool {
        self.baud().is_some_and(|baud| (baud / self.far_baud - 1.0).abs() < TOLERANCE)
    }

    fn has(&self, bits: u32) -> bool {
        self.storage[CR1] & bits == bits
    }

    fn depth(&self) -> usize {
        if self.has(FIFOEN) { 8 } else { 1 }
    }

    /// Number of bytes at which RXFT or TXFT is set (CR3 threshold fields).
    fn threshold(&self, shift: u32) -> usize {
        match self.storage[CR3] >> shift & 7 {
            0 => 1,
            1 => 2,
            2 => 4,
            3 => 6,
            4 => 7,
            _ => 8,
        }
    }

    fn status(&self) -> u32 {
        let fifo = self.has(FIFOEN);
        let free = self.depth() - self.transmit.len().min(self.depth());
        let flag = |on: bool, flag: u32| if on { flag } else { 0 };
        self.flags
            | flag(!self.receive.is_empty(), RXNE)
            | flag(free > 0, TXE)
            | flag(self.has(UE | TE), TEACK)
            | flag(self.has(UE | RE), REACK)
            | flag(!self.arriving.is_empty(), BUSY)
            | flag(fifo && self.transmit.is_empty(), TXFE)
            | flag(fifo && self.receive.len() >= self.depth(), RXFF)
            | flag(fifo && self.receive.len() >= self.threshold(25), RXFT)
            | flag(fifo && free >= self.threshold(29), TXFT)
    }

    /// Level of the interrupt request.
    pub fn irq(&self) -> bool {
        let (cr1, cr3, status) = (self.storage[CR1], self.storage[CR3], self.status());
        // IDLEIE, RXNEIE, TCIE and TXEIE have the positions of their flags; RXNEIE also enables overrun.
        cr1 & status & (IDLE | RXNE | TC | TXE) != 0
            || cr1 & RXNE != 0 && status & ORE != 0
            || cr3 & EIE != 0 && status & (FE | ORE) != 0
            || cr3 & 1 << 28 != 0 && status & RXFT != 0
            || cr3 & 1 << 23 != 0 && status & TXFT != 0
            || cr1 & 1 << 30 != 0 && status & TXFE != 0
            || cr1 & 1 << 31 != 0 && status & RXFF != 0
    }

    /// Whether the receiver requests DMA.
    pub fn dma_receive(&self) -> bool {
        self.storage[CR3] & DMAR != 0 && !self.receive.is_empty()
    }

    /// Whether the transmitter requests DMA.
    pub fn dma_transmit(&self) -> bool {
        self.storage[CR3] & DMAT != 0 && self.has(UE | TE) && self.transmit.len() < self.depth()
    }

    fn start(&mut self, now: Cycles) {
        if self.shifting.is_none() && self.has(UE | TE) {
            self.shifting = self.transmit.pop_front().map(|byte| (byte, now + self.own_byte_time()));
        }
    }

    fn received(&mut self, byte: u8) {
        if self.receive.len() < self.depth() {
            self.receive.push_back(if self.rates_agree() { byte } else { !byte });
        } else if self.storage[CR3] & OVRDIS == 0 {
            self.flags |= ORE;
        }
        if !self.rates_agree() {
            self.flags |= FE;
        }
    }
}

impl Registers for Lpuart {
    fn word(&mut self, register: u32, _: Cycles) -> Modelled<u32> {
        Ok(match register {
            ISR => self.status(),
            RDR => u32::from(self.receive.pop_front().unwrap_or(0)),
            ICR | RQR => 0,
            TDR => u32::from(self.written),
            _ => self.storage.load(register)?,
        })
    }

    fn write(&mut self, offset: u32, value: u32, width: Width, now: Cycles) -> Modelled {
        self.advance(now);
        let word = width.replace(0, offset, value);
        match offset & !3 {
            ICR => self.flags &= !(word & (0xf | IDLE | TC)),
            TDR => {
                refuse_if(self.transmit.len() >= self.depth(), "written while the transmitter is full")?;
                self.flags &= !TC;
                self.written = word as u8;
                self.transmit.push_back(self.written);
                self.start(now);
            }
            RQR => {
                if word & 1 << 3 != 0 {
                    self.receive.clear();
                }
                if word & 1 << 4 != 0 {
                    self.transmit.clear();
                }
                refuse_if(word & !(3 << 3) != 0, "RQR: only the flush requests are modelled")?;
            }
            CR1 if word & CR1_UNKNOWN != 0 => return refuse("frame formats other than 8N1 are not modelled"),
            CR3 if word & !CR3_KNOWN != 0 => return refuse("flow control and half-duplex are not modelled"),
            CR1 => {
                self.storage.store(offset, value, width)?;
                if !self.has(UE) {
                    self.flags = TC;
                    self.receive.clear();
                    self.transmit.clear();
                    self.shifting = None;
                }
                self.start(now);
            }
            _ => return self.storage.write(offset, value, width, now),
        }
        Ok(())
    }

    fn next_event(&self) -> Option<Cycles> {
        let arrives = (!self.arriving.is_empty()).then_some(self.arrives);
        let left = self.shifting.map(|(_, left)| left);
        [arrives, left, self.idles].into_iter().flatten().min()
    }

    fn advance(&mut self, now: Cycles) {
        while let Some((byte, left)) = self.shifting.filter(|&(_, left)| left <= now) {
            self.sent.push(if self.rates_agree() { byte } else { !byte });
            self.shifting = self.transmit.pop_front().map(|byte| (byte, left + self.own_byte_time()));
            if self.shifting.is_none() {
                self.flags |= TC;
            }
        }
        while !self.arriving.is_empty() && self.arrives <= now {
            if let Some(byte) = self.arriving.pop_front().filter(|_| self.has(UE | RE)) {
                self.received(byte);
                // The line is idle after a whole frame of ones.
                self.idles = Some(self.arrives + self.byte_time(self.far_baud));
            }
            self.arrives += self.byte_time(self.far_baud);
        }
        if self.idles.is_some_and(|at| at <= now) && (self.arriving.is_empty() || self.arrives > now) {
            if self.arriving.is_empty() {
                self.flags |= IDLE;
            }
            self.idles = None;
        }
    }

    fn reset(&mut self, now: Cycles) {
        self.storage.reset();
        self.flags = TC;
        self.shifting = None;
        self.transmit.clear();
        self.receive.clear();
        self.idles = None;
        self.advance(now);
    }

    fn set_clocks(&mut self, clocks: &Clocks) {
        self.clock_hz = clocks.lpuart1_hz;
        self.hclk_hz = clocks.hclk_hz;
    }

    fn unwritten_reads(&self) -> Vec<u32> {
        self.storage.unwritten_reads()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::{read, write};

    /// 1 Mbit/s at 16 MHz: a byte takes 160 cycles.
    fn running(cr1: u32) -> Lpuart {
        let mut uart = Lpuart { far_baud: 1e6, ..Lpuart::default() };
        write(&mut uart, BRR, 4096, 0);
        write(&mut uart, CR1, UE | RE | TE | cr1, 0);
        uart
    }

    #[test]
    fn sends_bytes_one_after_the_other() {
        let mut uart = running(FIFOEN);
        for byte in *b"abc" {
            write(&mut uart, TDR, u32::from(byte), 10);
        }
        assert_eq!(read(&mut uart, ISR, 489) & TC, 0);
        assert_eq!(uart.take_sent(), b"ab");
        assert_eq!(uart.next_event(), Some(490));
        assert_eq!(read(&mut uart, ISR, 490) & TC, TC);
        assert_eq!(uart.take_sent(), b"c");
    }

    #[test]
    fn receives_then_reports_the_idle_line() {
        let mut uart = running(FIFOEN | RXNE | IDLE);
        uart.send(b"xy", 0);
        uart.advance(159);
        assert!(!uart.irq());
        uart.advance(160);
        assert!(uart.irq());
        assert_eq!(read(&mut uart, RDR, 320), u32::from(b'x'));
        assert_eq!(read(&mut uart, RDR, 320), u32::from(b'y'));
        assert!(!uart.irq());
        assert_eq!(uart.next_event(), Some(480));
        uart.advance(480);
        assert_eq!(read(&mut uart, ISR, 480) & IDLE, IDLE);
        assert!(uart.irq());
        write(&mut uart, ICR, IDLE, 480);
        assert!(!uart.irq());
    }

    #[test]
    fn overrun_without_anybody_reading() {
        let mut uart = running(FIFOEN | RXNE);
        uart.send(b"123456789", 0);
        uart.advance(8 * 160);
        assert_eq!(read(&mut uart, ISR, 8 * 160) & (ORE | RXFF), RXFF);
        uart.advance(9 * 160);
        assert_eq!(read(&mut uart, ISR, 9 * 160) & ORE, ORE);
    }

    #[test]
    fn ends_that_disagree_about_the_rate() {
        let mut uart = running(0);
        uart.far_baud = 115_200.0;
        uart.send(b"x", 0);
        uart.advance(10_000);
        assert_eq!(read(&mut uart, ISR, 10_000) & FE, FE);
        assert_ne!(read(&mut uart, RDR, 10_000), u32::from(b'x'));
        assert_eq!(uart.baud(), Some(1e6));
    }

    #[test]
    fn asks_dma() {
        let mut uart = running(0);
        write(&mut uart, CR3, DMAR | DMAT, 0);
        assert!(uart.dma_transmit() && !uart.dma_receive());
        uart.send(b"x", 0);
        uart.advance(160);
        assert!(uart.dma_receive());
    }

    #[test]
    fn fields_are_metapacs() {
        fields_agree!("LPUART1", "CR1", UE, RE, TE, FIFOEN);
        fields_agree!("LPUART1", "CR3", EIE, DMAR, DMAT, OVRDIS);
        fields_agree!("LPUART1", "ISR", FE, ORE, IDLE, RXNE, TC, TXE, BUSY, TEACK, REACK, TXFE, RXFF, RXFT, TXFT);
        fields_agree!("LPUART1", "CR1", IDLEIE = IDLE, RXNEIE = RXNE, TCIE = TC, TXEIE = TXE);
    }
}
