//! Frequency response force over displacement: measured, ideal, and that of the complete linear model.
//!
//! Glossary: `x1` displacement of the terminal, `x2` of the screw; `s = 2 pi i f`. Responses are in N/m, force over displacement.
//! - *ideal*: `mt s^2`, an inertance and nothing else.
//! - *complete*: `(mt s^2 + cf s)(cs s + ks) / (mt s^2 + (cs + cf) s + ks)`, with friction that is viscous and no backlash.
//! - *measured*: the cross spectrum over the spectrum of the displacement (`H1`), averaged over overlapping pieces after Welch;
//!   for steady tones the ratio of the two lines, piece by piece.
//! - *coherence*: the part of the force's power that the displacement explains linearly.
//!
//! Sources: Bendat and Piersol, Random Data, 4th ed., 9.2 (errors of `H1` and of the coherence); P. D. Welch, "The use of
//! fast Fourier transform for the estimation of power spectra", 1967; for [`equivalent_viscous`] Roberts and Spanos, Random
//! Vibration and Statistical Linearization, 1990.

mod beside;
mod model;
mod tones;
mod welch;

pub use beside::{Beside, Polar, Row};
pub use model::{Agreement, ModelParameters, equivalent_viscous, ideal, ideal_band, model};
pub use rustfft::num_complex::Complex;

use crate::series::Series;

/// Standard errors in a 95 % interval of a normal distribution.
const COVERAGE: f64 = 1.96;
/// Least coherence of a point that is shown: below it, noise in the displacement biases `H1` by more than a fifth.
const LEAST_COHERENCE: f64 = 0.8;
/// Greatest relative error of a point that is shown.
const GREATEST_ERROR: f64 = 0.5;

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

/// The response that a run shows: over the terminal's displacement where it was measured, else over the screw's.
/// Without any point when the run is too short or nothing moves.
pub fn measured(series: &Series) -> Response {
    let has_terminal = series.stretches.iter().any(|stretch| !stretch.terminal_m.is_empty());
    let input = if has_terminal { Input::Terminal } else { Input::Screw };
    let pieces: Vec<(&[f64], &[f64])> = series
        .stretches
        .iter()
        .map(|stretch| {
            let displacement = if has_terminal { &stretch.terminal_m } else { &stretch.position_m };
            (displacement.as_slice(), stretch.force_n.as_slice())
        })
        .collect();
    let (method, mut points) = match tones::measured(&pieces, series.period_s) {
        Some(points) => (Method::Tones, points),
        None => welch::measured(&pieces, series.period_s),
    };
    points.retain(|point| {
        point.response.is_finite() && point.coherence >= LEAST_COHERENCE && point.error <= GREATEST_ERROR
    });
    Response { input, method, points }
}

/// The data less its mean, under a Hann window.
fn windowed(data: impl Iterator<Item = f64> + Clone, length: usize) -> Vec<Complex<f64>> {
    let n = length as f64;
    let mean = data.clone().sum::<f64>() / n;
    let window = |at: usize| 0.5 - 0.5 * (std::f64::consts::TAU * (at as f64 + 0.5) / n).cos();
    data.enumerate().map(|(at, value)| Complex::new((value - mean) * window(at), 0.0)).collect()
}

#[cfg(test)]
mod tests;
