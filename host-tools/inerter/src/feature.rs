//! Optional features, and the error when one is missing.
//!
//! Their options and commands always exist, so that the command line, its manual and `inerter.toml` are the same in
//! every build. If a feature is missing, they are refused.

use crate::{Error, error::Failure};

/// A feature of `Cargo.toml`.
pub struct Feature {
    /// Its name there.
    pub name: &'static str,
    is_built_in: bool,
}

impl Feature {
    /// Views of a live device in other programs.
    pub const BRIDGES: Self = Self { name: "bridges", is_built_in: cfg!(feature = "bridges") };
    /// Pages, figures and JUnit files.
    pub const REPORTS: Self = Self { name: "reports", is_built_in: cfg!(feature = "reports") };
    /// Parquet and MATLAB files, and stores.
    pub const TABLES: Self = Self { name: "tables", is_built_in: cfg!(feature = "tables") };

    /// Fails if an option is given that needs a missing feature. `others` names the alternatives.
    pub fn check(self, option: &'static str, is_given: bool, others: &'static str) -> Result<(), Error> {
        if is_given && !self.is_built_in {
            let instead = format!("; or leave {option} out: {others}");
            return Err(Failure::BuiltWithout { feature: self.name, needed_by: option, instead }.into());
        }
        Ok(())
    }
}
