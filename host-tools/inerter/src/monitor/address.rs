//! Addresses of the views that other programs show, and which of them other machines reach.

use std::net::{SocketAddr, ToSocketAddrs};

use super::MonitorError;

/// Where the page is when nothing else is said: any free port.
pub const PAGE: &str = "127.0.0.1:0";
/// Where Teleplot listens.
pub const TELEPLOT: &str = "127.0.0.1:47269";
/// Where PlotJuggler's UDP server listens.
pub const PLOTJUGGLER: &str = "127.0.0.1:9870";
/// Where Foxglove looks for a server.
pub const FOXGLOVE: &str = "127.0.0.1:8765";

/// The address that an option names.
#[cfg(feature = "bridges")]
pub fn resolve(option: &'static str, address: &str, example: &'static str) -> Result<SocketAddr, MonitorError> {
    let failed = |source| MonitorError::Address { option, address: address.into(), example, source };
    let mut found = address.to_socket_addrs().map_err(failed)?;
    found.next().ok_or_else(|| failed(std::io::Error::other("the name has no address")))
}

/// The first address of those that an option names which other machines could connect to.
pub fn exposed(address: &str) -> Option<SocketAddr> {
    address.to_socket_addrs().ok()?.find(|found| !found.ip().is_loopback())
}

/// Fails where other machines could connect, unless `remote` ones are meant.
pub fn check_exposed(option: &'static str, address: &str, remote: bool) -> Result<(), MonitorError> {
    match exposed(address).filter(|_| !remote) {
        Some(resolved) => Err(MonitorError::Exposed { option, address: address.into(), resolved }),
        None => Ok(()),
    }
}
