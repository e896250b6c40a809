//! State that the tasks share: queues, signals and flags.

use crate::alive::{Heartbeats, Task};
use crate::board::SourceError;
use crate::links::LinkState;
use crate::messages::{Batched, Control, ControlDone, Outgoing};
use crate::queue::{QUEUE, SampleQueue};
use crate::wear::Allowance;
use core::cell::{Cell, RefCell};
use core::future::poll_fn;
use core::pin::pin;
use core::sync::atomic::{AtomicBool, Ordering};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::{Channel, TrySendError};
use embassy_sync::signal::Signal;
use embassy_time::Instant;
use inerter_core::Settings;
use inerter_wire::{Event, EventKind, Health, Measure, Samples, Source, Streams};

/// Number of replies, events, estimates and sums that can wait for the link.
const URGENT: usize = 8;
/// Number of batches of raw samples that can wait for the link.
const BATCHES: usize = 4;

/// State that the tasks share. One per device, in a `static`.
pub struct App {
    pub(crate) queue: SampleQueue<QUEUE>,
    pub(crate) control: Signal<CriticalSectionRawMutex, Control>,
    pub(crate) control_done: Signal<CriticalSectionRawMutex, ControlDone>,
    /// Sent before `batches`.
    pub(crate) urgent: Channel<CriticalSectionRawMutex, Outgoing, URGENT>,
    pub(crate) batches: Channel<CriticalSectionRawMutex, Batched, BATCHES>,
    pub(crate) batches_sent: Signal<CriticalSectionRawMutex, ()>,
    /// Settings that the sampler is to apply; answered by `configured`.
    pub(crate) configure: Signal<CriticalSectionRawMutex, Settings>,
    pub(crate) configured: Signal<CriticalSectionRawMutex, Result<(), SourceError>>,
    /// What the board is to measure about itself; answered by `measured`.
    pub(crate) measure: Signal<CriticalSectionRawMutex, Measure>,
    pub(crate) measured: Signal<CriticalSectionRawMutex, ()>,
    /// The sampler has applied the settings in use and has not failed since.
    source_ready: AtomicBool,
    /// A host knows how this run began.
    greeted: AtomicBool,
    pub(crate) link: LinkState,
    pub(crate) heartbeats: Heartbeats,
    streams: Mutex<CriticalSectionRawMutex, Cell<Streams>>,
    health: Mutex<CriticalSectionRawMutex, RefCell<Health>>,
    sampler_waits: AtomicBool,
    saves: Mutex<CriticalSectionRawMutex, Cell<Allowance>>,
}

impl App {
    /// Streams that are on until the host chooses others.
    pub const FIRST_STREAMS: Streams = Streams { estimates: true, health: true, ..Streams::NONE };

    /// An app that has not run yet.
    pub const fn new() -> Self {
        Self {
            queue: SampleQueue::new(),
            control: Signal::new(),
            control_done: Signal::new(),
            urgent: Channel::new(),
            batches: Channel::new(),
            batches_sent: Signal::new(),
            configure: Signal::new(),
            configured: Signal::new(),
            measure: Signal::new(),
            measured: Signal::new(),
            source_ready: AtomicBool::new(false),
            greeted: AtomicBool::new(false),
            link: LinkState::new(),
            heartbeats: Heartbeats::new(),
            streams: Mutex::new(Cell::new(Self::FIRST_STREAMS)),
            health: Mutex::new(RefCell::new(Health {
                index: 0,
                uptime_s: 0,
                dropped_frames: 0,
                bad_frames: 0,
                lost_samples: 0,
                discontinuities: 0,
                overruns: 0,
                saturated: 0,
                cpu_load_permille: None,
                stack_free_bytes: None,
                temperature_c: None,
            })),
            sampler_waits: AtomicBool::new(false),
            saves: Mutex::new(Cell::new(Allowance::FULL)),
        }
    }

    /// Which link is in use, where there are two; see [`LinkState::join`].
    pub fn link_state(&self) -> &LinkState {
        &self.link
    }

    /// Whether sampling, estimating and telemetry have all given a heartbeat since the last call.
    ///
    /// For a watchdog. Each gives one at least every 500 ms while all is well, even when the sampler is halted or the
    /// host does not read; sampling gives none while samples are due but do not come.
    pub fn alive(&self) -> bool {
        self.heartbeats.all_since_last()
    }

