//! A session with a device: handshake, requests with their replies, records as they arrive.

use std::{
    collections::VecDeque,
    io,
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

use inerter_core::Settings;
use inerter_wire::{
    Capabilities, Command, Counts, DELIMITER, Done, Frame, FrameReader, Hello, MAX_FRAME, Measure, Measured, Reading,
    Record, Refusal, Request, SequenceCounter, Streams, encode_request,
};

use crate::{
    error::DeviceError,
    link::{Link, Target},
};

/// Time for the whole handshake.
const HANDSHAKE_TIME: Duration = Duration::from_secs(3);
/// Time after which Hello is requested again.
const HELLO_TIME: Duration = Duration::from_millis(500);
/// Time for a reply.
pub(crate) const REPLY_TIME: Duration = Duration::from_secs(3);
/// Time for a reply when flash is erased.
const ERASE_TIME: Duration = Duration::from_secs(6);
/// Time for a reply when the board measures itself, which takes it a second.
const MEASURE_TIME: Duration = Duration::from_secs(6);
/// Time limit for restoring a device's state after an interrupt.
const CLEAN_UP_TIME: Duration = Duration::from_secs(3);
/// Frames that may be queued. A device sends some hundreds a second, and nothing waits longer than seconds.
const MOST_IN_LINE: usize = 1 << 14;

/// Returns whether the work should end; called during waits.
pub type Interrupted = fn() -> bool;

/// Host time in nanoseconds since 1970 that never goes back within a session.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    epoch_ns: u64,
    started: Instant,
}

impl Clock {
    /// Starts from the system clock.
    pub fn new() -> Self {
        let epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self { epoch_ns: u64::try_from(epoch.as_nanos()).unwrap_or(0), started: Instant::now() }
    }

    /// Now \[ns\].
    pub fn now_ns(&self) -> u64 {
        self.epoch_ns.saturating_add(u64::try_from(self.started.elapsed().as_nanos()).unwrap_or(u64::MAX))
    }
}

impl Default for Clock {
    fn default() -> Self {
        Self::new()
    }
}

/// A received frame or a loss.
#[derive(Clone, Debug, PartialEq)]
pub struct Received {
    /// Host time \[ns\].
    pub time_ns: u64,
    /// The frame as received, without its delimiter; empty for anything that is not a frame itself (a loss, a restart).
    pub bytes: Vec<u8>,
    /// Its contents.
    pub frame: Frame<Record>,
}

impl Received {
    /// The device's answer to the request with this id, if this is its reply.
    pub(crate) fn reply_to(&self, id: u16) -> Option<Result<Done, Refusal>> {
        match &self.frame {
            Frame::Message { message: Record::Reply(reply), .. } if reply.id == id => Some(reply.result),
            _ => None,
        }
    }
}

/// An open session.
pub struct Device {
    link: Link,
    name: String,
    hello: Hello,
    reading: Reading,
    reader: Box<FrameReader<Record>>,
    sequence: SequenceCounter,
    next_id: u16,
    queue: VecDeque<Received>,
    clock: Clock,
    interrupted: Interrupted,
    /// Deadline for restoring the device's state after an interrupt.
    clean_up: Option<Instant>,
}

impl Device {
    /// Opens the link, identifies the device, and reads its settings. Once `interrupted`, every wait ends with
    /// [`DeviceError::Interrupted`]; requests made afterwards to restore the device's state may take 3 s in all.
    pub fn connect(target: &Target, clock: Clock, interrupted: Interrupted) -> Result<Self, DeviceError> {
        let (link, name) = Link::open(target)?;
        let mut device = Self {
            link,
            name,
            hello: Hello::default(),
            reading: Reading::default(),
            reader: Box::new(FrameReader::new()),
            sequence: SequenceCounter::new(),
            next_id: first_id(&clock),
            queue: VecDeque::new(),
            clock,
            interrupted,
            clean_up: None,
        };
        device.handshake()?;
        Ok(device)
    }

    /// Connects to a device that is just starting, for up to `patience`, and writes these settings to it; `alive`
    /// returns an error if waiting has become pointless, and an interrupt ends the wait.
    pub fn connect_starting<E: From<DeviceError>>(
        target: &Target,
        patience: Duration,
        settings: &Settings,
        interrupted: Interrupted,
        mut alive: impl FnMut() -> Result<(), E>,
    ) -> Result<Self, E> {
        let started = Instant::now();
        loop {
            match Self::connect(target, Clock::new(), interrupted) {
                Ok(mut device) => {
                    device.write_settings(settings)?;
                    return Ok(device);
                }
                Err(error) => {
                    alive()?;
                    if interrupted() {
                        return Err(DeviceError::Interrupted.into());
                    }
                    // A pseudo-terminal disappears with the program that made it, which may not have ended yet.
                    let may_come = matches!(
                        error,
                        DeviceError::Connect { .. }
                            | DeviceError::Missing { .. }
                            | DeviceError::Silent { .. }
                            | DeviceError::TurnedAway { .. }
                            | DeviceError::Vanished { .. }
                    );
                    if !may_come || started.elapsed() > patience {
                        return Err(error.into());
                    }
                    std::thread::sleep(Duration::from_millis(50));
                }
            }
        }
    }

