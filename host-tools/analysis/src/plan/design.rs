//! Designs the motion: parts with their shares of the time, as long as the wanted intervals require.

use inerter_core::{Bank, Detail, Found, Motion, NORMAL_COVERAGE, Scatter, Source, Systematic};
use inerter_data::wants::Want;
use inerter_plant::Excitation;

use super::{
    candidates::{Candidate, Effort, candidates},
    error::PlanError,
    expected::Expected,
    information::{Together, Told},
    limits::Limits,
    part::{Part, duration_s, in_a_row},
    predict::{Predicted, Prediction, predict},
    search::{times, together},
};
use crate::{calibrate, fit::budget};

/// Effort of a design with rehearsals, and of one without.
const THOROUGH: Effort = Effort { frequencies: 12, varied: true };
const QUICK: Effort = Effort { frequencies: 6, varied: false };
/// Shortest motion \[s\]: the estimator does not judge the law before 200 updates.
const SHORTEST_S: f64 = 5.0;
/// Margin on the wanted intervals before a motion has been rehearsed.
const MARGIN: f64 = 1.05;
/// Attempts to find the required duration.
const ATTEMPTS: usize = 3;
/// Ratio of an interval to the wanted one that is close enough, so that no shorter motion is searched for.
const NEAR: f64 = 0.85;
/// Attempts to bring a part within the limits, and the margin to them.
const TRIMS: usize = 4;
const CLEAR: f64 = 0.995;
/// Weight of the determinant relative to the largest ratio of an interval to the wanted one: it decides ties.
const TIE: f64 = 1e-3;
/// Ratio of the rehearsed to the theoretical interval, and of 95 % of the scatter to the interval, above which the
/// theory does not apply to the motion.
const ASTRAY: f64 = 2.0;
const SCATTERS: f64 = 1.2;

/// A designed or given motion, and its predicted intervals for the expected device.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The expected device.
    pub expected: Expected,
    /// The text of a given motion.
    pub given: Option<String>,
    /// The parts of a designed one.
    pub parts: Vec<Part>,
    /// The motion.
    pub motion: Excitation,
    /// Its length \[s\].
    pub duration_s: f64,
    /// Its predicted intervals.
    pub prediction: Prediction,
    /// Whether it is designed for the wanted intervals in minimum time, instead of the minimum determinant of the
    /// covariance of inertance, viscous and Coulomb friction.
    pub is_wanted: bool,
    /// The wanted intervals.
    pub wants: Vec<Want>,
    /// The limits, within the instruments' ranges, that a designed motion respects.
    pub limits: Limits,
    /// For a given motion the limits as stated, which it may exceed; for a designed one the same as above.
    pub stated: Limits,
    /// The theoretical contribution of chance alone to each interval, as the half width of a component.
    pub(super) chance: [f64; 4],
}

impl Plan {
    /// The predicted interval for a wanted one, or the scatter if that is larger; infinite if there will be none.
    pub fn reached(&self, want: &Want) -> f64 {
        self.of(want).half_width()
    }

    /// The same for an endless motion: what averaging does not remove.
    pub fn floor(&self, want: &Want) -> f64 {
        let predicted = self.of(want);
        let [noise, model] =
            [Source::Noise, Source::Model].map(|source| f64::from(predicted.budget.parts()[source as usize].1));
        let averaged = noise.powi(2) + model.min(self.chance[want.place]).powi(2);
        (predicted.half_width().powi(2) - averaged).max(0.0).sqrt()
    }

    /// How long the same motion would have to last for this \[s\]; `None` if no time is enough.
    pub fn enough_s(&self, want: &Want) -> Option<f64> {
        let (reached, floor) = (self.reached(want), self.floor(want));
        let (of_time, left) = (reached * reached - floor * floor, want.u95 * want.u95 - floor * floor);
        (reached.is_finite() && left > 0.0).then(|| self.duration_s * of_time / left)
    }

