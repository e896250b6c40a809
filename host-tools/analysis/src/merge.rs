//! Several runs of one device together: fits the law to the total of their exact sums.
//!
//! The sums are integers, so those of a thousand runs give the same bits in any order and grouping. Other data for the
//! intervals are kept for each run, and combined in a fixed order, that of the sums. A run that is given twice counts
//! once.
//!
//! Terms:
//! - *own*: of the fit to one run alone, as the estimator has it.
//! - *alike*: of runs with nearly the same motion of the screw, so that the encoder's steps in them may be the same.
//!
//! Source: docs/THEORY.md, "Several runs together".

use std::collections::BTreeMap;

use inerter_core::{Bank, LawStatus, MoreSums, Motion, NORMAL_COVERAGE, Settings, Sums, constants::CLEAR_OF_STEPS};
use inerter_data::{
    names::parameter,
    replay::{Outcome, Replay},
    words::{amount_text, plural},
};
use miette::Diagnostic;
use serde::{Deserialize, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF};

use crate::{
    calibrate::student,
    fit::{Beside, COUNT, Directions, FitError, PRODUCTS, Products, directions, each, joined, pairs, unit_of},
    law::extent,
};

/// Header of stored sums: another version has another estimator.
const MAGIC: &[u8] = concat!("inerter sums ", env!("CARGO_PKG_VERSION"), "\n").as_bytes();
/// Settings that may differ between runs: the tare, and those of the terminal sensor.
const FREE: [&str; 3] = ["force_zero_code", "metres_per_terminal_code", "terminal_sensor"];
/// Allowed relative difference of RMS velocity and acceleration between motions that are alike.
const ALIKE: f64 = 0.01;
/// Probability below which a difference between runs is not chance.
const UNLIKELY: f64 = 1e-3;
/// The bisections leave 1e-24 of the squared range.
const BISECTIONS: u32 = 80;

/// Why runs cannot be merged.
#[derive(Clone, Debug, PartialEq, thiserror::Error, Diagnostic)]
pub enum MergeError {
    /// There are no runs.
    #[error("there is no run to merge")]
    #[diagnostic(code(inerter::merge::empty), help("give at least one run"))]
    Empty,
    /// They were measured or replayed with different settings.
    #[error("the settings of {} and {} differ: {}", runs[0], runs[1], differences(settings))]
    #[diagnostic(
        code(inerter::merge::settings),
        help("runs merge only with the same settings; if this is right for both: {}", alike(settings))
    )]
    Settings {
        /// Names of the settings that differ, and their values in two runs.
        settings: Vec<(&'static str, [f64; 2])>,
        /// Names of the runs.
        runs: [String; 2],
    },
    /// The bytes are not stored sums.
    #[error("these bytes are not sums of runs, or are of another version")]
    #[diagnostic(code(inerter::merge::bytes), help("replay the runs again with this version"))]
    Bytes,
}

/// The differences, for a person.
fn differences(settings: &[(&str, [f64; 2])]) -> String {
    let each = settings.iter().map(|(name, [one, other])| format!("{name} is {one} and {other}"));
    each.collect::<Vec<_>>().join(", ")
}

/// Advice to make them the same: a scale that is large enough for both.
fn alike(settings: &[(&str, [f64; 2])]) -> String {
    let greater = |[one, other]: [f64; 2]| if one.abs() < other.abs() { other } else { one };
    let each = settings.iter().map(|(name, values)| format!("--set {name}={}", greater(*values)));
    each.collect::<Vec<_>>().join(" ")
}

/// A parameter from one run alone.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Own {
    value: f32,
    /// Variance of errors that vary from sample to sample, and the fraction of it that is scatter; the rest comes from
    /// the encoder's steps where strokes repeat.
    square: f32,
    scatter: f32,
    /// Variance of everything in which two runs on one rig may differ: a wrong skew or stiffness affects each motion
    /// differently.
    unshared: f32,
}

/// The data of one run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Part {
    name: String,
    settings: Settings,
    /// The sums of the fast and of the slow bank.
    banks: [(Sums, MoreSums); 2],
    /// Bank of its estimate.
    bank: Bank,
    motion: Motion,
    model_u95: [f32; 4],
    /// The four parameters.
    own: [Own; 4],
    law_is_broken: bool,
}

