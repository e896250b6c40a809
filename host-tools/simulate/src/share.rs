//! One device's link for several hosts at a TCP port. Never blocks.
//!
//! Terms:
//! - *reader*: a host that is connected. Nothing is sent to it before its first valid request.
//! - *controller*: the reader that spoke first. Its requests go to the device; when it leaves, the oldest other reader
//!   that has spoken takes its place.
//!
//! What the device says goes to every reader, in frames that are renumbered for each. `Hello`, `ReadSettings` and
//! `Streams` are answered here, so that each reader learns what it needs and gets the streams that it chose; any other
//! request is refused as [`Refusal::Busy`] but from the controller. A reader alone holds the device's link up when it
//! reads slowly, as a host at a cable does; among several, frames that one does not take are left out for it, which it
//! learns from their numbers. So no reader holds up another, and none takes more than 1 MiB.

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

/// Readers at a time. A further one takes the place of the oldest that has not spoken, else it is turned away by
/// closing its connection.
pub const MOST_READERS: usize = 16;
/// Bytes that wait for a reader among several: ten seconds at 4 kHz and more.
const MOST_WAITING: usize = 1 << 20;
/// Bytes that wait for a reader alone before the device does.
const MOST_WAITING_ALONE: usize = 1 << 14;
/// Bytes that wait for the device before nothing more is read from the controller.
const MOST_UPSTREAM: usize = 1 << 14;
/// Requests whose reply is still due; of more, the oldest replies are lost.
const MOST_ASKED: usize = 256;
/// Bytes taken from a reader at once.
const READ: usize = 4096;
/// Request number of our own; hosts leave it out.
const OWN_ID: u16 = 0;

/// A host that is connected.
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
    /// Who the device is and its settings, as it said last. Until both are known requests wait.
    hello: Option<Hello>,
    settings: Option<SettingsValues>,
    records: Box<FrameReader<Record>>,
    upstream: VecDeque<u8>,
    sequence: SequenceCounter,
    /// Requests that are with the device, and whose they are.
    asked: VecDeque<(u16, u64)>,
}

impl Share {
    /// For a device that readers control: it is asked for all streams when it starts.
    pub fn controlled(address: &str) -> io::Result<Self> {
        Self::listen(address, true)
    }

    /// For a device that this program controls: readers look on.
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

    /// Where it listens, with the true port number.
    pub fn address(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Takes what readers ask for, sends them what waits, and lets in new ones. To be called often.
    pub fn turn(&mut self) {
        if self.hello.is_some() && self.settings.is_some() {
            // The oldest first: one that has just left must not keep the next one from the control.
            for place in 0..self.readers.len() {
                self.hear(place);
            }
        }
        self.readers.iter_mut().for_each(Reader::flush);
        self.dismiss();
        // Whoever connects again and again must not keep the device waiting.
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

    /// Whether the device should wait: its only reader does not keep up.
    pub fn is_full(&self) -> bool {
        let mut speakers = self.readers.iter().filter(|reader| reader.has_spoken);
        match (speakers.next(), speakers.next()) {
            (Some(alone), None) => alone.waiting.len() > MOST_WAITING_ALONE,
            _ => false,
        }
    }

    /// Requests for the device; 0 bytes when there are none.
    pub fn requests(&mut self, into: &mut [u8]) -> usize {
        self.upstream.read(into).unwrap_or(0)
    }

    /// Takes what the device says to all who want it.
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
                // What a newer firmware says with its estimates.
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

    /// The device is away: readers are sent away too, and new ones wait.
    pub fn forget(&mut self) {
        self.readers.clear();
        self.controller = None;
        self.hello = None;
        self.settings = None;
        self.asked.clear();
        *self.records = FrameReader::new();
    }

    /// Keeps what readers that come later must know.
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

    /// Asks the device something of our own.
    fn ask(&mut self, command: Command) {
        let mut out = [0; MAX_FRAME];
        if let Ok(length) = encode_request(&Request { id: OWN_ID, command }, self.sequence.take(), &mut out) {
            self.upstream.extend(out.iter().take(length));
        }
    }

    /// Takes what one reader asks for.
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
                // For the device to count.
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

    /// Hands the control on when its holder has left.
    fn dismiss_controller(&mut self) {
        let is_here = |number| self.readers.iter().any(|reader| reader.number == number && !reader.is_gone);
        if self.controller.is_some_and(|number| !is_here(number)) {
            let next = self.readers.iter().find(|reader| reader.has_spoken && !reader.is_gone);
            self.controller = next.map(|reader| reader.number);
        }
    }

    fn dismiss(&mut self) {
        self.dismiss_controller();
        self.readers.retain(|reader| !reader.is_gone);
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

    /// Sends a frame of the device.
    fn pass(&mut self, stuffed: &[u8]) {
        if self.has_spoken {
            self.put(|sequence, out| renumber::<Record>(stuffed, sequence, out));
        }
    }

    /// Leaves frames out.
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

    /// Sends what the connection takes.
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

/// Whether a record belongs to these streams, or comes unasked.
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
