//! Shares one device's link among several hosts on a TCP port. Never blocks.
//!
//! Terms:
//! - *reader*: a connected host. Nothing is sent to it before its first valid request.
//! - *controller*: the reader that spoke first. Its requests go to the device; when it leaves, the oldest other reader
//!   that has spoken takes over.
//!
//! Every reader receives what the device sends, in frames that are renumbered for each reader. `Hello`, `ReadSettings`
//! and `Streams` are answered here, so that each reader learns what it needs and gets the streams that it chose; any
//! other request is refused with [`Refusal::Busy`] unless it comes from the controller. A single slow reader delays the
//! device's link, as a host at a cable does. Among several readers, frames that one does not accept are dropped for
//! that reader, which detects the loss from the sequence numbers. So no reader delays another, and none uses more than
//! 1 MiB.

use std::{
    collections::VecDeque,
    io::{self, Read, Write},
    net::{SocketAddr, TcpListener, TcpStream},
};

use inerter_app::App;
use inerter_wire::{
    Command, DELIMITER, Done, Event, EventKind, Frame, FrameReader, Hello, MAX_FRAME, Record, Refusal, Reply, Request,
    SequenceCounter, SettingsValues, Streams, encode_record, encode_request, renumber,
};

/// Maximum number of readers. A further one takes the place of the oldest that has not spoken; if all have spoken, its
/// connection is closed.
pub const MOST_READERS: usize = 16;
/// Bytes queued for one of several readers: at least ten seconds at 4 kHz.
const MOST_WAITING: usize = 1 << 20;
/// Bytes queued for a single reader before the device has to wait.
const MOST_WAITING_ALONE: usize = 1 << 14;
/// Bytes queued for the device before reading from the controller stops.
const MOST_UPSTREAM: usize = 1 << 14;
/// Maximum requests whose reply is pending; beyond that the oldest replies are lost.
const MOST_ASKED: usize = 256;
/// Bytes read from a reader at once.
const READ: usize = 4096;
/// Id of our own requests; hosts never use it.
const OWN_ID: u16 = 0;

/// A connected host.
struct Reader {
    number: u64,
    stream: TcpStream,
    requests: Box<FrameReader<Request>>,
    sequence: SequenceCounter,
    streams: Streams,
    has_spoken: bool,
    waiting: VecDeque<u8>,
    is_gone: bool,
}

/// The device's link, shared.
pub struct Share {
    listener: TcpListener,
    readers: Vec<Reader>,
    next_number: u64,
    /// Whether readers may control the device at all.
    may_control: bool,
    controller: Option<u64>,
    /// The device's identity and its settings, as last reported. Requests wait until both are known.
    hello: Option<Hello>,
    settings: Option<SettingsValues>,
    records: Box<FrameReader<Record>>,
    upstream: VecDeque<u8>,
    sequence: SequenceCounter,
    /// Requests sent to the device, and the readers that they belong to.
    asked: VecDeque<(u16, u64)>,
}

impl Share {
    /// For a device that readers control: all streams are requested when it starts.
    pub fn controlled(address: &str) -> io::Result<Self> {
        Self::listen(address, true)
    }

    /// For a device that this program controls: readers can only watch.
    pub fn watched(address: &str) -> io::Result<Self> {
        Self::listen(address, false)
    }

    fn listen(address: &str, may_control: bool) -> io::Result<Self> {
        let listener = TcpListener::bind(address)?;
        listener.set_nonblocking(true)?;
        Ok(Self {
            listener,
            readers: Vec::new(),
            next_number: 0,
            may_control,
            controller: None,
            hello: None,
            settings: None,
            records: Box::new(FrameReader::new()),
            upstream: VecDeque::new(),
            sequence: SequenceCounter::new(),
            asked: VecDeque::new(),
        })
    }

