//! Firmware updates over USB: the chip's own ROM takes the image, no probe is needed.
//!
//! The device restarts into its ROM on [`Command::EnterDfu`](inerter_wire::Command::EnterDfu), the ROM erases and
//! writes the pages of the image ([`dfuse`]), starts it, and the device is asked what it runs now. Settings lie in
//! pages of their own and are kept. If it is interrupted, the same command starts over and completes it.

pub mod dfuse;
mod error;
mod machine;
#[cfg(test)]
mod mock;
mod sequence;
mod this_machine;

pub use dfuse::{Going, Stage};
pub use error::{BY_HAND, UpdateError};
pub use machine::{Back, Machine, Running};
pub use sequence::{UpdateEvent, confirm, update, visit};
pub use this_machine::ThisMachine;