impl Part {
    fn sums(&self, bank: Bank) -> &(Sums, MoreSums) {
        &self.banks[bank as usize]
    }

    /// Exact sums of a bank.
    fn exact(&self, bank: Bank) -> [i128; PRODUCTS] {
        let (sums, more) = self.sums(bank);
        joined(&sums.sums, &more.sums)
    }

    /// One unit of each regressor of a bank in SI.
    fn units(&self, bank: Bank) -> [f64; COUNT] {
        let (sums, more) = self.sums(bank);
        joined(&sums.units, &more.units)
    }

    /// A key unique to each run; for a run with nothing summed, its name.
    fn key(&self) -> Key {
        let is_empty = self.banks.iter().all(|(sums, _)| sums.updates == 0);
        ([self.exact(Bank::Fast), self.exact(Bank::Slow)], is_empty.then(|| self.name.clone()))
    }

    /// Whether an estimator with its settings could have produced it.
    fn is_sound(&self) -> bool {
        let Ok(unused) = Replay::new(&self.settings, 0.0) else { return false };
        [Bank::Fast, Bank::Slow].into_iter().all(|bank| {
            let ((sums, more), (fresh, more_fresh)) = (self.sums(bank), unused.sums(bank));
            (sums.bank, more.bank) == (bank, bank)
                && (sums.index, sums.updates) == (more.index, more.updates)
                && (sums.units, more.units) == (fresh.units, more_fresh.units)
        })
    }

    /// Settings that differ from another run's although they must not.
    fn differing(&self, other: &Self) -> Vec<(&'static str, [f64; 2])> {
        let both = self.settings.values().into_iter().zip(other.settings.values());
        Settings::TABLE
            .iter()
            .zip(both)
            .filter(|(info, (one, other))| one != other && !FREE.contains(&info.name))
            .map(|(info, (one, other))| (info.name, [one, other]))
            .collect()
    }
}

type Key = ([[i128; PRODUCTS]; 2], Option<String>);

/// Runs of one device, each once, and at least one.
#[derive(Clone, Debug, PartialEq)]
pub struct Runs {
    parts: BTreeMap<Key, Part>,
}

/// Several runs fitted together.
#[derive(Clone, Debug)]
pub struct Merged {
    /// The fits to all runs.
    pub fit: Directions,
    /// Bank whose sums were fitted.
    pub bank: Bank,
    /// Number of updates summed.
    pub updates: u64,
    /// Names of the runs, in alphabetical order.
    pub names: Vec<String>,
    /// By how much the runs' own values of inertance, viscous and Coulomb friction and offset differ beyond their
    /// scatter, as a standard deviation. `None` if fewer than two runs identify one.
    pub apart: [Option<f32>; 4],
    /// Which of the four differ by more than chance explains.
    pub differs: [bool; 4],
    /// Names of the runs for which the law does not hold.
    pub broken: Vec<String>,
    /// Names of the runs with nothing summed.
    pub empty: Vec<String>,
}

impl Runs {
    /// One run, from the estimator's outcome with these settings.
    pub fn of(name: &str, settings: &Settings, outcome: &Outcome) -> Self {
        let values = each(&outcome.estimate.whole_run);
        let budgets = &outcome.budgets.whole_run;
        let Beside { motion, model_u95 } = Beside::of(outcome);
        let part = Part {
            name: name.to_string(),
            settings: *settings,
            banks: [outcome.fast, outcome.slow],
            bank: outcome.estimate.bank,
            motion,
            model_u95,
            own: std::array::from_fn(|i| Own {
                value: values[i].fitted().value,
                square: budgets[i].fit_square(),
                scatter: budgets[i].standard_error().powi(2),
                unshared: (budgets[i].same_rig_u95() / NORMAL_COVERAGE).powi(2),
            }),
            law_is_broken: outcome.law.status == LawStatus::Broken,
        };
        Self { parts: BTreeMap::from([(part.key(), part)]) }
    }

    /// Combines two sets of runs.
    pub fn and(mut self, others: Self) -> Result<Self, MergeError> {
        others.parts.into_values().try_for_each(|part| self.take(part))?;
        Ok(self)
    }

