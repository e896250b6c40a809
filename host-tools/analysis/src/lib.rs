//! What runs of an instrumented inerter say of the device.
//!
//! [`fit`] fits again what the estimator has summed: friction by direction. [`contact`] takes stiffness and damping from
//! a terminal displacement sensor. [`mod@identify`] fits the complete model, [`response`] measures F/x over frequency, [`law`]
//! compares the estimator's law with the force sample by sample, [`paper`] identifies the paper's device from its three tests.
//! [`mod@diagnose`] names what breaks the law, [`mod@skew`] finds how late the force is, [`plan`] designs a motion and predicts
//! what it will tell. [`calibrate`] turns samples at known loads, displacements and rests into settings
//! with their uncertainty.
#![forbid(unsafe_code)]

pub mod calibrate;
pub mod contact;
pub mod diagnose;
pub mod fit;
pub mod identify;
pub mod law;
pub mod paper;
pub mod plan;
pub mod response;
pub mod skew;
