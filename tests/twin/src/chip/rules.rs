//! How strictly the chip treats violations by the program.

/// What happens when a program does something that the manual forbids and the chip tolerates.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Rules {
    /// The run ends. Our image does none of this.
    #[default]
    Enforced,
    /// The chip's behaviour, for third-party programs:
    ///
    /// - A peripheral without a clock ignores writes and reads zero. PWR always responds (`stm32g4xx-hal` 0.1.0 relies
    ///   on such a read at start, and issue 79 of `stm32-hal` shows an L476 that reads this way and ignores the write).
    /// - The backup domain ignores writes while it is write-protected.
    /// - A system clock that is selected before it is ready is used once it is ready (RM0440 7.2.6).
    /// - The core may cross 80 MHz without the AHB / 2 step, and an unused PLL may be out of range.
    /// - The ADC's voltage regulator may be used before it has settled.
    /// - Resetting the data cache while it is on has no effect. Reads of changed flash are allowed without a reset and
    ///   return the new contents: stale cache contents are not modelled.
    AsOnTheChip,
}
