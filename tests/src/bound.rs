//! The smallest scatter that a record allows, given the noise of both channels.
//!
//! The force noise is white. The encoder's position error is white too, uniform over one count, and it enters the law
//! differentiated twice and multiplied by `mt`. A record of a force and a coarse encoder therefore contains less
//! information than the force noise alone suggests, and increasingly so at higher frequencies: at 2.44 um, 1 kHz and
//! 300 kg both contributions are equal at 11 Hz. The bound is that of weighted least squares with the true regressors,
//! weighted by the inverse of the sum of both spectra. In a periodic motion the encoder's error repeats, so its
//! spectrum is not white but concentrated in the lines of the motion. It does not average out, and the scatter may
//! exceed the bound by up to the square root of the number of periods (tests `steps`; [`TWO_CLOCKS`](grid::TWO_CLOCKS)
//! is the rig on which nothing repeats).

use crate::grid::{self, Instruments, Motion, Result};
use inerter_plant::{Inerter, Motion as Screw};
use std::f64::consts::PI;

/// Half length of the whitening filter \[s\].
const HALF_LENGTH_S: f64 = 0.128;
/// Number of frequencies from 0 to half the sample rate at which the filter is designed.
const FREQUENCIES: u32 = 2048;

/// The filter that whitens the sum of both noises to unit variance; symmetric, from its centre tap on.
fn whitening(device: &Inerter, rig: &Instruments, count_m: f64) -> Vec<f64> {
    let count_n = device.inertance_kg * count_m / 12_f64.sqrt() * rig.sample_rate_hz.powi(2);
    let gain = |w: f64| (rig.force_noise_n.powi(2) + (count_n * (2.0 - 2.0 * w.cos())).powi(2)).sqrt().recip();
    let half = (HALF_LENGTH_S * rig.sample_rate_hz) as u32;
    let tap = |n: u32| {
        let frequencies = (0..FREQUENCIES).map(|k| PI * (f64::from(k) + 0.5) / f64::from(FREQUENCIES));
        let tap: f64 = frequencies.map(|w| gain(w) * (w * f64::from(n)).cos()).sum();
        let window = 0.5 + 0.5 * (PI * f64::from(n) / f64::from(half + 1)).cos();
        tap / f64::from(FREQUENCIES) * window
    };
    (0..=half).map(tap).collect()
}

/// The smallest sigma of mt, cf and fc with the noise of force and encoder, over all samples around which the screw
/// slips for the length of core's kernel. `None` if these samples do not determine the parameters.
pub fn least_sigma(device: &Inerter, motion: &Motion, rig: &Instruments, seed: u64) -> Result<Option<[f64; 3]>> {
    if motion.is_slow() {
        // Below 1 Hz the encoder contributes less than a hundredth of the force noise.
        return grid::least_sigma(device, motion, rig, seed, 0.0);
    }
    let simulation = grid::simulation(device, motion, rig, seed)?;
    let filter = whitening(device, rig, simulation.sensors().metres_per_count);
    let truths: Vec<_> = simulation.lasting(motion.duration_s).map(|sample| sample.truth).collect();
    let regressors: Vec<[f64; 4]> =
        truths.iter().map(|t| [t.a2_m_per_s2, t.v2_m_per_s, t.v2_m_per_s.signum(), 1.0]).collect();
    // Core's kernels, which are shorter, determine how far a sample must be from a stuck one.
    let clearance = (motion.kernel_s() / 2.0 * rig.sample_rate_hz) as usize;
    let mut slipping = 0;
    let since: Vec<usize> = truths
        .iter()
        .map(|truth| {
            slipping = if truth.motion == Screw::Stuck { 0 } else { slipping + 1 };
            slipping
        })
        .collect();
    let inner = filter.len()..truths.len().saturating_sub(filter.len());
    Ok(grid::sigmas(inner.filter(|n| since[n + clearance] > 2 * clearance).map(|n| {
        std::array::from_fn(|i| {
            let pairs = filter.iter().enumerate().skip(1);
            filter[0] * regressors[n][i]
                + pairs.map(|(k, tap)| tap * (regressors[n - k][i] + regressors[n + k][i])).sum::<f64>()
        })
    })))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::{MOTIONS, RIGS};

    /// Without the encoder's noise the bound is that of the force alone.
    #[test]
    fn a_fine_encoder_leaves_the_force_alone() {
        let filter = whitening(&Inerter::paper(), &RIGS[1], 1e-12);
        assert!((filter[0] * RIGS[1].force_noise_n - 1.0).abs() < 1e-6, "{}", filter[0]);
        assert!(filter.iter().skip(1).all(|tap| tap.abs() < 1e-6));
    }

    /// The encoder degrades most what depends on the highest frequencies: friction at 15.9 Hz.
    #[test]
    fn a_coarse_encoder_takes_its_part() {
        let (device, rig) = (Inerter::paper(), &RIGS[0]);
        for (motion, ratios) in [(&MOTIONS[1], [1.04, 1.6, 1.7]), (&MOTIONS[4], [1.7, 2.0, 2.2])] {
            let force = grid::least_sigma(&device, motion, rig, 1, 0.0).unwrap().unwrap();
            let both = least_sigma(&device, motion, rig, 1).unwrap().unwrap();
            for ((both, force), ratio) in both.into_iter().zip(force).zip(ratios) {
                assert!((both / force / ratio - 1.0).abs() < 0.1, "{}: {}", motion.name, both / force);
            }
        }
    }
}
