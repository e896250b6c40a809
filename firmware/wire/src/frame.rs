//! Encodes messages into frames, and decodes them whatever happened on the way.
//!
//! - *body*: payload, sequence number (u16, little-endian), CRC-32 of both (ISO-HDLC, little-endian; of a request its
//!   complement).
//! - *frame*: the body in COBS, which leaves no zero in it, and the delimiter, one zero.
//!
//! A frame is accepted only if it can be unstuffed, its CRC agrees and its payload decodes to the last byte; damage
//! passes as another message with a chance of 2^-32 per damaged frame. The sequence number counts every frame that the
//! sender meant to send, so a jump is the number of frames lost. A step backwards cannot come from a wire, which keeps
//! the order and repeats nothing: it means that the sender restarted.
//!
//! The complement separates the directions: a terminal that echoes, as one just opened does on Linux, sends a device
//! its own records back, and none of them is a valid request, whatever its content.

use crate::{Command, Crc32, Event, EventKind, Record, Request, WIRE_VERSION};
use core::fmt;
use core::marker::PhantomData;
use heapless::Vec;
use postcard::ser_flavors::{Cobs, Flavor, Slice};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// Longest payload (bytes).
pub const MAX_PAYLOAD: usize = 512;

/// Sequence number and CRC (bytes).
const TRAILER: usize = 2 + 4;

/// Longest body (bytes).
const MAX_BODY: usize = MAX_PAYLOAD + TRAILER;

/// Longest frame with its delimiter (bytes): a send buffer of this size always suffices.
pub const MAX_FRAME: usize = cobs::max_encoding_length(MAX_BODY) + 1;

/// Ends every frame. A sender also writes one before its first frame and after a frame that it could not finish, so
/// that the fragment does not damage the next frame.
pub const DELIMITER: u8 = 0;

/// What can travel in a frame: [`Record`] and [`Request`].
pub trait Message: Serialize + DeserializeOwned {
    /// The frame's CRC-32 is combined with this by exclusive or, so that no other kind of message has the same CRC.
    const SALT: u32;

    /// Whether only a sender that has just started sends this message with this number.
    fn starts_stream(&self, sequence: u16) -> bool;

    /// What the head of a payload shows, whatever version it comes from.
    fn peek(payload: &[u8]) -> Option<Peek>;
}

/// What the head of a payload shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Peek {
    /// Number of the record or command.
    pub number: u32,
    /// The request's id.
    pub request: Option<u16>,
    /// The sender's wire version, when this is its Hello.
    pub wire_version: Option<u16>,
}

impl Message for Record {
    const SALT: u32 = 0;

    fn starts_stream(&self, sequence: u16) -> bool {
        match self {
            Self::Event(Event { kind: EventKind::Started, .. }) => true,
            Self::Hello(_) => sequence == 0,
            _ => false,
        }
    }

    fn peek(payload: &[u8]) -> Option<Peek> {
        let (number, rest) = postcard::take_from_bytes::<u32>(payload).ok()?;
        let wire_version =
            if number == 0 { postcard::take_from_bytes::<u16>(rest).ok().map(|(version, _)| version) } else { None };
        Some(Peek { number, request: None, wire_version })
    }
}

impl Message for Request {
    const SALT: u32 = u32::MAX;

    fn starts_stream(&self, sequence: u16) -> bool {
        sequence == 0 && matches!(self.command, Command::Hello)
    }

    fn peek(payload: &[u8]) -> Option<Peek> {
        let ((id, number), _) = postcard::take_from_bytes::<(u16, u32)>(payload).ok()?;
        Some(Peek { number, request: Some(id), wire_version: None })
    }
}

/// Numbers the frames of one sender, from 0, wrapping at 2^16.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SequenceCounter(u16);

impl SequenceCounter {
    /// Starts at 0.
    pub const fn new() -> Self {
        Self(0)
    }

