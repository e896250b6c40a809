//! Calibration: from raw samples at known loads, displacements and rests to settings with their uncertainty.
//!
//! Every step is a pure function of samples ([`load_cell`], [`rest`], [`force`], [`encoder`], [`direction`],
//! [`timebase`]) that returns a [`Finding`] or a [`CalibrateError`].
//!
//! Glossary:
//! - *code*: one sample's force as the device counts it; *count*: a sample's position, a sum of `oversampling` counts.
//! - *level*: the mean code of a device at rest, with its uncertainty.
//! - *U95*: half width of the 95 % interval.

pub mod direction;
pub mod encoder;
mod error;
pub mod finding;
pub mod force;
mod line;
pub mod load_cell;
pub mod rest;
mod statistics;
pub mod timebase;

pub use direction::refuse_saturated;
pub use error::CalibrateError;
pub use finding::{Finding, Level, Remark, Step};
pub use line::{Line, Point};
pub use statistics::{Mean, rounded_up};
pub(crate) use statistics::{student, together};
