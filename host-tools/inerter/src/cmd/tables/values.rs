//! Value parsers for arguments.

pub use inerter_store::{Day, Shard};
