//! The world outside the pins.

/// Source of the signals at the pins. Times are in seconds since power-on.
///
/// The times at which one signal is read never decrease. Those of different signals may differ by some milliseconds, as
/// the digital front end reads the voltages of a whole conversion at its end.
pub trait World {
    /// Encoder edges (x4) since the start, wrapping at 2^32.
    fn encoder(&mut self, time_s: f64) -> u32;
    /// Voltage of the force signal at its pin \[V\].
    fn force_volts(&mut self, time_s: f64) -> f64;
    /// Voltage of the terminal displacement signal at its pin \[V\].
    fn terminal_volts(&mut self, time_s: f64) -> f64;
    /// Bridge output voltage at the digital front end \[V\].
    fn bridge_volts(&mut self, _time_s: f64) -> f64 {
        0.0
    }
    /// Bridge excitation voltage at the digital front end, after the divider \[V\].
    fn excitation_volts(&mut self, _time_s: f64) -> f64 {
        0.0
    }
    /// Voltage of the terminal displacement signal at the digital front end \[V\].
    fn digital_terminal_volts(&mut self, _time_s: f64) -> f64 {
        0.0
    }
    /// Chip temperature \[degree Celsius\].
    fn temperature_c(&mut self, _time_s: f64) -> f64 {
        25.0
    }
}

/// A world in which nothing moves.
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
