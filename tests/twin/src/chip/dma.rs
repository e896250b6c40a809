//! The DMA controllers DMA1 and DMA2: eight channels each, in circular or normal mode.
//!
//! A channel serves a request with one transfer between a peripheral register and memory. The bus executes the
//! transfer; this model selects and counts it. A channel sets its flags at half transfer and at transfer complete. A
//! transfer error disables the channel, which cannot be enabled until its error flag is cleared.
//! Not modelled, and refused: memory-to-memory mode, priorities (a transfer takes no time here, so none waits for
//! another).
//!
//! Sources: RM0440 chapter 12, registers 12.6.1 to 12.6.6; the notes beside the fields say when a register may be
//! written.

use super::errata::Errata;
use crate::registers::{refuse, refuse_if};
use crate::{Cycles, Modelled, Registers, Unknown, Width};

/// Number of channels of a controller.
pub const CHANNELS: usize = 8;

// Registers of a channel, by their place in its group.
registers! { u32:
    CCR 0x00 { EN 0, TCIE 1, HTIE 2, TEIE 3, DIR 4, CIRC 5, PINC 6, MINC 7, MEM2MEM 14 },
    CNDTR 0x04,
    CPAR 0x08,
    CMAR 0x0C,
}
// Fields of CCR.
const PSIZE: u32 = 3 << 8;
const MSIZE: u32 = 3 << 10;
const PL: u32 = 3 << 12;
/// Interrupt enables, at the positions of their flags.
const INTERRUPTS: u32 = TCIE | HTIE | TEIE;
/// Fields that must not change while the channel is enabled.
const FIXED: u32 = DIR | PINC | MINC | PSIZE | MSIZE | PL | MEM2MEM;
const CCR_ALL: u32 = 0x7FFF;

/// DMA_ISR and DMA_IFCR, four bits per channel.
mod flag {
    pub const GLOBAL: u32 = 1 << 0;
    pub const COMPLETE: u32 = 1 << 1;
    pub const HALF: u32 = 1 << 2;
    pub const ERROR: u32 = 1 << 3;
    pub const ALL: u32 = COMPLETE | HALF | ERROR;
}

/// Direction of a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// From the peripheral to memory.
    ToMemory,
    /// From memory to the peripheral.
    ToPeripheral,
}

/// A transfer that a channel requests.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transfer {
    /// Address of the peripheral register.
    pub peripheral: u32,
    /// Width of the access there.
    pub peripheral_width: Width,
    /// Address in memory.
    pub memory: u32,
    /// Width of the access there.
    pub memory_width: Width,
    /// Its direction.
    pub direction: Direction,
}

/// A channel.
#[derive(Clone, Copy, Debug, Default)]
pub struct Channel {
    ccr: u32,
    /// Transfers left in this pass.
    cndtr: u32,
    cpar: u32,
    cmar: u32,
    /// Transfers per pass: the last value written to CNDTR.
    lap: u32,
    /// Flags except the global one.
    flags: u32,
    /// Until when it is denied the bus, as if another master held it. Its requests wait.
    pub stalled_until: Option<Cycles>,
    /// Every transfer fails.
    pub broken: bool,
}

impl Channel {
    /// Whether it is enabled.
    pub fn is_enabled(&self) -> bool {
        self.ccr & EN != 0
    }

    /// Transfers done in this pass.
    fn done(&self) -> u32 {
        self.lap - self.cndtr
    }

    fn width(&self, shift: u32) -> Modelled<Width> {
        match self.ccr >> shift & 3 {
            0 => Ok(Width::Byte),
            1 => Ok(Width::Half),
            2 => Ok(Width::Word),
            _ => refuse("DMA_CCR: a transfer size of 3 is reserved"),
        }
    }

    /// Level of the interrupt request.
    pub fn irq(&self) -> bool {
        self.flags & self.ccr & INTERRUPTS != 0
    }

    /// Transfers until the interrupt request is raised; none if that never happens.
    pub fn transfers_until_interrupt(&self) -> Option<u32> {
        if self.broken && self.ccr & (TEIE | EN) == TEIE | EN {
            return Some(1);
        }
        if !self.is_enabled() || self.cndtr == 0 {
            return None;
        }
        let half = self.lap / 2;
        let to_half = match half.checked_sub(self.done()) {
            Some(left) if left > 0 => Some(left),
            _ if self.ccr & CIRC != 0 => Some(self.cndtr + half),
            _ => None,
        };
        let half = to_half.filter(|_| self.ccr & HTIE != 0);
        let end = Some(self.cndtr).filter(|_| self.ccr & TCIE != 0);
        half.into_iter().chain(end).min()
    }

