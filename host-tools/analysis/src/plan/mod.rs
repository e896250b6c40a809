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
mod predict;
mod report;
mod search;
mod speeds;
mod words;

pub use advice::{Advice, advice};
pub use asked::Asked;
pub use design::{Plan, Sketch, design};
pub use error::PlanError;
pub use expected::Expected;
pub use limits::Limits;
pub use observed::{Reach, observed};
pub use part::{Part, duration_s};
pub use peaks::Peaks;
pub use predict::{Predicted, Prediction, predict};
pub use words::part_text;

#[cfg(test)]
#[path = "plan_tests.rs"]
mod tests;
