//! The sign and the velocity of each sample, with reversals located from everything known.

use inerter_core::Settings;
use inerter_data::series::Stretch;

use crate::{law::Law, reversals};

/// Mean sign of the velocity over a sample's own period, from a straight line through the velocities half a sample
/// before and after.
pub(super) fn sign((before, after): (f64, f64)) -> f64 {
    match (before.is_nan(), after.is_nan()) {
        (true, true) => 0.0,
        (true, false) => after.signum(),
        (false, true) => before.signum(),
        (false, false) if before * after >= 0.0 => (before + after).signum(),
        (false, false) => (after.abs() - before.abs()) / (after.abs() + before.abs()) * after.signum(),
    }
}

/// Velocities half a sample before and after each sample \[m/s\] through the estimator's short kernel, corrected for
/// the effects of Coulomb friction at a reversal and of a changing force (docs/THEORY.md, 2); uncorrected without an
/// inertance. The force is that of an aligned series. NaN if there are too few samples around.
pub(super) fn velocities(piece: &Stretch, period_s: f64, law: &Law, settings: &Settings) -> Vec<(f64, f64)> {
    let m = reversals::short_half(period_s);
    // Weights of the force's integral: all samples beyond `i` from the middle contain its difference.
    let weights: Vec<f64> = (1..m).map(|i| ((m - i) * (m - i + 1)) as f64 / 2.0 / (m * m) as f64).collect();
    let lost = |at: usize| -> f64 {
        let (later, earlier) = (piece.force_n.iter().skip(at + 1), piece.force_n.iter().take(at + 1).rev());
        weights.iter().zip(later.zip(earlier)).map(|(weight, (later, earlier))| weight * (earlier - later)).sum()
    };
    // Shifted by the fractional part of the skew.
    let late = settings.skew_parts().1 / period_s;
    let bend = |at: usize| lost(at) + late * 0.5 * (lost(at + 1) - lost(at.saturating_sub(1)));
    let corrected = |(at, velocity): (usize, f64)| {
        if law.inertance_kg > 0.0 { velocity + period_s / law.inertance_kg * bend(at) } else { velocity }
    };
    let known = reversals::velocities(piece, period_s, law).into_iter().enumerate().map(corrected);
    let between: Vec<f64> = std::iter::once(f64::NAN).chain(known).chain(std::iter::once(f64::NAN)).collect();
    between.iter().copied().zip(between.iter().copied().skip(1)).collect()
}
