//! Connected devices: finding them, opening the link, talking to them.

mod error;
mod link;
mod ports;
mod session;

pub use error::{DeviceError, version_help};
pub use link::{DEFAULT_BAUD, Link, Target};
pub use ports::{Port, find, list, serial_of, stlink_port};
pub use session::{Clock, Device, Received};
