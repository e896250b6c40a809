//! Starts the clocks, from the crystal if it runs.

use crate::boards;
use crate::boards::clock::{CORE_HZ, CORE_PER_US, NO_RTC, Oscillator};
use embassy_stm32::pac::flash::vals::Latency;
use embassy_stm32::pac::pwr::regs::Cr5;
use embassy_stm32::pac::rcc::vals::{Hpre, Sw};
use embassy_stm32::pac::timer::vals::Urs;
use embassy_stm32::pac::{FLASH, PWR, RCC, TIM15};
use embassy_stm32::{Config, Peripherals, rcc};
use embassy_time::TICK_HZ;
use inerter_wire::ClockSource;

/// Polls of the crystal, for 100 ms: at least 5 cycles each of the 16 MHz clock that the core then has. The crystal
/// needs 2 ms (DS12288, table 41).
const POLLS: u32 = 320_000;

/// After the ROM, restores the clocks that a reset leaves: the chip's own oscillator alone.
pub fn stop() {
    RCC.cr().modify(|w| w.set_hsion(true));
    let _ = (0..POLLS).any(|_| RCC.cr().read().hsirdy());
    RCC.cfgr().write(|w| w.set_sw(Sw::HSI));
    let _ = (0..POLLS).any(|_| RCC.cfgr().read().sws() == Sw::HSI);
    RCC.cr().modify(|w| w.set_pllon(false));
    let _ = (0..POLLS).any(|_| !RCC.cr().read().pllrdy());
    RCC.crrcr().modify(|w| w.set_hsi48on(false));
}

/// Starts all clocks and returns their source.
///
/// embassy-stm32 waits for oscillators and PLL without a time limit; the watchdog, already running, ends a wait that
/// hangs.
pub fn start() -> (ClockSource, Peripherals) {
    RCC.cr().modify(|w| w.set_hseon(true));
    let crystal_runs = (0..POLLS).any(|_| RCC.cr().read().hserdy());
    let oscillator = if crystal_runs { boards::crystal() } else { Oscillator::INTERNAL };
    if crystal_runs {
        // From here on a crystal that stops raises NMI: the failure is noticed, and nothing waits for the crystal.
        RCC.cr().modify(|w| w.set_csson(true));
    }
    // First at the 16 MHz of the chip's own oscillator. From here to `reinit` the clock of embassy-time must not reach
    // half of its timer's range, 33 ms, because `reinit` resets the timer but not the count of its overflows.
    let mut config = Config::default();
    config.rcc.ls = NO_RTC;
    // Leaves it on.
    config.rcc.hse = oscillator.crystal;
    let mut peripherals = embassy_stm32::init(config);
    // Range 1 boost, for more than 150 MHz (RM0440 6.4.5: R1MODE, bit 8, to 0; the register has no other bit).
    // stm32-metapac 21 has the bit in another place, so embassy-stm32's own setting has no effect.
    PWR.cr5().write_value(Cr5(0));
    rcc::reinit(oscillator.clocks(), &mut peripherals.RCC);
    full_speed();
    (if crystal_runs { ClockSource::Crystal } else { ClockSource::Internal }, peripherals)
}

/// Switches from half the core's clock to the full clock.
///
/// A step from below 80 MHz to more must stay at half for 1 us (RM0440 7.2.7); embassy-stm32 switches at once. Of
/// everything that takes its frequency from embassy-stm32, only the clock of embassy-time is in use; it is adjusted
/// here.
fn full_speed() {
    cortex_m::asm::delay(CORE_PER_US);
    FLASH.acr().modify(|w| w.set_latency(Latency::WS4));
    // Otherwise the core would read wrong instructions.
    assert!(
        (0..POLLS).any(|_| FLASH.acr().read().latency() == Latency::WS4),
        "the flash does not take its wait states"
    );
    critical_section::with(|_| {
        RCC.cfgr().modify(|w| w.set_hpre(Hpre::DIV1));
        TIM15.psc().write_value((CORE_HZ / TICK_HZ as u32 - 1) as u16);
        // Loads the prescaler, without an interrupt.
        TIM15.cr1().modify(|w| w.set_urs(Urs::COUNTER_ONLY));
        TIM15.egr().write(|w| w.set_ug(true));
        TIM15.cr1().modify(|w| w.set_urs(Urs::ANY_EVENT));
    });
}
