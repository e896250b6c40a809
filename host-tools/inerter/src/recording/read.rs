//! Reading a recording, whole or broken off, frame by frame.

use std::{
    collections::BTreeMap,
    fs::File,
    io::{BufReader, Read},
    path::Path,
};

use inerter_wire::{Counts, DELIMITER, Frame, FrameReader, Record};
use mcap::records::Record as McapRecord;

use super::{
    RAW_ENCODING, RAW_TOPIC, RecordingError,
    walk::{Step, Walker},
};

/// One finding in the stream with the host time \[ns\] at which its frame arrived.
#[derive(Debug)]
pub struct Incoming {
    /// Host time \[ns\].
    pub time_ns: u64,
    /// What was found.
    pub frame: Frame<Record>,
}

/// How a file ends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ending {
    /// It was closed: everything is there.
    Closed,
    /// It breaks off: everything before is there.
    CutOff,
    /// It is damaged at about this byte, and was read up to there.
    Damaged {
        /// Offset of the damage.
        byte: u64,
        /// What is wrong.
        reason: String,
    },
}

/// What a file holds beside its frames.
#[derive(Clone, Debug)]
pub struct Contents {
    /// Metadata by name.
    pub metadata: BTreeMap<String, BTreeMap<String, String>>,
    /// How it ends.
    pub ending: Ending,
    /// Frames, and what was lost or damaged among them.
    pub counts: Counts,
    /// Host time of the first and the last frame \[ns\].
    pub span_ns: Option<(u64, u64)>,
    /// Size of the file as far as it was read \[bytes\].
    pub bytes: u64,
}

/// Reads a file; `take` is handed every finding in order.
pub fn read(path: &Path, take: impl FnMut(Incoming)) -> Result<Contents, RecordingError> {
    let failed = |source| RecordingError::Read { path: path.into(), source };
    let file = File::open(path).map_err(failed)?;
    let name = path.display().to_string();
    read_from(&name, BufReader::with_capacity(1 << 16, file), take)
}

/// Reads any bytes; `file` is their name in messages.
pub(super) fn read_from(file: &str, source: impl Read, take: impl FnMut(Incoming)) -> Result<Contents, RecordingError> {
    let file = || file.to_string();
    let mut walker = Walker::new(source);
    let mut frames = Frames::new(take);
    let ending = loop {
        let byte = walker.offset();
        let step = walker.step().map_err(|source| RecordingError::Read { path: file().into(), source })?;
        match step {
            Step::Record { opcode, data } => {
                if let Err(error) = mcap::parse_record(opcode, data).map(|record| frames.record(record)) {
                    break Ending::Damaged { byte, reason: error.to_string() };
                }
            }
            Step::Closed => break Ending::Closed,
            Step::CutOff => break Ending::CutOff,
            Step::Damaged(reason) => break Ending::Damaged { byte, reason },
            Step::WrongKind => return Err(RecordingError::WrongKind { file: file() }),
            Step::Compressed(compression) => return Err(RecordingError::Compressed { file: file(), compression }),
        }
    };
    if frames.channel.is_none() {
        return Err(RecordingError::NoChannel { file: file() });
    }
    Ok(frames.finish(ending, walker.offset()))
}

struct Frames<F> {
    channel: Option<u16>,
    reader: FrameReader<Record>,
    take: F,
    metadata: BTreeMap<String, BTreeMap<String, String>>,
    span_ns: Option<(u64, u64)>,
}

impl<F: FnMut(Incoming)> Frames<F> {
    fn new(take: F) -> Self {
        Self { channel: None, reader: FrameReader::new(), take, metadata: BTreeMap::new(), span_ns: None }
    }

    fn record(&mut self, record: McapRecord<'_>) {
        match record {
            McapRecord::Channel(channel) if channel.topic == RAW_TOPIC && channel.message_encoding == RAW_ENCODING => {
                self.channel = Some(channel.id);
            }
            McapRecord::Metadata(metadata) => {
                self.metadata.insert(metadata.name, metadata.metadata);
            }
            McapRecord::Message { header, data } if Some(header.channel_id) == self.channel => {
                self.message(header.log_time, &data);
            }
            _ => {}
        }
    }

    fn message(&mut self, time_ns: u64, data: &[u8]) {
        let (first, _) = self.span_ns.unwrap_or((time_ns, time_ns));
        self.span_ns = Some((first, time_ns));
        // A link that went away leaves half a frame: it ends here, lest it spoil the one that follows.
        let end: &[u8] = if data.ends_with(&[DELIMITER]) { &[] } else { &[DELIMITER] };
        for mut input in [data, end] {
            while let Some(frame) = self.reader.read(&mut input) {
                (self.take)(Incoming { time_ns, frame });
            }
        }
    }

    fn finish(self, ending: Ending, bytes: u64) -> Contents {
        Contents { metadata: self.metadata, ending, counts: *self.reader.counts(), span_ns: self.span_ns, bytes }
    }
}

#[cfg(test)]
#[path = "read_tests.rs"]
mod tests;
