//! Writes a recording such that whatever was written can be read, whatever happens.
//!
//! The file ends with an index of its chunks. Until then it is kept in memory: 1.5 MB for each hour of a live
//! recording, whatever its rate.

use std::{collections::BTreeMap, io, path::Path};

use inerter_core::{Machine, Settings};
use inerter_wire::{Hello, WIRE_VERSION};
use mcap::{McapError, WriteOptions, records::MessageHeader, write::Metadata};

use super::{
    CALIBRATION_METADATA, END_METADATA, HELLO_METADATA, RAW_ENCODING, RAW_TOPIC, SETTINGS_METADATA,
    decode::{Channel, Decoder},
    messages::MarkerJson,
    schemas::schema,
    sink::{Safe, Sink},
};
use crate::{
    calibration::Calibration,
    output::{self, OutputError, Pending},
    words::duration_text,
};

/// Time after which a chunk is closed, written and, for a live device, synced \[ns\]: including the time that the disk
/// takes, a power failure loses a second at most.
const LIVE_FLUSH_NS: u64 = 500_000_000;
/// The same if the file gets its name at the end \[ns\].
const FLUSH_NS: u64 = 1_000_000_000;

/// How a recording ended, for its readers.
#[derive(Clone, Debug, PartialEq)]
pub struct End {
    /// One sentence.
    pub reason: String,
    /// Frames lost in transit.
    pub lost_frames: u64,
}

/// A recording being written.
pub struct Recorder {
    name: String,
    writer: mcap::Writer<Sink>,
    safe: Safe,
    /// Channel of the frames, and the number of streams so far.
    channel: u16,
    part: u16,
    sequence: u32,
    /// Channels of decoded messages, with the number of messages on each.
    decoded: Vec<(Channel, u16, u32)>,
    decoder: Option<Decoder>,
    start_ns: Option<u64>,
    last_ns: u64,
    flush_ns: u64,
    flushed_ns: u64,
    frame: Vec<u8>,
}

impl Recorder {
    /// Begins a live recording: what is written survives a power failure, and the recording ends if another program
    /// deletes, replaces or changes the file. Replaces an existing file only with `replace`.
    pub fn create(path: &Path, replace: bool) -> Result<Self, OutputError> {
        let file = output::create(path, replace)?;
        Self::begin(path.display().to_string(), LIVE_FLUSH_NS, |safe| Sink::watching(path, file, safe))
    }

    /// Begins a recording that gets its name when it is complete.
    pub fn fill(pending: &Pending) -> Result<Self, OutputError> {
        let file = pending.open()?;
        Self::begin(pending.name(), FLUSH_NS, |safe| Sink::new(file, safe))
    }

    fn begin(name: String, flush_ns: u64, sink: impl FnOnce(Safe) -> io::Result<Sink>) -> Result<Self, OutputError> {
        let options = WriteOptions::new()
            .profile("inerter")
            .library(concat!("inerter ", env!("CARGO_PKG_VERSION")))
            .compression(None)
            // Writes whole chunks from memory: a header is never written before its length is known.
            .disable_seeking(true)
            .chunk_size(Some(4 << 20));
        let safe = Safe::default();
        let failed = |error| OutputError::write(&name, into_io(error));
        let sink = sink(safe.clone()).map_err(|source| OutputError::write(&name, source))?;
        let mut writer = options.create(sink).map_err(failed)?;
        let channel = add_raw(&mut writer, 1).map_err(failed)?;
        Ok(Self {
            name,
            writer,
            safe,
            channel,
            part: 1,
            sequence: 0,
            decoded: Vec::new(),
            decoder: None,
            start_ns: None,
            last_ns: 0,
            flush_ns,
            flushed_ns: 0,
            frame: Vec::with_capacity(inerter_wire::MAX_FRAME),
        })
    }

