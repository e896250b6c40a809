//! Set-up that all converters need.

use crate::boards::clock::CORE_PER_US;
use embassy_stm32::pac::adc::Adc;
use embassy_stm32::pac::adc::vals::Adcaldif;
use embassy_stm32::pac::adccommon::AdcCommon;
use embassy_stm32::pac::adccommon::vals::{Ckmode, Presc};

/// Start-up time of the voltage regulator, in us (DS12288, table 66).
const REGULATOR_US: u32 = 20;

/// Polls of the converter, of at least 10 cycles each: the calibration takes 500 cycles.
const POLLS: u32 = 500;

/// Sets the clock of a block of converters, all off: [`ADC_HZ`](crate::boards::clock::ADC_HZ), undivided.
pub fn choose_clock(block: AdcCommon) {
    block.ccr().modify(|w| {
        w.set_ckmode(Ckmode::ASYNCHRONOUS);
        w.set_presc(Presc::DIV1);
    });
}

/// Starts the regulator, calibrates for single-ended inputs and switches on (RM0440, 21.4.6 to 21.4.9). Takes 25 us.
/// Returns whether the converter is ready.
///
/// The clock of the converter must have been set before.
#[must_use]
pub fn switch_on(adc: Adc) -> bool {
    adc.cr().modify(|w| w.set_deeppwd(false));
    adc.cr().modify(|w| w.set_advregen(true));
    cortex_m::asm::delay(REGULATOR_US * CORE_PER_US);
    adc.cr().modify(|w| {
        w.set_adcaldif(Adcaldif::SINGLE_ENDED);
        w.set_adcal(true);
    });
    if !(0..POLLS).any(|_| !adc.cr().read().adcal()) {
        return false;
    }
    // ADEN may be set 4 converter clocks after the calibration at the earliest.
    cortex_m::asm::delay(CORE_PER_US);
    adc.isr().write(|w| w.set_adrdy(true));
    adc.cr().modify(|w| w.set_aden(true));
    (0..POLLS).any(|_| adc.isr().read().adrdy())
}
