//! What arguments are read as.

pub use inerter_store::{Day, Shard};
