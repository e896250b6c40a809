//! From requests to replies; owns the settings.

use crate::BATCH;
use crate::app::App;
use crate::board::{Identity, Store};
use crate::estimating::{Control, ControlDone, Tare};
use crate::logging::log;
use crate::settings::{InUse, needs_reset};
use crate::telemetry::{Outgoing, Restart};
use embassy_time::{Duration, Timer, with_timeout};
use embedded_io_async::Read;
use inerter_core::{RawSample, Settings};
use inerter_wire::{
    Capabilities, Command, Done, EventKind, Frame, FrameReader, Hello, Refusal, Reply, Request, Samples,
    SettingsValues, Source, WIRE_VERSION,
};

/// Bytes taken from the link at once.
const READ: usize = 64;
/// Pause before a link that gave an error is read again.
const RETRY: Duration = Duration::from_millis(50);
/// Time that a tare averages, in seconds.
const TARE_S: f64 = 0.5;
/// Time in which a tare must have got its samples.
const TARE_LIMIT: Duration = Duration::from_secs(2);
/// Time that an injected batch waits for room. Longer than the link may hold up the estimator.
const INJECT_LIMIT: Duration = Duration::from_secs(2);

struct Commands<'a, K> {
    app: &'a App,
    store: K,
    identity: Identity<'a>,
    settings: Settings,
    /// Samples taken since the first of the injection.
    accepted: u32,
    /// The estimator holds injected samples.
    injected: bool,
}

impl App {
    /// Answers requests. Nothing that arrives on the link can do more than be refused or counted as a bad frame.
    pub async fn commands(
        &self,
        mut link: impl Read,
        store: impl Store,
        identity: Identity<'_>,
        in_use: InUse,
        autostart: bool,
    ) -> ! {
        let InUse { settings, fault } = in_use;
        let mut commands = Commands { app: self, store, identity, settings, accepted: 0, injected: false };
        self.urgent.send(Outgoing::Hello(commands.hello())).await;
        if let Some(fault) = fault {
            self.urgent.send(self.event(EventKind::Fault(fault))).await;
        }
        if autostart {
            commands.start().await;
        }
        let mut frames = FrameReader::<Request>::new();
        let mut buffer = [0; READ];
        loop {
            let mut input = match link.read(&mut buffer).await {
                Ok(count @ 1..) => buffer.get(..count).unwrap_or_default(),
                Ok(0) | Err(_) => {
                    Timer::after(RETRY).await;
                    continue;
                }
            };
            while let Some(frame) = frames.read(&mut input) {
                // By reference from here on: a request moved into a future is kept there once more.
                match &frame {
                    Frame::Message { message, .. } => commands.serve(message).await,
                    Frame::Unknown { request: Some(id), .. } => commands.reply(*id, Err(Refusal::Unsupported)).await,
                    Frame::Unknown { .. } | Frame::Corrupt(_) => {
                        log!(warn, "bad frame");
                        self.note(|health| health.bad_frames = health.bad_frames.saturating_add(1));
                    }
                    // The host knows which of its requests got no reply.
                    Frame::Lost { .. } | Frame::Restarted | Frame::ForeignVersion { .. } => {}
                }
            }
        }
    }
}