    /// The address it listens at, with the actual port number.
    pub fn address(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Processes the readers' requests, sends queued data, and accepts new readers. Must be called often.
    pub fn turn(&mut self) {
        if self.hello.is_some() && self.settings.is_some() {
            // The oldest first: a controller that has just left must not delay the next one.
            for place in 0..self.readers.len() {
                self.hear(place);
            }
        }
        self.readers.iter_mut().for_each(Reader::flush);
        self.dismiss_controller();
        self.readers.retain(|reader| !reader.is_gone);
        // A host that reconnects again and again must not delay the device.
        for _ in 0..MOST_READERS {
            let Ok((stream, _)) = self.listener.accept() else { break };
            let ready = stream.set_nonblocking(true).and_then(|()| stream.set_nodelay(true));
            if self.readers.len() == MOST_READERS
                && let Some(mute) = self.readers.iter().position(|reader| !reader.has_spoken)
            {
                self.readers.remove(mute);
            }
            if self.readers.len() < MOST_READERS && ready.is_ok() {
                self.readers.push(Reader::new(self.next_number, stream));
                self.next_number += 1;
            }
        }
    }

    /// Whether the device should wait because its only reader is too slow.
    pub fn is_full(&self) -> bool {
        let mut speakers = self.readers.iter().filter(|reader| reader.has_spoken);
        match (speakers.next(), speakers.next()) {
            (Some(alone), None) => alone.waiting.len() > MOST_WAITING_ALONE,
            _ => false,
        }
    }

    /// Requests for the device; 0 bytes if there are none.
    pub fn requests(&mut self, into: &mut [u8]) -> usize {
        self.upstream.read(into).unwrap_or(0)
    }

    /// Passes the device's data to all readers that want them.
    pub fn relay(&mut self, mut bytes: &[u8]) {
        while let Some(frame) = self.records.read(&mut bytes) {
            let stuffed = self.records.frame_bytes();
            match &frame {
                Frame::Message { message: Record::Reply(reply), .. } => {
                    if let Some(place) = self.asked.iter().position(|(id, _)| *id == reply.id)
                        && let Some((_, number)) = self.asked.remove(place)
                    {
                        let reader = self.readers.iter_mut().find(|reader| reader.number == number);
                        reader.into_iter().for_each(|reader| reader.pass(stuffed));
                    }
                    continue;
                }
                Frame::Message { message, .. } => {
                    let wanted = |reader: &&mut Reader| wants(reader.streams, message);
                    self.readers.iter_mut().filter(wanted).for_each(|reader| reader.pass(stuffed));
                }
                // Records that a newer firmware sends with its estimates.
                Frame::Unknown { .. } => {
                    let wanted = |reader: &&mut Reader| reader.streams.estimates;
                    self.readers.iter_mut().filter(wanted).for_each(|reader| reader.pass(stuffed));
                }
                Frame::Lost { frames } => self.readers.iter_mut().for_each(|reader| reader.miss(*frames)),
                Frame::Restarted | Frame::Corrupt(_) | Frame::ForeignVersion { .. } => {}
            }
            if let Frame::Message { message, .. } = frame {
                self.note(message);
            }
        }
        self.readers.iter_mut().for_each(Reader::flush);
    }

    /// The device is away: disconnects the readers; new ones wait.
    pub fn forget(&mut self) {
        self.readers.clear();
        self.controller = None;
        self.hello = None;
        self.settings = None;
        self.asked.clear();
        *self.records = FrameReader::new();
    }

    /// Stores what later readers must know.
    fn note(&mut self, record: Record) {
        match record {
            Record::Hello(hello) => self.hello = Some(hello),
            Record::Settings(values) => {
                let settings = values.read(&inerter_core::Settings::default()).settings;
                if let Some(hello) = &mut self.hello {
                    hello.sample_rate_hz = settings.sample_rate_hz;
                }
                self.settings = Some(values);
            }
            Record::Event(Event { kind: EventKind::Started, .. }) => {
                self.readers.iter_mut().for_each(|reader| reader.streams = App::FIRST_STREAMS);
                self.asked.clear();
                if self.may_control {
                    self.ask(Command::Streams(Streams::ALL));
                    self.ask(Command::ReadSettings);
                }
            }
            _ => {}
        }
    }

    /// Sends the device a request of our own.
    fn ask(&mut self, command: Command) {
        let mut out = [0; MAX_FRAME];
        if let Ok(length) = encode_request(&Request { id: OWN_ID, command }, self.sequence.take(), &mut out) {
            self.upstream.extend(out.iter().take(length));
        }
    }

    /// Processes the requests of one reader.
    fn hear(&mut self, place: usize) {
        let Some(reader) = self.readers.get_mut(place) else { return };
        let number = reader.number;
        if self.controller == Some(number) && self.upstream.len() > MOST_UPSTREAM {
            return;
        }
        let mut buffer = [0; READ];
        let mut input = match reader.stream.read(&mut buffer) {
            Ok(count @ 1..) => buffer.get(..count).unwrap_or_default(),
            Err(error) if is_wait(&error) => return,
            Ok(_) | Err(_) => {
                reader.is_gone = true;
                self.dismiss_controller();
                return;
            }
        };
        let mut found = Vec::new();
        while let Some(frame) = reader.requests.read(&mut input) {
            found.push((frame, reader.requests.frame_bytes().to_vec()));
        }
        for (frame, stuffed) in found {
            match frame {
                Frame::Message { message, .. } => self.serve(place, message.id, Some(message.command), &stuffed),
                Frame::Unknown { request: Some(id), .. } => self.serve(place, id, None, &stuffed),
                // Passed on, so that the device counts it.
                Frame::Corrupt(_) if self.controller == Some(number) => {
                    self.upstream.extend(stuffed.iter().chain([&DELIMITER]));
                }
                _ => {}
            }
        }
    }

    fn serve(&mut self, place: usize, id: u16, command: Option<Command>, stuffed: &[u8]) {
        let Some(reader) = self.readers.get_mut(place) else { return };
        reader.has_spoken = true;
        let controls = self.may_control && *self.controller.get_or_insert(reader.number) == reader.number;
        let result = match (command, &self.hello, &self.settings) {
            (Some(Command::Streams(streams)), ..) => {
                reader.streams = streams;
                Ok(Done::Plain)
            }
            (Some(Command::Hello), Some(hello), _) => {
                reader.say(&Record::Hello(hello.clone()));
                Ok(Done::Plain)
            }
            _ if controls => {
                let mut out = [0; MAX_FRAME];
                if let Some(length) = renumber::<Request>(stuffed, self.sequence.take(), &mut out) {
                    self.upstream.extend(out.iter().take(length));
                    self.asked.push_back((id, reader.number));
                    if self.asked.len() > MOST_ASKED {
                        self.asked.pop_front();
                    }
                }
                return;
            }
            (Some(Command::ReadSettings), _, Some(settings)) => {
                reader.say(&Record::Settings(settings.clone()));
                Ok(Done::Plain)
            }
            _ => Err(Refusal::Busy),
        };
        reader.say(&Record::Reply(Reply { id, result }));
    }

    /// Passes control on if the controller has left.
    fn dismiss_controller(&mut self) {
        let is_here = |number| self.readers.iter().any(|reader| reader.number == number && !reader.is_gone);
        if self.controller.is_some_and(|number| !is_here(number)) {
            let next = self.readers.iter().find(|reader| reader.has_spoken && !reader.is_gone);
            self.controller = next.map(|reader| reader.number);
        }
    }
}

impl Reader {
    fn new(number: u64, stream: TcpStream) -> Self {
        Self {
            number,
            stream,
            requests: Box::new(FrameReader::new()),
            sequence: SequenceCounter::new(),
            streams: App::FIRST_STREAMS,
            has_spoken: false,
            waiting: VecDeque::new(),
            is_gone: false,
        }
    }

