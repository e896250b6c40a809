//! The relevant option bytes: the supply voltage below which the chip holds itself in reset, and the boot from flash.
//!
//! Boards are delivered with various values (`docs/HARDWARE.md`). nSWBOOT0 is kept: it decides whether a pin can select
//! update mode, and not every board leaves that pin free. DBANK is kept: in the other mode the program would be at
//! another address.

use crate::flash;
use embassy_stm32::pac::FLASH;
use embassy_stm32::pac::flash::regs::Optr;
use inerter_wire::ResetCause;

/// Level 4, 2.8 V. Below 3.0 V the supply is out of range for USB, and the analogue supply, the reference of the force
/// measurement, differs from that at calibration: a missing measurement is better than a wrong one. A supply of 3.3 V
/// is 0.4 V above.
const BROWN_OUT_LEVEL: u8 = 4;
/// Keys of the option bytes (RM0440, 3.4.2).
const OPTION_KEYS: [u32; 2] = [0x0819_2A3B, 0x4C5D_6E7F];

/// Polls of the flash, for 50 ms: at least 8 cycles each of the 16 MHz clock that the core has here. Option bytes take
/// 22 ms for the erase and 82 us for each double word (DS12288, table 50).
const POLLS: u32 = 100_000;
/// 1 ms.
const LAUNCH_CYCLES: u32 = 16_000;

/// Whether a reset starts the ROM, whatever the boot pin: nBOOT0 replaces the pin and selects the ROM, or the ROM
/// chooses between the banks (RM0440 2.6).
pub fn start_in_rom() -> bool {
    let options = FLASH.optr().read();
    options.bfb2() || !options.n_swboot0() && !options.n_boot0()
}

/// The option bytes in use, and the wanted ones.
pub fn in_use_and_wanted() -> (u32, u32) {
    let options = FLASH.optr().read();
    (options.0, wanted(options).0)
}

/// The wanted option bytes; the brown-out level may be higher.
fn wanted(mut options: Optr) -> Optr {
    options.set_bor_lev(options.bor_lev().max(BROWN_OUT_LEVEL));
    // If nBOOT0 decides: boot from flash. If the pin decides and is high: boot the ROM, not RAM.
    options.set_n_boot0(true);
    options.set_n_boot1(true);
    // Otherwise the ROM would start the program even if update mode is wanted.
    options.set_bfb2(false);
    options
}

/// Sets the options if they differ from the wanted ones, which takes a reset; a device does this once in its life.
///
/// Not repeated after the reset that this causes, nor after one by the watchdog: an option that cannot be written must
/// not prevent the device from starting.
pub fn check(cause: ResetCause) {
    let now = FLASH.optr().read();
    if wanted(now) == now || matches!(cause, ResetCause::OptionBytes | ResetCause::Watchdog) {
        return;
    }
    if !is_idle() {
        return;
    }
    // An earlier error would prevent the operation.
    flash::clear_errors();
    // The ROM may have left both unlocked.
    flash::unlock();
    if FLASH.cr().read().optlock() {
        for key in OPTION_KEYS {
            FLASH.optkeyr().write_value(key);
        }
    }
    FLASH.optr().write_value(wanted(now));
    FLASH.cr().modify(|w| w.set_optstrt(true));
    if !is_idle() {
        return;
    }
    FLASH.cr().modify(|w| w.set_obl_launch(true));
    // The reset happens meanwhile; if it does not, the options take effect at the next one.
    cortex_m::asm::delay(LAUNCH_CYCLES);
}

/// Whether the flash is idle, or becomes so in time.
fn is_idle() -> bool {
    (0..POLLS).any(|_| !FLASH.sr().read().bsy())
}
