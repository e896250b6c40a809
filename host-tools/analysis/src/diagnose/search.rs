//! The search: what explains most is added first.

use inerter_core::{Found, Law, LawStatus, Motion, Parameter, Parameters, Published, Scatter, Settings, constants};
use inerter_data::series::Series;
use nalgebra::{DMatrix, DVector};

use super::{
    cause::Cause,
    columns::{Candidate, Rows, Term},
    kind::Kind,
    selection::{Group, Selection, dot},
};
use crate::{
    fit::{Beside, FitError, Judge},
    law::{self, Kernels},
};

/// What friction at the reversals makes of a skew \[s\], at most (docs/THEORY.md, 10).
const SKEW_MODEL_U95_S: f64 = 13e-6;
/// Causes that are looked for at most.
const MOST: usize = 4;
/// Part of a cause's statistic that another has which explains as much.
const RIVAL: f64 = 0.9;
/// Steps by which a length or a velocity is made more exact, on either side.
const FINER: [f64; 2] = [1.5, 1.15];
/// Steps of one size at most: the next of the values that are tried is nearer.
const MOST_STEPS: usize = 3;
/// Residual, as a part of what the law alone leaves over, above which a cause is not most of what breaks it.
const MOST_LEFT: f64 = 0.7;
/// Independent observations under which nothing is said.
const LEAST_OBSERVATIONS: f64 = 30.0;

/// What a run shows.
#[derive(Clone, Debug, PartialEq)]
pub struct Diagnosis {
    /// In the order of their weight.
    pub causes: Vec<Cause>,
    /// The parameters with the causes included; none where the motion cannot tell them apart.
    pub corrected: Option<Parameters>,
    /// Greatest F statistic of what was not named, in parts of its limit.
    pub greatest_left: f64,
    /// Root mean square of what the law leaves over by itself, and with the causes beside it \[N\].
    pub residual_rms_n: [f64; 2],
}

/// Whether a cause should be sought: more is left over than chance leaves, whatever the flanks may have to do with it.
pub fn is_suspect(law: &Law) -> bool {
    law.status == LawStatus::Broken || law.misfit.is_some_and(|misfit| misfit.ratio > misfit.limit)
}

/// What a person should be told of a run who has not asked for it: nothing where the law holds, and all where it is broken. Where
/// flanks may part, their impacts can look like a cause; then what was found must be most of what is left over. Nothing is told
/// either where too little of the run can be looked at.
pub fn suspected(series: &Series, settings: &Settings, published: &Published) -> Vec<Cause> {
    if !is_suspect(&published.law) {
        return Vec::new();
    }
    let Ok(Diagnosis { causes, residual_rms_n: [alone, with_causes], .. }) =
        diagnose(series, settings, published, None)
    else {
        return Vec::new();
    };
    let is_most = with_causes < MOST_LEFT * alone;
    if published.law.status == LawStatus::Broken || is_most { causes } else { Vec::new() }
}

/// Tests a run of which the estimator said this in the end; `counts_per_turn` of the encoder, where they are known, else those that are usual
/// are tried.
///
/// A skew is undone before the rest is looked at.
pub fn diagnose(
    series: &Series,
    settings: &Settings,
    published: &Published,
    counts_per_turn: Option<f64>,
) -> Result<Diagnosis, FitError> {
    let first = searched(series, settings, published, counts_per_turn, None)?;
    let Some(place) = first.causes.iter().position(|cause| cause.kind == Kind::Skew) else { return Ok(first) };
    let Some(skew) = first.causes.get(place).copied() else { return Ok(first) };
    let skew_u95_s = settings.skew_u95_s.hypot(SKEW_MODEL_U95_S);
    let undone = Settings { skew_s: settings.skew_s + skew.value, skew_u95_s, ..*settings };
    let left = Candidate { kind: Kind::Skew, term: Term::Skew };
    let mut found = searched(series, &undone, published, counts_per_turn, Some(left))?;
    found.residual_rms_n[0] = first.residual_rms_n[0];
    // What is left of the skew was taken in before all others.
    if !found.causes.is_empty() {
        let left = found.causes.remove(0);
        let whole = Cause { value: skew.value + left.value, u95: left.u95.hypot(SKEW_MODEL_U95_S), ..skew };
        found.causes.insert(place.min(found.causes.len()), whole);
    }
    Ok(found)
}

