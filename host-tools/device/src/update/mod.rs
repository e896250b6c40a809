//! Firmware updates over USB: the chip's own ROM bootloader writes the image, so no probe is needed.
//!
//! The device restarts into its ROM on [`Command::EnterDfu`](inerter_wire::Command::EnterDfu), the ROM erases and
//! writes the pages of the image ([`dfuse`]), and starts it; then the host asks the device which firmware it runs.
//! Settings are in separate pages and are kept. After an interruption, running the same command again starts over and
//! completes the update.

pub mod dfuse;
mod error;
mod machine;
#[cfg(test)]
mod mock;
mod sequence;
mod this_machine;

pub use dfuse::{Going, Stage};
pub use error::{BY_HAND, UpdateError};
pub use machine::{Machine, Running};
pub use sequence::{UpdateEvent, confirm, update, visit};
pub use this_machine::ThisMachine;
