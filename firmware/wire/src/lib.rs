//! Encodes and decodes the records and commands of the inerter's stream.
//!
//! A *record* goes from device to host, a *request* (a command with an id) from host to device. Each travels alone in
//! a *frame*: `COBS(payload ++ sequence ++ CRC-32)` and one zero byte, where the payload is the postcard form of
//! [`Record`] or [`Request`]. `docs/PROTOCOL.md` is the specification and is checked against this crate.
//!
//! - [`encode_record`], [`encode_request`]: a value to a frame; [`SequenceCounter`] numbers frames; [`renumber`] passes
//!   a frame on.
//! - [`FrameReader`]: bytes in any portions to values, losses and faults; resynchronises after any damage.
//! - [`Samples`], [`SamplesBuilder`]: batches of raw samples in few bytes.
//! - [`SettingsValues`]: settings as numbered values, so that old and new ends understand each other.
//! - [`Measured`]: what a board measured of itself, as numbered figures.
//! - [`Crc32`]: the checksum of frames, also for data that a device keeps.
//! - [`EstimatorEvent`]: an event of an estimator, in a replay or in a device; [`Pairing`] makes events from records.
//! - [`catalogue`]: name, label, symbol and unit of every number that a view can show.
//! - [`protocol`]: the tables of records and commands that the documents are made from.
//!
//! No input can cause a panic or an allocation. A frame that is damaged anywhere is dropped and counted.
#![no_std]

pub mod catalogue;
mod command;
mod crc;
mod event;
mod forms;
mod frame;
mod measured;
mod messages;
mod play;
pub mod protocol;
mod record;
mod refusal;
mod samples;
mod settings;

pub use command::{Command, Request, Streams};
pub use crc::Crc32;
pub use event::{Estimated, EstimatorEvent, Pairing, step};
pub use frame::{
    Corruption, Counts, DELIMITER, EncodeError, Frame, FrameReader, MAX_FRAME, MAX_PAYLOAD, Message, Peek,
    SequenceCounter, encode, encode_record, encode_request, renumber,
};
pub use measured::{Figure, MAX_FIGURES, Measure, Measured, Quantity};
pub use messages::{VersionAdvice, WIRE_VERSION};
pub use play::{Knot, Play};
pub use record::{
    Capabilities, ClockSource, Done, Event, EventKind, Fault, Health, Hello, Record, Reply, ResetCause, Source, Text,
};
pub use refusal::{Refusal, SettingFault};
pub use samples::{DecodeError, Full, Iter, Samples, SamplesBuilder};
pub use settings::{MAX_SETTINGS, Reading, SettingValue, SettingsValues};
