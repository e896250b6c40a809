//! What all converters need before they convert.

use crate::boards::clock::CORE_PER_US;
use embassy_stm32::pac::adc::Adc;
use embassy_stm32::pac::adc::vals::Adcaldif;

/// Start-up time of the voltage regulator, in us (DS12288, table 66).
const REGULATOR_US: u32 = 20;

/// Regulator, calibration for single-ended inputs, on (RM0440, 21.4.6 to 21.4.9). Takes 25 us.
///
/// The clock of the converter must have been chosen before.
pub fn switch_on(adc: Adc) {
    adc.cr().modify(|w| w.set_deeppwd(false));
    adc.cr().modify(|w| w.set_advregen(true));
    cortex_m::asm::delay(REGULATOR_US * CORE_PER_US);
    adc.cr().modify(|w| {
        w.set_adcaldif(Adcaldif::SINGLE_ENDED);
        w.set_adcal(true);
    });
    while adc.cr().read().adcal() {}
    // ADEN may follow 4 converter clocks after the calibration at the earliest.
    cortex_m::asm::delay(CORE_PER_US);
    adc.isr().write(|w| w.set_adrdy(true));
    adc.cr().modify(|w| w.set_aden(true));
    while !adc.isr().read().adrdy() {}
}
