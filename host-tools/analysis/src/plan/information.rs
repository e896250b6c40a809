//! The information of the regressors' sums about the device, by the estimator's own theory (docs/THEORY.md, 6).

use inerter_core::constants::{CLEAR_OF_STEPS, MOVED};
use inerter_core::{Bank, Budget, Found, Motion, Source, Systematic};

use super::{
    expected::{Expected, Seen},
    speeds::Speeds,
};
use crate::fit::{Products, budget};

/// Mean of the amount by which the square of a standard normal deviation exceeds its variance: `E max(0, z^2 - 1)`.
const BEYOND_CHANCE: f64 = 0.484;
/// Margin of the acceleration to the bound between the banks.
const CERTAIN: f64 = 1.25;
/// Half of the velocity's rms: lower speeds count as near rest.
const NEAR_REST: f64 = 0.5;

/// The information of a motion per second.
#[derive(Clone, Debug)]
pub(super) struct Information {
    all: Together,
    /// Sums by speed, for the fast and the slow bank.
    speeds: [Speeds; 2],
}

/// The first of [`Together::means`] if the fast bank has no updates.
const OF_NONE: [f64; 5] = [1.0, 0.0, 0.0, 0.0, 0.0];

/// Sums over motions, and the other inputs of the intervals.
#[derive(Clone, Copy, Debug)]
pub(super) struct Together {
    /// For the fast and the slow bank.
    products: [Products; 2],
    /// Those away from rest.
    away: [Option<Products>; 2],
    /// Number of reversals, each counted as often as its stroke has repeated.
    reversals_again: f64,
    /// Means over time: how often each stroke occurred; the fraction of the structure's mass that is lost because the
    /// structure moves across the gap; the fraction of the strokes that are as long as the previous one; viscous and
    /// Coulomb friction that the second derivative of the force imitates \[N s/m and N, per N/s^2\]. Means of the
    /// motion's squared frequency, weighted by the squared acceleration and velocity \[rad^2/s^2\].
    means: [f64; 7],
}

/// The resulting uncertainties.
#[derive(Clone, Copy, Debug)]
pub(super) struct Told {
    /// Budgets of the four parameters.
    pub budgets: [Budget; 4],
    /// Logarithm of the determinant of the covariance of inertance, viscous and Coulomb friction, without what no
    /// motion can change: gain, lead and timebase.
    pub log_det: f64,
}

impl Information {
    /// The information seen in this many seconds of samples.
    pub fn of(seen: Seen, seconds: f64) -> Self {
        let mut all = Together::of(&seen).times(1.0 / seconds);
        // No stroke of a candidate repeats.
        (all.means[0], all.reversals_again) = (1.0, 0.0);
        Self { all, speeds: seen.speeds.map(|speeds| speeds.times(1.0 / seconds).accumulated()) }
    }

    /// Whether either bank used any samples.
    pub fn is_something(&self) -> bool {
        self.all.products.iter().any(|products| products.updates() > 0.0)
    }
}

impl Together {
    /// All the information in a simulation.
    pub fn of(seen: &Seen) -> Self {
        // The products already contain the acceleration.
        let Motion {
            repeats,
            apart,
            reversals_again,
            frequency_squared,
            low_squared,
            friction_in_curvature: [viscous, coulomb],
            steady,
            ..
        } = seen.outcome.motion;
        let means = [repeats, apart, steady, viscous, coulomb, frequency_squared, low_squared].map(f64::from);
        Self { products: seen.products, away: [None; 2], reversals_again: reversals_again.into(), means }
    }

