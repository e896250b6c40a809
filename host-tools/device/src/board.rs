//! What this program has to know about the boards: chip, memory, USB numbers. The device reports everything else
//! itself.
//!
//! The firmware has the same numbers from the same sources; the host never uses the firmware's crate.

use std::ops::Range;

/// The chip's name in probe-rs: the one on NUCLEO-G474RE and WeAct STM32G474.
pub const CHIP: &str = "STM32G474RETx";
/// Device number of STM32G471, G473, G474, G483 and G484 in DBGMCU_IDCODE (RM0440 47.6.1).
pub const CHIP_DEVICE_ID: u32 = 0x469;
/// Address of DBGMCU_IDCODE (RM0440 47.6.1).
pub const CHIP_DEVICE_ID_ADDRESS: u64 = 0xE004_2000;
/// Address of the chip's 96-bit unique ID, three words (RM0440 48.1).
pub const UID_ADDRESS: u64 = 0x1FFF_7590;
/// Address of the size of its flash in KB, in the lower half of a word (RM0440 48.2).
pub const FLASH_KB_ADDRESS: u64 = 0x1FFF_75E0;
/// Address of the option bytes in use, FLASH_OPTR (RM0440 3.7.8).
pub const OPTIONS_ADDRESS: u64 = 0x4002_2020;

/// Address of the stored option bytes: FLASH_OPTR's word, then its inverse (RM0440 3.4.1).
pub const OPTION_BYTES: u32 = 0x1FFF_7800;
/// Dual-bank bit in FLASH_OPTR (RM0440 3.7.8).
pub const DBANK: u32 = 1 << 22;

/// Flash page size, the smallest unit to erase, in dual-bank mode (RM0440 3.3.1) (bytes).
pub const PAGE: u32 = 2048;
/// Bank 1, where the image lies (`memory.x`).
pub const CODE: Range<u32> = 0x0800_0000..0x0804_0000;
/// Last 8 pages of bank 2, where the firmware keeps its settings (`docs/HARDWARE.md`).
pub const SETTINGS: Range<u32> = 0x0807_C000..0x0808_0000;
const _: () = assert!(CODE.end <= SETTINGS.start, "image and settings lie apart");
const _: () = assert!(
    CODE.start.is_multiple_of(PAGE) && CODE.end.is_multiple_of(PAGE) && SETTINGS.start.is_multiple_of(PAGE),
    "on whole pages"
);
/// Flash needed for image and settings: a smaller chip has smaller banks, and no pages at the settings' address (KB).
pub const FLASH_KB: u16 = ((SETTINGS.end - CODE.start) / 1024) as u16;
/// What to do about a chip with less flash.
pub const SMALL_FLASH: &str = "the board needs the chip with 512 KB (STM32G474xE): a smaller chip's flash \
                               banks are too small for the firmware, and it has no flash at the address of the settings. \
                               Nothing was changed";
/// What to do about a chip in single-bank mode.
pub const SET_DBANK: &str =
    "set the option bit DBANK to 1, its factory value, with STM32CubeProgrammer; nothing was changed";
/// Valid initial stack pointers: SRAM1 and SRAM2 including their end (`memory.x`).
pub const STACK: Range<u32> = 0x2000_0004..0x2001_8001;

/// USB vendor of the board: pid.codes.
pub const USB_VID: u16 = 0x1209;
/// USB product of the board, from the range for testing.
pub const USB_PID: u16 = 0x0001;
/// USB product name of the board; the numbers alone are shared with other test devices.
pub const PRODUCT: &str = "inerter";

/// USB vendor of STMicroelectronics.
pub const ST_VID: u16 = 0x0483;
/// USB product of the chip's ROM in DFU mode (AN2606).
pub const DFU_PID: u16 = 0xDF11;
/// USB products of ST-Link probes that also have a serial port: V2-1, V3 (probe-rs and OpenOCD list the same).
pub const ST_LINK_PIDS: [u16; 7] = [0x374B, 0x3752, 0x374E, 0x374F, 0x3753, 0x3754, 0x3757];

/// The USB serial number, the same in the firmware and the ROM (the ROM's rule, AN2606): derived from the chip's unique
/// ID.
pub fn serial_number(uid: [u32; 3]) -> String {
    let [first, second, third] = uid;
    format!("{:08X}{:04X}", first.wrapping_add(third), second >> 16)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_serial_number_has_twelve_digits_and_wraps() {
        assert_eq!(serial_number([0x0021_0034, 0x3537_5101, 0x2036_3554]), "205735883537");
        assert_eq!(serial_number([0xFFFF_FFFF, 0x000A_FFFF, 2]), "00000001000A");
    }
}
