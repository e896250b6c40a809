//! A measured response, the ideal and the complete model, as rows for JSON and text.

use std::f64::consts::PI;

use rustfft::num_complex::Complex;
use serde::Serialize;

use super::{Input, Method, Response, ideal, model};
use crate::identify::Parameters;

/// Magnitude and phase.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Polar {
    /// Force over displacement \[N/m\].
    pub magnitude_n_per_m: f64,
    /// Phase of the force relative to the displacement \[degrees\], in (-180, 180].
    pub phase_deg: f64,
}

impl From<Complex<f64>> for Polar {
    fn from(value: Complex<f64>) -> Self {
        Self { magnitude_n_per_m: value.norm(), phase_deg: value.arg() * 180.0 / PI }
    }
}

/// All three at one frequency.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Frequency \[Hz\].
    pub frequency_hz: f64,
    /// As measured.
    pub measured: Polar,
    /// Half width of the magnitude's 95 % interval, relative to it.
    pub magnitude_u95: f64,
    /// Half width of the phase's 95 % interval \[degrees\].
    pub phase_u95_deg: f64,
    /// Fraction of the force's power that the displacement explains.
    pub coherence: f64,
    /// `mt s^2`.
    pub ideal: Polar,
    /// The complete linear model, which has no dry friction and no backlash.
    pub complete: Polar,
}

/// A response with its models.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Beside {
    /// `terminal` or `screw`: the reference displacement.
    pub input: &'static str,
    /// `welch` or `tones`.
    pub method: &'static str,
    /// By increasing frequency.
    pub points: Vec<Row>,
}

impl Beside {
    /// Each measured point with the models of `parameters`.
    pub fn of(response: &Response, parameters: &Parameters) -> Self {
        let row = |point: &super::Point| Row {
            frequency_hz: point.frequency_hz,
            measured: point.response.into(),
            magnitude_u95: point.error,
            phase_u95_deg: point.phase_error_rad() * 180.0 / PI,
            coherence: point.coherence,
            ideal: ideal(parameters.inertance_kg, point.frequency_hz).into(),
            complete: model(parameters, response.input, point.frequency_hz).into(),
        };
        Self {
            input: match response.input {
                Input::Terminal => "terminal",
                Input::Screw => "screw",
            },
            method: match response.method {
                Method::Welch { .. } => "welch",
                Method::Tones => "tones",
            },
            points: response.points.iter().map(row).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::response::Point;

    #[test]
    fn far_below_resonance_all_three_agree_where_friction_is_none() {
        let parameters = Parameters { inertance_kg: 300.0, stiffness_n_per_m: 2e6, ..Parameters::default() };
        let response = Complex::new(-300.0 * (2.0 * PI).powi(2), 0.0);
        let point = Point { frequency_hz: 1.0, response, coherence: 1.0, error: 0.01 };
        let beside =
            Beside::of(&Response { input: Input::Terminal, method: Method::Tones, points: vec![point] }, &parameters);
        let [row] = beside.points.as_slice() else { panic!("{beside:?}") };
        assert_eq!(row.measured, row.ideal);
        assert_eq!((row.ideal.phase_deg.abs(), beside.input, beside.method), (180.0, "terminal", "tones"));
        let apart = row.complete.magnitude_n_per_m / row.ideal.magnitude_n_per_m - 1.0;
        // The contact raises the magnitude by (w / w0)^2.
        assert!((apart - (2.0 * PI).powi(2) * 300.0 / 2e6).abs() < 1e-4, "{apart}");
        assert!((row.phase_u95_deg - 0.573).abs() < 1e-3);
    }
}
