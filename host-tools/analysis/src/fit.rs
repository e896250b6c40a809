//! Fits to the whole run's exact sums: friction by direction.
//!
//! Regressors: acceleration `a`, velocity `v`, its sign `s`, one, force `F`, speed `|v|`, force rate `F'`, all through
//! one kernel. `F = mt a + cf v + dc |v| + fc s + o`, `cf+- = cf +- dc` and `fc+- = fc +- (o - F0)`. An unknown offset
//! `F0` cannot be distinguished from a difference between `fc+` and `fc-`: both are a constant force.
//!
//! Uncertainty as in core (docs/THEORY.md 6), whose budgets these are.
//! f64 throughout; sums of a day keep 1e-9 of their value.

mod expected;

use inerter_core::constants::{BOXES_VARIANCE, CORRELATION_BOXES, EXACT, PIVOT_BITS, ROUNDING, UPDATES_PER_BOX};
use inerter_core::{
    Bank, Budget, Found, Interval, MoreSums, Motion, NORMAL_COVERAGE, Parameter, Parameters, Scatter, Settings, Source,
    Spread, Status, Sums, Systematic,
};
use inerter_data::replay::Outcome;
use miette::Diagnostic;

/// Number of regressors, including the force.
pub(crate) const COUNT: usize = 7;
/// Number of products of the regressors in [`Sums`] and [`MoreSums`] together.
pub(crate) const PRODUCTS: usize = COUNT * (COUNT + 1) / 2;
const ACCELERATION: usize = 0;
const VELOCITY: usize = 1;
const SIGN: usize = 2;
const ONE: usize = 3;
const FORCE: usize = 4;
const SPEED: usize = 5;
const FORCE_RATE: usize = 6;
/// The law's regressors.
const LAW: [usize; 4] = [ACCELERATION, VELOCITY, SIGN, ONE];

/// Updates that count as one independent observation.
const UPDATES_PER_OBSERVATION: f64 = CORRELATION_BOXES * UPDATES_PER_BOX as f64;
/// Minimum independent observations: more than on the device, because up to seven unknowns are fitted at once.
const LEAST_OBSERVATIONS: f64 = 20.0;
/// Maximum fraction of the encoder's steps in what the other regressors leave of the acceleration.
const MOST_STEPS: f64 = 0.5;
/// Fraction of a regressor's square that the others must leave.
const LEAST_PIVOT: f64 = 1.0 / (1u32 << PIVOT_BITS) as f64;

/// Why a fit gives no result.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error, Diagnostic)]
pub enum FitError {
    /// Too little motion.
    #[error("there is too little motion for a fit: {observations:.0} independent observations")]
    #[diagnostic(code(inerter::fit::short), help("{}", short_help(*observations)))]
    TooShort {
        /// Number of independent observations.
        observations: f64,
    },
    /// The motion cannot separate the parameters.
    #[error("the motion cannot separate inertance from friction")]
    #[diagnostic(code(inerter::fit::motion), help("move in both directions, fast enough that inertance matters"))]
    Motion,
    /// The sums are inconsistent.
    #[error("the two halves of the sums are from different moments")]
    #[diagnostic(code(inerter::fit::torn), help("frames were lost on the way: try again"))]
    Torn,
}

fn short_help(observations: f64) -> &'static str {
    if observations < 1.0 {
        "the encoder shows no motion: move the terminal back and forth, and check with `inerter monitor` that it counts"
    } else {
        "record at least a few seconds of motion"
    }
}

/// Sums of the products of all regressors in SI.
#[derive(Clone, Copy, Debug)]
pub struct Products {
    sums: [[f64; COUNT]; COUNT],
    updates: f64,
    bank: Bank,
    /// One unit of each regressor in SI: each was rounded to integer units.
    units: [f64; COUNT],
}

/// Least squares of the force on some of the regressors.
pub(crate) struct Solution<const N: usize> {
    pub values: [f64; N],
    /// Their derivative with respect to a delay of the force: what one more second takes from them.
    pub per_skew: [f64; N],
    /// Their uncertainty due to the incomplete knowledge of the encoder's steps.
    pub steps: [f64; N],
    pub scatter: Scatter,
    /// Inverse of the regressors' sum matrix.
    pub inverse: [[f64; N]; N],
    /// Factor that turns it into squares and products of the standard errors \[N^2\].
    error_square: f64,
    /// Mean square residual \[N^2\].
    pub residual_square: f64,
}

