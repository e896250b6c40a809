//! Answers requests; owns the settings.

use crate::app::App;
use crate::board::{Identity, SourceError, Store};
use crate::logging::log;
use crate::messages::{Control, ControlDone, Outgoing, Restart};
use crate::queue::BATCH;
use crate::settings::{InUse, concerns_source, needs_reset};
use crate::tare::Tare;
use crate::wear::FACTORY_RESET;
use core::future::pending;
use embassy_time::{Duration, Timer, with_timeout};
use embedded_io_async::Read;
use inerter_core::{RawSample, Settings};
use inerter_wire::{
    Capabilities, Command, Done, Event, EventKind, Fault, Frame, FrameReader, Hello, Measure, Refusal, Reply, Request,
    ResetCause, Samples, SettingsValues, Source, WIRE_VERSION,
};

/// Bytes taken from the link at once.
const READ: usize = 64;
/// Pause before a link that gave an error is read again.
const RETRY: Duration = Duration::from_millis(50);
/// Time that a tare averages, in seconds.
const TARE_S: f64 = 0.5;
/// Time within which a tare must get its samples.
const TARE_LIMIT: Duration = Duration::from_secs(2);
/// Time that an injected batch waits for room. It exceeds the time for which the link can block the estimator.
const INJECT_LIMIT: Duration = Duration::from_secs(2);

struct Commands<'a, K> {
    app: &'a App,
    store: K,
    identity: &'a Identity<'a>,
    in_use: &'a mut InUse,
    /// Samples accepted since the injection began.
    accepted: u32,
    /// The estimator holds injected samples.
    injected: bool,
}

/// Answers requests. Invalid input on the link is at most refused or counted as a bad frame.
pub async fn commands(
    app: &App,
    mut link: impl Read,
    store: impl Store,
    identity: &Identity<'_>,
    in_use: &mut InUse,
    autostart: bool,
) -> ! {
    app.set_saves_left(identity.start.saves_left);
    let mut commands = Commands { app, store, identity, in_use, accepted: 0, injected: false };
    let _ = commands.configure(&commands.in_use.settings).await;
    if !app.link.is_mute() {
        commands.greet().await;
    }
    // A source that did not start has been reported, or will be.
    if autostart && app.source_is_ready() {
        let _ = commands.start().await;
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
            let is_request = matches!(&frame, Frame::Message { .. } | Frame::Unknown { request: Some(_), .. });
            if is_request && app.link.note_request() && !app.is_greeted() {
                commands.greet().await;
            }
            // By reference from here on: a request moved into a future is stored a second time.
            match &frame {
                Frame::Message { message, .. } => commands.serve(message).await,
                Frame::Unknown { request: Some(id), .. } => commands.reply(*id, Err(Refusal::Unsupported)).await,
                Frame::Unknown { .. } | Frame::Corrupt(_) => {
                    log!(warn, "bad frame");
                    app.note(|health| health.bad_frames = health.bad_frames.saturating_add(1));
                }
                // The host notices which of its requests got no reply.
                Frame::Lost { .. } | Frame::Restarted | Frame::ForeignVersion { .. } => {}
            }
        }
    }
}

