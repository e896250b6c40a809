//! The law `F = mt a + cf v + fc sgn(v) + F0` against the measured force, both through the estimator's kernels.
//!
//! The kernels are core's (docs/THEORY.md, 1) in f64, centred instead of late: what is shown is what the estimator has
//! compared. The structure mass adds `mr x1''` to the law, with `x1'' = a + F''/ks - cs F'''/ks^2`; the skew is
//! taken out by whole samples, and what is left of it out of the force by its series.

use inerter_core::constants::{
    FORCE_TAPS, LONGEST_SPACING, RATE_TAPS, REST_COUNTS, REST_WINDOW_S, SIGN_KERNEL_S, SIGN_TAPS,
};
use inerter_core::{Bank, Settings};
use inerter_data::series::{Series, Stretch};

/// Values of the law.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Law {
    /// Effective inertance \[kg\].
    pub inertance_kg: f64,
    /// Viscous friction \[N s/m\].
    pub viscous_n_s_per_m: f64,
    /// Coulomb friction \[N\].
    pub coulomb_n: f64,
    /// Force offset \[N\].
    pub offset_n: f64,
}

/// Measured force and law at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Time \[s\].
    pub t_s: f64,
    /// Displacement of the screw \[m\].
    pub position_m: f64,
    /// Measured force \[N\].
    pub force_n: f64,
    /// Force by the law \[N\]; NaN where the screw stands, as friction at rest follows no law.
    pub law_n: f64,
}

/// The kernels of one bank, as taps that lie around a sample.
pub struct Kernels {
    pub(crate) force: Vec<f64>,
    pub(crate) rate: Vec<f64>,
    pub(crate) second: Vec<f64>,
    third: Vec<f64>,
    pub(crate) sign: Vec<f64>,
    pub(crate) box_samples: usize,
    period_s: f64,
}

/// What the kernels make of the samples around one.
pub(crate) struct Measured {
    /// Force \[N\], the skew taken out.
    pub force_n: f64,
    /// Velocity \[m/s\].
    pub velocity: f64,
    /// Acceleration \[m/s^2\].
    pub acceleration: f64,
    /// By how much the terminal's acceleration is greater \[m/s^2\].
    pub stretch: f64,
}

impl Measured {
    /// Force that acts on the screw \[N\]: without what the structure takes more of than it would if it moved with the screw.
    pub(crate) fn on_screw_n(&self, settings: &Settings) -> f64 {
        self.force_n - settings.structure_mass_kg * self.stretch
    }
}

impl Kernels {
    /// Those of a bank at a sample rate.
    pub fn new(bank: Bank, period_s: f64) -> Self {
        let box_s = bank.box_s();
        let m = 2 * ((box_s / period_s / 2.0).round().clamp(1.0, LONGEST_SPACING) as usize);
        let (length, t) = (m as f64, period_s);
        let smooth = vec![1.0 / length; m];
        let mut difference = vec![0.0; m + 1];
        // Taps run with time: the later sample counts positive.
        (difference[0], difference[m]) = (-1.0 / (length * t), 1.0 / (length * t));
        let made = |derivative: usize, correction: &[f64]| {
            let gain: f64 = correction.iter().sum();
            let correction: Vec<f64> = correction.iter().map(|tap| tap / gain).collect();
            let steps = (0..4).map(|step| if step < derivative { &difference } else { &smooth });
            steps.fold(correction, |taps, step| convolved(&taps, step))
        };
        Self {
            force: made(0, &FORCE_TAPS),
            rate: made(1, &RATE_TAPS),
            second: made(2, &[1.0]),
            third: made(3, &[1.0, 1.0]),
            sign: made(0, &SIGN_TAPS),
            box_samples: m,
            period_s,
        }
    }

    /// Half of the longest kernel \[samples\].
    pub(crate) fn reach(&self) -> usize {
        [&self.force, &self.rate, &self.second, &self.third, &self.sign]
            .map(|taps| taps.len() / 2)
            .into_iter()
            .max()
            .unwrap_or(0)
    }

    /// Rows of all stretches between two times \[s\], so many in a box.
    pub fn rows(
        &self,
        series: &Series,
        settings: &Settings,
        law: &Law,
        (from_s, to_s): (f64, f64),
        per_box: usize,
    ) -> Vec<Row> {
        let spacing = (self.box_samples / per_box).max(1);
        let mut rows = Vec::new();
        for stretch in &series.aligned(settings).stretches {
            let margin_s = (self.reach() + 2) as f64 * self.period_s;
            let first = ((from_s - stretch.start_s - margin_s) / self.period_s).floor().max(0.0) as usize;
            let last = ((to_s - stretch.start_s + margin_s) / self.period_s).ceil().max(0.0) as usize;
            let last = last.min(stretch.force_n.len());
            let (Some(position), Some(force)) = (stretch.position_m.get(first..last), stretch.force_n.get(first..last))
            else {
                continue;
            };
            let start_s = stretch.start_s + first as f64 * self.period_s;
            let piece =
                Stretch { start_s, position_m: position.to_vec(), force_n: force.to_vec(), terminal_m: Vec::new() };
            let signs = signs(&piece, self.period_s, law);
            let middles = (self.reach()..piece.force_n.len().saturating_sub(self.reach())).step_by(spacing);
            let new = middles.map(|middle| self.row(&piece, &signs, settings, law, middle));
            rows.extend(new.filter(|row| (from_s..=to_s).contains(&row.t_s)));
            // A line across missing samples would show what was not measured.
            rows.push(Row { t_s: f64::NAN, position_m: f64::NAN, force_n: f64::NAN, law_n: f64::NAN });
        }
        rows
    }