    /// The transfer that it would do on a request; none if it is disabled, has completed, or is stalled.
    pub fn transfer(&self) -> Modelled<Option<Transfer>> {
        if !self.is_enabled() || self.cndtr == 0 || self.stalled_until.is_some() {
            return Ok(None);
        }
        refuse_if(self.ccr & MEM2MEM != 0, "DMA_CCR.MEM2MEM: memory-to-memory mode is not modelled")?;
        let (peripheral_width, memory_width) = (self.width(8)?, self.width(10)?);
        let place = |base: u32, moves: u32, width: Width| {
            // An address is aligned to the transfer size: the lowest bits are ignored (12.6.5, 12.6.6).
            let step = if self.ccr & moves != 0 { self.done() * width.bytes() } else { 0 };
            (base & !(width.bytes() - 1)).wrapping_add(step)
        };
        Ok(Some(Transfer {
            peripheral: place(self.cpar, PINC, peripheral_width),
            peripheral_width,
            memory: place(self.cmar, MINC, memory_width),
            memory_width,
            direction: if self.ccr & DIR != 0 { Direction::ToPeripheral } else { Direction::ToMemory },
        }))
    }

    /// Counts a transfer that was done; returns whether it was the last of a pass. A failed transfer does not count.
    pub fn complete(&mut self) -> bool {
        if !self.is_enabled() {
            return false;
        }
        self.cndtr = self.cndtr.saturating_sub(1);
        if self.done() == self.lap / 2 {
            self.flags |= flag::HALF;
        }
        if self.cndtr > 0 {
            return false;
        }
        self.flags |= flag::COMPLETE;
        if self.ccr & CIRC != 0 {
            self.cndtr = self.lap;
        }
        true
    }

    /// The transfer hit a reserved address, or the bus refused it: a transfer error disables the channel (12.4.7).
    pub fn fail(&mut self) {
        self.flags |= flag::ERROR;
        self.ccr &= !EN;
    }
}

/// One controller.
#[derive(Clone, Debug, Default)]
pub struct Dma {
    /// Its channels, the first of which has number 1.
    pub channels: [Channel; CHANNELS],
    /// Errata in force.
    pub errata: Errata,
}

impl Dma {
    /// The channel at an offset, and the register within its group of five words. The first group starts at 0x08.
    fn place(&mut self, offset: u32) -> Modelled<(&mut Channel, u32)> {
        let offset = offset.checked_sub(0x08).ok_or(Unknown::REGISTER)?;
        let channel = self.channels.get_mut((offset / 0x14) as usize).ok_or(Unknown::REGISTER)?;
        Ok((channel, offset % 0x14))
    }
}

impl Registers for Dma {
    fn read(&mut self, offset: u32, width: Width, _: Cycles) -> Modelled<u32> {
        if width != Width::Word {
            return Err(Unknown::WIDTH);
        }
        if offset == 0x00 {
            let nibble = |flags: u32| flags | if flags != 0 { flag::GLOBAL } else { 0 };
            return Ok((0..).zip(&self.channels).map(|(n, it)| nibble(it.flags) << (4 * n)).sum());
        }
        let (it, register) = self.place(offset)?;
        match register {
            CCR => Ok(it.ccr),
            CNDTR => Ok(it.cndtr),
            CPAR => Ok(it.cpar),
            CMAR => Ok(it.cmar),
            _ => Err(Unknown::REGISTER),
        }
    }

    fn write(&mut self, offset: u32, value: u32, width: Width, _: Cycles) -> Modelled {
        if width != Width::Word {
            return Err(Unknown::WIDTH);
        }
        if offset == 0x04 {
            for (n, it) in (0..).zip(&mut self.channels) {
                let clear = value >> (4 * n) & 0xF;
                refuse_if(
                    self.errata.dma_global_clear && clear & flag::GLOBAL != 0 && it.is_enabled(),
                    "DMA_IFCR: CGIF written for an enabled channel may lose an error flag",
                )?;
                it.flags &= !if clear & flag::GLOBAL != 0 { flag::ALL } else { clear };
            }
            return Ok(());
        }
        let (it, register) = self.place(offset)?;
        if register == CCR {
            let value = value & CCR_ALL;
            refuse_if(
                it.is_enabled() && value & EN != 0 && (it.ccr ^ value) & FIXED != 0,
                "DMA_CCR: changed while the channel is enabled",
            )?;
            refuse_if(
                value & EN != 0 && it.flags & flag::ERROR != 0,
                "DMA_CCR.EN: set before the channel's error flag is cleared",
            )?;
            it.ccr = value;
            return Ok(());
        }
        refuse_if(it.is_enabled(), "DMA_CNDTR, CPAR or CMAR: written while the channel is enabled")?;
        match register {
            CNDTR => (it.cndtr, it.lap) = (value & 0xFFFF, value & 0xFFFF),
            CPAR => it.cpar = value,
            CMAR => it.cmar = value,
            _ => return Err(Unknown::REGISTER),
        }
        Ok(())
    }

