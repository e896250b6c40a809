//! `H1` from averaged overlapping pieces.
//!
//! The displacement falls with the square of the frequency, and a window would leak this from bin to bin. So the second
//! difference is transformed instead, whose ratio to the force is nearly flat; the difference's exact response `2 cos(w
//! T) - 2` is applied afterwards.

use std::f64::consts::TAU;

use rustfft::{FftPlanner, num_complex::Complex};

use super::point::{Method, NORMAL_COVERAGE, Point, windowed};

/// Minimum number of pieces of a run, not counting overlap.
const PIECES: usize = 6;
/// Finest resolution \[Hz\]: longer runs give more averages instead.
const FINEST_HZ: f64 = 0.05;
/// Lowest bins left out, because they would contain a trend.
const LEAST_BIN: usize = 3;
/// Velocity power, relative to the strongest bin's, below which a bin contains only effects of friction and impacts,
/// not motion of the rig.
const LEAST_MOTION: f64 = 3e-3;
/// Fraction of the sample rate above which there are no points.
const HIGHEST: f64 = 0.4;
/// Independent pieces per piece: Hann windows that overlap by half are correlated by 1/36 in power.
const INDEPENDENT: f64 = 1.0 / (1.0 + 2.0 / 36.0);

#[derive(Clone, Copy, Default)]
struct Sums {
    input: f64,
    force: f64,
    cross: Complex<f64>,
}

/// The response from pieces of displacement and force without a discontinuity.
pub fn measured(pieces: &[(&[f64], &[f64])], period_s: f64) -> (Method, Vec<Point>) {
    let total: usize = pieces.iter().map(|(input, _)| input.len()).sum();
    let most = (1.0 / (FINEST_HZ * period_s)) as usize;
    let length = 1usize << (total / PIECES).clamp(64, most.max(64)).ilog2();
    let fft = FftPlanner::new().plan_fft_forward(length);
    let bins = (length as f64 * HIGHEST) as usize;
    let (mut sums, mut count) = (vec![Sums::default(); bins], 0.0);
    for (input, force) in pieces {
        let (mut input, mut force) = (*input, force.get(1..).unwrap_or_default());
        while let (Some(here), Some(against)) = (input.get(..length + 2), force.get(..length)) {
            let (later, latest) = (here.iter().skip(1), here.iter().skip(2));
            let bent = here.iter().zip(later).zip(latest).map(|((a, b), c)| a - 2.0 * b + c);
            let (mut bent, mut against) = (windowed(bent, length), windowed(against.iter().copied(), length));
            fft.process(&mut bent);
            fft.process(&mut against);
            for (sums, (bent, against)) in sums.iter_mut().zip(bent.iter().zip(&against)) {
                sums.input += bent.norm_sqr();
                sums.force += against.norm_sqr();
                sums.cross += bent.conj() * against;
            }
            count += 1.0;
            input = input.get(length / 2..).unwrap_or_default();
            force = force.get(length / 2..).unwrap_or_default();
        }
    }
    let averages = count * INDEPENDENT;
    let flat = |sums: &Sums| sums.cross / sums.input;
    let motion = |(bin, sums): (usize, &Sums)| sums.input / (bin as f64).powi(2);
    let strongest = sums.iter().enumerate().skip(LEAST_BIN).map(motion).fold(0.0, f64::max);
    let point = |(before, trio): (usize, &[Sums])| {
        let [below, here, above] = trio else { return None };
        let bin = before + 1;
        let turn = TAU * bin as f64 / length as f64;
        let coherence = here.cross.norm_sqr() / (here.input * here.force);
        let chance = NORMAL_COVERAGE * ((1.0 - coherence).max(0.0) / (2.0 * averages * coherence)).sqrt();
        // The position of the motion within the window is unknown: allow for the response's slope over a bin.
        let slope = (flat(above) - flat(below)).norm() / 2.0 / flat(here).norm();
        let point = Point {
            frequency_hz: bin as f64 / (length as f64 * period_s),
            response: flat(here) * (2.0 * turn.cos() - 2.0),
            coherence,
            error: chance.hypot(slope),
        };
        (bin >= LEAST_BIN && motion((bin, here)) >= LEAST_MOTION * strongest).then_some(point)
    };
    // A single piece would have a coherence of one.
    let points = sums.windows(3).enumerate().filter_map(point).filter(|_| count >= 2.0);
    (Method::Welch { averages }, points.collect())
}
