//! Pages, figures and JUnit files: the work of `inerter compare`, `plot`, `report` and `reproduce-paper`, whose
//! arguments are beside this module, and of some options of other commands. All of it is behind the feature `reports`.

mod compare;
mod junit;
mod page;
mod paper;
mod plot;

pub use compare::run as compare;
pub use junit::junit;
pub use page::run as report;
pub use paper::run as reproduce_paper;
pub use plot::run as plot;

use inerter_data::selftest::SelfTest;

use crate::Error;

/// The page of a self-test.
pub fn selftest_page(test: &SelfTest) -> Result<String, Error> {
    Ok(inerter_view::selftest::html(test))
}
