//! Candidate motions for a plan: tones and multisines, each as large as the limits allow, and the information of each
//! per second.

use std::f64::consts::TAU;

use inerter_plant::{Excitation, Tone};

use super::{
    error::PlanError,
    expected::{Expected, GOLDEN},
    information::Information,
    limits::{CLEAR, Limits},
    part::Part,
    peaks::Peaks,
};

/// Amplitude of a smaller tone, relative to the largest one of its frequency.
const LOWER: f64 = 0.4;
/// Number of tones of a multisine.
const TONES: u32 = 8;
/// Phases tried for a multisine, to minimise its peaks.
const PHASES: u32 = 40;
/// Time until the estimator has learnt friction \[s\], and minimum time for which a motion is simulated.
const LEARNT_S: f64 = 2.0;
const SEEN_S: f64 = 4.0;
/// Periods of the lowest tone for which a motion is simulated, and minimum number in a part, in addition to its ramps.
const PERIODS: f64 = 2.5;
const LEAST_PERIODS: f64 = 1.5;
/// Attempts to meet the limits, and the accuracy that is sufficient.
const ATTEMPTS: usize = 6;
const NEAR: f64 = 0.97;
/// Seed of the noise in these simulations.
const SEED: u64 = 1;

/// Thoroughness of the search for motions.
#[derive(Clone, Copy, Debug)]
pub(super) struct Effort {
    /// Number of tone frequencies.
    pub frequencies: u32,
    /// Whether to include smaller tones and multisines.
    pub varied: bool,
}

/// A candidate motion.
#[derive(Clone, Debug)]
pub(super) struct Candidate {
    /// Its tones, whose sum is zero at the start, and their ramps.
    pub part: Part,
    /// Minimum time that it takes \[s\].
    pub shortest_s: f64,
    /// Its information per second.
    pub information: Information,
    /// Its peaks, to compare with the limits.
    pub peaks: Peaks,
}

/// The lowest frequency \[Hz\].
fn lowest_hz(tones: &[Tone]) -> f64 {
    tones.iter().map(|tone| tone.frequency_hz).fold(f64::INFINITY, f64::min)
}

/// All candidates with any information; the last error if none can be simulated.
pub(super) fn candidates(
    expected: &Expected,
    limits: &Limits,
    effort: Effort,
    mut progress: impl FnMut(f64),
) -> Result<Vec<Candidate>, PlanError> {
    let shapes = shapes(expected, limits, effort);
    let (mut found, count) = (Vec::new(), shapes.len() as f64);
    for (number, tones) in shapes.into_iter().enumerate() {
        progress(number as f64 / count);
        let Some(largest) = enlarged(expected, limits, tones)? else { continue };
        let tones = &largest.part.tones;
        if effort.varied && tones.len() == 1 {
            found.extend(seen(expected, limits, scaled(tones, LOWER))?);
        }
        found.push(largest);
    }
    Ok(found)
}

/// Tones with logarithmically spaced frequencies, and multisines of bands, still without an amplitude.
fn shapes(expected: &Expected, limits: &Limits, effort: Effort) -> Vec<Vec<Tone>> {
    let rate_hz = expected.settings.sample_rate_hz;
    let spread = |low_hz: f64, high_hz: f64, count: u32| {
        let step = if count > 1 { (high_hz / low_hz).ln() / f64::from(count - 1) } else { 0.0 };
        (0..count).map(move |k| incommensurate(low_hz * (step * f64::from(k)).exp(), rate_hz))
    };
    let tones = spread(limits.lowest_hz, limits.highest_hz, effort.frequencies).map(|hz| vec![Tone::new(hz, 0.0)]);
    let mut shapes: Vec<Vec<Tone>> = tones.collect();
    let middle_hz = (limits.lowest_hz * limits.highest_hz).sqrt();
    let bands = [(limits.lowest_hz, limits.highest_hz), (middle_hz, limits.highest_hz)];
    if effort.varied && limits.highest_hz > 2.0 * limits.lowest_hz {
        shapes.extend(bands.map(|(low_hz, high_hz)| multisine(spread(low_hz, high_hz, TONES))));
    }
    shapes
}

/// A nearby frequency whose period is not a whole number of samples: strokes that never repeat average out the
/// encoder's steps.
fn incommensurate(frequency_hz: f64, rate_hz: f64) -> f64 {
    rate_hz / ((rate_hz / frequency_hz).floor() + GOLDEN)
}

/// Tones of equal velocity at these frequencies, with the phases that minimise the peaks of displacement and velocity,
/// scaled to 1 m/s in the sum's velocity; zero at the start.
fn multisine(frequencies: impl Iterator<Item = f64>) -> Vec<Tone> {
    let frequencies: Vec<f64> = frequencies.collect();
    let velocity = (frequencies.len() as f64).sqrt().recip();
    let with = |turn: u32| -> Vec<Tone> {
        let phase =
            |place: usize| TAU * (f64::from(turn) * (place as f64 + 1.0) * GOLDEN * (place as f64 + 0.5)).fract();
        let tone =
            |(place, hz): (usize, &f64)| Tone { phase_rad: phase(place), ..Tone::new(*hz, velocity / (TAU * hz)) };
        frequencies.iter().enumerate().map(tone).collect()
    };
    let best = (0..PHASES).map(with).map(|tones| (crest(&tones), tones)).min_by(|a, b| a.0.total_cmp(&b.0));
    best.map(|(_, tones)| from_zero(tones)).unwrap_or_default()
}

