//! Recordings: MCAP files with the frames as they were received.
//!
//! | what | where |
//! |---|---|
//! | frames, each with its delimiter, as received; log time = host time \[ns\] | channel `raw`, message encoding `inerter` |
//! | the device's Hello | metadata `inerter.hello` |
//! | its settings, by name | metadata `inerter.settings` |
//! | what is true of a simulated device | metadata `inerter.truth` |
//! | how and why the recording ended | metadata `inerter.end`; missing when the writer was killed |
//!
//! Chunks are written whole once a second, uncompressed, so that a file which is cut off anywhere reads up to the cut,
//! within a chunk too.

mod error;
mod read;
mod samples;
mod walk;
mod write;

pub use error::RecordingError;
pub use read::{Contents, Ending, Incoming, read};
pub use samples::{Summary, read_run, summary};
pub use write::{End, Recorder};

/// Topic of the channel that holds the frames.
pub const RAW_TOPIC: &str = "raw";
/// Message encoding of that channel.
pub const RAW_ENCODING: &str = "inerter";
/// Name of the metadata that holds the Hello.
pub const HELLO_METADATA: &str = "inerter.hello";
/// Name of the metadata that holds the settings.
pub const SETTINGS_METADATA: &str = "inerter.settings";
/// Name of the metadata that says how the recording ended.
pub const END_METADATA: &str = "inerter.end";
/// Name of the metadata that holds what is true of a simulated device.
pub const TRUTH_METADATA: &str = "inerter.truth";
