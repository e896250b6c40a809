//! The core's clock, the same on every board, and the oscillator from which it is derived.

use embassy_stm32::rcc;

/// Clock of the core and of all buses and timers, in Hz.
///
/// Not the chip's maximum of 170 MHz: 168 MHz is exactly 2625 times 64 kHz.
pub const CORE_HZ: u32 = 168_000_000;
/// The same, per microsecond.
pub const CORE_PER_US: u32 = CORE_HZ / 1_000_000;
/// Clock of all converters, in Hz: the PLL's own output for them, not divided further. ES0430 2.7.11: converters that
/// run at the same time disturb each other, unless their clocks have one source and are divided by 1, or the triggers'
/// period is a multiple of the divider, and no suitable divider divides 2625.
pub const ADC_HZ: u32 = 2 * CORE_HZ / 8;

/// The RTC has no clock: ES0430, "unstable LSI when it clocks RTC", and the watchdog counts the LSI, which it switches
/// on when it starts.
pub const NO_RTC: rcc::LsConfig = rcc::LsConfig::off();

/// Source of the core's clock: 168 MHz after multiplication.
pub struct Oscillator {
    /// The crystal, or `None` for the chip's own 16 MHz.
    pub crystal: Option<rcc::Hse>,
    /// Divides the oscillator before the PLL.
    pub divider: rcc::PllPreDiv,
    /// Multiplies to 336 MHz; half of that is the core's clock, an eighth the converters'.
    pub multiplier: rcc::PllMul,
}

impl Oscillator {
    /// 16 MHz / 4 * 84 / 2 = 168 MHz, to about 1 %: for a board whose crystal does not start.
    pub const INTERNAL: Self = Self { crystal: None, divider: rcc::PllPreDiv::DIV4, multiplier: rcc::PllMul::MUL84 };

    /// All clocks, with the core at half of [`CORE_HZ`], because it must not step there from below 80 MHz: see
    /// `clocks.rs`. USB runs from the chip's 48 MHz oscillator, trimmed by the host's start of frame.
    pub fn clocks(self) -> rcc::Config {
        let mut config = rcc::Config::new();
        config.hse = self.crystal;
        config.hsi48 = Some(rcc::Hsi48Config { sync_from_usb: true });
        config.pll = Some(rcc::Pll {
            source: if self.crystal.is_some() { rcc::PllSource::HSE } else { rcc::PllSource::HSI },
            prediv: self.divider,
            mul: self.multiplier,
            divp: Some(rcc::PllPDiv::DIV8),
            divq: None,
            divr: Some(rcc::PllRDiv::DIV2),
        });
        config.sys = rcc::Sysclk::PLL1_R;
        config.ahb_pre = rcc::AHBPrescaler::DIV2;
        // Required above 150 MHz (RM0440, 6.1.5).
        config.boost = true;
        config.mux.clk48sel = rcc::mux::Clk48sel::HSI48;
        config.mux.adc12sel = rcc::mux::Adcsel::PLL1_P;
        config.mux.adc345sel = rcc::mux::Adcsel::PLL1_P;
        config.ls = NO_RTC;
        config
    }
}
