//! Connected devices: finding them, opening the link, talking to them, updating their firmware.
//!
//! [`Device`] is a session with one device, [`live::Live`] one that survives an unplugged cable, [`inject`] sends
//! samples through a device's own estimator. A firmware [`image`] reaches a board by [`mod@update`] over USB or by
//! [`flash`] through a debug probe.

pub mod board;
pub mod dfu;
mod error;
pub mod flash;
pub mod image;
pub mod inject;
mod link;
pub mod live;
mod ports;
mod session;
pub mod udev;
pub mod update;

pub use error::DeviceError;
pub use link::{DEFAULT_BAUD, Link, Target};
pub use ports::{Port, find, list, serial_of, stlink_port};
pub use session::{Clock, Device, Interrupted, Received};
