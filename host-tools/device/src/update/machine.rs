//! What an update needs of the machine that it runs on, and what it finds there.

use std::{fmt::Display, time::Duration};

use dfu_core::DfuIo;
use inerter_wire::Hello;

use super::error::UpdateError;
use crate::{dfu::DfuDevice, image::Identity};

/// What an update needs of the machine that it runs on.
pub trait Machine {
    /// The way to a device in update mode.
    type Io: DfuIo<Read = usize, Write = usize, Error: Display>;

    /// The running device that was chosen; `None` when there is none, which one in update mode may make up for.
    fn running(&mut self) -> Result<Option<Running>, UpdateError>;
    /// Tells the running device to enter update mode.
    fn enter_dfu(&mut self) -> Result<(), UpdateError>;
    /// Devices in update mode.
    fn in_dfu(&mut self) -> Result<Vec<DfuDevice>, UpdateError>;
    /// Opens one of them.
    fn open(&mut self, device: &DfuDevice) -> Result<Self::Io, UpdateError>;
    /// Asks the device with this serial number who it is; the error says why nobody answers yet.
    fn hello(&mut self, serial: &str) -> Result<Back, UpdateError>;
    /// Lets time pass.
    fn sleep(&mut self, time: Duration);

    /// Fails once the work is to end where nothing is under way.
    fn check_interrupted(&self) -> Result<(), UpdateError> {
        Ok(())
    }
}

/// A device that runs.
#[derive(Clone, Debug, PartialEq)]
pub struct Running {
    /// Port or address.
    pub name: String,
    /// Who it is.
    pub hello: Hello,
}

/// A device that is back.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Back {
    /// Port or address.
    pub port: String,
    /// Serial number.
    pub serial: String,
    /// What it runs.
    pub identity: Identity,
}

impl From<&Hello> for Identity {
    fn from(hello: &Hello) -> Self {
        Self { firmware: hello.firmware.to_string(), git: hello.git.to_string(), board: hello.board.to_string() }
    }
}

impl From<Running> for Back {
    fn from(running: Running) -> Self {
        let identity = Identity::from(&running.hello);
        Self { port: running.name, serial: running.hello.serial.to_string(), identity }
    }
}
