//! USART1 as the link.
//!
//! QEMU hands over received bytes one at a time and keeps the rest waiting until the data register is read, so
//! leaving a byte in the register is flow control, and nothing is lost. A byte written has been sent when the store
//! returns: writing never waits here, and a reader on the host that stops reading stops the machine.

use core::convert::Infallible;
use core::ptr;
use cortex_m::interrupt::InterruptNumber;
use cortex_m::peripheral::NVIC;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::pipe::Pipe;
use embedded_io_async::{ErrorType, Read, Write};

/// Interrupt number of USART1.
pub const INTERRUPT: u16 = 37;

const BASE: usize = 0x4001_1000;
const STATUS: *mut u32 = BASE as *mut u32;
const DATA: *mut u32 = (BASE + 0x04) as *mut u32;
const CONTROL: *mut u32 = (BASE + 0x0c) as *mut u32;

const STATUS_RECEIVED: u32 = 1 << 5;
const STATUS_TRANSMIT_EMPTY: u32 = 1 << 7;
/// Enable; interrupt on a received byte; transmitter; receiver.
const CONTROL_ON: u32 = 1 << 13 | 1 << 5 | 1 << 3 | 1 << 2;

static RECEIVED: Pipe<CriticalSectionRawMutex, 1024> = Pipe::new();

#[derive(Clone, Copy)]
struct Usart1;

// SAFETY: 37 is USART1's place in the vector table of the STM32F405 (RM0090, table 62).
unsafe impl InterruptNumber for Usart1 {
    fn number(self) -> u16 {
        INTERRUPT
    }
}

/// Switches the USART on and returns its two directions.
pub fn start() -> (Receiver, Transmitter) {
    // SAFETY: CONTROL is USART1's CR1, and this is the only code that uses the USART; the handler below is ready.
    unsafe {
        ptr::write_volatile(CONTROL, CONTROL_ON);
        NVIC::unmask(Usart1);
    }
    (Receiver, Transmitter)
}

/// Takes received bytes; called from the interrupt.
pub fn on_interrupt() {
    // SAFETY: the registers are USART1's. Reading DATA takes a byte, and only this handler does so.
    unsafe {
        while ptr::read_volatile(STATUS) & STATUS_RECEIVED != 0 {
            if RECEIVED.is_full() {
                // The byte stays in its register, and the interrupt pending, until the reader has made room.
                NVIC::mask(Usart1);
                return;
            }
            let byte = ptr::read_volatile(DATA) as u8;
            let _ = RECEIVED.try_write(&[byte]);
        }
    }
}

/// The receiving direction.
pub struct Receiver;

impl ErrorType for Receiver {
    type Error = Infallible;
}

impl Read for Receiver {
    async fn read(&mut self, into: &mut [u8]) -> Result<usize, Infallible> {
        let count = RECEIVED.read(into).await;
        // SAFETY: there is room again, so the interrupt may take bytes; it was unmasked in `start`.
        unsafe { NVIC::unmask(Usart1) };
        Ok(count)
    }
}

/// The sending direction.
pub struct Transmitter;

impl ErrorType for Transmitter {
    type Error = Infallible;
}

impl Write for Transmitter {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        for &byte in bytes {
            // SAFETY: the registers are USART1's, and only this code writes DATA.
            unsafe {
                while ptr::read_volatile(STATUS) & STATUS_TRANSMIT_EMPTY == 0 {}
                ptr::write_volatile(DATA, u32::from(byte));
            }
        }
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}