impl<const N: usize> Solution<N> {
    /// Sets the mean square residual \[N^2\].
    fn rest_on(&mut self, residual_square: f64) {
        self.residual_square = residual_square;
        self.error_square = residual_square * UPDATES_PER_OBSERVATION;
    }

    /// The coefficients one by one.
    pub fn each(&self) -> [Found; N] {
        std::array::from_fn(|place| self.combined(unit_of(place)))
    }

    /// A weighted sum of the coefficients.
    fn combined(&self, weights: [f64; N]) -> Found {
        let dot = |row: &[f64; N]| row.iter().zip(weights).map(|(value, weight)| value * weight).sum::<f64>();
        let variance: f64 = self.inverse.iter().zip(weights).map(|(row, weight)| weight * dot(row)).sum();
        Found {
            value: dot(&self.values) as f32,
            error: (variance * self.error_square).max(0.0).sqrt() as f32,
            per_skew: dot(&self.per_skew) as f32,
            steps: dot(&self.steps).abs() as f32,
        }
    }
}

impl Products {
    /// From the sums of one bank at one time.
    pub fn of(sums: &Sums, more: &MoreSums) -> Result<Self, FitError> {
        if (sums.index, sums.bank, sums.updates) != (more.index, more.bank, more.updates) {
            return Err(FitError::Torn);
        }
        let units = joined(&sums.units, &more.units);
        Ok(Self::summed(sums.bank, [units; 2], joined(&sums.sums, &more.sums), f64::from(sums.updates)))
    }

    /// From exact sums, in the order of [`Sums`] and [`MoreSums`], the lower triangle by rows; in these units, and
    /// rounded to the others.
    pub(crate) fn summed(
        bank: Bank,
        [units, rounded]: [[f64; COUNT]; 2],
        sums: [i128; PRODUCTS],
        updates: f64,
    ) -> Self {
        let mut matrix = [[0.0; COUNT]; COUNT];
        for ((row, column), sum) in pairs().zip(sums) {
            let sum = sum as f64 * units[row] * units[column];
            (matrix[row][column], matrix[column][row]) = (sum, sum);
        }
        Self { sums: matrix, updates, bank, units: rounded }
    }

    /// The sums of both together, from one run.
    pub(crate) fn and(mut self, other: &Self) -> Self {
        for (row, others) in self.sums.iter_mut().zip(&other.sums) {
            row.iter_mut().zip(others).for_each(|(sum, other)| *sum += other);
        }
        self.updates += other.updates;
        self.units.iter_mut().zip(other.units).for_each(|(unit, other)| *unit = unit.max(other));
        self
    }

    /// What a law fitted to other sums leaves unexplained of the force here: RMS \[N\], and the fraction of the force's
    /// mean square that it explains.
    pub fn judging(&self, fitted: &Self) -> Result<(f64, f64), FitError> {
        let values = fitted.solve(LAW)?.values;
        let mut square = self.sums[FORCE][FORCE];
        for (row, a) in LAW.into_iter().zip(values) {
            square -= 2.0 * a * self.sums[row][FORCE];
            square += LAW.into_iter().zip(values).map(|(column, b)| a * b * self.sums[row][column]).sum::<f64>();
        }
        let left = square.max(0.0);
        Ok(((left / self.updates).sqrt(), 1.0 - left / self.sums[FORCE][FORCE]))
    }

    /// Inverse of the sum matrix of the law's regressors.
    pub(crate) fn inverse(&self) -> Result<[[f64; 4]; 4], FitError> {
        Ok(self.solve(LAW)?.inverse)
    }

    /// How an error of each parameter in the fit to these sums affects each parameter in the fit to more of them, with
    /// this inverse: their share of the squares.
    pub(crate) fn influence(&self, inverse: &[[f64; 4]; 4]) -> [[f64; 4]; 4] {
        inverse.map(|row| LAW.map(|j| row.iter().zip(LAW).map(|(part, k)| part * self.sums[k][j]).sum()))
    }

    /// Correlation of the errors of inertance, viscous and Coulomb friction and offset.
    pub fn correlation(&self) -> Result<[[f64; 4]; 4], FitError> {
        let inverse = self.inverse()?;
        Ok(std::array::from_fn(|row| {
            std::array::from_fn(|column| inverse[row][column] / (inverse[row][row] * inverse[column][column]).sqrt())
        }))
    }

    fn mean_square(&self, regressor: usize) -> f64 {
        self.sums[regressor][regressor] / self.updates
    }