    /// The number for the next frame. Take it whether the frame is then sent or dropped: the gap shows the loss to the
    /// other end.
    pub fn take(&mut self) -> u16 {
        let sequence = self.0;
        self.0 = sequence.wrapping_add(1);
        sequence
    }
}

/// Why a message could not be put into a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EncodeError {
    /// The frame does not fit the buffer; one of [`MAX_FRAME`] bytes always suffices.
    BufferTooSmall,
    /// The payload is longer than [`MAX_PAYLOAD`].
    TooLong,
}

impl fmt::Display for EncodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::BufferTooSmall => write!(f, "the frame does not fit the buffer: give it {MAX_FRAME} bytes"),
            Self::TooLong => write!(f, "the message is longer than {MAX_PAYLOAD} bytes: split it"),
        }
    }
}

impl core::error::Error for EncodeError {}

/// Stuffs bytes and computes their CRC on the way from postcard to the buffer.
struct Body<'a> {
    stuffed: Cobs<Slice<'a>>,
    digest: Crc32,
    salt: u32,
    room: usize,
}

impl<'a> Flavor for Body<'a> {
    type Output = &'a mut [u8];

    fn try_push(&mut self, byte: u8) -> postcard::Result<()> {
        self.try_extend(&[byte])
    }

    fn try_extend(&mut self, bytes: &[u8]) -> postcard::Result<()> {
        self.room = self.room.checked_sub(bytes.len()).ok_or(postcard::Error::SerializeBufferFull)?;
        self.digest.update(bytes);
        bytes.iter().try_for_each(|&byte| self.stuffed.try_push(byte))
    }

    fn finalize(mut self) -> postcard::Result<&'a mut [u8]> {
        for byte in (self.digest.value() ^ self.salt).to_le_bytes() {
            self.stuffed.try_push(byte)?;
        }
        self.stuffed.finalize()
    }
}

/// Writes the frame of `message` with its delimiter to the front of `out`; returns its length.
///
/// On an error the content of `out` is unspecified.
///
/// ```
/// # use inerter_wire::{DELIMITER, Event, EventKind, MAX_FRAME, Record, SequenceCounter, encode};
/// let mut sequence = SequenceCounter::new();
/// let mut out = [0; MAX_FRAME];
/// let record = Record::Event(Event { index: 300, kind: EventKind::SourceEnded });
/// let length = encode(&record, sequence.take(), &mut out)?;
/// assert_eq!(out.get(..length), Some(&[5, 4, 0xAC, 2, 1, 1, 5, 0x9E, 0x33, 0x4F, 0x34, DELIMITER][..]));
/// # Ok::<(), inerter_wire::EncodeError>(())
/// ```
pub fn encode<T: Message>(message: &T, sequence: u16, out: &mut [u8]) -> Result<usize, EncodeError> {
    let error = if out.len() < MAX_FRAME { EncodeError::BufferTooSmall } else { EncodeError::TooLong };
    write(message, sequence, out).map_err(|_| error)
}

fn write<T: Message>(message: &T, sequence: u16, out: &mut [u8]) -> postcard::Result<usize> {
    let stuffed = Cobs::try_new(Slice::new(out))?;
    let body = Body { stuffed, digest: Crc32::new(), salt: T::SALT, room: MAX_PAYLOAD };
    let mut serializer = postcard::Serializer { output: body };
    message.serialize(&mut serializer)?;
    let mut body = serializer.output;
    body.room = 2;
    body.try_extend(&sequence.to_le_bytes())?;
    Ok(body.finalize()?.len())
}

/// [`encode`] for a device.
pub fn encode_record(record: &Record, sequence: u16, out: &mut [u8]) -> Result<usize, EncodeError> {
    encode(record, sequence, out)
}

/// [`encode`] for a host.
pub fn encode_request(request: &Request, sequence: u16, out: &mut [u8]) -> Result<usize, EncodeError> {
    encode(request, sequence, out)
}

