//! The options that matter: at which supply voltage the chip holds itself in reset, and that it starts from flash.
//!
//! Boards come with any of them (`docs/HARDWARE.md`). nSWBOOT0 stays: it says whether a pin can lead into update mode, and
//! not every board leaves that pin free. DBANK stays: in the other mode the program would lie elsewhere.

use crate::flash;
use embassy_stm32::pac::FLASH;
use embassy_stm32::pac::flash::regs::Optr;
use inerter_wire::ResetCause;

/// Level 4, 2.8 V. Below 3.0 V USB is out of its range and the analogue supply, against which force is measured, is
/// not what the scale was found with: better no measurement than that one. A supply of 3.3 V keeps 0.4 V to it.
const BROWN_OUT_LEVEL: u8 = 4;
/// Keys (RM0440, 3.3.5 and 3.4.2).
const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];
const OPTION_KEYS: [u32; 2] = [0x0819_2A3B, 0x4C5D_6E7F];

/// Looks at the flash, for 50 ms: at least 8 cycles each of the 16 MHz that the core runs from here. Option bytes take 22 ms
/// for the erase and 82 us for each double word (DS12288, table 50).
const POLLS: u32 = 100_000;
/// For 1 ms.
const LAUNCH_CYCLES: u32 = 16_000;

/// Whether a reset leads into the ROM, whatever the boot pin: nBOOT0 counts in its place and says so, or the ROM is to
/// choose between the banks (RM0440 2.6).
pub fn start_in_rom() -> bool {
    let options = FLASH.optr().read();
    options.bfb2() || !options.n_swboot0() && !options.n_boot0()
}

/// As in use, and as they should be.
pub fn in_use_and_wanted() -> (u32, u32) {
    let options = FLASH.optr().read();
    (options.0, wanted(options).0)
}

/// As they should be; the brown-out level may be higher.
fn wanted(mut options: Optr) -> Optr {
    options.set_bor_lev(options.bor_lev().max(BROWN_OUT_LEVEL));
    // Where nBOOT0 counts: from flash. Where the pin counts, high: the ROM, and not RAM.
    options.set_n_boot0(true);
    options.set_n_boot1(true);
    // The ROM would also start the program where update mode is wanted.
    options.set_bfb2(false);
    options
}

/// Sets the options where they are not as they should be, which takes a reset; a device comes here once in its life.
///
/// Not again after the reset that this makes, nor where the watchdog ended it: an option that cannot be written must not
/// keep the device from starting.
pub fn check(cause: ResetCause) {
    let now = FLASH.optr().read();
    if wanted(now) == now || matches!(cause, ResetCause::OptionBytes | ResetCause::Watchdog) {
        return;
    }
    if !is_idle() {
        return;
    }
    // An error of before would keep the operation from starting.
    flash::clear_errors();
    // The ROM may have left both unlocked, and a key for what is open is a bus fault.
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
    // The reset comes meanwhile; where it does not, the options count from the next one on.
    cortex_m::asm::delay(LAUNCH_CYCLES);
}

/// Whether the flash is idle, or becomes so in time.
fn is_idle() -> bool {
    (0..POLLS).any(|_| !FLASH.sr().read().bsy())
}
