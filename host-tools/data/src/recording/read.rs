//! Reading a recording, complete or truncated, frame by frame.

use std::{collections::BTreeMap, io::Read, path::Path};

use inerter_wire::{Counts, Frame, Record};

use super::{
    RecordingError,
    layout::Ending,
    messages::{Framing, Known, Message, Messages},
};

/// A frame or marker in the file with the host time \[ns\] at which it arrived.
#[derive(Debug)]
pub struct Incoming {
    /// Host time \[ns\].
    pub time_ns: u64,
    /// Bytes of the file read so far.
    pub offset: u64,
    /// The frame or marker.
    pub item: Item,
}

/// The contents of a recording, in order of arrival.
#[derive(Debug)]
#[allow(clippy::large_enum_variant, reason = "nearly all are frames")]
pub enum Item {
    /// A frame, or a loss, in the stream.
    Frame(Frame<Record>),
    /// A remark made during the recording.
    Marker(String),
}

/// What a file holds besides its frames.
#[derive(Clone, Debug, Default)]
pub struct Contents {
    /// Metadata by name.
    pub metadata: BTreeMap<String, BTreeMap<String, String>>,
    /// How the file ends.
    pub ending: Ending,
    /// Frames, and what was lost or damaged among them.
    pub counts: Counts,
    /// Host time of the first and the last frame \[ns\].
    pub span_ns: Option<(u64, u64)>,
    /// Bytes of the file that were read.
    pub bytes: u64,
}

/// Reads a file; `take` gets every item in order.
pub fn read(path: &Path, take: impl FnMut(Incoming)) -> Result<Contents, RecordingError> {
    read_all(Messages::open(path)?, take)
}

fn read_all(mut messages: Messages<impl Read>, mut take: impl FnMut(Incoming)) -> Result<Contents, RecordingError> {
    let mut framing = Framing::default();
    loop {
        let offset = messages.offset();
        match messages.next()? {
            None => break,
            Some(Message::Raw { time_ns, part }) => {
                framing
                    .take(part, messages.bytes(), |frame| take(Incoming { time_ns, offset, item: Item::Frame(frame) }));
            }
            Some(Message::Marker { time_ns, text }) => take(Incoming { time_ns, offset, item: Item::Marker(text) }),
        }
    }
    let bytes = messages.offset();
    let Messages { known: Known { metadata, span_ns, .. }, ending, .. } = messages;
    Ok(Contents { metadata, ending: ending.unwrap_or_default(), counts: framing.counts(), span_ns, bytes })
}

#[cfg(test)]
#[path = "read_tests.rs"]
mod tests;
