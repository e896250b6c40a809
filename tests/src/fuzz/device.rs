//! The whole instrument on mock parts, with a mock clock.

use embassy_time::{Duration, MockDriver};
use embedded_io_async::{ErrorType, Read, Write};
use embedded_storage_async::nor_flash::{
    ErrorType as FlashErrorType, NorFlash, NorFlashErrorKind as FlashError, ReadNorFlash,
};
use inerter_app::{
    App, Board, Figures, FlashStore, Identity, Pace, Platform, Restart, SampleSource, SourceError, Start, Store,
    StoreError, run,
};
use inerter_core::{FrontEnd, RawSample, Settings, SettingsError, State};
use inerter_needs::Random;
use inerter_wire::{
    Capabilities, ClockSource, Command, Counts, DELIMITER, Frame, FrameReader, Record, Reply, SettingsValues, Streams,
};
use std::{
    any::Any,
    cell::{Cell, RefCell},
    collections::VecDeque,
    convert::Infallible,
    future::{Future, poll_fn},
    ops::Range,
    panic::{AssertUnwindSafe, catch_unwind},
    pin::Pin,
    rc::Rc,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    task::{Context, Poll, Wake, Waker},
};

use super::{make::request, requests::Requests};

/// The whole process shares one mock clock.
static CLOCK: Mutex<()> = Mutex::new(());

/// The requests of the probe.
pub(super) const PROBE: [(u16, Command); 3] = [
    (0xFFFD, Command::Streams(Streams { health: true, ..Streams::NONE })),
    (0xFFFE, Command::Hello),
    (0xFFFF, Command::ReadSettings),
];

/// Time after which a reply counts as missing: longer than any wait in the device. It applies once per request that may
/// wait.
const LIMIT_MS: u64 = 3_000;
/// Longer than the interval between two health records.
const HEALTH_MS: u64 = 1_100;
/// Maximum number of polls until a device waits.
const TURNS: u32 = 100_000;

/// How a stream reaches the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Conditions {
    /// Number of bytes that arrive together, at least 1; a portion arrives every millisecond.
    pub portion: usize,
    /// The sampler runs from the start.
    pub sampling: bool,
    /// Where the stream arrives.
    pub link: Link,
    /// The host does not read while the middle half of the stream arrives.
    pub deaf: bool,
}

/// The link on which a stream arrives. Meanwhile, requests for a factory reset keep arriving on the device's other
/// link, and must have no effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Link {
    /// The only link.
    Single,
    /// The link with the open port.
    First,
    /// The other link, while that port is closed.
    Second,
}

impl Played {
    /// The replies that it sent, in order.
    pub fn replies(&self) -> impl Iterator<Item = &Reply> {
        self.records.iter().filter_map(|record| if let Record::Reply(reply) = record { Some(reply) } else { None })
    }
}

impl Conditions {
    /// Packets of full-speed USB to a device that is measuring: the conditions of the corpus.
    pub const PLAIN: Self = Self { portion: 64, sampling: true, link: Link::First, deaf: false };

    /// The conditions for the stream of a seed.
    pub fn of(seed: u64) -> Self {
        let mut noise = Random(!seed);
        Self {
            portion: noise.pick(&[1, 3, 17, 64, 64, 200, 4_096]),
            sampling: noise.percent(80),
            link: noise.pick(&[Link::Single, Link::First, Link::First, Link::Second]),
            deaf: noise.percent(10),
        }
    }
}

/// How a run ended.
#[derive(Clone, Debug, PartialEq)]
pub enum End {
    /// The device still runs.
    Running,
    /// It restarted as asked.
    Restarted(Restart),
    /// It panicked with this message.
    Panicked(String),
    /// It never waited.
    Hung,
    /// Its default settings were refused.
    Refused(SettingsError),
}

/// The device's behaviour in a run.
#[derive(Clone, Debug)]
pub struct Played {
    /// What it sent, in order.
    pub records: Vec<Record>,
    /// Frames from the device that are not records.
    pub faults: Vec<String>,
    /// The reader's counts on the host.
    pub counts: Counts,
    /// How it ended.
    pub end: End,
    /// Settings in flash that the next start would load.
    pub kept: Result<Option<SettingsValues>, StoreError>,
}

/// The settings of a board without saved settings: the analogue front end of the STM32G474 boards.
pub(super) fn defaults() -> Settings {
    Settings {
        sample_rate_hz: 1_000.0,
        oversampling: 64.0,
        force_min_code: 0.0,
        force_max_code: 262_080.0,
        force_zero_code: 131_040.0,
        newtons_per_code: 0.02,
        skew_s: -0.69e-6,
        ..Settings::default()
    }
}