/// One search; `known` is taken in before it begins.
fn searched(
    series: &Series,
    settings: &Settings,
    published: &Published,
    counts_per_turn: Option<f64>,
    known: Option<Candidate>,
) -> Result<Diagnosis, FitError> {
    let aligned = series.aligned(settings);
    let rows = rows_of(&aligned, settings, published)?;
    let mut search = Search::of(&rows, Candidate::all(&rows.span, settings, counts_per_turn));
    let alone_n = search.selection.residual_rms();
    let mut chosen: Vec<Chosen> =
        known.into_iter().map(|candidate| search.choose(Chosen { candidate, f: 0.0, rival: None })).collect();
    let greatest_left = loop {
        let Some(next) = search.next() else { break 0.0 };
        if next.strength() < 1.0 || chosen.len() == MOST {
            break next.strength();
        }
        chosen.push(search.choose(next));
    };
    let Some(Fitted { causes, corrected, residual_rms_n }) =
        fitted(&rows, settings, &Motion::of(&published.detail, 1.0), &chosen)
    else {
        return Ok(Diagnosis { causes: Vec::new(), corrected: None, greatest_left, residual_rms_n: [alone_n; 2] });
    };
    let residual_rms_n = [alone_n, residual_rms_n];
    Ok(Diagnosis { causes, corrected: Some(corrected), greatest_left, residual_rms_n })
}

/// The rows of a run, with signs placed by what the estimator said of the whole of it.
pub(super) fn rows_of<'a>(
    aligned: &'a Series,
    settings: &Settings,
    published: &Published,
) -> Result<Rows<'a>, FitError> {
    let kernels = Kernels::new(published.estimate.bank, aligned.period_s);
    let found = published.estimate.whole_run;
    let value = |parameter: Parameter| f64::from(parameter.fitted().value);
    let law = law::Law {
        inertance_kg: value(found.inertance_kg) + settings.structure_mass_kg,
        viscous_n_s_per_m: value(found.viscous_n_s_per_m),
        coulomb_n: value(found.coulomb_n),
        offset_n: value(found.offset_n),
    };
    let rows = Rows::of(aligned, settings, kernels, law);
    let observations = rows.force.len() as f64 / rows.per_observation;
    if observations < LEAST_OBSERVATIONS { Err(FitError::TooShort { observations }) } else { Ok(rows) }
}

/// A candidate that was chosen.
struct Chosen {
    candidate: Candidate,
    f: f64,
    rival: Option<Kind>,
}

impl Chosen {
    /// F statistic in parts of its limit.
    fn strength(&self) -> f64 {
        self.f / self.candidate.kind.limit()
    }
}

/// The search under way.
struct Search<'a> {
    rows: &'a Rows<'a>,
    groups: Vec<(Candidate, Group)>,
    selection: Selection,
    directions: Vec<Vec<f64>>,
}

impl<'a> Search<'a> {
    fn of(rows: &'a Rows<'a>, candidates: Vec<Candidate>) -> Self {
        let mut selection = Selection::new(&rows.force, rows.per_observation);
        let directions = selection.take(&Group::new(rows.base.to_vec()));
        let mut search = Self { rows, groups: Vec::new(), selection, directions };
        search.groups = candidates.into_iter().map(|candidate| (candidate, search.group(candidate))).collect();
        search
    }

    fn group(&self, candidate: Candidate) -> Group {
        let mut group = Group::new(self.rows.columns(candidate.term));
        self.directions.iter().for_each(|direction| group.leave_out(direction));
        group
    }

    fn statistic(&self, candidate: Candidate, group: &Group) -> f64 {
        self.selection.statistic(group, |size| candidate.can_be(size, &self.rows.law))
    }

    /// What explains most of the residual.
    fn next(&self) -> Option<Chosen> {
        let with_f = self.groups.iter().map(|(candidate, group)| (*candidate, self.statistic(*candidate, group)));
        let all: Vec<(Candidate, f64)> = with_f.collect();
        let (best, f) = all.iter().copied().max_by(|(_, a), (_, b)| a.total_cmp(b))?;
        let others = all.iter().filter(|(candidate, other)| candidate.kind != best.kind && *other > RIVAL * f);
        let rival = others.max_by(|(_, a), (_, b)| a.total_cmp(b)).map(|(candidate, _)| candidate.kind);
        Some(Chosen { candidate: best, f, rival })
    }

    /// Takes it in, at the length or velocity at which it explains most.
    fn choose(&mut self, mut chosen: Chosen) -> Chosen {
        for step in FINER {
            for _ in 0..MOST_STEPS {
                let finer = [step, step.recip()].into_iter().filter_map(|factor| chosen.candidate.scaled(factor));
                let better = finer
                    .map(|candidate| (candidate, self.statistic(candidate, &self.group(candidate))))
                    .filter(|(_, f)| *f > chosen.f)
                    .max_by(|(_, a), (_, b)| a.total_cmp(b));
                let Some((candidate, f)) = better else { break };
                (chosen.candidate, chosen.f) = (candidate, f);
            }
        }
        let new = self.selection.take(&self.group(chosen.candidate));
        for (_, group) in &mut self.groups {
            new.iter().for_each(|direction| group.leave_out(direction));
        }
        self.directions.extend(new);
        self.groups.retain(|(candidate, _)| candidate.kind != chosen.candidate.kind);
        chosen
    }
}

