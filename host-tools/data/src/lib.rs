//! Runs of an instrumented inerter: reading, replaying and writing them.
//!
//! [`open`] reads a [`run::Run`] from a [`recording`] or a [`csv`] file; [`replay`] runs it through the estimator;
//! [`series`] converts its samples to SI units; [`full_scale`] finds the peak velocity and acceleration. [`json`],
//! [`text`] and [`words`] write results for programs and for people, [`causes`] lists what may be wrong; [`mod@export`]
//! writes samples and estimates for other tools. [`settings`] and [`backup`] store settings in files; [`wants`] parses
//! wanted intervals, [`wav`] writes a motion.
//!
//! Every error names the file, field or line; its help says what to do next.

pub mod backup;
pub mod calibration;
pub mod causes;
pub mod csv;
mod error;
pub mod export;
#[cfg(test)]
mod fixtures;
pub mod full_scale;
pub mod gated;
pub mod json;
pub mod limits;
pub mod names;
mod open;
pub mod output;
pub mod recording;
pub mod replay;
pub mod run;
pub mod selftest;
pub mod series;
pub mod settings;
pub mod text;
pub mod uncertainty;
pub mod wants;
pub mod wav;
pub mod words;

pub use error::Error;
pub use open::open;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
