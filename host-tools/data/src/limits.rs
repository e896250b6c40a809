//! Limits of a device, and the verdicts of a measurement on them by ISO 14253-1: the whole interval decides, not the
//! value alone.
//!
//! A parameter passes if its 95 % interval lies within the limits, and fails if it lies beyond one. Otherwise it is
//! undecided: a narrower interval would decide.

use std::{
    fmt, io,
    ops::Range,
    path::{Path, PathBuf},
};

use inerter_core::{LawStatus, Machine};
use inerter_wire::catalogue::{self, Field, Group};
use miette::Diagnostic;
use serde::Serialize;
use toml::de::{DeTable, DeValue};

use crate::{
    settings::{line_of, text_of, written},
    words::{amount_text, interval_text, no_parameter},
};

/// The parameters that can be limited, named as for a linear machine.
pub const NAMES: [&str; 7] = [
    "inertance_kg",
    "viscous_n_s_per_m",
    "coulomb_n",
    "offset_n",
    "backlash_m",
    "stiffness_n_per_m",
    "contact_damping_n_s_per_m",
];

/// Why limits cannot be used.
#[derive(Debug, thiserror::Error, Diagnostic)]
#[allow(missing_docs, reason = "the messages say what the fields are")]
pub enum LimitsError {
    /// The file cannot be read.
    #[error("the limits file {path} cannot be read: {source}", path = path.display())]
    #[diagnostic(
        code(inerter::limits::file),
        help("check the name; the file is TOML such as `[coulomb_n]` and below it `max = 60`")
    )]
    File { path: PathBuf, source: io::Error },
    /// Its content is invalid.
    #[error("the limits file {path}, line {line}: {problem}", path = path.display())]
    #[diagnostic(code(inerter::limits::form), help("{help}"))]
    Form { path: PathBuf, line: usize, problem: String, help: String },
}

/// Limits of one parameter, in its own unit; at least one is set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limit {
    /// Index into [`NAMES`].
    pub place: usize,
    /// Least value that passes.
    pub min: Option<f64>,
    /// Greatest value that passes.
    pub max: Option<f64>,
}

/// The limits of a kind of device.
#[derive(Clone, Debug, PartialEq)]
pub struct Limits {
    /// The file that they come from.
    pub path: PathBuf,
    /// Each parameter once, in the alphabetical order of their names.
    pub all: Vec<Limit>,
}

/// The verdict on a limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// The interval lies within the limits.
    Pass,
    /// It extends beyond a limit, or is unknown.
    Undecided,
    /// It lies beyond them.
    Fail,
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Pass => "pass",
            Self::Undecided => "undecided",
            Self::Fail => "FAIL",
        })
    }
}

/// A measured parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// Value, and half width of its 95 % interval; `None` if the motion cannot identify it.
    pub found: Option<(f32, f32)>,
    /// Why the measurement proves nothing, whatever its value.
    pub doubt: Option<&'static str>,
}

/// Why the parameters of a run prove nothing, if there is a reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Doubts {
    of_run: Option<&'static str>,
    of_law: Option<&'static str>,
    is_broken: bool,
}

impl Doubts {
    /// The parameters of the law come first in [`NAMES`]; this is how many there are.
    const OF_LAW: usize = 4;

    /// The doubts about a run: whether the device `changed`, whether samples `are_wrong`, and the state of the law;
    /// `is_beyond` means that the residual exceeds what noise and steps explain.
    pub fn new(changed: bool, are_wrong: bool, law: LawStatus, is_beyond: bool) -> Self {
        let wrong = are_wrong.then_some("samples are wrong (see the warnings)");
        let of_run = if changed { Some("the device changed during the run") } else { wrong };
        // Where the flanks may part, the law is not called broken, but no interval covers the error that this causes.
        let of_law = match law {
            LawStatus::Broken => Some("the law is broken"),
            _ if is_beyond => Some("the residual of the law is more than noise and steps explain"),
            _ => None,
        };
        Self { of_run, of_law, is_broken: law == LawStatus::Broken }
    }

    /// Doubts about a whole run, for this reason.
    pub const fn because(of_run: &'static str) -> Self {
        Self { of_run: Some(of_run), of_law: None, is_broken: false }
    }