    /// The prediction for the parameter of a wanted interval.
    pub(super) fn of(&self, want: &Want) -> &Predicted {
        &self.prediction.parameters[want.place]
    }
}

/// A motion without rehearsals.
#[derive(Clone, Debug)]
pub struct Sketch {
    /// Its parts.
    pub parts: Vec<Part>,
    /// The theoretical interval of each of the four parameters; infinite if there will be none.
    pub u95: [f64; 4],
    /// The limits that it respects.
    pub limits: Limits,
}

/// The search for a design.
struct Search<'a> {
    expected: &'a Expected,
    limits: &'a Limits,
    wants: &'a [Want],
    found: &'a [Candidate],
}

/// One way to search: whether for the wanted intervals, the bank if it is fixed, and the fraction of the highest
/// frequency up to which tones are used.
#[derive(Clone, Copy)]
struct Way {
    is_wanted: bool,
    bank: Option<Bank>,
    highest: f64,
}

/// For the minimum determinant, with everything allowed.
const D_OPTIMAL: Way = Way { is_wanted: false, bank: None, highest: 1.0 };

impl Search<'_> {
    fn score(&self, told: &Told, way: Way) -> f64 {
        if way.is_wanted { widest(told, self.wants).ln() + TIE * told.log_det } else { told.log_det }
    }

    /// The candidates that together fill this time, how long each of them lasts, and their information.
    fn lasting(&self, seconds: f64, way: Way) -> Option<(Vec<(&Candidate, f64)>, Told)> {
        let told = |all: &Together| all.told(self.expected, way.bank);
        let highest_hz = way.highest * self.limits.highest_hz;
        let is_allowed = |one: &&Candidate| one.part.tones.iter().all(|tone| tone.frequency_hz <= 1.01 * highest_hz);
        let allowed: Vec<&Candidate> = self.found.iter().filter(is_allowed).collect();
        let score = |all: &Together| told(all).map_or(f64::INFINITY, |told| self.score(&told, way));
        let (times, _) = times(&allowed, seconds, score)?;
        let told = together(&allowed, &times).and_then(|all| told(&all))?;
        Some((allowed.into_iter().zip(times).filter(|(_, time)| *time > 0.0).collect(), told))
    }

    /// The minimum time in which the wanted intervals are reached, within two percent; at most that of the limits.
    fn shortest(&self, way: Way) -> f64 {
        if self.wants.is_empty() {
            return self.limits.duration_s;
        }
        let is_enough = |seconds: f64| {
            self.lasting(seconds, way).is_some_and(|(_, told)| MARGIN * widest(&told, self.wants) <= 1.0)
        };
        let (mut low, mut high) = (SHORTEST_S, self.limits.duration_s);
        if high <= low || !is_enough(high) {
            return high;
        }
        if is_enough(low) {
            return low;
        }
        while high > 1.02 * low {
            let middle = (low * high).sqrt();
            if is_enough(middle) { high = middle } else { low = middle }
        }
        high
    }

    /// The parts with these durations \[s\], the one with the largest force first: from it the estimator learns
    /// friction soonest. Each is within the limits on its own, including its ramps.
    fn parts(&self, mut chosen: Vec<(&Candidate, f64)>) -> Result<Vec<Part>, PlanError> {
        chosen.sort_by(|a, b| b.0.peaks.force_n.total_cmp(&a.0.peaks.force_n));
        let part = |(one, duration_s): (&Candidate, f64)| {
            let mut part = Part { duration_s, ..one.part.clone() };
            for _ in 0..TRIMS {
                let seen = self.expected.quick().see(&part.motion(), duration_s, 1, None)?;
                let room = self.limits.room(&seen.peaks);
                if room >= 1.0 {
                    break;
                }
                part.scale(CLEAR * room);
            }
            Ok(part)
        };
        chosen.into_iter().map(part).collect()
    }

    /// The plan for this time, rehearsed, and reduced if its parts together exceed a limit.
    fn rehearsed(&self, seconds: f64, way: Way) -> Result<Option<(Plan, Told)>, PlanError> {
        let Some((chosen, told)) = self.lasting(seconds, way) else { return Ok(None) };
        let mut parts = self.parts(chosen)?;
        let duration_s = duration_s(&parts);
        let mut motion = in_a_row(&parts);
        let mut prediction = predict(self.expected, &motion, duration_s)?;
        for _ in 0..TRIMS {
            let room = self.limits.room(&prediction.peaks);
            if room >= 1.0 {
                break;
            }
            parts.iter_mut().for_each(|part| part.scale(CLEAR * room));
            motion = in_a_row(&parts);
            prediction = predict(self.expected, &motion, duration_s)?;
        }
        let plan = Plan {
            expected: *self.expected,
            given: None,
            parts,
            motion,
            duration_s,
            prediction,
            is_wanted: way.is_wanted,
            wants: self.wants.to_vec(),
            limits: *self.limits,
            stated: *self.limits,
            chance: told.budgets.map(|budget| f64::from(budget.given_u95(Source::Model))),
        };
        Ok(Some((plan, told)))
    }

    /// Searches in this way for a better plan; returns whether rehearsals contradict the theory.
    fn seek(&self, best: &mut Option<Plan>, way: Way, progress: &mut impl FnMut(f64)) -> Result<bool, PlanError> {
        let (mut seconds, mut is_astray) = (self.shortest(way), false);
        for attempt in 0..ATTEMPTS {
            progress(0.5 + 0.5 * attempt as f64 / ATTEMPTS as f64);
            let Some((plan, told)) = self.rehearsed(seconds, way)? else { break };
            let pairs = plan.prediction.parameters.iter().zip(&told.budgets).take(3);
            is_astray = pairs.into_iter().any(|(predicted, told)| {
                !predicted.is_given()
                    || predicted.u95() > ASTRAY * f64::from(told.u95())
                    || same_rig_half_width(predicted) > SCATTERS * predicted.same_rig_u95()
            });
            let (worst, length_s) = (self.worst(&plan), plan.duration_s);
            if best.as_ref().is_none_or(|best| self.is_better(&plan, best)) {
                *best = Some(plan);
            }
            let is_near = (NEAR..=1.0).contains(&worst) || (worst < NEAR && length_s <= 1.05 * SHORTEST_S);
            if self.wants.is_empty() || is_near || (worst > 1.0 && seconds >= self.limits.duration_s) {
                break;
            }
            let longer = if worst.is_finite() { worst * worst * MARGIN } else { 2.0 };
            seconds = (seconds * longer).clamp(SHORTEST_S, self.limits.duration_s);
        }
        Ok(is_astray)
    }

    /// Among plans that reach everything the shorter is better; among the others the one that comes closest.
    fn is_better(&self, plan: &Plan, than: &Plan) -> bool {
        match (self.worst(than) <= 1.0, self.worst(plan) <= 1.0) {
            (true, true) if !self.wants.is_empty() => plan.duration_s < than.duration_s,
            (false, true) => true,
            (true, false) => false,
            _ => self.rank(plan) < self.rank(than),
        }
    }

    /// Rank of a rehearsed motion: lower is better.
    fn rank(&self, plan: &Plan) -> f64 {
        if self.wants.is_empty() {
            plan.prediction.parameters.iter().take(3).map(|predicted| same_rig_half_width(predicted).ln()).sum()
        } else {
            self.worst(plan).ln()
        }
    }

    /// The largest ratio of an interval to the wanted one; 0 if nothing is wanted.
    fn worst(&self, plan: &Plan) -> f64 {
        self.wants.iter().map(|want| plan.reached(want) / want.u95).fold(0.0, f64::max)
    }
}

