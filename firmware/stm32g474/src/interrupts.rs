//! Which interrupt runs which handler.

use crate::{executor, lpuart, ready, rings, spi, usb};
use embassy_stm32::{bind_interrupts, exti, interrupt, peripherals};

bind_interrupts!(pub struct Interrupts {
    USB_LP => usb::DisturbanceHandler, embassy_stm32::usb::InterruptHandler<peripherals::USB>;
    LPUART1 => lpuart::UartHandler;
    EXTI9_5 => exti::InterruptHandler<interrupt::typelevel::EXTI9_5>;
    DMA1_CHANNEL3 => rings::HalfHandler;
    DMA1_CHANNEL5 => spi::DoneHandler;
    TIM2 => ready::LatchHandler;
    UART4 => executor::SamplingHandler;
});
