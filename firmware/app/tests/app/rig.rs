//! A device on the bench: the app on mock parts, a mock clock, and the host's end of the link.

use embassy_time::{Duration, MockDriver};
use embedded_io_async::{ErrorKind, ErrorType, Read, Write};
use inerter_app::{
    App, Board, Figures, Identity, Pace, Platform, Restart, SampleSource, SourceError, Start, Store, StoreError,
    accept_all, play_nothing, run,
};
use inerter_core::{Estimate, FrontEnd, RawSample, Settings, SettingsError, State};
use inerter_wire::{
    Capabilities, ClockSource, Command, Done, Event, EventKind, Frame, FrameReader, Health, MAX_FRAME, Measure,
    Measured, Quantity, Record, Refusal, Reply, Request, Samples, SequenceCounter, SettingValue, SettingsValues,
    Streams, encode_request,
};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::future::{Future, poll_fn};
use std::pin::Pin;
use std::rc::Rc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::task::{Context, Poll, Wake, Waker};

/// The whole process shares one mock clock.
static CLOCK: Mutex<()> = Mutex::new(());

/// One direction of the link.
#[derive(Default)]
pub struct Wire {
    bytes: VecDeque<u8>,
    /// Bytes that fit before the writer must wait.
    capacity: usize,
    broken: bool,
    waker: Option<Waker>,
}

#[derive(Clone)]
pub struct WireEnd(Rc<RefCell<Wire>>);

impl WireEnd {
    pub fn new() -> Self {
        Self(Rc::new(RefCell::new(Wire { capacity: usize::MAX, ..Wire::default() })))
    }

    /// Puts bytes in at one end.
    pub fn put(&self, bytes: &[u8]) {
        self.change(|wire| wire.bytes.extend(bytes));
    }

    /// Takes all bytes out at the other end.
    pub fn take(&self) -> Vec<u8> {
        self.change(|wire| wire.bytes.drain(..).collect())
    }

    /// Number of bytes not yet taken.
    pub fn waiting(&self) -> usize {
        self.0.borrow().bytes.len()
    }

    /// Sets the room for bytes not yet taken.
    pub fn set_room(&self, bytes: usize) {
        self.change(|wire| wire.capacity = bytes);
    }

    /// Breaks or repairs the wire.
    pub fn set_broken(&self, broken: bool) {
        self.change(|wire| wire.broken = broken);
    }

    fn change<R>(&self, act: impl FnOnce(&mut Wire) -> R) -> R {
        let mut wire = self.0.borrow_mut();
        let result = act(&mut wire);
        if let Some(waker) = wire.waker.take() {
            waker.wake();
        }
        result
    }

    /// Waits until `act` has moved a byte, and returns how many it moved; an error while the wire is broken.
    async fn moved(&self, mut act: impl FnMut(&mut Wire) -> usize) -> Result<usize, ErrorKind> {
        poll_fn(|context| {
            let mut wire = self.0.borrow_mut();
            if wire.broken {
                return Poll::Ready(Err(ErrorKind::NotConnected));
            }
            let count = act(&mut wire);
            if count > 0 {
                return Poll::Ready(Ok(count));
            }
            wire.waker = Some(context.waker().clone());
            Poll::Pending
        })
        .await
    }
}

impl ErrorType for WireEnd {
    type Error = ErrorKind;
}

impl Read for WireEnd {
    async fn read(&mut self, into: &mut [u8]) -> Result<usize, ErrorKind> {
        self.moved(|wire| {
            let count = wire.bytes.len().min(into.len());
            into.iter_mut().zip(wire.bytes.drain(..count)).for_each(|(place, byte)| *place = byte);
            count
        })
        .await
    }
}

impl Write for WireEnd {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, ErrorKind> {
        self.moved(|wire| {
            let count = bytes.len().min(wire.capacity.saturating_sub(wire.bytes.len()));
            wire.bytes.extend(&bytes[..count]);
            count
        })
        .await
    }