    /// Saves that the flash may take now, for [`Start::saves_left`](crate::Start::saves_left) of the next run.
    pub fn saves_left(&self) -> u8 {
        self.saves.lock(Cell::get).left(Instant::now())
    }

    pub(crate) fn set_saves_left(&self, left: u8) {
        self.saves.lock(|cell| cell.set(Allowance::with_left(left, Instant::now())));
    }

    /// Takes `saves` from the allowance, or returns in how many seconds they may be made.
    pub(crate) fn take_saves(&self, saves: u8) -> Result<(), u16> {
        self.saves.lock(|cell| {
            let mut allowance = cell.get();
            let taken = allowance.take(saves, Instant::now());
            cell.set(allowance);
            taken
        })
    }

    pub(crate) fn streams(&self) -> Streams {
        self.streams.lock(Cell::get)
    }

    pub(crate) fn set_streams(&self, streams: Streams) {
        self.streams.lock(|cell| cell.set(streams));
    }

    pub(crate) fn health(&self) -> Health {
        self.health.lock(|health| *health.borrow())
    }

    pub(crate) fn note(&self, change: impl FnOnce(&mut Health)) {
        self.health.lock(|health| change(&mut health.borrow_mut()));
    }

    pub(crate) fn set_sampler_waits(&self, waits: bool) {
        self.sampler_waits.store(waits, Ordering::Relaxed);
    }

    pub(crate) fn source_is_ready(&self) -> bool {
        self.source_ready.load(Ordering::Relaxed)
    }

    pub(crate) fn set_source_ready(&self, ready: bool) {
        self.source_ready.store(ready, Ordering::Relaxed);
    }

    pub(crate) fn is_greeted(&self) -> bool {
        self.greeted.load(Ordering::Relaxed)
    }

    pub(crate) fn set_greeted(&self) {
        self.greeted.store(true, Ordering::Relaxed);
    }

    /// Whether the source in use can wait for the link.
    pub(crate) fn source_waits(&self) -> bool {
        self.queue.source() == Source::Link || self.sampler_waits.load(Ordering::Relaxed)
    }

    pub(crate) fn note_dropped_frame(&self) {
        self.note(|health| health.dropped_frames = health.dropped_frames.saturating_add(1));
    }

    /// Hands the link a record that no host requested: waits for room if the source of samples can wait, otherwise
    /// drops and counts it.
    ///
    /// The wait ends because every write to the link has a time limit.
    pub(crate) fn deliver(&self, by: Task, outgoing: Outgoing) -> impl Future<Output = ()> {
        self.hand_over(by, &self.urgent, outgoing)
    }

    /// [`deliver`](Self::deliver) for raw samples, which are sent after everything else.
    pub(crate) fn deliver_samples(&self, by: Task, samples: Samples) -> impl Future<Output = ()> {
        self.hand_over(by, &self.batches, Some(samples))
    }

    #[allow(clippy::manual_async_fn, reason = "an async function keeps what it is given by value twice")]
    fn hand_over<T, const N: usize>(
        &self,
        by: Task,
        to: &Channel<CriticalSectionRawMutex, T, N>,
        mut record: T,
    ) -> impl Future<Output = ()> {
        async move {
            loop {
                match to.try_send(record) {
                    Ok(()) => return,
                    Err(TrySendError::Full(back)) => record = back,
                }
                if !self.source_waits() {
                    return self.note_dropped_frame();
                }
                self.heartbeats.with_heartbeat(by, pin!(poll_fn(|context| to.poll_ready_to_send(context)))).await;
            }
        }
    }

    /// Waits until all raw samples that were handed over have been sent or dropped.
    pub(crate) async fn samples_are_sent(&self) {
        self.batches_sent.reset();
        self.batches.send(None).await;
        self.batches_sent.wait().await;
    }

    pub(crate) fn event(&self, kind: EventKind) -> Outgoing {
        Outgoing::Event(Event { index: self.health().index, kind })
    }
}

impl Default for App {
    fn default() -> Self {
        Self::new()
    }
}
