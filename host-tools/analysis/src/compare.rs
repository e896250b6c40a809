//! Compares runs: finds the differences that exceed their intervals.
//!
//! All other runs are compared with the first. Runs on the same rig have the same errors of force gain, lead and clock:
//! these affect a difference only in proportion to it. All other components of the two intervals count as independent.
//!
//! Source: docs/THEORY.md, "Runs compared".

use inerter_core::{Budget, Machine, NORMAL_COVERAGE, Settings, Source};
use inerter_data::{
    calibration::Calibration,
    limits::{self, NAMES},
    words::interval_text,
};
use inerter_wire::{
    Hello,
    catalogue::{self, Field},
};
use miette::Diagnostic;
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};

use crate::told::{Quantity, Told};

/// Probability that a comparison without any difference reports one.
const FALSE_ALARM: f64 = 0.05;
/// Degrees of freedom above which Student's distribution is taken as normal.
const MOST_FREEDOM: f64 = 1e4;

/// Why runs cannot be compared.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error, Diagnostic)]
pub enum CompareError {
    /// There is only one run.
    #[error("a comparison needs at least two runs")]
    #[diagnostic(code(inerter::compare::one), help("give at least two; the others are compared with the first"))]
    One,
    /// They are of different machine kinds.
    #[error("{} is of a linear machine and {} of a rotary one", runs[0], runs[1])]
    #[diagnostic(
        code(inerter::compare::machine),
        help("compare runs of one kind of machine, which the setting `machine` states")
    )]
    Machine {
        /// Names of a linear and of a rotary run.
        runs: [String; 2],
    },
}

/// A run to be compared.
#[derive(Clone, Debug)]
pub struct Side {
    /// Its name.
    pub name: String,
    /// Settings that it was taken with.
    pub settings: Settings,
    /// Device that recorded it, if known.
    pub hello: Option<Hello>,
    /// The calibration of its rig, if known.
    pub calibration: Option<Calibration>,
    /// The parameters that it identifies.
    pub told: Told,
}

/// Whether a run has the same errors of force gain, lead and clock as the first one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Rig {
    /// It has.
    Same,
    /// This is assumed, because nothing contradicts it.
    Assumed,
    /// It has not, for this reason.
    Other(String),
}

impl Rig {
    /// Decided from what the runs state: another board, another calibration, or another scale of encoder or force means
    /// another rig. The force scale of a run without a device depends on its file, and proves nothing.
    pub fn of(first: &Side, other: &Side) -> Self {
        match differing(first, other) {
            Some(what) => Self::Other(format!("{what} differs")),
            None if first.hello.is_some() && other.hello.is_some() => Self::Same,
            None => Self::Assumed,
        }
    }

    /// Whether the two share a rig, as far as is known.
    pub fn is_shared(&self) -> bool {
        !matches!(self, Self::Other(_))
    }

    /// Half width of the relevant interval: for comparing runs on one rig, or the full one.
    pub fn u95(&self, budget: &Budget) -> f32 {
        if self.is_shared() { budget.same_rig_u95() } else { budget.u95() }
    }
}

/// What proves that these are not from the same rig.
fn differing(one: &Side, other: &Side) -> Option<&'static str> {
    let differs = |of: fn(&Settings) -> f64| of(&one.settings).abs() != of(&other.settings).abs();
    if differs(|settings| settings.metres_per_count) {
        return Some("the encoder's scale (metres_per_count)");
    }
    if one.calibration.as_ref().zip(other.calibration.as_ref()).is_some_and(|(one, other)| one != other) {
        return Some("the calibration");
    }
    let stated = |settings: &Settings| [settings.force_gain_u95, settings.lead_u95, settings.timebase_u95];
    if stated(&one.settings) != stated(&other.settings) {
        return Some("the stated uncertainty of the calibration (force_gain_u95, lead_u95 or timebase_u95)");
    }
    let (a, b) = (one.hello.as_ref()?, other.hello.as_ref()?);
    if a.serial != b.serial {
        return Some("the serial number of the board");
    }
    differs(|settings| settings.newtons_per_code).then_some("the force's scale (newtons_per_code)")
}

