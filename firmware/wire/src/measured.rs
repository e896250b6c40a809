//! What a board measures of itself: raw numbers, which the host evaluates.

use heapless::Vec;
use serde::{Deserialize, Serialize};

/// Figures that one message can carry.
pub const MAX_FIGURES: usize = 16;

/// What a board can be asked to measure of itself. New ones go at the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Measure {
    /// The chip: identity, flash, option bytes, cause of its start, stack.
    Chip,
    /// The clocks against each other; takes a second.
    Clocks,
    /// The chip's own voltage reference and temperature sensor, each with its factory value.
    Supply,
    /// Cycles of the processor by activity; takes a second.
    Work,
    /// Nothing: after the reply the firmware hangs until its watchdog resets it. For the test of the watchdog.
    Hang,
}

/// What a figure is: its number on the wire. New ones go at the end.
///
/// Name, label and unit are those at the same place in the catalogue's
/// [`Group::Measured`](crate::catalogue::Group::Measured).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Quantity {
    /// DBGMCU_IDCODE (RM0440 47.6.1): device in bits 11 to 0, revision in bits 31 to 16.
    DeviceId,
    /// Flash of the chip (RM0440 48.2).
    FlashKb,
    /// Package register (RM0440 48.3).
    Package,
    /// FLASH_OPTR as in use (RM0440 3.7.8).
    OptionBytes,
    /// FLASH_OPTR as the firmware wants it.
    OptionBytesWanted,
    /// RCC_CSR at the start (RM0440 7.4.30).
    ResetFlags,
    /// Whole stack.
    StackBytes,
    /// Stack never used so far.
    StackFreeBytes,
    /// Saves that the flash can still take now.
    SavesLeft,
    /// Clock of the core that the firmware was built for.
    CoreHz,
    /// USB frames, one per millisecond of the host's clock.
    UsbFrames,
    /// Cycles of the core's clock in these frames.
    UsbFramesCycles,
    /// Periods of the chip's 32 kHz oscillator, by which the watchdog counts.
    LsiPeriods,
    /// Cycles of the core's clock in these periods.
    LsiPeriodsCycles,
    /// A time by the firmware's own clock.
    ClockUs,
    /// Cycles of the core's clock in that time.
    ClockUsCycles,
    /// RCC_CR (RM0440 7.4.1): which oscillators run.
    ClockControl,
    /// CRS_ISR (RM0440 8.7.3): how the 48 MHz oscillator follows the USB's frames.
    RecoveryStatus,
    /// Conversion of the voltage reference, 12 bits.
    ReferenceCode,
    /// The same at the factory, with a supply of 3.0 V.
    ReferenceFactoryCode,
    /// Conversion of the temperature sensor, 12 bits.
    TemperatureCode,
    /// The same at the factory, at 30 degrees Celsius and a supply of 3.0 V.
    TemperatureFactory30Code,
    /// The same at 130 degrees.
    TemperatureFactory130Code,
    /// Time over which cycles of work were counted.
    WorkUs,
    /// Of that, time with nothing to do.
    IdleUs,
    /// Cycles spent in the sampling interrupt, including what interrupted it.
    SamplingCycles,
    /// Cycles of the estimator's task, without the sampling that interrupted it; likewise for the tasks that follow.
    EstimatingCycles,
    /// Cycles of the task that sends.
    TelemetryCycles,
    /// Cycles of the task that serves requests.
    CommandsCycles,
    /// Cycles of the USB task.
    UsbCycles,
    /// Cycles of the task for health, LED and watchdog.
    SupervisingCycles,
}

/// One number that a board measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Figure {
    /// A [`Quantity`], or one that this reader does not know.
    pub quantity: u8,
    /// In the unit of the quantity.
    pub value: u32,
}

/// What a board measured of itself. It leaves out what it cannot measure.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Measured {
    /// What it was requested to measure.
    pub what: Measure,
    /// What it found.
    pub figures: Vec<Figure, MAX_FIGURES>,
}

impl Measured {
    /// Nothing yet.
    pub const fn new(what: Measure) -> Self {
        Self { what, figures: Vec::new() }
    }

    /// Adds a figure; drops it if there is no room.
    #[inline(never)]
    pub fn push(&mut self, quantity: Quantity, value: u32) {
        let _ = self.figures.push(Figure { quantity: quantity as u8, value });
    }

    /// The figure of this quantity; `None` where there is none, or more than one.
    pub fn get(&self, quantity: Quantity) -> Option<u32> {
        let mut all = self.figures.iter().filter(|figure| figure.quantity == quantity as u8);
        all.next().filter(|_| all.next().is_none()).map(|figure| figure.value)
    }
}
