//! Pins that belong to a peripheral.

use embassy_stm32::gpio::{AfType, Flex};

/// Connects a pin to a peripheral for good. Inlined at each pin it would take more flash.
#[inline(never)]
pub fn connect(mut pin: Flex<'static>, function: u8, kind: AfType) {
    pin.set_as_af_unchecked(function, kind);
    // Dropped, it would be disconnected.
    core::mem::forget(pin);
}