/// Writes the frame of the same payload with another number, for passing frames on; the payload need not be understood.
/// `frame` is without its delimiter, as [`FrameReader::frame_bytes`] gives it; its CRC is not checked. Returns the
/// length; `None` if `frame` is no frame or does not fit `out`: [`MAX_FRAME`] bytes always suffice.
pub fn renumber<T: Message>(frame: &[u8], sequence: u16, out: &mut [u8]) -> Option<usize> {
    let mut body = [0; MAX_BODY];
    let length = cobs::decode(frame, &mut body).ok()?;
    let (payload, _) = body.get(..length)?.split_last_chunk::<TRAILER>()?;
    let stuffed = Cobs::try_new(Slice::new(out)).ok()?;
    let mut written = Body { stuffed, digest: Crc32::new(), salt: T::SALT, room: MAX_PAYLOAD + 2 };
    written.try_extend(payload).ok()?;
    written.try_extend(&sequence.to_le_bytes()).ok()?;
    Some(written.finalize().ok()?.len())
}

/// What [`FrameReader::read`] found.
#[derive(Clone, Debug, PartialEq)]
pub enum Frame<T> {
    /// An intact message.
    Message {
        /// Number of its frame.
        sequence: u16,
        /// The message.
        message: T,
    },
    /// This many frames are missing before the next one.
    Lost {
        /// Missing frames, at least 1.
        frames: u16,
    },
    /// The sender restarted before the next frame; what was lost meanwhile is unknown.
    Restarted,
    /// A frame arrived damaged and was dropped.
    Corrupt(Corruption),
    /// An intact frame contains something that this version does not know, because the sender is newer. It was left
    /// out.
    Unknown {
        /// Number of its frame.
        sequence: u16,
        /// Number of the record or command; unknown itself, or known with unknown content.
        number: u32,
        /// The request's id, so that a device can refuse it.
        request: Option<u16>,
    },
    /// The sender uses another wire version: nothing it sends is decoded until a Hello in ours.
    ForeignVersion {
        /// Number of its frame.
        sequence: u16,
        /// The version it uses.
        wire_version: u16,
    },
}

/// How a frame was damaged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Corruption {
    /// No delimiter within [`MAX_FRAME`] bytes.
    TooLong,
    /// Too short for a message.
    TooShort,
    /// The zero stuffing is broken.
    Stuffing,
    /// The CRC does not agree.
    Checksum,
    /// The CRC agrees, but the payload is not a message: the sender is at fault.
    Malformed,
}

impl fmt::Display for Corruption {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::TooLong => "no frame end where one is due",
            Self::TooShort => "frame too short for a message",
            Self::Stuffing => "frame with broken zero stuffing",
            Self::Checksum => "frame with a wrong CRC-32",
            Self::Malformed => "intact frame that holds no message",
        })
    }
}

/// What a [`FrameReader`] has seen since it was made. Counters stop at their greatest value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Messages handed out.
    pub messages: u32,
    /// Frames missing according to the sequence numbers. This includes frames that arrived damaged, except for
    /// malformed ones, whose number is known.
    pub lost: u32,
    /// Times the sender restarted.
    pub restarts: u32,
    /// Frames dropped as [`Corruption::TooLong`].
    pub too_long: u32,
    /// Frames dropped as [`Corruption::TooShort`].
    pub too_short: u32,
    /// Frames dropped as [`Corruption::Stuffing`].
    pub stuffing: u32,
    /// Frames dropped as [`Corruption::Checksum`].
    pub checksum: u32,
    /// Frames dropped as [`Corruption::Malformed`].
    pub malformed: u32,
    /// Intact frames left out because they contain something unknown.
    pub unknown: u32,
    /// Intact frames left out because the sender uses another wire version.
    pub foreign: u32,
}

impl Counts {
    /// Frames dropped as damaged, of all kinds.
    pub fn corrupt(&self) -> u32 {
        [self.too_short, self.stuffing, self.checksum, self.malformed]
            .into_iter()
            .fold(self.too_long, u32::saturating_add)
    }
}

fn count(counter: &mut u32) {
    *counter = counter.saturating_add(1);
}

