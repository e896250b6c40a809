//! Addresses for the views in other programs, and which of them other machines can reach.

use std::net::{SocketAddr, ToSocketAddrs};

use super::MonitorError;

/// Default address of the page: any free port.
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

/// The first address an option names to which other machines could connect.
pub fn exposed(address: &str) -> Option<SocketAddr> {
    address.to_socket_addrs().ok()?.find(|found| !found.ip().is_loopback())
}

/// Fails if other machines could connect, unless `remote` is set.
pub fn check_exposed(option: &'static str, address: &str, remote: bool) -> Result<(), MonitorError> {
    match exposed(address).filter(|_| !remote) {
        Some(resolved) => Err(MonitorError::Exposed { option, address: address.into(), resolved }),
        None => Ok(()),
    }
}
