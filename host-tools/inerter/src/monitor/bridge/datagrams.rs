//! Datagrams to a plotting program.

use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};

use crate::monitor::{MonitorError, address::resolve};

/// A socket to send from. It is not connected: if no program listens, every other send would fail.
pub struct Datagrams {
    socket: UdpSocket,
    to: SocketAddr,
}

impl Datagrams {
    pub fn new(option: &'static str, address: &str, example: &'static str) -> Result<Self, MonitorError> {
        let to = resolve(option, address, example)?;
        // If the destination is local, nobody outside can reach the socket either.
        let from = match to {
            SocketAddr::V4(to) if to.ip().is_loopback() => Ipv4Addr::LOCALHOST.into(),
            SocketAddr::V4(_) => IpAddr::from(Ipv4Addr::UNSPECIFIED),
            SocketAddr::V6(to) if to.ip().is_loopback() => Ipv6Addr::LOCALHOST.into(),
            SocketAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
        };
        let failed = |source| MonitorError::Address { option, address: address.into(), example, source };
        let socket = UdpSocket::bind((from, 0)).map_err(failed)?;
        // A full buffer loses a datagram, not a sample: the measurement must not wait for a plot.
        socket.set_nonblocking(true).map_err(failed)?;
        Ok(Self { socket, to })
    }

    pub fn send(&self, bytes: &[u8]) {
        self.socket.send_to(bytes, self.to).ok();
    }
}
