//! The DMA request multiplexer: routes peripheral requests to DMA channels.
//!
//! Multiplexer channels 0 to 7 serve channels 1 to 8 of DMA1, 8 to 15 those of DMA2. Synchronisation and request
//! generators are not modelled, and refused.
//!
//! Sources: RM0440 chapter 13, registers 13.6.1 to 13.6.6; request numbers, table 91 (the same in stm32-metapac 21.0).

use super::adc::Unit;
use crate::registers::refuse;
use crate::{Cycles, Modelled, Registers, Storage, Unknown, Width};

/// Number of multiplexer channels.
pub const CHANNELS: usize = 16;

/// What the modelled peripherals request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Request {
    /// A converter has a result.
    Adc(Unit),
    /// DAC1 requests a code.
    Dac1,
    /// DAC2 requests a code.
    Dac2,
    /// Update of TIM6.
    Tim6Update,
    /// Update of TIM7.
    Tim7Update,
    /// SPI2 has received data.
    Spi2Receive,
    /// SPI2 has room in its transmit FIFO.
    Spi2Transmit,
}

impl Request {
    /// All of them with their numbers, in order of service.
    pub const ALL: [(Self, u8); 11] = [
        (Self::Adc(Unit::One), 5),
        (Self::Tim6Update, 8),
        (Self::Spi2Receive, 12),
        (Self::Spi2Transmit, 13),
        (Self::Adc(Unit::Two), 36),
        (Self::Adc(Unit::Three), 37),
        (Self::Adc(Unit::Four), 38),
        (Self::Adc(Unit::Five), 39),
        (Self::Tim7Update, 9),
        (Self::Dac1, 6),
        (Self::Dac2, 41),
    ];

    /// The request with this number; none if no model raises it.
    pub fn of(number: u8) -> Option<Self> {
        Self::ALL.into_iter().find_map(|(request, its)| (its == number).then_some(request))
    }
}

// DMAMUX_CxCR.
const DMAREQ_ID: u32 = 0x7F;
const SE: u32 = 1 << 16;
/// SOIE, EGE, SE, SPOL, NBREQ, SYNC_ID.
const CCR_ALL: u32 = 0x1FFF_0300 | DMAREQ_ID;

// DMAMUX_RGxCR.
/// GNBREQ, GPOL, GE, OIE, SIG_ID.
const RGCR_ALL: u32 = 0x00FF_011F;

/// The multiplexer.
#[derive(Clone, Debug)]
pub struct Dmamux(Storage);

impl Default for Dmamux {
    fn default() -> Self {
        let channels = (0..CHANNELS as u32).map(|n| (4 * n, 0, CCR_ALL));
        let generators = (0..4).map(|n| (0x100 + 4 * n, 0, RGCR_ALL));
        // CSR and RGSR: there is no overrun without synchronisation and generators.
        let registers: Vec<_> = channels.chain(generators).chain([(0x80, 0, 0), (0x140, 0, 0)]).collect();
        Self(Storage::shared(&registers))
    }
}

impl Dmamux {
    /// Number of the request assigned to a channel; 0 is none.
    pub fn request(&self, channel: usize) -> u8 {
        (self.0[4 * channel as u32] & DMAREQ_ID) as u8
    }
}

impl Registers for Dmamux {
    fn read(&mut self, offset: u32, width: Width, _: Cycles) -> Modelled<u32> {
        if width == Width::Word { self.0.load(offset) } else { Err(Unknown::WIDTH) }
    }

    fn write(&mut self, offset: u32, value: u32, width: Width, now: Cycles) -> Modelled {
        if width != Width::Word {
            return Err(Unknown::WIDTH);
        }
        match offset {
            0x00..=0x3C if value & SE != 0 => refuse("DMAMUX_CxCR.SE: synchronisation is not modelled"),
            0x100..=0x10C if value & 1 << 16 != 0 => refuse("DMAMUX_RGxCR.GE: request generators are not modelled"),
            0x84 | 0x144 => Ok(()),
            0x80 | 0x140 => Err(Unknown::REGISTER),
            _ => self.0.write(offset, value, width, now),
        }
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
    fn a_channel_listens_to_one_request_and_a_request_may_have_many() {
        let mut mux = Dmamux::default();
        write(&mut mux, 0x04, 36, 0);
        write(&mut mux, 0x3C, 36 | 1 << 9, 0);
        assert_eq!((0..CHANNELS).map(|channel| mux.request(channel)).filter(|number| *number == 36).count(), 2);
        assert_eq!([0, 1, 15].map(|channel| mux.request(channel)), [0, 36, 36]);
        assert_eq!(mux.read(0x3C, Width::Word, 0), Ok(36 | 1 << 9));
        assert_eq!(Request::of(36), Some(Request::Adc(Unit::Two)));
        assert_eq!(Request::of(0), None);
    }

    #[test]
    fn what_is_not_modelled_is_refused() {
        let mut mux = Dmamux::default();
        assert!(refuses(&mut mux, 0x00, 1 << 16, 0));
        assert!(refuses(&mut mux, 0x100, 1 << 16, 0));
        assert!(mux.read(0x44, Width::Word, 0).is_err());
        assert!(refuses(&mut mux, 0x80, 0, 0));
    }

    #[test]
    fn fields_are_metapacs() {
        // metapac's DMAREQ_ID has one more bit, for other chips.
        fields_agree!("DMAMUX1", "CCR", SE);
        fields_agree!("DMAMUX1", "CCR", DMAREQ_ID = DMAREQ_ID | 0x80);
    }
}
