//! The converter's clock: TIM1 divides the core's clock to 8 MHz, on demand.

use crate::boards::clock::CORE_HZ;
use crate::pins;
use embassy_stm32::gpio::{AfType, Flex, OutputType, Speed};
use embassy_stm32::pac::timer::vals::Ocm;
use embassy_stm32::pac::{RCC, TIM1};
use embassy_stm32::timer::{Ch1, TimerPin};
use embassy_stm32::{Peri, peripherals};

/// The clock, in Hz: 168 MHz / 21.
pub const HZ: u32 = 8_000_000;
/// Core clocks per period: 21. High for 10 of them: 48 %; the converter accepts 40 to 60.
const PERIOD: u16 = (CORE_HZ / HZ) as u16;
const _: () = assert!(PERIOD as u32 * HZ == CORE_HZ);

/// The clock, low until it starts.
pub struct Clkin {
    _private: (),
}

impl Clkin {
    /// Takes timer and pin.
    pub fn new(
        _timer: Peri<'static, peripherals::TIM1>,
        pin: Peri<'static, impl TimerPin<peripherals::TIM1, Ch1>>,
    ) -> Self {
        let function = pin.af_num();
        pins::connect(Flex::new(pin), function, AfType::output(OutputType::PushPull, Speed::VeryHigh));
        critical_section::with(|_| RCC.apb2enr().modify(|w| w.set_tim1en(true)));
        TIM1.arr().write(|w| w.set_arr(PERIOD - 1));
        TIM1.ccr(0).write(|w| w.set_ccr(PERIOD / 2));
        TIM1.ccmr_output(0).write(|w| w.set_ocm(0, Ocm::PWM_MODE1));
        TIM1.ccer().write(|w| w.set_cce(0, true));
        TIM1.bdtr().write(|w| w.set_moe(true));
        Self { _private: () }
    }

    /// Starts the clock, or leaves it running.
    pub fn start(&mut self) {
        TIM1.cr1().write(|w| w.set_cen(true));
    }
}
