//! Causes that may have shifted the parameters, including those too small to be named.
//!
//! Adding a cause to the law shifts each parameter; chance alone shifts it by as much as its standard error grows
//! (Hausman). So leaving the cause out may have shifted the parameter by that much. If the standard error would grow
//! beyond [`TOLD`], an interval that covered this too would be useless if there is no such cause. The parameter then
//! assumes its absence, as it does if the run cannot separate the two at all.

use inerter_core::{Bank, Budget, Machine, NORMAL_COVERAGE, Parameters, Settings, Source};
use inerter_data::{
    names::{description, parameter},
    replay::Outcome,
    series::Series,
    words::rounded_text,
};
use nalgebra::{DMatrix, DVector};

use super::{
    candidate::{Kind, Term},
    cause::Cause,
    columns::Rows,
    search::rows_of,
};
use crate::{
    fit::each,
    law::{dot, inverse, less, products, products_with},
};

/// Fraction of a column's square that the law must leave unexplained for the run to identify the cause; and for it to
/// count a shift that is [`FAR`] beyond chance.
const LEAST_LEFT: f64 = 0.05;
const LITTLE_LEFT: f64 = 0.01;
/// The minimum fraction if there is no noise.
const LEAST_KNOWN: f64 = 1e-9;
/// Weights of a parameter's shift, and of its shift by chance, in the half width of an interval: for any size of a
/// cause that the law leaves out, 90 % of such intervals contain the true value (docs/THEORY.md, 14).
const MOVED: [f64; 2] = [1.6, 1.2];
/// Growth of the standard error up to which the run identifies a cause with certainty.
pub const TOLD: f64 = 1.6;
/// Standard deviations beyond which a shift counts although the run does not identify the cause with certainty.
const CHANCE: f64 = 2.0;
/// The same if the law leaves little of the cause: no run without a fault reaches it (docs/THEORY.md, 17).
const FAR: f64 = 7.0;
/// Standard deviations of a cause's size below which it may not be named.
const NAMED: f64 = 12.0;

/// Ratio of the interval from the samples to that of the device above which it is reported.
const WORTH_A_WORD: f32 = 1.05;

/// A parameter of the whole run, judged by the samples in addition to the estimator's sums.
#[derive(Clone, Debug, PartialEq)]
pub struct Judged {
    /// The sources of its interval.
    pub budget: Budget,
    /// The cause that shifts it most according to the samples, whether named or too small for that.
    pub moved_by: Option<Kind>,
    /// Causes that this motion cannot separate from it: the value is right only in their absence.
    pub assumes: Vec<Kind>,
}

/// A sentence on the causes that a motion cannot separate from the parameters, with those `found` marked; `None` if it
/// separates all.
pub fn assumptions(machine: Machine, all: &[Judged; 4], found: &[Cause]) -> Option<String> {
    let is_found = |kind: Kind| found.iter().any(|cause| cause.kind == kind);
    let told = all.iter().enumerate().filter(|(_, one)| one.budget.u95().is_finite() && !one.assumes.is_empty());
    let told = told.map(|(place, one)| {
        let words = one.assumes.iter().map(|kind| match is_found(*kind) {
            true => format!("{} (found in this run)", kind.words()),
            false => kind.words().to_string(),
        });
        let words: Vec<String> = words.collect();
        format!(" {}: {}.", parameter(machine, place).label, description(machine, &words.join(", ")))
    });
    headed(
        "This motion cannot separate some causes from a parameter. The value is right only if they are absent.",
        told,
    )
}

/// A sentence on the intervals that the samples make wider than those of the device; `None` if there are none.
pub fn widened(machine: Machine, whole_run: &Parameters, all: &[Judged; 4]) -> Option<String> {
    let told = each(whole_run).into_iter().zip(all).enumerate().filter_map(|(place, (parameter_found, judged))| {
        let (u95, wider) = (parameter_found.known()?.u95, judged.budget.u95());
        if !wider.is_finite() || wider <= WORTH_A_WORD * u95 {
            return None;
        }
        let field = parameter(machine, place);
        let [u95, wider] = [u95, wider].map(|u95| rounded_text(u95.into(), u95.into()));
        let why = judged.moved_by.map_or_else(String::new, |kind| {
            format!(" (moved most by what looks like {})", description(machine, kind.words()))
        });
        Some(format!(" {}: {wider} {}, not {u95}{why}.", field.label, field.unit))
    });
    headed(
        "The samples show effects that the law does not explain, or cannot rule them out. This widens 95 % intervals.",
        told,
    )
}

/// The sentences on the parameters under one heading; `None` if there are none.
fn headed(head: &str, told: impl Iterator<Item = String>) -> Option<String> {
    let told: String = told.collect();
    (!told.is_empty()).then(|| format!("{head}{told}"))
}