    /// Adds one run.
    fn take(&mut self, part: Part) -> Result<(), MergeError> {
        if let Some((_, first)) = self.parts.first_key_value() {
            let settings = first.differing(&part);
            if !settings.is_empty() {
                return Err(MergeError::Settings { settings, runs: [first.name.clone(), part.name] });
            }
        }
        let key = part.key();
        // The result does not depend on which came first.
        if self.parts.get(&key).is_none_or(|there| stored(&part) < stored(there)) {
            self.parts.insert(key, part);
        }
        Ok(())
    }

    /// Combines all of these.
    pub fn all(runs: impl IntoIterator<Item = Self>) -> Result<Self, MergeError> {
        let mut runs = runs.into_iter();
        let first = runs.next().ok_or(MergeError::Empty)?;
        runs.try_fold(first, Self::and)
    }

    /// Names of the runs, in alphabetical order.
    pub fn names(&self) -> Vec<String> {
        self.named(|_| true)
    }

    /// Number of runs.
    pub fn count(&self) -> usize {
        self.parts.len()
    }

    /// Names of some of them, in alphabetical order.
    fn named(&self, which: impl Fn(&Part) -> bool) -> Vec<String> {
        let mut names: Vec<_> = self.parts.values().filter(|part| which(part)).map(|part| part.name.clone()).collect();
        names.sort();
        names
    }

    /// Settings of the runs; those that may differ are one run's.
    pub fn settings(&self) -> Settings {
        self.parts.values().next().map(|part| part.settings).unwrap_or_default()
    }

    /// Bytes for another program of this version.
    pub fn to_bytes(&self) -> Vec<u8> {
        [MAGIC, &stored(&self.parts.values().collect::<Vec<_>>())].concat()
    }

    /// Parses the bytes of [`to_bytes`](Self::to_bytes).
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, MergeError> {
        let body = bytes.strip_prefix(MAGIC).ok_or(MergeError::Bytes)?;
        let (parts, rest): (Vec<Part>, &[u8]) = postcard::take_from_bytes(body).map_err(|_| MergeError::Bytes)?;
        if !rest.is_empty() || parts.is_empty() || !parts.iter().all(Part::is_sound) {
            return Err(MergeError::Bytes);
        }
        let mut runs = Self { parts: BTreeMap::new() };
        parts.into_iter().try_for_each(|part| runs.take(part)).map_err(|_| MergeError::Bytes)?;
        Ok(runs)
    }

    /// The law fitted to all runs; `offset_n` is the force offset, if known.
    pub fn merged(&self, offset_n: Option<f64>) -> Result<Merged, FitError> {
        let bank = self.bank()?;
        let products = self.products(bank)?;
        let shares = self.shares(bank, &products)?;
        let spreads = self.spreads();
        let again = encoder_again(&shares);
        let model_u95 = std::array::from_fn(|i| {
            let law: f64 = shares.iter().map(|share| share.moved(i, |j| share.part.model_u95[j])).sum();
            law.hypot(between(&shares, i, &spreads)).hypot(again[i]) as f32
        });
        let settings = self.settings();
        let beside = Beside { motion: self.motion(&shares, &products), model_u95 };
        Ok(Merged {
            fit: directions(&products, &settings, &beside, offset_n)?,
            bank,
            updates: products.updates() as u64,
            names: self.names(),
            apart: spreads.map(|spread| spread.map(|spread| spread.deviation as f32)),
            differs: spreads.map(|spread| spread.is_some_and(|spread| spread.is_unlikely)),
            broken: self.named(|part| part.law_is_broken),
            empty: self.named(|part| part.sums(bank).0.updates == 0),
        })
    }

    /// The bank of all estimates; if they differ, the fast one if the encoder's steps are a small part of its
    /// acceleration, as on the device.
    fn bank(&self) -> Result<Bank, FitError> {
        // A run with nothing summed has no influence.
        let is_of_all = |bank: &Bank| {
            let mut told = self.parts.values().filter(|part| part.sums(part.bank).0.updates > 0);
            told.all(|part| part.bank == *bank)
        };
        if let Some(bank) = [Bank::Fast, Bank::Slow].into_iter().find(is_of_all) {
            return Ok(bank);
        }
        let fast = self.products(Bank::Fast)?;
        let [acceleration, _] = fast.mean_squares();
        let is_clear = acceleration > CLEAR_OF_STEPS * fast.steps_square(&self.settings());
        Ok(if is_clear { Bank::Fast } else { Bank::Slow })
    }

