//! The response at steady tones: each tone's line in force over its line in displacement, in several pieces.

use std::f64::consts::TAU;

use rustfft::{FftPlanner, num_complex::Complex};

use super::point::{Point, windowed};

/// With more tones than this a motion counts as broadband.
const MOST_TONES: usize = 8;
/// Fraction of the velocity's power that the tones must contain.
const LEAST_PART: f64 = 0.9;
/// Multiples of the strongest tone's frequency up to which power counts.
const HARMONICS: usize = 30;
/// Minimum power of a tone relative to the strongest: friction creates weaker ones, most of all at the resonance.
const LEAST_POWER: f64 = 5e-2;
/// Maximum power of a drift relative to the strongest tone.
const MOST_DRIFT: f64 = 0.1;
/// Bins on either side that belong to a tone: a Hann window adds two, ramps and starts a few more.
const LOBE: usize = 8;
/// Fraction of their power that must lie within two bins: an intermittent motion is not a steady tone.
const LEAST_STEADY: f64 = 0.9;
/// Minimum number of periods in the whole run.
const LEAST_BIN: usize = 3;
/// Maximum number of samples searched for tones.
const MOST_SEARCHED: usize = 1 << 18;
/// Number of pieces whose scatter gives the error.
const PIECES: usize = 8;
/// Minimum number of periods per piece.
const LEAST_PERIODS: f64 = 2.0;

/// The response at each tone, or `None` if the motion is not a sum of a few tones.
pub fn measured(pieces: &[(&[f64], &[f64])], period_s: f64) -> Option<Vec<Point>> {
    let (input, force) = pieces.iter().max_by_key(|(input, _)| input.len())?;
    let points: Vec<_> =
        tones(input, period_s)?.into_iter().filter_map(|tone| point(input, force, period_s, tone)).collect();
    (!points.is_empty()).then_some(points)
}

/// Frequencies of the tones \[Hz\], in increasing order.
fn tones(input: &[f64], period_s: f64) -> Option<Vec<f64>> {
    let input = &input[..input.len().min(MOST_SEARCHED)];
    if input.len() < 64 {
        return None;
    }
    let mut spectrum = windowed(input.iter().copied(), input.len());
    FftPlanner::new().plan_fft_forward(spectrum.len()).process(&mut spectrum);
    // The spectrum of velocity: in the displacement a bang-bang motion would look like a tone.
    let half = spectrum.iter().take(spectrum.len() / 2).enumerate();
    let mut power: Vec<f64> = half.map(|(bin, line)| line.norm_sqr() * (bin as f64).powi(2)).collect();
    let strongest_bin = power.iter().enumerate().skip(LEAST_BIN).max_by(|a, b| a.1.total_cmp(b.1))?.0;
    // At higher frequencies the velocity contains only the sensor's quantisation.
    power.truncate(strongest_bin * HARMONICS + LOBE + 1);
    // A drift, or a component with too few periods.
    let drift = power.get_mut(..LEAST_BIN)?;
    let greatest_drift = drift.iter().copied().fold(0.0, f64::max);
    drift.fill(0.0);
    let total: f64 = power.iter().sum();
    let (mut found, mut strongest, mut seen) = (Vec::new(), 0.0_f64, 0.0);
    while found.len() < MOST_TONES {
        let (bin, peak) = power.iter().copied().enumerate().max_by(|a, b| a.1.total_cmp(&b.1))?;
        strongest = strongest.max(peak);
        if peak < LEAST_POWER * strongest || peak <= 0.0 {
            break;
        }
        let end = (bin + LOBE + 1).min(power.len());
        let lobe = power.get_mut(bin.saturating_sub(LOBE)..end)?;
        // The centroid of the lobe's power is the tone's frequency, to a fraction of a bin.
        let offset = |at: usize| at as f64 - bin.min(LOBE) as f64;
        let (sum, moment) = lobe
            .iter()
            .enumerate()
            .filter(|(at, _)| offset(*at).abs() < 2.5)
            .fold((0.0, 0.0), |(sum, moment), (at, power)| (sum + power, moment + power * offset(at)));
        let around: f64 = lobe.iter().sum();
        if sum < LEAST_STEADY * around {
            return None;
        }
        seen += around;
        lobe.fill(0.0);
        found.push((bin as f64 + moment / sum) / (input.len() as f64 * period_s));
    }
    found.sort_by(f64::total_cmp);
    (seen >= LEAST_PART * total && greatest_drift < MOST_DRIFT * strongest).then_some(found)
}

/// Complex amplitudes of both channels at a frequency, in pieces of `length` samples.
fn lines(input: &[f64], force: &[f64], length: usize, turn: f64) -> Vec<(Complex<f64>, Complex<f64>)> {
    let line = |data: &[f64]| -> Complex<f64> {
        let all = windowed(data.iter().copied(), length).into_iter().enumerate();
        all.map(|(at, value)| value * Complex::from_polar(1.0, -turn * at as f64)).sum()
    };
    input
        .chunks_exact(length)
        .zip(force.chunks_exact(length))
        .map(|(input, force)| (line(input), line(force)))
        .collect()
}

fn point(input: &[f64], force: &[f64], period_s: f64, tone_hz: f64) -> Option<Point> {
    let periods = input.len() as f64 * period_s * tone_hz;
    let count = ((periods / LEAST_PERIODS) as usize).min(PIECES);
    let spread = student(count)?;
    let length = input.len() / count;
    // The phase advance from piece to piece gives the error of the frequency.
    let rough = lines(input, force, length, TAU * tone_hz * period_s);
    let expected = Complex::from_polar(1.0, -TAU * tone_hz * period_s * length as f64);
    let advance: Complex<f64> =
        rough.iter().zip(rough.iter().skip(1)).map(|(before, after)| before.0.conj() * after.0 * expected).sum();
    let frequency_hz = tone_hz + advance.arg() / (TAU * period_s * length as f64);
    let lines = lines(input, force, length, TAU * frequency_hz * period_s);
    let of = |part: fn(&(Complex<f64>, Complex<f64>)) -> f64| lines.iter().map(part).sum::<f64>();
    let (inputs, forces) = (of(|line| line.0.norm_sqr()), of(|line| line.1.norm_sqr()));
    let cross: Complex<f64> = lines.iter().map(|line| line.0.conj() * line.1).sum();
    let response = cross / inputs;
    let scatter: f64 = lines.iter().map(|line| (line.1 - line.0 * response).norm_sqr()).sum::<f64>() / inputs;
    // For one of the two components; `inputs` sums the pieces' powers, so this is already the error of the mean.
    let error = (scatter / (2.0 * (count as f64 - 1.0))).sqrt();
    Some(Point {
        frequency_hz,
        response,
        coherence: cross.norm_sqr() / (inputs * forces),
        error: spread * error / response.norm(),
    })
}

/// Half width of a 95 % interval in standard errors, from Student's distribution with `2 (pieces - 1)` degrees of
/// freedom.
fn student(pieces: usize) -> Option<f64> {
    /// From three pieces to the maximum.
    const FROM_THREE: [f64; PIECES - 2] = [2.776, 2.447, 2.306, 2.228, 2.179, 2.145];
    FROM_THREE.get(pieces.checked_sub(3)?).copied()
}
