//! The virtual device: the firmware's own app with the plant as its sampler, in a thread of this process.

use std::{
    cell::RefCell,
    future::{Future, poll_fn},
    io,
    pin::pin,
    rc::Rc,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    task::{Context, Poll, Wake, Waker},
    thread::{self, JoinHandle, Thread},
    time::Duration,
};

use embassy_time::{Instant, Timer};
use embedded_io_async::{ErrorKind, ErrorType, Read, Write};
use inerter_app::{
    App, Board, Figures, Identity, Pace, Platform, SampleSource, SourceError, Start, Store, StoreError, accept_all,
    play_nothing,
};
use inerter_core::{RawSample, Settings, State};
use inerter_plant::Sample;
use inerter_wire::{Capabilities, ClockSource, SettingsValues};

use crate::{
    clock,
    error::SimulateError,
    operator::{Operator, Samples},
    port::Port,
    setup::{Setup, raw},
};

/// Longest time between two polls of the link.
const IDLE: Duration = Duration::from_millis(1);
/// A source that lags by more than this was halted, and does not catch up.
const PAUSE: embassy_time::Duration = embassy_time::Duration::from_secs(1);

/// Where the device can be reached.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Endpoint {
    /// A TCP address; port 0 stands for any free one.
    Tcp(String),
    /// A pseudo-terminal.
    Pty,
}

/// A device that runs until it is stopped or dropped.
pub struct VirtualDevice {
    name: String,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl VirtualDevice {
    /// Starts a device that is already in motion, at `speed` times real time.
    pub fn start(setup: &Setup, endpoint: &Endpoint, speed: f64) -> Result<Self, SimulateError> {
        Self::new(setup, endpoint, speed, true, setup.samples()?)
    }

    /// Starts a device that an operator loads and moves; the motion of the set-up is the first one.
    pub fn with_operator(setup: &Setup, endpoint: &Endpoint, speed: f64) -> Result<(Self, Operator), SimulateError> {
        let (samples, bench) = setup.handled()?;
        Ok((Self::new(setup, endpoint, speed, true, samples)?, bench))
    }

    /// Starts a device whose motion begins when a host starts the sampler, so that the host misses no sample.
    pub fn waiting(setup: &Setup, endpoint: &Endpoint, speed: f64) -> Result<Self, SimulateError> {
        Self::new(setup, endpoint, speed, false, setup.samples()?)
    }

    fn new(
        setup: &Setup,
        endpoint: &Endpoint,
        speed: f64,
        autostart: bool,
        samples: Samples,
    ) -> Result<Self, SimulateError> {
        let (port, name) = match endpoint {
            Endpoint::Tcp(address) => Port::tcp(address)?,
            #[cfg(unix)]
            Endpoint::Pty => Port::pty()?,
            #[cfg(not(unix))]
            Endpoint::Pty => {
                let source = io::Error::new(io::ErrorKind::Unsupported, "this system has none; use --tcp");
                return Err(SimulateError::Endpoint { what: "a pseudo-terminal".into(), source });
            }
        };
        let source = PlantSource { samples, next: None, started: None, speed };
        let stop = Arc::new(AtomicBool::new(false));
        let (flag, settings, serial) = (stop.clone(), setup.settings, format!("SIM-{}", setup.sensors.seed));
        let thread = thread::Builder::new().name("virtual inerter".into()).spawn(move || {
            let port = Rc::new(RefCell::new(port));
            let source = Rc::new(RefCell::new(source));
            let mut state = Box::new(State::default());
            let kept = Rc::new(RefCell::new(None));
            let mut start = Start::POWER_ON;
            // Each iteration is one start of the device; a reboot begins the next.
            while !flag.load(Ordering::Relaxed) {
                let app = App::new();
                let board = Board {
                    source: Shared(source.clone()),
                    receiver: HostLink(port.clone()),
                    transmitter: HostLink(port.clone()),
                    store: Kept(kept.clone()),
                    platform: NoFigures,
                    identity: Identity {
                        firmware: concat!("inerter-virtual ", env!("CARGO_PKG_VERSION")),
                        git: "",
                        board: "virtual",
                        serial: &serial,
                        clock: ClockSource::Simulated,
                        capabilities: Capabilities::SAMPLER
                            .with(Capabilities::INJECT)
                            .with(Capabilities::TERMINAL)
                            .with(Capabilities::STORE)
                            .with(Capabilities::REBOOT),
                        accepts: accept_all,
                        play: play_nothing,
                        start,
                    },
                    defaults: settings,
                    autostart,
                };
                run_until(&flag, || port.borrow_mut().turn(), inerter_app::run(&app, &mut state, board));
                start = Start { saves_left: app.saves_left(), ..Start::SOFTWARE };
            }
        });
        let thread = thread.map_err(|source| SimulateError::Endpoint { what: "a thread".into(), source })?;
        Ok(Self { name, stop, thread: Some(thread) })
    }

    /// Address or pseudo-terminal to connect to.
    pub fn name(&self) -> &str {
        &self.name
    }
}

impl Drop for VirtualDevice {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            thread.join().ok();
        }
    }
}

