//! How strictly the chip takes its program.

/// What happens where a program does what the manual warns of and the chip lets pass.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Rules {
    /// The run ends: our image does none of it.
    #[default]
    Enforced,
    /// The same as on the chip, for programs of others:
    ///
    /// - A peripheral without its clock ignores writes and answers zero; PWR answers as ever (`stm32g4xx-hal` 0.1.0 starts
    ///   boards by such a read, and issue 79 of `stm32-hal` shows an L476 that answers so and ignores the write).
    /// - The backup domain ignores writes while it is shut.
    /// - A system clock that is chosen before it runs is used from when it does (RM0440 7.2.6).
    /// - The core may jump over 80 MHz, and a PLL that nobody uses may be out of its range.
    /// - The converters' regulator is used before it has settled.
    /// - The data cache is not reset while it is on. What it may keep of flash that has changed is not modelled.
    AsOnTheChip,
}
