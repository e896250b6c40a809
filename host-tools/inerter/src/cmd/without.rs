//! Stands in for `reports` and `tables` if they are not built in: the error names the missing feature.

use inerter_core::Machine;
use inerter_data::{limits::Judged, selftest::SelfTest};

use crate::{Error, feature::Feature};

/// Value parsers for arguments: here they accept any text, since the command is refused.
pub mod values {
    pub type Day = String;
    pub type Shard = String;
}

fn lacks<T>(feature: Feature, needed_by: &'static str) -> Result<T, Error> {
    Err(Error::BuiltWithout { feature: feature.name(), needed_by, instead: String::new() })
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
    compare: Reports, "`inerter compare`";
    plot: Reports, "`inerter plot`";
    report: Reports, "`inerter report`";
    reproduce_paper: Reports, "`inerter reproduce-paper`";
    store: Tables, "`inerter store`";
}

pub fn selftest_page(_: &SelfTest) -> Result<String, Error> {
    lacks(Feature::Reports, "the page of `inerter selftest`")
}

pub fn junit<'a>(_: impl Iterator<Item = (&'a str, Machine, &'a [Judged])>) -> Result<String, Error> {
    lacks(Feature::Reports, "--junit")
}

pub fn replay<Args, Settings>(_: &str, _: &Args, _: &Settings, _: bool) -> Result<(), Error> {
    lacks(Feature::Tables, "`inerter replay --store`")
}
