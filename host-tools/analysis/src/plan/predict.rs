//! Predicts the intervals of a motion with the expected device: from the estimator's theory applied to its sums, and
//! from rehearsals where there is no formula.
//!
//! A rehearsal is a simulated run of the whole motion with the rig's noise through the estimator itself. The theory is
//! applied to its sums: `u_a`, the encoder's component and everything that the settings state follow from them
//! (docs/THEORY.md, 6). Rehearsals give what has no formula: by how much the residual exceeds what noise and steps
//! explain, the addition for a law that may not hold, the scatter of values where steps repeat or reversals are
//! misplaced, and whether there is a value at all.

use inerter_core::{Backlash, Bank, Budget, Detail, LawStatus, NORMAL_COVERAGE, Source};
use inerter_plant::Excitation;

use super::{
    error::PlanError,
    expected::{Expected, Seen},
    information::{Together, Told},
    peaks::Peaks,
};
use crate::{cores::on_cores, fit::each, law::median};

/// Rehearsals of a prediction: they give the scatter to a tenth.
pub const REHEARSALS: u64 = 48;
/// The seed before that of the first one.
const BEFORE_FIRST: u64 = 900;

/// The prediction for one parameter.
#[derive(Clone, Copy, Debug)]
pub struct Predicted {
    /// The expected value.
    pub value: f64,
    /// The sources of its interval.
    pub budget: Budget,
    /// Standard uncertainty from scatter if noise and steps explain the residual: from the theory alone.
    pub theory_u_a: f64,
    /// Scatter of the values from run to run, as a standard deviation.
    pub scatter: f64,
    /// Fraction of the rehearsals that gave a value.
    pub given: f64,
}

impl Predicted {
    /// Half width of the 95 % interval that will be stated; infinite if most rehearsals gave none.
    pub fn u95(&self) -> f64 {
        if self.is_given() { f64::from(self.budget.u95()) } else { f64::INFINITY }
    }

    /// The same without the errors that two runs on one rig share.
    pub fn same_rig_u95(&self) -> f64 {
        if self.is_given() { f64::from(self.budget.same_rig_u95()) } else { f64::INFINITY }
    }

    /// Standard uncertainty from the scatter of a run alone, which the estimator will state.
    pub fn u_a(&self) -> f64 {
        f64::from(self.budget.standard_error())
    }

    /// Half width that covers both the stated interval and 95 % of the scatter.
    pub fn half_width(&self) -> f64 {
        self.u95().max(f64::from(NORMAL_COVERAGE) * self.scatter)
    }

    /// Whether there will be a value.
    pub fn is_given(&self) -> bool {
        self.given >= 0.5 && self.budget.u95().is_finite()
    }

    /// Whether the value will be larger than its interval.
    pub fn is_shown(&self) -> bool {
        self.u95() < self.value.abs()
    }

    /// The largest source of its interval; without noise, of what does not average out.
    pub fn most(&self, with_noise: bool) -> Source {
        let parts = self.budget.parts().into_iter().filter(|(source, _)| with_noise || *source != Source::Noise);
        parts.max_by(|a, b| a.1.total_cmp(&b.1)).map_or(Source::Noise, |(source, _)| source)
    }
}

/// The prediction for a motion.
#[derive(Clone, Debug)]
pub struct Prediction {
    /// The predictions for inertance, viscous and Coulomb friction and offset.
    pub parameters: [Predicted; 4],
    /// The backlash in the first rehearsal.
    pub backlash: Backlash,
    /// What it needs from the rig.
    pub peaks: Peaks,
    /// Bank that the estimate will come from.
    pub bank: Bank,
    /// Frequencies at which the inertance will be measured \[Hz\].
    pub band_hz: [f64; 2],
    /// Fraction of the rehearsals in which the law was judged broken.
    pub broken: f64,
}

/// The prediction for a motion of this duration \[s\] with the expected device.
pub fn predict(expected: &Expected, motion: &Excitation, duration_s: f64) -> Result<Prediction, PlanError> {
    let seen = rehearsed(expected, motion, duration_s)?;
    let count = seen.len() as f64;
    let in_fast = seen.iter().filter(|seen| seen.outcome.estimate.bank == Bank::Fast).count() as f64;
    let bank = if in_fast >= 0.5 * count { Bank::Fast } else { Bank::Slow };
    // If the estimator restarts its sums during the motion, averages make no sense: the median run represents all.
    let sums: Vec<Together> = seen.iter().map(Together::of).collect();
    let beyond = median(sums.iter().filter_map(|sums| sums.beyond_explained(bank, expected)).collect()).unwrap_or(1.0);
    let told = |times: f64| {
        let mut each: Vec<Told> = sums.iter().filter_map(|sums| sums.told_by(bank, expected, times)).collect();
        each.sort_by(|a, b| a.log_det.total_cmp(&b.log_det));
        each.get(each.len() / 2).copied()
    };
    let (theory, told) = (told(1.0), told(beyond));
    let values = expected.own();
    let predicted = |place: usize| {
        let [alone, stated] = [&theory, &told].map(|told| told.map_or(Budget::UNKNOWN, |told| told.budgets[place]));
        let value = values[place];
        // The addition of each for a law that may not hold.
        let model_u95 = |seen: &Seen| f64::from(seen.outcome.budgets.whole_run[place].given_u95(Source::Model));
        let model = mean_square(seen.iter().map(model_u95));
        let known: Vec<_> =
            seen.iter().filter_map(|seen| each(&seen.outcome.estimate.whole_run)[place].known()).collect();
        let errors = known.iter().map(|found| f64::from(found.value) - value);
        Predicted {
            value,
            budget: stated.and(Source::Model, model.sqrt() as f32),
            theory_u_a: f64::from(alone.standard_error()),
            scatter: mean_square(errors).sqrt(),
            given: known.len() as f64 / count,
        }
    };
    let Detail { band, backlash, .. } = seen[0].outcome.detail;
    Ok(Prediction {
        parameters: std::array::from_fn(predicted),
        backlash,
        peaks: seen.iter().map(|seen| seen.peaks).fold(Peaks::default(), Peaks::and),
        bank,
        band_hz: [band.low_hz.into(), band.high_hz.into()],
        broken: seen.iter().filter(|seen| seen.outcome.law.status == LawStatus::Broken).count() as f64 / count,
    })
}

/// All rehearsals, on all available cores.
fn rehearsed(expected: &Expected, motion: &Excitation, duration_s: f64) -> Result<Vec<Seen>, PlanError> {
    let run = |number: u64| expected.see(motion, duration_s, BEFORE_FIRST + number, None);
    on_cores((1..=REHEARSALS).collect(), usize::MAX, run).into_iter().collect()
}

/// Mean square of the finite values; 0 if there are none.
fn mean_square(values: impl Iterator<Item = f64>) -> f64 {
    let squares: Vec<f64> = values.filter(|value| value.is_finite()).map(|value| value * value).collect();
    if squares.is_empty() { 0.0 } else { squares.iter().sum::<f64>() / squares.len() as f64 }
}