struct Unpark(Thread);

impl Wake for Unpark {
    fn wake(self: Arc<Self>) {
        self.0.unpark();
    }
}

/// Polls `future` until it is ready or `stop` is set, with a call of `turn` before each poll.
fn run_until(stop: &AtomicBool, mut turn: impl FnMut(), future: impl Future) {
    let waker = Waker::from(Arc::new(Unpark(thread::current())));
    let mut context = Context::from_waker(&waker);
    let mut future = pin!(future);
    while !stop.load(Ordering::Relaxed) {
        clock::advance();
        turn();
        if future.as_mut().poll(&mut context).is_ready() {
            return;
        }
        thread::park_timeout(IDLE);
    }
}

/// The plant as a sampler.
struct PlantSource {
    samples: Samples,
    next: Option<Sample>,
    started: Option<Instant>,
    speed: f64,
}

impl PlantSource {
    /// When a sample with time `t_s` is due. A source that was not read for a long time continues from where it
    /// stopped.
    fn due(&mut self, t_s: f64, now: Instant) -> Instant {
        let after = embassy_time::Duration::from_micros((t_s / self.speed * 1e6) as u64);
        let due = *self.started.get_or_insert(now) + after;
        if now.saturating_duration_since(due) < PAUSE {
            return due;
        }
        self.started = Some(Instant::from_micros(now.as_micros().saturating_sub(after.as_micros())));
        now
    }
}

/// The sampler survives a reboot.
struct Shared(Rc<RefCell<PlantSource>>);

impl SampleSource for Shared {
    /// The plant waits on a busy machine, so that the simulation itself loses no sample.
    fn pace(&self) -> Pace {
        Pace::OnDemand
    }

    async fn read(&mut self, into: &mut [RawSample]) -> Result<usize, SourceError> {
        let mut count = 0;
        while count < into.len() {
            let wait = {
                let mut source = self.0.borrow_mut();
                if source.next.is_none() {
                    source.next = source.samples.next();
                }
                let Some(next) = source.next else {
                    return if count == 0 { Err(SourceError::Ended) } else { Ok(count) };
                };
                let now = Instant::now();
                let due = source.due(next.t_s, now);
                if due <= now {
                    source.next = None;
                    if let Some(place) = into.get_mut(count) {
                        *place = raw(&next);
                    }
                    count += 1;
                    continue;
                }
                due
            };
            if count > 0 {
                break;
            }
            Timer::at(wait).await;
        }
        Ok(count)
    }

    /// The plant's instruments follow the settings; a sample already waiting has the former rate.
    async fn configure(&mut self, settings: &Settings) -> Result<(), SourceError> {
        let source = &mut *self.0.borrow_mut();
        let simulation = &mut source.samples.simulation;
        let sensors = simulation.sensors();
        if (sensors.sample_rate_hz, sensors.oversampling) == (settings.sample_rate_hz, settings.oversampling) {
            return Ok(());
        }
        source.next = None;
        simulation.sample_at(settings.sample_rate_hz, settings.oversampling).map_err(|_| SourceError::Unreadable)
    }
}

/// Settings that survive a reboot, but not the program.
struct Kept(Rc<RefCell<Option<SettingsValues>>>);

impl Store for Kept {
    async fn load(&mut self) -> Result<Option<SettingsValues>, StoreError> {
        Ok(self.0.borrow().clone())
    }

    async fn save(&mut self, settings: &SettingsValues) -> Result<(), StoreError> {
        *self.0.borrow_mut() = Some(settings.clone());
        Ok(())
    }

    async fn erase(&mut self) -> Result<(), StoreError> {
        *self.0.borrow_mut() = None;
        Ok(())
    }
}

/// One half of the link, as the app uses it.
struct HostLink(Rc<RefCell<Port>>);

impl ErrorType for HostLink {
    type Error = ErrorKind;
}

fn ready(result: io::Result<usize>) -> Poll<Result<usize, ErrorKind>> {
    match result {
        Ok(count) => Poll::Ready(Ok(count)),
        // The next poll tries again, at most a millisecond later.
        Err(error) if error.kind() == io::ErrorKind::WouldBlock => Poll::Pending,
        Err(_) => Poll::Ready(Err(ErrorKind::NotConnected)),
    }
}

impl Read for HostLink {
    async fn read(&mut self, into: &mut [u8]) -> Result<usize, ErrorKind> {
        poll_fn(|_| ready(self.0.borrow_mut().read(into))).await
    }
}

impl Write for HostLink {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, ErrorKind> {
        poll_fn(|_| ready(self.0.borrow_mut().write(bytes))).await
    }

    async fn flush(&mut self) -> Result<(), ErrorKind> {
        Ok(())
    }
}

struct NoFigures;

impl Platform for NoFigures {
    fn figures(&mut self) -> Figures {
        Figures::default()
    }
}