/// Displacement and velocity of a sum of tones at a given time.
fn at(tones: &[Tone], t_s: f64) -> (f64, f64) {
    tones.iter().fold((0.0, 0.0), |(x, v), tone| {
        let w = TAU * tone.frequency_hz;
        let (sin, cos) = (w * t_s + tone.phase_rad).sin_cos();
        (x + tone.amplitude_m * sin, v + tone.amplitude_m * w * cos)
    })
}

/// Sampling times for a sum of tones: ten periods of the lowest, ten points in each period of the highest.
fn times(tones: &[Tone]) -> impl Iterator<Item = f64> + use<> {
    let highest_hz = tones.iter().map(|tone| tone.frequency_hz).fold(0.0, f64::max);
    let count = (100.0 * highest_hz / lowest_hz(tones)).min(20_000.0) as u32;
    (0..count).map(move |k| f64::from(k) / (10.0 * highest_hz))
}

/// Product of the crest factors of displacement and velocity.
fn crest(tones: &[Tone]) -> f64 {
    let (mut peaks, mut squares, mut count) = ([0.0f64; 2], [0.0; 2], 0.0);
    for (x, v) in times(tones).map(|t_s| at(tones, t_s)) {
        count += 1.0;
        for (value, (peak, square)) in [x, v].into_iter().zip(peaks.iter_mut().zip(&mut squares)) {
            *peak = peak.max(value.abs());
            *square += value * value;
        }
    }
    peaks.iter().zip(squares).map(|(peak, square)| peak / (square / f64::max(count, 1.0)).sqrt()).product()
}

/// The same tones, shifted to start at a zero of their sum, so that a motion from rest stays centred.
fn from_zero(tones: Vec<Tone>) -> Vec<Tone> {
    let mut passes =
        times(&tones).zip(times(&tones).skip(1)).filter(|(a, b)| at(&tones, *a).0 * at(&tones, *b).0 <= 0.0);
    let Some((mut low, mut high)) = passes.next() else { return tones };
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if at(&tones, low).0 * at(&tones, middle).0 <= 0.0 { high = middle } else { low = middle }
    }
    let turned = |tone: Tone| Tone { phase_rad: (tone.phase_rad + TAU * tone.frequency_hz * low) % TAU, ..tone };
    tones.into_iter().map(turned).collect()
}

/// The tones with scaled amplitudes.
fn scaled(tones: &[Tone], factor: f64) -> Vec<Tone> {
    tones.iter().map(|tone| Tone { amplitude_m: factor * tone.amplitude_m, ..*tone }).collect()
}

/// Enlarged as far as the limits allow: first by the terminal's motion alone, then by the resulting force of the
/// device.
fn enlarged(expected: &Expected, limits: &Limits, tones: Vec<Tone>) -> Result<Option<Candidate>, PlanError> {
    let of_unit_speed = |tone: Tone| Tone { amplitude_m: (TAU * tone.frequency_hz).recip(), ..tone };
    let unit = if tones.len() == 1 { tones.into_iter().map(of_unit_speed).collect() } else { tones };
    let mut kinematic = Peaks::default();
    for (x, v) in times(&unit).map(|t_s| at(&unit, t_s)) {
        kinematic = kinematic.and(Peaks { stroke_m: x.abs(), speed_m_per_s: v.abs(), ..Peaks::default() });
    }
    // The force with a rigid contact, which a resonance exceeds.
    let [mass_kg, viscous, ..] = expected.law();
    let acceleration: f64 = unit.iter().map(|tone| tone.amplitude_m * (TAU * tone.frequency_hz).powi(2)).sum();
    let per_size = mass_kg * acceleration + viscous * kinematic.speed_m_per_s;
    let free_n = limits.force_n - expected.device.coulomb_n;
    let greatest = CLEAR * expected.settings.full_scale_acceleration_m_per_s2;
    let mut size = limits.room(&kinematic).min(free_n / per_size).min(greatest / acceleration) * NEAR;
    let mut best: Option<Candidate> = None;
    for _ in 0..ATTEMPTS {
        let tones = scaled(&unit, size);
        let Some(found) = seen(expected, limits, tones)? else {
            // A motion that does not break free may be too small.
            size *= 1.5;
            if size > limits.room(&kinematic) {
                return Ok(best);
            }
            continue;
        };
        let room = limits.room(&found.peaks);
        if room >= 1.0 {
            best = Some(found);
        }
        if (1.0..1.0 / NEAR / NEAR).contains(&room) {
            break;
        }
        size = (size * (1.0 + (room - 1.0) * 0.9) * if room < 1.0 { NEAR } else { 1.0 })
            .min(limits.room(&kinematic) * NEAR);
    }
    Ok(best)
}

/// The information of tones of this size; `None` if the estimator uses none of their samples.
fn seen(expected: &Expected, limits: &Limits, tones: Vec<Tone>) -> Result<Option<Candidate>, PlanError> {
    let lowest_hz = lowest_hz(&tones);
    // Shorter ramps would be faster than the motion.
    let fade_s = limits.fade_s.max(0.25 / lowest_hz);
    let (from_s, duration_s) = (fade_s + LEARNT_S, SEEN_S.max(PERIODS / lowest_hz));
    let motion = Excitation::tones(tones.clone()).with_ramp(fade_s);
    let seen = expected.quick().see(&motion, from_s + duration_s, SEED, Some(from_s))?;
    let (shortest_s, peaks) = (2.0 * fade_s + LEAST_PERIODS / lowest_hz, seen.peaks);
    let (part, information) = (Part { tones, duration_s, fade_s }, Information::of(seen, duration_s));
    Ok(information.is_something().then_some(Candidate { part, shortest_s, information, peaks }))
}
