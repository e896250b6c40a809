//! Calibration with a device, in a dialogue with a person.
//!
//! [`steps`] takes the samples from a device while it talks to a person through a [`Dialogue`]; [`wizard`] runs all of
//! them. Nothing is written to the device before the end. [`inerter_analysis::calibrate`] evaluates the samples.

pub mod dialogue;
mod listen;
pub mod steps;
pub mod wizard;

pub use dialogue::Dialogue;
pub use listen::Heard;
