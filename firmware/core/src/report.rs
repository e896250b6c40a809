//! From moments to values in SI with their intervals: the edge of the fixed-point world.
//!
//! Floats are allowed here, as everything is basic arithmetic that gives the same bits on every machine, and nothing
//! flows back but three rounded integers (see [`Feedback`]).

use crate::active::{Active, Scales, term};
use crate::estimate::{Bank, Estimate, Parameter, Parameters, Status};
use crate::estimator::{BankState, Feedback, State, VELOCITY_BITS};
use crate::kernel::UPDATES_PER_BOX;
use crate::ldl::{FACTOR_BITS, MATRIX_BITS, Solution, UNKNOWNS, solve};
use crate::math::{power, sqrt};
use crate::rls::{PRODUCTS, place};

/// Sum of the cubic B-spline's autocorrelation over its value at 0, in boxes: updates within it are one observation.
const CORRELATION_BOXES: f32 = 2.09;
/// Standard errors in the interval: 1.96 would do for white noise alone.
const COVERAGE: f32 = 3.0;
/// Independent observations under which nothing is said.
const LEAST_OBSERVATIONS: f32 = 8.0;
/// A parameter whose interval is wider than this part of its value is not identifiable.
const WIDEST_INTERVAL: f32 = 0.5;
/// Model error of dry friction: real friction is never exactly Coulomb's.
const COULOMB_MODEL_U95: f32 = 0.05;
/// The skew's false damper, with room for what correlated regressors make of it.
const SKEW_FACTOR: f32 = 2.0;
/// Acceleration's mean square over that of the encoder's steps above which the fast bank is used.
const CLEAR_OF_STEPS: f32 = 2000.0;
/// Component of an unobservable direction that makes a parameter unobservable.
const TOUCHED: f32 = 0.02;

/// What one bank's memory knows.
struct Knowledge {
    matrix: [i64; PRODUCTS],
    /// Average product per unit of the matrix.
    per_unit: f32,
    /// Equally weighted updates that would know as much.
    updates: f32,
}

impl Knowledge {
    fn recent(bank: &BankState) -> Self {
        let weight = bank.recent.weight() as f32;
        let updates = if weight > 0.0 { power(MATRIX_BITS as i32) / weight } else { 0.0 };
        Self { matrix: *bank.recent.averages(), per_unit: 1.0, updates }
    }

    fn whole_run(bank: &BankState) -> Self {
        let (matrix, shift) = bank.whole.scaled();
        let updates = bank.whole.updates() as f32;
        Self { matrix, per_unit: power(shift as i32) / updates.max(1.0), updates }
    }

    /// Mean square of a regressor.
    fn mean_square(&self, i: usize) -> f32 {
        self.matrix[place(i, i)] as f32 * self.per_unit
    }
}

impl Active {
    /// The estimate as it stands, at any time.
    pub fn estimate(&self, state: &State) -> Estimate {
        let (bank, recent) = self.choose(state, Knowledge::recent);
        let (config, bank_state) = self.bank(state, bank);
        let moving = bank_state.idle_samples < config.hold_samples && recent.updates > 0.0;
        let (mut recent, residual_rms_n) = self.solve_for(&recent, &config.scales);
        if !moving {
            recent.hold();
        }
        let (whole_bank, whole) = self.choose(state, Knowledge::whole_run);
        let (whole_run, _) = self.solve_for(&whole, &self.bank(state, whole_bank).0.scales);
        Estimate {
            index: state.last_index(),
            elapsed_samples: state.counters().samples + state.counters().lost_samples,
            bank,
            moving,
            recent,
            whole_run,
            residual_rms_n,
            updates: bank_state.whole.updates(),
        }
    }

    /// The fast bank when its acceleration stands clear of the encoder's steps, else the slow one.
    fn choose(&self, state: &State, knowledge: impl Fn(&BankState) -> Knowledge) -> (Bank, Knowledge) {
        let fast = knowledge(&state.fast);
        if fast.mean_square(0) > CLEAR_OF_STEPS * self.fast.scales.quantisation || state.slow.whole.updates() == 0 {
            (Bank::Fast, fast)
        } else {
            (Bank::Slow, knowledge(&state.slow))
        }
    }

    /// What the next samples are told: friction's kink at a reversal, the offset, and what a weak force is.
    pub(crate) fn feedback(&self, estimate: &Estimate, before: Feedback) -> Feedback {
        let Parameters { inertance_kg, coulomb_n, offset_n, .. } = estimate.recent;
        let codes = |newtons: f32| (newtons / self.signal.newtons_per_code) as i32;
        let mut feedback = before;
        if coulomb_n.status == Status::Ok && inertance_kg.status == Status::Ok {
            let (kink, per_force) = self.sign_effects;
            let fraction = f64::from((1_u32 << VELOCITY_BITS) as f32 / inertance_kg.value);
            feedback.kink = term(kink * fraction * f64::from(coulomb_n.value));
            feedback.velocity_per_force = term(per_force * fraction);
        }
        if coulomb_n.status == Status::Ok && offset_n.status == Status::Ok {
            feedback.offset_code = codes(offset_n.value);
            feedback.weak_force_code = codes(3.0 * coulomb_n.value).max(0) as u32;
        }
        feedback
    }

