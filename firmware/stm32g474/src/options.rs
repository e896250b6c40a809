//! The one option that matters: at which supply voltage the chip holds itself in reset.

use core::arch::asm;
use embassy_stm32::pac::FLASH;
use inerter_wire::ResetCause;

/// Level 4, 2.8 V. Below 3.0 V USB is out of its range and the analogue supply, against which force is measured, is
/// not what the scale was found with: better no measurement than that one. A supply of 3.3 V keeps 0.4 V to it.
const BROWN_OUT_LEVEL: u8 = 4;
/// Keys (RM0440, 3.3.5 and 3.4.2).
const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];
const OPTION_KEYS: [u32; 2] = [0x0819_2A3B, 0x4C5D_6E7F];

/// Sets the brown-out level if it is lower, which takes a reset; a device comes here once in its life.
///
/// Not again after the reset that this makes: an option that cannot be written must not keep the device from starting.
pub fn check(cause: ResetCause) {
    if FLASH.optr().read().bor_lev() >= BROWN_OUT_LEVEL || cause == ResetCause::OptionBytes {
        return;
    }
    while FLASH.sr().read().bsy() {}
    for key in KEYS {
        FLASH.keyr().write_value(key);
    }
    for key in OPTION_KEYS {
        FLASH.optkeyr().write_value(key);
    }
    FLASH.optr().modify(|w| w.set_bor_lev(BROWN_OUT_LEVEL));
    FLASH.cr().modify(|w| w.set_optstrt(true));
    while FLASH.sr().read().bsy() {}
    FLASH.cr().modify(|w| w.set_obl_launch(true));
    // SAFETY: stands still, as the reset takes a moment.
    unsafe { asm!("b .", options(noreturn)) }
}
