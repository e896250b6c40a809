//! The self-test with jumpers: four wires connect a board's outputs to its inputs, and the board measures the signals
//! that it plays.
//!
//! ```text
//! plant -> tape -> knots -> board: player -> wires -> converters, counter -> estimator
//!            '-> steps -----------------------> truth        samples, estimates -'-> checks
//! ```
//!
//! Terms:
//! - *tape*: knots, and the [`Step`](inerter_app::player::Step)s that the board makes of them; so the host knows the
//!   exact output codes at every 64000th of a second.
//! - *lag*: steps from a tape's beginning to the first sample. Counts have no noise, so they give it exactly.
//! - *phase*: from the sampling clock's event to a change of the outputs. Moving it shows when the converters sample.
//! - *check*: the expected and the actual result, and if they differ the cause.
//!
//! [`run`] does the whole test on a [`Board`]. Nothing here depends on a port or a screen, and the caller provides the
//! time, so the same code runs with a real and an emulated device.

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
