//! Where plotting programs listen.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs, UdpSocket};

use crate::monitor::MonitorError;

/// Where Teleplot listens.
pub const TELEPLOT: &str = "127.0.0.1:47269";
/// Where PlotJuggler's UDP server listens.
pub const PLOTJUGGLER: &str = "127.0.0.1:9870";
/// Where Foxglove looks for a server.
pub const FOXGLOVE: &str = "127.0.0.1:8765";

/// The address that an option names.
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

/// A socket to send from. It is not connected: a program that does not listen would make every other send fail.
pub struct Datagrams {
    socket: UdpSocket,
    to: SocketAddr,
}

impl Datagrams {
    pub fn new(option: &'static str, address: &str, example: &'static str) -> Result<Self, MonitorError> {
        let to = resolve(option, address, example)?;
        // Where all stays on this machine, nobody else reaches the socket either.
        let from = match to {
            SocketAddr::V4(to) if to.ip().is_loopback() => Ipv4Addr::LOCALHOST.into(),
            SocketAddr::V4(_) => IpAddr::from(Ipv4Addr::UNSPECIFIED),
            SocketAddr::V6(to) if to.ip().is_loopback() => Ipv6Addr::LOCALHOST.into(),
            SocketAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
        };
        let failed = |source| MonitorError::Address { option, address: address.into(), example, source };
        let socket = UdpSocket::bind((from, 0)).map_err(failed)?;
        // A full buffer loses a datagram rather than a sample: what is measured must not wait for a plot.
        socket.set_nonblocking(true).map_err(failed)?;
        Ok(Self { socket, to })
    }

    pub fn send(&self, bytes: &[u8]) {
        self.socket.send_to(bytes, self.to).ok();
    }
}
