//! Analysis of runs of an instrumented inerter.
//!
//! [`fit`] refits the sums of the estimator: friction by direction; [`merge`] does so for several runs together.
//! [`contact`] derives stiffness and damping from a terminal displacement sensor. [`mod@identify`] fits the complete
//! model, [`response`] measures F/x over frequency, [`law`] is the law of the estimator with its kernels, [`rows`]
//! lists the law and the force row by row, [`mod@compare`] compares runs, [`paper`] identifies the paper's device from
//! its three tests. [`mod@diagnose`] identifies what violates the law, [`mod@skew`] finds the delay of the force,
//! [`plan`] designs a motion and predicts its intervals. [`calibrate`] turns samples at known loads, displacements and
//! rests into settings with their uncertainty. [`results`] combines all of that as the program prints it.

pub mod calibrate;
pub mod compare;
pub mod contact;
mod cores;
pub mod diagnose;
pub mod fit;
pub mod identify;
pub mod law;
pub mod merge;
pub mod paper;
pub mod plan;
pub mod response;
pub mod results;
mod reversals;
pub mod rows;
#[cfg(test)]
mod simulated;
pub mod skew;
pub mod told;