    async fn flush(&mut self) -> Result<(), ErrorKind> {
        Ok(())
    }
}

/// The sampler's results, in order.
#[derive(Clone)]
pub struct Script {
    pace: Pace,
    parts: Rc<RefCell<Parts>>,
}

#[derive(Default)]
struct Parts {
    waiting: VecDeque<Result<RawSample, SourceError>>,
    waker: Option<Waker>,
    /// The results of the next calls of `configure`; later calls succeed.
    answers: VecDeque<Result<(), SourceError>>,
    asked: Vec<Asked>,
    with_next_settings: Option<VecDeque<Result<RawSample, SourceError>>>,
}

/// Requests to the source besides reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Asked {
    /// To apply settings, with their rate and front end.
    Configure(f64, FrontEnd),
    Halt,
}

impl Script {
    pub fn push(&self, parts: impl IntoIterator<Item = Result<RawSample, SourceError>>) {
        let mut inner = self.parts.borrow_mut();
        inner.waiting.extend(parts);
        if let Some(waker) = inner.waker.take() {
            waker.wake();
        }
    }

    /// These samples.
    pub fn push_samples(&self, samples: &[RawSample]) {
        self.push(samples.iter().copied().map(Ok));
    }

    /// These samples, and no more.
    pub fn push_all(&self, samples: &[RawSample]) {
        self.push_samples(samples);
        self.push([Err(SourceError::Ended)]);
    }

    /// Sets the results of the next calls of `configure`.
    pub fn answer(&self, answers: impl IntoIterator<Item = Result<(), SourceError>>) {
        self.parts.borrow_mut().answers.extend(answers);
    }

    /// Requests since the last call.
    pub fn asked(&self) -> Vec<Asked> {
        std::mem::take(&mut self.parts.borrow_mut().asked)
    }

    /// From the next settings that the sampler applies, it finds these samples and nothing else.
    pub fn push_with_next_settings(&self, samples: &[RawSample]) {
        self.parts.borrow_mut().with_next_settings = Some(samples.iter().copied().map(Ok).collect());
    }

    /// Number of parts that the sampler has not taken.
    pub fn left(&self) -> usize {
        self.parts.borrow().waiting.len()
    }
}

impl SampleSource for Script {
    fn pace(&self) -> Pace {
        self.pace
    }

    async fn read(&mut self, into: &mut [RawSample]) -> Result<usize, SourceError> {
        poll_fn(|context| {
            let mut inner = self.parts.borrow_mut();
            let mut count = 0;
            while let Some(part) = inner.waiting.front().copied() {
                match part {
                    Ok(sample) if count < into.len() => {
                        into[count] = sample;
                        count += 1;
                    }
                    Err(error) if count == 0 => {
                        inner.waiting.pop_front();
                        return Poll::Ready(Err(error));
                    }
                    _ => break,
                }
                inner.waiting.pop_front();
            }
            if count > 0 {
                return Poll::Ready(Ok(count));
            }
            inner.waker = Some(context.waker().clone());
            Poll::Pending
        })
        .await
    }

    async fn configure(&mut self, settings: &Settings) -> Result<(), SourceError> {
        let mut inner = self.parts.borrow_mut();
        inner.asked.push(Asked::Configure(settings.sample_rate_hz, settings.front_end));
        if let Some(parts) = inner.with_next_settings.take() {
            inner.waiting = parts;
        }
        inner.answers.pop_front().unwrap_or(Ok(()))
    }

    async fn halt(&mut self) {
        self.parts.borrow_mut().asked.push(Asked::Halt);
    }
}

/// A store in memory.
#[derive(Clone, Default)]
pub struct MemoryStore {
    pub saved: Rc<RefCell<Option<SettingsValues>>>,
    /// The error that the store returns.
    pub error: Rc<RefCell<Option<StoreError>>>,
}

