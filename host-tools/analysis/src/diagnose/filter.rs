//! Filters of the rows: kernels, and whitening of their noise.
//!
//! The residual is the force's noise, white, and the encoder's steps, whose acceleration grows with the square of the
//! frequency: `S = s_F^2 + r (mt w^2)^2 q^2 / 12`, `r` times as often as the motion repeats them. Short boxes preserve
//! the behaviour of friction near a reversal and in fast motion; a filter of `1 / sqrt(S)` after them weights each
//! frequency by its information.

use std::f64::consts::{PI, TAU};

use inerter_core::{
    Bank, Settings,
    constants::{FAST_BOX_S, ROUNDING, SLOW_BOX_S},
};
use inerter_data::series::Series;

use crate::law::{Kernels, Law, median};

/// Box length of the rows in which causes are searched for \[s\].
const BOX_S: f64 = 0.004;
/// Minimum half width of the whitening \[s\], and its size in periods of the frequency at which noise and steps are
/// equal.
const NARROWEST_S: f64 = 0.02;
const PERIODS: f64 = 0.5;
/// Number of frequencies in the integral for the whitening.
const FREQUENCIES: usize = 2000;
/// Median of the fourth differences of white noise of unit variance: `0.6745 sqrt(70)`.
const MEDIAN_DIFFERENCE: f64 = 5.643;

/// How a run is filtered.
#[derive(Clone, Copy, Debug)]
pub(super) enum Sight {
    /// Short boxes and a whitening of at most this half width \[s\].
    White(f64),
    /// Boxes of this length \[s\].
    Box(f64),
}

impl Sight {
    /// Ordered from the most informative to the one that leaves out least, and whose acceleration suffers least.
    pub fn all(bank: Bank) -> &'static [Self] {
        match bank {
            Bank::Fast => &[Self::White(0.08), Self::White(0.04), Self::White(NARROWEST_S), Self::Box(FAST_BOX_S)],
            Bank::Slow => &[Self::Box(0.024), Self::Box(0.032), Self::Box(0.048), Self::Box(SLOW_BOX_S)],
        }
    }
}

/// Kernels and whitening.
pub(super) struct Filter {
    pub kernels: Kernels,
    /// Samples between two grid points.
    pub spacing: usize,
    /// Taps on the grid, an odd number, which sum to 1.
    pub whitening: Vec<f64>,
    /// Noise of the force \[N\].
    pub noise_n: f64,
    /// Mean squares that the force's noise and the encoder's steps, taken as white noise, leave in a row \[N^2\].
    pub noise_square: f64,
    pub steps_square: f64,
    /// Mean square that the force's noise leaves in a row's rate of change of force \[N^2/s^2\].
    pub rate_square: f64,
    /// The same for the second derivative \[N^2/s^4\], and the mean product of that with the row's force \[N^2/s^2\].
    pub bend_square: f64,
    pub bend_with_force: f64,
    /// Mean square that the force's noise leaves in the third derivative \[N^2/s^6\].
    pub third_square: f64,
    /// Mean square that the steps leave in a row's acceleration.
    pub acceleration_square: f64,
    /// How often each stroke repeats.
    pub repeats: f64,
}

impl Filter {
    /// Short boxes with whitening of their noise, or long boxes alone; grid points are half a box apart, and at least
    /// `least_spacing` samples.
    pub fn of(
        sight: Sight,
        least_spacing: usize,
        period_s: f64,
        settings: &Settings,
        law: &Law,
        noise_n: f64,
        repeats: f64,
    ) -> Self {
        let box_s = match sight {
            Sight::White(_) => BOX_S,
            Sight::Box(box_s) => box_s,
        };
        let kernels = Kernels::of_box(box_s, period_s);
        let spacing = (kernels.box_samples / 2).max(least_spacing).max(1);
        let whitening = match sight {
            Sight::White(widest_s) => {
                let step_n = law.inertance_kg.abs() * settings.metres_per_count.abs() * (ROUNDING * repeats).sqrt();
                whitening((noise_n / step_n).sqrt() / TAU, spacing as f64 * period_s, widest_s)
            }
            Sight::Box(_) => vec![1.0],
        };
        // The combined kernel, tap by tap.
        let whole = |taps: &[f64]| {
            let mut whole = vec![0.0; taps.len() + (whitening.len() - 1) * spacing];
            for (place, weight) in whitening.iter().enumerate() {
                for (slot, tap) in whole.iter_mut().skip(place * spacing).zip(taps) {
                    *slot += weight * tap;
                }
            }
            whole
        };
        let product = |a: &[f64], b: &[f64]| whole(a).iter().zip(whole(b)).map(|(a, b)| a * b).sum::<f64>();
        let square = |taps: &[f64]| product(taps, taps);
        let noise_variance = noise_n * noise_n;
        let acceleration_square = ROUNDING * settings.metres_per_count.powi(2) * square(&kernels.second);
        Self {
            noise_n,
            noise_square: noise_variance * square(&kernels.force),
            rate_square: noise_variance * square(&kernels.rate),
            bend_square: noise_variance * square(&kernels.second),
            bend_with_force: noise_variance * product(&kernels.second, &kernels.force),
            third_square: noise_variance * square(&kernels.third),
            steps_square: law.inertance_kg.powi(2) * acceleration_square,
            acceleration_square,
            kernels,
            spacing,
            whitening,
            repeats,
        }
    }

    /// Variance of the noise in a regular motion relative to white noise: repeated errors do not average out.
    pub fn inflation(&self) -> f64 {
        let share = self.steps_square / (self.steps_square + self.noise_square).max(f64::MIN_POSITIVE);
        1.0 + share * (self.repeats - 1.0)
    }
}

/// Taps of `1 / sqrt(1 + (f / f0)^4)` at this spacing \[s\].
fn whitening(alike_hz: f64, spacing_s: f64, widest_s: f64) -> Vec<f64> {
    let half_s = (PERIODS / alike_hz).clamp(NARROWEST_S.min(widest_s), widest_s);
    let half = (half_s / spacing_s).round() as i32;
    let top_hz = 0.5 / spacing_s;
    let frequencies = (0..FREQUENCIES).map(|k| (k as f64 + 0.5) * top_hz / FREQUENCIES as f64);
    let gains: Vec<(f64, f64)> = frequencies.map(|f| (f, 1.0 / (1.0 + (f / alike_hz).powi(4)).sqrt())).collect();
    let tap = |place: i32| {
        let t = f64::from(place) * spacing_s;
        let window = 0.5 * (1.0 + (PI * f64::from(place) / f64::from(half + 1)).cos());
        window * gains.iter().map(|(f, gain)| gain * (TAU * f * t).cos()).sum::<f64>()
    };
    let taps: Vec<f64> = (-half..=half).map(tap).collect();
    let sum: f64 = taps.iter().sum();
    taps.into_iter().map(|tap| tap / sum).collect()
}

/// Noise of the force \[N\], from its fourth differences, on which motion has little effect; at least the rounding of
/// its codes.
pub(super) fn force_noise_n(series: &Series, settings: &Settings) -> f64 {
    let fives = series.stretches.iter().flat_map(|stretch| stretch.force_n.windows(5));
    let difference = |five: &[f64]| (five[0] - 4.0 * five[1] + 6.0 * five[2] - 4.0 * five[3] + five[4]).abs();
    let least = settings.newtons_per_code.abs() * ROUNDING.sqrt();
    median(fives.map(difference).collect()).map_or(least, |median| (median / MEDIAN_DIFFERENCE).max(least))
}

#[cfg(test)]
#[path = "filter_tests.rs"]
mod tests;