    /// Why nothing is proven about the parameter at this index of [`NAMES`].
    pub fn of(&self, place: usize) -> Option<&'static str> {
        self.of_run.or(self.of_law.filter(|_| place < Self::OF_LAW || self.is_broken))
    }
}

/// A limited parameter with its verdict.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Judged {
    /// Its name, for a linear machine.
    pub parameter: &'static str,
    /// Least value that passes.
    pub min: Option<f64>,
    /// Greatest value that passes.
    pub max: Option<f64>,
    /// The measured value; `None` if the motion cannot identify it.
    pub value: Option<f32>,
    /// Half width of the 95 % interval.
    pub u95: Option<f32>,
    /// The verdict.
    pub verdict: Verdict,
    /// Half width below which the limit would be decided; `None` if a narrower interval does not help.
    pub needed_u95: Option<f32>,
    /// Why it is undecided.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<&'static str>,
}

impl Limits {
    /// Reads a file with a table for each parameter, by its name on this machine: `min`, `max` or both.
    pub fn read(path: &Path, machine: Machine) -> Result<Self, LimitsError> {
        let text = text_of(path).map_err(|source| LimitsError::File { path: path.into(), source })?;
        let form = |at: Option<Range<usize>>, problem: String, help: &str| LimitsError::Form {
            path: path.into(),
            line: line_of(&text, at),
            problem,
            help: help.into(),
        };
        let example = "write a table for each parameter: `[coulomb_n]`, and below it `max = 60`";
        let table = DeTable::parse(&text).map_err(|error| form(error.span(), error.message().into(), example))?;
        let known: Vec<&str> = NAMES.iter().map(|name| field(machine, name).path).collect();
        let mut all = Vec::new();
        for (key, value) in table.get_ref().iter() {
            let name: &str = key.get_ref();
            let wrong = |problem, help: &str| form(Some(key.span()), problem, help);
            let place = known.iter().position(|known| *known == name).ok_or_else(|| {
                wrong(no_parameter(name, known.iter().copied()), &format!("these can be limited: {}", known.join(", ")))
            })?;
            let DeValue::Table(bounds) = value.get_ref() else {
                return Err(wrong(format!("`{name}` is not a table"), example));
            };
            let (mut min, mut max) = (None, None);
            for (key, value) in bounds.iter() {
                let (bound, at): (&str, _) = (key.get_ref(), Some(key.span()));
                let slot = match bound {
                    "min" => &mut min,
                    "max" => &mut max,
                    _ => return Err(form(at, format!("`{name}` has `min` and `max`, not `{bound}`"), example)),
                };
                let (shown, number) = written(&text, value);
                *slot = Some(number.filter(|number| number.is_finite()).ok_or_else(|| {
                    form(
                        at,
                        format!("{name}, {bound}: `{shown}` is not a number"),
                        "write one with a point: 0.002 or 2e-3",
                    )
                })?);
            }
            match (min, max) {
                (None, None) => return Err(wrong(format!("`{name}` has neither `min` nor `max`"), example)),
                (Some(min), Some(max)) if min > max => {
                    return Err(wrong(format!("{name}: min {min} is above max {max}"), "swap them"));
                }
                _ => all.push(Limit { place, min, max }),
            }
        }
        if all.is_empty() {
            return Err(form(None, "it sets no limit".into(), example));
        }
        Ok(Self { path: path.into(), all })
    }

    /// The verdict on each parameter; `measured` returns the one at an index of [`NAMES`].
    pub fn judge(&self, measured: impl Fn(usize) -> Measured) -> Vec<Judged> {
        self.all.iter().map(|limit| limit.judge(&measured(limit.place))).collect()
    }
}

/// The catalogue entry of a parameter of [`NAMES`] on this machine.
pub fn field(machine: Machine, name: &str) -> &'static Field {
    let groups = [Group::Parameter, Group::Detail];
    groups.into_iter().find_map(|group| catalogue::find(machine, group, name)).unwrap_or(&catalogue::FIELDS[0])
}

/// Rounded to two digits, never upwards.
fn rounded_down(amount: f64) -> String {
    let digit = 10_f64.powf(amount.log10().floor() - 1.0);
    // A value of two digits stays as it is.
    amount_text((amount / digit * (1.0 + 1e-6)).floor() * digit, 2)
}

