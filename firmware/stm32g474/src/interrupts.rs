//! Which interrupt runs which handler.

use crate::{executor, lpuart, player, ready, rings, spi, usb};
use embassy_stm32::interrupt::typelevel::{Handler, Interrupt};
use embassy_stm32::{bind_interrupts, exti, interrupt, peripherals};

/// The end of each handler: no store may be pending while the exception returns, or the core may vector to the wrong
/// interrupt (Cortex-M4 r0p1, erratum 838869).
pub struct Barrier;

impl<I: Interrupt> Handler<I> for Barrier {
    unsafe fn on_interrupt() {
        cortex_m::asm::dsb();
    }
}

bind_interrupts!(pub struct Interrupts {
    USB_LP => usb::DisturbanceHandler, embassy_stm32::usb::InterruptHandler<peripherals::USB>, Barrier;
    LPUART1 => lpuart::UartHandler, Barrier;
    EXTI9_5 => exti::InterruptHandler<interrupt::typelevel::EXTI9_5>, Barrier;
    DMA1_CHANNEL3 => rings::HalfHandler, Barrier;
    DMA1_CHANNEL5 => spi::DoneHandler, Barrier;
    DMA2_CHANNEL1 => player::HalfHandler, Barrier;
    TIM2 => ready::LatchHandler, Barrier;
    UART4 => executor::SamplingHandler, Barrier;
});
