//! Conditions the samples: smooths the terminal's motion, and finds the white noise of each channel.
//!
//! The terminal's motion drives the simulation, so its noise must be removed and its motion kept: everything above the
//! highest frequency that stands clear of the noise, and above the device's resonance, is removed in the frequency
//! domain, without a delay and without droop below; the same step gives the derivatives. The white noise comes from the
//! sixth differences, in which smooth motion vanishes.

use std::f64::consts::{PI, TAU};

use inerter_plant::Excitation;
use rustfft::{FftPlanner, num_complex::Complex};

use super::model::Node;
use crate::law::{mean, median};

/// Length of a spectrum \[s\].
const WINDOW_S: f64 = 2.0;
/// Ratio of the spectrum to that of the white noise from which motion is detected: beyond the scatter of a mean of nine
/// bins.
const CLEAR: f64 = 6.0;
/// Half width over which a spectrum is averaged \[Hz\].
const AROUND_HZ: f64 = 2.0;
/// Margin above the highest frequency detected: factor, and \[Hz\].
const ROOM: (f64, f64) = (1.25, 1.0);
/// Ratio of the stop-band edge to the pass-band edge.
const ROLL_OFF: f64 = 1.5;
/// Maximum band as a fraction of the sample rate.
const WIDEST: f64 = 0.3;
/// Length of the mirrored extensions \[s\].
const MIRROR_S: f64 = 2.0;

/// The terminal's motion without its noise.
#[derive(Clone, Debug)]
pub struct Smooth {
    /// Displacement, velocity, acceleration at each sample.
    pub nodes: Vec<Node>,
    /// White noise of one sample \[m\].
    pub noise: f64,
    /// Pass band \[Hz\].
    pub band_hz: f64,
}

impl Smooth {
    /// From samples with this period. Nothing up to `least_hz` is removed; everything above `most_hz` is, for cases
    /// where the noise is worse than the loss.
    pub fn of(samples: &[f64], period_s: f64, least_hz: f64, most_hz: f64) -> Self {
        let noise = white_noise(samples);
        let band_hz = band_hz(samples, period_s, noise).max(least_hz).min(most_hz).min(WIDEST / period_s);
        Self { nodes: smoothed(samples, period_s, band_hz), noise, band_hz }
    }

    /// A known motion, from a given time on.
    pub fn stated(excitation: &Excitation, start_s: f64, period_s: f64, count: usize) -> Self {
        let node = |place: usize| {
            let point = excitation.at(start_s + place as f64 * period_s);
            [point.x_m, point.v_m_per_s, point.a_m_per_s2]
        };
        Self { nodes: (0..count).map(node).collect(), noise: 0.0, band_hz: excitation.highest_hz() }
    }

    /// The same with added noise, like the remaining sensor noise multiplied by a factor; each number gives another
    /// realisation.
    pub fn disturbed(&self, period_s: f64, times: f64, number: u64) -> Vec<Node> {
        let count = self.nodes.len();
        let amplitude = 2.0 * times * self.noise / (count.max(1) as f64).sqrt();
        let inverse = FftPlanner::new().plan_fft_inverse(count);
        let noise = [0, 1, 2].map(|derivative: i32| {
            let mut spectrum = vec![Complex::default(); count];
            for (bin, slot) in spectrum.iter_mut().enumerate().take(count.div_ceil(2)).skip(1) {
                let frequency_hz = bin as f64 / (count as f64 * period_s);
                let size = amplitude * passes(frequency_hz, self.band_hz);
                let turn = Complex::new(0.0, TAU * frequency_hz).powi(derivative);
                *slot = Complex::from_polar(size, TAU * uniform(bin as u64, number)) * turn;
            }
            inverse.process(&mut spectrum);
            spectrum
        });
        let [x, v, a] = &noise;
        let noise = x.iter().zip(v).zip(a).map(|((x, v), a)| [x.re, v.re, a.re]);
        self.nodes.iter().zip(noise).map(|(node, noise)| [0, 1, 2].map(|k| node[k] + noise[k])).collect()
    }
}

fn passes(frequency_hz: f64, band_hz: f64) -> f64 {
    let beyond = (frequency_hz / band_hz - 1.0) / (ROLL_OFF - 1.0);
    0.5 + 0.5 * (PI * beyond.clamp(0.0, 1.0)).cos()
}

