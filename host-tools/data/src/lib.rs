//! Runs of an instrumented inerter, wherever they come from and wherever they go.
//!
//! [`open`] reads a [`run::Run`] from a [`recording`] or a [`csv`] file; [`replay`] takes it through the estimator;
//! [`series`] brings its samples into SI units, [`full_scale`] says how fast they are. [`json`], [`text`] and [`words`]
//! write down what comes out, for programs and for people, [`causes`] what is wrong; [`mod@export`] writes samples and
//! estimates for other tools. [`settings`] and [`backup`] keep settings in files; [`wants`] reads what is wanted of a
//! motion, [`wav`] writes one.
//!
//! Every error names the file, field or line; its help says what to do next.
#![forbid(unsafe_code)]

pub mod backup;
pub mod calibration;
pub mod causes;
pub mod csv;
mod error;
pub mod export;
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