/// Designs the motion for an expected device within the limits: D-optimal over the whole duration or, if intervals are
/// wanted, the shortest one that reaches them. `progress` gets the completed fraction.
pub fn design(
    expected: &Expected,
    limits: Limits,
    wants: &[Want],
    mut progress: impl FnMut(f64),
) -> Result<Plan, PlanError> {
    let limits = limits.checked(expected)?;
    let found = candidates(expected, &limits, THOROUGH, |part| progress(0.4 * part))?;
    let possible: Vec<Want> = wants.iter().copied().filter(|want| calibration(expected, want) < want.u95).collect();
    let search = Search { expected, limits: &limits, wants: &possible, found: &found };
    let first = Way { is_wanted: !possible.is_empty(), ..D_OPTIMAL };
    let mut best = None;
    let mut is_astray = search.seek(&mut best, first, &mut progress)?;
    if first.is_wanted && best.as_ref().is_none_or(|best| search.worst(best) > 1.0) {
        is_astray |= search.seek(&mut best, D_OPTIMAL, &mut progress)?;
    }
    if is_astray || best.is_none() {
        let [fast, slow] = [Bank::Fast, Bank::Slow].map(|bank| Way { bank: Some(bank), ..first });
        for other in [Way { highest: 0.5, ..first }, fast, slow] {
            search.seek(&mut best, other, &mut progress)?;
        }
    }
    progress(1.0);
    let best = best.ok_or_else(|| nothing(expected, &limits, &found))?;
    Ok(Plan { wants: wants.to_vec(), ..best })
}

