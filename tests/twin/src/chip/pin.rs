//! The chip's pins.

/// A pin of a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pin {
    /// Port number: 0 for A to 6 for G.
    pub port: usize,
    /// Pin number in the port: 0 to 15.
    pub number: usize,
}

impl Pin {
    /// The pin with this data sheet name: `Pin::new('B', 10)` is PB10.
    ///
    /// # Panics
    /// If the pin does not exist.
    pub const fn new(port: char, number: usize) -> Self {
        assert!(matches!(port, 'A'..='G') && number < 16, "no such pin");
        Self { port: port as usize - 'A' as usize, number }
    }
}
