//! What is soldered around the chip.

use crate::chip::Pin;

/// The properties of a board that the chip cannot know.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Board {
    /// Name, for messages.
    pub name: &'static str,
    /// Frequency of the crystal at HSE, 0 if it is broken \[Hz\].
    pub hse_hz: f64,
    /// Phase A of the encoder.
    pub encoder_a: Pin,
    /// Phase B of the encoder.
    pub encoder_b: Pin,
    /// The force signal.
    pub force: Pin,
    /// The terminal displacement signal.
    pub terminal: Pin,
    /// The chip's transmitter of the serial link.
    pub serial_tx: Pin,
    /// The chip's receiver of the serial link.
    pub serial_rx: Pin,
    /// Divider from USB's VBUS.
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
