//! Everything that the program `inerter` does, as a library: sources, recordings, CSV, replay, devices, simulation.
//!
//! Data flows one way: a [`run::Run`] comes from a file ([`recording`], [`csv`]) or from a device
//! ([`device`], [`live`]); [`replay`] takes it through the estimator here, [`inject`] through a device's own;
//! [`report`] and [`detail`] turn what comes out into JSON and text, [`mod@export`] writes samples and estimates for other
//! tools, [`monitor`] is a live device for a terminal, a page and other programs. [`simulate`] makes runs and devices out of
//! the plant. [`fit`] fits again what the estimator has summed: friction by direction, the skew. [`calibrate`] finds
//! scales, zero and clock at known loads, displacements and rests; [`backup`] keeps settings in files.
//! [`response`] measures F/x over frequency; [`figure`] draws, [`page`] makes a run into one page, [`paper`] does the paper again.
//! [`report`] and [`detail`] turn what comes out into JSON and text. [`simulate`] makes runs and devices out of the plant.
//! [`fit`] fits again what the estimator has summed: friction by direction, the skew. [`identify`] fits the complete model.
//! A firmware [`image`] reaches a board by [`mod@update`] over USB or by [`flash`] through a debug probe.
//!
//! Every error names the file, field, line or port and says what to do next; [`error::Error::exit_code`] is the code
//! that the program ends with.
#![forbid(unsafe_code)]

// The app's queues need critical sections; this crate brings the implementation for a machine with threads.
use critical_section as _;

pub mod backup;
pub mod board;
pub mod calibrate;
pub mod contact;
pub mod csv;
pub mod detail;
pub mod device;
pub mod doctor;
pub mod error;
pub mod export;
pub mod figure;
pub mod fit;
pub mod flash;
pub mod identify;
pub mod image;
pub mod inject;
pub mod live;
pub mod monitor;
pub mod output;
pub mod page;
pub mod paper;
pub mod recording;
pub mod replay;
pub mod report;
pub mod response;
pub mod run;
pub mod series;
pub mod settings;
pub mod simulate;
pub mod update;

pub use error::Error;
