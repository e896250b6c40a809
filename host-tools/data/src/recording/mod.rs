//! Recordings: MCAP files with the frames as they were received.
//!
//! | what | where |
//! |---|---|
//! | frames, each with its delimiter, as received; log time = host time \[ns\] | channel `raw`, message encoding `inerter` |
//! | the device's Hello | metadata `inerter.hello` |
//! | its settings, by name | metadata `inerter.settings` |
//! | when and how its rig was calibrated | metadata `inerter.calibration` |
//! | the true parameters of a simulated device | metadata `inerter.truth` |
//! | how and why the recording ended | metadata `inerter.end`; missing when the writer was killed |
//! | remarks made during the recording | channel `marker`, JSON |
//! | the same decoded, for PlotJuggler and Foxglove | channels `motion`, `estimate`, `reversal`, `event`, `health`, JSON |
//!
//! The frames are authoritative: readers here ignore the decoded channels.
//!
//! Chunks are written whole, uncompressed, so that a truncated file can be read up to the cut, even within a chunk. For
//! a live device they are written and synchronised twice a second: a power failure loses a second at most.

mod decode;
mod edit;
mod error;
mod layout;
mod messages;
mod read;
mod samples;
mod schemas;
mod sink;
mod walk;
mod write;

pub use edit::{Cut, Merged, cut, merge};
pub use error::RecordingError;
pub use layout::{
    CALIBRATION_METADATA, END_METADATA, Ending, HELLO_METADATA, MARKER_TOPIC, RAW_ENCODING, RAW_TOPIC,
    SETTINGS_METADATA, TRUTH_METADATA, is_recording,
};
pub use read::{Contents, Incoming, Item, read};
pub use samples::{Extent, Marker, Summary, calibration, read_run, samples, summary, summary_watched, usable_settings};
pub(crate) use write::into_io;
pub use write::{End, Recorder};
