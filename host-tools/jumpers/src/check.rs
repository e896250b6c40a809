//! Results of the test.

use crate::board::JumperError;

/// Result of a part of the test, or why the test ends: it could not be done, or (`None`) a check in the report failed.
pub(crate) type Judged<T> = Result<T, Option<JumperError>>;

/// One property of the board.
#[derive(Clone, Debug, PartialEq)]
pub struct Check {
    /// Its name, in few words.
    pub name: &'static str,
    /// What a good board shows.
    pub expected: String,
    /// What this one showed.
    pub found: String,
    /// What is wrong, and what to do; `None` if the check passed.
    pub cause: Option<String>,
}

impl Check {
    /// A check that passed if `cause` is `None`.
    pub fn new(
        name: &'static str,
        expected: impl Into<String>,
        found: impl Into<String>,
        cause: Option<impl Into<String>>,
    ) -> Self {
        Self { name, expected: expected.into(), found: found.into(), cause: cause.map(Into::into) }
    }

    /// Whether it passed.
    pub fn passed(&self) -> bool {
        self.cause.is_none()
    }
}

/// Values for the settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// Delay of the force relative to the position, of the board alone: an amplifier's filter adds to it \[s\].
    pub skew_s: f64,
    /// Its 95 % uncertainty \[s\].
    pub skew_u95_s: f64,
}

/// All checks, in the order in which they were made; the first one that fails ends the test.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// Each of them.
    pub checks: Vec<Check>,
    /// The measured values, if the test got that far.
    pub measured: Option<Measured>,
}

impl Report {
    /// Whether all checks were done and passed.
    pub fn passed(&self) -> bool {
        self.measured.is_some() && self.checks.iter().all(Check::passed)
    }

    /// Adds a check only if it failed, which ends the test.
    pub(crate) fn holds(&mut self, check: Check) -> Judged<()> {
        if check.passed() { Ok(()) } else { self.take(check) }
    }

    /// Adds a check; one that failed ends the test.
    pub(crate) fn take(&mut self, check: Check) -> Judged<()> {
        let passed = check.passed();
        self.checks.push(check);
        if passed { Ok(()) } else { Err(None) }
    }
}
