//! Panics and faults: the message goes to the log and survives the reset that follows.
//!
//! panic-probe would be a second panic handler, and a program can have only one; it also preserves nothing across the
//! reset. Under a probe this handler does what panic-probe does (prints the message with defmt, then UDF, at which the
//! probe stops and shows the stack); without one it restarts, and the next host receives the message.

use crate::reset;
use core::fmt::{self, Write};
use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::ptr;
use core::sync::atomic::{AtomicBool, Ordering};
use cortex_m::peripheral::{DCB, SCB};
use cortex_m_rt::{ExceptionFrame, exception};
use heapless::String;
use inerter_wire::Crc32;
use static_cell::StaticCell;

/// Bytes kept: the capacity of an event.
const LENGTH: usize = 96;
/// Bytes kept of a source file's path: its end is the most informative part.
const PATH: usize = 32;
/// Marks that a message is present; the checksum shows that it is intact.
const MAGIC: u32 = 0x5041_4E21;

/// A message kept across the reset, in words, as RAM retains them.
#[repr(C)]
struct Kept {
    magic: u32,
    check: u32,
    text: [u32; LENGTH / 4],
}

/// Not touched by start-up.
#[unsafe(link_section = ".uninit.message")]
static mut KEPT: MaybeUninit<Kept> = MaybeUninit::uninit();
static PANICKED: AtomicBool = AtomicBool::new(false);

/// Text of at most [`LENGTH`] bytes; the excess is dropped, and a non-ASCII character becomes a question mark.
struct Message {
    text: String<LENGTH>,
}

impl Message {
    const EMPTY: Self = Self { text: String::new() };

    /// Keeps it, padded with zeros.
    fn keep(&self) {
        let mut bytes = [0; LENGTH];
        for (place, byte) in bytes.iter_mut().zip(self.text.bytes()) {
            *place = byte;
        }
        let kept = ptr::addr_of_mut!(KEPT).cast::<Kept>();
        let (words, _) = bytes.as_chunks();
        // SAFETY: the fields of a static, through pointers that stay inside; volatile, because the next run reads them.
        // Nothing else runs any more: interrupts are off, or this is a fault.
        unsafe {
            for (place, word) in words.iter().enumerate() {
                ptr::addr_of_mut!((*kept).text).cast::<u32>().add(place).write_volatile(u32::from_le_bytes(*word));
            }
            ptr::addr_of_mut!((*kept).check).write_volatile(Crc32::of(&bytes));
            ptr::addr_of_mut!((*kept).magic).write_volatile(MAGIC);
        }
    }

    /// Returns what was kept, if it is intact, and clears it.
    fn fetch() -> Option<Self> {
        let kept = ptr::addr_of_mut!(KEPT).cast::<Kept>();
        let mut bytes = [0; LENGTH];
        let (words, _) = bytes.as_chunks_mut();
        // SAFETY: as in `keep`; integers, for which every content is valid.
        let (magic, check) = unsafe {
            for (place, word) in words.iter_mut().enumerate() {
                *word = ptr::addr_of!((*kept).text).cast::<u32>().add(place).read_volatile().to_le_bytes();
            }
            let magic = ptr::addr_of!((*kept).magic).read_volatile();
            ptr::addr_of_mut!((*kept).magic).write_volatile(0);
            (magic, ptr::addr_of!((*kept).check).read_volatile())
        };
        if magic != MAGIC || check != Crc32::of(&bytes) {
            return None;
        }
        let mut message = Self::EMPTY;
        for byte in bytes.into_iter().take_while(|byte| *byte != 0) {
            message.add(char::from(byte));
        }
        Some(message)
    }

    fn add(&mut self, letter: char) {
        let _ = self.text.push(if letter.is_ascii() { letter } else { '?' });
    }
}

impl Write for Message {
    fn write_str(&mut self, part: &str) -> fmt::Result {
        part.chars().for_each(|letter| self.add(letter));
        Ok(())
    }
}

/// The message that the previous run left, if it ended by a panic or fault. Clears it. Must be called only once.
pub fn take() -> Option<&'static str> {
    static TAKEN: StaticCell<Message> = StaticCell::new();
    let message: &'static Message = TAKEN.init(Message::fetch()?);
    Some(&message.text)
}

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    cortex_m::interrupt::disable();
    // A panic in this handler adds nothing new.
    if !PANICKED.swap(true, Ordering::Relaxed) {
        let mut message = Message::EMPTY;
        if let Some(location) = info.location() {
            let file = location.file();
            let file = file.get(file.len().saturating_sub(PATH)..).unwrap_or(file);
            let _ = write!(message, "{file}:{}: ", location.line());
        }
        let _ = write!(message, "{}", info.message());
        message.keep();
        reset::note_failure();
        defmt::error!("panicked at {=str}", message.text.as_str());
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
        reset::note_failure();
        defmt::error!("{=str}", message.text.as_str());
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
