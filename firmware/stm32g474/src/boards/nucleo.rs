//! NUCLEO-G474RE (MB1367). Sources: UM2505 (board), DS12288 tables 12 and 13 (pins).

use super::clock::Oscillator;
use super::parts::Parts;
use crate::clkin::Clkin;
use crate::converter::Converter;
use crate::interrupts::Interrupts;
use crate::ready::Ready;
use crate::rings::{self, Rings};
use crate::sampler::Sampler;
use crate::source::Source;
use crate::{lpuart, player, spi, usb};
use embassy_stm32::exti::ExtiInput;
use embassy_stm32::gpio::{Level, Output, Pull, Speed};
use embassy_stm32::time::Hertz;
use embassy_stm32::{Peripherals, peripherals, rcc};

/// Name of the board.
pub const NAME: &str = "nucleo-g474re";

/// X3, 24 MHz / 2 * 28 / 2 = 168 MHz.
pub const fn crystal() -> Oscillator {
    Oscillator {
        crystal: Some(rcc::Hse { freq: Hertz(24_000_000), mode: rcc::HseMode::Oscillator }),
        divider: rcc::PllPreDiv::DIV2,
        multiplier: rcc::PllMul::MUL28,
    }
}

/// Takes the pins.
///
/// | pin | use |
/// |---|---|
/// | PA0 | force, ADC1_IN1 |
/// | PA1 | terminal displacement, ADC2_IN2 |
/// | PA2, PA3 | LPUART1 TX, RX: the ST-Link's serial port |
/// | PA5 | LED LD2, lit when high |
/// | PA9 | USB's VBUS through a divider |
/// | PA11, PA12 | USB D-, D+ |
/// | PA8 | converter's CLKIN, 8 MHz: TIM1_CH1 |
/// | PA15, PB3 | encoder A, B: TIM2_CH1, TIM2_CH2 (PB3 is SWO too, an input of the ST-Link) |
/// | PA4, PA6 | self-test: volts for PA0 and PA1, DAC1_OUT1, DAC2_OUT1 |
/// | PB1, PB2 | self-test: A and B for PA15 and PB3 |
/// | PB10 | converter's DRDY: TIM2_CH3 |
/// | PB11 | converter's SYNC/RESET |
/// | PB12, PB13, PB14, PB15 | converter's CS, SCLK, DOUT, DIN: SPI2 |
pub fn wire(p: Peripherals) -> Parts {
    let encoder = rings::encoder(p.TIM2, p.PA15, p.PB3);
    let force = rings::analogue::<peripherals::ADC1>(p.PA0);
    let terminal = rings::analogue::<peripherals::ADC2>(p.PA1);
    let sampler = Sampler::new(Rings::new(force, terminal, encoder));
    let select = Output::new(p.PB12, Level::High, Speed::High);
    let converter = Converter::new(
        spi::Device::new(p.SPI2, p.PB13, p.PB15, p.PB14, select),
        Output::new(p.PB11, Level::High, Speed::Low),
        Ready::new(p.PB10),
        Clkin::new(p.TIM1, p.PA8),
    );
    Parts {
        led: Output::new(p.PA5, Level::High, Speed::Low),
        usb: usb::Peripheral::new(p.USB, Interrupts, p.PA12, p.PA11),
        vbus: Some(ExtiInput::new(p.PA9, p.EXTI9, Pull::Down, Interrupts)),
        uart: lpuart::start(p.LPUART1, p.PA3, p.PA2),
        source: Source::new(sampler, converter),
        player: player::wires(p.TIM7, (p.DAC1, p.PA4), (p.DAC2, p.PA6), p.PB1, p.PB2),
    }
}
