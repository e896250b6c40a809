//! Bridges to the plotting programs that laboratories have: samples and estimates as they come.
//!
//! A program that does not listen is no error: it may be started later. Times are those of the host, so that the curves
//! stand beside others.

mod datagrams;
mod foxglove;
mod plotjuggler;
mod teleplot;

pub use foxglove::Foxglove;
pub use plotjuggler::PlotJuggler;
pub use teleplot::Teleplot;