    /// Least squares by the Cholesky factors of the matrix scaled to a unit diagonal.
    pub(crate) fn solve<const N: usize>(&self, regressors: [usize; N]) -> Result<Solution<N>, FitError> {
        let observations = self.updates / UPDATES_PER_OBSERVATION;
        if observations < LEAST_OBSERVATIONS {
            return Err(FitError::TooShort { observations });
        }
        let scale = regressors.map(|place| self.sums[place][place].sqrt().recip());
        let mut lower = [[0.0; N]; N];
        for row in 0..N {
            for column in 0..=row {
                let known: f64 = (0..column).map(|place| lower[row][place] * lower[column][place]).sum();
                let product = self.sums[regressors[row]][regressors[column]] * scale[row] * scale[column] - known;
                if row > column {
                    lower[row][column] = product / lower[column][column];
                } else if product > LEAST_PIVOT {
                    lower[row][row] = product.sqrt();
                } else {
                    return Err(FitError::Motion);
                }
            }
        }
        let inverse: [[f64; N]; N] = std::array::from_fn(|row| {
            let mut unit = [0.0; N];
            unit[row] = scale[row];
            let solved = solved(&lower, unit);
            std::array::from_fn(|column| solved[column] * scale[column])
        });
        let right = regressors.map(|place| self.sums[place][FORCE]);
        let times = |right: [f64; N]| -> [f64; N] {
            std::array::from_fn(|row| inverse[row].iter().zip(right).map(|(part, right)| part * right).sum())
        };
        let values = times(right);
        let explained: f64 = values.iter().zip(right).map(|(value, right)| value * right).sum();
        let left_over = (self.sums[FORCE][FORCE] - explained).max(0.0) / self.updates;
        let freedom = observations - N as f64;
        let mut solution = Solution {
            values,
            per_skew: times(regressors.map(|place| self.sums[place][FORCE_RATE])),
            steps: [0.0; N],
            scatter: Scatter::white(values[0] as f32, freedom as f32),
            inverse,
            error_square: 0.0,
            residual_square: 0.0,
        };
        solution.rest_on(left_over * observations / freedom);
        Ok(solution)
    }

    /// The same for instruments that round, the acceleration first. As in core: the encoder's steps attenuate the
    /// acceleration; and if the residual is smaller than rounding should leave, the roundings follow the motion or stay
    /// constant, and averaging does not remove them.
    fn fitted<const N: usize>(&self, regressors: [usize; N], settings: &Settings) -> Result<Solution<N>, FitError> {
        let mut solution = self.solve(regressors)?;
        let inertance_kg = solution.values[0];
        let steps = inertance_kg.powi(2) * self.steps_square(settings);
        let kept = settings.oversampling.recip();
        let code_n = settings.newtons_per_code.abs();
        let codes = BOXES_VARIANCE / (self.box_s(settings) * settings.sample_rate_hz) * ROUNDING * code_n.powi(2);
        if solution.residual_square < EXACT * (codes + steps * kept) {
            let units: f64 =
                regressors.iter().zip(solution.values).map(|(place, value)| self.units[*place] * value.abs()).sum();
            let greatest_n = 0.5 * code_n + (3.0 * steps).sqrt() + 0.5 * (self.units[FORCE] + units);
            solution.error_square =
                solution.error_square.max((greatest_n / f64::from(NORMAL_COVERAGE)).powi(2) * self.updates);
        } else {
            self.weigh_steps(&mut solution, regressors, settings);
        }
        self.correct_for_steps(&mut solution, inertance_kg, settings)?;
        Ok(solution)
    }

    /// Fraction of the scatter in the law's fit that the encoder's steps explain; 0 if there is no fit.
    pub(crate) fn steps_share(&self, settings: &Settings) -> f32 {
        self.fitted(LAW, settings).map_or(0.0, |solution| solution.scatter.steps_share[0])
    }

    /// Finds the encoder steps' share of the scatter.
    fn weigh_steps<const N: usize>(&self, solution: &mut Solution<N>, regressors: [usize; N], settings: &Settings) {
        let of =
            |wanted: usize| regressors.iter().position(|place| *place == wanted).map_or(0.0, |at| solution.values[at]);
        let (inertance_kg, coulomb_n) = (of(ACCELERATION), of(SIGN));
        let steps_square = self.steps_square(settings);
        let share = (inertance_kg.powi(2) * steps_square / solution.residual_square).min(1.0);
        let acceleration_square = (self.mean_square(ACCELERATION) - steps_square).max(0.0);
        let rate_square = acceleration_square / self.mean_square(VELOCITY);
        let box_square = self.box_s(settings).powi(2);
        let inertance_error = (solution.inverse[0][0] * solution.error_square).max(0.0).sqrt();
        solution.scatter.places = Systematic::of(settings).places(
            [inertance_kg as f32, coulomb_n as f32],
            inertance_error as f32,
            solution.residual_square as f32,
            box_square as f32,
            acceleration_square as f32,
        );
        solution.scatter.steps_share = [share as f32, (share * settings.oversampling.recip()) as f32];
        solution.scatter.frequency_squared = (rate_square * box_square) as f32;
    }

