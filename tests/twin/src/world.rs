//! What is outside the pins.

/// The world outside the pins. Time in seconds since power-on.
///
/// Each signal is read at times that never decrease; between signals, times may differ by some milliseconds, as the
/// digital front end looks back over a conversion.
pub trait World {
    /// Encoder edges (x4) since the start, wrapping at 2^32.
    fn encoder(&mut self, time_s: f64) -> u32;
    /// Voltage of the force signal at its pin \[V\].
    fn force_volts(&mut self, time_s: f64) -> f64;
    /// Voltage of the terminal displacement signal at its pin \[V\].
    fn terminal_volts(&mut self, time_s: f64) -> f64;
    /// Voltage between the bridge's outputs, at the digital front end \[V\].
    fn bridge_volts(&mut self, time_s: f64) -> f64 {
        let _ = time_s;
        0.0
    }
    /// Voltage that the digital front end sees of the bridge's excitation \[V\].
    fn excitation_volts(&mut self, time_s: f64) -> f64 {
        let _ = time_s;
        0.0
    }
    /// Voltage of the terminal displacement signal at the digital front end \[V\].
    fn digital_terminal_volts(&mut self, time_s: f64) -> f64 {
        let _ = time_s;
        0.0
    }
    /// Temperature of the chip \[degree Celsius\].
    fn temperature_c(&mut self, time_s: f64) -> f64 {
        let _ = time_s;
        25.0
    }
}

/// Nothing moves.
#[derive(Clone, Copy, Debug, Default)]
pub struct Still;

impl World for Still {
    fn encoder(&mut self, _: f64) -> u32 {
        0
    }

    fn force_volts(&mut self, _: f64) -> f64 {
        1.65
    }

    fn terminal_volts(&mut self, _: f64) -> f64 {
        1.65
    }
}
