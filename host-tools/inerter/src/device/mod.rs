//! Connected devices: finding them, opening the link, talking to them.

mod error;
mod link;
mod ports;
mod session;

pub use error::{DeviceError, version_help};
pub use link::{DEFAULT_BAUD, Link, Target};
pub use ports::{PRODUCT, Port, USB_PID, USB_VID, find, list};
pub use session::{Clock, Device, Received};