    /// The exact sums of all runs.
    fn products(&self, bank: Bank) -> Result<Products, FitError> {
        // A tare changes the force's unit by powers of two, so the finest unit divides each of the others.
        let units = self.parts.values().map(|part| part.units(bank));
        let of_all = |pick: fn(f64, f64) -> f64| {
            units.clone().reduce(|one, other| std::array::from_fn(|i| pick(one[i], other[i])))
        };
        // Some sums were rounded to the coarsest unit.
        let (Some(finest), Some(coarsest)) = (of_all(f64::min), of_all(f64::max)) else {
            return Err(FitError::TooShort { observations: 0.0 });
        };
        let (mut all, mut updates) = ([0_i128; PRODUCTS], 0.0);
        for part in self.parts.values() {
            let units = part.units(bank);
            let doublings: [u32; COUNT] = std::array::from_fn(|i| (units[i] / finest[i]).log2().round() as u32);
            for ((all, sum), (row, column)) in all.iter_mut().zip(part.exact(bank)).zip(pairs()) {
                // One run reaches at most 2^94.
                *all = all.wrapping_add(sum.wrapping_shl(doublings[row] + doublings[column]));
            }
            updates += f64::from(part.sums(bank).0.updates);
        }
        Ok(Products::summed(bank, [finest, coarsest], all, updates))
    }

    /// Each run's share of the total.
    fn shares(&self, bank: Bank, all: &Products) -> Result<Vec<Share<'_>>, FitError> {
        let (inverse, settings) = (all.inverse()?, self.settings());
        let mut shares = Vec::new();
        for part in self.parts.values() {
            let (sums, more) = part.sums(bank);
            if sums.updates > 0 {
                shares.push(Share::new(part, Products::of(sums, more)?, &inverse, &settings));
            }
        }
        if let [one] = shares.as_mut_slice() {
            // Exactly.
            (one.influence, one.correlation) = (identity(), identity());
        }
        Ok(shares)
    }

    /// Statistics of all motions besides the sums; for a single run its own.
    fn motion(&self, shares: &[Share], products: &Products) -> Motion {
        let total = |part: &dyn Fn(&Share) -> f64| shares.iter().map(part).sum::<f64>();
        let updates = total(&|share| share.products.updates());
        let strokes = total(&|share| share.strokes);
        let squares = [0, 1].map(|i| total(&|share| share.square(i)));
        // A run's share of the updates, of the strokes, and of the squares of acceleration and velocity.
        let of_updates = |share: &Share| share.products.updates() / updates;
        let of_strokes = |share: &Share| if strokes > 0.0 { share.strokes / strokes } else { of_updates(share) };
        let of_squares = |i: usize, share: &Share| {
            if squares[i] > 0.0 { share.square(i) / squares[i] } else { of_updates(share) }
        };
        let of_acceleration = |share: &Share| of_squares(0, share);
        let sum = |part: &dyn Fn(&Share) -> f64, own: fn(&Motion) -> f32| {
            total(&|share| part(share) * f64::from(own(&share.part.motion))) as f32
        };
        Motion {
            repeats: sum(&of_strokes, |own| own.repeats),
            apart: sum(&of_acceleration, |own| own.apart),
            frequency_squared: sum(&of_acceleration, |own| own.frequency_squared),
            low_squared: sum(&|share| of_squares(1, share), |own| own.low_squared),
            acceleration_squared: sum(&of_updates, |own| own.acceleration_squared),
            readings: match shares {
                [one] => one.part.motion.readings,
                _ => products.readings(&self.settings()) as f32,
            },
            steady: sum(&of_updates, |own| own.steady),
            reversals_again: sum(&|_| 1.0, |own| own.reversals_again),
            friction_in_curvature: [
                sum(&of_updates, |own| own.friction_in_curvature[0]),
                sum(&of_updates, |own| own.friction_in_curvature[1]),
            ],
        }
    }

    /// The spread of the runs' own values of the four parameters; `None` if fewer than two runs identify a parameter.
    fn spreads(&self) -> [Option<Spread>; 4] {
        std::array::from_fn(|i| {
            let own: Vec<_> = self
                .parts
                .values()
                .map(|part| part.own[i])
                .filter(|own| own.value.is_finite() && own.unshared.is_finite() && own.unshared > 0.0)
                .map(|own| (f64::from(own.value), f64::from(own.unshared)))
                .collect();
            Spread::of(&own)
        })
    }
}