    /// The end of a stall. Everything else waits for a request.
    fn next_event(&self) -> Option<Cycles> {
        self.channels.iter().filter_map(|it| it.stalled_until).min()
    }

    fn advance(&mut self, now: Cycles) {
        self.channels.iter_mut().for_each(|it| it.stalled_until = it.stalled_until.filter(|end| *end > now));
    }

    fn reset(&mut self, _: Cycles) {
        self.channels = self.channels.map(|it| Channel { broken: it.broken, ..Channel::default() });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Width::{Half, Word};
    use crate::chip::testing::{read, refuses, write};

    const ISR: u32 = 0x00;
    const IFCR: u32 = 0x04;
    /// CCR2 to CMAR2.
    const CCR: u32 = 0x1C;
    const CNDTR: u32 = 0x20;
    const CPAR: u32 = 0x24;
    const CMAR: u32 = 0x28;
    const CHANNEL: usize = 1;

    /// Channel 2 with a pass of `count` transfers.
    fn ring(count: u32, ccr: u32) -> Dma {
        let mut dma = Dma::default();
        write(&mut dma, CNDTR, count, 0);
        write(&mut dma, CPAR, 0x5000_0040, 0);
        write(&mut dma, CMAR, 0x2000_0100, 0);
        write(&mut dma, CCR, ccr | EN, 0);
        dma
    }

    const HALVES: u32 = 1 << 8 | 1 << 10;

    #[test]
    fn a_circular_channel_fills_its_ring_and_begins_anew() {
        let mut dma = ring(4, HALVES | CIRC | MINC | HTIE | TCIE);
        let places: Vec<u32> = (0..6)
            .map(|_| {
                let transfer = dma.channels[CHANNEL].transfer().unwrap().unwrap();
                assert_eq!((transfer.peripheral, transfer.direction), (0x5000_0040, Direction::ToMemory));
                assert_eq!((transfer.peripheral_width, transfer.memory_width), (Half, Half));
                dma.channels[CHANNEL].complete();
                transfer.memory - 0x2000_0100
            })
            .collect();
        assert_eq!(places, [0, 2, 4, 6, 0, 2]);
        assert_eq!(read(&mut dma, CNDTR, 0), 2);
    }

    #[test]
    fn flags_come_half_way_and_at_the_end_and_go_one_by_one() {
        let mut dma = ring(4, HALVES | CIRC | MINC | HTIE);
        let mut seen = Vec::new();
        for _ in 0..4 {
            dma.channels[CHANNEL].complete();
            seen.push((read(&mut dma, ISR, 0), dma.channels[CHANNEL].irq()));
        }
        let half = (flag::GLOBAL | flag::HALF) << 4;
        assert_eq!(seen, [(0, false), (half, true), (half, true), (half | flag::COMPLETE << 4, true)]);
        // The interrupt request follows the flag whose interrupt is enabled.
        write(&mut dma, IFCR, flag::HALF << 4, 0);
        let seen = (read(&mut dma, ISR, 0), dma.channels[CHANNEL].irq());
        assert_eq!(seen, ((flag::GLOBAL | flag::COMPLETE) << 4, false));
        write(&mut dma, IFCR, flag::GLOBAL << 4, 0);
        assert_eq!(read(&mut dma, ISR, 0), 0);
    }

    #[test]
    fn all_flags_of_a_channel_are_cleared_at_once_only_while_it_is_off() {
        let mut dma = ring(2, HALVES);
        dma.errata = Errata::ALL;
        assert!(refuses(&mut dma, IFCR, flag::GLOBAL << 4, 0));
        assert_eq!(dma.write(IFCR, flag::ALL << 4, Word, 0), Ok(()));
        dma.channels[CHANNEL].fail();
        assert_eq!(dma.write(IFCR, flag::GLOBAL << 4, Word, 0), Ok(()));
        assert_eq!(read(&mut dma, ISR, 0), 0);
        // Without errata the write is always accepted.
        let mut dma = ring(2, HALVES);
        assert_eq!(dma.write(IFCR, flag::GLOBAL << 4, Word, 0), Ok(()));
    }

    #[test]
    fn a_channel_without_circ_stops() {
        let mut dma = ring(2, HALVES | MINC | TCIE);
        assert!(!dma.channels[CHANNEL].complete());
        assert!(dma.channels[CHANNEL].complete());
        assert_eq!(dma.channels[CHANNEL].transfer(), Ok(None));
        assert!(dma.channels[CHANNEL].irq() && dma.channels[CHANNEL].is_enabled());
        assert_eq!(dma.channels[CHANNEL].transfers_until_interrupt(), None);
    }

    #[test]
    fn the_interrupt_is_foretold() {
        for enabled in [HTIE, TCIE, HTIE | TCIE] {
            let mut dma = ring(6, HALVES | CIRC | MINC | enabled);
            for _ in 0..20 {
                let told = dma.channels[CHANNEL].transfers_until_interrupt().unwrap();
                let mut counted = 0;
                let mut ahead = dma.clone();
                while !ahead.channels[CHANNEL].irq() {
                    ahead.channels[CHANNEL].complete();
                    counted += 1;
                }
                assert_eq!(told, counted);
                dma.channels[CHANNEL].complete();
                write(&mut dma, IFCR, 0xF << 4, 0);
            }
        }
        assert_eq!(ring(6, HALVES | CIRC).channels[CHANNEL].transfers_until_interrupt(), None);
    }

    #[test]
    fn words_to_a_peripheral() {
        let mut dma = ring(3, 1 << 10 | DIR | MINC | PINC);
        dma.channels[CHANNEL].complete();
        let transfer = dma.channels[CHANNEL].transfer().unwrap().unwrap();
        assert_eq!(transfer.direction, Direction::ToPeripheral);
        assert_eq!((transfer.memory, transfer.peripheral), (0x2000_0102, 0x5000_0041));
    }

    #[test]
    fn what_the_manual_forbids_is_refused() {
        let mut dma = ring(4, HALVES);
        for offset in [CNDTR, CPAR, CMAR] {
            assert!(refuses(&mut dma, offset, 1, 0));
        }
        assert!(refuses(&mut dma, CCR, EN, 0));
        // Interrupt enables and CIRC may change. Once the channel is disabled, everything may.
        write(&mut dma, CCR, HALVES | EN | TCIE | CIRC, 0);
        write(&mut dma, CCR, 0, 0);
        write(&mut dma, CNDTR, 7, 0);
        assert!(dma.read(0xA8, Word, 0).is_err());
        write(&mut dma, CCR, MEM2MEM | EN, 0);
        assert!(dma.channels[CHANNEL].transfer().is_err());
        write(&mut dma, CCR, 0, 0);
        write(&mut dma, CCR, PSIZE | EN, 0);
        assert!(dma.channels[CHANNEL].transfer().is_err());
    }

    #[test]
    fn an_error_stops_the_channel_and_raises_its_line() {
        let mut dma = ring(4, HALVES | TEIE);
        assert_eq!(dma.channels[CHANNEL].transfers_until_interrupt(), None);
        dma.channels[CHANNEL].broken = true;
        assert_eq!(dma.channels[CHANNEL].transfers_until_interrupt(), Some(1));
        dma.channels[CHANNEL].fail();
        assert!(!dma.channels[CHANNEL].complete());
        assert_eq!(read(&mut dma, CNDTR, 0), 4, "it counts for nothing");
        assert!(dma.channels[CHANNEL].irq() && !dma.channels[CHANNEL].is_enabled());
        assert_eq!(read(&mut dma, ISR, 0), (flag::GLOBAL | flag::ERROR) << 4);
        assert!(refuses(&mut dma, CCR, HALVES | EN, 0));
        write(&mut dma, IFCR, flag::ERROR << 4, 0);
        write(&mut dma, CCR, HALVES | EN, 0);
        assert!(dma.channels[CHANNEL].is_enabled());
    }

    #[test]
    fn a_stalled_channel_waits() {
        let mut dma = ring(4, HALVES);
        dma.channels[CHANNEL].stalled_until = Some(100);
        dma.advance(99);
        assert_eq!((dma.channels[CHANNEL].transfer(), dma.next_event()), (Ok(None), Some(100)));
        assert_eq!(dma.channels[0].transfer(), Ok(None), "not enabled");
        dma.advance(100);
        assert!(dma.channels[CHANNEL].transfer().unwrap().is_some());
        assert_eq!(dma.next_event(), None);
    }

    #[test]
    fn fields_are_metapacs() {
        fields_agree!("DMA1", "CR", EN, TCIE, HTIE, TEIE, DIR, CIRC, PINC, MINC, PSIZE, MSIZE, PL, MEM2MEM);
        fields_agree!("DMA1", "ISR", GIF = flag::GLOBAL, TCIF = flag::COMPLETE, HTIF = flag::HALF, TEIF = flag::ERROR);
    }
}
