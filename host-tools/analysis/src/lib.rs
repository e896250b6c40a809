//! What runs of an instrumented inerter say of the device.
//!
//! [`fit`] fits again what the estimator has summed: friction by direction; [`merge`] does so for several runs
//! together. [`contact`] takes stiffness and damping from a terminal displacement sensor. [`mod@identify`] fits the
//! complete model, [`response`] measures F/x over frequency, [`law`] is the estimator's with its kernels, [`rows`] has
//! it beside the force row by row, [`mod@compare`] holds runs against each other, [`paper`] identifies the paper's
//! device from its three tests. [`mod@diagnose`] names what breaks the law, [`mod@skew`] finds how late the force is,
//! [`plan`] designs a motion and predicts what it will tell. [`calibrate`] turns samples at known loads, displacements
//! and rests into settings with their uncertainty. [`results`] puts all of that together as the program prints it.
#![forbid(unsafe_code)]

pub mod calibrate;
pub mod compare;
pub mod contact;
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
pub mod skew;
pub mod told;