impl MemoryStore {
    /// Replaces the stored settings.
    fn replace(&self, saved: Option<SettingsValues>) -> Result<(), StoreError> {
        if *self.error.borrow() == Some(StoreError::Unreadable) {
            return Err(StoreError::Unreadable);
        }
        *self.error.borrow_mut() = None;
        *self.saved.borrow_mut() = saved;
        Ok(())
    }
}

impl Store for MemoryStore {
    async fn load(&mut self) -> Result<Option<SettingsValues>, StoreError> {
        match *self.error.borrow() {
            Some(error) => Err(error),
            None => Ok(self.saved.borrow().clone()),
        }
    }

    async fn save(&mut self, settings: &SettingsValues) -> Result<(), StoreError> {
        self.replace(Some(settings.clone()))
    }

    async fn erase(&mut self) -> Result<(), StoreError> {
        self.replace(None)
    }
}

struct FixedFigures;

impl Platform for FixedFigures {
    fn figures(&mut self) -> Figures {
        Figures { cpu_load_permille: Some(123), stack_free_bytes: Some(4567), temperature_c: Some(30.5) }
    }

    async fn measure(&mut self, what: Measure) -> Measured {
        let mut measured = Measured::new(what);
        measured.push(Quantity::FlashKb, 512);
        measured
    }
}

#[derive(Default)]
struct Woken(AtomicBool);

impl Wake for Woken {
    fn wake(self: Arc<Self>) {
        self.0.store(true, Ordering::SeqCst);
    }
}

pub const IDENTITY: Identity<'static> = Identity {
    firmware: "inerter 1.2.3",
    git: "0123456789ab",
    board: "bench",
    serial: "B-7",
    clock: ClockSource::Simulated,
    capabilities: Capabilities::SAMPLER.with(Capabilities::INJECT).with(Capabilities::STORE).with(Capabilities::REBOOT),
    accepts: accept_all,
    play: play_nothing,
    start: Start::POWER_ON,
};

/// Options for building a rig.
#[derive(Clone)]
pub struct Options {
    pub pace: Pace,
    pub autostart: bool,
    pub identity: Identity<'static>,
    pub store: MemoryStore,
    pub defaults: Settings,
    /// The source's result for its first settings.
    pub configured: Result<(), SourceError>,
    /// With a UART as the second link, and a port that is not yet open.
    pub two_links: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            pace: Pace::OnDemand,
            autostart: false,
            identity: IDENTITY,
            store: MemoryStore::default(),
            defaults: Settings::default(),
            configured: Ok(()),
            two_links: false,
        }
    }
}

/// A device with these capabilities.
pub fn able_to(capabilities: Capabilities) -> Options {
    Options { identity: Identity { capabilities, ..IDENTITY }, ..Options::default() }
}

/// A device that began its run like this.
pub fn begun(start: Start<'static>) -> Options {
    Options { identity: Identity { start, ..IDENTITY }, ..Options::default() }
}

/// A device whose samples do not wait, and which measures from the start.
pub fn live() -> Options {
    Options { pace: Pace::Live, autostart: true, ..Options::default() }
}

/// Number of the setting of this name.
pub fn number(name: &str) -> u8 {
    Settings::find(name).unwrap() as u8
}

/// The command that writes these settings, by name.
pub fn write(pairs: &[(&str, f64)]) -> Command {
    let mut values = SettingsValues::default();
    for &(name, value) in pairs {
        values.0.push(SettingValue { number: number(name), value }).unwrap();
    }
    Command::WriteSettings(values)
}

/// The device's tasks.
type Running = Pin<Box<dyn Future<Output = Result<Restart, SettingsError>>>>;