    fn solve_for(&self, knowledge: &Knowledge, scales: &Scales) -> (Parameters, f32) {
        let observations = knowledge.updates / (CORRELATION_BOXES * UPDATES_PER_BOX as f32);
        if observations < LEAST_OBSERVATIONS {
            return (Parameters::default(), 0.0);
        }
        let solution = solve(&knowledge.matrix);
        let residual_variance = pivot(&solution, UNKNOWNS) * observations / (observations - UNKNOWNS as f32);
        let errors = standard_errors(&solution, residual_variance / observations);
        let force_shift = i32::from(solution.shifts[UNKNOWNS]);
        let mut found = [Found::default(); UNKNOWNS];
        for (i, found) in found.iter_mut().enumerate() {
            let to_si = scales.force_per[i] * power(i32::from(solution.shifts[i]) - force_shift);
            found.value = solution.unknowns[i] as f32 * power(-(FACTOR_BITS as i32)) * to_si;
            found.error = errors[i].map(|error| error * to_si);
        }
        // The matrix in Q62 is of regressors in Q31.
        let force_unit = scales.force * power(31 - force_shift);
        let residual_rms_n = sqrt(residual_variance * knowledge.per_unit) * force_unit;
        (self.with_systematic(&found, knowledge, scales), residual_rms_n)
    }

    /// Adds what no averaging removes, and gives each parameter its word.
    fn with_systematic(&self, found: &[Found; UNKNOWNS], knowledge: &Knowledge, scales: &Scales) -> Parameters {
        let systematic = &self.systematic;
        let [inertance, viscous, coulomb, offset] = found;
        let square = |value: f32| value * value;
        // Divisions by zero give what nothing is known of: an infinite interval.
        let acceleration = knowledge.mean_square(0);
        let velocity = knowledge.mean_square(1);
        let per_skew = SKEW_FACTOR * inertance.value * (acceleration / velocity) * scales.rate_squared;
        let steps = inertance.value * (scales.quantisation / acceleration);
        let without_structure = inertance.value - self.settings.structure_mass_kg as f32;
        let relative = |found: &Found, part: f32| square(found.value) * part;
        Parameters {
            inertance_kg: inertance
                .with(relative(inertance, systematic.inertance) + systematic.structure_mass + square(steps))
                .word(without_structure, true),
            viscous_n_s_per_m: viscous
                .with(relative(viscous, systematic.viscous) + square(per_skew * systematic.skew_s))
                .word(viscous.value, true),
            coulomb_n: coulomb
                .with(relative(coulomb, systematic.force + square(COULOMB_MODEL_U95)))
                .word(coulomb.value, true),
            // An offset near zero is as good a finding as any other.
            offset_n: offset.with(relative(offset, systematic.force)).word(offset.value, false),
        }
    }
}

impl State {
    /// How much of the kink that Coulomb friction would give the velocity the reversals have shown: 1 is all of it,
    /// less where friction turns over a presliding distance. Nothing before the first reversal under known friction.
    pub fn reversal_ratio(&self) -> Option<f32> {
        let (seen, predicted) = self.reversals.seen_and_predicted()?;
        Some(seen as f32 / predicted as f32)
    }
}

/// One unknown in SI with its standard error; none where the motion cannot show it.
#[derive(Clone, Copy, Default)]
struct Found {
    value: f32,
    error: Option<f32>,
}

/// Half width of a 95 % interval; none where the motion cannot show the value.
struct Interval(Option<f32>);

impl Found {
    /// The interval with the square of what no averaging removes.
    fn with(&self, systematic_squared: f32) -> Interval {
        Interval(self.error.map(|error| {
            let random = COVERAGE * error;
            sqrt(random * random + systematic_squared)
        }))
    }
}

impl Interval {
    fn word(self, value: f32, relative: bool) -> Parameter {
        let Some(u95) = self.0.filter(|u95| u95.is_finite() && value.is_finite()) else {
            return Parameter { value: 0.0, u95: f32::INFINITY, status: Status::NotIdentifiable };
        };
        let magnitude = if value < 0.0 { -value } else { value };
        let too_wide = relative && u95 > WIDEST_INTERVAL * magnitude;
        let status = if too_wide { Status::NotIdentifiable } else { Status::Ok };
        Parameter { value, u95, status }
    }
}

impl Parameters {
    fn hold(&mut self) {
        for parameter in [&mut self.inertance_kg, &mut self.viscous_n_s_per_m, &mut self.coulomb_n, &mut self.offset_n]
        {
            if parameter.status == Status::Ok {
                parameter.status = Status::Held;
            }
        }
    }
}

fn pivot(solution: &Solution, i: usize) -> f32 {
    solution.pivots[i] as f32 * power(-(MATRIX_BITS as i32))
}

/// Standard error of each unknown in equilibrated units for a residual variance per observation of `variance`;
/// nothing where an unobservable direction has a part in it.
fn standard_errors(solution: &Solution, variance: f32) -> [Option<f32>; UNKNOWNS] {
    let factor = |row: usize, column: usize| solution.factors[row][column] as f32 * power(-(FACTOR_BITS as i32));
    let mut errors = [Some(0.0_f32); UNKNOWNS];
    // Row by row of the inverse of the unit lower factor; each is the direction that its pivot measures.
    let mut inverse = [[0.0_f32; UNKNOWNS]; UNKNOWNS];
    for row in 0..UNKNOWNS {
        let mut direction = [0.0_f32; UNKNOWNS];
        direction[row] = 1.0;
        for (earlier, parts) in inverse.iter().enumerate().take(row) {
            let factor = factor(row, earlier);
            for (sum, part) in direction.iter_mut().zip(parts) {
                *sum -= factor * part;
            }
        }
        inverse[row] = direction;
        let pivot = pivot(solution, row);
        for (error, part) in errors.iter_mut().zip(direction) {
            if pivot > 0.0 {
                *error = error.map(|sum| sum + part * part / pivot);
            } else if !(-TOUCHED..=TOUCHED).contains(&part) {
                *error = None;
            }
        }
    }
    errors.map(|sum| sum.map(|sum| sqrt(sum * variance)))
}
