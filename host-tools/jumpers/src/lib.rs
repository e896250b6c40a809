//! The self-test with jumpers: four wires connect a board's outputs to its inputs, and it measures what it plays.
//!
//! ```text
//! plant -> tape -> knots -> board: player -> wires -> converters, counter -> estimator
//!            '-> steps -----------------------> truth        samples, estimates -'-> checks
//! ```
//!
//! Terms:
//! - *tape*: knots, and the same [`Step`](inerter_app::player::Step)s that the board makes of them; so the host knows what
//!   the outputs were at every 64000th of a second, to the last code.
//! - *lag*: steps from a tape's beginning to the first sample. Counts have no noise, so they give it exactly.
//! - *phase*: from the sampling clock's event to a change of the outputs. Moving it shows when the converters sample.
//! - *check*: what was expected, what was found, and if they differ the cause.
//!
//! [`run`] does all of it on a [`Board`]; nothing here depends on a port or a screen, and time comes from the caller,
//! so the same code runs on a device and on an emulated one.

mod align;
mod board;
mod check;
mod motion;
mod recording;
mod run;
mod sweep;
mod tape;
mod wires;

pub use board::{Board, JumperError};
pub use check::{Check, Measured, Report};
pub use motion::{truth, worn};
pub use run::{run, run_with};