    /// The device's identity.
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// The settings in use.
    pub fn settings(&self) -> &Settings {
        &self.reading.settings
    }

    /// The settings in use, and how many the device has beyond or short of those that this program knows.
    pub fn reading(&self) -> &Reading {
        &self.reading
    }

    /// The port or address.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Frames seen, lost and damaged on this link.
    pub fn counts(&self) -> &Counts {
        self.reader.counts()
    }

    /// The next frame; `None` if nothing has arrived for a moment.
    pub fn receive(&mut self) -> Result<Option<Received>, DeviceError> {
        if self.queue.is_empty() {
            self.poll()?;
        }
        Ok(self.queue.pop_front())
    }

    /// A frame that is already queued, without reading from the link.
    pub fn pending(&mut self) -> Option<Received> {
        self.queue.pop_front()
    }

    /// Sends a command and waits for its reply; other frames that arrive meanwhile stay queued for
    /// [`receive`](Self::receive).
    pub fn request(&mut self, what: &'static str, command: Command) -> Result<Done, DeviceError> {
        self.request_within(what, command, REPLY_TIME)
    }

    /// [`request`](Self::request) with a longer time limit.
    pub fn request_within(
        &mut self,
        what: &'static str,
        command: Command,
        time: Duration,
    ) -> Result<Done, DeviceError> {
        let mut deadline = Instant::now() + time;
        let cleans_up = (self.interrupted)();
        if cleans_up {
            let end = *self.clean_up.get_or_insert_with(|| Instant::now() + CLEAN_UP_TIME);
            deadline = deadline.min(end);
        }
        let id = self.send(command)?;
        let mut seen = self.queue.len();
        loop {
            self.poll()?;
            let mut new = self.queue.range(seen.min(self.queue.len())..);
            if let Some(result) = new.find_map(|received| received.reply_to(id)) {
                return result.map_err(|refusal| DeviceError::Refused { name: self.name.clone(), what, refusal });
            }
            seen = self.queue.len();
            if !cleans_up {
                self.check_interrupted()?;
            }
            if Instant::now() > deadline {
                return Err(DeviceError::NoReply { name: self.name.clone(), what });
            }
        }
    }

    /// Fails if the work should end.
    pub fn check_interrupted(&self) -> Result<(), DeviceError> {
        if (self.interrupted)() { Err(DeviceError::Interrupted) } else { Ok(()) }
    }

    /// Selects the records that the device streams.
    pub fn stream(&mut self, streams: Streams) -> Result<(), DeviceError> {
        self.request("to choose the streams", Command::Streams(streams)).map(drop)
    }

    /// Starts the device's own sampler, if it has one; harmless if it already runs.
    pub fn start_sampler(&mut self) -> Result<(), DeviceError> {
        if self.hello.capabilities.contains(Capabilities::SAMPLER) {
            self.request("to start its sampler", Command::Start)?;
        }
        Ok(())
    }

    /// Puts other settings in use.
    pub fn write_settings(&mut self, settings: &Settings) -> Result<(), DeviceError> {
        let values = inerter_wire::SettingsValues::difference(settings, self.settings());
        if !values.0.is_empty() {
            self.request("the settings", Command::WriteSettings(values))?;
            self.reading.settings = *settings;
        }
        Ok(())
    }

    fn handshake(&mut self) -> Result<(), DeviceError> {
        let is_tcp = matches!(self.link, Link::Tcp(_));
        self.hello = self.introduce().map_err(|error| match error {
            DeviceError::Vanished { name, .. } if is_tcp && self.queue.is_empty() => DeviceError::TurnedAway { name },
            error => error,
        })?;
        self.read_settings()
    }

    fn introduce(&mut self) -> Result<Hello, DeviceError> {
        self.write(&[DELIMITER])?;
        let started = Instant::now();
        let mut asked: Option<Instant> = None;
        loop {
            self.check_interrupted()?;
            if started.elapsed() > HANDSHAKE_TIME {
                return Err(self.silent(HANDSHAKE_TIME));
            }
            if asked.is_none_or(|asked| asked.elapsed() > HELLO_TIME) {
                // Each attempt restarts the stream, with sequence number 0.
                self.sequence = SequenceCounter::new();
                self.send(Command::Hello)?;
                asked = Some(Instant::now());
            }
            self.poll()?;
            let hello = self.queue.iter().find_map(|received| {
                message(received, |record| match record {
                    Record::Hello(hello) => Some(hello.clone()),
                    _ => None,
                })
            });
            if let Some(hello) = hello {
                return Ok(hello);
            }
        }
    }

    /// Requests the settings in use.
    pub(crate) fn read_settings(&mut self) -> Result<(), DeviceError> {
        let values = self.asked("to read its settings", Command::ReadSettings, REPLY_TIME, |record| match record {
            Record::Settings(values) => Some(values.clone()),
            _ => None,
        })?;
        self.reading = values.ok_or_else(|| self.silent(REPLY_TIME))?.read(&Settings::default());
        Ok(())
    }

