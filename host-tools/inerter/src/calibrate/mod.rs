//! Calibration: from raw samples at known loads, displacements and rests to settings with their uncertainty.
//!
//! Every step is a pure function of samples ([`load_cell`], [`rest`], [`force`], [`encoder`], [`direction`], [`timebase`])
//! that gives a [`Finding`] or refuses with a [`CalibrateError`]. [`steps`] takes the samples from a device while it talks
//! to a person through a [`Dialogue`]; [`wizard`] goes through all of them. Nothing is written on the device before the end.
//!
//! Glossary:
//! - *code*: one sample's force as the device counts it; *count*: one sample's position, a sum of `oversampling` counts.
//! - *level*: the mean code of a device at rest, with its uncertainty.
//! - *U95*: half width of the 95 % interval.

pub mod dialogue;
pub mod direction;
pub mod encoder;
mod error;
mod finding;
pub mod force;
mod line;
mod listen;
pub mod load_cell;
pub mod rest;
mod statistics;
pub mod steps;
pub mod timebase;
pub mod wizard;

pub use dialogue::Dialogue;
pub use direction::refuse_saturated;
pub use error::CalibrateError;
pub use finding::{Finding, Level, Remark, Step};
pub use line::{Line, Point};
pub use listen::{Arrival, Heard};
pub use statistics::Mean;
