//! Calibration at a device, in a dialogue with a person.
//!
//! [`steps`] takes the samples from a device while it talks to a person through a [`Dialogue`]; [`wizard`] goes through
//! all of them. Nothing is written on the device before the end. What the samples say is
//! [`inerter_analysis::calibrate`].

pub mod dialogue;
mod listen;
pub mod steps;
pub mod wizard;

pub use dialogue::Dialogue;
pub use listen::Heard;
