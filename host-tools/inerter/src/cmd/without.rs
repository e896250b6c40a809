//! Stands in for `reports` and `tables` if they are not built in: the error names the missing feature.

use inerter_core::Machine;
use inerter_data::{limits::Judged, selftest::SelfTest};

use crate::{Error, error::Failure, feature::Feature};

/// Value parsers for arguments: here they accept any text, since the command is refused.
pub mod values {
    pub type Day = String;
    pub type Shard = String;
}

fn lacks<T>(feature: Feature, needed_by: &'static str) -> Result<T, Error> {
    Err(Failure::BuiltWithout { feature: feature.name, needed_by, instead: String::new() }.into())
}

/// Commands that are refused.
macro_rules! commands {
    ($($run:ident: $feature:ident, $needed_by:literal;)*) => {$(
        pub fn $run<Args>(_: &Args) -> Result<(), Error> {
            lacks(Feature::$feature, $needed_by)
        }
    )*};
}

commands! {
    compare: REPORTS, "`inerter compare`";
    plot: REPORTS, "`inerter plot`";
    report: REPORTS, "`inerter report`";
    reproduce_paper: REPORTS, "`inerter reproduce-paper`";
    store: TABLES, "`inerter store`";
}

pub fn selftest_page(_: &SelfTest) -> Result<String, Error> {
    lacks(Feature::REPORTS, "the page of `inerter selftest`")
}

pub fn junit<'a>(_: impl Iterator<Item = (&'a str, Machine, &'a [Judged])>) -> Result<String, Error> {
    lacks(Feature::REPORTS, "--junit")
}

pub fn replay<Args, Settings>(_: &str, _: &Args, _: &Settings, _: bool) -> Result<(), Error> {
    lacks(Feature::TABLES, "`inerter replay --store`")
}
