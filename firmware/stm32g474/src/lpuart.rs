//! The second link: LPUART1 at 921 600 baud; on the NUCLEO it is the ST-Link's serial port.
//!
//! Bytes go through the interrupt and one pipe per direction. There is no flow control: bytes not taken in time are
//! lost, which the frames' checks detect. Source: RM0440 38.

use crate::boards::clock::CORE_HZ;
use crate::pins;
use core::convert::Infallible;
use embassy_stm32::gpio::{AfType, Flex, OutputType, Pull, Speed};
use embassy_stm32::interrupt::typelevel::{Handler, Interrupt, LPUART1 as LpuartInterrupt};
use embassy_stm32::pac::{LPUART1, RCC};
use embassy_stm32::usart::{RxPin, TxPin};
use embassy_stm32::{Peri, peripherals};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::pipe::Pipe;
use embassy_time::Timer;
use embedded_io_async::{ErrorType, Read, Write};

/// Fast enough for every stream at 1 kHz, and supported by the ST-Link V3E (UM2505).
const BAUD: u32 = 921_600;
/// The divider counts 256ths (RM0440 38.4.7).
const DIVIDER: u32 = ((256 * CORE_HZ as u64 + BAUD as u64 / 2) / BAUD as u64) as u32;
// With less, the transmitter may fail (ES0430 2.17.1).
const _: () = assert!(DIVIDER > 0x3FF);
/// 11 ms at this baud rate.
const RECEIVED_LENGTH: usize = 1024;
const SENT_LENGTH: usize = 512;
/// Bytes of the receiver's FIFO, and of the transmitter's.
const FIFO: usize = 8;
/// Longest wait for the last byte to go out, in milliseconds.
const DRAIN_MS: u64 = 50;

static RECEIVED: Pipe<CriticalSectionRawMutex, RECEIVED_LENGTH> = Pipe::new();
static SENT: Pipe<CriticalSectionRawMutex, SENT_LENGTH> = Pipe::new();

/// Interrupt of the UART.
pub struct UartHandler;

impl Handler<LpuartInterrupt> for UartHandler {
    unsafe fn on_interrupt() {
        // Bytes that arrive while the FIFO is emptied raise the interrupt again.
        for _ in 0..FIFO {
            if !LPUART1.isr().read().rxne() {
                break;
            }
            let byte = LPUART1.rdr().read().0 as u8;
            let _ = RECEIVED.try_write(&[byte]);
        }
        // Bytes were already lost; while the flag is set, so are all others.
        LPUART1.icr().write(|w| w.set_ore(true));
        if LPUART1.isr().read().txfe() {
            let mut bytes = [0; FIFO];
            let count = SENT.try_read(&mut bytes).unwrap_or(0);
            for byte in bytes.iter().take(count) {
                LPUART1.tdr().write(|w| w.0 = u32::from(*byte));
            }
            if count == 0 {
                LPUART1.cr1().modify(|w| w.set_txfeie(false));
            }
        }
    }
}

/// The UART's two directions.
pub type Uart = (Receiver, Transmitter);

/// Starts the UART: 8 bits, no parity, one stop bit.
pub fn start(
    _uart: Peri<'static, peripherals::LPUART1>,
    receive: Peri<'static, impl RxPin<peripherals::LPUART1>>,
    transmit: Peri<'static, impl TxPin<peripherals::LPUART1>>,
) -> Uart {
    let (receive_function, transmit_function) = (receive.af_num(), transmit.af_num());
    pins::connect(Flex::new(receive), receive_function, AfType::input(Pull::Up));
    pins::connect(Flex::new(transmit), transmit_function, AfType::output(OutputType::PushPull, Speed::Medium));
    critical_section::with(|_| RCC.apb1enr2().modify(|w| w.set_lpuart1en(true)));
    LPUART1.brr().write(|w| w.0 = DIVIDER);
    LPUART1.cr1().write(|w| {
        w.set_fifoen(true);
        w.set_rxneie(true);
        w.set_re(true);
        w.set_te(true);
        w.set_ue(true);
    });
    // SAFETY: the handler accesses only this UART and the two pipes.
    unsafe { LpuartInterrupt::enable() };
    (Receiver, Transmitter)
}

/// Waits until everything has been sent, for a limited time.
pub async fn drain() {
    for _ in 0..DRAIN_MS {
        if SENT.is_empty() && LPUART1.isr().read().tc() {
            return;
        }
        Timer::after_millis(1).await;
    }
}

/// The receiving direction.
pub struct Receiver;

impl ErrorType for Receiver {
    type Error = Infallible;
}

impl Read for Receiver {
    async fn read(&mut self, into: &mut [u8]) -> Result<usize, Infallible> {
        Ok(RECEIVED.read(into).await)
    }
}

/// The sending direction.
pub struct Transmitter;

impl ErrorType for Transmitter {
    type Error = Infallible;
}

impl Write for Transmitter {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let count = SENT.write(bytes).await;
        critical_section::with(|_| LPUART1.cr1().modify(|w| w.set_txfeie(true)));
        Ok(count)
    }

    /// Written bytes are sent without a flush.
    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}