/// Half width without the errors that two runs share, or the scatter if it is larger.
fn same_rig_half_width(predicted: &Predicted) -> f64 {
    predicted.same_rig_u95().max(f64::from(NORMAL_COVERAGE) * predicted.scatter)
}

/// The ratio of the interval from gain, lead and timebase alone to the wanted one, whatever the motion.
fn calibration(expected: &Expected, want: &Want) -> f64 {
    let value = expected.law()[want.place];
    let found = Found { value: value as f32, error: 0.0, per_skew: 0.0, steps: 0.0 };
    let scatter = Scatter::white(value as f32, f32::INFINITY);
    // For any motion: none of the three depends on it.
    let motion = Motion::of(&Detail::default(), 1.0);
    let budget = budget(want.place, &Systematic::of(&expected.settings), &found, &scatter.in_motion(&motion), &motion);
    calibrate::together(
        [Source::Gain, Source::Lead, Source::Timebase].map(|source| f64::from(budget.given_u95(source))),
    )
}

/// The same without rehearsals and with fewer candidates: a quick estimate of what a motion of this length could
/// identify.
pub fn sketch(expected: &Expected, limits: Limits) -> Result<Sketch, PlanError> {
    let limits = limits.checked(expected)?;
    let found = candidates(expected, &limits, QUICK, |_| ())?;
    let search = Search { expected, limits: &limits, wants: &[], found: &found };
    let (chosen, told) =
        search.lasting(limits.duration_s, D_OPTIMAL).ok_or_else(|| nothing(expected, &limits, &found))?;
    let u95 = told.budgets.map(|budget| f64::from(budget.u95()));
    Ok(Sketch { parts: search.parts(chosen)?, u95, limits })
}

/// The largest ratio of an interval to the wanted one.
fn widest(told: &Told, wants: &[Want]) -> f64 {
    wants.iter().map(|want| f64::from(told.budgets[want.place].u95()) / want.u95).fold(0.0, f64::max)
}

/// Why nothing can be identified.
fn nothing(expected: &Expected, limits: &Limits, found: &[Candidate]) -> PlanError {
    let why = match found.iter().map(|one| one.peaks.stroke_m).reduce(f64::max) {
        None => format!(
            "from {:.3} to {:.3} Hz the estimator uses nothing, because the screw sticks or moves by less than 2 encoder counts in 24 ms",
            limits.lowest_hz, limits.highest_hz
        ),
        Some(stroke_m) => format!(
            "with strokes of {:.0} encoder counts at most, the acceleration is lost in the encoder's steps",
            stroke_m / expected.settings.metres_per_count.abs()
        ),
    };
    PlanError::Nothing { why }
}