/// The worst verdict of all.
pub fn verdict(all: &[Judged]) -> Verdict {
    all.iter().map(|judged| judged.verdict).max().unwrap_or(Verdict::Pass)
}

impl Limit {
    fn judge(&self, measured: &Measured) -> Judged {
        let Self { place, min, max } = *self;
        let parameter = NAMES.get(place).copied().unwrap_or_default();
        let found = measured.found.filter(|(value, u95)| value.is_finite() && u95.is_finite());
        let undecided = |reason, needed_u95| (Verdict::Undecided, Some(reason), needed_u95);
        let (verdict, reason, needed_u95) = match (found, measured.doubt) {
            (None, _) => undecided("the motion cannot identify it", None),
            (_, Some(doubt)) => undecided(doubt, None),
            (Some((value, u95)), None) => {
                let (value, u95) = (f64::from(value), f64::from(u95));
                let (above, below) = (min.map(|min| value - min), max.map(|max| max - value));
                let both = || [above, below].into_iter().flatten();
                if both().all(|room| room >= u95) {
                    (Verdict::Pass, None, None)
                } else if both().any(|room| room < -u95) {
                    (Verdict::Fail, None, None)
                } else {
                    let needed = both().map(f64::abs).fold(f64::INFINITY, f64::min);
                    undecided("the interval extends beyond a limit", Some(needed as f32).filter(|needed| *needed > 0.0))
                }
            }
        };
        let (value, u95) = found.unzip();
        Judged { parameter, min, max, value, u95, verdict, needed_u95, reason }
    }
}

