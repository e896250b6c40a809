//! The options that matter: the supply voltage below which the chip holds itself in reset, and the start from flash.
//!
//! Boards come with any of them (`docs/HARDWARE.md`). nSWBOOT0 is kept: it decides whether a pin can select update
//! mode, and not every board leaves that pin free. DBANK is kept: in the other mode the program would lie elsewhere.

use crate::flash;
use embassy_stm32::pac::FLASH;
use embassy_stm32::pac::flash::regs::Optr;
use inerter_wire::ResetCause;

/// Level 4, 2.8 V. Below 3.0 V USB is out of its range and the analogue supply, against which force is measured, is
/// not that of the calibration: a missing measurement is better than a wrong one. A supply of 3.3 V is 0.4 V above.
const BROWN_OUT_LEVEL: u8 = 4;
/// Keys (RM0440, 3.3.5 and 3.4.2).
const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];
const OPTION_KEYS: [u32; 2] = [0x0819_2A3B, 0x4C5D_6E7F];

/// Polls of the flash, for 50 ms: at least 8 cycles each of the 16 MHz that the core runs from here. Option bytes take
/// 22 ms for the erase and 82 us for each double word (DS12288, table 50).
const POLLS: u32 = 100_000;
/// For 1 ms.
const LAUNCH_CYCLES: u32 = 16_000;

/// Whether a reset starts the ROM, whatever the boot pin: nBOOT0 is used in place of the pin and selects the ROM, or
/// the ROM chooses between the banks (RM0440 2.6).
pub fn start_in_rom() -> bool {
    let options = FLASH.optr().read();
    options.bfb2() || !options.n_swboot0() && !options.n_boot0()
}

/// The option bytes in use, and as they should be.
pub fn in_use_and_wanted() -> (u32, u32) {
    let options = FLASH.optr().read();
    (options.0, wanted(options).0)
}

/// The option bytes as they should be; the brown-out level may be higher.
fn wanted(mut options: Optr) -> Optr {
    options.set_bor_lev(options.bor_lev().max(BROWN_OUT_LEVEL));
    // If nBOOT0 decides: start from flash. If the pin decides and is high: start the ROM, not RAM.
    options.set_n_boot0(true);
    options.set_n_boot1(true);
    // Else the ROM would start the program even when update mode is wanted.
    options.set_bfb2(false);
    options
}

/// Sets the options if they are not as they should be, which takes a reset; a device does this once in its life.
///
/// Not repeated after the reset that this causes, nor after one by the watchdog: an option that cannot be written must
/// not keep the device from starting.
pub fn check(cause: ResetCause) {
    let now = FLASH.optr().read();
    if wanted(now) == now || matches!(cause, ResetCause::OptionBytes | ResetCause::Watchdog) {
        return;
    }
    if !is_idle() {
        return;
    }
    // An earlier error would keep the operation from starting.
    flash::clear_errors();
    // The ROM may have left both unlocked, and writing a key when unlocked is a bus fault.
    if FLASH.cr().read().lock() {
        for key in KEYS {
            FLASH.keyr().write_value(key);
        }
    }
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
    // The reset comes meanwhile; if it does not, the options take effect at the next one.
    cortex_m::asm::delay(LAUNCH_CYCLES);
}

/// Whether the flash is idle, or becomes so in time.
fn is_idle() -> bool {
    (0..POLLS).any(|_| !FLASH.sr().read().bsy())
}