/// Puts the device on this link.
fn running(
    app: &'static App,
    (receiver, transmitter): (impl Read + 'static, impl Write + 'static),
    source: Script,
    options: Options,
) -> Running {
    let state: &'static mut State = Box::leak(Box::default());
    let Options { identity, store, defaults, autostart, .. } = options;
    let board = Board { source, receiver, transmitter, store, platform: FixedFigures, identity, defaults, autostart };
    Box::pin(run(app, state, board))
}

/// The device, and the host's end of its link.
pub struct TestDevice {
    pub app: &'static App,
    device: Running,
    woken: Arc<Woken>,
    pub ended: Option<Result<Restart, SettingsError>>,
    pub script: Script,
    pub store: MemoryStore,
    pub to_device: WireEnd,
    pub from_device: WireEnd,
    /// Both directions of the second link.
    pub uart: (WireEnd, WireEnd),
    frames: FrameReader<Record>,
    sequence: SequenceCounter,
    id: u16,
    _clock: MutexGuard<'static, ()>,
}

impl TestDevice {
    /// A stopped device with a source that can wait, after its first frames.
    pub fn new() -> Self {
        Self::with(Options::default())
    }

    /// A device after its first frames.
    pub fn with(options: Options) -> Self {
        let mut rig = Self::cold(options);
        rig.frames();
        rig
    }

    /// A device that has not yet sent anything.
    pub fn cold(options: Options) -> Self {
        let clock = CLOCK.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        MockDriver::get().reset();
        let (to_device, from_device) = (WireEnd::new(), WireEnd::new());
        let uart = (WireEnd::new(), WireEnd::new());
        let script = Script { pace: options.pace, parts: Rc::default() };
        script.answer([options.configured]);
        let app: &'static App = Box::leak(Box::default());
        let (store, source) = (options.store.clone(), script.clone());
        let usb = (to_device.clone(), from_device.clone());
        let device = if options.two_links {
            running(app, app.link_state().join(usb, uart.clone()), source, options)
        } else {
            running(app, usb, source, options)
        };
        let woken = Arc::new(Woken(AtomicBool::new(true)));
        Self {
            app,
            device,
            woken,
            ended: None,
            script,
            store,
            to_device,
            from_device,
            uart,
            frames: FrameReader::new(),
            sequence: SequenceCounter::new(),
            id: 0,
            _clock: clock,
        }
    }

    /// Runs the device until it waits.
    pub fn settle(&mut self) {
        let waker = Waker::from(self.woken.clone());
        for _ in 0..1_000_000 {
            if self.ended.is_some() || !self.woken.0.swap(false, Ordering::SeqCst) {
                return;
            }
            if let Poll::Ready(result) = self.device.as_mut().poll(&mut Context::from_waker(&waker)) {
                self.ended = Some(result);
            }
        }
        panic!("the device never waits");
    }

    /// Advances time in steps of a millisecond.
    pub fn pass(&mut self, milliseconds: u64) {
        self.settle();
        for _ in 0..milliseconds {
            MockDriver::get().advance(Duration::from_millis(1));
            self.settle();
        }
    }

    /// Sets the room in the link for what the device sends.
    pub fn set_room(&mut self, bytes: usize) {
        self.from_device.set_room(bytes);
    }

    /// Breaks or repairs both directions of the link.
    pub fn unplug(&mut self, unplugged: bool) {
        self.from_device.set_broken(unplugged);
        self.to_device.set_broken(unplugged);
    }

    /// Opens or closes the port of the first link.
    pub fn set_open(&self, open: bool) {
        self.app.link_state().set_open(open);
    }

    /// Sends raw bytes to the device.
    pub fn send_bytes(&mut self, bytes: &[u8]) {
        self.to_device.put(bytes);
    }

    /// Reads at most `count` bytes of the device's output, without running the device.
    pub fn read_bytes(&mut self, count: usize) -> Vec<Frame<Record>> {
        let bytes: Vec<u8> = self.from_device.change(|wire| {
            let count = count.min(wire.bytes.len());
            wire.bytes.drain(..count).collect()
        });
        let mut input = bytes.as_slice();
        std::iter::from_fn(|| self.frames.read(&mut input)).collect()
    }

