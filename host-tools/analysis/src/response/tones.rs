//! The response at steady tones: each tone's line in force over its line in displacement, in several pieces.

use std::f64::consts::TAU;

use rustfft::{FftPlanner, num_complex::Complex};

use super::point::{Point, windowed};

/// Tones above which a motion counts as broad.
const MOST_TONES: usize = 8;
/// Part of the velocity's power that the tones must hold.
const LEAST_PART: f64 = 0.9;
/// Multiples of the strongest tone's frequency up to which power counts.
const HARMONICS: usize = 30;
/// Least power of a tone against the strongest: friction makes weaker ones of its own, most of all at the resonance.
const LEAST_POWER: f64 = 5e-2;
/// Greatest power of a drift against the strongest tone.
const MOST_DRIFT: f64 = 0.1;
/// Bins on either side that belong to a tone: a Hann window gives it two, ramps and starts a few more.
const LOBE: usize = 8;
/// Part of their power that must lie within two bins: a motion that comes and goes is no steady tone.
const LEAST_STEADY: f64 = 0.9;
/// Least number of periods in the whole run.
const LEAST_BIN: usize = 3;
/// Samples that are searched for tones.
const MOST_SEARCHED: usize = 1 << 18;
/// Pieces by whose scatter the error is told.
const PIECES: usize = 8;
/// Least number of periods in one.
const LEAST_PERIODS: f64 = 2.0;

/// The response at each tone, or `None` where the motion is no sum of a few tones.
pub fn measured(pieces: &[(&[f64], &[f64])], period_s: f64) -> Option<Vec<Point>> {
    let (input, force) = pieces.iter().max_by_key(|(input, _)| input.len())?;
    let points: Vec<_> =
        tones(input, period_s)?.into_iter().filter_map(|tone| point(input, force, period_s, tone)).collect();
    (!points.is_empty()).then_some(points)
}

/// Frequencies of the tones \[Hz\], rising.
fn tones(input: &[f64], period_s: f64) -> Option<Vec<f64>> {
    let input = &input[..input.len().min(MOST_SEARCHED)];
    if input.len() < 64 {
        return None;
    }
    let mut spectrum = windowed(input.iter().copied(), input.len());
    FftPlanner::new().plan_fft_forward(spectrum.len()).process(&mut spectrum);
    // Of the velocity: of a displacement alone a bang-bang motion would pass for a tone.
    let half = spectrum.iter().take(spectrum.len() / 2).enumerate();
    let mut power: Vec<f64> = half.map(|(bin, line)| line.norm_sqr() * (bin as f64).powi(2)).collect();
    let strongest_bin = power.iter().enumerate().skip(LEAST_BIN).max_by(|a, b| a.1.total_cmp(b.1))?.0;
    // Higher up there is only what the sensor's steps make of a velocity.
    power.truncate(strongest_bin * HARMONICS + LOBE + 1);
    // A drift, or what is left of too few periods.
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
        // The middle of the lobe's power is the tone, to a part of a bin.
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

/// Lines of both channels at a frequency, in pieces of `length` samples.
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
    // The phase's advance from piece to piece is what the frequency is off by.
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
    // Of one of the two components; the pieces' powers sum in `inputs`, so this is the mean's already.
    let error = (scatter / (2.0 * (count as f64 - 1.0))).sqrt();
    Some(Point {
        frequency_hz,
        response,
        coherence: cross.norm_sqr() / (inputs * forces),
        error: spread * error / response.norm(),
    })
}

/// Half width of a 95 % interval in standard errors, by Student's distribution of `2 (pieces - 1)` degrees of freedom.
fn student(pieces: usize) -> Option<f64> {
    /// From three pieces on, up to the most.
    const FROM_THREE: [f64; PIECES - 2] = [2.776, 2.447, 2.306, 2.228, 2.179, 2.145];
    FROM_THREE.get(pieces.checked_sub(3)?).copied()
}
