//! The search: adds the cause that explains most first, and judges it again with all that are added later.

use inerter_core::{Law as LawState, LawStatus, Parameters, Published, Settings};
use inerter_data::{gated::Gated, series::Series};

use super::{
    candidate::{Encoder, Found, Kind, LIMIT, Term},
    cause::Cause,
    columns::{MOST_ROWS, Rows},
    filter::{Filter, Sight, force_noise_n},
    fitted::fitted,
    found::{model, refine, strongest, taken},
    selection::Model,
};
use crate::{
    fit::FitError,
    law::{LEAST_OBSERVATIONS, Law},
};

/// Maximum number of causes.
const MOST: usize = 4;
/// Fraction of the strongest evidence from which another cause is also tried with reversals located by it, and their
/// maximum number.
const CLOSE: f64 = 0.5;
const MOST_CLOSE: usize = 3;
/// What one more size must explain, in squares of the noise, to be preferred.
const WORTH: f64 = 8.0;
/// Fraction of a cause's evidence from which another explains as much.
const RIVAL: f64 = 0.9;
/// Maximum rounds of locating reversals and fitting sizes, and the relative change of a size at which they end.
const ROUNDS: usize = 6;
const ALIKE: f64 = 0.01;
/// Maximum corrections of a skew, and the remainder that is accepted \[s\], also as a fraction of it.
const MOST_UNDONE: usize = 6;
const UNDONE_S: f64 = 2e-6;
const UNDONE: f64 = 0.02;
/// Maximum residual with a cause, beyond noise and steps, as a fraction (in squares) of that of the law alone, for it
/// to be the main cause.
const MOST_LEFT: f64 = 0.25;
/// F statistic from which a cause is reported unasked if the flanks may part.
const LIMIT_PARTING: f64 = 1000.0;
/// Minimum fraction of rows left after excluding rest, and maximum fraction of the acceleration due to encoder steps;
/// otherwise other kernels are tried.
const LEAST_KEPT: f64 = 0.4;
const MOST_STEPS: f64 = 0.15;

/// Residual relative to noise and steps up to which they explain it.
const EXPLAINED: f64 = 1.4;

/// The result of a diagnosis.
#[derive(Clone, Debug, PartialEq)]
pub struct Diagnosis {
    /// In descending order of importance.
    pub causes: Vec<Cause>,
    /// The parameters with the causes included, if any were found; `None` if the motion cannot separate them.
    pub corrected: Option<Parameters>,
    /// Largest evidence that was not named, relative to its limit.
    pub greatest_left: f64,
    /// RMS residual of the law alone, and with the causes included \[N\].
    pub residual_rms_n: [f64; 2],
    /// The RMS that noise and the encoder's steps leave in these rows \[N\].
    pub noise_rms_n: f64,
}

impl Diagnosis {
    /// Whether the causes account for most of what noise and the encoder's steps do not explain.
    fn is_most(&self) -> bool {
        let [alone, with_causes] = self.residual_rms_n.map(|rms| rms * rms - self.noise_rms_n * self.noise_rms_n);
        with_causes < MOST_LEFT * alone
    }

    /// Whether noise and the encoder's steps explain the residual with the causes included.
    pub fn is_explained(&self) -> bool {
        let [_, with_causes] = self.residual_rms_n;
        with_causes <= EXPLAINED * self.noise_rms_n
    }
}

/// Whether to search for a cause: the residual is larger than chance explains, even if the flanks may be the reason.
pub fn is_suspect(law: &LawState) -> bool {
    law.status == LawStatus::Broken || law.misfit.is_some_and(|misfit| misfit.ratio > misfit.limit)
}

/// Whether the force acts in the wrong direction: then adding to the law is pointless.
pub fn is_reversed(published: &Published) -> bool {
    let inertance = published.estimate.whole_run.inertance_kg.fitted();
    inertance.value + inertance.u95 < 0.0
}

/// The causes that a person should know of without asking: none if the law holds, all if it is broken. If the flanks
/// may part, their impacts can look like a cause; then the causes found must explain most of the residual, each of them
/// clearly, and a mass on the terminal must not explain it too. None are reported if too little of the run can be
/// evaluated.
pub fn suspected(gated: &Gated, settings: &Settings, published: &Published) -> Vec<Cause> {
    if !is_suspect(&published.law) || is_reversed(published) {
        return Vec::new();
    }
    let Ok(found) = diagnose(&gated.series, settings, published, Encoder::default(), &|| {}) else { return Vec::new() };
    if published.law.status == LawStatus::Broken {
        return found.causes;
    }
    let is_most = found.is_most();
    let is_clear = |cause: &Cause| cause.f >= LIMIT_PARTING && cause.rival != Some(Kind::Structure);
    found.causes.into_iter().filter(|cause| is_most && is_clear(cause)).collect()
}

