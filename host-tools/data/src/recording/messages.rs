//! The messages of a recording one after the other: frames as received, and markers.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs::File,
    io::{BufReader, Read},
    path::Path,
};

use inerter_wire::{DELIMITER, Frame, FrameReader, Record};
use mcap::records::Record as McapRecord;
use serde::{Deserialize, Serialize};

use super::{
    MARKER_TOPIC, RAW_ENCODING, RAW_TOPIC, RecordingError,
    layout::Ending,
    walk::{Step, Walker},
};

/// Content of a message of the channel `marker`.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct MarkerJson {
    pub(super) t_ns: u64,
    pub(super) text: String,
}

/// One message.
#[derive(Debug)]
pub(super) enum Message {
    /// Bytes of the stream ([`Messages::bytes`]), as received at host time `time_ns`; `part` changes when another
    /// stream begins.
    Raw { time_ns: u64, part: u16 },
    /// A remark made at that time.
    Marker { time_ns: u64, text: String },
}

/// The messages of a file, and what has been read from it on the way.
pub(super) struct Messages<R> {
    file: String,
    walker: Walker<R>,
    pub(super) known: Known,
    /// How the file ends, once [`next`](Self::next) has returned `None`.
    pub(super) ending: Option<Ending>,
}

/// What the file has stated so far.
#[derive(Default)]
pub(super) struct Known {
    raw: BTreeSet<u16>,
    markers: BTreeSet<u16>,
    /// Metadata by name.
    pub(super) metadata: BTreeMap<String, BTreeMap<String, String>>,
    /// Host time of the first and the latest bytes \[ns\].
    pub(super) span_ns: Option<(u64, u64)>,
    bytes: Vec<u8>,
}

impl Messages<BufReader<File>> {
    /// Opens a file.
    pub(super) fn open(path: &Path) -> Result<Self, RecordingError> {
        let file = File::open(path).map_err(|source| RecordingError::Read { path: path.into(), source })?;
        Ok(Self::new(&path.display().to_string(), BufReader::with_capacity(1 << 16, file)))
    }
}

impl<R: Read> Messages<R> {
    /// Reads from any source; `file` is its name in messages.
    pub(super) fn new(file: &str, source: R) -> Self {
        Self { file: file.into(), walker: Walker::new(source), known: Known::default(), ending: None }
    }

    /// Bytes read so far.
    pub(super) fn offset(&self) -> u64 {
        self.walker.offset
    }

    /// The bytes of the message of the stream that [`next`](Self::next) has just returned.
    pub(super) fn bytes(&self) -> &[u8] {
        &self.known.bytes
    }

    /// The next message; `None` at the end of what can be read.
    pub(super) fn next(&mut self) -> Result<Option<Message>, RecordingError> {
        if self.ending.is_some() {
            return Ok(None);
        }
        let file = || self.file.clone();
        let ending = loop {
            let byte = self.walker.offset;
            let step = self.walker.step().map_err(|source| RecordingError::Read { path: file().into(), source })?;
            match step {
                Step::Record { opcode, data } => match mcap::parse_record(opcode, data) {
                    Ok(record) => {
                        if let Some(message) = self.known.record(record) {
                            return Ok(Some(message));
                        }
                    }
                    Err(error) => break Ending::Damaged { byte, reason: error.to_string() },
                },
                Step::Closed => break Ending::Closed,
                Step::CutOff => break Ending::CutOff,
                Step::Damaged(reason) => break Ending::Damaged { byte, reason },
                Step::WrongKind => return Err(RecordingError::WrongKind { file: file() }),
                Step::Compressed(compression) => return Err(RecordingError::Compressed { file: file(), compression }),
            }
        };
        if self.known.raw.is_empty() {
            return Err(RecordingError::NoChannel { file: file() });
        }
        self.ending = Some(ending);
        Ok(None)
    }
}

impl Known {
    fn record(&mut self, record: McapRecord<'_>) -> Option<Message> {
        match record {
            McapRecord::Channel(channel) if channel.topic == RAW_TOPIC && channel.message_encoding == RAW_ENCODING => {
                self.raw.insert(channel.id);
            }
            McapRecord::Channel(channel) if channel.topic == MARKER_TOPIC && channel.message_encoding == "json" => {
                self.markers.insert(channel.id);
            }
            McapRecord::Metadata(metadata) => {
                self.metadata.insert(metadata.name, metadata.metadata);
            }
            McapRecord::Message { header, data } if self.raw.contains(&header.channel_id) => {
                let time_ns = header.log_time;
                let (first, _) = self.span_ns.unwrap_or((time_ns, time_ns));
                self.span_ns = Some((first, time_ns));
                self.bytes.clear();
                self.bytes.extend_from_slice(&data);
                return Some(Message::Raw { time_ns, part: header.channel_id });
            }
            McapRecord::Message { header, data } if self.markers.contains(&header.channel_id) => {
                let MarkerJson { t_ns, text } = serde_json::from_slice(&data).ok()?;
                return Some(Message::Marker { time_ns: t_ns, text });
            }
            _ => {}
        }
        None
    }
}

/// Splits the bytes of messages into frames.
#[derive(Default)]
pub(super) struct Framing {
    reader: FrameReader<Record>,
    part: Option<u16>,
}

impl Framing {
    /// Emits the frames in the bytes of one message.
    pub(super) fn take(&mut self, part: u16, bytes: &[u8], mut found: impl FnMut(Frame<Record>)) {
        // Sequence numbers do not continue from one stream to the next.
        if self.part.replace(part).is_some_and(|before| before != part) {
            self.reader.reset();
        }
        // A broken link leaves half a frame: end it here, so that it does not spoil the next one.
        let end: &[u8] = if bytes.ends_with(&[DELIMITER]) { &[] } else { &[DELIMITER] };
        for mut input in [bytes, end] {
            while let Some(frame) = self.reader.read(&mut input) {
                found(frame);
            }
        }
    }

    /// Frames, and what was lost or damaged among them.
    pub(super) fn counts(&self) -> inerter_wire::Counts {
        *self.reader.counts()
    }
}
