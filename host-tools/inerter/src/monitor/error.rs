//! Why the monitor cannot open a requested view.

use std::{io, net::SocketAddr};

use miette::Diagnostic;

/// A view that cannot be set up.
#[derive(Debug, thiserror::Error, Diagnostic)]
pub enum MonitorError {
    /// The page is for this machine only.
    #[error("--bind {address} would offer the page to other machines: {resolved} is not a loopback address")]
    #[diagnostic(
        code(inerter::monitor::bind),
        help(
            "use --bind 127.0.0.1:0; to view the page on another machine, forward the port: ssh -L 8080:127.0.0.1:PORT this-machine"
        )
    )]
    NotLoopback { address: String, resolved: SocketAddr },

    /// Other machines could connect, which was not allowed.
    #[error("{option} {address} would let in other machines: {resolved} is not a loopback address")]
    #[diagnostic(
        code(inerter::monitor::remote),
        help("use {option} 127.0.0.1:{port}, or add --allow-remote if everybody on that network may connect", port = resolved.port())
    )]
    Exposed { option: &'static str, address: String, resolved: SocketAddr },

    /// An address that does not exist.
    #[error("{option} {address} is not an address: {source}")]
    #[diagnostic(code(inerter::monitor::address), help("give HOST:PORT, for example {example}"))]
    Address { option: &'static str, address: String, example: &'static str, source: io::Error },

    /// The port is taken.
    #[error("{what} cannot listen at {address}: {reason}")]
    #[diagnostic(
        code(inerter::monitor::listen),
        help("another program may have the port: give another one, for example {option} {example}")
    )]
    Listen { what: &'static str, option: &'static str, address: String, example: &'static str, reason: String },

    /// The operating system provides no randomness.
    #[error("no random token for the page's address could be generated: {reason}")]
    #[diagnostic(code(inerter::monitor::random), help("leave --web out"))]
    Random { reason: String },

    /// The terminal failed.
    #[error("cannot draw on the terminal: {source}")]
    #[diagnostic(code(inerter::monitor::terminal), help("add --plain for lines"))]
    Terminal { source: io::Error },
}