/// Diagnoses a run for which `published` is the estimator's final result.
///
/// Each cause is included as it is found; then all are fitted together, and each is compared with all possible
/// alternatives. A skew is corrected, and the search continues. `tick` is called before each pass over the run.
pub fn diagnose(
    series: &Series,
    settings: &Settings,
    published: &Published,
    encoder: Encoder,
    tick: &dyn Fn(),
) -> Result<Diagnosis, FitError> {
    let search = Search {
        tick,
        published,
        encoder,
        seeks_skew: true,
        sights: Sight::all(published.estimate.bank),
        settings: *settings,
        noise_n: force_noise_n(series, settings),
        law: Law::of_run(&published.estimate.whole_run, settings),
        found: Vec::new(),
        greatest_left: 0.0,
    };
    let found = search.clone().searched(series)?;
    // A skew that the other causes explain as well, once found, was not a skew.
    let is_weak = |cause: &Cause| cause.kind == Kind::Skew && cause.f < LIMIT;
    if found.causes.iter().any(is_weak) {
        return Search { seeks_skew: false, ..search }.searched(series);
    }
    Ok(found)
}

/// The rows of a run, with signs placed by the estimator's result for the whole run.
pub(super) fn rows_of<'a>(
    aligned: &'a Series,
    settings: &Settings,
    published: &Published,
) -> Result<Rows<'a>, FitError> {
    let sight = Sight::Box(published.estimate.bank.box_s());
    let law = Law::of_run(&published.estimate.whole_run, settings);
    let (spacing, noise_n) = (aligned.len() / MOST_ROWS, force_noise_n(aligned, settings));
    let filter = Filter::of(sight, spacing, aligned.period_s, settings, &law, noise_n, 1.0);
    enough(Rows::of(aligned, law, &[], settings, |_| filter))
}

fn enough(rows: Rows) -> Result<Rows, FitError> {
    let observations = rows.force.len() as f64 / rows.per_observation;
    if observations < LEAST_OBSERVATIONS { Err(FitError::TooShort { observations }) } else { Ok(rows) }
}

/// State of the search.
#[derive(Clone)]
struct Search<'a> {
    tick: &'a dyn Fn(),
    published: &'a Published,
    encoder: Encoder,
    seeks_skew: bool,
    /// The filters still in question; unsuitable ones have been removed.
    sights: &'static [Sight],
    /// With the skew that was found corrected.
    settings: Settings,
    noise_n: f64,
    law: Law,
    found: Vec<Found>,
    greatest_left: f64,
}

/// All terms that are tried in a run, with their columns.
type Columns = Vec<(Term, Vec<Vec<f64>>)>;