/// The board's own limits beyond [`Settings::validate`].
pub(super) fn accepts(settings: &Settings) -> Result<(), SettingsError> {
    let offered: &[f64] = match settings.front_end {
        FrontEnd::Analogue => &[1_000.0, 2_000.0, 4_000.0],
        FrontEnd::Ads131m04 => &[3_906.25, 1_953.125, 976.5625],
    };
    let value = settings.sample_rate_hz;
    if !offered.contains(&value) {
        return Err(SettingsError::NotOffered { field: "sample_rate_hz", value, offered });
    }
    if settings.front_end == FrontEnd::Ads131m04 && settings.force_min_code >= 0.0 {
        let rule = "the digital front end's codes have a sign";
        return Err(SettingsError::Conflict { field: "front_end", other: "force_min_code", rule });
    }
    Ok(())
}

fn identity() -> Identity<'static> {
    Identity {
        firmware: "inerter 1.2.3",
        git: "0123456789ab",
        board: "fuzzed",
        serial: "F-1",
        clock: ClockSource::Simulated,
        capabilities: Capabilities::SAMPLER
            .with(Capabilities::INJECT)
            .with(Capabilities::TERMINAL)
            .with(Capabilities::STORE)
            .with(Capabilities::DFU)
            .with(Capabilities::REBOOT),
        accepts,
        play: inerter_app::play_nothing,
        start: Start::POWER_ON,
    }
}

/// `stream` and the probe.
pub fn with_probe(stream: &[u8]) -> Vec<u8> {
    let mut bytes = stream.to_vec();
    bytes.push(DELIMITER);
    for (id, command) in PROBE {
        bytes.extend(request(id, command, 0));
    }
    bytes
}

/// Starts a device with blank flash, sends it `stream` and the probe, and waits for all replies.
pub fn play(stream: &[u8], conditions: &Conditions) -> Played {
    let _clock = CLOCK.lock().unwrap_or_else(PoisonError::into_inner);
    let mut bench = FuzzedDevice::new(conditions);
    let bytes = with_probe(stream);
    let requests = Requests::read(&bytes);
    let elsewhere = request(1, Command::FactoryReset, 0);
    let mut end = bench.settle();
    let portions = bytes.chunks(conditions.portion.max(1));
    let middle = portions.len() / 4..portions.len() * 3 / 4;
    for (place, portion) in portions.enumerate() {
        bench.from_device.0.taken.set(!(conditions.deaf && middle.contains(&place)));
        bench.to_idle.0.bytes.borrow_mut().extend(&elsewhere);
        bench.to_device.0.bytes.borrow_mut().extend(portion);
        end = end.or_else(|| bench.pass(1));
    }
    let mut left_ms = LIMIT_MS * (1 + requests.that_wait() as u64);
    while end.is_none() && !bench.has_replied(&requests) && left_ms > 0 {
        end = bench.pass(1);
        left_ms -= 1;
    }
    end = end.or_else(|| bench.pass(HEALTH_MS));
    let kept = bench.kept();
    let counts = *bench.reader.counts();
    Played { records: bench.records, faults: bench.faults, counts, end: end.unwrap_or(End::Running), kept }
}

/// The device and everything connected to it.
struct FuzzedDevice {
    device: Pin<Box<dyn Future<Output = Result<Restart, SettingsError>>>>,
    woken: Arc<Woken>,
    to_device: Wire,
    /// To the unused link.
    to_idle: Wire,
    from_device: Wire,
    source: Script,
    flash: Flash,
    reader: FrameReader<Record>,
    records: Vec<Record>,
    faults: Vec<String>,
    /// IDs of the replies.
    replies: Vec<u16>,
}

impl FuzzedDevice {
    fn new(conditions: &Conditions) -> Self {
        MockDriver::get().reset();
        let (to_device, to_idle, from_device) = (Wire::default(), Wire::default(), Wire::default());
        let (source, flash) = (Script::default(), Flash::blank());
        let used = (to_device.clone(), from_device.clone());
        let idle = (to_idle.clone(), Wire::default());
        let device = device(*conditions, source.clone(), flash.clone(), used, idle);
        Self {
            device: Box::pin(device),
            woken: Arc::new(Woken(AtomicBool::new(true))),
            to_device,
            to_idle,
            from_device,
            source,
            flash,
            reader: FrameReader::new(),
            records: Vec::new(),
            faults: Vec::new(),
            replies: Vec::new(),
        }
    }

