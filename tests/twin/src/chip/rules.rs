//! How strictly the chip treats violations by its program.

/// What happens when a program does what the manual warns of and the chip tolerates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Rules {
    /// The run ends: our image does none of it.
    #[default]
    Enforced,
    /// The same as on the chip, for foreign programs:
    ///
    /// - A peripheral without its clock ignores writes and reads zero; PWR responds as always (`stm32g4xx-hal` 0.1.0
    ///   starts boards by such a read, and issue 79 of `stm32-hal` shows an L476 that reads so and ignores the write).
    /// - The backup domain ignores writes while it is closed.
    /// - A system clock that is chosen before it runs is used once it does (RM0440 7.2.6).
    /// - The core may jump over 80 MHz, and an unused PLL may be out of its range.
    /// - The converters' regulator may be used before it has settled.
    /// - The data cache need not be reset while it is on. What it may keep of changed flash is not modelled.
    AsOnTheChip,
}
