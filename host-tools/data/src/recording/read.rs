//! Reading a recording, complete or truncated, frame by frame.

use std::{collections::BTreeMap, io::Read, path::Path};

use inerter_wire::{Counts, Frame, Record};

use super::{
    RecordingError,
    layout::Ending,
    messages::{Framing, Message, Messages},
};

/// One finding in the file with the host time \[ns\] at which it arrived.
#[derive(Debug)]
pub struct Incoming {
    /// Host time \[ns\].
    pub time_ns: u64,
    /// Bytes of the file read so far.
    pub offset: u64,
    /// What was found.
    pub item: Item,
}

/// What a recording holds, in the order in which it came.
#[derive(Debug)]
#[allow(clippy::large_enum_variant, reason = "nearly all are frames")]
pub enum Item {
    /// Something in the stream.
    Frame(Frame<Record>),
    /// A remark made during the recording.
    Marker(String),
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
    read_all(Messages::open(path)?, take)
}

/// Reads any bytes; `file` is their name in messages.
#[cfg(test)]
pub(super) fn read_from(file: &str, source: impl Read, take: impl FnMut(Incoming)) -> Result<Contents, RecordingError> {
    read_all(Messages::new(file, source), take)
}

fn read_all(mut messages: Messages<impl Read>, mut take: impl FnMut(Incoming)) -> Result<Contents, RecordingError> {
    let mut framing = Framing::default();
    loop {
        let offset = messages.offset();
        match messages.next()? {
            None => break,
            Some(Message::Raw { time_ns, part, bytes }) => {
                framing.take(part, bytes, |frame| take(Incoming { time_ns, offset, item: Item::Frame(frame) }));
            }
            Some(Message::Marker { time_ns, text }) => take(Incoming { time_ns, offset, item: Item::Marker(text) }),
        }
    }
    let (ending, span_ns, bytes) = (messages.ending(), messages.span_ns(), messages.offset());
    Ok(Contents { metadata: messages.metadata(), ending, counts: framing.counts(), span_ns, bytes })
}

#[cfg(test)]
#[path = "read_tests.rs"]
mod tests;
