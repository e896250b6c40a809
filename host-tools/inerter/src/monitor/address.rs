//! Addresses of the views that other programs show, and which of them other machines reach.

use std::net::{IpAddr, SocketAddr, ToSocketAddrs};

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

/// `HOST:PORT`, as in a Host header, when it names this machine, written anew from what it means; the port may differ where it
/// is forwarded, or be missing.
pub fn loopback(host: &str) -> Option<String> {
    if let Ok(address) = host.parse::<SocketAddr>() {
        return address.ip().is_loopback().then(|| address.to_string());
    }
    let (name, port) = match host.rsplit_once(':').filter(|_| !host.ends_with(']')) {
        Some((name, port)) => (name, format!(":{}", port.parse::<u16>().ok()?)),
        None => (host, String::new()),
    };
    let bare = name.strip_prefix('[').and_then(|name| name.strip_suffix(']')).filter(|bare| bare.contains(':'));
    match bare.unwrap_or(name).parse::<IpAddr>() {
        Ok(IpAddr::V6(_)) if bare.is_none() => None,
        Ok(address) => address.is_loopback().then(|| format!("{name}{port}")),
        Err(_) => name.eq_ignore_ascii_case("localhost").then(|| format!("localhost{port}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_host_is_this_machine_or_none() {
        for (host, same) in [
            ("127.0.0.1:80", "127.0.0.1:80"),
            ("localhost:8080", "localhost:8080"),
            ("LOCALHOST", "localhost"),
            ("[::1]:5", "[::1]:5"),
            ("127.0.0.1", "127.0.0.1"),
            ("[::1]", "[::1]"),
        ] {
            assert_eq!(loopback(host).as_deref(), Some(same), "{host}");
        }
        for host in [
            "evil.example:80",
            "127.0.0.1.evil.example",
            "localhost.evil.example:1",
            "10.0.0.1:80",
            "",
            "0.0.0.0:1",
            "localhost:1; script-src *",
            "localhost:*",
            "localhost:",
            "localhost:65536",
            "localhost:+1:",
            "::1",
            "[127.0.0.1]",
            "[[::1]]",
            "[::1",
        ] {
            assert_eq!(loopback(host), None, "{host}");
        }
    }
}
