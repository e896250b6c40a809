//! Bridges to common plotting programs: samples and estimates as they arrive.
//!
//! A program that does not listen is not an error: it may be started later. Times are the host's, so that the curves
//! line up with others.

mod datagrams;
mod foxglove;

pub use datagrams::{PlotJuggler, Teleplot};
pub use foxglove::Foxglove;
