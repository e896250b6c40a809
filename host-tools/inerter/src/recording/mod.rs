//! Recordings: MCAP files with the frames as they were received.
//!
//! | what | where |
//! |---|---|
//! | frames, each with its delimiter, as received; log time = host time \[ns\] | channel `raw`, message encoding `inerter` |
//! | the device's Hello | metadata `inerter.hello` |
//! | its settings, by name | metadata `inerter.settings` |
//! | what is true of a simulated device | metadata `inerter.truth` |
//! | how and why the recording ended | metadata `inerter.end`; missing when the writer was killed |
//! | what somebody wrote down on the way | channel `marker`, JSON |
//! | the same decoded, for PlotJuggler and Foxglove | channels `motion`, `estimate`, `gap`, `event`, `health`, JSON |
//!
//! The frames are the truth: readers here leave the decoded channels alone.
//!
//! Chunks are written whole once a second, uncompressed, so that a file which is cut off anywhere reads up to the cut,
//! within a chunk too.

mod decode;
mod edit;
mod error;
mod messages;
mod read;
mod samples;
mod schemas;
mod walk;
mod write;

pub use edit::{Cut, Merged, cut, merge};
pub use error::RecordingError;
pub use read::{Contents, Ending, Incoming, Item, read};
pub use samples::{
    Extent, Marker, SampleReader, Summary, read_run, samples, summary, summary_watched, usable_settings,
};
pub use write::{End, Recorder};

/// Topic of the channel that holds the frames.
pub const RAW_TOPIC: &str = "raw";
/// Topic of the channel that holds what somebody wrote down.
pub const MARKER_TOPIC: &str = "marker";
/// Message encoding of the channel that holds the frames.
pub const RAW_ENCODING: &str = "inerter";
/// Name of the metadata that holds the Hello.
pub const HELLO_METADATA: &str = "inerter.hello";
/// Name of the metadata that holds the settings.
pub const SETTINGS_METADATA: &str = "inerter.settings";
/// Name of the metadata that says how the recording ended.
pub const END_METADATA: &str = "inerter.end";
/// Name of the metadata that holds what is true of a simulated device.
pub const TRUTH_METADATA: &str = "inerter.truth";
