#![doc = include_str!("../README.md")]

mod host;
#[cfg(feature = "http")]
mod http;

pub use host::loopback;
#[cfg(feature = "http")]
pub use http::{Place, Server, comes_from, guarded, limited, local_host, send, serve_connection};
