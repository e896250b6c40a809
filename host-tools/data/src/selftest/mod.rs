//! The self-test of a board: expectations, findings and verdicts.
//!
//! - *check*: one property of the board, with the range it must lie in.
//! - *verdict*: [`Verdict::Pass`], [`Verdict::Fail`] with the likely cause, or [`Verdict::Skipped`] with the reason.
//!
//! [`judge`] judges raw figures and samples, without a device. A device may report any number: a missing or implausible
//! one fails, and never passes.

pub mod judge;

use std::borrow::Cow;

use inerter_core::Machine;
use inerter_wire::{
    Figure, Hello, Measured,
    catalogue::{Field, Group, fields},
};
use serde::Serialize;
use serde_json::{Value, json};

use crate::words::three_digits;

/// The result of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// As expected.
    Pass,
    /// Not as expected.
    Fail,
    /// Not checked.
    Skipped,
}

impl Verdict {
    /// The verdict for a person.
    pub fn word(self) -> &'static str {
        match self {
            Self::Pass => "pass",
            Self::Fail => "FAIL",
            Self::Skipped => "skipped",
        }
    }
}

/// Checks whose failure explains that of others, the strongest first. If the check at the end of a row failed too, the
/// row explains nothing: lost frames may have carried the samples.
const EXPLAINED: [(&str, &[&str], Option<&str>); 2] =
    [("sampling", &["samples_lost", "overruns"], None), ("overruns", &["samples_lost"], Some("frames_lost"))];

/// One property of the board.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Check {
    /// Name for programs; never changes.
    pub name: Cow<'static, str>,
    /// Name for a person.
    pub label: &'static str,
    /// What was expected.
    pub expected: String,
    /// What was found; `None` if it was not checked.
    pub found: Option<String>,
    /// Unit of both; empty for text.
    pub unit: &'static str,
    /// The verdict.
    pub verdict: Verdict,
    /// The likely cause of a failure, or why it was skipped.
    pub reason: Option<String>,
}

impl Check {
    /// A check that a number lies in a range; a number that is not finite fails.
    pub fn range<S: Into<String>>(
        name: impl Into<Cow<'static, str>>,
        label: &'static str,
        unit: &'static str,
        range: std::ops::RangeInclusive<f64>,
        found: Option<f64>,
        cause: impl FnOnce(f64) -> S,
    ) -> Self {
        let expected = match (*range.start(), *range.end()) {
            (least, most) if least == most => three_digits(least),
            (f64::NEG_INFINITY, most) => format!("at most {}", three_digits(most)),
            (least, f64::INFINITY) => format!("at least {}", three_digits(least)),
            (least, most) => format!("{} to {}", three_digits(least), three_digits(most)),
        };
        let found = found.filter(|value| value.is_finite());
        let cause = match found {
            Some(value) => (!range.contains(&value)).then(|| cause(value).into()),
            None => Some("the board did not report it".to_owned()),
        };
        Self { found: found.map(three_digits), unit, ..Self::words(name, label, expected, "", cause) }
    }

    /// A check of a text.
    pub fn words(
        name: impl Into<Cow<'static, str>>,
        label: &'static str,
        expected: impl Into<String>,
        found: impl Into<String>,
        cause: Option<impl Into<String>>,
    ) -> Self {
        let verdict = if cause.is_some() { Verdict::Fail } else { Verdict::Pass };
        let (expected, found) = (expected.into(), Some(found.into()));
        Self { name: name.into(), label, expected, found, unit: "", verdict, reason: cause.map(Into::into) }
    }

    /// A check that was skipped.
    pub fn skipped(name: impl Into<Cow<'static, str>>, label: &'static str, reason: impl Into<String>) -> Self {
        Self { found: None, verdict: Verdict::Skipped, ..Self::words(name, label, "", "", Some(reason)) }
    }

    /// One line for a person.
    pub fn line(&self) -> String {
        let verdict = self.verdict.word();
        let unit = if self.unit.is_empty() { String::new() } else { format!(" {}", self.unit) };
        let reason = self.reason.as_ref().map(|reason| format!("; {reason}")).unwrap_or_default();
        match &self.found {
            Some(found) => format!("{verdict:<7} {}: {found}{unit} ({}{unit}){reason}", self.label, self.expected),
            None => format!("{verdict:<7} {}{reason}", self.label),
        }
    }
}