/// The verdict on a difference.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// There is a difference: chance alone is very unlikely to cause one this large.
    Differs,
    /// Chance alone could explain it.
    NotShown,
    /// One of the runs does not identify the parameter, or proves nothing about it.
    Undecided,
}

/// A parameter of a run in the comparison.
#[derive(Clone, Debug, PartialEq)]
pub struct Compared {
    /// The value, if the run identifies it.
    pub found: Option<Quantity>,
    /// Why it proves nothing, if there is a reason.
    pub doubt: Option<&'static str>,
    /// Difference from the first run; `None` for that run itself, or if one of them does not identify it.
    pub difference: Option<Difference>,
    /// The verdict on the difference; `None` for the first run.
    pub verdict: Option<Verdict>,
}

/// A run's value minus the first one's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// The difference.
    pub value: f64,
    /// Half width of its 95 % interval.
    pub u95: f64,
    /// Probability of a difference at least this large by chance.
    pub p: f64,
}

/// A parameter of all runs.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Its index in [`NAMES`].
    pub place: usize,
    /// Each run, in order.
    pub runs: Vec<Compared>,
}

impl Row {
    /// Its entry in the catalogue.
    pub fn field(&self, machine: Machine) -> &'static Field {
        limits::field(machine, NAMES[self.place])
    }

    /// The unit shown to a person, and how many of it make one SI unit.
    pub fn shown_unit(&self, machine: Machine) -> (&'static str, f64) {
        match NAMES[self.place] {
            "backlash_m" => (catalogue::unit(machine, "µm"), 1e6),
            _ => (self.field(machine).unit, 1.0),
        }
    }
}

impl Compared {
    /// For a person: value and interval of the run, with the interval that applies to this rig, in the unit of which
    /// `factor` make one in SI.
    pub fn value_text(&self, rig: &Rig, factor: f64) -> String {
        self.found.map_or("not identifiable".into(), |Quantity { value, budget }| {
            interval_text(factor * f64::from(value), factor * f64::from(rig.u95(&budget)))
        })
    }

    /// For a person: the difference in that unit, and the verdict on it; `None` for the first run.
    pub fn difference_text(&self, factor: f64) -> Option<(String, &'static str)> {
        let difference = self.difference.map_or("-".into(), |Difference { value, u95, .. }| {
            let sign = if value > 0.0 { "+" } else { "" };
            format!("{sign}{}", interval_text(factor * value, factor * u95))
        });
        let said = match self.verdict? {
            Verdict::Differs => "differs",
            Verdict::NotShown => "no difference shown",
            Verdict::Undecided => "undecided",
        };
        Some((difference, said))
    }

    /// Why there is no verdict on the difference from the first run, whose doubt is `first`.
    pub fn reason(&self, first: Option<&'static str>) -> Option<String> {
        if self.verdict != Some(Verdict::Undecided) {
            return None;
        }
        match (self.doubt, first) {
            (Some(doubt), _) => Some(doubt.into()),
            (None, Some(doubt)) => Some(format!("in the first run, {doubt}")),
            (None, None) => Some("one of the two motions cannot identify it".into()),
        }
    }
}

/// Compares runs with the first one: the parameters that at least one of them identifies. `rigs` states for each run
/// whether it shares the rig of the first.
pub fn compare(sides: &[Side], rigs: &[Rig]) -> Result<Vec<Row>, CompareError> {
    let [first, _, ..] = sides else { return Err(CompareError::One) };
    let of = |machine: Machine| sides.iter().find(|side| side.settings.machine == machine);
    if let (Some(linear), Some(rotary)) = (of(Machine::Linear), of(Machine::Rotary)) {
        return Err(CompareError::Machine { runs: [linear.name.clone(), rotary.name.clone()] });
    }
    let row = |place: usize| {
        let runs = sides.iter().zip(rigs).enumerate().map(|(number, (side, rig))| {
            let difference = first.told.found[place].zip(side.told.found[place]).filter(|_| number > 0);
            Compared {
                found: side.told.found[place],
                doubt: side.told.doubts.of(place),
                difference: difference.map(|(first, other)| Difference::of(place, &first, &other, rig)),
                verdict: None,
            }
        });
        Row { place, runs: runs.collect() }
    };
    let is_told = |row: &Row| row.runs.iter().any(|run| run.found.is_some());
    let mut rows: Vec<Row> = (0..NAMES.len()).map(row).filter(is_told).collect();
    judge(&mut rows);
    Ok(rows)
}