impl Search<'_> {
    /// The result, from a search that has not begun.
    fn searched(mut self, series: &Series) -> Result<Diagnosis, FitError> {
        let (unsearched, settings) = (self.clone(), self.settings);
        for _ in 0..MOST_UNDONE {
            self.seek(&series.aligned(&self.settings))?;
            let left_s = self.skew().map_or(0.0, |skew| skew.sizes[0]);
            if left_s.abs() <= UNDONE_S.max(UNDONE * (self.settings.skew_s - settings.skew_s).abs()) {
                break;
            }
            self.settings.skew_s += left_s;
        }
        // The law alone, filtered in the same way as everything.
        let mut alone = Self { sights: self.sights, ..unsearched };
        let aligned = series.aligned(&settings);
        let rows = alone.rows(&aligned)?;
        alone.settle(&rows)?;
        let rows = alone.rows(&aligned)?;
        let alone_n = alone.settle(&rows)?.residual_rms();
        let aligned = series.aligned(&self.settings);
        let rows = self.rows(&aligned)?;
        let undone_s = self.settings.skew_s - settings.skew_s;
        let fitted = loop {
            let fitted = fitted(&rows, &self.settings, &self.published.detail, &self.found, undone_s, self.encoder);
            if fitted.is_some() || !self.drop_weakest() {
                break fitted;
            }
        };
        let (causes, corrected, with_causes_n) = match fitted {
            Some((causes, corrected, rms_n)) => (causes, Some(corrected), rms_n),
            None => (Vec::new(), None, alone_n),
        };
        Ok(Diagnosis {
            causes,
            corrected,
            greatest_left: self.greatest_left,
            residual_rms_n: [alone_n, with_causes_n],
            noise_rms_n: (rows.filter.noise_square + rows.filter.steps_square).sqrt(),
        })
    }

    /// The rows with everything known so far, through the most informative filter.
    fn rows<'a>(&mut self, aligned: &'a Series) -> Result<Rows<'a>, FitError> {
        loop {
            (self.tick)();
            let [sight, worse @ ..] = self.sights else { return Err(FitError::Motion) };
            let rows = Rows::of(aligned, self.law, &self.found, &self.settings, |repeats| {
                Filter::of(*sight, 1, aligned.period_s, &self.settings, &self.law, self.noise_n, repeats)
            });
            let is_fit = || rows.kept >= LEAST_KEPT && model(&rows, &[]).is_some_and(|law| law.steps <= MOST_STEPS);
            if worse.is_empty() || is_fit() {
                return enough(rows);
            }
            self.sights = worse;
        }
    }

    /// Fits the causes found, in rows whose reversals are located with them; drops the weakest if the motion cannot
    /// separate them all.
    fn settle<'a>(&mut self, rows: &'a Rows<'a>) -> Result<Model<'a>, FitError> {
        loop {
            if let Some(model) = model(rows, &self.found) {
                self.law = taken(&model, &mut self.found);
                return Ok(model);
            }
            if !self.drop_weakest() {
                return Err(FitError::Motion);
            }
        }
    }

    /// Drops the weakest; returns whether there was one.
    fn drop_weakest(&mut self) -> bool {
        let all = self.found.iter().enumerate();
        let weakest = all.min_by(|(_, a), (_, b)| a.strength.total_cmp(&b.strength)).map(|(place, _)| place);
        weakest.map(|place| self.found.remove(place)).is_some()
    }

    /// The skew that was found; its size is the remainder \[s\].
    fn skew(&self) -> Option<&Found> {
        self.found.iter().find(|one| one.term.kind() == Kind::Skew)
    }

    /// Finds causes, until a skew is found, which must be corrected first.
    fn seek(&mut self, aligned: &Series) -> Result<(), FitError> {
        // First with the estimator's law, which a fault may have distorted, to fit a better one.
        let rows = self.rows(aligned)?;
        self.settle(&rows)?;
        let had_skew = self.skew().is_some();
        while self.found.len() < MOST {
            let rows = self.rows(aligned)?;
            let model = self.settle(&rows)?;
            let best = Self::best(&rows, &model, &self.columns(&rows), &self.found);
            self.greatest_left = best.iter().map(Found::f).fold(0.0, f64::max) / LIMIT;
            let named: Vec<Found> = best.into_iter().filter(|one| one.f() >= LIMIT).collect();
            let Some(first) = named.first() else { break };
            let close = named.iter().filter(|one| one.strength > CLOSE * first.strength).take(MOST_CLOSE);
            let close: Vec<Found> = close.copied().collect();
            if let [only] = close.as_slice() {
                self.found.push(*only);
            } else {
                let square = model.square();
                let tried = close.into_iter().filter_map(|one| self.tried(aligned, one, square));
                let Some((_, best)) = tried.min_by(|(a, _), (b, _)| a.total_cmp(b)) else { break };
                *self = best;
            }
            if !had_skew && self.skew().is_some() {
                let rows = self.rows(aligned)?;
                self.settle(&rows)?;
                return Ok(());
            }
        }
        self.polish(aligned)
    }

    /// The search with one more cause, which also locates the reversals; and its residual in squares of the noise,
    /// including the cost of its sizes.
    fn tried(&self, aligned: &Series, one: Found, square: f64) -> Option<(f64, Self)> {
        let mut with = self.clone();
        with.found.push(one);
        let left = with.converge(aligned).ok()?;
        let sizes = one.term.width() + usize::from(one.term.scale().is_some());
        Some((left / square + WORTH * sizes as f64, with))
    }

    /// Alternately locates reversals with the causes found and fits them, until neither changes; returns the residual.
    fn converge(&mut self, aligned: &Series) -> Result<f64, FitError> {
        let mut left = f64::INFINITY;
        for _ in 0..ROUNDS {
            let before = self.found.clone();
            let rows = self.rows(aligned)?;
            refine(&rows, &mut self.found);
            left = self.settle(&rows)?.left();
            if are_alike(&before, &self.found) {
                break;
            }
        }
        Ok(left)
    }

    /// All terms that are tried, with their columns.
    fn columns(&self, rows: &Rows) -> Columns {
        let all = Term::all(&rows.span, &self.settings, self.encoder).into_iter();
        let sought = all.filter(|term| self.seeks_skew || term.kind() != Kind::Skew);
        sought.map(|term| (term, rows.columns(term))).collect()
    }

    /// For each kind that is not among the others, the term that explains most in addition to them, the strongest
    /// first.
    fn best(rows: &Rows, model: &Model, columns: &Columns, others: &[Found]) -> Vec<Found> {
        let evidence = |term: Term, columns: &[Vec<f64>]| {
            model.evidence(term, columns, rows.noise(term)[0], |size, coulomb_n| term.can_be(size, coulomb_n))
        };
        let strength = |evidence: Option<Found>| evidence.map_or(0.0, |found| found.strength);
        let kinds = Kind::ALL.into_iter().filter(|kind| others.iter().all(|one| one.term.kind() != *kind));
        let of_kind = |kind: Kind| {
            let all = columns.iter().filter(|(term, _)| term.kind() == kind);
            let told = all.map(|(term, columns)| (*term, strength(evidence(*term, columns))));
            let (best, most) = told.max_by(|(_, a), (_, b)| a.total_cmp(b))?;
            let of = |term: Term| evidence(term, &rows.columns(term));
            // If there is no evidence, the search does not continue.
            of(if most > 0.1 * LIMIT { strongest(best, |term| strength(of(term))) } else { best })
        };
        let mut all: Vec<Found> = kinds.filter_map(of_kind).collect();
        all.sort_by(|a, b| b.strength.total_cmp(&a.strength));
        all
    }

    /// Fits all causes found, and compares each with its possible alternatives.
    fn polish(&mut self, aligned: &Series) -> Result<(), FitError> {
        for _ in 0..ROUNDS {
            if self.found.is_empty() {
                break;
            }
            self.converge(aligned)?;
            let rows = self.rows(aligned)?;
            self.settle(&rows)?;
            if !self.weigh(&rows) {
                break;
            }
        }
        Ok(())
    }

    /// Weighs each by what it explains in addition to the others: drops one that is too weak, replaces one that another
    /// explains better. Returns whether anything changed.
    fn weigh(&mut self, rows: &Rows) -> bool {
        let columns = self.columns(rows);
        let mut weighed: Vec<Found> = Vec::new();
        let mut has_changed = false;
        for (place, one) in self.found.clone().into_iter().enumerate() {
            // A corrected skew shows nothing more.
            if one.term.kind() == Kind::Skew {
                weighed.push(one);
                continue;
            }
            let later = self.found.iter().skip(place + 1).copied();
            let others: Vec<Found> = weighed.iter().copied().chain(later).collect();
            let Some(model) = model(rows, &others) else { return false };
            let can_be = one.is_whole || one.term.can_be(one.sizes[0], self.law.coulomb_n);
            let own = model.evidence(one.term, &rows.columns(one.term), 0.0, |_, _| can_be);
            let own = Found { strength: own.map_or(0.0, |own| own.strength), ..one };
            let all = Self::best(rows, &model, &columns, &others);
            let rival = all.into_iter().find(|other| other.term.kind() != one.term.kind());
            let equals = |weaker: &Found, stronger: &Found| {
                (weaker.strength > RIVAL * stronger.strength).then_some(weaker.term.kind())
            };
            match rival {
                Some(better) if better.strength > own.strength && better.f() >= LIMIT => {
                    weighed.push(Found { rival: equals(&own, &better), ..better });
                    has_changed = true;
                }
                _ if own.f() < LIMIT => {
                    self.greatest_left = self.greatest_left.max(own.f() / LIMIT);
                    has_changed = true;
                }
                _ => weighed.push(Found { rival: rival.and_then(|rival| equals(&rival, &own)), ..own }),
            }
        }
        self.found = weighed;
        has_changed
    }
}

/// Whether sizes, velocities and distances agree within a small fraction.
fn are_alike(before: &[Found], now: &[Found]) -> bool {
    let is_near = |a: f64, b: f64, of: f64| (a - b).abs() <= ALIKE * of;
    let is_one = |(before, now): (&Found, &Found)| {
        let size = now.sizes[0].hypot(now.sizes[1]);
        let scale = |one: &Found| one.term.scale().unwrap_or(1.0);
        before.sizes.iter().zip(now.sizes).all(|(was, is)| is_near(*was, is, size))
            && is_near(scale(before), scale(now), scale(now))
            && std::mem::discriminant(&before.term) == std::mem::discriminant(&now.term)
    };
    before.len() == now.len() && before.iter().zip(now).all(is_one)
}