    /// Each for this many seconds; `None` if there are none.
    pub fn lasting<'a>(parts: impl Iterator<Item = (f64, &'a Information)> + Clone) -> Option<Self> {
        let mut all = parts.clone().map(|(seconds, part)| part.all.times(seconds)).reduce(|all, one| all.and(&one))?;
        for (bank, (away, products)) in all.away.iter_mut().zip(&all.products).enumerate() {
            let [_, velocity_square] = products.mean_squares();
            let slowest = NEAR_REST * velocity_square.max(0.0).sqrt();
            let faster =
                parts.clone().filter_map(|(seconds, part)| Some(part.speeds[bank].above(slowest)?.times(seconds)));
            *away = faster.reduce(|all, one| all.and(&one));
        }
        Some(all)
    }

    /// The same information, while it has no sums away from rest, multiplied by a factor.
    fn times(mut self, factor: f64) -> Self {
        self.products = self.products.map(|products| products.times(factor));
        self.reversals_again *= factor;
        self
    }

    fn and(&self, other: &Self) -> Self {
        let [mine, others] = [self, other].map(|each| {
            let length = each.products[0].updates();
            // Sums, not mean squares: each counts according to its length.
            let [acceleration, velocity] = each.products[0].mean_squares().map(|square| (square * length).max(0.0));
            [length, length, length, length, length, acceleration, velocity]
        });
        let mean = |i: usize| match (mine[i], others[i]) {
            (a, b) if a + b > 0.0 => (a * self.means[i] + b * other.means[i]) / (a + b),
            _ => OF_NONE.get(i).copied().unwrap_or(self.means[i]),
        };
        Self {
            products: std::array::from_fn(|bank| self.products[bank].and(&other.products[bank])),
            away: [None; 2],
            reversals_again: self.reversals_again + other.reversals_again,
            means: std::array::from_fn(mean),
        }
    }

    /// The law's mean square residual in one bank relative to what noise and steps explain.
    pub fn beyond_explained(&self, bank: Bank, expected: &Expected) -> Option<f64> {
        let products = &self.products[usize::from(bank == Bank::Slow)];
        let [inertance_kg, ..] = expected.law();
        products.beyond_explained(inertance_kg, expected.force_noise_n, &expected.settings).ok()
    }

    /// The uncertainties for the expected device; `None` if a combination of parameters is not identified, or if it is
    /// not certain that the estimator will use the `wanted` bank. If any bank will do and it is uncertain which one the
    /// estimator will use, the one with less information counts.
    pub fn told(&self, expected: &Expected, wanted: Option<Bank>) -> Option<Told> {
        let [fast, _] = &self.products;
        let [acceleration, _] = fast.mean_squares();
        // Squared ratio of the acceleration to that from which the estimator uses the fast bank.
        let clear = acceleration / (CLEAR_OF_STEPS * fast.steps_square(&expected.settings));
        let of = |bank| self.told_by(bank, expected, 1.0);
        match wanted {
            None | Some(Bank::Fast) if clear > CERTAIN => of(Bank::Fast),
            None | Some(Bank::Slow) if clear < 1.0 / CERTAIN => of(Bank::Slow),
            None => {
                let (fast, slow) = (of(Bank::Fast)?, of(Bank::Slow)?);
                Some(if fast.log_det > slow.log_det { fast } else { slow })
            }
            Some(_) => None,
        }
    }

    /// The same for one bank, if the law's mean square residual is this multiple of what noise and steps explain.
    pub fn told_by(&self, bank: Bank, expected: &Expected, times: f64) -> Option<Told> {
        let settings = &expected.settings;
        let place = usize::from(bank == Bank::Slow);
        let noise_n = expected.force_noise_n;
        let solved = |products: &Products| products.expected(expected.law(), noise_n, times, settings).ok();
        let solution = solved(&self.products[place])?;
        let [acceleration, _] = self.products[place].mean_squares();
        let [repeats, apart, steady, viscous, coulomb, frequency_squared, low_squared] =
            self.means.map(|mean| mean as f32);
        let motion = Motion {
            repeats,
            apart,
            frequency_squared,
            low_squared,
            acceleration_squared: (acceleration - self.products[place].steps_square(settings)) as f32,
            readings: self.products[place].readings(settings) as f32,
            steady,
            reversals_again: self.reversals_again as f32,
            friction_in_curvature: [viscous, coulomb],
        };
        let spread = solution.scatter.in_motion(&motion);
        let systematic = Systematic::of(settings);
        let each: [Found; 4] = solution.each();
        let mut budgets: [Budget; 4] = std::array::from_fn(|i| budget(i, &systematic, &each[i], &spread, &motion));
        if let Some(away) = self.away[place].as_ref().and_then(solved) {
            let moved = moved_by_chance(&each, &away.each(), &budgets[2]);
            for (budget, moved) in budgets.iter_mut().zip(moved) {
                *budget = budget.and(Source::Model, moved);
            }
        }
        let by_motion = |i: usize| f64::from(budgets[i].same_rig_u95());
        let part =
            |i: usize, j: usize| solution.inverse[i][j] / (solution.inverse[i][i] * solution.inverse[j][j]).sqrt();
        let (a, b, c) = (part(0, 1), part(0, 2), part(1, 2));
        let correlated = 1.0 + 2.0 * a * b * c - a * a - b * b - c * c;
        let log_det = correlated.ln() + 2.0 * (0..3).map(|i| by_motion(i).ln()).sum::<f64>();
        log_det.is_finite().then_some(Told { budgets, log_det })
    }
}

/// By how much inertance, viscous and Coulomb friction will differ by chance alone between the fit to all updates and
/// the fit away from rest, as the half width that the estimator derives from it.
fn moved_by_chance(all: &[Found; 4], away: &[Found; 4], coulomb: &Budget) -> [f32; 3] {
    let scatter = f64::from(coulomb.fit_square()) / f64::from(all[2].error).powi(2);
    let per_square = MOVED.powi(2) * BEYOND_CHANCE * scatter;
    std::array::from_fn(|i| {
        let grown = f64::from(away[i].error).powi(2) - f64::from(all[i].error).powi(2);
        (per_square * grown).max(0.0).sqrt() as f32
    })
}
