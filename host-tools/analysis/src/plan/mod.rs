//! The most informative motion for an expected device within a rig's limits, and its predicted intervals.
//!
//! Tones and multisines are made as large as the limits allow (`candidates`) and passed through the estimator itself,
//! on the simulated expected device. Their sums of regressors add up, so the search (`search`) finds the most
//! informative combination of time shares: D-optimal, or with the narrowest wanted intervals. The intervals of the
//! whole motion are then predicted ([`predict()`]). [`Asked`] is all of this at once, for a program.
//!
//! Glossary: a *part* is one tone or multisine with its own ramps; a *motion* is a sequence of parts; a *want* is the
//! half width of a 95 % interval; a *rehearsal* is a simulated run of the motion.

mod advice;
mod asked;
mod candidates;
mod design;
mod error;
mod expected;
mod information;
mod limits;
mod observed;
mod part;
mod peaks;
mod planned;
mod predict;
mod search;
mod speeds;
mod words;

pub use advice::{Advice, advice};
pub use asked::Asked;
pub use design::{Criterion, Plan, Sketch, design, sketch};
pub use error::PlanError;
pub use expected::Expected;
pub use limits::Limits;
pub use observed::{Reach, observed, with_contact};
pub use part::{Part, duration_s, in_a_row};
pub use peaks::Peaks;
pub use planned::Planned;
pub use predict::{Predicted, Prediction, REHEARSALS, predict};
pub use words::{interval_of, limits_text, part_text, peaks_text, source_words};

#[cfg(test)]
#[path = "plan_tests.rs"]
mod tests;