/// Least squares with all that was chosen.
struct Fitted {
    causes: Vec<Cause>,
    corrected: Parameters,
    residual_rms_n: f64,
}

/// Fits them; nothing where the motion cannot tell them apart.
fn fitted(rows: &Rows, settings: &Settings, motion: &Motion, chosen: &[Chosen]) -> Option<Fitted> {
    let groups: Vec<Vec<Vec<f64>>> = chosen.iter().map(|one| rows.columns(one.candidate.term)).collect();
    let columns: Vec<&Vec<f64>> = rows.base.iter().chain(groups.iter().flatten()).collect();
    let scales: Vec<f64> = columns.iter().map(|column| dot(column, column).sqrt().recip()).collect();
    let count = columns.len();
    let gram = DMatrix::from_fn(count, count, |i, j| dot(columns[i], columns[j]) * scales[i] * scales[j]);
    let right = DVector::from_fn(count, |i, _| dot(columns[i], &rows.force) * scales[i]);
    let factors = gram.cholesky()?;
    let (solution, inverse) = (factors.solve(&right), factors.inverse());
    let left = dot(&rows.force, &rows.force) - solution.dot(&right);
    let freedom = rows.force.len() as f64 / rows.per_observation - count as f64;
    let square = left.max(0.0) / freedom.max(1.0);
    let value = |i: usize| solution[i] * scales[i];
    let covariance = |i: usize, j: usize| inverse[(i, j)] * scales[i] * scales[j] * square;
    let error = |i: usize| covariance(i, i).max(0.0).sqrt();
    let mut at = rows.base.len();
    let causes = chosen.iter().map(|one| {
        let first = at;
        let width = Rows::width(one.candidate.term);
        at += width;
        let (size, size_error) = if width == 2 {
            let (a, b) = (value(first), value(first + 1));
            let length = a.hypot(b);
            let variance = a * a * covariance(first, first)
                + 2.0 * a * b * covariance(first, first + 1)
                + b * b * covariance(first + 1, first + 1);
            (length, variance.max(0.0).sqrt() / length)
        } else {
            (value(first), error(first))
        };
        cause(one, size, constants::COVERAGE * size_error)
    });
    let causes: Vec<Cause> = causes.collect();
    // What a skew that is left unseen moves, a skew that was found beside the law or not.
    let late = rows.columns(Term::Skew);
    let [late] = late.as_slice() else { return None };
    let law = rows.base.len();
    let own = DMatrix::from_fn(law, law, |i, j| dot(&rows.base[i], &rows.base[j]) * scales[i] * scales[j]);
    let moved = own.cholesky()?.solve(&DVector::from_fn(law, |i, _| dot(&rows.base[i], late) * scales[i]));
    let found = [0, 1, 2, 3].map(|i| Found {
        value: value(i) as f32,
        error: error(i) as f32,
        per_skew: (moved[i] * scales[i]) as f32,
        steps: 0.0,
    });
    // What breaks the law is in the fit.
    let beside = Beside { motion: *motion, model_u95: [0.0; 4] };
    let parameters =
        Judge { settings, beside: &beside, scatter: Scatter::white(value(0) as f32, freedom as f32) }.four(found);
    let residual_rms_n = (left.max(0.0) / rows.force.len() as f64).sqrt();
    Some(Fitted { causes, corrected: parameters, residual_rms_n })
}

fn cause(chosen: &Chosen, size: f64, u95: f64) -> Cause {
    let Candidate { kind, term } = chosen.candidate;
    let (value, u95, unit, period_m) = match term {
        Term::Load => (size, u95, "1", None),
        Term::Ripple(period_m) | Term::Uneven(period_m) => (size, u95, "N", Some(period_m)),
        Term::Wobble(period_m) => (size, u95, "m", Some(period_m)),
        Term::Falling(_) | Term::Bell(_) | Term::Drift | Term::Warming => (size, u95, "N", None),
        // What the distance is uncertain by is the last step by which it was sought.
        Term::Turning(distance) => (distance, (FINER[1] - 1.0) * distance, "m", None),
        Term::Thinning | Term::Speed => (size, u95, "N s/m", None),
        Term::Skew => (size, u95, "s", None),
    };
    Cause { kind, value, u95, unit, f: chosen.f, period_m, rival: chosen.rival }
}
