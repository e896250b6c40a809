//! The digital-to-analogue converters DAC1 and DAC2, channel 1 of each, with the settling of the output voltage.
//!
//! A write to the holding register reaches the output at once, or at the selected trigger. Each trigger requests the
//! next code by DMA. The output then settles like a first-order low-pass ([`Quality`]).
//! Not modelled, and refused: channel 2, wave generation, sample and hold, dual-channel writes, calibration.
//!
//! Sources: RM0440 chapter 22 (registers 22.7.1 to 22.7.16; DMA underrun 22.4.8; triggers, table 187); settling, gain
//! and offset from DS12288, DAC characteristics.

use super::adc::{CODES, REFERENCE_V};
use super::clocks::Clocks;
use crate::registers::{refuse, refuse_if};
use crate::{Cycles, Modelled, Registers, Unknown, Width};
use std::collections::VecDeque;

/// TSEL value of TIM7_TRGO.
pub const TRIGGER_TIM7: u32 = 2;
/// The bus clock above which HFSEL must be 2 \[Hz\].
const FAST_HZ: f64 = 160e6;
/// Minimum distance of the buffered output from the rails \[V\] (DS12288, VDAC_OUT).
const FROM_RAIL_V: f64 = 0.2;
/// Number of output changes kept. An ADC reads back less than one step.
const REMEMBERED: usize = 4;

registers! { u32:
    CR 0x00 { EN 0, TEN 1, DMAEN 12, DMAUDRIE 13 },
    DHR12R1 0x08,
    DOR1 0x2C,
    SR 0x34 { DACRDY 11, DMAUDR 13 },
    MCR 0x3C,
}
const TSEL: u32 = 0xF << 2;
const CR_KNOWN: u32 = EN | TEN | TSEL | DMAEN | DMAUDRIE;
/// HFSEL in MCR.
const HFSEL: u32 = 3 << 14;

/// Quality of the output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quality {
    /// Output voltage relative to its nominal value.
    pub gain: f64,
    /// Output voltage at code 0 \[V\].
    pub offset_v: f64,
    /// Time constant of the settling \[s\].
    pub settling_s: f64,
}

impl Default for Quality {
    /// Half of the maximum gain error and offset of DS12288; full-scale settling to half a code in 1.7 us (its typical
    /// settling time).
    fn default() -> Self {
        Self { gain: 1.0025, offset_v: 5e-3, settling_s: 0.19e-6 }
    }
}

/// A change of the output.
#[derive(Clone, Copy, Debug)]
struct Change {
    at: Cycles,
    from_v: f64,
    to_v: f64,
}

/// One converter.
#[derive(Clone, Debug, Default)]
pub struct Dac {
    cr: u32,
    mcr: u32,
    holding: u32,
    output: u32,
    underrun: bool,
    /// It requests DMA.
    pub dma_request: bool,
    hclk_hz: f64,
    /// Quality of the output.
    pub quality: Quality,
    changes: VecDeque<Change>,
}

impl Dac {
    /// Processes a timer's trigger.
    pub fn trigger(&mut self, number: u32, now: Cycles) {
        if self.cr & (EN | TEN) != EN | TEN || (self.cr & TSEL) >> 2 != number {
            return;
        }
        self.put_out(now);
        if self.cr & DMAEN != 0 && !self.underrun {
            // The previous request was not served: underrun. There are no further requests until the flag is cleared.
            self.underrun = self.dma_request;
            self.dma_request = !self.underrun;
        }
    }

    /// Level of the interrupt request.
    pub fn irq(&self) -> bool {
        self.underrun && self.cr & DMAUDRIE != 0
    }

    /// Voltage at the pin \[V\], now or shortly before; none while the output is off.
    pub fn volts(&self, at: Cycles) -> Option<f64> {
        if self.cr & EN == 0 {
            return None;
        }
        let change = self.changes.iter().rev().find(|change| change.at <= at).or(self.changes.front())?;
        let passed_s = at.saturating_sub(change.at) as f64 / self.hclk_hz;
        Some(change.to_v + (change.from_v - change.to_v) * (-passed_s / self.quality.settling_s).exp())
    }

    fn put_out(&mut self, now: Cycles) {
        self.output = self.holding;
        let Quality { gain, offset_v, .. } = self.quality;
        let ideal_v = offset_v + gain * f64::from(self.output) / CODES * REFERENCE_V;
        let to_v = ideal_v.clamp(FROM_RAIL_V, REFERENCE_V - FROM_RAIL_V);
        let from_v = self.volts(now).unwrap_or(0.0);
        self.changes.push_back(Change { at: now, from_v, to_v });
        if self.changes.len() > REMEMBERED {
            self.changes.pop_front();
        }
    }
}

impl Registers for Dac {
    fn word(&mut self, register: u32, _: Cycles) -> Modelled<u32> {
        Ok(match register {
            CR => self.cr,
            DHR12R1 => self.holding,
            DOR1 => self.output,
            SR => {
                let ready = if self.cr & EN != 0 { DACRDY } else { 0 };
                ready | if self.underrun { DMAUDR } else { 0 }
            }
            MCR => self.mcr,
            _ => return Err(Unknown::REGISTER),
        })
    }