    /// All frames that the device sends now.
    pub fn frames(&mut self) -> Vec<Frame<Record>> {
        let mut all = Vec::new();
        loop {
            self.settle();
            let part = self.read_bytes(usize::MAX);
            if part.is_empty() && self.from_device.0.borrow().bytes.is_empty() {
                return all;
            }
            all.extend(part);
        }
    }

    /// [`frames`](Self::frames), none of which may be lost or damaged.
    pub fn records(&mut self) -> Vec<Record> {
        self.frames().into_iter().map(message).collect()
    }

    /// The records until they are all, for a host that reads `count` bytes each time that some milliseconds have
    /// passed.
    pub fn read_until(&mut self, milliseconds: u64, count: usize, are_all: impl Fn(&[Record]) -> bool) -> Vec<Record> {
        let mut records = Vec::new();
        while !are_all(&records) {
            self.pass(milliseconds);
            records.extend(self.read_bytes(count).into_iter().map(message));
        }
        records
    }

    /// The frame of a request, and its ID.
    pub fn request(&mut self, command: Command) -> (u16, Vec<u8>) {
        self.id += 1;
        let mut frame = [0; MAX_FRAME];
        let length = encode_request(&Request { id: self.id, command }, self.sequence.take(), &mut frame).unwrap();
        (self.id, frame[..length].to_vec())
    }

    /// Sends a command without waiting for its reply.
    pub fn send(&mut self, command: Command) -> u16 {
        let (id, frame) = self.request(command);
        self.send_bytes(&frame);
        id
    }

    /// Sends a command. Returns its result, and the records before and after its reply.
    pub fn ask(&mut self, command: Command) -> (Vec<Record>, Result<Done, Refusal>, Vec<Record>) {
        let id = self.send(command);
        let mut records = self.records();
        let place = records.iter().position(|record| matches!(record, Record::Reply(reply) if reply.id == id));
        let place = place.unwrap_or_else(|| panic!("no reply to {id} among {records:?}"));
        let after = records.split_off(place + 1);
        match records.pop() {
            Some(Record::Reply(Reply { result, .. })) => (records, result, after),
            other => panic!("{other:?}"),
        }
    }

    /// The result of a command.
    pub fn result(&mut self, command: Command) -> Result<Done, Refusal> {
        self.ask(command).1
    }

    /// Sends a command that must succeed. Returns the records before its reply; none may follow it.
    pub fn tell(&mut self, command: Command) -> Vec<Record> {
        let (before, result, after) = self.ask(command);
        result.unwrap();
        assert_eq!(after, []);
        before
    }

    /// Chooses the records that come unasked.
    pub fn stream(&mut self, streams: Streams) {
        self.tell(Command::Streams(streams));
    }

    /// Feeds samples to the sampler, no more at once than a live source would deliver.
    pub fn feed<'a>(&mut self, samples: impl IntoIterator<Item = &'a RawSample>) {
        for sample in samples {
            self.script.push([Ok(*sample)]);
            self.settle();
        }
    }

    /// Injects samples within the credit that the device grants. Returns the records before the last reply.
    pub fn inject(&mut self, samples: &[RawSample]) -> Vec<Record> {
        let (mut records, mut left) = (Vec::new(), samples);
        while !left.is_empty() {
            let (batch, taken) = Samples::from_slice(left);
            left = &left[taken..];
            let (before, result, after) = self.ask(Command::Inject(batch));
            records.extend(before);
            records.extend(after);
            assert!(matches!(result, Ok(Done::Injected { .. })), "{result:?}");
        }
        records
    }

    /// The settings in use.
    pub fn settings(&mut self) -> Settings {
        match self.tell(Command::ReadSettings).as_slice() {
            [Record::Settings(values)] => values.read(&Settings::default()).settings,
            other => panic!("{other:?}"),
        }
    }

    /// [`tell`](Self::tell) if frames may be missing.
    pub fn tell_through_loss(&mut self, command: Command) {
        let id = self.send(command);
        let frames = self.frames();
        assert!(frames.iter().any(|frame| matches!(frame, Frame::Message { message, .. } if *message == done(id))));
    }

    /// Number of frames missing so far, from their sequence numbers.
    pub fn lost(&self) -> u32 {
        self.frames.counts().lost
    }

    /// Number of frames that arrived damaged so far.
    pub fn corrupt(&self) -> u32 {
        self.frames.counts().corrupt()
    }

    /// The next health record.
    pub fn health(&mut self) -> Health {
        self.pass(1_000);
        let health = self.frames().into_iter().rev().find_map(|frame| match frame {
            Frame::Message { message: Record::Health(health), .. } => Some(health),
            _ => None,
        });
        health.expect("a report every second")
    }
}

