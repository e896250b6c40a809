//! Panics and faults: what was wrong goes to the log and outlives the reset that follows.
//!
//! panic-probe would be the other panic handler, and a program can have but one; its own forgets everything at the reset.
//! This one does under a probe what panic-probe does (the message by defmt, then UDF, on which the probe stops and shows
//! the stack) and without one restarts, to tell the next host.

use core::fmt::{self, Write};
use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::ptr;
use core::sync::atomic::{AtomicBool, Ordering};
use cortex_m::peripheral::{DCB, SCB};
use cortex_m_rt::{ExceptionFrame, exception};
use crc::{CRC_32_ISO_HDLC, Crc, NoTable};
use static_cell::StaticCell;

/// Bytes kept: what an event can carry.
const LENGTH: usize = 96;
/// Bytes of a source file's path: its end tells most.
const PATH: usize = 32;
/// Says that a message is there; the check says that it is whole.
const MAGIC: u32 = 0x5041_4E21;
const CHECK: Crc<u32, NoTable> = Crc::<u32, NoTable>::new(&CRC_32_ISO_HDLC);

/// A message on its way through the reset.
#[derive(Clone, Copy)]
#[repr(C)]
struct Message {
    magic: u32,
    check: u32,
    length: u32,
    text: [u8; LENGTH],
}

/// Not touched by start-up.
#[unsafe(link_section = ".uninit.message")]
static mut KEPT: MaybeUninit<Message> = MaybeUninit::uninit();
static PANICKED: AtomicBool = AtomicBool::new(false);

impl Message {
    const EMPTY: Self = Self { magic: 0, check: 0, length: 0, text: [0; LENGTH] };

    fn text(&self) -> &str {
        let bytes = self.text.get(..self.length as usize).unwrap_or_default();
        match core::str::from_utf8(bytes) {
            Ok(text) => text,
            // Cut within a letter.
            Err(error) => {
                bytes.get(..error.valid_up_to()).and_then(|whole| core::str::from_utf8(whole).ok()).unwrap_or_default()
            }
        }
    }

    fn keep(&mut self) {
        self.magic = MAGIC;
        self.check = CHECK.checksum(&self.text);
        // SAFETY: interrupts are off, and nothing else runs any more.
        unsafe { ptr::write_volatile(ptr::addr_of_mut!(KEPT).cast(), *self) };
    }
}

impl Write for Message {
    /// What does not fit is left out.
    fn write_str(&mut self, part: &str) -> fmt::Result {
        for (place, byte) in self.text.iter_mut().skip(self.length as usize).zip(part.bytes()) {
            *place = byte;
            self.length += 1;
        }
        Ok(())
    }
}

/// The message that the run before left, if it ended by a panic or fault. Forgets it. To be called once.
pub fn take() -> Option<&'static str> {
    static TAKEN: StaticCell<Message> = StaticCell::new();
    // SAFETY: integers only, for which every content is valid; volatile, as the run before wrote it. Nothing has
    // panicked yet.
    let message: Message = unsafe { ptr::read_volatile(ptr::addr_of!(KEPT).cast()) };
    // SAFETY: as above.
    unsafe { ptr::write_volatile(ptr::addr_of_mut!(KEPT).cast(), Message::EMPTY) };
    let whole = message.magic == MAGIC && message.check == CHECK.checksum(&message.text);
    if !whole {
        return None;
    }
    let message: &'static Message = TAKEN.init(message);
    Some(message.text())
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    cortex_m::interrupt::disable();
    // A panic in here says nothing new.
    if !PANICKED.swap(true, Ordering::Relaxed) {
        let mut message = Message::EMPTY;
        if let Some(location) = info.location() {
            let file = location.file();
            let file = file.get(file.len().saturating_sub(PATH)..).unwrap_or(file);
            let _ = write!(message, "{file}:{}: ", location.line());
        }
        let _ = write!(message, "{}", info.message());
        message.keep();
        defmt::error!("panicked at {=str}", message.text());
    }
    end()
}

/// Stops for a probe, or restarts.
fn end() -> ! {
    if DCB::is_debugger_attached() {
        cortex_m::asm::udf();
    }
    SCB::sys_reset()
}

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    if !PANICKED.swap(true, Ordering::Relaxed) {
        // SAFETY: two reads of status registers.
        let (status, address) = unsafe { ((*SCB::PTR).cfsr.read(), (*SCB::PTR).mmfar.read()) };
        let mut message = Message::EMPTY;
        let _ = write!(
            message,
            "hard fault at {:08x} from {:08x}, CFSR {status:08x}, address {address:08x}",
            frame.pc(),
            frame.lr()
        );
        message.keep();
        defmt::error!("{=str}", message.text());
    }
    if DCB::is_debugger_attached() {
        cortex_m::asm::bkpt();
    }
    SCB::sys_reset()
}

#[exception]
unsafe fn DefaultHandler(number: i16) {
    panic!("interrupt {number} has no handler")
}