    /// What is measured around a sample of an aligned series.
    pub(crate) fn measured(&self, piece: &Stretch, settings: &Settings, middle: usize) -> Measured {
        let Settings { stiffness_n_per_m: ks, contact_damping_n_s_per_m: cs, .. } = *settings;
        let (_, skew_s) = settings.skew_parts();
        let of = |taps: &[f64], data: &[f64]| around(taps, data, middle);
        let force = &piece.force_n;
        let [rate, second, third] = [&self.rate, &self.second, &self.third].map(|taps| of(taps, force));
        Measured {
            force_n: of(&self.force, force) + skew_s * (rate + skew_s / 2.0 * (second + skew_s / 3.0 * third)),
            velocity: of(&self.rate, &piece.position_m),
            acceleration: of(&self.second, &piece.position_m),
            stretch: if ks > 0.0 { (second + (skew_s - cs / ks) * third) / ks } else { 0.0 },
        }
    }

    fn row(&self, piece: &Stretch, signs: &[f64], settings: &Settings, law: &Law, middle: usize) -> Row {
        let Measured { force_n, velocity, acceleration, stretch } = self.measured(piece, settings, middle);
        let law_n = law.inertance_kg * acceleration
            + law.viscous_n_s_per_m * velocity
            + law.coulomb_n * around(&self.sign, signs, middle)
            + law.offset_n
            + settings.structure_mass_kg * (acceleration + stretch);
        let half = (REST_WINDOW_S / 2.0 / self.period_s).ceil() as usize;
        let near = piece.position_m.get(middle.saturating_sub(half)..middle + half + 1).unwrap_or(&piece.position_m);
        Row {
            t_s: piece.start_s + middle as f64 * self.period_s,
            position_m: around(&self.force, &piece.position_m, middle),
            force_n,
            law_n: if stands(near, settings) { f64::NAN } else { law_n },
        }
    }
}

/// Whether the screw stands while it goes through these positions \[m\].
pub(crate) fn stands(positions: &[f64], settings: &Settings) -> bool {
    let (low, high) =
        positions.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(*x), high.max(*x)));
    let still_m = (REST_COUNTS * settings.metres_per_count.abs()).max(settings.stuck_displacement_m);
    high - low <= still_m * (1.0 + 1e-6)
}

pub(crate) fn convolved(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut taps = vec![0.0; a.len() + b.len() - 1];
    for (at, left) in a.iter().enumerate() {
        for (tap, right) in taps.iter_mut().skip(at).zip(b) {
            *tap += left * right;
        }
    }
    taps
}

/// Taps laid with their middle over one sample. All kernels are of odd length.
pub(crate) fn around(taps: &[f64], data: &[f64], middle: usize) -> f64 {
    let first = middle.saturating_sub(taps.len() / 2);
    taps.iter().zip(data.iter().skip(first)).map(|(tap, value)| tap * value).sum()
}

/// Mean sign of the velocity over each sample's own period: by straight lines through velocities halfway between samples.
pub(crate) fn signs(piece: &Stretch, period_s: f64, law: &Law) -> Vec<f64> {
    let mean = |(before, after): (f64, f64)| match (before.is_nan(), after.is_nan()) {
        (true, true) => 0.0,
        (true, false) => after.signum(),
        (false, true) => before.signum(),
        (false, false) if before * after >= 0.0 => (before + after).signum(),
        (false, false) => (after.abs() - before.abs()) / (after.abs() + before.abs()) * after.signum(),
    };
    velocities(piece, period_s, law).map(mean).collect()
}

/// Velocities half a sample before and after each \[m/s\], from which what Coulomb friction itself makes of a short kernel is
/// taken; NaN where there are too few samples around.
pub(crate) fn velocities(piece: &Stretch, period_s: f64, law: &Law) -> impl Iterator<Item = (f64, f64)> {
    let m = (SIGN_KERNEL_S / period_s).round().max(1.0) as usize;
    let triangle = convolved(&vec![1.0; m], &vec![1.0; m]);
    let sum: f64 = triangle.iter().sum();
    let moment: f64 = triangle.iter().enumerate().map(|(at, tap)| tap * (at as f64 - (m - 1) as f64).abs()).sum();
    let kink = if law.inertance_kg > 0.0 { moment / sum * period_s * law.coulomb_n / law.inertance_kg } else { 0.0 };
    let steps: Vec<f64> = piece.position_m.iter().zip(piece.position_m.iter().skip(1)).map(|(a, b)| b - a).collect();
    let velocity = |at: usize| {
        let force = piece.force_n.iter().skip(at).take(2).sum::<f64>() - 2.0 * law.offset_n;
        around(&triangle, &steps, at) / sum / period_s + kink * force.signum()
    };
    let known = (0..steps.len()).map(|at| if at + 1 < m || at + m > steps.len() { f64::NAN } else { velocity(at) });
    let velocities: Vec<f64> = std::iter::once(f64::NAN).chain(known).chain(std::iter::once(f64::NAN)).collect();
    let after = velocities.clone().into_iter().skip(1);
    velocities.into_iter().zip(after)
}

#[cfg(test)]
#[path = "law_tests.rs"]
mod tests;
