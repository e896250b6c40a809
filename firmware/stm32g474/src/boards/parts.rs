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
    /// High while a host powers the bus; `None` where the board cannot tell.
    pub vbus: Option<ExtiInput<'static, Async>>,
    /// The second link.
    pub uart: lpuart::Uart,
    /// Encoder and both front ends.
    pub source: Source,
    /// Outputs that jumpers lead back to them, for the self-test.
    pub player: player::Wires,
}
