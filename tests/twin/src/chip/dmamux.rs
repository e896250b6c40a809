//! The DMA request multiplexer: routes peripheral requests to DMA channels.
//!
//! Multiplexer channels 0 to 7 serve channels 1 to 8 of DMA1, 8 to 15 those of DMA2. Synchronisation and request
//! generators are not modelled, and refused.
//!
//! Sources: RM0440 chapter 13, registers 13.6.1 to 13.6.6; request numbers, table 91 (the same in stm32-metapac 21.0).

use crate::registers::refuse;
use crate::{Cycles, Modelled, Registers, Unknown, Width};

/// Number of multiplexer channels.
pub const CHANNELS: usize = 16;

/// Request numbers of the modelled peripherals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Request {
    /// ADC1 has a result.
    Adc1 = 5,
    /// DAC1 requests a code.
    Dac1 = 6,
    /// Update of TIM6.
    Tim6Update = 8,
    /// Update of TIM7.
    Tim7Update = 9,
    /// SPI2 has received data.
    Spi2Receive = 12,
    /// SPI2 has room in its transmit FIFO.
    Spi2Transmit = 13,
    /// ADC2 has a result.
    Adc2 = 36,
    /// ADC3 has a result.
    Adc3 = 37,
    /// ADC4 has a result.
    Adc4 = 38,
    /// ADC5 has a result.
    Adc5 = 39,
    /// DAC2 requests a code.
    Dac2 = 41,
}

impl Request {
    /// All of them, in order of service.
    pub const ALL: [Self; 11] = [
        Self::Adc1,
        Self::Tim6Update,
        Self::Spi2Receive,
        Self::Spi2Transmit,
        Self::Adc2,
        Self::Adc3,
        Self::Adc4,
        Self::Adc5,
        Self::Tim7Update,
        Self::Dac1,
        Self::Dac2,
    ];

    /// The request with this number; none if no model raises it.
    pub fn of(number: u8) -> Option<Self> {
        Self::ALL.into_iter().find(|request| *request as u8 == number)
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
#[derive(Clone, Debug, Default)]
pub struct Dmamux {
    channels: [u32; CHANNELS],
    generators: [u32; 4],
}

impl Dmamux {
    /// Number of the request assigned to a channel; 0 is none.
    pub fn request(&self, channel: usize) -> u8 {
        self.channels.get(channel).map_or(0, |ccr| (ccr & DMAREQ_ID) as u8)
    }

    /// Channels to which the request is assigned.
    pub fn listeners(&self, request: Request) -> impl Iterator<Item = usize> {
        (0..CHANNELS).filter(move |channel| self.request(*channel) == request as u8)
    }
}

impl Registers for Dmamux {
    fn read(&mut self, offset: u32, width: Width, _: Cycles) -> Modelled<u32> {
        if width != Width::Word {
            return Err(Unknown::WIDTH);
        }
        let place = (offset / 4) as usize;
        match offset {
            0x00..=0x3C => Ok(self.channels.get(place).copied().unwrap_or(0)),
            // There is no overrun without synchronisation and generators.
            0x80 | 0x140 => Ok(0),
            0x100..=0x10C => Ok(self.generators.get(place - 0x40).copied().unwrap_or(0)),
            _ => Err(Unknown::REGISTER),
        }
    }

    fn write(&mut self, offset: u32, value: u32, width: Width, _: Cycles) -> Modelled {
        if width != Width::Word {
            return Err(Unknown::WIDTH);
        }
        let place = (offset / 4) as usize;
        match offset {
            0x00..=0x3C if value & SE != 0 => return refuse("DMAMUX_CxCR.SE: synchronisation is not modelled"),
            0x00..=0x3C => {
                if let Some(channel) = self.channels.get_mut(place) {
                    *channel = value & CCR_ALL;
                }
            }
            0x84 | 0x144 => {}
            0x100..=0x10C if value & 1 << 16 != 0 => {
                return refuse("DMAMUX_RGxCR.GE: request generators are not modelled");
            }
            0x100..=0x10C => {
                if let Some(generator) = self.generators.get_mut(place - 0x40) {
                    *generator = value & RGCR_ALL;
                }
            }
            _ => return Err(Unknown::REGISTER),
        }
        Ok(())
    }

    fn reset(&mut self, _: Cycles) {
        *self = Self::default();
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
        assert_eq!(mux.listeners(Request::Adc2).collect::<Vec<_>>(), [1, 15]);
        assert_eq!((mux.request(0), mux.request(1)), (0, 36));
        assert_eq!(mux.read(0x3C, Width::Word, 0), Ok(36 | 1 << 9));
        assert_eq!(Request::of(36), Some(Request::Adc2));
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