impl<K: Store> Commands<'_, K> {
    async fn serve(&mut self, request: &Request) {
        let Request { id, command } = request;
        let restart = match command {
            Command::EnterDfu => Some((Restart::Dfu, Capabilities::DFU)),
            Command::Reboot => Some((Restart::Reboot, Capabilities::REBOOT)),
            _ => None,
        };
        let result = match &restart {
            Some((_, needed)) => self.require(*needed).map(|()| Done::Plain),
            None => self.obey(command).await,
        };
        self.reply(*id, result).await;
        if let (Some((restart, _)), Ok(_)) = (restart, result) {
            log!(info, "restart");
            self.app.urgent.send(Outgoing::Restart(restart)).await;
        }
    }

    async fn reply(&self, id: u16, result: Result<Done, Refusal>) {
        self.app.urgent.send(Outgoing::Reply(Reply { id, result })).await;
    }

    async fn event(&self, kind: EventKind) {
        self.app.urgent.send(self.app.event(kind)).await;
    }

    fn require(&self, needed: Capabilities) -> Result<(), Refusal> {
        if self.identity.capabilities.contains(needed) { Ok(()) } else { Err(Refusal::Unsupported) }
    }

    async fn obey(&mut self, command: &Command) -> Result<Done, Refusal> {
        match command {
            Command::Hello => self.app.urgent.send(Outgoing::Hello(self.hello())).await,
            Command::ReadSettings => self.app.urgent.send(Outgoing::Settings(self.settings)).await,
            Command::WriteSettings(values) => {
                let settings = values.write(&self.settings)?;
                self.adopt(&settings).await?;
            }
            Command::SaveSettings => {
                self.require(Capabilities::STORE)?;
                let values = SettingsValues::from(&self.settings);
                self.store.save(&values).await.map_err(|_| Refusal::Store)?;
            }
            Command::Tare => self.tare().await?,
            Command::Streams(streams) => self.app.set_streams(*streams),
            Command::ResetEstimator => self.reset().await,
            Command::Start => {
                self.require(Capabilities::SAMPLER)?;
                self.start().await;
            }
            Command::Stop => {
                self.require(Capabilities::SAMPLER)?;
                self.change_source(Source::Stopped).await;
            }
            Command::Inject(samples) => {
                self.require(Capabilities::INJECT)?;
                return self.inject(samples).await;
            }
            Command::InjectEnd => {
                self.require(Capabilities::INJECT)?;
                return self.end_injection().await;
            }
            // Served where they are known by their effect after the reply.
            Command::EnterDfu | Command::Reboot => return Err(Refusal::Unsupported),
        }
        Ok(Done::Plain)
    }

    fn hello(&self) -> Hello {
        let identity = &self.identity;
        Hello {
            wire_version: WIRE_VERSION,
            firmware: Hello::text(identity.firmware),
            git: Hello::text(identity.git),
            board: Hello::text(identity.board),
            serial: Hello::text(identity.serial),
            sample_rate_hz: self.settings.sample_rate_hz,
            clock: identity.clock,
            capabilities: identity.capabilities.with(Capabilities::SUMS),
        }
    }

    /// Asks something of the estimator that it answers at once.
    async fn control(&self, control: Control) {
        self.app.control_done.reset();
        self.app.control.signal(control);
        while self.app.control_done.wait().await != ControlDone::Plain {}
    }

    async fn reset(&mut self) {
        self.control(Control::Reset).await;
        self.event(EventKind::EstimatorReset).await;
    }

    /// Checks settings and puts them in use between two samples.
    async fn adopt(&mut self, settings: &Settings) -> Result<(), Refusal> {
        let active = settings.validate().map_err(|error| Refusal::of_setting(&error, u8::MAX))?;
        let reset = needs_reset(&self.settings, settings);
        self.control(Control::Use { active, reset }).await;
        self.settings = *settings;
        if reset {
            self.event(EventKind::EstimatorReset).await;
        }
        self.event(EventKind::SettingsChanged).await;
        self.app.urgent.send(Outgoing::Settings(*settings)).await;
        Ok(())
    }

    async fn tare(&mut self) -> Result<(), Refusal> {
        match self.app.queue.source() {
            Source::Sampler => {}
            Source::Stopped => return Err(Refusal::NoSamples),
            Source::Link => return Err(Refusal::Busy),
        }
        let samples = (self.settings.sample_rate_hz * TARE_S) as u32;
        self.app.control_done.reset();
        self.app.control.signal(Control::Tare(Tare::new(samples, &self.settings)));
        match with_timeout(TARE_LIMIT, self.app.control_done.wait()).await {
            Ok(ControlDone::Tared { force_code }) => {
                self.adopt(&Settings { force_zero_code: f64::from(force_code), ..self.settings }).await
            }
            _ => {
                self.control(Control::CancelTare).await;
                Err(Refusal::NoSamples)
            }
        }
    }

    async fn change_source(&mut self, source: Source) -> Source {
        let before = self.app.queue.change_source(source);
        if before != source {
            self.event(EventKind::SourceChanged(source)).await;
        }
        before
    }

    async fn start(&mut self) {
        self.change_source(Source::Sampler).await;
        if core::mem::take(&mut self.injected) {
            self.reset().await;
        }
    }

    fn credit(&self) -> (u32, u16) {
        (self.accepted, u16::try_from(self.app.queue.free()).unwrap_or(u16::MAX))
    }

    async fn inject(&mut self, samples: &Samples) -> Result<Done, Refusal> {
        samples.check().map_err(|_| Refusal::BadSamples)?;
        if self.app.queue.source() != Source::Link {
            self.change_source(Source::Link).await;
            self.accepted = 0;
            self.injected = true;
            self.reset().await;
        }
        let count = samples.len();
        let room = with_timeout(INJECT_LIMIT, self.app.queue.room(Source::Link, count)).await;
        if room != Ok(Ok(())) || !self.enqueue(samples) {
            let (accepted, free) = self.credit();
            return Err(Refusal::QueueFull { accepted, free });
        }
        self.accepted = self.accepted.wrapping_add(count as u32);
        let (accepted, free) = self.credit();
        Ok(Done::Injected { accepted, free })
    }

    /// Gives samples to the estimator; whether all found room.
    fn enqueue(&self, samples: &Samples) -> bool {
        let mut batch = [RawSample::default(); BATCH];
        for (place, sample) in batch.iter_mut().zip(samples.iter().flatten()) {
            *place = sample;
        }
        let batch = batch.get(..samples.len()).unwrap_or_default();
        self.app.queue.give_now(Source::Link, batch) == Ok(0)
    }

    async fn end_injection(&mut self) -> Result<Done, Refusal> {
        if self.app.queue.source() != Source::Link {
            return Err(Refusal::NotInjecting);
        }
        self.control(Control::Finish).await;
        self.app.queue.change_source(Source::Stopped);
        let (accepted, free) = self.credit();
        Ok(Done::Injected { accepted, free })
    }
}
