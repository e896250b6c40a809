//! What an update needs from the machine that it runs on, and the types of its answers.

use std::{fmt::Display, time::Duration};

use dfu_core::DfuIo;
use inerter_wire::Hello;

use super::error::UpdateError;
use crate::{dfu::DfuDevice, image::Identity};

/// What an update needs from the machine that it runs on.
pub trait Machine {
    /// The connection to a device in update mode.
    type Io: DfuIo<Read = usize, Write = usize, Error: Display>;

    /// The running device that was chosen; `None` if there is none, in which case one in update mode may serve.
    fn running(&mut self) -> Result<Option<Running>, UpdateError>;
    /// Tells the running device to enter update mode.
    fn enter_dfu(&mut self) -> Result<(), UpdateError>;
    /// Devices in update mode.
    fn in_dfu(&mut self) -> Result<Vec<DfuDevice>, UpdateError>;
    /// Opens one of them.
    fn open(&mut self, device: &DfuDevice) -> Result<Self::Io, UpdateError>;
    /// Asks the device with this serial number for its identity; the error says why it does not answer yet.
    fn hello(&mut self, serial: &str) -> Result<Running, UpdateError>;
    /// Waits.
    fn sleep(&mut self, time: Duration);

    /// Fails if the work should end. Called only while nothing is in progress.
    fn check_interrupted(&self) -> Result<(), UpdateError> {
        Ok(())
    }
}

/// A running device.
#[derive(Clone, Debug, PartialEq)]
pub struct Running {
    /// Port or address.
    pub name: String,
    /// Its identity.
    pub hello: Hello,
}

impl From<&Hello> for Identity {
    fn from(hello: &Hello) -> Self {
        Self { firmware: hello.firmware.to_string(), git: hello.git.to_string(), board: hello.board.to_string() }
    }
}