impl Judged {
    /// Its name on this machine.
    pub fn name(&self, machine: Machine) -> &'static str {
        field(machine, self.parameter).path
    }

    /// What would decide it, in the form of `inerter plan --want`; `None` if a narrower interval does not help, or no
    /// motion can be planned for it.
    pub fn want(&self, machine: Machine) -> Option<String> {
        let Field { group, symbol, unit, .. } = field(machine, self.parameter);
        let u95 = self.needed_u95.filter(|_| *group == Group::Parameter)?;
        Some(format!("{symbol} to {} {unit}", rounded_down(u95.into())))
    }

    /// For a person: the value, its limits, and why it is undecided.
    pub fn words(&self, machine: Machine) -> String {
        let Field { label, unit, .. } = field(machine, self.parameter);
        let found = match (self.value, self.u95) {
            (Some(value), Some(u95)) => format!("{} {unit}", interval_text(value.into(), u95.into())),
            _ => "not identifiable".into(),
        };
        let limits = match (self.min, self.max) {
            (Some(min), Some(max)) => format!("{min} to {max}"),
            (Some(min), None) => format!("at least {min}"),
            (None, max) => format!("at most {}", max.map(|max| max.to_string()).unwrap_or_default()),
        };
        let reason = self.reason.map(|reason| format!(": {reason}")).unwrap_or_default();
        let needed =
            self.needed_u95.map(|u95| format!("; an interval under {} {unit} would decide", rounded_down(u95.into())));
        format!("{label}: {found}, wanted {limits} {unit}{reason}{}", needed.unwrap_or_default())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str, machine: Machine) -> Result<Limits, LimitsError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        Limits::read(file.path(), machine)
    }

    #[test]
    fn limits_are_read_by_the_names_of_the_machine() {
        let limits = read("[coulomb_n]\nmax = 6_0\n[inertance_kg]\nmin = 2.9e2\nmax = 310\n", Machine::Linear).unwrap();
        let all =
            [Limit { place: 0, min: Some(290.0), max: Some(310.0) }, Limit { place: 2, min: None, max: Some(60.0) }];
        assert!(limits.all.len() == 2 && all.iter().all(|limit| limits.all.contains(limit)), "{limits:?}");
        let rotary = "[inertia_kg_m2]\nmin = 1\n[contact_damping_n_m_s]\nmax = 2\n";
        let rotary = read(rotary, Machine::Rotary).unwrap();
        assert_eq!(rotary.all.iter().map(|limit| limit.place).max(), Some(6));
    }

    #[test]
    fn what_is_wrong_with_limits_is_named_with_its_line() {
        for (text, line, words) in [
            ("", 1, "it sets no limit"),
            (
                "[coulomb_n]\nmax = 60\n[coulomb]\nmin = 1\n",
                3,
                "no parameter is called `coulomb`; did you mean `coulomb_n`?",
            ),
            ("[coulomb_n]\nmost = 60\n", 2, "not `most`"),
            ("[coulomb_n]\nmax = \"60\"\n", 2, "`\"60\"` is not a number"),
            ("[coulomb_n]\nmax = nan\n", 2, "`nan` is not a number"),
            ("[coulomb_n]\n", 1, "neither `min` nor `max`"),
            ("[coulomb_n]\nmin = 2\nmax = 1\n", 1, "min 2 is above max 1"),
            ("coulomb_n = 60\n", 1, "`coulomb_n` is not a table"),
            ("[inertia_kg_m2]\nmin = 1\n", 1, "no parameter is called `inertia_kg_m2`"),
            ("[coulomb_n\n", 1, ""),
        ] {
            let error = read(text, Machine::Linear).unwrap_err();
            let told = error.to_string();
            assert!(told.contains(&format!("line {line}: ")) && told.contains(words), "{text:?}: {told}");
            assert!(error.help().is_some_and(|help| !help.to_string().is_empty()));
        }
        assert!(matches!(Limits::read(Path::new("/nothing"), Machine::Linear), Err(LimitsError::File { .. })));
    }

    #[test]
    fn the_interval_decides_and_not_the_value() {
        let limits = [(Some(290.0), Some(310.0)), (None, Some(310.0)), (Some(290.0), None)];
        let judged = |(min, max), found, doubt| Limit { place: 0, min, max }.judge(&Measured { found, doubt });
        for limit in limits {
            assert_eq!(judged(limit, Some((300.0, 10.0)), None).verdict, Verdict::Pass);
            assert_eq!(judged(limit, None, None).verdict, Verdict::Undecided);
            assert_eq!(judged(limit, Some((300.0, f32::INFINITY)), None).verdict, Verdict::Undecided);
            let doubted = judged(limit, Some((300.0, 1.0)), Some("the law is broken"));
            assert_eq!((doubted.verdict, doubted.reason), (Verdict::Undecided, Some("the law is broken")));
        }
        let [both, ..] = limits;
        for (value, u95, verdict, needed) in [
            (309.0, 2.0, Verdict::Undecided, Some(1.0)),
            (311.0, 2.0, Verdict::Undecided, Some(1.0)),
            (313.0, 2.0, Verdict::Fail, None),
            (287.0, 2.0, Verdict::Fail, None),
            (310.0, 2.0, Verdict::Undecided, None),
            (310.0, 0.0, Verdict::Pass, None),
            (300.0, 40.0, Verdict::Undecided, Some(10.0)),
        ] {
            let judged = judged(both, Some((value, u95)), None);
            assert_eq!((judged.verdict, judged.needed_u95), (verdict, needed), "{value} {u95}");
        }
    }

    #[test]
    fn words_have_values_with_their_digits_and_what_would_decide() {
        let judged = |found| Limit { place: 2, min: None, max: Some(55.0) }.judge(&Measured { found, doubt: None });
        for (found, words) in [
            (Some((50.0, 0.3)), "Coulomb friction: 50.00 ± 0.30 N, wanted at most 55 N"),
            (
                Some((54.8, 0.3)),
                "Coulomb friction: 54.80 ± 0.30 N, wanted at most 55 N: the interval extends beyond a limit; an interval under 0.20 N would decide",
            ),
            (
                Some((54.9004, 0.3)),
                "Coulomb friction: 54.90 ± 0.30 N, wanted at most 55 N: the interval extends beyond a limit; an interval under 0.099 N would decide",
            ),
            (Some((60.0, 0.3)), "Coulomb friction: 60.00 ± 0.30 N, wanted at most 55 N"),
            (None, "Coulomb friction: not identifiable, wanted at most 55 N: the motion cannot identify it"),
        ] {
            assert_eq!(judged(found).words(Machine::Linear), words);
        }
        assert_eq!(verdict(&[judged(Some((50.0, 0.3))), judged(None)]), Verdict::Undecided);
        assert_eq!(verdict(&[judged(Some((60.0, 0.3))), judged(None)]), Verdict::Fail);
        assert_eq!(verdict(&[judged(Some((50.0, 0.3)))]), Verdict::Pass);
    }
}