/// The record in a frame that must be whole.
pub fn message(frame: Frame<Record>) -> Record {
    match frame {
        Frame::Message { message, .. } => message,
        other => panic!("{other:?}"),
    }
}

/// The reply to a request that was executed.
pub fn done(id: u16) -> Record {
    Record::Reply(Reply { id, result: Ok(Done::Plain) })
}

/// The estimates among records.
pub fn estimates(records: &[Record]) -> Vec<Estimate> {
    records
        .iter()
        .filter_map(|record| if let Record::Estimate(estimate) = record { Some(*estimate) } else { None })
        .collect()
}

/// The events among records.
pub fn events(records: &[Record]) -> Vec<EventKind> {
    records
        .iter()
        .filter_map(|record| if let Record::Event(Event { kind, .. }) = record { Some(kind.clone()) } else { None })
        .collect()
}

/// The raw samples among records.
pub fn raw_samples(records: &[Record]) -> Vec<RawSample> {
    records
        .iter()
        .filter_map(|record| if let Record::Samples(samples) = record { Some(samples) } else { None })
        .flat_map(|samples| samples.iter().map(|sample| sample.unwrap()))
        .collect()
}

/// A moving inerter of 100 kg with 20 N of friction: 3 Hz, 4 mm, at the default settings.
pub fn shaken(count: u32) -> Vec<RawSample> {
    shaken_mass(count, 100.0)
}

/// The same motion with half the inertance.
pub fn lighter(count: u32) -> Vec<RawSample> {
    shaken_mass(count, 50.0)
}

fn shaken_mass(count: u32, inertance_kg: f64) -> Vec<RawSample> {
    let settings = Settings::default();
    (0..count)
        .map(|index| {
            let w = 2.0 * std::f64::consts::PI * 3.0;
            let phase = w * f64::from(index) / settings.sample_rate_hz;
            let (x, v, a) = (4e-3 * phase.sin(), 4e-3 * w * phase.cos(), -4e-3 * w * w * phase.sin());
            let force = inertance_kg * a + 20.0 * v.signum();
            RawSample {
                index,
                position_count: (x / settings.metres_per_count).floor() as i32,
                force_code: (force / settings.newtons_per_code).round() as i32,
                terminal_code: 0,
            }
        })
        .collect()
}

/// Core's own results for these samples: estimates at the publish rate, and the final one.
pub fn by_core(settings: &Settings, samples: &[RawSample]) -> (Vec<Estimate>, Estimate) {
    let active = settings.validate().unwrap();
    let mut state = State::new(&active);
    let estimates = samples.iter().filter_map(|sample| active.step(&mut state, sample).estimate()).collect();
    (estimates, active.publish(&state).estimate)
}

/// The same, the final one last.
pub fn all_by_core(settings: &Settings, samples: &[RawSample]) -> Vec<Estimate> {
    let (mut estimates, end) = by_core(settings, samples);
    estimates.push(end);
    estimates
}