    /// Corrects for the attenuation by the encoder's steps; fails if they are most of the acceleration.
    fn correct_for_steps<const N: usize>(
        &self,
        solution: &mut Solution<N>,
        inertance_kg: f64,
        settings: &Settings,
    ) -> Result<(), FitError> {
        let steps_square = self.steps_square(settings);
        let taken = solution.inverse.map(|row| row[0] * steps_square * self.updates);
        let of_itself = taken[0];
        if of_itself > MOST_STEPS {
            return Err(FitError::Motion);
        }
        let all = taken.map(|taken| inertance_kg * taken / (1.0 - of_itself));
        for ((value, steps), all) in solution.values.iter_mut().zip(&mut solution.steps).zip(all) {
            *value += all * 0.5 * (1.0 + settings.oversampling.recip());
            *steps = all * 0.5;
        }
        Ok(())
    }

    /// Mean square of the encoder's steps in the acceleration \[m^2/s^4\].
    pub(crate) fn steps_square(&self, settings: &Settings) -> f64 {
        let Settings { metres_per_count, sample_rate_hz, .. } = *settings;
        metres_per_count.powi(2) / 12.0 * (8.0 / 3.0) / sample_rate_hz / self.box_s(settings).powi(5)
    }

    /// Length of the kernel's box \[s\].
    fn box_s(&self, settings: &Settings) -> f64 {
        let box_s = self.bank.box_s();
        let spacing = (settings.sample_rate_hz * box_s / 2.0).round().clamp(1.0, 256.0);
        spacing * 2.0 / settings.sample_rate_hz
    }
}

/// The solution of `L L' x = right`.
fn solved<const N: usize>(lower: &[[f64; N]; N], right: [f64; N]) -> [f64; N] {
    let mut x = right;
    for row in 0..N {
        let known: f64 = (0..row).map(|place| lower[row][place] * x[place]).sum();
        x[row] = (x[row] - known) / lower[row][row];
    }
    for row in (0..N).rev() {
        let known: f64 = (row + 1..N).map(|place| lower[place][row] * x[place]).sum();
        x[row] = (x[row] - known) / lower[row][row];
    }
    x
}

/// Turns the coefficients into parameters with their intervals.
pub(crate) struct Judge<'a> {
    pub settings: &'a Settings,
    pub beside: &'a Beside,
    pub scatter: Scatter,
}

impl Judge<'_> {
    fn parameter(&self, i: usize, found: &Found, value: f32, model_u95: f32) -> Parameter {
        let motion = &self.beside.motion;
        let budget = budget(i, &Systematic::of(self.settings), found, &self.scatter.in_motion(motion), motion);
        Parameter::new(Interval { value, u95: budget.and(Source::Model, model_u95).u95() }, Status::Ok)
    }

    /// The four together, with the structure's mass still in the inertance.
    pub fn four(&self, [inertance, viscous, coulomb, offset]: [Found; 4]) -> Parameters {
        let screw_kg = inertance.value - self.settings.structure_mass_kg as f32;
        Parameters {
            inertance_kg: self.parameter(ACCELERATION, &inertance, screw_kg, self.beside.model_u95[ACCELERATION]),
            viscous_n_s_per_m: self.own(VELOCITY, &viscous),
            coulomb_n: self.own(SIGN, &coulomb),
            offset_n: self.own(ONE, &offset),
        }
    }

    /// One of friction and offset.
    fn own(&self, i: usize, found: &Found) -> Parameter {
        self.parameter(i, found, found.value, self.beside.model_u95[i])
    }
}

/// The uncertainty budget of one of the four parameters.
pub(crate) fn budget(i: usize, systematic: &Systematic, found: &Found, spread: &Spread, motion: &Motion) -> Budget {
    match i {
        ACCELERATION => systematic.inertance(found, spread, motion),
        VELOCITY => systematic.viscous(found, spread, motion),
        SIGN => systematic.coulomb(found, spread, motion),
        _ => systematic.offset(found, spread),
    }
}