/// One run's share.
struct Share<'a> {
    part: &'a Part,
    products: Products,
    /// How an error of each parameter in the run's own fit affects each in the fit to all: the identity for a single
    /// run.
    influence: [[f64; 4]; 4],
    /// Correlation of the errors of its own fit; the identity if unknown.
    correlation: [[f64; 4]; 4],
    /// Fraction of the scatter that the encoder's steps explain.
    steps_share: f32,
    /// Mean squares of acceleration and velocity, without the encoder's steps.
    mean_squares: [f64; 2],
    /// Number of strokes in its motion.
    strokes: f64,
}

impl<'a> Share<'a> {
    fn new(part: &'a Part, products: Products, inverse: &[[f64; 4]; 4], settings: &Settings) -> Self {
        let [acceleration, velocity] = products.mean_squares();
        let mean_squares = [(acceleration - products.steps_square(settings)).max(0.0), velocity];
        let duration_s = products.readings(settings) / (settings.sample_rate_hz * settings.oversampling);
        let strokes = duration_s * f64::from(part.motion.low_squared).sqrt() / std::f64::consts::PI;
        Self {
            part,
            influence: products.influence(inverse),
            correlation: products.correlation().unwrap_or_else(|_| identity()),
            steps_share: products.steps_share(settings),
            products,
            mean_squares,
            strokes: if strokes.is_finite() { strokes } else { 0.0 },
        }
    }

    /// Sum of the squares of acceleration or velocity.
    fn square(&self, i: usize) -> f64 {
        self.mean_squares[i] * self.products.updates()
    }

    /// Effect of its own errors, correlated as in its own fit, on a parameter of the fit to all. A parameter that the
    /// run cannot identify has no weight.
    fn moved(&self, i: usize, own: impl Fn(usize) -> f32) -> f64 {
        let errors: [f64; 4] = std::array::from_fn(|j| {
            let error = self.influence[i][j] * f64::from(own(j));
            if error.is_finite() { error } else { 0.0 }
        });
        let with = |j: usize| (0..4).map(|k| errors[k] * self.correlation[j][k]).sum::<f64>();
        (0..4).map(|j| errors[j] * with(j)).sum::<f64>().max(0.0).sqrt()
    }

    /// Effect of the encoder's steps on a parameter of the fit to all, whether or not they repeat in this run: half
    /// width.
    fn moved_by_steps(&self, i: usize) -> f64 {
        self.moved(i, |j| {
            let Own { square, scatter, .. } = self.part.own[j];
            NORMAL_COVERAGE * ((square - scatter).max(0.0) + self.steps_share * scatter).sqrt()
        })
    }

    /// Whether the motions of the screw are alike.
    fn is_alike(&self, other: &Self) -> bool {
        let near = |(a, b): (f64, f64)| (a.sqrt() - b.sqrt()).abs() <= ALIKE * a.max(b).sqrt();
        self.mean_squares.into_iter().zip(other.mean_squares).all(near)
    }
}

/// The additional effect of the encoder's steps on each parameter because runs repeat the motion of others, including
/// the steps: half widths.
fn encoder_again(shares: &[Share]) -> [f64; 4] {
    let mut ordered: Vec<(&Share, [f64; 4])> =
        shares.iter().map(|share| (share, std::array::from_fn(|i| share.moved_by_steps(i)))).collect();
    let acceleration = |share: &Share| share.mean_squares[0];
    ordered.sort_by(|(one, _), (other, _)| acceleration(one).total_cmp(&acceleration(other)));
    let mut squares = [0.0; 4];
    for (place, (share, errors)) in ordered.iter().enumerate() {
        let most = acceleration(share) / (1.0 - ALIKE).powi(2);
        let near = ordered.iter().skip(place + 1).take_while(|(other, _)| acceleration(other) <= most);
        for (_, others) in near.filter(|(other, _)| share.is_alike(other)) {
            squares.iter_mut().zip(errors.iter().zip(others)).for_each(|(sum, (one, other))| *sum += 2.0 * one * other);
        }
    }
    squares.map(f64::sqrt)
}

