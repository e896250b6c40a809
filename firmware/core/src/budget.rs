//! The sources of an interval's uncertainty, after the Guide to the expression of uncertainty (JCGM 100).
//!
//! `U95 = k sqrt(u_a^2 + sum u_i^2)`. `u_a` is the scatter of the fit, with its degrees of freedom. The `u_i` are
//! stated or measured, for everything that averaging does not remove. `k` is that of Student's distribution for the
//! degrees of freedom of both together (Welch and Satterthwaite). Floats, as in `report`: basic arithmetic gives the
//! same bits on every machine.

use crate::ldl::UNKNOWNS;
use crate::math::{sqrt, square};

/// Standard deviations within which 95 % of a normal distribution lie.
pub const NORMAL_COVERAGE: f32 = 1.959_964;

/// Where an uncertainty comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Source {
    /// Scatter of the fit: noise of the force, and the encoder's steps treated as noise.
    Noise,
    /// The encoder's steps in a motion that repeats itself, and their bias through the acceleration.
    Encoder,
    /// The unknown part of the force's delay.
    Skew,
    /// The force's scale.
    Gain,
    /// Travel per count.
    Lead,
    /// The clock.
    Timebase,
    /// The structure mass, and its motion across a backlash.
    Structure,
    /// The contact's stiffness, which relates the structure's motion to the screw's.
    Stiffness,
    /// A law that may not hold, as far as this run shows it. For the contact: what higher degrees of the fit would
    /// change, and how far the noise of the displacements lowers their coefficients.
    Model,
}

impl Source {
    /// All sources, in the order of a budget.
    pub const ALL: [Self; 9] = [
        Self::Noise,
        Self::Encoder,
        Self::Skew,
        Self::Gain,
        Self::Lead,
        Self::Timebase,
        Self::Structure,
        Self::Stiffness,
        Self::Model,
    ];

    /// Whether two runs on one rig share it, so that it cancels in their difference.
    pub const fn is_shared(self) -> bool {
        matches!(self, Self::Gain | Self::Lead | Self::Timebase)
    }
}

/// The uncertainty of one parameter by its sources, in the parameter's unit.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Budget {
    /// Squared standard uncertainties, in the order of [`Source::ALL`].
    squares: [f32; Source::ALL.len()],
    /// Degrees of freedom of the scatter.
    freedom: f32,
}

impl Budget {
    /// Nothing is known.
    pub const UNKNOWN: Self = {
        let mut squares = [0.0; Source::ALL.len()];
        squares[Source::Noise as usize] = f32::INFINITY;
        Self { squares, freedom: 1.0 }
    };

    /// The budget of a fit with this standard error and these degrees of freedom.
    #[must_use]
    pub fn of_scatter(standard_error: f32, freedom: f32) -> Self {
        let mut squares = [0.0; Source::ALL.len()];
        squares[Source::Noise as usize] = square(standard_error);
        Self { squares, freedom: if freedom > 1.0 { freedom } else { 1.0 } }
    }

    /// Adds an uncertainty, given as the half width of its 95 % interval.
    #[must_use]
    pub fn and(self, source: Source, u95: f32) -> Self {
        self.and_variance(source, square(u95 / NORMAL_COVERAGE))
    }

    /// The same, given as a variance.
    #[must_use]
    pub fn and_variance(mut self, source: Source, variance: f32) -> Self {
        self.squares[source as usize] += variance;
        self
    }

    /// Converts the budget to another unit; `unit` is the size of the present unit in it.
    #[must_use]
    pub fn times(self, unit: f32) -> Self {
        Self { squares: self.squares.map(|variance| variance * square(unit)), ..self }
    }

    /// Standard uncertainty by the scatter of the run alone, `u_a`.
    pub fn standard_error(&self) -> f32 {
        sqrt(self.squares[Source::Noise as usize])
    }

    /// Half width of the 95 % interval by this source alone, as it was given to [`Self::and`].
    pub fn given_u95(&self, source: Source) -> f32 {
        NORMAL_COVERAGE * sqrt(self.squares[source as usize])
    }

    /// Variance by what differs from sample to sample, whether it averages out or not.
    pub fn fit_square(&self) -> f32 {
        self.squares[Source::Noise as usize] + self.squares[Source::Encoder as usize]
    }

    /// Degrees of freedom of the scatter.
    pub fn scatter_freedom(&self) -> f32 {
        self.freedom
    }

    /// Degrees of freedom of all together; infinite if nothing scatters.
    pub fn freedom(&self) -> f32 {
        self.freedom_of(self.square())
    }

    /// Half width of the 95 % interval.
    pub fn u95(&self) -> f32 {
        self.u95_of(self.square())
    }