    /// Records the device's identity and settings, which define its numbers.
    pub fn describe(&mut self, hello: &Hello, settings_in_use: &Settings) -> Result<(), OutputError> {
        let values = Settings::TABLE.iter().zip(settings_in_use.values());
        let settings = values.map(|(info, value)| (info.name.to_string(), format!("{value:?}"))).collect();
        self.metadata(HELLO_METADATA, hello_map(hello))?;
        self.metadata(SETTINGS_METADATA, settings)?;
        self.decode_by(settings_in_use)?;
        self.flush()
    }

    /// Records when and how the rig was calibrated.
    pub fn calibrated(&mut self, calibration: &Calibration) -> Result<(), OutputError> {
        self.metadata(CALIBRATION_METADATA, calibration.texts())
    }

    /// From now on the frames are also written decoded, with these settings and those that follow in the stream.
    pub fn decode_by(&mut self, settings: &Settings) -> Result<(), OutputError> {
        self.add_decoded(settings.machine)?;
        self.decoder = Some(Decoder::new(settings));
        Ok(())
    }

    /// Begins another stream: its sequence numbers do not continue the previous ones.
    pub fn begin_part(&mut self) -> Result<(), OutputError> {
        self.part += 1;
        self.channel = add_raw(&mut self.writer, self.part).map_err(|error| self.failed(error))?;
        Ok(())
    }

    /// Writes a marker at once.
    pub fn marker(&mut self, time_ns: u64, text: &str) -> Result<(), OutputError> {
        let time_ns = time_ns.max(self.last_ns);
        // Two plain fields: serialisation cannot fail.
        let json = serde_json::to_vec(&MarkerJson { t_ns: time_ns, text: text.into() }).unwrap_or_default();
        self.say(Channel::Marker, time_ns, &json)?;
        self.flush()
    }

    /// Writes one frame as received (without its delimiter) at host time `time_ns`, never earlier than the previous
    /// one.
    pub fn frame(&mut self, time_ns: u64, stuffed: &[u8]) -> Result<(), OutputError> {
        let time_ns = time_ns.max(self.last_ns);
        self.frame.clear();
        self.frame.extend_from_slice(stuffed);
        self.frame.push(inerter_wire::DELIMITER);
        let header = MessageHeader {
            channel_id: self.channel,
            sequence: self.sequence,
            log_time: time_ns,
            publish_time: time_ns,
        };
        self.writer.write_to_known_channel(&header, &self.frame).map_err(|error| self.failed(error))?;
        self.sequence = self.sequence.wrapping_add(1);
        self.last_ns = time_ns;
        if let Some(decoder) = &mut self.decoder {
            for (channel, json) in decoder.take(self.channel, &self.frame) {
                self.say(channel, time_ns, &json)?;
            }
        }
        self.start_ns.get_or_insert(time_ns);
        self.flush_by(time_ns)
    }

    /// Nothing has arrived until `time_ns`: flushes earlier frames if they are due.
    pub fn quiet(&mut self, time_ns: u64) -> Result<(), OutputError> {
        if self.last_ns > self.flushed_ns { self.flush_by(time_ns) } else { Ok(()) }
    }

    fn flush_by(&mut self, time_ns: u64) -> Result<(), OutputError> {
        let since_ns = self.flushed_ns.max(self.start_ns.unwrap_or(time_ns));
        if time_ns.saturating_sub(since_ns) < self.flush_ns {
            return Ok(());
        }
        self.flushed_ns = time_ns;
        self.flush()
    }

    /// Adds the decoded channels, once, with the names of this machine.
    fn add_decoded(&mut self, machine: Machine) -> Result<(), OutputError> {
        if !self.decoded.is_empty() {
            return Ok(());
        }
        let add = |(channel, topic): (Channel, &str)| {
            let (text, none) = (schema(machine, channel), BTreeMap::new());
            let schema = self.writer.add_schema(&format!("inerter.{topic}"), "jsonschema", text.as_bytes())?;
            Ok((channel, self.writer.add_channel(schema, topic, "json", &none)?, 0))
        };
        let added: Result<Vec<_>, McapError> = Channel::ALL.into_iter().map(add).collect();
        self.decoded = added.map_err(|error| self.failed(error))?;
        Ok(())
    }

