//! Optional features, and the error when one is missing.
//!
//! Their options and commands always exist, so that the command line, its manual and `inerter.toml` are the same in
//! every build. If a feature is missing, they are refused.

use crate::Error;

/// A feature of `Cargo.toml`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Feature {
    /// Views of a live device in other programs.
    Bridges,
    /// Pages, figures and JUnit files.
    Reports,
    /// Parquet and MATLAB files, and stores.
    Tables,
}

impl Feature {
    /// Its name in `Cargo.toml`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Bridges => "bridges",
            Self::Reports => "reports",
            Self::Tables => "tables",
        }
    }

    const fn is_built_in(self) -> bool {
        match self {
            Self::Bridges => cfg!(feature = "bridges"),
            Self::Reports => cfg!(feature = "reports"),
            Self::Tables => cfg!(feature = "tables"),
        }
    }

    /// Fails if an option is given that needs a missing feature. `others` names the alternatives.
    pub fn check(self, option: &'static str, is_given: bool, others: &'static str) -> Result<(), Error> {
        if is_given && !self.is_built_in() {
            let instead = format!("; or leave {option} out: {others}");
            return Err(Error::BuiltWithout { feature: self.name(), needed_by: option, instead });
        }
        Ok(())
    }
}