    /// The record that the device sends before it replies to a command.
    fn asked<T>(
        &mut self,
        what: &'static str,
        command: Command,
        time: Duration,
        of: fn(&Record) -> Option<T>,
    ) -> Result<Option<T>, DeviceError> {
        let before = self.queue.len();
        self.request_within(what, command, time)?;
        // The last one: an earlier one may come from an earlier change.
        Ok(self.queue.range(before..).rev().find_map(|received| message(received, of)))
    }

    /// The settings that the device keeps across a restart, in use or not; those that it does not know are as in
    /// `Settings::default`.
    pub fn saved_settings(&mut self) -> Result<Settings, DeviceError> {
        let values =
            self.asked("to read what it has saved", Command::ReadSaved, REPLY_TIME, |record| match record {
                Record::Saved(values) => Some(values.clone()),
                _ => None,
            })?;
        Ok(values.ok_or_else(|| self.silent(REPLY_TIME))?.read(&Settings::default()).settings)
    }

    /// Makes the board measure something of itself; `None` if it reported nothing, or something else.
    pub fn measure(&mut self, what: Measure) -> Result<Option<Measured>, DeviceError> {
        let measured =
            self.asked("to measure itself", Command::Measure(what), MEASURE_TIME, |record| match record {
                Record::Measured(measured) => Some(measured.clone()),
                _ => None,
            })?;
        Ok(measured.filter(|measured| measured.what == what))
    }

    /// Takes the present force as zero.
    pub fn tare(&mut self) -> Result<(), DeviceError> {
        self.request("to take the present force as zero", Command::Tare)?;
        self.read_settings()
    }

    /// Saves the settings in use, so that they survive a restart.
    pub fn save_settings(&mut self) -> Result<(), DeviceError> {
        self.request_within("to save its settings", Command::SaveSettings, ERASE_TIME).map(drop)
    }

    /// Whether it can save settings across a restart.
    pub fn keeps_settings(&self) -> bool {
        self.hello().capabilities.contains(Capabilities::STORE)
    }

    /// Erases what the device has saved, puts its board's defaults in use, and reads them.
    pub fn factory_reset(&mut self) -> Result<&Settings, DeviceError> {
        // Pages are erased, each within 25 ms, and the sampler may restart.
        self.request_within("to erase its settings", Command::FactoryReset, ERASE_TIME)?;
        self.read_settings()?;
        Ok(self.settings())
    }

    /// Sends a command without waiting; returns the id that its reply will carry.
    pub fn send(&mut self, command: Command) -> Result<u16, DeviceError> {
        let id = self.next_id;
        self.next_id = id.wrapping_add(1).max(1);
        let mut out = [0; MAX_FRAME];
        let length = encode_request(&Request { id, command }, self.sequence.take(), &mut out)
            // Only a command that no caller can build would be too long for a frame.
            .unwrap_or(0);
        self.write(out.get(..length).unwrap_or_default())?;
        Ok(id)
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), DeviceError> {
        self.link.write_all(bytes).map_err(|error| self.vanished(&error))
    }

    /// Moves what has arrived on the link into the queue.
    fn poll(&mut self) -> Result<(), DeviceError> {
        let mut portion = [0; 4096];
        let count = self.link.read(&mut portion).map_err(|error| self.vanished(&error))?;
        let time_ns = self.clock.now_ns();
        let mut input = portion.get(..count).unwrap_or_default();
        while let Some(frame) = self.reader.read(&mut input) {
            if let Frame::ForeignVersion { wire_version, .. } = frame {
                return Err(DeviceError::WireVersion { name: self.name.clone(), theirs: wire_version });
            }
            let bytes = match frame {
                Frame::Lost { .. } | Frame::Restarted => Vec::new(),
                _ => self.reader.frame_bytes().to_vec(),
            };
            if self.queue.len() >= MOST_IN_LINE {
                self.queue.clear();
                return Err(DeviceError::Flood { name: self.name.clone() });
            }
            self.queue.push_back(Received { time_ns, bytes, frame });
        }
        Ok(())
    }

    fn silent(&self, time: Duration) -> DeviceError {
        DeviceError::Silent { name: self.name.clone(), seconds: time.as_secs_f64() }
    }

    /// What an error of the link means.
    fn vanished(&self, error: &io::Error) -> DeviceError {
        let reason = match error.kind() {
            io::ErrorKind::BrokenPipe | io::ErrorKind::UnexpectedEof => "the connection was closed".into(),
            _ => error.to_string(),
        };
        DeviceError::Vanished { name: self.name.clone(), reason, kept: String::new() }
    }
}

/// Number of the first request. It differs each time, so that a reply still queued for an earlier program is not
/// mistaken for ours.
fn first_id(clock: &Clock) -> u16 {
    // Microseconds wrap 15 times a second; 0 is left out.
    (clock.now_ns() / 1000 % 0xFFFF) as u16 + 1
}

fn message<T>(received: &Received, of: fn(&Record) -> Option<T>) -> Option<T> {
    match &received.frame {
        Frame::Message { message, .. } => of(message),
        _ => None,
    }
}