    fn say(&mut self, channel: Channel, time_ns: u64, json: &[u8]) -> Result<(), OutputError> {
        // A marker may come before the device is known.
        self.add_decoded(Machine::Linear)?;
        let Some((_, id, sequence)) = self.decoded.iter_mut().find(|(known, ..)| *known == channel) else {
            return Ok(());
        };
        let header = MessageHeader { channel_id: *id, sequence: *sequence, log_time: time_ns, publish_time: time_ns };
        *sequence = sequence.wrapping_add(1);
        self.writer.write_to_known_channel(&header, json).map_err(|error| self.failed(error))
    }

    /// Hands everything so far to the writing thread.
    pub fn flush(&mut self) -> Result<(), OutputError> {
        self.safe.hand_over(self.duration_ns());
        self.writer.flush().map_err(|error| self.failed(error))
    }

    /// Frames so far.
    pub fn frames(&self) -> u32 {
        self.sequence
    }

    /// Time from the first frame to the last \[s\].
    pub fn duration_s(&self) -> f64 {
        self.duration_ns() as f64 * 1e-9
    }

    fn duration_ns(&self) -> u64 {
        self.last_ns.saturating_sub(self.start_ns.unwrap_or(self.last_ns))
    }

    /// Closes the recording: writes the index and the reason for the end.
    pub fn close(mut self, end: &End) -> Result<(), OutputError> {
        for (channel, json) in self.decoder.as_mut().map(Decoder::end).unwrap_or_default() {
            self.say(channel, self.last_ns, &json)?;
        }
        let map = map([
            ("reason", end.reason.clone()),
            ("frames", self.sequence.to_string()),
            ("lost_frames", end.lost_frames.to_string()),
        ]);
        self.metadata(END_METADATA, map)?;
        self.writer.finish().map(drop).map_err(|error| self.failed(error))?;
        let Self { name, writer, safe, .. } = self;
        writer.into_inner().finish().map_err(|source| write_error(name, &safe, source))
    }

    /// Records other metadata of the run.
    pub fn metadata(&mut self, name: &str, metadata: BTreeMap<String, String>) -> Result<(), OutputError> {
        let metadata = Metadata { name: name.into(), metadata };
        self.writer.write_metadata(&metadata).map_err(|error| self.failed(error))
    }

    fn failed(&self, error: McapError) -> OutputError {
        write_error(self.name.clone(), &self.safe, into_io(error))
    }
}

fn write_error(name: String, safe: &Safe, source: io::Error) -> OutputError {
    let written = match safe.synced_ns() {
        0 => String::new(),
        synced_ns => format!("{} of recording", duration_text(synced_ns as f64 * 1e-9)),
    };
    OutputError::Write { name, written, source }
}

/// Adds a channel `raw` with what a reader must know about it; each stream has its own channel.
fn add_raw(writer: &mut mcap::Writer<Sink>, part: u16) -> Result<u16, McapError> {
    let mut metadata = map([("wire_version", WIRE_VERSION.to_string())]);
    if part > 1 {
        metadata.insert("part".into(), part.to_string());
    }
    writer.add_channel(0, RAW_TOPIC, RAW_ENCODING, &metadata)
}

/// The operating system's reason.
pub(crate) fn into_io(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}

fn hello_map(hello: &Hello) -> BTreeMap<String, String> {
    let Hello { wire_version, firmware, git, board, serial, sample_rate_hz, clock, capabilities } = hello;
    map([
        ("wire_version", wire_version.to_string()),
        ("firmware", firmware.to_string()),
        ("git", git.to_string()),
        ("board", board.to_string()),
        ("serial", serial.to_string()),
        ("sample_rate_hz", format!("{sample_rate_hz:?}")),
        ("clock", format!("{clock:?}").to_lowercase()),
        ("capabilities", format!("{:#x}", capabilities.0)),
    ])
}

/// Texts by name.
pub(super) fn map<const N: usize>(pairs: [(&str, String); N]) -> BTreeMap<String, String> {
    pairs.into_iter().map(|(key, value)| (key.to_string(), value)).collect()
}
