//! A measured response, and what both ways of measuring share.

use rustfft::num_complex::Complex;

/// Standard errors in a 95 % interval of a normal distribution.
pub(super) const NORMAL_COVERAGE: f64 = 1.96;

/// Which displacement the response is taken over.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Input {
    /// The terminal's, by its own sensor.
    Terminal,
    /// The screw's, by the encoder.
    Screw,
}

/// How it was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// Over all frequencies, from so many pieces worth of independent ones.
    Welch {
        /// Independent pieces.
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
    /// Part of the force's power that the displacement explains, 0 to 1.
    pub coherence: f64,
    /// Half width of the 95 % interval of the magnitude, as a part of it.
    pub error: f64,
}

impl Point {
    /// Half width of the 95 % interval of the phase \[rad\].
    pub fn phase_error_rad(&self) -> f64 {
        self.error.min(1.0).asin()
    }
}

/// A measured response; only points that say something.
#[derive(Clone, Debug, PartialEq)]
pub struct Response {
    /// The displacement it is taken over.
    pub input: Input,
    /// How it was measured.
    pub method: Method,
    /// By rising frequency.
    pub points: Vec<Point>,
}

/// The data less its mean, under a Hann window.
pub(super) fn windowed(data: impl Iterator<Item = f64> + Clone, length: usize) -> Vec<Complex<f64>> {
    let n = length as f64;
    let mean = data.clone().sum::<f64>() / n;
    let window = |at: usize| 0.5 - 0.5 * (std::f64::consts::TAU * (at as f64 + 0.5) / n).cos();
    data.enumerate().map(|(at, value)| Complex::new((value - mean) * window(at), 0.0)).collect()
}