    fn write(&mut self, offset: u32, value: u32, width: Width, now: Cycles) -> Modelled {
        if width != Width::Word {
            return Err(Unknown::WIDTH);
        }
        match offset {
            CR if value & !CR_KNOWN != 0 => {
                return refuse("DAC_CR: only channel 1 without wave generation and calibration is modelled");
            }
            CR => {
                refuse_if(
                    value & EN != 0 && self.hclk_hz > FAST_HZ && self.mcr & HFSEL != 2 << 14,
                    "DAC_MCR.HFSEL is not 2 with the bus clock above 160 MHz",
                )?;
                let starts = value & !self.cr & EN != 0;
                self.cr = value;
                if value & (EN | DMAEN) != EN | DMAEN {
                    self.dma_request = false;
                }
                if starts {
                    self.changes.clear();
                    self.put_out(now);
                }
            }
            DHR12R1 => {
                self.holding = value & 0xFFF;
                if self.cr & (EN | TEN) == EN {
                    self.put_out(now);
                }
            }
            SR => self.underrun &= value & DMAUDR == 0,
            MCR if value & !HFSEL != 0 => return refuse("DAC_MCR: only normal mode with the buffer is modelled"),
            MCR => self.mcr = value,
            _ => return Err(Unknown::REGISTER),
        }
        Ok(())
    }

    fn reset(&mut self, _: Cycles) {
        *self = Self { hclk_hz: self.hclk_hz, quality: self.quality, ..Self::default() };
    }

    fn set_clocks(&mut self, clocks: &Clocks) {
        self.hclk_hz = clocks.hclk_hz;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::{refuses, write};

    const HCLK_HZ: f64 = 168e6;

    fn dac(control: u32) -> Dac {
        let mut dac = Dac::default();
        dac.set_clocks(&Clocks { hclk_hz: HCLK_HZ, ..Clocks::POWER_ON });
        dac.quality = Quality { gain: 1.0, offset_v: 0.0, settling_s: 1e-6 };
        write(&mut dac, 0x3C, 2 << 14, 0);
        write(&mut dac, 0x08, 2048, 0);
        write(&mut dac, 0x00, control, 0);
        dac
    }

    #[test]
    fn without_a_trigger_a_code_is_put_out_at_once_and_settles() {
        let mut dac = dac(EN);
        assert_eq!(dac.volts(168_000), Some(1.65));
        write(&mut dac, 0x08, 1024, 168_000);
        // After one time constant.
        let after = dac.volts(168_000 + 168).expect("the DAC is on");
        assert!((after - (0.825 + 0.825 * (-1f64).exp())).abs() < 1e-12, "{after}");
        assert_eq!(dac.volts(167_000), Some(1.65), "looking back");
        assert_eq!(dac.read(0x2C, Width::Word, 168_200), Ok(1024));
        write(&mut dac, 0x00, 0, 200_000);
        assert_eq!(dac.volts(200_001), None);
    }

    #[test]
    fn the_buffer_does_not_reach_the_rails() {
        let mut dac = dac(EN);
        for (code, volts) in [(0, 0.2), (4095, 3.1)] {
            write(&mut dac, 0x08, code, 168_000);
            assert!((dac.volts(1_000_000).expect("the DAC is on") - volts).abs() < 1e-9);
        }
    }

    #[test]
    fn its_own_trigger_puts_out_and_asks_for_more() {
        let mut dac = dac(EN | TEN | TRIGGER_TIM7 << 2 | DMAEN | DMAUDRIE);
        write(&mut dac, 0x08, 100, 10);
        dac.trigger(TRIGGER_TIM7 + 1, 20);
        assert_eq!((dac.output, dac.dma_request), (2048, false));
        dac.trigger(TRIGGER_TIM7, 30);
        assert_eq!((dac.output, dac.dma_request), (100, true));
        dac.dma_request = false;
        dac.trigger(TRIGGER_TIM7, 40);
        assert!(dac.dma_request && !dac.irq());
        // No transfer follows.
        dac.trigger(TRIGGER_TIM7, 50);
        assert!(dac.irq() && !dac.dma_request);
        write(&mut dac, 0x34, DMAUDR, 60);
        assert!(!dac.irq());
    }

    #[test]
    fn what_is_not_modelled_is_refused() {
        let mut fast = Dac::default();
        fast.set_clocks(&Clocks { hclk_hz: HCLK_HZ, ..Clocks::POWER_ON });
        assert!(refuses(&mut fast, 0x00, EN, 0), "HFSEL");
        let mut dac = dac(EN);
        for (offset, value) in [(0x00, 1 << 16), (0x00, 1 << 6), (0x3C, 1), (0x20, 0)] {
            assert!(refuses(&mut dac, offset, value, 0), "{offset:#x}");
        }
        assert!(dac.write(0x08, 1, Width::Half, 0).is_err());
    }

    #[test]
    fn fields_are_metapacs() {
        fields_agree!("DAC1", "CR", EN, TEN, TSEL, DMAEN, DMAUDRIE);
        fields_agree!("DAC1", "SR", DACRDY, DMAUDR);
        fields_agree!("DAC1", "MCR", HFSEL);
    }
}
