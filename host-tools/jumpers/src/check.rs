//! Results of the test.

/// One thing that was looked at.
#[derive(Clone, Debug, PartialEq)]
pub struct Check {
    /// What it is, in few words.
    pub name: &'static str,
    /// What a sound board shows.
    pub expected: String,
    /// What this one showed.
    pub found: String,
    /// What is wrong, and what to do; nothing where the check is passed.
    pub cause: Option<String>,
}

impl Check {
    /// Passed where `cause` is nothing.
    pub fn new(
        name: &'static str,
        expected: impl Into<String>,
        found: impl Into<String>,
        cause: Option<impl Into<String>>,
    ) -> Self {
        Self { name, expected: expected.into(), found: found.into(), cause: cause.map(Into::into) }
    }

    /// Whether it is passed.
    pub fn passed(&self) -> bool {
        self.cause.is_none()
    }
}

/// What can be put into the settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// Delay of the force behind the position, of the board alone: an amplifier's filter comes on top \[s\].
    pub skew_s: f64,
    /// 95 % uncertainty of it \[s\].
    pub skew_u95_s: f64,
}

/// All checks, in the order in which they were made; the first one that fails ends the test.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// Each of them.
    pub checks: Vec<Check>,
    /// What was measured, where it came to that.
    pub measured: Option<Measured>,
}

impl Report {
    /// Whether all checks were made and passed.
    pub fn passed(&self) -> bool {
        self.measured.is_some() && self.checks.iter().all(Check::passed)
    }

    /// Takes a check only where it is not passed; whether it is.
    pub(crate) fn holds(&mut self, check: Check) -> bool {
        check.passed() || self.take(check)
    }

    /// Takes a check; whether it is passed.
    pub(crate) fn take(&mut self, check: Check) -> bool {
        let passed = check.passed();
        self.checks.push(check);
        passed
    }
}
