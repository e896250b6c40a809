//! The second link: LPUART1 at 921 600 baud, on the NUCLEO the ST-Link's serial port.
//!
//! Received bytes go through the interrupt into a ring. When nobody takes them in time the ring overflows and bytes are
//! lost, which the frames' checks notice.

use crate::image::Interrupts;
use embassy_stm32::usart::{BufferedUart, BufferedUartRx, BufferedUartTx, Config, RxPin, TxPin};
use embassy_stm32::{Peri, peripherals::LPUART1};
use static_cell::ConstStaticCell;

/// The UART's two directions.
pub type Uart = (BufferedUartRx<'static>, BufferedUartTx<'static>);

/// Fast enough for every stream at 1 kHz, and within what the ST-Link V3E passes on (UM2505: up to 12 Mbit/s).
pub const BAUD: u32 = 921_600;
/// 11 ms of bytes.
const RECEIVED: usize = 1024;
const SENT: usize = 256;

static RECEIVE: ConstStaticCell<[u8; RECEIVED]> = ConstStaticCell::new([0; RECEIVED]);
static SEND: ConstStaticCell<[u8; SENT]> = ConstStaticCell::new([0; SENT]);

/// Starts the UART: 8 bits, no parity, one stop bit.
pub fn start(
    uart: Peri<'static, LPUART1>,
    receive: Peri<'static, impl RxPin<LPUART1>>,
    transmit: Peri<'static, impl TxPin<LPUART1>>,
) -> Uart {
    let mut config = Config::default();
    config.baudrate = BAUD;
    // The only error is a rate that the clock cannot make.
    let Ok(uart) = BufferedUart::new(uart, receive, transmit, SEND.take(), RECEIVE.take(), Interrupts, config) else {
        panic!("{BAUD} baud cannot be had from this clock")
    };
    let (transmitter, receiver) = uart.split();
    (receiver, transmitter)
}