impl<K: Store> Commands<'_, K> {
    /// Tells the first host which device this is and how the run began.
    async fn greet(&self) {
        let start = self.identity.start;
        let hung = matches!(start.cause, ResetCause::Watchdog | ResetCause::WindowWatchdog);
        let silent_source = !self.app.source_is_ready() && self.identity.capabilities.contains(Capabilities::SAMPLER);
        self.start_event(EventKind::Started).await;
        self.app.urgent.send(Outgoing::Hello(self.hello())).await;
        self.start_event(EventKind::ResetBy(start.cause)).await;
        if let Some(message) = start.panic {
            self.start_event(EventKind::Panicked(Hello::text(message))).await;
        }
        let faults =
            [hung.then_some(Fault::Watchdog), self.in_use.fault, silent_source.then_some(Fault::SourceUnreadable)];
        for fault in faults.into_iter().flatten() {
            self.start_event(EventKind::Fault(fault)).await;
        }
        self.app.urgent.send(Outgoing::Greeted).await;
    }

    /// Sends an event that precedes the first sample.
    async fn start_event(&self, kind: EventKind) {
        self.app.urgent.send(Outgoing::Event(Event { index: 0, kind })).await;
    }

    async fn serve(&mut self, request: &Request) {
        let Request { id, command } = request;
        let restart = match command {
            Command::EnterDfu => Some((Restart::Dfu, Capabilities::DFU)),
            Command::Reboot => Some((Restart::Reboot, Capabilities::REBOOT)),
            Command::Measure(Measure::Hang) => Some((Restart::Hang, Capabilities::MEASURE)),
            _ => None,
        };
        let result = match &restart {
            Some((_, needed)) => self.require(*needed).map(|()| Done::Plain),
            None => self.execute(command).await,
        };
        self.reply(*id, result).await;
        if let (Some((restart, _)), Ok(_)) = (restart, result) {
            log!(info, "restart");
            self.app.urgent.send(Outgoing::Restart(restart)).await;
            // No later request is executed: its reply would be cut off.
            pending::<()>().await;
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

    async fn execute(&mut self, command: &Command) -> Result<Done, Refusal> {
        match command {
            Command::Hello => self.app.urgent.send(Outgoing::Hello(self.hello())).await,
            Command::ReadSettings => self.app.urgent.send(Outgoing::Settings(self.in_use.settings)).await,
            Command::WriteSettings(values) => {
                let settings = values.write(&self.in_use.settings)?;
                self.adopt(&settings).await?;
            }
            Command::SaveSettings => {
                self.require(Capabilities::STORE)?;
                self.app.take_saves(1).map_err(|wait_s| Refusal::Worn { wait_s })?;
                let values = SettingsValues::from(&self.in_use.settings);
                self.store.save(&values).await.map_err(|_| Refusal::Store)?;
            }
            Command::Tare => self.tare().await?,
            Command::Streams(streams) => self.app.set_streams(*streams),
            Command::ResetEstimator => self.reset().await,
            Command::Start => {
                self.require(Capabilities::SAMPLER)?;
                self.start().await?;
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
            Command::FactoryReset => {
                self.require(Capabilities::STORE)?;
                self.app.take_saves(FACTORY_RESET).map_err(|wait_s| Refusal::Worn { wait_s })?;
                self.store.erase().await.map_err(|_| Refusal::Store)?;
                let defaults = self.in_use.defaults;
                self.adopt(&defaults).await?;
            }
            Command::ReadSaved => {
                self.require(Capabilities::STORE)?;
                let values = self.store.load().await.map_err(|_| Refusal::SavedUnreadable)?;
                let values = values.ok_or(Refusal::NothingSaved)?;
                let saved = values.read(&self.in_use.defaults).settings;
                self.app.urgent.send(Outgoing::Saved(saved)).await;
            }
            Command::Play(play) => {
                self.require(Capabilities::PLAYER)?;
                let (answer, free) = (self.identity.play)(play)?;
                return Ok(Done::Played { answer, free });
            }
            Command::Measure(what) => {
                self.require(Capabilities::MEASURE)?;
                // The task that measures sends the record before it signals that it is done.
                self.app.measured.reset();
                self.app.measure.signal(*what);
                self.app.measured.wait().await;
            }
            // Handled in `serve`, because they take effect after the reply.
            Command::EnterDfu | Command::Reboot => return Err(Refusal::Unsupported),
        }
        Ok(Done::Plain)
    }

    fn hello(&self) -> Hello {
        let identity = self.identity;
        Hello {
            wire_version: WIRE_VERSION,
            firmware: Hello::text(identity.firmware),
            git: Hello::text(identity.git),
            board: Hello::text(identity.board),
            serial: Hello::text(identity.serial),
            sample_rate_hz: self.in_use.settings.sample_rate_hz,
            clock: identity.clock,
            capabilities: identity.capabilities.with(Capabilities::SUMS),
        }
    }

    /// Sends a control to the estimator; [`control_done`](Self::control_done) waits until it is done.
    ///
    /// Not combined into one future, which would store the large controls twice.
    fn control(&self, control: Control) {
        self.app.control_done.reset();
        self.app.control.signal(control);
    }

    /// Waits until the estimator replies [`ControlDone::Plain`].
    async fn control_done(&self) {
        while self.app.control_done.wait().await != ControlDone::Plain {}
    }

    async fn reset(&mut self) {
        self.control(Control::Reset);
        self.control_done().await;
        self.event(EventKind::EstimatorReset).await;
    }

    /// Makes the source apply settings; it must be halted.
    async fn configure(&self, settings: &Settings) -> Result<(), SourceError> {
        self.app.configured.reset();
        self.app.configure.signal(*settings);
        let result = self.app.configured.wait().await;
        self.app.set_source_ready(result.is_ok());
        result
    }

    /// Checks settings and puts them in use between two samples, or leaves everything as it was.
    ///
    /// Settings of the source are changed while the sampler is halted and the queue is empty, so that no sample is
    /// processed under settings other than those it was taken with.
    async fn adopt(&mut self, settings: &Settings) -> Result<(), Refusal> {
        let refusal = |error| Refusal::of_setting(&error, u8::MAX);
        // Quantised again below: kept across the wait, it would be stored twice.
        settings.validate().map_err(refusal)?;
        (self.identity.accepts)(settings).map_err(refusal)?;
        let mut was_sampling = false;
        if concerns_source(&self.in_use.settings, settings) {
            was_sampling = self.app.queue.halt_sampler();
            // No batch may hold samples from both before and after.
            self.control(Control::Flush);
            self.control_done().await;
            if self.configure(settings).await.is_err() {
                self.resume(was_sampling).await;
                return Err(Refusal::Source);
            }
        }
        let reset = needs_reset(&self.in_use.settings, settings);
        let active = settings.validate().map_err(refusal)?;
        self.control(Control::Use { active, reset });
        self.control_done().await;
        self.in_use.settings = *settings;
        if reset {
            self.event(EventKind::EstimatorReset).await;
        }
        self.event(EventKind::SettingsChanged).await;
        self.app.urgent.send(Outgoing::Settings(*settings)).await;
        if was_sampling {
            self.app.queue.change_source(Source::Sampler);
        }
        Ok(())
    }

    /// Reconfigures the source with the settings in use, if possible.
    async fn resume(&self, was_sampling: bool) {
        if self.configure(&self.in_use.settings).await.is_err() {
            log!(error, "source unusable");
            self.event(EventKind::Fault(Fault::SourceUnreadable)).await;
            if was_sampling {
                self.event(EventKind::SourceChanged(Source::Stopped)).await;
            }
        } else if was_sampling {
            self.app.queue.change_source(Source::Sampler);
        }
    }

    async fn tare(&mut self) -> Result<(), Refusal> {
        match self.app.queue.source() {
            Source::Sampler => {}
            Source::Stopped => return Err(Refusal::NoSamples),
            Source::Link => return Err(Refusal::Busy),
        }
        let samples = (self.in_use.settings.sample_rate_hz * TARE_S) as u32;
        self.control(Control::Tare(Tare::new(samples, &self.in_use.settings)));
        match with_timeout(TARE_LIMIT, self.app.control_done.wait()).await {
            Ok(ControlDone::Tared { force_code }) => {
                self.adopt(&Settings { force_zero_code: f64::from(force_code), ..self.in_use.settings }).await
            }
            _ => {
                self.control(Control::CancelTare);
                self.control_done().await;
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

    async fn start(&mut self) -> Result<(), Refusal> {
        let unready = self.app.queue.source() != Source::Sampler && !self.app.source_is_ready();
        if unready && self.configure(&self.in_use.settings).await.is_err() {
            return Err(Refusal::Source);
        }
        self.change_source(Source::Sampler).await;
        if core::mem::take(&mut self.injected) {
            self.reset().await;
        }
        Ok(())
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

    /// Queues samples for the estimator; returns whether all found room.
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
        self.control(Control::Finish);
        self.control_done().await;
        self.app.queue.change_source(Source::Stopped);
        let (accepted, free) = self.credit();
        Ok(Done::Injected { accepted, free })
    }
}

#[cfg(test)]
mod tests {
    use super::{Commands, INJECT_LIMIT};
    use crate::app::App;
    use crate::board::{Identity, NoStore, Start, accept_all, play_nothing};
    use crate::queue::QUEUE;
    use crate::settings::InUse;
    use core::pin::pin;
    use core::task::Poll;
    use embassy_futures::{block_on, poll_once};
    use embassy_time::MockDriver;
    use inerter_core::{RawSample, Settings};
    use inerter_wire::{Capabilities, ClockSource, Done, Refusal, Samples, Source};

    const IDENTITY: Identity<'static> = Identity {
        firmware: "inerter",
        git: "",
        board: "bench",
        serial: "",
        clock: ClockSource::Simulated,
        capabilities: Capabilities::INJECT,
        accepts: accept_all,
        play: play_nothing,
        start: Start::POWER_ON,
    };

    /// Without an estimator, which would make room before the time is up.
    #[test]
    fn a_batch_that_finds_no_room_in_time_is_refused_whole() {
        let app = &App::new();
        app.queue.change_source(Source::Link);
        let mut in_use = InUse { settings: Settings::default(), defaults: Settings::default(), fault: None };
        let mut commands =
            Commands { app, store: NoStore, identity: &IDENTITY, in_use: &mut in_use, accepted: 0, injected: true };
        let batch = Samples::from_slice(&[RawSample::default(); 32]).0;
        let half = Samples::from_slice(&[RawSample::default(); 16]).0;
        for _ in 1..QUEUE / 32 {
            assert!(block_on(commands.inject(&batch)).is_ok());
        }
        assert_eq!(block_on(commands.inject(&half)), Ok(Done::Injected { accepted: 240, free: 16 }));
        {
            let mut waiting = pin!(commands.inject(&batch));
            assert!(poll_once(waiting.as_mut()).is_pending());
            MockDriver::get().advance(INJECT_LIMIT);
            let full = Refusal::QueueFull { accepted: 240, free: 16 };
            assert_eq!(poll_once(waiting), Poll::Ready(Err(full)));
        }
        assert_eq!(app.queue.take_now(&mut [RawSample::default(); 16]), 16);
        assert_eq!(block_on(commands.inject(&batch)), Ok(Done::Injected { accepted: 272, free: 0 }));
    }
}