/// The parameters of the whole run, judged by the samples for a law that is nearly true; for a run too short for that,
/// as the estimator has them.
pub fn judged(series: &Series, settings: &Settings, outcome: &Outcome) -> [Judged; 4] {
    let mut all = outcome.budgets.whole_run.map(|budget| Judged { budget, moved_by: None, assumes: Vec::new() });
    let aligned = series.aligned(settings);
    let Ok(rows) = rows_of(&aligned, settings, &outcome.published()) else { return all };
    let Some(law) = Law::of(&rows) else { return all };
    // Scaled to the estimator's own scatter, which includes effects that the rows lack: the spectrum of the steps, and
    // their repetition.
    let mut patterns = outcome.motion.pattern_in_differences(outcome.estimate.bank.box_s() as f32).into_iter();
    let squares = outcome.budgets.whole_run.map(|budget| {
        let part = |source| (f64::from(budget.given_u95(source)) / f64::from(NORMAL_COVERAGE)).powi(2);
        let (noise, steps) = (part(Source::Noise), part(Source::Encoder));
        [noise + steps, noise + f64::from(patterns.next().unwrap_or(1.0)) * steps]
    });
    let half_widths = outcome.budgets.whole_run.map(|budget| f64::from(budget.u95()));
    // The effect of steps in the slow bank is not white noise, and would seem far beyond chance.
    let is_fast = outcome.estimate.bank == Bank::Fast;
    let (mut reaches, mut moved_most) = ([0.0; 4], [0.0; 4]);
    for term in Term::all_for(&rows.span, settings) {
        let (kind, moves) = (term.kind(), law.with(&rows, term));
        for (i, one) in all.iter_mut().enumerate() {
            let [own, of_differences] = squares[i];
            let moved = moves.moved[i];
            // Standard error with the cause, relative to that without.
            let grows = (1.0 + moves.squares[i] / moves.before[i]).sqrt();
            let chance = ((grows * grows - 1.0) * of_differences).sqrt();
            let is_told = moves.are_told && own + chance * chance <= TOLD * TOLD * own;
            if !is_told && NAMED * chance > half_widths[i] && !one.assumes.contains(&kind) {
                one.assumes.push(kind);
            }
            if moves.can_be && is_regarded(kind) {
                let is_far = is_fast && moves.are_hardly_told && moved.abs() > FAR * chance;
                let is_moved = is_far || moves.are_told && moved.abs() > CHANCE * chance;
                let reach = match (is_told || is_far, is_moved) {
                    (true, _) => reach(moved, chance),
                    (false, true) => reach((moved * moved - (CHANCE * chance).powi(2)).sqrt(), 0.0),
                    (false, false) => 0.0,
                };
                reaches[i] = f64::max(reaches[i], reach);
                if is_moved && reach > moved_most[i] {
                    moved_most[i] = reach;
                    one.moved_by = Some(kind);
                }
            }
        }
    }
    for (one, reach) in all.iter_mut().zip(reaches) {
        one.budget = one.budget.and(Source::Model, reach as f32);
    }
    all
}

/// Half width of the interval for a possible shift by a cause that was left out, if including it shifts the parameter
/// by `moved`, and `chance` is the standard deviation of that shift without any such cause.
pub fn reach(moved: f64, chance: f64) -> f64 {
    let [times, at_least] = MOVED;
    (times * moved).hypot(at_least * chance)
}

/// A skew has a separately stated uncertainty, and the effects at reversals appear near rest (docs/THEORY.md, 6).
fn is_regarded(kind: Kind) -> bool {
    !matches!(kind, Kind::Skew | Kind::Stribeck | Kind::Presliding)
}

/// The law fitted to the rows.
struct Law {
    inverse: DMatrix<f64>,
    residual: Vec<f64>,
    /// Variance of a row's residual, multiplied by the rows per independent observation.
    error_square: f64,
}

/// Effect of adding a cause on the parameters.
struct Moves {
    moved: DVector<f64>,
    /// Squares of the shifts by chance.
    squares: DVector<f64>,
    /// Squares of the standard errors without the cause.
    before: Vec<f64>,
    /// The law leaves enough of it to identify it.
    are_told: bool,
    /// The law leaves a little of it.
    are_hardly_told: bool,
    /// Its size is plausible, as far as the run identifies it.
    can_be: bool,
}

impl Law {
    fn of(rows: &Rows) -> Option<Self> {
        let inverse = inverse(&products(&rows.base, &rows.base))?;
        let values = &inverse * products_with(&rows.base, &rows.force);
        let residual = less(&rows.force, &rows.base, values.as_slice());
        let freedom = rows.force.len() as f64 / rows.per_observation - rows.base.len() as f64;
        let error_square = dot(&residual, &residual) / freedom.max(1.0);
        Some(Self { inverse, residual, error_square })
    }

    /// The effect of adding a term.
    fn with(&self, rows: &Rows, term: Term) -> Moves {
        let columns = rows.columns(term);
        let width = columns.len();
        let along = &self.inverse * products(&rows.base, &columns);
        let left: Vec<Vec<f64>> =
            columns.iter().enumerate().map(|(k, all)| less(all, &rows.base, along.column(k).as_slice())).collect();
        let [of_noise, with_force] = rows.noise(term).map(|mean| mean * rows.force.len() as f64);
        let leaves = |least: f64| {
            left.iter().zip(&columns).all(|(left, all)| {
                let told = dot(left, left) - of_noise;
                told > of_noise && told > least * (dot(all, all) - of_noise)
            })
        };
        let gram = DMatrix::from_fn(width, width, |i, j| dot(&left[i], &left[j]) - if i == j { of_noise } else { 0.0 });
        // If noise may account for all of it, the run says no more about it than that noise would.
        let unknown = || {
            let least = columns.iter().map(|all| of_noise.max(LEAST_KNOWN * dot(all, all)).recip());
            DMatrix::from_diagonal(&DVector::from_iterator(width, least))
        };
        let inverse = gram.cholesky().map_or_else(unknown, |gram| gram.inverse());
        let sizes = &inverse * products_with(&left, &self.residual).map(|said| said - with_force);
        let squares = (&along * inverse * along.transpose()).diagonal() * self.error_square;
        let before = self.inverse.diagonal().iter().map(|part| part * self.error_square).collect();
        let can_be = width > 1 || term.can_be(sizes[0], rows.law.coulomb_n);
        let [are_told, are_hardly_told] = [LEAST_LEFT, LITTLE_LEFT].map(leaves);
        Moves { moved: &along * sizes, squares, before, are_told, are_hardly_told, can_be }
    }
}
