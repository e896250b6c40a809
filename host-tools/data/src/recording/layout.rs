//! Names of the parts of a recording.

use std::{fs::File, io::Read, path::Path};

/// Topic of the channel that holds the frames.
pub const RAW_TOPIC: &str = "raw";
/// Topic of the channel with markers.
pub const MARKER_TOPIC: &str = "marker";
/// Message encoding of the channel that holds the frames.
pub const RAW_ENCODING: &str = "inerter";
/// Name of the metadata that holds the Hello.
pub const HELLO_METADATA: &str = "inerter.hello";
/// Name of the metadata that holds the settings.
pub const SETTINGS_METADATA: &str = "inerter.settings";
/// Name of the metadata that holds the rig's calibration.
pub const CALIBRATION_METADATA: &str = "inerter.calibration";
/// Name of the metadata that says how the recording ended.
pub const END_METADATA: &str = "inerter.end";
/// Name of the metadata that holds the true parameters of a simulated device.
pub const TRUTH_METADATA: &str = "inerter.truth";

/// Whether a file begins like an MCAP file, even if it ends within the first bytes.
pub fn is_recording(path: &Path) -> std::io::Result<bool> {
    let mut start = Vec::new();
    File::open(path)?.take(8).read_to_end(&mut start)?;
    Ok(!start.is_empty() && mcap::MAGIC.starts_with(&start))
}

/// How a file ends.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Ending {
    /// It was closed: everything is there.
    Closed,
    /// It is truncated: everything before the cut is there.
    #[default]
    CutOff,
    /// It is damaged at about this byte, and readable up to there.
    Damaged {
        /// Offset of the damage.
        byte: u64,
        /// What is damaged.
        reason: String,
    },
}