/// Finds messages in a stream of bytes that arrives in portions of any size.
///
/// Takes about [`MAX_FRAME`] bytes, and as much again on the stack while it reads.
///
/// ```
/// # use inerter_wire::{Command, Frame, FrameReader, MAX_FRAME, Request, encode_request};
/// # let mut out = [0; MAX_FRAME];
/// # let length = encode_request(&Request { id: 1, command: Command::Hello }, 0, &mut out).unwrap();
/// # let received = &out[..length];
/// let mut reader = FrameReader::<Request>::new();
/// let mut input: &[u8] = received;
/// while let Some(frame) = reader.read(&mut input) {
///     match frame {
///         Frame::Message { message, .. } => assert_eq!(message.command, Command::Hello),
///         other => panic!("{other:?}"),
///     }
/// }
/// ```
#[derive(Clone, Debug)]
pub struct FrameReader<T> {
    frame: Vec<u8, { MAX_FRAME - 1 }>,
    overlong: bool,
    stage: Stage,
    expected: Option<u16>,
    foreign: Option<u16>,
    counts: Counts,
    messages: PhantomData<fn() -> T>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Stage {
    /// Collecting the bytes of a frame.
    Collecting,
    /// The frame's loss or restart was reported; the frame itself comes next.
    Announced,
    /// The frame was handed out; its bytes are kept until the next one begins.
    Reported,
}

impl<T: Message> FrameReader<T> {
    /// A reader at the beginning of a stream, or anywhere in it.
    pub const fn new() -> Self {
        Self {
            frame: Vec::new(),
            overlong: false,
            stage: Stage::Collecting,
            expected: None,
            foreign: None,
            counts: Counts {
                messages: 0,
                lost: 0,
                restarts: 0,
                too_long: 0,
                too_short: 0,
                stuffing: 0,
                checksum: 0,
                malformed: 0,
                unknown: 0,
                foreign: 0,
            },
            messages: PhantomData,
        }
    }

    /// Takes bytes off the front of `input` up to the next finding. `None`: `input` is used up, and more is needed.
    ///
    /// Call it until `None`. What it finds does not depend on how the stream was cut into portions.
    pub fn read(&mut self, input: &mut &[u8]) -> Option<Frame<T>> {
        if self.stage == Stage::Announced {
            self.stage = Stage::Reported;
            return Some(self.interpret(true));
        }
        while !input.is_empty() {
            if self.stage == Stage::Reported {
                self.frame.clear();
                self.overlong = false;
                self.stage = Stage::Collecting;
            }
            let end = input.iter().position(|&byte| byte == DELIMITER);
            let (part, rest) = input.split_at_checked(end.unwrap_or(input.len())).unwrap_or((input, &[]));
            let fitting = part.len().min(self.frame.capacity() - self.frame.len());
            self.overlong |= fitting < part.len();
            self.frame.extend_from_slice(part.get(..fitting).unwrap_or_default()).ok();
            *input = rest.get(1..).unwrap_or_default();
            if end.is_some() && !self.frame.is_empty() {
                self.stage = Stage::Reported;
                return Some(self.interpret(false));
            }
        }
        None
    }

    /// The stuffed bytes of the frame last reported, without delimiter, until the next call of [`read`](Self::read);
    /// of an overlong one, its beginning. Recordings keep these.
    pub fn frame_bytes(&self) -> &[u8] {
        if self.stage == Stage::Collecting { &[] } else { &self.frame }
    }

    /// Bytes of a frame that has begun and not ended; at the end of a recording, what was cut off.
    pub fn unfinished(&self) -> usize {
        if self.stage == Stage::Collecting { self.frame.len() } else { 0 }
    }

    /// What was seen so far.
    pub fn counts(&self) -> &Counts {
        &self.counts
    }

    /// Forgets the position in the stream, for a link that was opened again. The counts stay.
    pub fn reset(&mut self) {
        let counts = self.counts;
        *self = Self { counts, ..Self::new() };
    }

