//! What several tests need: a device's Hello, a recording of its records, and new files.

use std::path::{Path, PathBuf};

use inerter_wire::{Capabilities, ClockSource, Hello, MAX_FRAME, Record, SequenceCounter, WIRE_VERSION, encode_record};
use tempfile::TempDir;

use crate::recording::{End, Recorder};

/// The Hello of a device with this serial number.
pub fn hello(serial: &str) -> Hello {
    Hello {
        wire_version: WIRE_VERSION,
        firmware: Hello::text("test 0"),
        git: Hello::text(""),
        board: Hello::text("desk"),
        serial: Hello::text(serial),
        sample_rate_hz: 1000.0,
        clock: ClockSource::Simulated,
        capabilities: Capabilities::NONE,
    }
}

/// A path without a file, in a folder of its own.
pub fn new_file(name: &str) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    (folder, path)
}

/// A recording of what a device sends at the host time `time_ns`.
pub struct Stream {
    pub recorder: Recorder,
    pub time_ns: u64,
    sequence: SequenceCounter,
}

impl Stream {
    pub fn new(path: &Path) -> Self {
        Self { recorder: Recorder::create(path, false).unwrap(), time_ns: 0, sequence: SequenceCounter::new() }
    }

    pub fn send(&mut self, record: &Record) {
        let mut out = [0; MAX_FRAME];
        let length = encode_record(record, self.sequence.take(), &mut out).unwrap();
        self.recorder.frame(self.time_ns, out.get(..length - 1).unwrap()).unwrap();
    }

    pub fn close(self, reason: &str) {
        self.recorder.close(&End { reason: reason.into(), lost_frames: 0 }).unwrap();
    }
}
