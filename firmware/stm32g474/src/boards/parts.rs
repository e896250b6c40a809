//! The parts that every board provides.

use crate::source::Source;
use crate::{lpuart, player, usb};
use embassy_stm32::exti::ExtiInput;
use embassy_stm32::gpio::Output;
use embassy_stm32::mode::Async;

/// The parts wired to the chip, ready for use.
pub struct Parts {
    /// Lit when high; lit from the start.
    pub led: Output<'static>,
    /// USB, not started yet.
    pub usb: usb::Peripheral,
    /// High while a host powers the bus; `None` if the board cannot detect it.
    pub vbus: Option<ExtiInput<'static, Async>>,
    /// The second link.
    pub uart: lpuart::Uart,
    /// Encoder and both front ends.
    pub source: Source,
    /// Outputs that jumpers connect to the inputs, for the self-test.
    pub player: player::Wires,
}
