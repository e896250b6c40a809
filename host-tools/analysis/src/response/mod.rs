//! Frequency response force over displacement: measured, ideal, and that of the complete linear model.
//!
//! Glossary: `x1` displacement of the terminal, `x2` of the screw; `s = 2 pi i f`. Responses are force over
//! displacement, in N/m.
//! - *ideal*: `mt s^2`, a pure inertance.
//! - *complete*: `(mt s^2 + cf s)(cs s + ks) / (mt s^2 + (cs + cf) s + ks)`, with viscous friction and without
//!   backlash.
//! - *measured*: the cross spectrum over the spectrum of the displacement (`H1`), averaged over overlapping pieces
//!   (Welch); for steady tones the ratio of the two lines, piece by piece.
//! - *coherence*: the fraction of the force's power that the displacement explains linearly.
//!
//! Sources: Bendat and Piersol, Random Data, 4th ed., 9.2 (errors of `H1` and of the coherence); P. D. Welch, "The use
//! of fast Fourier transform for the estimation of power spectra", 1967; for [`equivalent_viscous`] Roberts and Spanos,
//! Random Vibration and Statistical Linearization, 1990.

mod beside;
mod model;
mod point;
mod tones;
mod welch;

pub use beside::{Beside, Polar, Row};
use inerter_data::series::Series;
pub use model::{Agreement, equivalent_viscous, ideal, ideal_band, model};
pub use point::{Input, Method, Point, Response};
pub use rustfft::num_complex::Complex;

/// Minimum coherence of a point that is shown: below it, noise in the displacement biases `H1` by more than a fifth.
const LEAST_COHERENCE: f64 = 0.8;
/// Maximum relative error of a point that is shown.
const GREATEST_ERROR: f64 = 0.5;

/// The response in a run: relative to the terminal's displacement if it was measured, otherwise to the screw's. It has
/// no points if the run is too short or nothing moves.
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

#[cfg(test)]
mod tests;
