//! Host names and addresses of this machine.

use std::net::{IpAddr, SocketAddr};

/// A `HOST:PORT`, as in a Host header, in normal form if it names this machine; the port may differ because of
/// forwarding, or be missing.
pub fn loopback(host: &str) -> Option<String> {
    if let Ok(address) = host.parse::<SocketAddr>() {
        // Without a scope ID, which a header cannot hold.
        return address.ip().is_loopback().then(|| SocketAddr::new(address.ip(), address.port()).to_string());
    }
    let (name, port) = match host.rsplit_once(':').filter(|_| !host.ends_with(']')) {
        Some((name, port)) if port.bytes().all(|byte| byte.is_ascii_digit()) => {
            (name, format!(":{}", port.parse::<u16>().ok()?))
        }
        Some(_) => return None,
        None => (host, String::new()),
    };
    let bare = name.strip_prefix('[').and_then(|name| name.strip_suffix(']')).filter(|bare| bare.contains(':'));
    match bare.unwrap_or(name).parse::<IpAddr>() {
        Ok(IpAddr::V6(_)) if bare.is_none() => None,
        Ok(IpAddr::V6(address)) => address.is_loopback().then(|| format!("[{address}]{port}")),
        Ok(IpAddr::V4(address)) => address.is_loopback().then(|| format!("{address}{port}")),
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
            ("[0::1]", "[::1]"),
            ("[::1%1]:9", "[::1]:9"),
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
            "localhost:+1",
            "[0::1]:+5",
            "::1",
            "[127.0.0.1]",
            "[[::1]]",
            "[::1",
        ] {
            assert_eq!(loopback(host), None, "{host}");
        }
    }
}