    fn interpret(&mut self, announced: bool) -> Frame<T> {
        let mut body = [0; MAX_BODY];
        let (payload, sequence) = match self.open(&mut body) {
            Ok(parts) => parts,
            Err(corruption) => return self.corrupt(corruption),
        };
        let content = self.content(payload, sequence);
        if !announced {
            let restarted = matches!(&content, Frame::Message { message, .. } if message.starts_stream(sequence));
            let jump = self.expected.map_or(0, |expected| sequence.wrapping_sub(expected));
            if jump > u16::MAX / 2 || (restarted && jump != 0) {
                self.stage = Stage::Announced;
                self.expected = Some(sequence);
                count(&mut self.counts.restarts);
                return Frame::Restarted;
            }
            if jump > 0 {
                self.stage = Stage::Announced;
                self.expected = Some(sequence);
                self.counts.lost = self.counts.lost.saturating_add(u32::from(jump));
                return Frame::Lost { frames: jump };
            }
        }
        self.expected = Some(sequence.wrapping_add(1));
        match content {
            Frame::Message { .. } => count(&mut self.counts.messages),
            Frame::Unknown { .. } => count(&mut self.counts.unknown),
            Frame::ForeignVersion { .. } => count(&mut self.counts.foreign),
            Frame::Corrupt(corruption) => return self.corrupt(corruption),
            Frame::Lost { .. } | Frame::Restarted => {}
        }
        content
    }

    /// Payload and sequence number of the collected frame.
    fn open<'b>(&self, body: &'b mut [u8; MAX_BODY]) -> Result<(&'b [u8], u16), Corruption> {
        if self.overlong {
            return Err(Corruption::TooLong);
        }
        let length = cobs::decode(&self.frame, body).map_err(|error| match error {
            cobs::DecodeError::TargetBufTooSmall => Corruption::TooLong,
            _ => Corruption::Stuffing,
        })?;
        let body = body.get(..length).ok_or(Corruption::TooLong)?;
        let (summed, crc) = body.split_last_chunk::<4>().ok_or(Corruption::TooShort)?;
        let (payload, sequence) = summed.split_last_chunk::<2>().ok_or(Corruption::TooShort)?;
        if payload.is_empty() {
            return Err(Corruption::TooShort);
        }
        if Crc32::of(summed) ^ T::SALT != u32::from_le_bytes(*crc) {
            return Err(Corruption::Checksum);
        }
        Ok((payload, u16::from_le_bytes(*sequence)))
    }

    /// What an intact payload means.
    fn content(&mut self, payload: &[u8], sequence: u16) -> Frame<T> {
        let Some(Peek { number, request, wire_version }) = T::peek(payload) else {
            return Frame::Corrupt(Corruption::Malformed);
        };
        if let Some(version) = wire_version {
            self.foreign = (version != WIRE_VERSION).then_some(version);
        }
        if let Some(wire_version) = self.foreign {
            return Frame::ForeignVersion { sequence, wire_version };
        }
        match postcard::take_from_bytes::<T>(payload) {
            Ok((message, [])) => Frame::Message { sequence, message },
            // serde's own error: a variant or a length that this version's types do not have.
            Err(postcard::Error::SerdeDeCustom) => Frame::Unknown { sequence, number, request },
            _ => Frame::Corrupt(Corruption::Malformed),
        }
    }

    fn corrupt(&mut self, corruption: Corruption) -> Frame<T> {
        let counts = &mut self.counts;
        count(match corruption {
            Corruption::TooLong => &mut counts.too_long,
            Corruption::TooShort => &mut counts.too_short,
            Corruption::Stuffing => &mut counts.stuffing,
            Corruption::Checksum => &mut counts.checksum,
            Corruption::Malformed => &mut counts.malformed,
        });
        Frame::Corrupt(corruption)
    }
}

impl<T: Message> Default for FrameReader<T> {
    fn default() -> Self {
        Self::new()
    }
}
