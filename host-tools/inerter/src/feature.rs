//! Features that the program may be built without, and what it says then.
//!
//! Their options and commands are always there, so that the command line, its manual and `inerter.toml` are the same in
//! every build. Where a feature is missing they are refused.

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
    /// Its name there.
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

    /// Fails where an option is given that needs a feature which is not built in. `others` are what remains.
    pub fn check(self, option: &'static str, is_given: bool, others: &'static str) -> Result<(), Error> {
        if is_given && !self.is_built_in() {
            let instead = format!("; or leave {option} out: {others}");
            return Err(Error::BuiltWithout { feature: self.name(), needed_by: option, instead });
        }
        Ok(())
    }
}