/// A pseudo-random number from 0 to 1 that is the same in every run, by SplitMix64.
pub(super) fn uniform(place: u64, stream: u64) -> f64 {
    let mut z = (place + 1).wrapping_add(stream << 32).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

/// RMS of the white noise of one sample: motion well below the sample rate vanishes in the sixth differences, and
/// impacts do not affect their median.
pub fn white_noise(samples: &[f64]) -> f64 {
    /// Median magnitude of a standard normal variable.
    const MEDIAN: f64 = 0.6745;
    /// Sum of squares of the binomial coefficients of order six.
    const GAIN: f64 = 924.0;
    let differences: Vec<f64> = samples
        .windows(7)
        .map(|window| {
            window.iter().zip([1.0, -6.0, 15.0, -20.0, 15.0, -6.0, 1.0]).map(|(x, c)| x * c).sum::<f64>().abs()
        })
        .collect();
    median(differences).map_or(0.0, |median| median / MEDIAN / GAIN.sqrt())
}

/// Highest frequency at which the spectrum stands clear of the noise in any window, plus a margin \[Hz\].
///
/// The windows are short because a start or an impact is brief but still drives the device.
fn band_hz(samples: &[f64], period_s: f64, noise: f64) -> f64 {
    let count = samples.len().min((WINDOW_S / period_s) as usize).max(1);
    let bin_hz = 1.0 / (count as f64 * period_s);
    let half = (AROUND_HZ / bin_hz).round().max(2.0) as usize;
    let transform = FftPlanner::new().plan_fft_forward(count);
    // The squared Hann window, whose side lobes are below the noise of a sensor with a resolution of 1e-4, passes
    // 35/128 of the power.
    let floor = 35.0 / 128.0 * noise * noise * count as f64;
    let mut highest = half;
    for start in (0..=samples.len() - count.min(samples.len())).step_by((count / 2).max(1)) {
        let part: Vec<f64> = samples.iter().copied().skip(start).take(count).collect();
        let mean = mean(&part);
        let window = |place: usize| (0.5 - 0.5 * (TAU * (place as f64 + 0.5) / count as f64).cos()).powi(2);
        let mut spectrum: Vec<Complex<f64>> =
            part.iter().enumerate().map(|(place, x)| Complex::new((x - mean) * window(place), 0.0)).collect();
        spectrum.resize(count, Complex::default());
        transform.process(&mut spectrum);
        let powers: Vec<f64> = spectrum.iter().take(count / 2).map(|bin| bin.norm_sqr()).collect();
        let width = 2 * half + 1;
        let clear = |around: &[f64]| around.iter().sum::<f64>() > CLEAR * floor * width as f64;
        highest = highest.max(powers.windows(width).rposition(clear).map_or(0, |place| place + half));
    }
    ROOM.0 * highest as f64 * bin_hz + ROOM.1
}

/// Displacement, velocity and acceleration of the content within the band.
fn smoothed(samples: &[f64], period_s: f64, band_hz: f64) -> Vec<Node> {
    let (Some(&first), Some(&last)) = (samples.first(), samples.last()) else { return Vec::new() };
    // The ends are extended by point reflection, so that displacement and velocity are continuous there.
    let mirror = ((MIRROR_S / period_s) as usize).min(samples.len() - 1);
    let before = samples.iter().skip(1).take(mirror).rev().map(|x| 2.0 * first - x);
    let after = samples.iter().rev().skip(1).take(mirror).map(|x| 2.0 * last - x);
    let mut signal: Vec<f64> = before.chain(samples.iter().copied()).chain(after).collect();
    // The remaining step between the ends of the extensions is removed as a straight line.
    let count = signal.len();
    let start = signal[0];
    let slope = (signal[count - 1] - start) / (count - 1).max(1) as f64;
    signal.iter_mut().enumerate().for_each(|(place, x)| *x -= start + slope * place as f64);
    let mut planner = FftPlanner::new();
    let mut spectrum: Vec<Complex<f64>> = signal.iter().map(|x| Complex::new(*x, 0.0)).collect();
    planner.plan_fft_forward(count).process(&mut spectrum);
    let frequency_hz = |bin: usize| {
        let signed = if bin > count / 2 { bin as f64 - count as f64 } else { bin as f64 };
        signed / (count as f64 * period_s)
    };
    let inverse = planner.plan_fft_inverse(count);
    // Displacement and velocity are real, so one transform computes both.
    let mut pair: Vec<Complex<f64>> = spectrum
        .iter()
        .enumerate()
        .map(|(bin, x)| {
            let frequency = frequency_hz(bin);
            let velocity = x * Complex::new(0.0, TAU * frequency);
            (x + velocity * Complex::i()) * passes(frequency.abs(), band_hz) / count as f64
        })
        .collect();
    inverse.process(&mut pair);
    for (bin, x) in spectrum.iter_mut().enumerate() {
        let frequency = frequency_hz(bin);
        *x *= -(TAU * frequency).powi(2) * passes(frequency.abs(), band_hz) / count as f64;
    }
    inverse.process(&mut spectrum);
    pair.iter()
        .zip(&spectrum)
        .enumerate()
        .skip(mirror)
        .take(samples.len())
        .map(|(place, (pair, acceleration))| {
            [pair.re + start + slope * place as f64, pair.im + slope / period_s, acceleration.re]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Noise with an RMS of 1.
    fn noise(place: usize) -> f64 {
        (uniform(place as u64, 0) - 0.5) * 12f64.sqrt()
    }

    #[test]
    fn noise_goes_and_motion_stays() {
        let motion = |place: usize| {
            let t = place as f64 * 1e-3;
            let (w1, w2) = (TAU * 0.8, TAU * 6.4);
            [
                8e-3 * (w1 * t).sin() + 8e-4 * (w2 * t).sin(),
                8e-3 * w1 * (w1 * t).cos() + 8e-4 * w2 * (w2 * t).cos(),
                -8e-3 * w1 * w1 * (w1 * t).sin() - 8e-4 * w2 * w2 * (w2 * t).sin(),
            ]
        };
        let samples: Vec<f64> = (0..20_000).map(|place| motion(place)[0] + 1e-6 * noise(place)).collect();
        let smooth = Smooth::of(&samples, 1e-3, 1.0, f64::INFINITY);
        assert!((smooth.noise - 1e-6).abs() < 0.1e-6, "{}", smooth.noise);
        assert!((6.4..15.0).contains(&smooth.band_hz), "{}", smooth.band_hz);
        let rms = |of: usize| {
            let inner = smooth.nodes.iter().enumerate().skip(1000).take(18_000);
            let square: f64 = inner.map(|(place, node)| (node[of] - motion(place)[of]).powi(2)).sum();
            (square / 18_000.0).sqrt()
        };
        assert!(rms(0) < 0.3e-6, "{}", rms(0));
        assert!(rms(1) < 1.5e-5, "{}", rms(1));
        assert!(rms(2) < 1.5e-3, "{}", rms(2));
    }

    #[test]
    fn a_disturbance_is_as_large_as_what_is_left_of_the_noise() {
        let samples: Vec<f64> = (0..20_000).map(|place| 1e-6 * noise(place)).collect();
        let smooth = Smooth::of(&samples, 1e-3, 25.0, f64::INFINITY);
        let still = Smooth { nodes: vec![[0.0; 3]; 20_000], ..smooth.clone() };
        let disturbed = still.disturbed(1e-3, 1.0, 1);
        let rms =
            |nodes: &[Node], of: usize| (nodes.iter().map(|node| node[of].powi(2)).sum::<f64>() / 20_000.0).sqrt();
        for of in 0..3 {
            let ratio = rms(&disturbed, of) / rms(&smooth.nodes, of);
            assert!((0.9..1.1).contains(&ratio), "{of}: {ratio}");
        }
        assert_ne!(still.disturbed(1e-3, 1.0, 2), disturbed);
    }

    #[test]
    fn too_little_is_no_reason_to_fall_over() {
        for samples in [&[][..], &[1.0][..], &[1.0; 8][..]] {
            assert_eq!(Smooth::of(samples, 1e-3, 1.0, f64::INFINITY).nodes.len(), samples.len());
        }
    }
}
