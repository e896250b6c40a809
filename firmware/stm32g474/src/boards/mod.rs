//! The boards, one file each: pins, clocks and name.
//!
//! Another board is one more file with the same items, and a feature that chooses it.

use crate::lpuart;
use crate::source::Source;
use crate::usb;
use embassy_stm32::exti::ExtiInput;
use embassy_stm32::gpio::Output;
use embassy_stm32::mode::Async;
use embassy_stm32::rcc;

#[cfg(all(feature = "board-nucleo", feature = "board-weact"))]
compile_error!("choose one board: board-weact goes with --no-default-features");
#[cfg(not(any(feature = "board-nucleo", feature = "board-weact")))]
compile_error!("choose a board: board-nucleo or board-weact");

#[cfg(feature = "board-nucleo")]
mod nucleo;
#[cfg(all(feature = "board-weact", not(feature = "board-nucleo")))]
mod weact;

#[cfg(feature = "board-nucleo")]
pub use nucleo::{NAME, crystal, wire};
#[cfg(all(feature = "board-weact", not(feature = "board-nucleo")))]
pub use weact::{NAME, crystal, wire};

/// Clock of the core and of all buses and timers, in Hz.
///
/// Not the 170 MHz that the chip can do: 168 MHz is 2625 times 64 kHz, exactly.
pub const CORE_HZ: u32 = 168_000_000;
/// The same, in a microsecond.
pub const CORE_PER_US: u32 = CORE_HZ / 1_000_000;

/// What is wired to the chip, ready for use.
pub struct Parts {
    /// Lit when high; lit from the start.
    pub led: Output<'static>,
    /// USB, not started yet.
    pub usb: usb::Peripheral,
    /// High while a host powers the bus; `None` where the board cannot tell.
    pub vbus: Option<ExtiInput<'static, Async>>,
    /// The second link.
    pub uart: lpuart::Uart,
    /// Encoder and both front ends.
    pub source: Source,
}

/// Where the core's clock comes from: 168 MHz after multiplication.
pub struct Oscillator {
    /// The crystal, or nothing for the chip's own 16 MHz.
    pub crystal: Option<rcc::Hse>,
    /// Divides the oscillator before the PLL.
    pub divider: rcc::PllPreDiv,
    /// Multiplies, to 336 MHz; half of that is the core's clock.
    pub multiplier: rcc::PllMul,
}

impl Oscillator {
    /// 16 MHz / 4 * 84 / 2 = 168 MHz, about 1 %: for a board whose crystal does not start.
    pub const INTERNAL: Self = Self { crystal: None, divider: rcc::PllPreDiv::DIV4, multiplier: rcc::PllMul::MUL84 };

    /// All clocks. USB runs from the chip's 48 MHz oscillator, trimmed by the host's start of frame.
    pub fn clocks(self) -> rcc::Config {
        let mut config = rcc::Config::new();
        config.hse = self.crystal;
        config.hsi48 = Some(rcc::Hsi48Config { sync_from_usb: true });
        config.pll = Some(rcc::Pll {
            source: if self.crystal.is_some() { rcc::PllSource::HSE } else { rcc::PllSource::HSI },
            prediv: self.divider,
            mul: self.multiplier,
            divp: None,
            divq: None,
            divr: Some(rcc::PllRDiv::DIV2),
        });
        config.sys = rcc::Sysclk::PLL1_R;
        // Above 150 MHz (RM0440, 6.1.5).
        config.boost = true;
        config.mux.clk48sel = rcc::mux::Clk48sel::HSI48;
        config
    }
}
