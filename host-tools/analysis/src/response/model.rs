//! The ideal and the complete model, and the band in which they agree.

use std::f64::consts::{PI, TAU};

use inerter_data::series::Series;
use rustfft::num_complex::Complex;

use super::Input;
use crate::identify::Parameters;

/// Limits of the search for the band \[Hz\].
const SEARCH_HZ: (f64, f64) = (1e-5, 1e4);
/// Points of it per decade.
const PER_DECADE: i32 = 200;

/// The load cell's reading over the displacement \[N/m\], by the linear part of the complete model: without Coulomb
/// friction, backlash and offset. An unknown stiffness is taken as infinite.
pub fn model(parameters: &Parameters, input: Input, frequency_hz: f64) -> Complex<f64> {
    let Parameters { inertance_kg, viscous_n_s_per_m, stiffness_n_per_m, .. } = *parameters;
    let s = Complex::new(0.0, TAU * frequency_hz);
    let screw = s * s * inertance_kg + s * viscous_n_s_per_m;
    let contact = s * parameters.contact_damping_n_s_per_m + stiffness_n_per_m;
    // Displacement of the terminal over that of the screw.
    let stretch = if stiffness_n_per_m > 0.0 { screw / contact + 1.0 } else { Complex::new(1.0, 0.0) };
    let structure = s * s * parameters.structure_mass_kg;
    let delay = Complex::from_polar(1.0, -TAU * frequency_hz * parameters.skew_s);
    delay
        * match input {
            Input::Terminal => screw / stretch + structure,
            Input::Screw => screw + structure * stretch,
        }
}

/// The ideal inertance: `mt s^2` \[N/m\].
pub fn ideal(inertance_kg: f64, frequency_hz: f64) -> Complex<f64> {
    Complex::new(-inertance_kg * (TAU * frequency_hz).powi(2), 0.0)
}

/// Agreement of the ideal inertance with the complete model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Agreement {
    /// Maximum difference of the magnitudes \[dB\].
    pub decibels: f64,
    /// Maximum difference of the phases \[degrees\].
    pub degrees: f64,
}

impl Agreement {
    /// Complete model over ideal one at a frequency, between the terminals: the structure mass and the delay belong to
    /// the rig.
    pub fn at(parameters: &Parameters, frequency_hz: f64) -> Self {
        let device = Parameters { structure_mass_kg: 0.0, skew_s: 0.0, ..*parameters };
        let ratio = model(&device, Input::Terminal, frequency_hz) / ideal(device.inertance_kg, frequency_hz);
        Self { decibels: 20.0 * ratio.norm().log10(), degrees: ratio.arg() * 180.0 / PI }
    }

    fn holds(&self, parameters: &Parameters, frequency_hz: f64) -> bool {
        let there = Self::at(parameters, frequency_hz);
        there.decibels.abs() <= self.decibels && there.degrees.abs() <= self.degrees
    }
}

/// The widest band, by frequency ratio, in which the ideal inertance agrees with the complete model to `within`: its
/// lower and upper end \[Hz\], each to six digits; `None` for an end beyond 1e-5 or 1e4 Hz.
pub fn ideal_band(parameters: &Parameters, within: Agreement) -> Option<(Option<f64>, Option<f64>)> {
    let decade = 10f64.powf(1.0 / f64::from(PER_DECADE));
    let count = ((SEARCH_HZ.1 / SEARCH_HZ.0).log10() * f64::from(PER_DECADE)).round() as i32;
    let frequency = |number: i32| SEARCH_HZ.0 * decade.powi(number);
    let good: Vec<bool> = (0..=count).map(|number| within.holds(parameters, frequency(number))).collect();
    let bands = good.chunk_by(|a, b| a == b).scan(0, |next, run| {
        let first = *next;
        *next += run.len() as i32;
        Some((run[0], first, *next - 1))
    });
    let (_, first, last) = bands.filter(|(is_good, ..)| *is_good).max_by_key(|(_, first, last)| last - first)?;
    let edge = |good: i32, bad: i32| {
        let (mut good, mut bad) = (frequency(good), frequency(bad));
        while (good / bad - 1.0).abs() > 1e-7 {
            let middle = (good * bad).sqrt();
            *(if within.holds(parameters, middle) { &mut good } else { &mut bad }) = middle;
        }
        good
    };
    Some(((first > 0).then(|| edge(first, first - 1)), (last < count).then(|| edge(last, last + 1))))
}

/// The viscous friction that dissipates the same energy in this motion as the Coulomb friction: `fc mean|v| / mean v^2`
/// \[N s/m\]; `4 fc / (pi V)` for a tone with velocity amplitude `V`. `None` if nothing moves.
pub fn equivalent_viscous(series: &Series, coulomb_n: f64) -> Option<f64> {
    // Long enough that the encoder's steps are small compared with the motion.
    let span = (0.02 / series.period_s).round().max(1.0) as usize;
    let velocities = series.stretches.iter().flat_map(|stretch| {
        let later = stretch.position_m.iter().skip(span);
        stretch.position_m.iter().zip(later).map(|(before, after)| (after - before) / (span as f64 * series.period_s))
    });
    let (sum, squares, count) =
        velocities.fold((0.0, 0.0, 0.0), |(sum, squares, count), v| (sum + v.abs(), squares + v * v, count + 1.0));
    (count > 0.0 && (squares / count).sqrt() > 1e-6).then(|| coulomb_n * sum / squares)
}