/// Delay of the force relative to the position, of the board alone: an amplifier or a filter adds to it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Skew {
    /// The delay (s).
    pub skew_s: f64,
    /// Its 95 % uncertainty (s).
    pub skew_u95_s: f64,
}

/// A self-test with all its results.
#[derive(Clone, Debug, PartialEq)]
pub struct SelfTest {
    /// The device tested.
    pub hello: Hello,
    /// Port or address.
    pub port: String,
    /// Start time, host time in nanoseconds since 1970.
    pub begun_ns: u64,
    /// The checks, in order.
    pub checks: Vec<Check>,
    /// Everything that the board measured of itself, in order.
    pub measured: Vec<Measured>,
    /// What the jumpers showed, if they were tested and passed.
    pub skew: Option<Skew>,
}

impl SelfTest {
    /// How many checks have this verdict.
    pub fn count(&self, verdict: Verdict) -> usize {
        self.labels(verdict).count()
    }

    /// Labels of the failed checks; one that explains others comes first.
    pub fn failed(&self) -> Vec<&'static str> {
        let cause = self.cause().map(|check| check.label);
        let others = self.labels(Verdict::Fail).filter(|label| Some(*label) != cause);
        cause.into_iter().chain(others).collect()
    }

    /// The failed check that explains others that failed, if there is one.
    fn cause(&self) -> Option<&Check> {
        let failed = |name: &str| self.checks.iter().find(|check| check.name == name && check.verdict == Verdict::Fail);
        EXPLAINED.iter().find_map(|(cause, symptoms, unless)| {
            let explains = symptoms.iter().any(|symptom| failed(symptom).is_some());
            failed(cause).filter(|_| explains && unless.is_none_or(|unless| failed(unless).is_none()))
        })
    }

    /// Labels of the checks that have this verdict.
    fn labels(&self, verdict: Verdict) -> impl Iterator<Item = &'static str> {
        self.checks.iter().filter(move |check| check.verdict == verdict).map(|check| check.label)
    }

    /// The counts in one line, with the labels of what was skipped, because nothing is known about it, and the likely
    /// cause of what failed together.
    pub fn summary(&self) -> String {
        let [passed, failed] = [Verdict::Pass, Verdict::Fail].map(|verdict| self.count(verdict));
        let skipped: Vec<_> = self.labels(Verdict::Skipped).collect();
        let names = if skipped.is_empty() { String::new() } else { format!(" ({})", skipped.join(", ")) };
        let cause = self.cause().and_then(|check| check.reason.as_ref());
        let cause = cause.map(|reason| format!("; likely cause: {reason}")).unwrap_or_default();
        format!("{passed} passed, {failed} failed, {} skipped{names}{cause}", skipped.len())
    }

    /// The raw figures with their fields; for a quantity that this program does not know, its number.
    pub fn figures(&self) -> impl Iterator<Item = (Result<&'static Field, u8>, u32)> {
        self.measured.iter().flat_map(|measured| &measured.figures).map(|Figure { quantity, value }| {
            let field = fields(Machine::Linear, Group::Measured).nth(usize::from(*quantity));
            (field.ok_or(*quantity), *value)
        })
    }

    /// The whole self-test for programs: `docs/CLI.md`.
    pub fn json(&self) -> Value {
        let Hello { wire_version, firmware, git, board, serial, clock, .. } = &self.hello;
        let figures: Vec<Value> = self
            .figures()
            .map(|(field, value)| match field {
                Ok(field) => json!({ "quantity": field.path, "value": value, "unit": field.unit }),
                Err(number) => json!({ "quantity": number, "value": value, "unit": "" }),
            })
            .collect();
        json!({
            "kind": "selftest", "board": board.as_str(), "serial": serial.as_str(), "firmware": firmware.as_str(),
            "git": git.as_str(), "wire_version": wire_version, "clock": format!("{clock:?}").to_lowercase(),
            "port": self.port, "begun_ns": self.begun_ns, "program": concat!("inerter ", env!("CARGO_PKG_VERSION")),
            "passed": self.count(Verdict::Pass), "failed": self.count(Verdict::Fail),
            "skipped": self.count(Verdict::Skipped), "checks": self.checks, "figures": figures,
            "skew": self.skew,
        })
    }
}

#[cfg(test)]
mod tests;