    /// Lets the device run until it waits, and reads its output.
    fn settle(&mut self) -> Option<End> {
        // Poll at least once: the link keeps no waker for bytes that have arrived.
        self.woken.0.store(true, Ordering::SeqCst);
        let waker = Waker::from(Arc::clone(&self.woken));
        for _ in 0..TURNS {
            if !self.woken.0.swap(false, Ordering::SeqCst) {
                self.read();
                return None;
            }
            let polled = catch_unwind(AssertUnwindSafe(|| self.device.as_mut().poll(&mut Context::from_waker(&waker))));
            let end = match polled {
                Ok(Poll::Pending) => continue,
                Ok(Poll::Ready(Ok(restart))) => End::Restarted(restart),
                Ok(Poll::Ready(Err(error))) => End::Refused(error),
                Err(panic) => End::Panicked(message(panic.as_ref())),
            };
            self.read();
            return Some(end);
        }
        Some(End::Hung)
    }

    /// Advances time, with samples.
    fn pass(&mut self, milliseconds: u64) -> Option<End> {
        for _ in 0..milliseconds {
            MockDriver::get().advance(Duration::from_millis(1));
            self.source.tick();
            if let Some(end) = self.settle() {
                return Some(end);
            }
        }
        None
    }

    fn read(&mut self) {
        let bytes: Vec<u8> = self.from_device.0.bytes.borrow_mut().drain(..).collect();
        let mut input = bytes.as_slice();
        while let Some(frame) = self.reader.read(&mut input) {
            match frame {
                Frame::Message { message, .. } => {
                    if let Record::Reply(Reply { id, .. }) = message {
                        self.replies.push(id);
                    }
                    self.records.push(message);
                }
                // The judge compares the device's own count of dropped frames with the reader's.
                Frame::Lost { .. } => {}
                other => self.faults.push(format!("{other:?}")),
            }
        }
    }

    /// Whether all replies have arrived, or at least those to the probe.
    fn has_replied(&self, requests: &Requests) -> bool {
        self.replies.len() >= requests.replies() || self.replies.ends_with(&PROBE.map(|(id, _)| id))
    }

    /// The settings that a device would load from flash now.
    fn kept(&self) -> Result<Option<SettingsValues>, StoreError> {
        embassy_futures::block_on(FlashStore::new(self.flash.clone(), FLASH).load())
    }
}

async fn device(
    conditions: Conditions,
    source: Script,
    flash: Flash,
    used: (Wire, Wire),
    idle: (Wire, Wire),
) -> Result<Restart, SettingsError> {
    let (app, mut state) = (Box::new(App::new()), Box::new(State::default()));
    let link = app.link_state();
    let joined = match conditions.link {
        Link::Single => return run(&app, &mut state, board(conditions, source, flash, used)).await,
        Link::First => link.join(used, idle),
        Link::Second => link.join(idle, used),
    };
    link.set_open(conditions.link == Link::First);
    run(&app, &mut state, board(conditions, source, flash, joined)).await
}

fn board<R: Read, W: Write>(
    conditions: Conditions,
    source: Script,
    flash: Flash,
    (receiver, transmitter): (R, W),
) -> Board<'static, Script, R, W, FlashStore<Flash>, Unknown> {
    Board {
        source,
        receiver,
        transmitter,
        store: FlashStore::new(flash, FLASH),
        platform: Unknown,
        identity: identity(),
        defaults: defaults(),
        autostart: conditions.sampling,
    }
}

fn message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or(panic.downcast_ref::<&str>().copied()).unwrap_or("no message").to_string()
}

#[derive(Default)]
struct Woken(AtomicBool);

impl Wake for Woken {
    fn wake(self: Arc<Self>) {
        self.0.store(true, Ordering::SeqCst);
    }
}

/// Moves what waits and fits; returns how many.
fn moved<T>(waiting: &mut VecDeque<T>, into: &mut [T]) -> usize {
    let count = waiting.len().min(into.len());
    into.iter_mut().zip(waiting.drain(..count)).for_each(|(place, item)| *place = item);
    count
}

/// One direction of a link.
#[derive(Clone, Default)]
struct Wire(Rc<Line>);

#[derive(Default)]
struct Line {
    bytes: RefCell<VecDeque<u8>>,
    /// Whether the host reads what the device sends.
    taken: Cell<bool>,
}

impl ErrorType for Wire {
    type Error = Infallible;
}

impl Read for Wire {
    async fn read(&mut self, into: &mut [u8]) -> Result<usize, Infallible> {
        poll_fn(|_| {
            let count = moved(&mut self.0.bytes.borrow_mut(), into);
            if count == 0 { Poll::Pending } else { Poll::Ready(Ok(count)) }
        })
        .await
    }
}