/// Uncertainty of a parameter due to the differences between runs: half width.
fn between(shares: &[Share], i: usize, spreads: &[Option<Spread>; 4]) -> f64 {
    let of = |j: usize| {
        let spread = spreads[j].as_ref().filter(|spread| spread.deviation > 0.0)?;
        let influences: f64 = shares.iter().map(|share| share.influence[i][j].powi(2)).sum();
        Some((student(spread.freedom) * spread.deviation).powi(2) * influences)
    };
    (0..4).filter_map(of).sum::<f64>().sqrt()
}

/// The spread of the runs' own values of one parameter.
#[derive(Clone, Copy, Debug)]
struct Spread {
    /// Standard deviation beyond their own scatter.
    deviation: f64,
    freedom: usize,
    is_unlikely: bool,
}

impl Spread {
    /// From values with their variances: Paule and Mandel, J. Res. Natl. Bur. Stand. 87 (1982) 377.
    fn of(own: &[(f64, f64)]) -> Option<Self> {
        let freedom = own.len().checked_sub(1).filter(|freedom| *freedom > 0)?;
        let statistic = |between: f64| {
            let weight = |square: f64| (square + between).recip();
            let all: f64 = own.iter().map(|(_, square)| weight(*square)).sum();
            let mean = own.iter().map(|(value, square)| value * weight(*square)).sum::<f64>() / all;
            own.iter().map(|(value, square)| weight(*square) * (value - mean).powi(2)).sum::<f64>()
        };
        let chance = ChiSquared::new(freedom as f64).ok()?.sf(statistic(0.0));
        // The statistic falls with the variance between runs, and is below its expectation if that variance is the
        // whole squared range.
        let (mut least, mut most) = (0.0, extent(own.iter().map(|(value, _)| *value)).powi(2));
        if statistic(0.0) > freedom as f64 {
            for _ in 0..BISECTIONS {
                let middle = 0.5 * (least + most);
                *(if statistic(middle) > freedom as f64 { &mut least } else { &mut most }) = middle;
            }
        } else {
            most = 0.0;
        }
        Some(Self { deviation: most.sqrt(), freedom, is_unlikely: chance < UNLIKELY })
    }
}

/// No influence between parameters: the identity.
fn identity() -> [[f64; 4]; 4] {
    std::array::from_fn(unit_of)
}

/// The stored form of a value.
fn stored(value: &impl Serialize) -> Vec<u8> {
    // Writing to memory cannot fail.
    postcard::to_extend(value, Vec::new()).unwrap_or_default()
}

impl Merged {
    /// Remarks for a person.
    pub fn remarks(&self, settings: &Settings) -> Vec<String> {
        let mut remarks = Vec::new();
        let runs = |names: &[String]| format!("{} ({})", plural(names.len() as u64, "run"), names.join(", "));
        if !self.empty.is_empty() {
            remarks.push(format!("nothing was summed in {}: too little motion", runs(&self.empty)));
        }
        if !self.broken.is_empty() {
            remarks.push(format!(
                "the law is broken in {}: find the cause with `inerter diagnose`, or leave them out",
                runs(&self.broken)
            ));
        }
        for (i, apart) in self.apart.iter().enumerate().filter(|(i, _)| self.differs[*i]) {
            let name = parameter(settings.machine, i);
            remarks.push(format!(
                "{} differs from run to run by more than its scatter, by {} {} rms: its interval is that of the mean",
                name.label,
                amount_text(f64::from(apart.unwrap_or_default()), 2),
                name.unit
            ));
        }
        remarks
    }
}

#[cfg(test)]
#[path = "merge_tests.rs"]
mod tests;