    /// Sends a record of our own.
    fn say(&mut self, record: &Record) {
        self.put(|sequence, out| encode_record(record, sequence, out).ok());
    }

    /// Passes on a frame of the device.
    fn pass(&mut self, stuffed: &[u8]) {
        if self.has_spoken {
            self.put(|sequence, out| renumber::<Record>(stuffed, sequence, out));
        }
    }

    /// Skips frames.
    fn miss(&mut self, frames: u16) {
        if self.has_spoken {
            (0..frames).for_each(|_| {
                self.sequence.take();
            });
        }
    }

    fn put(&mut self, write: impl FnOnce(u16, &mut [u8]) -> Option<usize>) {
        let sequence = self.sequence.take();
        let mut out = [0; MAX_FRAME];
        if self.waiting.len() + MAX_FRAME <= MOST_WAITING
            && let Some(length) = write(sequence, &mut out)
        {
            self.waiting.extend(out.iter().take(length));
        }
    }

    /// Sends what the connection accepts.
    fn flush(&mut self) {
        while !self.waiting.is_empty() {
            match self.stream.write(self.waiting.as_slices().0) {
                Ok(count @ 1..) => drop(self.waiting.drain(..count)),
                Err(error) if is_wait(&error) => return,
                Ok(_) | Err(_) => {
                    self.is_gone = true;
                    return;
                }
            }
        }
    }
}

fn is_wait(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::Interrupted)
}

/// Whether a record belongs to these streams, or is sent without request.
fn wants(streams: Streams, record: &Record) -> bool {
    match record {
        Record::Samples(_) => streams.samples,
        Record::Estimate(_) | Record::Law(_) | Record::Detail(_) | Record::Reversal(_) => streams.estimates,
        Record::Sums(_) | Record::MoreSums(_) => streams.sums,
        Record::Health(_) => streams.health,
        Record::Hello(_)
        | Record::Event(_)
        | Record::Reply(_)
        | Record::Settings(_)
        | Record::Saved(_)
        | Record::Measured(_) => true,
    }
}

#[cfg(test)]
mod tests;
