//! A measured response, and the parts that both methods share.

use rustfft::num_complex::Complex;

/// Standard errors in a 95 % interval of a normal distribution.
pub(super) const NORMAL_COVERAGE: f64 = 1.96;

/// The displacement that the response refers to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Input {
    /// The terminal's, from its own sensor.
    Terminal,
    /// The screw's, from the encoder.
    Screw,
}

/// How it was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// Over all frequencies, with this equivalent number of independent pieces.
    Welch {
        /// Number of independent pieces.
        averages: f64,
    },
    /// At the frequencies of steady tones.
    Tones,
}

/// The response at one frequency.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Frequency \[Hz\].
    pub frequency_hz: f64,
    /// Force over displacement \[N/m\].
    pub response: Complex<f64>,
    /// Fraction of the force's power that the displacement explains, 0 to 1.
    pub coherence: f64,
    /// Half width of the magnitude's 95 % interval, relative to it.
    pub error: f64,
}

impl Point {
    /// Half width of the 95 % interval of the phase \[rad\].
    pub fn phase_error_rad(&self) -> f64 {
        self.error.min(1.0).asin()
    }
}

/// A measured response; only meaningful points.
#[derive(Clone, Debug, PartialEq)]
pub struct Response {
    /// The displacement that it refers to.
    pub input: Input,
    /// How it was measured.
    pub method: Method,
    /// By increasing frequency.
    pub points: Vec<Point>,
}

/// The data minus their mean, with a Hann window.
pub(super) fn windowed(data: impl Iterator<Item = f64> + Clone, length: usize) -> Vec<Complex<f64>> {
    let n = length as f64;
    let mean = data.clone().sum::<f64>() / n;
    let window = |at: usize| 0.5 - 0.5 * (std::f64::consts::TAU * (at as f64 + 0.5) / n).cos();
    data.enumerate().map(|(at, value)| Complex::new((value - mean) * window(at), 0.0)).collect()
}
