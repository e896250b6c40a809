//! Identity of the device, defined once: the host's update program finds it in the image by its first word, and a host
//! that talks to the device receives it in Hello.

use crate::boards;
use core::fmt::Write as _;
use embassy_stm32::pac::UID;
use heapless::String;
use static_cell::StaticCell;

/// The first word, firmware name and version, the commit that it was built from, and the board.
pub const TEXTS: [&str; 4] =
    ["inerter-identity", concat!("inerter ", env!("CARGO_PKG_VERSION")), env!("INERTER_GIT"), boards::NAME];
const LENGTH: usize = {
    let mut length = 0;
    let mut n = 0;
    while n < TEXTS.len() {
        length += TEXTS[n].len() + 1;
        n += 1;
    }
    length
};

/// The same, each followed by a zero.
#[used]
static IDENTITY: [u8; LENGTH] = {
    let mut joined = [0; LENGTH];
    let (mut place, mut n) = (0, 0);
    while n < TEXTS.len() {
        let text = TEXTS[n].as_bytes();
        let mut letter = 0;
        while letter < text.len() {
            joined[place] = text[letter];
            place += 1;
            letter += 1;
        }
        place += 1;
        n += 1;
    }
    joined
};

/// Digits of the serial number.
const DIGITS: usize = 12;

/// Serial number from the chip's unique ID, as the ROM's update mode forms it.
///
/// Must be called only once: it claims the memory of the text.
pub fn serial() -> &'static str {
    static SERIAL: StaticCell<String<DIGITS>> = StaticCell::new();
    let word = |n| UID.uid(n).read();
    let serial = SERIAL.init(String::new());
    // The text fits.
    let _ = write!(serial, "{:08X}{:04X}", word(0).wrapping_add(word(2)), word(1) >> 16);
    serial
}