/// All four, in the order of the law.
pub(crate) fn each(parameters: &Parameters) -> [Parameter; 4] {
    let Parameters { inertance_kg, viscous_n_s_per_m, coulomb_n, offset_n } = *parameters;
    [inertance_kg, viscous_n_s_per_m, coulomb_n, offset_n]
}

/// Row and column of each product, in the order of the sums: the lower triangle.
pub(crate) fn pairs() -> impl Iterator<Item = (usize, usize)> {
    (0..COUNT).flat_map(|row| (0..=row).map(move |column| (row, column)))
}

/// The concatenation of two arrays.
pub(crate) fn joined<T: Copy + Default, const N: usize>(some: &[T], more: &[T]) -> [T; N] {
    let mut all = some.iter().chain(more).copied();
    std::array::from_fn(|_| all.next().unwrap_or_default())
}

/// What a fit needs from a run in addition to its sums.
#[derive(Clone, Copy, Debug)]
pub struct Beside {
    /// Statistics of the motion.
    pub motion: Motion,
    /// How far the law may be wrong in each of the four parameters, as the half width of a 95 % interval.
    pub model_u95: [f32; 4],
}

impl Beside {
    /// From the estimator's final outcome.
    pub fn of(outcome: &Outcome) -> Self {
        Self {
            motion: outcome.motion,
            model_u95: outcome.budgets.whole_run.map(|budget| budget.given_u95(Source::Model)),
        }
    }
}

/// Friction equal in both directions, and by direction.
#[derive(Clone, Copy, Debug)]
pub struct Directions {
    /// The law of the estimator: friction equal in both directions.
    pub symmetric: Parameters,
    /// Its RMS residual \[N\].
    pub symmetric_residual_rms_n: f64,
    /// Inertance if friction may differ by direction \[kg\].
    pub inertance_kg: Parameter,
    /// Viscous friction in positive and in negative motion \[N s/m\].
    pub viscous_n_s_per_m: [Parameter; 2],
    /// Mean Coulomb friction of the two \[N\].
    pub coulomb_n: Parameter,
    /// `fc+ - fc- + 2 F0`, the only combination of these three that the motion identifies \[N\].
    pub difference_n: Parameter,
    /// Coulomb friction in positive and in negative motion, if the offset is known \[N\].
    pub coulomb_by_direction_n: Option<[Parameter; 2]>,
    /// RMS residual \[N\].
    pub residual_rms_n: f64,
}

/// Friction by direction; `offset_n` is the force offset, if known.
pub fn directions(
    products: &Products,
    settings: &Settings,
    beside: &Beside,
    offset_n: Option<f64>,
) -> Result<Directions, FitError> {
    let plain = products.fitted(LAW, settings)?;
    let full = products.fitted([ACCELERATION, VELOCITY, SIGN, ONE, SPEED], settings)?;
    let judge = |scatter| Judge { settings, beside, scatter };
    let (alike, by_direction) = (judge(plain.scatter), judge(full.scatter));
    let viscous = |side: f64| by_direction.own(VELOCITY, &full.combined([0.0, 1.0, 0.0, 0.0, side]));
    let coulomb = |side: f64, offset_n: f64| {
        let found = full.combined([0.0, 0.0, 1.0, side, 0.0]);
        let found = Found { value: found.value - (side * offset_n) as f32, ..found };
        let [_, _, model_u95, of_offset] = beside.model_u95;
        by_direction.parameter(SIGN, &found, found.value, model_u95.hypot(side as f32 * of_offset))
    };
    // Twice the offset.
    let difference = full.combined([0.0, 0.0, 0.0, 2.0, 0.0]);
    Ok(Directions {
        symmetric: alike.four(plain.each()),
        symmetric_residual_rms_n: plain.residual_square.sqrt(),
        inertance_kg: by_direction.four(LAW.map(|place| full.combined(unit_of(place)))).inertance_kg,
        viscous_n_s_per_m: [viscous(1.0), viscous(-1.0)],
        coulomb_n: coulomb(0.0, 0.0),
        difference_n: by_direction.parameter(ONE, &difference, difference.value, 2.0 * beside.model_u95[ONE]),
        coulomb_by_direction_n: offset_n.map(|offset_n| [coulomb(1.0, offset_n), coulomb(-1.0, offset_n)]),
        residual_rms_n: full.residual_square.sqrt(),
    })
}

/// Weights that select one coefficient.
pub(crate) fn unit_of<const N: usize>(place: usize) -> [f64; N] {
    std::array::from_fn(|other| f64::from(u8::from(other == place)))
}

#[cfg(test)]
#[path = "fit_tests.rs"]
mod tests;