/// Gives each difference its verdict. The more differences are tested, the less likely by chance each must be (Holm
/// 1979), so that the probability of any false alarm is as stated.
fn judge(rows: &mut [Row]) {
    let mut proven: Vec<&mut Compared> = Vec::new();
    for row in rows {
        let Some((first, others)) = row.runs.split_first_mut() else { continue };
        for other in others {
            let is_proven = other.difference.is_some() && first.doubt.or(other.doubt).is_none();
            other.verdict = Some(if is_proven { Verdict::NotShown } else { Verdict::Undecided });
            if is_proven {
                proven.push(other);
            }
        }
    }
    let p = |compared: &Compared| compared.difference.map_or(1.0, |difference| difference.p);
    proven.sort_by(|one, other| p(one).total_cmp(&p(other)));
    let count = proven.len();
    for (number, compared) in proven.into_iter().enumerate() {
        if p(compared) > FALSE_ALARM / (count - number) as f64 {
            break;
        }
        compared.verdict = Some(Verdict::Differs);
    }
}

impl Difference {
    /// The difference between two runs, for the parameter at this index.
    fn of(place: usize, first: &Quantity, other: &Quantity, rig: &Rig) -> Self {
        let value = f64::from(other.value) - f64::from(first.value);
        let part = |of: &Quantity, source| f64::from(of.budget.given_u95(source) / NORMAL_COVERAGE);
        let squares = Source::ALL.map(|source| {
            let (one, two) = (part(first, source), part(other, source));
            let is_shared = rig.is_shared() && source.is_shared();
            match (NAMES[place], source) {
                // Proportional to something positive in both runs: inertance with structure, stiffness, damping.
                ("inertance_kg", _) | ("stiffness_n_per_m" | "contact_damping_n_s_per_m", Source::Gain)
                    if is_shared =>
                {
                    (two - one).powi(2)
                }
                // Proportional to the value, with its sign.
                ("viscous_n_s_per_m" | "coulomb_n" | "offset_n", _) if is_shared => {
                    (two.copysign(other.value.into()) - one.copysign(first.value.into())).powi(2)
                }
                // Dependent on the motion, or on how it was measured.
                _ => one.powi(2) + two.powi(2),
            }
        });
        let square: f64 = squares.iter().sum();
        let unknown = Self { value, u95: f64::INFINITY, p: 1.0 };
        if !(square.is_finite() && value.is_finite()) {
            return unknown;
        }
        // Welch and Satterthwaite: only scatter has degrees of freedom.
        let scatters = [first, other]
            .map(|of| f64::from(of.budget.standard_error()).powi(4) / f64::from(of.budget.scatter_freedom()));
        let freedom = (square.powi(2) / scatters.iter().sum::<f64>()).clamp(1.0, MOST_FREEDOM);
        // NaN if nothing is uncertain.
        let freedom = if freedom.is_finite() { freedom } else { MOST_FREEDOM };
        let standard = square.sqrt();
        let Ok(student) = StudentsT::new(0.0, 1.0, freedom) else { return unknown };
        let p = if value == 0.0 { 1.0 } else { 2.0 * student.sf(value.abs() / standard) };
        Self { value, u95: student.inverse_cdf(0.975) * standard, p }
    }
}

#[cfg(test)]
#[path = "compare_tests.rs"]
mod tests;
