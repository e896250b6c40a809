//! The circuit around the chip.

use crate::chip::Pin;

/// Properties of a board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Board {
    /// Name for messages.
    pub name: &'static str,
    /// Frequency of the HSE crystal, 0 if it is broken \[Hz\].
    pub hse_hz: f64,
    /// Encoder phase A.
    pub encoder_a: Pin,
    /// Encoder phase B.
    pub encoder_b: Pin,
    /// Force signal.
    pub force: Pin,
    /// Terminal displacement signal.
    pub terminal: Pin,
    /// TX of the serial link.
    pub serial_tx: Pin,
    /// RX of the serial link.
    pub serial_rx: Pin,
    /// Divided VBUS of the USB connector.
    pub vbus: Pin,
    /// The LED.
    pub led: Pin,
}

impl Board {
    /// ST's NUCLEO-G474RE (UM2505).
    pub const NUCLEO: Self = Self {
        name: "NUCLEO-G474RE",
        hse_hz: 24e6,
        encoder_a: Pin::new('A', 15),
        encoder_b: Pin::new('B', 3),
        force: Pin::new('A', 0),
        terminal: Pin::new('A', 1),
        serial_tx: Pin::new('A', 2),
        serial_rx: Pin::new('A', 3),
        vbus: Pin::new('A', 9),
        led: Pin::new('A', 5),
    };

    /// WeAct's STM32G474 core board.
    pub const WEACT: Self = Self { name: "WeAct STM32G474", hse_hz: 8e6, led: Pin::new('C', 6), ..Self::NUCLEO };
}