    /// The same without what two runs on one rig share (force gain, lead and clock): for comparing them.
    pub fn same_rig_u95(&self) -> f32 {
        let own = Source::ALL.into_iter().zip(self.squares).filter(|(source, _)| !source.is_shared());
        self.u95_of(own.map(|(_, square)| square).sum())
    }

    /// Each source's part of the half width; the squares of the parts add up to that of [`Self::u95`].
    pub fn parts(&self) -> [(Source, f32); Source::ALL.len()] {
        let factor = student(self.freedom());
        core::array::from_fn(|i| (Source::ALL[i], factor * sqrt(self.squares[i])))
    }

    /// Square of the combined standard uncertainty.
    fn square(&self) -> f32 {
        self.squares.iter().sum()
    }

    /// Degrees of freedom where the squares add up to `all`.
    fn freedom_of(&self, all: f32) -> f32 {
        let share = self.squares[Source::Noise as usize] / all;
        // Nothing scatters, or nothing is uncertain.
        if share > 0.0 { self.freedom / square(share) } else { f32::INFINITY }
    }

    /// Half width where the squares add up to `all`.
    fn u95_of(&self, all: f32) -> f32 {
        if all.is_finite() { student(self.freedom_of(all)) * sqrt(all) } else { f32::INFINITY }
    }
}

/// Standard deviations within which 95 % of Student's distribution lie: the series of Cornish and Fisher, within 0.4 %
/// from 3 degrees of freedom on.
fn student(freedom: f32) -> f32 {
    let part = 1.0 / freedom;
    NORMAL_COVERAGE + part * (2.3723 + part * (2.8225 + part * (2.5558 + part * 1.5895)))
}

/// Budgets of the four parameters of an estimate, in their order, and of the contact.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Budgets {
    /// With the memory of `memory_s`.
    pub recent: [Budget; UNKNOWNS],
    /// From all motion since the reset.
    pub whole_run: [Budget; UNKNOWNS],
    /// Of the contact, likewise.
    pub contact: ContactBudgets,
}

/// Budgets of the contact, where it has values.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ContactBudgets {
    /// Of the backlash \[m\], by the route of its value.
    pub backlash_m: Option<Budget>,
    /// Of the stiffness \[N/m\], by the terminal's sensor.
    pub stiffness_n_per_m: Option<Budget>,
    /// Of the damping \[N s/m\], likewise.
    pub damping_n_s_per_m: Option<Budget>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn students_distribution_is_that_of_the_tables() {
        for (freedom, wanted) in [(3.0, 3.1824), (4.0, 2.7764), (8.0, 2.3060), (30.0, 2.0423), (f32::INFINITY, 1.96)] {
            assert!((student(freedom) / wanted - 1.0).abs() < 0.004, "{freedom}: {}", student(freedom));
        }
    }

    #[test]
    fn parts_add_up_and_what_a_rig_shares_is_left_out() {
        let budget = Budget::of_scatter(0.3, 8.0).and(Source::Gain, 0.7).and(Source::Skew, 0.2).and(Source::Skew, 0.1);
        let sum: f32 = budget.parts().into_iter().map(|(_, part)| square(part)).sum();
        assert!((sqrt(sum) / budget.u95() - 1.0).abs() < 1e-6);
        let same = Budget::of_scatter(0.3, 8.0).and(Source::Skew, sqrt(0.05)).u95();
        assert!((budget.same_rig_u95() / same - 1.0).abs() < 1e-6);
        // By hand: u_c^2 = 0.09 + (0.49 + 0.05) / 1.96^2, nu = 8 u_c^4 / 0.09^2.
        let square = 0.09 + 0.54 / (NORMAL_COVERAGE * NORMAL_COVERAGE);
        assert!((budget.freedom() / (8.0 * square * square / 0.0081) - 1.0).abs() < 1e-5);
    }

    #[test]
    fn nothing_known_is_infinite_and_nothing_uncertain_is_zero() {
        assert_eq!(Budget::UNKNOWN.u95(), f32::INFINITY);
        assert_eq!(Budget::of_scatter(f32::INFINITY, 20.0).u95(), f32::INFINITY);
        assert_eq!((Budget::of_scatter(0.0, 20.0).u95(), Budget::of_scatter(0.0, 0.0).freedom()), (0.0, f32::INFINITY));
    }

    /// In another unit, both what scatters and what is stated are by as much greater; its degrees of freedom stay.
    #[test]
    fn a_budget_in_another_unit_is_the_same_budget() {
        let budget = Budget::of_scatter(0.3, 8.0).and(Source::Model, 0.7).times(4.0);
        assert!((budget.standard_error() / 1.2 - 1.0).abs() < 1e-6, "{}", budget.standard_error());
        assert!((budget.given_u95(Source::Model) / 2.8 - 1.0).abs() < 1e-6, "{}", budget.given_u95(Source::Model));
        assert_eq!((budget.scatter_freedom(), budget.given_u95(Source::Gain)), (8.0, 0.0));
    }
}