impl Write for Wire {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        poll_fn(|_| if self.0.taken.get() { Poll::Ready(()) } else { Poll::Pending }).await;
        self.0.bytes.borrow_mut().extend(bytes);
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// A sampler driven by the mock clock: a moving terminal, its force, and now and then a saturated code.
#[derive(Clone, Default)]
struct Script(Rc<RefCell<Sampler>>);

#[derive(Default)]
struct Sampler {
    index: u32,
    /// Samples per second, once configured.
    rate_hz: f64,
    /// Fraction of a sample that is due.
    due: f64,
    running: bool,
    waiting: VecDeque<RawSample>,
    waker: Option<Waker>,
}

impl Script {
    /// Advances by one millisecond.
    fn tick(&self) {
        let mut sampler = self.0.borrow_mut();
        sampler.due += sampler.rate_hz / 1_000.0;
        while sampler.due >= 1.0 {
            sampler.due -= 1.0;
            let sample = sample(sampler.index, sampler.rate_hz);
            sampler.index = sampler.index.wrapping_add(1);
            if sampler.running && sampler.waiting.len() < 512 {
                sampler.waiting.push_back(sample);
            }
        }
        if let Some(waker) = sampler.waker.take() {
            waker.wake();
        }
    }
}

fn sample(index: u32, rate_hz: f64) -> RawSample {
    let phase = std::f64::consts::TAU * 3.0 * f64::from(index) / rate_hz;
    let force_code = if index.is_multiple_of(997) { 262_080 } else { (131_040.0 - 30_000.0 * phase.sin()) as i32 };
    RawSample { index, position_count: (64.0 * 1_600.0 * phase.sin()) as i32, force_code, terminal_code: 7 }
}

impl SampleSource for Script {
    fn pace(&self) -> Pace {
        Pace::Live
    }

    async fn read(&mut self, into: &mut [RawSample]) -> Result<usize, SourceError> {
        poll_fn(|context| {
            let mut sampler = self.0.borrow_mut();
            sampler.running = true;
            let count = moved(&mut sampler.waiting, into);
            if count == 0 {
                sampler.waker = Some(context.waker().clone());
                return Poll::Pending;
            }
            Poll::Ready(Ok(count))
        })
        .await
    }

    async fn configure(&mut self, settings: &Settings) -> Result<(), SourceError> {
        let mut sampler = self.0.borrow_mut();
        sampler.waiting.clear();
        sampler.rate_hz = settings.sample_rate_hz;
        Ok(())
    }

    async fn halt(&mut self) {
        let mut sampler = self.0.borrow_mut();
        sampler.running = false;
        sampler.waiting.clear();
    }
}

struct Unknown;

impl Platform for Unknown {
    fn figures(&mut self) -> Figures {
        Figures::default()
    }
}

const PAGE: usize = 2_048;
const WORD: usize = 8;
const FLASH: Range<u32> = 0..8 * PAGE as u32;

/// Working flash. It refuses to write a word twice between two erases.
#[derive(Clone)]
struct Flash(Rc<[Cell<Option<[u8; WORD]>>]>);

impl Flash {
    fn blank() -> Self {
        Self((0..FLASH.end as usize / WORD).map(|_| Cell::new(None)).collect())
    }
}

impl FlashErrorType for Flash {
    type Error = FlashError;
}

impl ReadNorFlash for Flash {
    const READ_SIZE: usize = WORD;

    async fn read(&mut self, address: u32, into: &mut [u8]) -> Result<(), FlashError> {
        for (place, bytes) in (address as usize / WORD..).zip(into.chunks_mut(WORD)) {
            let word = self.0.get(place).ok_or(FlashError::OutOfBounds)?.get().unwrap_or([0xFF; WORD]);
            bytes.copy_from_slice(&word);
        }
        Ok(())
    }

    fn capacity(&self) -> usize {
        FLASH.end as usize
    }
}

impl NorFlash for Flash {
    const WRITE_SIZE: usize = WORD;
    const ERASE_SIZE: usize = PAGE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        let words = self.0.get(from as usize / WORD..to as usize / WORD).ok_or(FlashError::OutOfBounds)?;
        words.iter().for_each(|word| word.set(None));
        Ok(())
    }

    async fn write(&mut self, address: u32, bytes: &[u8]) -> Result<(), FlashError> {
        for (place, bytes) in (address as usize / WORD..).zip(bytes.as_chunks().0) {
            let word = self.0.get(place).ok_or(FlashError::OutOfBounds)?;
            if word.replace(Some(*bytes)).is_some() {
                return Err(FlashError::Other);
            }
        }
        Ok(())
    }
}
